"""AUTOSAR end-to-end protection: the library's own check accepts every protected frame, and refuses a changed one."""

from __future__ import annotations

import itertools
from importlib import import_module
from typing import Any

import pytest

from protocols.errors import DeviceSettingError
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


@pytest.mark.parametrize(
    ("table", "key", "allowed"),
    [
        ({"profile": "p04", "messages": {}}, "e2e.profile", "p01 | p02"),
        ({"profile": "p01"}, "e2e.messages", "a table"),
        ({"profile": "p01", "messages": {"Nothing": {}}}, "e2e.messages.Nothing", "ListHeader"),
        ({"profile": "p01", "messages": {"ListTrailer": 5}}, "e2e.messages.ListTrailer", "a table"),
        (
            {"profile": "p01", "messages": {"ObjTrack1": {"data_id": 1}}},
            "e2e.messages.ObjTrack1.offset_bytes",
            "it has none",
        ),
        (
            {"profile": "p05", "messages": {"ListTrailer": {"data_id": 1, "offset_bytes": 3}}},
            "e2e.messages.ListTrailer.offset_bytes",
            r"free bytes are \[4, 5, 6, 7\]",
        ),
        (
            {"profile": "p02", "messages": {"ListTrailer": {"offset_bytes": 4}}},
            "e2e.messages.ListTrailer.offset_bytes",
            "in front",
        ),
        (
            {"profile": "p05", "messages": {"ListTrailer": {"data_id": 70000}}},
            "e2e.messages.ListTrailer.data_id",
            "from 0 to 65535",
        ),
        ({"profile": "p05", "messages": {"ListTrailer": {"offset": 4}}}, "e2e.messages.ListTrailer.offset", "known: "),
        ({"profile": "p05", "data_id_mode": "low", "messages": {"ListTrailer": {}}}, "e2e.data_id_mode", "both"),
        ({"profile": "p05", "messages": {"ListTrailer": {}}, "extra": 1}, "e2e.extra", "no such key"),
    ],
)
def test_a_table_that_cannot_be_is_refused_with_what_is_allowed(table: Any, key: str, allowed: str) -> None:
    with pytest.raises(DeviceSettingError, match=allowed) as caught:
        start({"format": "ldmrs", "e2e": table})
    assert caught.value.key == key
