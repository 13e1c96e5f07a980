"""Every scan that hosts are entitled to is on account, whatever befalls those who measure, send and listen.

Slots are counted twice: by the ledger from numbers, and here by the clock.
"""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from emulator.instrument.ledger import check_accounts
from emulator.process.incidents import Incidents
from protocols.lms2xx.telegrams import request
from protocols.session import CutShort, DropReason
from tests.draws import cases
from tests.instrument.account import SECOND, Yard
from tests.protocols.ld.reader import request as service

STREAM, STOP = request(b"\x20\x24"), request(b"\x20\x25")
BAUD_500 = request(b"\x20\x48")
MEAN_OF_5, PARTIAL = request(b"\x20\x26\x05"), request(b"\x20\x2a")
PROFILES, ECHOES, CANCEL = service(0x0301, 0, 0x0100), service(0x0301, 0, 0x0700), service(0x0302)


def ended(account: dict[str, Any]) -> int:
    return account["sent"] + account["withdrawn"] + sum(account["dropped"].values())


def streaming(kind: str, device: dict[str, Any] | None = None) -> Yard:
    yard = Yard(kind, {"mode": "measure", **(device or {})} if kind == "tcp" else device)
    if kind == "line":
        host = yard.connect()
        yard.wait(3.0)
        for said in (BAUD_500, STREAM):
            host.write(said, yard.now_ns)
            yard.wait(0.2)
    elif kind == "tcp":
        yard.wait(8.0)
        host = yard.connect()
        host.write(PROFILES, yard.now_ns)
        yard.wait(0.2)
    else:
        yard.wait(1.0)
    return yard


def slots_by_the_clock(yard: Yard) -> float:
    """From the beginning of the first sweep that was asked for until now, in the time from slot to slot."""
    first = yard.measuring.plans[0]
    assert first.period_ns
    return (yard.now_ns - first.start_ns) / first.period_ns


def ahead(yard: Yard) -> float:
    """Slots that may be asked for before they begin, and the one that is going on."""
    period_ns = yard.measuring.plans[0].period_ns
    assert period_ns
    return 0.25 * SECOND / period_ns + 2


@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
@pytest.mark.parametrize("still_s", [0.0, 0.1, 1.03, 5.0])
def test_slots_of_a_stream_are_those_of_the_clock_however_late_it_is_measured(kind: str, still_s: float) -> None:
    yard = streaming(kind)
    yard.wait(2.0)
    yard.measuring.stand_still(round(still_s * SECOND))
    for _ in range(8):
        yard.wait(1.0)
        account = yard.account
        assert account["unaccounted"] == 0
        assert -1 <= account["asked"] - slots_by_the_clock(yard) <= ahead(yard)
        assert account["asked"] - account["under_way"] == ended(account)
    assert account["under_way"] <= ahead(yard)
    if still_s > 1.0:
        late = account["dropped"]["measured too late"]
        period_s = (yard.measuring.plans[0].period_ns or 0) * 1e-9
        assert late == pytest.approx(still_s / period_s, abs=3 + 0.3 / period_s)
    else:
        assert account["dropped"].get("measured too late", 0) <= 3


@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
def test_a_run_that_ends_while_nothing_is_measured_has_its_slots_on_account(kind: str) -> None:
    yard = streaming(kind)
    yard.wait(1.0)
    yard.measuring.stand_still(60 * SECOND)
    yard.wait(5.0)
    account = yard.account
    assert -1 <= account["asked"] - slots_by_the_clock(yard) <= ahead(yard)
    assert account["dropped"]["measured too late"] > 40
    assert account["unaccounted"] == 0


def test_a_host_that_stops_a_stream_that_is_not_measured_leaves_its_slots_on_account() -> None:
    for kind, stop in (("line", STOP), ("tcp", CANCEL)):
        yard = streaming(kind)
        host = yard.connect()
        yard.wait(1.0)
        before = yard.account["dropped"].get("measured too late", 0)
        yard.measuring.stand_still(4 * SECOND)
        yard.wait(3.0)
        if kind == "tcp":
            yard.loops["front"].reset_hosts()
        else:
            host.write(stop, yard.now_ns)
        yard.wait(0.1)
        asked = yard.account["asked"]
        assert -1 <= asked - slots_by_the_clock(yard) + 0.1 * 75 <= ahead(yard) + 8
        account = yard.wait(20.0).account
        assert account["dropped"]["measured too late"] - before >= 2.5 * (10 if kind == "tcp" else 37)
        assert account["asked"] == asked == ended(account), "nothing is owed after the end"
        assert account["under_way"] == 0


def test_a_host_that_asks_anew_while_nothing_is_measured_is_owed_nothing_of_the_time_between() -> None:
    yard = Yard("tcp", {"mode": "measure"})
    yard.wait(8.0)
    first, second = yard.connect(), yard.connect()
    first.write(PROFILES, yard.now_ns)
    yard.wait(1.0)
    yard.measuring.stand_still(2 * SECOND)
    yard.wait(1.03)
    first.close(yard.now_ns)
    second.write(PROFILES, yard.now_ns)  # in one step: there is no moment in which nobody wants anything
    for _ in range(6):
        assert yard.wait(1.0).account["unaccounted"] == 0


def test_a_mean_is_as_many_scans_as_were_measured_for_it() -> None:
    yard = Yard("line")
    host = yard.connect()
    yard.wait(3.0)
    for said in (BAUD_500, MEAN_OF_5):
        host.write(said, yard.now_ns)
        yard.wait(0.2)
    account = yard.wait(4.0).account
    sent = yard.instrument.stats.scans_sent
    assert sent > 20
    assert account["sent"] == 5 * sent
    assert -1 <= account["asked"] - slots_by_the_clock(yard) <= ahead(yard)
    assert account["unaccounted"] == 0


def test_scans_that_replies_push_off_the_line_are_told_as_they_pass() -> None:
    yard = streaming("line")
    host = yard.connect()
    before = yard.account
    for _ in range(200):
        host.write(request(b"\x31") * 3, yard.now_ns)
        yard.wait(0.02)
        assert yard.account["under_way"] <= ahead(yard)
    account = yard.account
    assert account["dropped"]["line slower than the scan rate"] > 50
    assert account["sent"] - before["sent"] < 100
    assert -1 <= account["asked"] - slots_by_the_clock(yard) <= ahead(yard)
    assert account["unaccounted"] == 0


INSTALL = request(b"\x20\x00SICK_LMS")
DIRECT, ONCE_DIRECT = request(bytes.fromhex("202701806901")), request(bytes.fromhex("370180B400"))
TEACH = request(bytes.fromhex("460140B40064000064" + "00" * 5))


@pytest.mark.parametrize(
    ("said", "slots"),
    [((PARTIAL,), "sent"), ((DIRECT,), "sent"), ((INSTALL, TEACH), DropReason.KEPT.value)],
    ids=["partial", "direct", "taught"],
)
def test_parts_of_scans_and_scans_for_the_device_are_a_slot_each(said: tuple[bytes, ...], slots: str) -> None:
    yard = Yard("line")
    host = yard.connect()
    yard.wait(3.0)
    for one in (BAUD_500, *said):
        host.write(one, yard.now_ns)
        yard.wait(0.2)
    for still_s in (0.0, 0.1, 1.03):
        yard.measuring.stand_still(round(still_s * SECOND))
        account = yard.wait(3.0).account
        assert account["unaccounted"] == 0
        assert account["asked"] - account["under_way"] == ended(account)
        assert -1 <= account["asked"] - slots_by_the_clock(yard) <= ahead(yard)
    assert {"sent": account["sent"], **account["dropped"]}[slots] > 60
    if slots == "sent":
        assert account["sent"] == yard.instrument.stats.scans_sent
    else:
        assert account["sent"] == yard.instrument.stats.scans_sent == 0


def test_a_scan_asked_for_by_turns_is_a_slot_for_each() -> None:
    yard = Yard("line")
    host = yard.connect()
    yard.wait(3.0)
    for _ in range(3):
        before = yard.account
        host.write(ONCE_DIRECT, yard.now_ns)
        account = yard.wait(3.0).account
        assert account["asked"] - before["asked"] == account["sent"] - before["sent"] > 1
        assert (account["unaccounted"], account["under_way"]) == (0, 0)
        assert account["sent"] == yard.instrument.stats.scans_sent


def test_a_telegram_cut_short_by_a_request_counts_as_sent() -> None:
    yard = Yard("line")
    host = yard.connect()
    yard.wait(3.0)
    host.write(STREAM, yard.now_ns)  # at 9600 baud: a telegram takes 0.76 s
    yard.wait(2.0)
    for _ in range(4):
        host.write(request(b"\x31"), yard.now_ns)
        account = yard.wait(1.3).account
        assert account["unaccounted"] == 0
        assert account["sent"] == yard.instrument.stats.scans_sent
    host.write(STOP, yard.now_ns)
    account = yard.wait(0.05).account
    assert account["asked"] == pytest.approx(slots_by_the_clock(yard), abs=ahead(yard))
    assert account["unaccounted"] == 0
    assert sum(isinstance(event, CutShort) for event in yard.instrument.take_events()) > 2


def test_a_monitor_s_copy_is_a_slot_of_its_own() -> None:
    yard = streaming("tcp")
    watching = yard.connect()
    for said in (service(0x0801, 2), service(0x0802, 1)):
        watching.write(said, yard.now_ns)
        yard.wait(0.2)
    before = yard.account
    account = yard.wait(3.0).account
    assert account["sent"] - before["sent"] == pytest.approx(60, abs=2)
    yard.measuring.stand_still(SECOND)
    yard.wait(0.5)
    watching.close(yard.now_ns)
    account = yard.wait(3.0).account
    assert account["unaccounted"] == 0
    assert account["sent"] == yard.instrument.stats.scans_sent


def test_a_profile_for_two_hosts_is_a_slot_for_each() -> None:
    yard = streaming("tcp")
    other = yard.connect()
    yard.wait(1.0)
    one = yard.account
    other.write(ECHOES, yard.now_ns)
    account = yard.wait(10.0).account
    assert account["sent"] - one["sent"] == pytest.approx(200, abs=4)
    assert account["sent"] == yard.instrument.stats.scans_sent
    yard.measuring.stand_still(2 * SECOND)
    account = yard.wait(3.0).account
    assert account["dropped"]["measured too late"] == pytest.approx(2 * 17, abs=6)
    assert account["unaccounted"] == 0


def test_telegrams_that_a_link_gives_up_are_dropped_and_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    yard = streaming("tcp")
    sent = yard.instrument.stats.scans_sent
    link = yard.link
    put = link._line.put  # type: ignore[attr-defined]
    monkeypatch.setattr(link._line, "put", lambda payload, *more: len(payload) < 100 and put(payload, *more))  # type: ignore[attr-defined]
    account = yard.wait(2.0).account
    assert account["dropped"] == {"host reads too slowly": link.stats.payloads_dropped}
    assert link.stats.payloads_dropped == pytest.approx(20, abs=1)
    assert yard.instrument.stats.scans_sent == sent == account["sent"]


def test_a_telegram_that_a_link_gives_up_later_is_taken_back() -> None:
    yard = streaming("tcp")
    before = yard.account
    send, flush, waiting = yard.link.send, yard.link.flush, []

    def take(payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        send(payload, due_ns, peer, line_speed)
        waiting.append(payload)

    def give_up(now_ns: int) -> int | None:
        while waiting:
            yard.link.on_given_up(waiting.pop())
        return flush(now_ns)

    yard.link.send, yard.link.flush = take, give_up  # type: ignore[method-assign]
    account = yard.wait(1.0).account
    assert account["sent"] == before["sent"] == yard.instrument.stats.scans_sent
    assert account["dropped"]["host reads too slowly"] == pytest.approx(10, abs=1)
    assert account["unaccounted"] == 0


@pytest.mark.parametrize("half", [0, 1])
def test_a_telegram_of_which_a_link_gives_up_one_half_is_taken_back(half: int) -> None:
    yard = streaming("line")  # 500 kBd: 508 bytes leave in one turn, the rest in the next
    before = yard.account
    send, lost = yard.link.send, []

    def take(payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        send(payload, due_ns, peer, line_speed)
        if (len(payload) == 508, 100 < len(payload) < 508)[half]:
            lost.append(payload)

    yard.link.send = take  # type: ignore[method-assign]
    yard.wait(1.0)
    yard.link.send = send  # type: ignore[method-assign]
    for payload in lost[:3]:
        yard.link.on_given_up(payload)
    assert lost
    account = yard.account
    assert account["dropped"][DropReason.HOST_SLOW.value] == 3
    assert account["sent"] == yard.instrument.stats.scans_sent > before["sent"]
    assert account["unaccounted"] == 0


def test_a_list_of_which_one_frame_finds_no_room_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    yard = streaming("can")
    put, frames = yard.wire.put, []

    def full(node: Any, peer: int, data: bytes, due_ns: int) -> bool:
        frames.append(peer)
        return not (peer == 0x60B and len(frames) % 2) and put(node, peer, data, due_ns)

    before = yard.account
    monkeypatch.setattr(yard.wire, "put", full)
    account = yard.wait(2.0).account
    lists = frames.count(0x60A)
    assert lists > 20
    assert account["dropped"] == {"line slower than the scan rate": pytest.approx(lists, abs=1)}
    assert account["sent"] == pytest.approx(before["sent"], abs=1)
    assert account["unaccounted"] == 0


@pytest.mark.unaccounted
@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
def test_a_session_that_loses_scans_without_a_word_is_told_at_the_end(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    yard = streaming(kind)
    take = yard.session.take_emissions
    taken: list[int] = []

    def lose(now_ns: int) -> list[Any]:
        found = take(now_ns)
        lost = [one for one in found if one.sweep is not None and one.sweep % 5 == 0]
        taken.extend(one.sweep for one in lost)
        return [one for one in found if one not in lost]

    monkeypatch.setattr(yard.session, "take_emissions", lose)
    yard.wait(3.0)
    monkeypatch.undo()
    yard.wait(1.0)
    assert len(taken) > 4
    assert yard.account["unaccounted"] == len(taken)
    incidents = Incidents()
    check_accounts([yard.instrument], incidents, yard.now_ns)
    (row,) = incidents.rows()
    assert (row["kind"], row["on"], incidents.exit_code) == ("scans unaccounted", "front", 5)
    assert f"{len(taken)} of " in str(row["text"])


# ---------------------------------------------------------------- whatever happens

SECONDS = st.floats(0.005, 3.0)
SAID = {
    "line": [
        *(STREAM, STOP, MEAN_OF_5, PARTIAL, BAUD_500),
        request(b"\x20\x40"),  # 38 400 baud
        *(request(b"\x30\x01"), request(b"\x30\x03\x05")),  # one scan, one mean
        *(request(b"\x3b\xb4\x00\x64\x00"), request(b"\x3b\x64\x00\x32\x00")),  # field and resolution
        *(DIRECT, ONCE_DIRECT, INSTALL, TEACH),
        *(request(b"\x10"), request(b"\x31"), b"noise"),  # reset, status
    ],
    "tcp": [
        *(PROFILES, ECHOES, CANCEL),
        service(0x0301, 3, 0x0100),  # three profiles
        *(service(0x0402), service(0x0403, 10), service(0x0403, 20), service(0x0404), service(0x0404)),
        *(service(0x0401, 0), service(0x0102), b"noise"),  # reset, status
    ],
}
FAULTS = [
    {"do": "drop_telegram", "for_s": 0.3},
    {"do": "repeat_telegram", "for_s": 0.3},
    {"do": "delay_telegram", "delay_s": 0.5, "for_s": 0.3},
    {"do": "reorder_telegrams", "for_s": 0.5},
    {"do": "slow_link", "bytes_per_s": 3000.0, "for_s": 1.0},
    {"do": "power_cycle", "off_s": 0.4},
    {"do": "reboot"},
    {"do": "hang", "for_s": 0.5},
    {"do": "unplug", "for_s": 0.5},
    {"do": "flip_bits", "for_s": 0.5},
]
ACTIONS = st.one_of(
    st.tuples(st.just("still"), SECONDS),
    st.tuples(st.just("say"), st.integers(0, 100)),
    st.tuples(st.just("say"), st.integers(0, 100)),
    st.tuples(st.just("fault"), st.sampled_from(FAULTS)),
    st.tuples(st.just("host"), st.booleans()),
)


class Guests:
    """Hosts that come, speak and go."""

    def __init__(self, yard: Yard, kind: str) -> None:
        self.yard, self.kind = yard, kind
        self.hosts = [] if kind == "can" else [yard.connect()]
        if kind == "can":
            self.node = yard.wire.join("host")

    def say(self, number: int) -> None:
        if self.kind == "can":
            output, moved = (0, 1, 2)[number % 3], number % 7 // 6
            data = bytes([0x08 | moved << 1, 0, 0, 0, output << 3, 0, 0, 0])
            self.yard.wire.put(self.node, 0x200, data, self.yard.now_ns)
        elif self.hosts:
            said = SAID[self.kind]
            self.hosts[number % len(self.hosts)].write(said[number % len(said)], self.yard.now_ns)

    def come_or_go(self, come: bool) -> None:
        if self.kind != "tcp":
            return
        if come and len(self.hosts) < 3:
            self.hosts.append(self.yard.connect())
        elif self.hosts:
            self.hosts.pop(0).close(self.yard.now_ns)


SPOILT_AND_HELD = [(0.4, ("fault", FAULTS[9])), (1.0, ("fault", FAULTS[4])), (1.0, ("host", True))]
HELD_TWICE = [(0.3, ("fault", FAULTS[4])), (0.5, ("fault", FAULTS[3])), (1.5, ("say", 87))]


@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
@settings(max_examples=cases(6))
@example(events=SPOILT_AND_HELD)
@example(events=HELD_TWICE)
@given(events=st.lists(st.tuples(st.floats(0.001, 2.0), ACTIONS), min_size=4, max_size=14))
def test_the_account_adds_up_whatever_happens(kind: str, events: list[tuple[float, tuple[str, Any]]]) -> None:
    yard = streaming(kind)
    guests = Guests(yard, kind)
    for wait_s, (what, how) in events:
        if what == "still":
            yard.measuring.stand_still(round(how * SECOND))
        elif what == "say":
            guests.say(how)
        elif what == "fault":
            yard.faults.add({"on": "front", **how}, yard.now_ns)
        else:
            guests.come_or_go(how)
        account = yard.wait(wait_s).account
        assert account["unaccounted"] == 0
        assert min(account["under_way"], account["withdrawn"], *account["dropped"].values(), 0) == 0
        assert account["sent"] >= yard.instrument.stats.scans_sent
    account = yard.wait(5.0 if kind == "can" else 15.0).account  # until those that turn run again
    assert account["unaccounted"] == 0
    assert account["under_way"] <= 2 * ahead(yard) + 20
