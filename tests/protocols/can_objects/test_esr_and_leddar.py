"""Delphi ESR tracks and LeddarTech Vu8 detections: worked frames, cycle, conditions."""

from __future__ import annotations

import itertools
import math

import pytest

from protocols.can_objects.layout import load
from protocols.scan import DetectedObject
from protocols.session import DropReason
from tests.protocols.can_objects.rig import BOOT_NS, MS, crowd, decoded, line, lines, start, thing

RADIATE = "4F1 00 64 00 00 00 00 BF 2C"
"The worked command: radiate, 64 tracks, speed valid."
QUIET = "4F1 00 64 00 00 00 00 3F 2C"
VEHICLE = "4F0 14 00 00 00 00 00 00 00"
"10 m/s."


def radiating(objects: object, seconds: float = 0.5, **device: object) -> list[str]:
    rig = start({"format": "esr", **device}, objects)  # type: ignore[arg-type]
    rig.session.advance(rig.now_ns)
    rig.hear(RADIATE)
    rig.hear(VEHICLE)
    return lines(rig.run(seconds))


def test_the_worked_track_comes_out_byte_for_byte() -> None:
    target = thing(
        1,
        35.6 * math.cos(math.radians(4.2)),
        35.6 * math.sin(math.radians(4.2)),
        velocity_m_s=(-2.5 / math.cos(math.radians(4.2)) - 0.25 * math.tan(math.radians(4.2)), 0.25, 0.0),
        acceleration_m_s2=(-0.5 / math.cos(math.radians(4.2)), 0.0),
        size_m=(4.0, 2.0, 1.5),
    )
    sent = radiating([target])
    raw = {"Status": 3, "RollingCount": 1, "MedRangeMode": 2}
    values = {"LatRate": 0.25, "Angle": -4.2, "Range": 35.6, "RangeRate": -2.5, "RangeAccel": -0.5, "Width": 2.0}
    assert load("esr.dbc")["Track_01"].frame(raw, **values).hex(" ") == "04 7e b1 64 53 f6 bf 06"
    tracks = [text for text in sent if text.startswith("500")]
    # 4.2 deg to the left, seen by both scans (the worked frame says: by the long range one)
    assert tracks[3] == "500 04 7E B1 64 53 F6 FF 06"
    # new, twice new and updated, then updated
    assert [text[7:9] for text in tracks[:4]] == ["3E", "5E", "5E", "7E"]


def test_every_cycle_has_all_frames_in_order_and_fits_its_50_ms() -> None:
    rig = start({"format": "esr", "radiate": "always"}, crowd(80))
    sent = rig.run(0.5)
    peers = [emission.address.peer for emission in sent if emission.address]
    cycle = [0x4E0, 0x4E1, 0x4E2, 0x4E3, *range(0x500, 0x540), *[0x540] * 10, 0x5D0, 0x5D1, *range(0x5E4, 0x5E9)]
    assert peers[: 2 * len(cycle)] == cycle * 2
    dues = [emission.due_ns for emission in sent if emission.address and emission.address.peer == 0x4E0]
    assert {b - a for a, b in itertools.pairwise(dues)} == {50 * MS}


@pytest.mark.parametrize("said", [(), (RADIATE,), (VEHICLE,), (QUIET, VEHICLE)])
def test_without_command_and_vehicle_data_the_tracks_are_empty(said: tuple[str, ...]) -> None:
    rig = start({"format": "esr"}, crowd(5))
    rig.session.advance(rig.now_ns)
    for frame in said:
        rig.hear(frame)
    sent = rig.run(0.04)
    assert all(
        load("esr.dbc").decode("Track_01", e.payload)["Status"] == 0 for e in sent if e.label.startswith("Track_0")
    )
    assert decoded(rig, sent, "Status2")[0]["TransceiverOn"] == 0


def test_the_radar_goes_quiet_when_its_host_does() -> None:
    rig = start({"format": "esr", "host_timeout_ms": 200}, crowd(5))
    rig.session.advance(rig.now_ns)
    rig.hear(RADIATE)
    rig.hear(VEHICLE)
    rig.run(1.0)
    on = [int(item["TransceiverOn"]) for item in decoded(rig, rig.sent, "Status2")]
    assert on[:4] == [1, 1, 1, 1]
    assert on[5:] == [0] * (len(on) - 5)


def test_the_host_sets_how_many_tracks_there_are() -> None:
    rig = start({"format": "esr"}, crowd(20))
    rig.session.advance(rig.now_ns)
    rig.hear("4F1 00 64 00 00 00 00 87 2C")  # eight
    rig.hear(VEHICLE)
    sent = rig.run(0.04)
    used = [e for e in sent if 0x500 <= e.address.peer < 0x540 and e.payload[1] >> 5]  # type: ignore[union-attr]
    assert len(used) == 8
    assert decoded(rig, sent, "Status2")[0]["MaxTracksAck"] == 8


def test_a_track_keeps_its_slot_coasts_and_the_freed_slot_is_used_again() -> None:
    def life(now_ns: int) -> list[DetectedObject]:
        k = (now_ns - BOOT_NS) // (50 * MS)
        first = [thing(1, 20.0, 0.0, coasting_s=0.05 * max(0, k - 5))] if k < 8 else []
        return [*first, thing(2, 40.0, 0.0), *([thing(3, 60.0, 0.0)] if k >= 9 else [])]

    rig = start({"format": "esr", "radiate": "always"}, life)
    sent = rig.run(0.55)
    slots = [
        [int(item["Status"]) for item in decoded(rig, sent, name)] for name in ("Track_01", "Track_02", "Track_03")
    ]
    assert slots[0][:11] == [1, 2, 2, 3, 3, 3, 4, 4, 0, 1, 2]
    assert slots[1][:11] == [1, 2, 2, *[3] * 8]
    assert slots[2] == [0] * len(slots[2])


def test_motion_power_groups_seven_tracks_and_says_which_move() -> None:
    objects = [thing(k, 10.0 + k, 0.0, velocity_m_s=(0.0, 4.0 if k == 8 else 0.0, 0.0)) for k in range(9)]
    rig = start({"format": "esr", "radiate": "always", "power_db": 5.0}, objects)
    groups = decoded(rig, rig.run(0.04), "TrackMotionPower")
    assert [group["Group"] for group in groups] == list(range(10))
    assert [groups[0][f"Power{k}"] for k in range(1, 8)] == [5.0] * 7
    assert (groups[1]["Power2"], groups[1]["Moving2"], groups[1]["MovableFast2"], groups[1]["Moving1"]) == (
        5.0,
        1,
        1,
        0,
    )
    assert [groups[1][f"Power{k}"] for k in range(3, 8)] == [-10.0] * 5


def test_objects_beyond_the_range_of_the_format_are_left_out() -> None:
    rig = start({"format": "esr", "radiate": "always"}, [thing(1, 205.0, 0.0), thing(2, 204.0, 0.0)])
    assert decoded(rig, rig.run(0.04), "Track_01")[0]["Range"] == pytest.approx(204.0)


# Leddar


def test_nothing_leaves_unasked_and_a_stream_is_echoed_and_sent_until_stopped() -> None:
    rig = start({"format": "leddar_vu8"}, [thing(1, 16.0, 0.0, reflectance=0.5)])
    assert rig.run(1.0) == []
    assert rig.ask("740 03 00 00 00 00 00 00 00", 0.2) == ["750 03 00 00 00 00 00 00 00"]
    assert len([e for e in rig.sent if e.label == "DetectionCount"]) == 5
    assert rig.ask("740 01", 0.2) == ["750 01 00 00 00 00 00 00 00"]
    assert rig.run(0.5) == []


def test_one_frame_is_sent_when_one_is_asked_for() -> None:
    rig = start({"format": "leddar_vu8"}, [thing(1, 16.0, 0.0, reflectance=0.5)])
    rig.run(0.1)
    for _ in range(2):
        assert rig.ask("740 02 00 00 00 00 00 00 00", 0.2) == ["750 02 00 00 00 00 00 00 00"]
    assert len([e for e in rig.sent if e.label == "DetectionCount"]) == 2


def test_the_printed_example_reads_and_packs_as_printed() -> None:
    layout = load("leddar_vu8.dbc")
    count = {"NumDetections": 8, "LightPower": 100, "Timestamp": 0x00268D41}
    assert layout["DetectionCount"].frame(count).hex(" ") == "08 64 00 00 41 8d 26 00"
    raw = {"FlagValid": 1, "Segment": 7}
    assert layout["Detection"].frame(raw, Distance=13.99, Amplitude=2.234375).hex(" ") == "77 05 8f 00 01 00 07 00"


def test_segments_come_highest_first_with_distances_along_their_middle_lines() -> None:
    rig = start(
        {"format": "leddar_vu8", "streaming": "start"}, [thing(1, 20.0, 0.0, size_m=(2.0, 6.0, 2.0), reflectance=0.5)]
    )
    sent = rig.run(0.03)
    detections = decoded(rig, sent, "Detection")
    # eight segments of 6 deg; the rear at 19 m spans 9 deg to each side
    assert [int(item["Segment"]) for item in detections] == [5, 4, 3, 2]
    near, far = 19.0, 19.0 / math.cos(math.radians(6))
    assert [item["Distance"] for item in detections] == pytest.approx([far, near, near, far], abs=0.02)
    assert detections[1]["Amplitude"] == pytest.approx(20 * 0.5 * (10 / near) ** 2, rel=0.01)


def test_the_nearest_of_two_objects_answers_and_a_predicted_one_does_not() -> None:
    objects = [thing(1, 30.0, 0.0), thing(2, 20.0, 0.0), thing(3, 10.0, 0.0, coasting_s=0.1)]
    rig = start({"format": "leddar_vu8", "streaming": "start"}, objects)
    distances = [item["Distance"] for item in decoded(rig, rig.run(0.03), "Detection")]
    assert distances == pytest.approx([17.8, 17.8], abs=0.02)


def test_multi_id_mode_counts_identifiers_up() -> None:
    rig = start({"format": "leddar_vu8"}, [thing(1, 6.0, 0.0, size_m=(2.0, 4.0, 2.0))])
    rig.run(0.1)
    rig.hear("740 03 01 00 00 00 00 00 00")
    detections = [e for e in rig.run(0.04) if e.label == "Detection"]
    assert len(detections) > 3
    assert [e.address.peer for e in detections if e.address] == [0x752 + k for k in range(len(detections))]


@pytest.mark.parametrize("function", [0, 11, 255])
def test_unknown_requests_are_refused_as_the_device_refuses(function: int) -> None:
    rig = start({"format": "leddar_vu8"})
    rig.run(0.1)
    answer = rig.ask(f"740 {function:02X} 05 01 02 03 04 05 06", 0.05)
    assert answer == [f"750 {function:02X} 05 FF FF FF FF FF FF"]
    assert rig.dropped() == [DropReason.UNKNOWN_COMMAND]


def test_an_empty_view_is_a_count_of_nothing() -> None:
    rig = start({"format": "leddar_vu8", "streaming": "start"})
    assert line(rig.run(0.03)[0]) == "751 00 64 00 00 F4 01 00 00"  # 500 ms since power-on
