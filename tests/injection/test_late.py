"""What faults make late and what waits behind it: its order, its end by an order, a power cut; draws of a trigger."""

from __future__ import annotations

from typing import Any

import pytest

from emulator.faults.reading import FaultError
from emulator.physics.random_streams import RandomStreams
from tests.faults.bench import Bench, faultless

SECOND = 1_000_000_000


def cleared(kind: str, **keys: Any) -> Bench:
    """From 3.01 s a fault would hold the link for an hour; it is cleared at 4 s."""
    bench = Bench(kind).until(3.01)
    number = bench.faults.add({"on": "front", **keys}, 3_010_000_000)
    bench.until(4.0)
    assert bench.sent(3.1, 4.1) == [], "all waits behind what is late"
    bench.faults.clear(number, 4 * SECOND)
    return bench.until(7.0)


@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
@pytest.mark.parametrize("more", [{}, {"count": 1}], ids=["holds", "over"])
def test_a_delay_that_is_cleared_lets_go_of_what_waits(kind: str, more: dict[str, Any]) -> None:
    bench = cleared(kind, do="delay_telegram", delay_s=3600.0, **more)
    healthy = faultless(kind, 7.0)
    assert bench.sent(4.0, 7.0)[0].start_ns == 4 * SECOND
    if kind != "line":  # whose own pace lets the slower half of a second's telegrams go
        assert [one.data for one in bench.sent()] == [one.data for one in healthy.sent()], "all of it, in its order"
    assert [one.data for one in bench.sent(6.0)] == [one.data for one in healthy.sent(6.0)]
    assert [one.start_ns for one in bench.sent(6.0)] == [one.start_ns for one in healthy.sent(6.0)]
    assert bench.instrument.stats.scans_sent == healthy.instrument.stats.scans_sent
    assert bench.instrument.stats.replies_sent == healthy.instrument.stats.replies_sent


@pytest.mark.parametrize("kind", ["line", "tcp"])
def test_a_gap_that_is_cleared_is_over(kind: str) -> None:
    bench = Bench(kind).until(3.01)
    number = bench.faults.add({"on": "front", "do": "gap", "gap_s": 3600.0, "at_byte": 100}, 3_010_000_000)
    bench.until(4.0)
    (first,) = bench.sent(3.01, 4.0)
    assert len(first.data) == 100
    bench.faults.clear(number, 4 * SECOND)
    bench.until(7.0)
    healthy = faultless(kind, 7.0)
    second = bench.sent(4.0, 7.0)[0]
    assert first.data + second.data == healthy.sent(3.01)[0].data
    assert [one.start_ns for one in bench.sent(6.0)] == [one.start_ns for one in healthy.sent(6.0)]
    assert bench.instrument.stats.scans_sent == healthy.instrument.stats.scans_sent
    assert bench.instrument.stats.replies_sent == healthy.instrument.stats.replies_sent


def test_a_controller_is_back_on_the_bus_when_its_fault_is_cleared() -> None:
    bench = Bench("can").until(3.01)
    number = bench.faults.add({"on": "front", "do": "bus_off", "off_s": 3600.0}, 3_010_000_000)
    bench.until(4.0)
    assert bench.sent(3.2, 4.0) == []
    bench.faults.clear(number, 4 * SECOND)
    bench.until(6.0)
    healthy = faultless("can", 6.0)
    assert [(one.start_ns, one.data) for one in bench.sent(4.1)] == [
        (one.start_ns, one.data) for one in healthy.sent(4.1)
    ]


def test_telegrams_are_told_as_they_leave_when_a_fault_has_changed_the_speed_of_the_line() -> None:
    bench = Bench("line").until(3.01)
    number = bench.faults.add({"on": "front", "do": "wrong_baud", "baud": 1200}, 3_010_000_000)
    bench.until(4.0)
    bench.faults.clear(number, 4 * SECOND)
    bench.until(8.0)
    healthy = faultless("line", 8.0)
    assert bench.decoded(7.0, 8.0) >= 37, "the line itself is as fast as ever"
    reported, right = ([one.start_ns for one in one.heard.sent[-30:]] for one in (bench, healthy))
    assert reported == right


def test_nothing_of_a_slow_line_is_told_behind_a_power_cut() -> None:
    bench = Bench("line", {"do": "wrong_baud", "baud": 50, "at_s": 3.0, "for_s": 0.5}).until(3.4)
    bench.faults.add({"on": "front", "do": "power_cycle", "off_s": 0.2}, 3_400_000_000)
    before = len(bench.heard.sent)
    text = bench.until(12.0).heard.sent[before]
    assert text.label == "90"
    assert 5.0 * SECOND < text.start_ns < 6.0 * SECOND, "in its own time, behind nothing"


def test_clearing_one_delay_leaves_another_alone() -> None:
    bench = Bench("tcp").until(3.0)
    for delay_s in (1.0, 3600.0):
        bench.faults.add({"on": "front", "do": "delay_telegram", "delay_s": delay_s, "count": 1}, 3 * SECOND)
    bench.until(3.05)
    bench.faults.clear(1, 3_050_000_000)
    assert bench.until(6.0).sent(3.1) == []
    bench.faults.clear(2, 6 * SECOND)
    assert bench.until(7.0).sent(6.0, 7.0)[0].start_ns == 6 * SECOND


@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
def test_what_is_late_is_gone_when_the_power_is_cut(kind: str) -> None:
    bench = Bench(kind).until(3.0)
    bench.faults.add({"on": "front", "do": "delay_telegram", "delay_s": 2.0, "count": 1}, 3 * SECOND)
    cut = bench.until(4.0).faults.add({"on": "front", "do": "power_cycle", "off_s": 5.0}, 4 * SECOND)
    bench.until(8.0)
    assert bench.sent(3.1, 8.0) == []
    assert bench.row(cut)["taken"]["bytes"] > 100


def test_a_scan_held_back_when_the_power_is_cut_is_on_account() -> None:
    bench = Bench("tcp").until(3.01)
    bench.faults.add({"on": "front", "do": "reorder_telegrams", "behind": 64, "of": "scans"}, 3_010_000_000)
    bench.until(3.15)
    assert len(bench.sent(3.01, 3.15)) == 0
    bench.faults.add({"on": "front", "do": "power_cycle", "off_s": 5.0}, 3_150_000_000)
    stats = bench.until(3.5).instrument.stats
    assert stats.scans_measured == stats.scans_sent + stats.scans_dropped.total()


@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
def test_scans_that_a_live_power_cut_takes_are_on_account(kind: str) -> None:
    bench = Bench(kind).until(3.15)
    bench.faults.add({"on": "front", "do": "power_cycle", "off_s": 5.0}, 3_150_000_000)
    stats = bench.until(3.5).instrument.stats
    account = stats.ledger.account()
    assert account["dropped"]["switched off"] > 1
    assert (account["under_way"], account["unaccounted"]) == (0, 0)
    assert account["asked"] == stats.scans_sent + stats.scans_dropped.total()


@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
@pytest.mark.parametrize("held", ["delay_telegram", "slow_link", "reorder_telegrams"])
@pytest.mark.parametrize("first", [True, False])
def test_a_telegram_that_begins_a_power_cut_does_not_leave_nor_wait(kind: str, held: str, first: bool) -> None:
    keys = {"delay_telegram": {"delay_s": 0.3, "every": 2}, "slow_link": {"bytes_per_s": 2000.0, "at_s": 2.0}}
    faults = [{"do": held, **keys.get(held, {"every": 2})}, {"do": "power_cycle", "off_s": 0.5, "at_telegram": 30}]
    bench = Bench(kind, *(faults if first else faults[::-1]))
    stats = bench.instrument.stats
    for second in range(1, 41):  # until it measures again
        bench.until(second)
        if stats.restarts == 2 and stats.ledger.account()["under_way"]:
            break
    cuts = [event.at_ns for event in bench.reported("hit") if event.name == "power_cycle"]
    assert len(cuts) == 1
    assert [one for one in bench.heard.sent if cuts[0] <= one.start_ns < cuts[0] + 500_000_000] == []
    assert stats.restarts == 2
    account = stats.ledger.account()
    assert account["dropped"]["switched off"] > 1
    assert account["unaccounted"] == 0
    assert 0 < account["under_way"] < 12, "measured ahead"


@pytest.mark.parametrize("do", ["unplug", "reset_connections", None])
def test_revolutions_that_nobody_wants_any_more_are_on_account(do: str | None) -> None:
    bench = Bench("tcp").until(3.01)
    if do is None:
        bench.end.close(3_010_000_000)
    else:
        bench.faults.add({"on": "front", "do": do}, 3_010_000_000)
    stats = bench.until(3.6).instrument.stats
    account = stats.ledger.account()
    assert account["under_way"] == (4 if do == "reset_connections" else 0)  # for its host, which is back
    assert stats.scans_measured == stats.scans_sent + stats.scans_dropped.total() + account["under_way"]
    assert account["unaccounted"] == 0


def test_a_late_telegram_on_one_of_two_links_holds_that_link_alone() -> None:
    bench = Bench("line", links=2).until(3.0)
    bench.faults.add({"on": "front", "do": "delay_telegram", "delay_s": 0.5, "count": 1, "link": 1}, 3 * SECOND)
    bench.until(5.0)
    healthy = Bench("line", links=2).until(5.0)
    assert [one.start_ns for one in bench.sent() if one.link == 0] == [
        one.start_ns for one in healthy.sent() if one.link == 0
    ]
    late = [one for one in bench.sent(3.0) if one.link == 1]
    assert late[0].start_ns >= 3.5 * SECOND
    assert [one.data for one in late] == [one.data for one in healthy.sent(3.0) if one.link == 1][: len(late)]


@pytest.mark.parametrize("held", [{"do": "slow_link", "bytes_per_s": 3000.0}, {"do": "reorder_telegrams", "every": 2}])
def test_a_scan_that_is_held_back_on_one_of_two_links_is_sent_once(held: dict[str, Any]) -> None:
    bench = Bench("line", {**held, "at_s": 3.0, "link": 0}, links=2).until(6.0)
    healthy = Bench("line", links=2).until(6.0)
    assert bench.instrument.stats.scans_sent == healthy.instrument.stats.scans_sent


def test_a_host_does_not_wait_for_ever_for_a_reply_whose_length_was_garbled() -> None:
    bench = Bench("tcp", {"do": "replace_bytes", "at_telegram": 1, "at_byte": 6, "value": 200}).until(40.0)
    assert bench.row()["hits"] == 1
    assert bench.decoded(39.0, 40.0) == 10


def test_a_fault_that_is_not_there_cannot_be_cleared() -> None:
    bench = Bench("line").until(1.0)
    with pytest.raises(FaultError, match=r"number: 3; want none: the list is empty"):
        bench.faults.clear(3, SECOND)


def test_a_trigger_by_chance_draws_its_numbers_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []
    uniform = RandomStreams.uniform

    def counted(self: RandomStreams, term: str, sweep: int, beams: int, columns: int = 1) -> Any:
        drawn.append(term)
        return uniform(self, term, sweep, beams, columns)

    monkeypatch.setattr(RandomStreams, "uniform", counted)
    bench = Bench("line", {"do": "drop_telegram", "probability": 1e-9}).until(20.0)
    assert len(bench.sent()) > 600
    assert len(drawn) <= 4
