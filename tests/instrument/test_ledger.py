"""The ledger alone, by what an instrument tells it: numbers, sums, and families that say as little as they may."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.instrument.ledger import MOST_OPEN, SETTLED_KEPT, STREAMS_KEPT, Ledger
from protocols.scan import ScanPlan
from protocols.session import Address, Dropped, DropReason, Emission, dropped_scans
from tests.instrument.account import SECOND, Yard

PERIOD_NS = 100_000_000
ONE, OTHER = Address(0, 1), Address(0, 2)


def plan(sweep: int, epoch: int = 0, **more: Any) -> ScanPlan:
    nothing = np.zeros(1)
    return ScanPlan(epoch, sweep, sweep * PERIOD_NS, nothing, nothing, nothing, 0.1, **more)


def sent(sweep: int, address: Address | None = None, scans: int = 1) -> Emission:
    return Emission(0, b"scan", address, sweep, scans=scans)


def reported(reason: DropReason, count: int) -> Dropped:
    return Dropped(0, reason, count=count)


def sums(ledger: Ledger) -> tuple[int, int, int, int, int, int]:
    one = ledger.account()
    dropped = sum(one["dropped"].values())
    return one["asked"], one["sent"], dropped, one["withdrawn"], one["under_way"], one["unaccounted"]


def measured(ledger: Ledger, *sweeps: int, **more: Any) -> Ledger:
    for sweep in sweeps:
        ledger.ask(plan(sweep, **more))
        ledger.take(plan(sweep, **more))
    return ledger


def test_what_is_asked_for_is_under_way_until_it_is_sent() -> None:
    ledger = measured(Ledger(), 0, 1)
    ledger.ask(plan(2))
    assert sums(ledger) == (3, 0, 0, 0, 3, 0)
    ledger.send(sent(0))
    assert sums(ledger) == (3, 1, 0, 0, 2, 0)


def test_numbers_that_are_passed_over_are_missing_once_the_next_has_left_and_nobody_has_said_why() -> None:
    ledger = measured(Ledger(), 0, 5)
    assert sums(ledger) == (6, 0, 0, 0, 6, 0), "they are told with the one behind them"
    ledger.send(sent(0))
    ledger.send(sent(5))
    assert sums(ledger) == (6, 2, 0, 0, 0, 4)
    ledger.tell(dropped_scans(0, DropReason.LATE, range(1, 3))[0])
    assert sums(ledger) == (6, 2, 2, 0, 0, 2)
    ledger.tell(reported(DropReason.LINE_BUSY, 2))  # without numbers
    assert ledger.account()["dropped"] == {"line slower than the scan rate": 2, "measured too late": 2}
    assert sums(ledger)[-1] == 0


def test_a_stream_counts_by_the_turns_that_a_scan_takes() -> None:
    ledger = measured(Ledger(), 0, 8, stride=2, stream=1)
    ledger.send(sent(0))
    ledger.send(sent(8))
    assert sums(ledger) == (5, 2, 0, 0, 0, 3)
    ledger.tell(dropped_scans(0, DropReason.LINE_BUSY, range(2, 8, 2), stream=1)[0])
    assert sums(ledger) == (5, 2, 3, 0, 0, 0)


def test_a_scan_that_was_measured_and_overtaken_is_missing() -> None:
    ledger = measured(Ledger(), 0, 1, 2)
    ledger.send(sent(2))
    assert sums(ledger) == (3, 1, 0, 0, 0, 2)


def test_drops_without_numbers_may_be_told_before_the_numbers_are_passed_over() -> None:
    ledger = measured(Ledger(), 0)
    ledger.tell(reported(DropReason.LATE, 4))
    assert sums(ledger) == (5, 0, 4, 0, 1, 0)
    ledger.ask(plan(5))
    assert sums(ledger) == (6, 0, 4, 0, 2, 0)


def test_what_is_withdrawn_without_numbers_is_what_was_measured() -> None:
    ledger = measured(Ledger(), 0, 1)
    ledger.tell(reported(DropReason.STALE, 2))
    assert sums(ledger) == (2, 0, 0, 2, 0, 0)


def test_a_sweep_that_is_asked_for_anew_is_the_same_slot() -> None:
    ledger = Ledger()
    ledger.ask(plan(0, epoch=0, stream=1))
    ledger.ask(plan(0, epoch=1, stream=1))
    ledger.refuse(plan(0, epoch=0, stream=1))
    assert sums(ledger) == (1, 0, 0, 0, 1, 0)
    ledger.take(plan(0, epoch=1, stream=1))
    ledger.tell(dropped_scans(0, DropReason.STALE, range(0, 1), stream=1)[0])
    assert sums(ledger) == (1, 0, 0, 1, 0, 0)
    ledger.ask(plan(0, epoch=2, stream=1))
    assert sums(ledger) == (1, 0, 0, 0, 1, 0)
    ledger.send(sent(0))
    assert (sums(ledger), ledger.again) == ((1, 1, 0, 0, 0, 0), 2)


def test_a_number_within_a_gap_that_is_asked_for_after_all_is_no_more_missing() -> None:
    ledger = measured(Ledger(), 0, 10, stream=1)
    ledger.refuse(plan(10, stream=1))
    ledger.ask(plan(4, epoch=1, stream=1))
    assert sums(ledger)[0] == 11
    ledger.send(sent(0))
    ledger.send(sent(4))
    ledger.tell(dropped_scans(0, DropReason.LINE_BUSY, range(1, 4), stream=1)[0])
    ledger.tell(dropped_scans(0, DropReason.LINE_BUSY, range(5, 10), stream=1)[0])
    assert sums(ledger) == (11, 2, 8, 1, 0, 0)


@pytest.mark.parametrize("first", [True, False])
def test_a_scan_for_two_hosts_is_two_slots_whichever_gets_it(first: bool) -> None:
    ledger = measured(Ledger(), 0, stream=1)
    busy = dropped_scans(0, DropReason.LINE_BUSY, range(0, 1), stream=1, address=OTHER)[0]
    for action in (ledger.tell, ledger.send) if first else (ledger.send, ledger.tell):
        action(busy if action == ledger.tell else sent(0, ONE))
    assert sums(ledger) == (2, 1, 1, 0, 0, 0)


def test_a_drop_that_is_told_twice_counts_once() -> None:
    ledger = measured(Ledger(), 0, stream=1)
    for _ in range(2):
        ledger.tell(dropped_scans(0, DropReason.LATE, range(1, 4), stream=1)[0])
    assert sums(ledger) == (4, 0, 3, 0, 1, 0)


def test_a_hole_before_what_is_told_is_missing() -> None:
    ledger = measured(Ledger(), 0, stream=1)
    ledger.tell(dropped_scans(0, DropReason.LATE, range(3, 5), stream=1)[0])
    assert sums(ledger) == (5, 0, 2, 0, 1, 2)


def test_slots_pass_by_the_clock_while_a_sweep_is_not_measured() -> None:
    ledger = measured(Ledger(), 0)
    ledger.ask(plan(1))
    ledger.now_ns = 2 * PERIOD_NS + 7 * PERIOD_NS + 1
    assert sums(ledger) == (9, 0, 7, 0, 2, 0), "told, not kept: it may come any moment"
    ledger.wants(None)
    ledger.now_ns += 50 * PERIOD_NS
    assert sums(ledger) == (9, 0, 7, 0, 2, 0), "nothing is owed behind the end"
    ledger.tell(reported(DropReason.LATE, 7))  # a session that says so itself
    assert sums(ledger) == (9, 0, 7, 0, 2, 0)


def test_one_scan_that_was_asked_for_is_followed_by_no_other() -> None:
    ledger = Ledger()
    ledger.ask(plan(3, stream=1, period_ns=0))
    ledger.now_ns = 100 * SECOND
    assert sums(ledger) == (1, 0, 0, 0, 1, 0)


def test_after_a_rest_a_family_without_numbers_of_streams_begins_another() -> None:
    ledger = measured(Ledger(), 0)
    ledger.send(sent(0))
    ledger.wants(None)
    measured(ledger, 30)
    ledger.send(sent(30))
    assert sums(ledger) == (2, 2, 0, 0, 0, 0)


def test_a_power_cut_takes_what_is_under_way_and_a_restart_withdraws_it() -> None:
    for action, at in ((lambda one: one.cut("switched off"), 2), (lambda one: one.restart(), 3)):
        ledger = measured(Ledger(), 0, 4, stream=1)
        ledger.ask(plan(5, stream=1))
        action(ledger)
        assert sums(ledger)[0] == sums(ledger)[at] == 6
        ledger.refuse(plan(5, stream=1))
        assert sums(ledger)[-1] == 0
        ledger.send(sent(4))  # it was on its way already
        assert sums(ledger)[1::4] == (1, 0)


def test_what_leaves_for_nobody_who_asked_does_not_add_up() -> None:
    ledger = Ledger()
    ledger.send(sent(7))
    assert sums(ledger)[-1] == -1


def test_what_a_ledger_keeps_is_bounded() -> None:
    ledger = Ledger()
    for epoch in range(100):
        for sweep in range(0, 4 * MOST_OPEN, 2):
            ledger.ask(plan(sweep, epoch))
            if sweep % 4:
                ledger.take(plan(sweep, epoch))
    assert len(ledger._streams) <= STREAMS_KEPT
    for stream in ledger._streams:
        assert max(len(stream.open), len(stream.passed)) <= MOST_OPEN
        assert len(stream.settled) <= SETTLED_KEPT
    assert sums(ledger)[-1] > 0, "what was never measured and is forgotten has been lost"


def test_ranges_of_months_cost_no_time() -> None:
    ledger = measured(Ledger(), 0, 10**9, stream=1)
    ledger.tell(dropped_scans(0, DropReason.LATE, range(1, 10**9), stream=1)[0])
    assert sums(ledger) == (10**9 + 1, 0, 10**9 - 1, 0, 2, 0)


# ---------------------------------------------------------------- the example of a family


def acme(monkeypatch: pytest.MonkeyPatch) -> tuple[Yard, Any]:
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "docs/examples/acme_family")
    import acme_lidar

    sys.modules.pop("acme_lidar")
    yard = Yard("line", session=acme_lidar.FAMILY.new_session({}, {}))
    host = yard.connect()
    yard.wait(1.0)
    host.write(b"START\n", yard.now_ns)
    yard.wait(1.0)
    return yard, host


def test_a_family_in_a_package_of_its_own_has_every_scan_on_account(monkeypatch: pytest.MonkeyPatch) -> None:
    yard, host = acme(monkeypatch)
    yard.measuring.stand_still(3 * SECOND)
    account = yard.wait(2.0).account
    assert account["asked"] == pytest.approx(30, abs=4)
    assert account["dropped"]["measured too late"] == pytest.approx(17, abs=3)
    host.write(b"STOP\n", yard.now_ns)
    account = yard.wait(20.0).account
    assert account["asked"] == pytest.approx(30, abs=4)
    assert account["unaccounted"] == account["under_way"] == 0
    host.write(b"START\n", yard.now_ns)
    yard.wait(1.02)
    host.write(b"STOP\n", yard.now_ns)
    account = yard.wait(1.0).account
    assert account["asked"] == pytest.approx(42, abs=5)
    assert account["unaccounted"] == account["under_way"] == 0
    assert account["withdrawn"] >= 3


def test_a_one_way_family_has_every_scan_on_account(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[2] / "docs/examples/acme_family")
    import acme_spin

    sys.modules.pop("acme_spin")
    yard = Yard("tcp", session=acme_spin.FAMILY.new_session({}, {}))
    host = yard.connect()
    account = yard.wait(4.0).account
    assert account["sent"] == pytest.approx(20, abs=1)
    assert sum(len(one.data) for one in host.arrivals) // acme_spin.PACKET.itemsize == pytest.approx(15 * 20, abs=20)
    yard.measuring.stand_still(3 * SECOND)
    account = yard.wait(3.0).account
    assert account["dropped"]["measured too late"] == pytest.approx(28, abs=3)
    assert account["unaccounted"] == 0
    assert yard.session.impair(yard.now_ns, "motor speed", 1.1)
    account = yard.wait(2.0).account
    assert account["unaccounted"] == 0
    assert account["withdrawn"] >= 1
    yard.instrument.power_off(yard.now_ns)
    yard.wait(1.0)
    yard.instrument.power_back(yard.now_ns)
    before = account["sent"]
    account = yard.wait(4.0).account
    assert account["sent"] - before == pytest.approx(22, abs=3)
    assert account["unaccounted"] == 0


@pytest.mark.unaccounted
def test_a_family_that_skips_without_a_word_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    yard, _ = acme(monkeypatch)
    events = yard.session.take_events
    yard.session.take_events = lambda: [one for one in events() if not isinstance(one, Dropped)]  # type: ignore[method-assign]
    yard.measuring.stand_still(3 * SECOND)
    assert yard.wait(5.0).account["unaccounted"] == pytest.approx(28, abs=4)
