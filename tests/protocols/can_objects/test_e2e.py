"""AUTOSAR end-to-end protection: the library's own check accepts every protected frame, and refuses a changed one."""

from __future__ import annotations

import itertools
import sys
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import pytest

from protocols.can_objects.e2e import Protection
from protocols.can_objects.layout import MessageLayout
from protocols.errors import DeviceSettingError
from protocols.skeleton.keys import DeviceKeys
from tests.protocols.can_objects.rig import crowd, lists, start

# profile -> (message of the LD-MRS or ARS408, offset, bytes of the protected frame, place of the counter, mask)
CASES = [
    ("p01", "ldmrs", "ListTrailer", 4, 8, 5, 0x0F),
    ("p11", "ldmrs", "ListTrailer", 6, 8, 7, 0x0F),
    ("p05", "ldmrs", "ListTrailer", 4, 8, 6, 0xFF),
    ("p01", "ars408", "ObjListHeader", 4, 6, 5, 0x0F),
    ("p05", "ars408", "ObjListHeader", 5, 8, 7, 0xFF),
    ("p06", "ars408", "RelayControl", 1, 6, 5, 0xFF),
]


def protected(profile: str, name: str, message: str, offset: int, **more: Any) -> list[bytes]:
    entry = {"data_id": 0x1234, "offset_bytes": offset}
    device = {"format": name, "e2e": {"profile": profile, "messages": {message: entry}, **more}}
    if message == "RelayControl":
        device["control_relay"] = True
    rig = start(device, crowd(3))
    return [emission.payload for emission in rig.run(2.0) if emission.label == message]


@pytest.mark.parametrize(("profile", "name", "message", "offset", "length", "counter", "mask"), CASES)
def test_the_library_accepts_every_frame_and_its_counter_counts(
    profile: str, name: str, message: str, offset: int, length: int, counter: int, mask: int
) -> None:
    module = import_module(f"e2e.{profile}")
    check = getattr(module, f"e2e_{profile}_check")
    frames = protected(profile, name, message, offset)
    assert len(frames) >= 2
    for frame in frames:
        assert len(frame) == length
        assert check(bytearray(frame), 0x1234, offset=offset)
        for index in range(length):
            changed = bytearray(frame)
            changed[index] ^= 0x10
            assert not check(changed, 0x1234, offset=offset)
    counts = [frame[counter] & mask for frame in frames]
    modulus = 15 if mask == 0x0F else 256  # profiles 1 and 11 count from 0 to 14
    assert all((b - a) % modulus == 1 for a, b in itertools.pairwise(counts))


@pytest.mark.parametrize(
    ("mode", "name"), [("both", "BOTH"), ("alternating", "ALT"), ("low", "LOW"), ("nibble", "NIBBLE")]
)
def test_profile_1_takes_its_data_id_in_each_of_its_ways(mode: str, name: str) -> None:
    p01 = import_module("e2e.p01")
    frames = protected("p01", "ldmrs", "ListTrailer", 4, data_id_mode=mode)
    used = getattr(p01, f"E2E_P01_DATAID_{name}")
    assert all(p01.e2e_p01_check(bytearray(frame), 0x1234, offset=4, data_id_mode=used) for frame in frames)


def test_the_message_keeps_its_own_bytes_and_others_stay_as_they_are() -> None:
    plain = start({"format": "ldmrs"}, crowd(2)).run(0.3)
    entry = {"ListTrailer": {"data_id": 1, "offset_bytes": 4}}
    guarded = start({"format": "ldmrs", "e2e": {"profile": "p05", "messages": entry}}, crowd(2)).run(0.3)
    for before, after in zip(plain, guarded, strict=True):
        assert after.payload[:4] == before.payload[:4]
        if before.label != "ListTrailer":
            assert after.payload == before.payload


def test_counters_begin_again_at_power_on() -> None:
    entry = {"ListTrailer": {"data_id": 1, "offset_bytes": 4}}
    rig = start({"format": "ldmrs", "e2e": {"profile": "p05", "messages": entry}}, crowd(2))
    first = [frames[-1].payload for frames in lists(rig.run(0.3), "ListHeader")]
    rig.session.power_on(rig.now_ns)
    rig.now_ns += 500_000_000
    assert [frames[-1].payload for frames in lists(rig.run(0.3), "ListHeader")] == first


class Room:
    """A layout of one message of eight bytes of which only the last is used: no shipped format leaves its first two."""

    messages = ("Late",)

    def __getitem__(self, name: str) -> MessageLayout:
        return SimpleNamespace(used_bytes={7}, length=8)  # type: ignore[return-value]


def protection(table: dict[str, Any]) -> Protection:
    return Protection(table, Room())  # type: ignore[arg-type]


IDS = [(7 * k + 3) % 256 for k in range(16)]


@pytest.mark.parametrize(("entry", "ids"), [({"data_ids": IDS}, IDS), ({}, [0] * 16)])
def test_profile_2_takes_another_data_id_with_every_count(entry: dict[str, Any], ids: list[int]) -> None:
    p02 = import_module("e2e.p02")
    guard = protection({"profile": "p02", "messages": {"Late": entry}})
    frames = [guard.protect("Late", bytes(7) + bytes((k,))) for k in range(40)]
    assert [guard.counter("Late", frame) for frame in frames] == [(k + 1) % 16 for k in range(40)]
    for k, frame in enumerate(frames):
        assert frame[7] == k
        assert p02.e2e_p02_check(frame, bytes(ids), length=8)
        assert not p02.e2e_p02_check(frame, bytes(one ^ 1 for one in ids), length=8)
    # what a fault makes of the counter has the checksum of that count
    assert p02.e2e_p02_check(guard.counted("Late", frames[3], frames[3], 5), bytes(ids), length=8)
    assert guard.counter("Late", guard.counted("Late", frames[3], frames[3], 5)) == 9
    assert guard.offset("Late") == 0


def test_what_a_message_does_not_say_is_0_and_a_header_ends_with_the_frame() -> None:
    p05 = import_module("e2e.p05")
    for entry in ({}, {"data_id": 0}, {"offset_bytes": 0}):
        guard = protection({"profile": "p05", "messages": {"Late": entry}})
        assert guard.offset("Late") == 0
        assert p05.e2e_p05_check(bytearray(guard.protect("Late", bytes(8))), 0, offset=0)
    for offset, of_place in ((4, True), (5, False), (6, False)):
        table = {"profile": "p05", "messages": {"Late": {"offset_bytes": offset}}}
        if of_place:
            assert protection(table).protect("Late", b"\1" * 8)[7] == 1
        else:
            with pytest.raises(DeviceSettingError, match="that Late leaves free" if offset == 5 else "from 0 to 5"):
                protection(table)


def test_a_short_payload_is_filled_with_zeros_up_to_its_header() -> None:
    guard = protection({"profile": "p05", "messages": {"Late": {"offset_bytes": 4}}})
    frame = guard.protect("Late", b"\xff")
    assert (len(frame), frame[:4]) == (8, b"\xff\0\0\0")


def test_the_keys_are_told_with_what_they_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    reported: list[tuple[str, str, str]] = []
    finish = DeviceKeys.finish

    def finished(keys: DeviceKeys) -> None:
        reported.extend((one.name, one.default, one.meaning) for one in keys.known)
        finish(keys)

    monkeypatch.setattr(DeviceKeys, "finish", finished)
    protection({"profile": "p02", "messages": {"Late": {}}})
    protection({"profile": "p01", "messages": {"Late": {}}})
    assert reported == [
        ("profile", "", "AUTOSAR profile"),
        ("messages", "none", "message -> {data_id, offset_bytes}"),
        ("data_id_mode", "both", "how the data id enters the checksum"),
        ("offset_bytes", "0", "where the header begins"),
        ("data_ids", str([0] * 16), "one for each counter"),
        ("profile", "", "AUTOSAR profile"),
        ("messages", "none", "message -> {data_id, offset_bytes}"),
        ("data_id_mode", "both", "how the data id enters the checksum"),
        ("offset_bytes", "0", "where the header begins"),
        ("data_id", "0", "of this message"),
    ]


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "e2e.p05", None)
    with pytest.raises(DeviceSettingError) as caught:
        protection({"profile": "p05", "messages": {"Late": {}}})
    assert str(caught.value) == "e2e.profile: 'p05'; want the extra `e2e` to be installed"


LDMRS = (
    "EgoSpeed, EgoCrossAccel, EgoSteeringWheel, EgoYawRate, ListHeader, ListTime, ObjTrack1, ObjTrack2, ObjClassBox1,"
    " ObjBox2, ContourHeader, ContourPoints, ListTrailer, Command, Reply, ErrorsWarnings"
)
PROFILES = "p01 | p02 | p05 | p06 | p11"
TABLE = "a table: message name -> {data_id, offset_bytes}"


@pytest.mark.parametrize(
    ("table", "reported"),
    [
        ({"profile": "p04", "messages": {}}, f"profile: 'p04'; want {PROFILES}"),
        ({"messages": {"ListTrailer": {}}}, f"profile: None; want {PROFILES}"),
        ({"profile": "p01"}, f"messages: None; want {TABLE}"),
        ({"profile": "p01", "messages": {}}, f"messages: {{}}; want {TABLE}"),
        ({"profile": "p05", "messages": {"ListTrailer": {}}, "x": 1},
         "x: 1; want no such key; known: data_id_mode, messages, profile"),
        ({"profile": "p05", "data_id_mode": "low", "messages": {"ListTrailer": {}}}, "data_id_mode: 'low'; want both"),
    ],
)  # fmt: skip
def test_a_table_that_cannot_be_is_refused_with_what_is_allowed(table: Any, reported: str) -> None:
    with pytest.raises(DeviceSettingError) as caught:
        start({"format": "ldmrs", "e2e": table})
    assert str(caught.value) == f"e2e.{reported}"
    assert caught.value.key == "e2e." + reported.partition(":")[0]


@pytest.mark.parametrize(
    ("profile", "message", "entry", "reported"),
    [
        ("p01", "Nothing", {"data_id": 1}, f": {{'data_id': 1}}; want one of {LDMRS}"),
        ("p01", "ListTrailer", 5, ": 5; want a table {data_id, offset_bytes}"),
        ("p01", "ObjTrack1", {}, ".offset_bytes: 0; want 2 bytes that ObjTrack1 leaves free; it has none"),
        ("p05", "ListTrailer", {"offset_bytes": 3},
         ".offset_bytes: 3; want 3 bytes that ListTrailer leaves free; free bytes are [4, 5, 6, 7]"),
        ("p05", "ListTrailer", {"offset_bytes": 6}, ".offset_bytes: 6; want an integer from 0 to 5"),
        ("p05", "ListTrailer", {"offset_bytes": -1}, ".offset_bytes: -1; want an integer from 0 to 5"),
        ("p06", "ListTrailer", {"offset_bytes": 4}, ".offset_bytes: 4; want an integer from 0 to 3"),
        ("p02", "ListTrailer", {"offset_bytes": 4}, ".offset_bytes: 4; want 0: profile 2 has its header in front"),
        ("p02", "ListTrailer", {"data_ids": [1]}, ".data_ids: [1]; want 16 integers from 0 to 255"),
        ("p02", "ListTrailer", {"data_ids": [256] * 16}, f".data_ids: {[256] * 16}; want 16 integers from 0 to 255"),
        ("p05", "ListTrailer", {"data_id": 70000}, ".data_id: 70000; want an integer from 0 to 65535"),
        ("p05", "ListTrailer", {"offset": 4}, ".offset: 4; want no such key; known: data_id, offset_bytes"),
    ],
)  # fmt: skip
def test_a_message_that_cannot_be_protected_so_is_refused(
    profile: str, message: str, entry: Any, reported: str
) -> None:
    with pytest.raises(DeviceSettingError) as caught:
        start({"format": "ldmrs", "e2e": {"profile": profile, "messages": {message: entry}}})
    assert str(caught.value) == f"e2e.messages.{message}{reported}"
