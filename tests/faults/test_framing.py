"""Telegrams changed on their way: what a reader of each family makes of them, on every kind of link."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest
from e2e.p01 import e2e_p01_check
from e2e.p05 import e2e_p05_check

from protocols.can_objects.e2e import Protection
from protocols.can_objects.framing import CanFraming
from protocols.can_objects.layout import load
from protocols.framing import Framing
from protocols.ld.framing import PackageFraming, SegmentFraming, UspFraming
from protocols.ld.packages import Package, PackageReader, encode_packages
from protocols.ld.segments import SegmentJoiner, encode_segments
from protocols.ld.telegrams import payload_of
from protocols.ld.usp import UspReader, encode_frame
from protocols.lms2xx.framing import Lms2xxFraming
from protocols.lms2xx.telegrams import open_frame
from protocols.session import DropReason, Emission
from protocols.skeleton.receiving import Fault

PROFILE = payload_of(0x8301, 0x0103, 1, 41, 7, *range(200))
"A profile with both counters: PROFILESENT 41, PROFILECOUNT 7."
# the first telegram of the vendor's listing with an answer: 06 A0 00 10 16 0A is ACK, then A0 (listing, 20h)
LMS_REPLY = bytes.fromhex("0280 0300 a000 10 160a")


def sent(payload: bytes, label: str = "") -> Emission:
    return Emission(0, payload, label=label)


def test_lms_fields_change_and_the_crc_is_right_again() -> None:
    framing = Lms2xxFraming()
    assert open_frame(LMS_REPLY) is not None, "published bytes"
    for changed in (
        framing.with_type(sent(LMS_REPLY), 0x92),
        framing.with_address(sent(LMS_REPLY), 3),
        framing.with_length(sent(LMS_REPLY), 1),
    ):
        assert changed is not None
        assert open_frame(changed) is not None
        assert changed[:-2] != LMS_REPLY[:-2]
    wrong = framing.bad_check(sent(LMS_REPLY))
    assert wrong is not None
    assert open_frame(wrong) is None
    assert wrong[:-1] == LMS_REPLY[:-1]


@pytest.mark.parametrize("framing", [Lms2xxFraming(), UspFraming(), PackageFraming(), SegmentFraming()])
@pytest.mark.parametrize("payload", [b"", b"\x06", b"\x15", b"\x02", b"\x02USP", bytes(3), b"\xff" * 9])
def test_what_has_no_such_field_stays_as_it_is(framing: Framing, payload: bytes) -> None:
    one = sent(payload)
    changes: list[Callable[[], bytes | None]] = [
        lambda: framing.bad_check(one),
        lambda: framing.with_counter(one, 1),
        lambda: framing.with_type(one, 1),
        lambda: framing.with_address(one, 1),
        lambda: framing.stale(one, one),
    ]
    for change in changes:
        found = change()
        assert found is None or len(found) == len(payload)


def tried(framing: Framing, one: Emission, whole: Emission) -> None:
    """Every change of a telegram, whatever another fault has made of it: its length stays, or nothing is changed."""
    found = [framing.bad_check(one), framing.bad_e2e_check(one), framing.stale(whole, one), framing.stale(one, whole)]
    for change in (1, -7, 65_535):
        found += [framing.with_length(one, change), framing.with_counter(one, change)]
        found += [framing.with_e2e_counter(one, change)]
    found += [framing.with_type(one, 0x92), framing.with_address(one, 0xFFFF)]
    found += [framing.with_signal(one, name, 2**64 - 1) for name in framing.signals(one.label)]
    framing.e2e_counter(one)
    framing.is_whole(one.payload)
    framing.to_be_refused(one.payload)
    assert {len(payload) for payload in found if payload is not None} <= {len(one.payload), len(whole.payload)}


@pytest.mark.parametrize(
    ("framing", "telegram"),
    [
        (Lms2xxFraming(), LMS_REPLY),
        (UspFraming(), encode_frame(PROFILE)),
        (PackageFraming(), encode_packages(PROFILE, 0x1410)),
        (SegmentFraming(), b"".join(encode_segments(PROFILE, 0x0220))),
    ],
    ids=["lms2xx", "usp", "package", "segment"],
)
def test_a_telegram_that_another_fault_has_cut_or_flipped_is_borne(framing: Framing, telegram: bytes) -> None:
    whole = sent(telegram)
    for length in range(len(telegram) + 1):
        tried(framing, sent(telegram[:length]), whole)
        tried(framing, sent(telegram[length:]), whole)
    for bit in range(8 * min(len(telegram), 40)):
        flipped = bytearray(telegram)
        flipped[bit // 8] ^= 1 << bit % 8
        tried(framing, sent(bytes(flipped)), whole)


@pytest.mark.parametrize("name", ["ars408", "ldmrs", "esr", "leddar_vu8", "leddar_m16"])
def test_a_frame_that_another_fault_has_cut_is_borne(name: str) -> None:
    layout = load(f"{name}.dbc")
    e2e = {"profile": "p05", "messages": {"ObjListHeader": {"data_id": 1, "offset_bytes": 4}}}
    framing = CanFraming(layout, Protection(e2e, layout) if name == "ars408" else None)
    for label in layout.messages:
        for length in range(9):
            tried(framing, sent(bytes(length), label), sent(bytes(8), label))


def message(payload: bytes) -> bytes:
    """The message in an LD's frame on TCP, checks held."""
    (found,) = UspReader(10_000).feed(payload)
    assert isinstance(found, bytes)
    return found


def test_usp_counters_types_and_stale_profiles() -> None:
    framing, one = UspFraming(), sent(encode_frame(PROFILE))
    counted = message(framing.with_counter(one, 5) or b"")
    assert (counted[6:8], counted[8:10]) == (b"\0\x2e", b"\0\x0c")
    assert counted[10:] == PROFILE[10:]
    assert message(framing.with_type(one, 0x8302) or b"")[:2] == b"\x83\x02"
    old = sent(encode_frame(payload_of(0x8301, 0x0103, 1, 1, 1, *range(1, 201))))
    stale = message(framing.stale(old, one) or b"")
    assert (stale[:10], stale[10:12]) == (PROFILE[:10], b"\0\x01"), "its counters, the old values"
    assert isinstance(UspReader(10_000).feed(framing.bad_check(one) or b"")[0], Fault)


def test_packages_on_a_serial_line() -> None:
    framing = PackageFraming()
    # COMTEST: the vendor's own example, a package with its CRC
    published = PackageReader().feed(b"\x02141000040000020200012BBC\x03")
    assert published == [Package(0x1410, bytes.fromhex("000002020001"))]
    short, long = sent(encode_packages(payload_of(0x8102, 0, 1), 0x1014)), sent(encode_packages(PROFILE, 0x1014))
    (typed,) = PackageReader().feed(framing.with_type(short, 0x8103) or b"")
    assert typed == Package(0x1014, b"\0\0" + payload_of(0x8103, 0, 1))
    (moved,) = PackageReader().feed(framing.with_address(short, 0x2014) or b"")
    assert isinstance(moved, Package)
    assert moved.address == 0x2014
    first, second = PackageReader().feed(framing.with_counter(long, 5) or b"")
    assert isinstance(first, Package)
    assert first.body[10:14] == b"\0\x2e\0\x0c"
    assert isinstance(second, Package)
    (wrong,) = PackageReader().feed(framing.bad_check(short) or b"")
    assert isinstance(wrong, Fault)
    assert wrong.reason is DropReason.BAD_CHECKSUM
    (longer,) = PackageReader().feed(framing.with_length(short, 3) or b"")
    assert isinstance(longer, Fault)
    assert longer.reason is DropReason.BAD_LENGTH
    (refused,) = PackageReader().feed(framing.to_be_refused(short.payload) or b"")
    assert isinstance(refused, Fault)
    assert refused.whole, "the device answers such a package with NAK"


def test_segments_on_can() -> None:
    framing = SegmentFraming()
    frames = encode_segments(PROFILE, 3)
    (single,) = encode_segments(payload_of(0x8102, 1), 3)
    joiner = SegmentJoiner()
    assert joiner.add(framing.with_type(sent(single), 0x8103) or b"") == (3, payload_of(0x8103, 1))
    assert joiner.add(framing.with_address(sent(single), 9) or b"") == (9, payload_of(0x8102, 1))
    joiner.add(frames[0])
    out_of_turn = joiner.add(framing.with_counter(sent(frames[1]), 1) or b"")
    assert isinstance(out_of_turn, Fault)
    longer = framing.with_length(sent(frames[0]), 2)
    assert longer is not None
    assert int.from_bytes(longer[2:4], "big") == len(frames) + 2
    assert framing.with_length(sent(frames[1]), 2) is None


@pytest.mark.parametrize(
    ("profile", "check"),
    [
        ("p01", lambda data: e2e_p01_check(bytearray(data), data_id=0x1234, offset=4)),
        ("p05", lambda data: e2e_p05_check(bytearray(data), data_id=0x1234, offset=4)),
    ],
)
def test_can_protection_is_right_or_wrong_on_purpose(profile: str, check: Callable[[bytes], bool]) -> None:
    layout = load("ars408.dbc")
    table = {"profile": profile, "messages": {"ObjListHeader": {"data_id": 0x1234, "offset_bytes": 4}}}
    protection = Protection(table, layout)
    framing = CanFraming(layout, protection)
    frames = [sent(protection.protect("ObjListHeader", bytes((3, 0, 7, 0))), "ObjListHeader") for _ in range(40)]
    for before, one in pairwise(frames):
        for change in (1, 5, -1):
            changed = framing.with_e2e_counter(one, change)
            assert changed is not None
            assert check(changed)
            assert changed[:4] == one.payload[:4]
        assert framing.with_e2e_counter(one, -1) == before.payload
        counted = framing.with_counter(one, 9)
        assert counted is not None
        assert check(counted)
        assert layout.decode("ObjListHeader", counted)["MeasCounter"] == 7 + 9
        assert framing.e2e_counter(sent(counted, "ObjListHeader")) == framing.e2e_counter(one), "it counts on as it did"
        wrong = framing.bad_e2e_check(one)
        assert wrong is not None
        assert not check(wrong)
    assert framing.with_e2e_counter(sent(bytes(8), "ObjGeneral"), 1) is None


def test_signals_are_put_where_the_dbc_has_them() -> None:
    layout = load("ars408.dbc")
    framing = CanFraming(layout, None)
    payload = layout["ObjGeneral"].frame(raw={"ObjId": 5}, DistLong=33.4, DistLat=-2.0)
    changed = framing.with_signal(sent(payload, "ObjGeneral"), "DistLong", framing.all_ones("ObjGeneral", "DistLong"))
    assert changed is not None
    before, after = layout.decode("ObjGeneral", payload), layout.decode("ObjGeneral", changed)
    assert {name for name in before if before[name] != after[name]} == {"DistLong"}
    assert framing.with_signal(sent(payload, "ObjGeneral"), "NoSuch", 1) is None


@pytest.mark.parametrize("name", ["ars408", "ldmrs", "esr"])
def test_every_format_that_counts_lists_has_its_counter_changed(name: str) -> None:
    layout = load(f"{name}.dbc")
    framing = CanFraming(layout, None)
    reported = {"ars408": "ObjListHeader", "ldmrs": "ListHeader", "esr": "Status1"}[name]
    assert framing.with_counter(sent(bytes(8), reported), 5) not in (None, bytes(8))
