"""Every fault of telegrams, bytes, links and frames: what the host sees of it, and that nothing of it stays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import pytest

from emulator.faults.catalogue import kinds
from protocols.can_objects.layout import load
from protocols.ld.telegrams import GET_PROFILE_REPLY
from protocols.ld.usp import UspReader
from protocols.lms2xx.telegrams import open_frame, read_values
from protocols.session import CommandHandled
from tests.faults.bench import Bench, faultless

AT_S = 3.0
CLEAN = {"line": 37, "tcp": 10, "can": 130}
"Scans, on CAN frames, of a clean second at least."


@dataclass(frozen=True)
class Case:
    """A fault on a kind of link, and what must be seen of it between `AT_S` and `end_s`."""

    kind: str
    keys: dict[str, Any]
    shows: Callable[[Bench], None]
    end_s: float = 5.0
    clean_s: float = 5.6
    "From then on all is as it would be without it."
    device: dict[str, Any] = field(default_factory=dict)


def case(
    kind: str, do: str, shows: Callable[[Bench], None], end_s: float = 5.0, clean_s: float = 5.6, **keys: Any
) -> Any:
    trigger = {} if {"at_telegram", "on_command"} & keys.keys() else {"at_s": AT_S}
    return pytest.param(Case(kind, {"do": do, **trigger, **keys}, shows, end_s, clean_s), id=f"{kind}-{do}")


# ---------------------------------------------------------------- what is seen


def after(bench: Bench, label: str = "B0") -> list[bytes]:
    """Telegrams with scans, from the fault's beginning on."""
    return [one.data for one in bench.sent(AT_S, 5.0) if one.label in (label, "8301")]


def lms(data: bytes) -> Any:
    """A telegram whose CRC must be right."""
    telegram = open_frame(data)
    assert telegram is not None
    return telegram


def indices(bench: Bench) -> list[int]:
    return [read_values(lms(data)).indices[1] for data in after(bench)]  # type: ignore[union-attr,index]


def steps(numbers: list[int], modulo: int) -> Counter[int]:
    return Counter((b - a) % modulo for a, b in pairwise(numbers))


def profile_numbers(bench: Bench) -> list[int]:
    """PROFILESENT of the profiles that the host can read."""
    found = UspReader(70_000).feed(b"".join(after(bench)))
    profiles = [item for item in found if isinstance(item, bytes) and item[:2] == GET_PROFILE_REPLY.to_bytes(2, "big")]
    return [int.from_bytes(item[6:8], "big") for item in profiles]


def numbers(bench: Bench) -> tuple[list[int], int]:
    return (indices(bench), 256) if bench.sent(label="B0") else (profile_numbers(bench), 65536)


def gap_of(missing: int) -> Callable[[Bench], None]:
    def shows(bench: Bench) -> None:
        found, modulo = numbers(bench)
        before = [one for one in bench.sent(2.5, AT_S) if one.sweep is not None]
        assert len(found) > 10
        assert len(before) > 4
        assert bench.row()["taken"]["scans"] == missing
        assert set(steps(found, modulo)) == {1}, "dropped are the first ones"
        start_ns = bench.sent(AT_S)[0].start_ns - before[-1].start_ns
        assert start_ns == pytest.approx((missing + 1) * (before[-1].start_ns - before[-2].start_ns), rel=0.01)

    return shows


def stepped(*expected: int) -> Callable[[Bench], None]:
    """Steps of the counter beside those by one."""

    def shows(bench: Bench) -> None:
        found, modulo = numbers(bench)
        assert steps(found, modulo) - Counter({1: 10**6}) == Counter(step % modulo for step in expected)

    return shows


def first_is(check: Callable[[bytes], bool]) -> Callable[[Bench], None]:
    """Of the telegrams from the fault on the first one is hit, the others are not."""

    def shows(bench: Bench) -> None:
        found = after(bench)
        assert check(found[0])
        assert not any(check(data) for data in found[1:])

    return shows


def of_usp(check: Callable[[bytes], bool]) -> Callable[[Bench], None]:
    return first_is(lambda data: len(data) > 9 and check(data))


def usp_check_wrong(data: bytes) -> bool:
    return bool(UspReader(70_000).feed(data)) and not isinstance(UspReader(70_000).feed(data)[0], bytes)


def reported_length(data: bytes) -> int:
    return int.from_bytes(data[4:8], "big") - (len(data) - 9)


def late(seconds: float) -> Callable[[Bench], None]:
    def shows(bench: Bench) -> None:
        first, second = bench.sent(AT_S)[0], bench.sent(AT_S)[1]
        assert first.start_ns >= (AT_S + seconds) * 1e9
        assert second.start_ns >= first.end_ns, "what follows waits behind it"

    return shows


def silent(from_s: float, to_s: float, lost: str = "scans") -> Callable[[Bench], None]:
    def shows(bench: Bench) -> None:
        assert bench.heard_between(2.0, 3.0) if bench.kind != "can" else bench.sent(2.0, 3.0)
        assert not bench.heard_between(from_s, to_s)
        assert not (bench.kind == "can" and bench.sent(from_s, to_s))
        assert bench.row()["taken"].get(lost, 1) > 0

    return shows


def restarted(boot_text: bool) -> Callable[[Bench], None]:
    def shows(bench: Bench) -> None:
        silent(3.05, 4.9, "bytes" if bench.kind == "line" else "connections")(bench)
        assert bench.instrument.stats.restarts == 2
        if boot_text:
            assert b"\x90LMS291;" in bench.sent(label="90")[0].data
        assert "Restarted" in {type(event).__name__ for event in bench.heard.events if event.at_ns >= 3e9}

    return shows


def other_bytes(bench: Bench) -> None:
    """The host decodes one scan less than it would, and what it decodes is right."""
    clean = faultless(bench.kind, 5.0)
    assert bench.decoded(AT_S, 5.0) in (clean.decoded(AT_S, 5.0) - 1, clean.decoded(AT_S, 5.0) - 2)


def garbled(bench: Bench) -> None:
    assert bench.links[0].stats.bytes_garbled > 1000
    assert bench.decoded(3.1, 3.5) == 0


def trickles(bench: Bench) -> None:
    # the device says 27 kB/s (LMS291), 44 kB/s (LD) or 1 kB/s (CAN); half of it and less goes through
    at_most = {"line": 15_000, "tcp": 15_000, "can": 500}[bench.kind]
    assert 0.7 * at_most < sum(len(one.data) for one in bench.sent(3.1, 4.0)) / 0.9 < 1.1 * at_most


# ---------------------------------------------------------------- CAN


LAYOUT = load("ars408.dbc")
HEADER = LAYOUT.identifier("ObjListHeader")
GENERAL = LAYOUT.identifier("ObjGeneral")


def frames(bench: Bench, identifier: int, from_s: float = AT_S, to_s: float = 5.0) -> list[bytes]:
    return [one.data for one in bench.sent(from_s, to_s) if one.peer == identifier]


def list_numbers(bench: Bench) -> list[int]:
    return [int(LAYOUT.decode("ObjListHeader", data)["MeasCounter"]) for data in frames(bench, HEADER)]


def e2e_ok(data: bytes) -> bool:
    from e2e.p05 import e2e_p05_check

    return bool(e2e_p05_check(bytearray(data), data_id=0x1234, offset=4))


def e2e_counts(bench: Bench) -> list[int]:
    assert all(e2e_ok(data) for data in frames(bench, HEADER))
    return [data[6] for data in frames(bench, HEADER)]


def counts_step(*expected: int) -> Callable[[Bench], None]:
    def shows(bench: Bench) -> None:
        assert steps(e2e_counts(bench), 256) - Counter({1: 10**6}) == Counter(step % 256 for step in expected)

    return shows


def lists_step(*expected: int) -> Callable[[Bench], None]:
    def shows(bench: Bench) -> None:
        assert steps(list_numbers(bench), 65536) - Counter({1: 10**6}) == Counter(step % 65536 for step in expected)

    return shows


def general_is(check: Callable[[Bench, list[bytes]], bool]) -> Callable[[Bench], None]:
    def shows(bench: Bench) -> None:
        assert check(bench, frames(bench, GENERAL))

    return shows


def bus_off(bench: Bench) -> None:
    link: Any = bench.links[0]
    assert link.can.bus_offs == 1
    assert link.can.state == "active"
    off = [one.start_ns for one in bench.sent(2.9, 4.0)]
    longest = max(b - a for a, b in pairwise(off))
    assert 0.2e9 < longest < 0.4e9, "the pause that its firmware waits, beside that between lists"
    assert bench.row()["taken"]["scans"] >= 2


def error_passive(bench: Bench) -> None:
    link: Any = bench.links[0]
    assert link.can.bus_offs == 0
    assert link.node.error_counter == 0, "good frames have counted it down"
    assert len(list_numbers(bench)) == pytest.approx(2 / 0.075, abs=2), "each frame was sent again"


def babbled(bench: Bench) -> None:
    foreign = [one for one in bench.heard.got if one.peer == 0]
    assert foreign[0].start_ns >= AT_S * 1e9
    assert foreign[-1].start_ns < (AT_S + 0.52) * 1e9
    assert len(foreign) > 0.9 * 0.5 * 500_000 / 135
    assert len(bench.sent(3.05, 3.5)) < 5, "frames of lower priority wait"


# ---------------------------------------------------------------- the cases

FOR_1_S = {"for_s": 1.0}

TELEGRAMS = [
    case("line", "drop_telegram", gap_of(3), count=3),
    case("tcp", "drop_telegram", gap_of(3), count=3),
    case("can", "drop_telegram", lists_step(2), label="ObjListHeader", at_telegram=55),
    case("line", "repeat_telegram", stepped(0, 0), times=2),
    case("tcp", "repeat_telegram", stepped(0, 0), times=2),
    case("can", "repeat_telegram", counts_step(0), label="ObjListHeader"),
    case("line", "reorder_telegrams", stepped(-1, 2)),
    case("tcp", "reorder_telegrams", stepped(-2, 3), behind=2),
    case("can", "reorder_telegrams", lists_step(-1, 2), label="ObjListHeader"),
    case("line", "delay_telegram", late(0.2), delay_s=0.2),
    case("tcp", "delay_telegram", late(0.2), delay_s=0.2),
    case("can", "delay_telegram", late(0.2), delay_s=0.2),
    case("line", "truncate_telegram", first_is(lambda data: len(data) == 300), keep_bytes=300),
    case("tcp", "truncate_telegram", first_is(lambda data: len(data) < 1200)),
    case(
        "can",
        "truncate_telegram",
        general_is(lambda bench, found: len(found[0]) == 3),
        label="ObjGeneral",
        keep_bytes=3,
    ),
    case("line", "bad_checksum", first_is(lambda data: open_frame(data) is None and data[:4] == b"\x02\x80\xd8\x02")),
    case("tcp", "bad_checksum", of_usp(usp_check_wrong)),
    case("line", "wrong_length", first_is(lambda data: int.from_bytes(data[2:4], "little") == len(data) + 1), change=7),
    case("tcp", "wrong_length", first_is(lambda data: reported_length(data) == 7), change=7),
    case("line", "wrong_counter", stepped(-4), change=5),
    case("tcp", "wrong_counter", stepped(-4), change=5),
    case("can", "wrong_counter", lists_step(6, -4), change=5, label="ObjListHeader", at_telegram=55),
    case("line", "wrong_type", first_is(lambda data: lms(data).command == 0x92)),
    case("tcp", "wrong_type", first_is(lambda data: data[8:10] == b"\x00\x92")),
    case("line", "wrong_address", first_is(lambda data: lms(data).address == 0x85)),
    case("line", "stale_scan", stepped(), **FOR_1_S),
    case("tcp", "stale_scan", stepped(), **FOR_1_S),
    case("can", "stale_scan", lists_step(), **FOR_1_S),
]

BYTES = [
    *(case(kind, "flip_bits", other_bytes, bits=3) for kind in ("line", "tcp")),
    *(case(kind, "insert_bytes", other_bytes, number=5) for kind in ("line", "tcp")),
    *(case(kind, "delete_bytes", other_bytes, number=5) for kind in ("line", "tcp")),
    *(case(kind, "replace_bytes", other_bytes, number=5, value=0x55) for kind in ("line", "tcp")),
    case("can", "flip_bits", general_is(lambda bench, found: len(set(found)) > 3), label="ObjGeneral"),
    case("can", "replace_bytes", general_is(lambda bench, found: found[0][2:4] == b"\0\0"), number=2, value=0,
         at_byte=2, label="ObjGeneral"),
    *(case(kind, "gap", lambda bench: late_second_piece(bench), gap_s=0.2, at_byte=100) for kind in ("line", "tcp")),
    *(case(kind, "garbage", lambda bench: foreign_bytes(bench), number=64, value=0xAA) for kind in ("line", "tcp")),
    case("line", "stuck_line", lambda bench: stuck(bench), level="break", **FOR_1_S),
    *(case(kind, "line_noise", lambda bench: noisy(bench), bit_error_rate=1e-4, **FOR_1_S) for kind in ("line", "tcp")),
]  # fmt: skip

LINKS = [
    *(case(kind, "unplug", silent(3.05, 4.0), clean_s=9.0, **FOR_1_S) for kind in ("line", "tcp", "can")),
    case("line", "power_cycle", restarted(True), off_s=0.5, clean_s=12.5, end_s=6.0),
    case("tcp", "power_cycle", restarted(False), off_s=0.5, clean_s=35.0, end_s=6.0),
    case("can", "power_cycle", silent(3.01, 3.95, "bytes"), off_s=0.5, end_s=6.0, clean_s=7.0),
    case("line", "reboot", restarted(True), clean_s=12.5, end_s=6.0),
    case("tcp", "reboot", restarted(False), clean_s=35.0, end_s=6.0),
    case("can", "reboot", silent(3.01, 3.45, "bytes")),
    *(case(kind, "hang", silent(3.05, 4.0), **FOR_1_S) for kind in ("line", "tcp", "can")),
    case("tcp", "half_open", silent(3.05, 4.0), **FOR_1_S),
    *(case(kind, "slow_link", trickles, bytes_per_s=15_000, **FOR_1_S) for kind in ("line", "tcp")),
    case("can", "slow_link", trickles, bytes_per_s=500, **FOR_1_S),
    case("tcp", "reset_connections", lambda bench: came_back(bench)),
    case("tcp", "refuse_connections", lambda bench: refused(bench), **FOR_1_S),
    case("line", "wrong_baud", garbled, baud=115_200, clean_s=8.0, for_s=0.5),
]

FRAMES = [
    case("can", "bus_off", bus_off, off_s=0.2, **FOR_1_S),
    case("can", "error_passive", error_passive, **FOR_1_S),
    case("can", "e2e_counter", counts_step(4, -2), change=3, at_telegram=55, label="ObjListHeader"),
    case("can", "e2e_counter", counts_step(*[0] * 5, 7), for_s=0.5),
    case("can", "e2e_checksum", lambda bench: wrong_e2e(bench)),
    case("can", "wrong_dlc", general_is(lambda bench, found: [len(one) for one in found[:2]] == [5, 8]), data_bytes=5,
         label="ObjGeneral"),
    case("can", "missing_message", lambda bench: missing(bench), label="ObjGeneral", **FOR_1_S),
    case("can", "shifted_identifier", lambda bench: shifted(bench), label="ObjGeneral"),
    case("can", "frame_burst", general_is(lambda bench, found: found[:20] == found[:1] * 20), label="ObjGeneral"),
    case("can", "invalid_signal", lambda bench: invalid(bench), signal="DistLong"),
    case("can", "slow_rate", lists_step(*[2] * 6), for_s=1.0),
    case("can", "babbling_node", babbled, for_s=0.5),
]  # fmt: skip


def late_second_piece(bench: Bench) -> None:
    first, second = bench.sent(AT_S)[:2]
    assert (len(first.data), second.label) == (100, first.label)
    assert second.start_ns - first.start_ns == pytest.approx(0.2e9, abs=1e6)


def foreign_bytes(bench: Bench) -> None:
    assert [one.data for one in bench.sent(label="garbage")] == [b"\xaa" * 64]
    assert b"\xaa" * 64 in bench.heard_between(AT_S, 5.0)
    clean = faultless(bench.kind, 5.0)
    assert bench.decoded(AT_S, 5.0) in (clean.decoded(AT_S, 5.0), clean.decoded(AT_S, 5.0) - 1)


def stuck(bench: Bench) -> None:
    assert [one.data for one in bench.sent(3.0, 4.0)] == [b"\0"], "a break is one byte, then nothing"
    assert not bench.heard_between(3.03, 4.0)


def noisy(bench: Bench) -> None:
    clean = faultless(bench.kind, 5.0)
    ours, theirs = bench.heard_between(3.1, 4.0), clean.heard_between(3.1, 4.0)
    assert len(ours) == len(theirs)
    wrong = sum((a ^ b).bit_count() for a, b in zip(ours, theirs, strict=True)) / (8 * len(ours))
    assert 0.5e-4 < wrong < 1.5e-4


def came_back(bench: Bench) -> None:
    assert bench.row()["taken"] == {"connections": 1}
    assert bench.end.peer == 2, "the same host, another connection"
    assert bench.decoded(3.4, 5.0) > 10


def refused(bench: Bench) -> None:
    assert bench.decoded(3.0, 5.0) == 20, "who is connected stays"
    assert bench.row()["hits"] == 1


def wrong_e2e(bench: Bench) -> None:
    found = frames(bench, HEADER)
    assert [e2e_ok(data) for data in found[:3]] == [False, True, True]
    assert all(e2e_ok(data) for data in found[1:])


def missing(bench: Bench) -> None:
    assert not frames(bench, GENERAL, 3.0, 4.0)
    assert len(frames(bench, GENERAL, 4.0, 5.0)) == pytest.approx(3 / 0.075, abs=3)
    assert len(frames(bench, HEADER, 3.0, 4.0)) > 10


def shifted(bench: Bench) -> None:
    assert len(frames(bench, GENERAL + 0x10)) == 1


def invalid(bench: Bench) -> None:
    bits = load("ars408.dbc")["ObjGeneral"].signals["DistLong"]
    found = [int.from_bytes(data, "big") >> bits.shift & (1 << bits.bits) - 1 for data in frames(bench, GENERAL)]
    assert found[0] == (1 << bits.bits) - 1
    assert len(set(found[1:])) == 3, "one value for each object"


@pytest.mark.parametrize("one", [*TELEGRAMS, *BYTES, *LINKS, *FRAMES])
def test_a_fault_shows_on_the_wire_and_ends(one: Case) -> None:
    bench = Bench(one.kind, one.keys)
    bench.until(one.end_s)
    assert [event.what for event in bench.reported("begin")] == ["begin"]
    assert bench.row()["hits"] > 0
    one.shows(bench)
    bench.until(one.clean_s)
    assert bench.row()["state"] == "over"
    assert len(bench.reported("end")) == 1
    lost = bench.instrument.stats.scans_dropped.copy()
    bench.until(one.clean_s + 1.1)
    assert (len(bench.sent(one.clean_s)) if one.kind == "can" else bench.decoded(one.clean_s, 10**6)) >= CLEAN[one.kind]
    assert bench.instrument.stats.scans_dropped == lost, "nothing is lost after the end"


def test_every_fault_of_these_layers_is_tried() -> None:
    tried = {one.values[0].keys["do"] for one in (*TELEGRAMS, *BYTES, *LINKS, *FRAMES)}
    asked = {"lose_reply", "slow_reply", "refuse_command", "lose_input"}  # below: they need a host that asks
    asked |= {"device_busy", "refuse_login", "no_pps"}  # test_refusing
    asked |= {"no_ptp", "overheating", "ptc_error", "calibration_file"}  # test_hesai_faults
    # test_refusing
    asked |= {"http_unavailable", "lost_columns", "shot_limiting", "thermal_shutdown", "calibration_served_wrong"}
    known = {name for name, kind in kinds().items() if kind.layer in ("telegram", "byte", "link", "can")}
    assert tried | asked == known
    assert len(known) >= 40


# ---------------------------------------------------------------- what hosts ask


def test_a_lost_ack_is_missing_and_the_command_is_carried_out_all_the_same() -> None:
    bench = Bench("line", {"do": "lose_reply", "on_command": "20 25", "label": "ACK"}).until(3.0)
    assert bench.row()["taken"] == {"replies": 1, "bytes": 1}
    assert bench.heard_between(0.0, 0.2)[:2] == b"\x02\x80", "the reply without the ACK before it"
    assert bench.decoded(2.0, 3.0) >= 37


def test_a_lost_reply_is_asked_for_again() -> None:
    bench = Bench("tcp", {"do": "lose_reply", "on_command": "TRANS_MEASURE", "count": 1}).until(40.0)
    assert bench.row()["taken"]["replies"] == 1
    reported = [one.label for one in bench.sent(0.0, 32.0)][:4]
    assert reported == ["8102", "8403", "8102", "8404"], "lost the first time, given the second"
    assert bench.decoded(38.0, 39.0) == 10


@pytest.mark.parametrize(("kind", "label"), [("line", "A0"), ("tcp", "8404")])
def test_a_slow_reply_comes_late_by_what_was_asked(kind: str, label: str) -> None:
    keys = {"do": "slow_reply", "delay_s": 0.7, "label": label, "at_telegram": 1}
    late_ns, clean_ns = (bench.until(4.0).sent(label=label)[0].start_ns for bench in (Bench(kind, keys), Bench(kind)))
    assert late_ns - clean_ns == 700_000_000


def test_a_slow_reply_on_can() -> None:
    bench = Bench("can", {"do": "slow_reply", "at_s": 1.0, "delay_s": 0.3, "label": "SensorState"}).until(3.0)
    state = load("ars408.dbc").identifier("SensorState")
    times = [one.start_ns * 1e-9 for one in bench.sent() if one.peer == state]
    assert times[1] - times[0] == pytest.approx(1.3, abs=0.1)
    assert times[2] - times[0] == pytest.approx(2.0, abs=0.1)


def test_a_refused_command_is_answered_by_nak_and_changes_nothing() -> None:
    bench = Bench("line", {"do": "refuse_command", "at_telegram": 1}, device={"real_time_indices": False}).until(0.1)
    assert [one.data for one in bench.sent()] == [b"\x15"]
    assert not [event for event in bench.heard.events if isinstance(event, CommandHandled)]
    assert bench.instrument.stats.input_dropped["bad checksum"] > 0
    assert bench.until(8.0).decoded(7.0, 8.0) >= 37


def test_a_refused_service_is_answered_by_a_service_failure() -> None:
    bench = Bench("tcp", {"do": "refuse_command", "at_telegram": 1}).until(0.5)
    assert [one.data[8:10] for one in bench.sent()] == [b"\xff\x00"]
    assert bench.until(40.0).decoded(38.0, 39.0) == 10


@pytest.mark.parametrize(("kind", "clean_s"), [("line", 6.0), ("tcp", 35.0)])
def test_lost_input_is_counted_and_asked_again(kind: str, clean_s: float) -> None:
    bench = Bench(kind, {"do": "lose_input", "at_telegram": 1}).until(clean_s + 1.1)
    assert bench.instrument.stats.input_dropped["fault lose_input"] == bench.row()["taken"]["input bytes"] > 0
    assert bench.decoded(clean_s, clean_s + 1.1) >= CLEAN[kind]


def test_lost_input_of_a_can_device() -> None:
    bench = Bench("can", {"do": "lose_input", "at_s": 0.0})
    link: Any = bench.links[0]
    host = link.wire.join("host")
    link.wire.put(host, 0x200, bytes(8), 10**9)
    link.wire.put(host, 0x200, bytes(8), 2 * 10**9)
    bench.until(3.0)
    assert sum(isinstance(event, CommandHandled) for event in bench.heard.events) == 1


# ---------------------------------------------------------------- what hosts send


@pytest.mark.parametrize("do", ["flip_bits", "insert_bytes", "delete_bytes", "replace_bytes"])
def test_bytes_of_hosts_are_hit_on_their_way_and_the_device_says_why_it_took_nothing(do: str) -> None:
    bench = Bench("tcp", {"do": do, "direction": "from_host", "at_s": 0.0}).until(0.1)
    assert bench.row()["hits"] == 1
    assert not bench.sent(), "no reply"
    assert bench.until(35.0).instrument.stats.input_dropped.total() > 0
    assert bench.decoded(33.5, 34.5) == 10


def test_a_noisy_line_to_the_device() -> None:
    bench = Bench(
        "line", {"do": "line_noise", "direction": "from_host", "bit_error_rate": 0.2, "at_s": 0.0, "for_s": 3.0}
    )
    assert bench.until(2.9).decoded(0.0, 2.9) == 0
    assert bench.until(12.0).decoded(11.0, 12.0) >= 37
