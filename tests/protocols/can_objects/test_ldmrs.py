"""LD-MRS S01: the worked list, commands as the maker prints them, and lists over time.

The get and the NTP frames below are the printed examples of SICK document 8014493; the list was computed by shift
arithmetic and by cantools from its tables.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from protocols.can_objects.layout import load
from protocols.can_objects.ldmrs_lists import object_frames
from protocols.can_objects.ldmrs_parameters import PARAMETERS
from protocols.can_objects.table import ObjectTable
from protocols.scan import DetectedObject
from protocols.session import DropReason, Restarted
from tests.protocols.can_objects.rig import BOOT_NS, MS, SECOND, Rig, crowd, decoded, line, lines, lists, start, thing

EGO = "303 02 05 6C", "304 02 01 F4", "305 02 FF 88", "306 02 01 68"
"The worked ego frames: 13.88 m/s, 0.5 m/s2, -0.12 rad, 0.036 rad/s."
STANDING = "303 02 00 00", "306 02 00 00"

CAR = thing(
    1,
    25.40,
    -1.80,
    velocity_m_s=(12.5, -0.2, 0.0),
    size_m=(4.20, 1.80, 1.5),
    yaw_rad=math.radians(3.0),
    position_std_m=(0.08, 0.08),
    velocity_std_m_s=(0.30, 0.30),
    contour_m=((23.30, -2.70), (23.30, -2.10), (23.30, -1.50), (23.30, -0.90), (24.50, -0.86)),
)
WALKER = thing(
    2,
    8.00,
    3.50,
    velocity_m_s=(0.0, 1.2, 0.0),
    size_m=(0.60, 0.60, 1.8),
    category="pedestrian",
    position_std_m=(0.08, 0.08),
    velocity_std_m_s=(0.30, 0.30),
    contour_m=((7.70, 3.50),),
)


def object_lines(density: int = 2, **more: Any) -> list[list[str]]:
    table = ObjectTable.of([CAR, WALKER])
    found = object_frames(
        load("ldmrs.dbc"),
        0,
        table,
        np.array([5, 9]),
        (table.vx_m_s, table.vy_m_s),
        age_scans=np.array([30, 3]),
        prediction_scans=np.array([0, 0]),
        axis_aligned=more.get("axis_aligned", False),
        density=density,
        class_in_reserved=more.get("class_in_reserved", False),
    )
    return [[f"{frame.identifier:03X} {frame.payload.hex(' ').upper()}" for frame in group] for group in found]


def test_the_worked_objects_come_out_byte_for_byte() -> None:
    car, walker = object_lines()
    assert car == [
        "502 05 09 EC FF 4C 07 DF FE",
        "503 05 1E 00 00 08 08 1E 1E",  # we know no time offset within a list: 0, not the 12 ms of the worked frame
        "504 05 00 00 00 09 EC FF 4C",
        "505 05 01 A4 00 B4 01 2C 00",
        "506 05 05 03 00 09 1A FE F2",  # the nearest of the points is the fourth
        "507 05 00 00 0F 00 0F 00 0F",
        "507 05 01 1E 01 00 00 00 00",
    ]
    assert walker == [
        "502 09 03 20 01 5E 00 00 0C",
        "503 09 03 00 00 08 08 1E 1E",
        "504 09 00 00 00 03 20 01 5E",
        "505 09 00 3C 00 3C 00 00 00",
        "506 09 01 00 00 03 02 01 5E",
    ]


def test_the_worked_frames_around_the_objects_come_out_byte_for_byte() -> None:
    layout = load("ldmrs.dbc")
    header = {"FormatVersion": 1, "NumObjects": 2, "ViewRange": 100, "Temperature": 34, "ListCounter": 17}
    assert layout["ListHeader"].frame(header).hex(" ") == "01 02 64 22 00 11 00 00"
    time = {"NtpSeconds": 3_900_000_000, "NtpFraction": 1 << 30}
    assert layout["ListTime"].frame(time).hex(" ") == "e8 75 47 00 40 00 00 00"
    assert layout["ListTrailer"].frame({"NumMessages": 14, "ListCounter": 17}).hex(" ") == "00 0e 00 11 00 00 00 00"
    track = {"ObjId": 5, "Age": 30, "TimeOffset": 12}
    sigma = {"PosXSigma": 0.08, "PosYSigma": 0.08, "VelXSigma": 0.3, "VelYSigma": 0.3}
    assert layout["ObjTrack2"].frame(track, **sigma).hex(" ") == "05 1e 00 0c 08 08 1e 1e"


def test_a_list_is_header_time_objects_trailer_and_counts_its_messages() -> None:
    rig = start({"format": "ldmrs", "temperature_c": 34}, [CAR, WALKER])
    rig.session.advance(rig.now_ns)
    for frame in STANDING:
        rig.hear(frame)
    frames = lists(rig.run(0.05), "ListHeader")[0]
    assert [emission.label for emission in frames] == [
        "ListHeader",
        "ListTime",
        *["ObjTrack1", "ObjTrack2", "ObjClassBox1", "ObjBox2", "ContourHeader"],
        *["ObjTrack1", "ObjTrack2", "ObjClassBox1", "ObjBox2", "ContourHeader", "ContourPoints", "ContourPoints"],
        "ListTrailer",
    ]
    assert line(frames[0]) == "500 01 02 64 22 00 00 00 00"
    # nearest first; 14 frames before the trailer; one warning, no NTP time
    assert line(frames[2]) == "502 00 03 20 01 5E 00 00 0C"
    assert line(frames[-1]) == "508 00 0E 01 00 00 00 00 00"


def test_the_trailer_can_count_the_object_frames_alone() -> None:
    rig = start({"format": "ldmrs", "count_messages": "objects"}, [CAR, WALKER])
    assert decoded(rig, rig.run(0.05), "ListTrailer")[0]["NumMessages"] == 12


def test_header_and_trailer_carry_the_same_counter_and_it_wraps() -> None:
    rig = start({"format": "ldmrs", "scan_frequency_hz": 50}, [])
    sent = rig.run(5.3)
    heads = [int(item["ListCounter"]) for item in decoded(rig, sent, "ListHeader")]
    tails = [int(item["ListCounter"]) for item in decoded(rig, sent, "ListTrailer")]
    assert heads == tails == [k % 256 for k in range(len(heads))]
    assert len(heads) > 256


@pytest.mark.parametrize(("frequency_hz", "period_ms"), [(12.5, 80), (25, 40), (50, 20)])
def test_lists_come_at_the_scan_frequency(frequency_hz: float, period_ms: int) -> None:
    rig = start({"format": "ldmrs", "scan_frequency_hz": frequency_hz}, [CAR])
    dues = [emission.due_ns for emission in rig.run(0.9) if emission.label == "ListHeader"]
    assert {b - a for a, b in itertools.pairwise(dues)} == {period_ms * MS}


@pytest.mark.parametrize(
    ("ask", "answer"),
    [
        ("50A 11 00 12 10", "50B 11 00 12 10 80 00 00 00"),
        ("50A 10 00 12 10 1F 00 00 00", "50B 10 00 00 00 00 00 00 00"),
        ("50A 20 00", "50B 20 00 00 00 00 00 00 00"),
        ("50A 21 00", "50B 21 00 00 00 00 00 00 00"),
        ("50A 30 00 00 00 78 56 34 12", "50B 30 00 00 00 00 00 00 00"),
        ("50A 31 00 00 00 00 00 00 80", "50B 31 00 00 00 00 00 00 00"),
        ("50A 04 00", "50B 04 00 00 00 00 00 00 00"),
        ("50A 1A 00", "50B 1A 00 00 00 00 00 00 00"),
        ("50A 11 00 05 11", "50B 11 00 05 11 00 2D 00 00"),  # 11520 ticks a turn
        ("50A 11 00 01 11", "50B 11 00 01 11 80 F8 00 00"),  # end angle -1920
    ],
)
def test_a_command_is_answered_as_the_maker_prints_it(ask: str, answer: str) -> None:
    rig = start({"format": "ldmrs"})
    rig.run(0.1)
    assert rig.ask(ask, 0.05) == [answer]


@pytest.mark.parametrize(
    ("ask", "answer", "reason"),
    [
        ("50A 99 00", "50B 99 80 00 00 00 00 00 00", DropReason.UNKNOWN_COMMAND),
        ("50A 11 00 99 99", "50B 11 80 00 00 00 00 00 00", DropReason.BAD_ARGUMENT),
        ("50A 11 00 12 10 00 00 00 00", "50B 11 80 00 00 00 00 00 00", DropReason.BAD_LENGTH),
        ("50A 20 00 00", "50B 20 80 00 00 00 00 00 00", DropReason.BAD_LENGTH),
        ("50A 10 00 12 10 FF FF 00 00", "50B 10 80 00 00 00 00 00 00", DropReason.BAD_ARGUMENT),  # everything off
        ("50A 10 00 10 10 F1 07 00 00", "50B 10 80 00 00 00 00 00 00", DropReason.BAD_ARGUMENT),  # base id 0x7F1
        ("50A 10 00 13 10 42 00 00 00", "50B 10 80 00 00 00 00 00 00", DropReason.BAD_ARGUMENT),  # 66 objects
        ("50A 10 00 02 11 81 0C 00 00", "50B 10 80 00 00 00 00 00 00", DropReason.BAD_ARGUMENT),  # 3201 / 256 Hz
        ("50A 10 00 05 11 00 2D 00 00", "50B 10 80 00 00 00 00 00 00", DropReason.BAD_ARGUMENT),  # read only
        ("50A 10 00 00 11 80 F8 00 00", "50B 10 80 00 00 00 00 00 00", DropReason.BAD_ARGUMENT),  # start below end
    ],
)
def test_a_wrong_command_is_refused_and_warned_of_once(ask: str, answer: str, reason: DropReason) -> None:
    rig = start({"format": "ldmrs", "ntp_start_s": 0})
    rig.run(0.1)
    assert rig.ask(ask, 0.05) == [answer]
    assert rig.dropped() == [reason]
    warnings = [int(item["WarnReg2"]) for item in decoded(rig, rig.run(2.5), "ErrorsWarnings")]
    assert [value & 1 << 5 for value in warnings] == [1 << 5, 0]


@pytest.mark.parametrize("index", sorted(PARAMETERS))
def test_every_parameter_can_be_read_and_written_back_or_is_read_only(index: int) -> None:
    rig = start({"format": "ldmrs"})
    rig.run(0.1)
    low, high = index & 0xFF, index >> 8
    got = rig.ask(f"50A 11 00 {low:02X} {high:02X}", 0.01)
    assert got[0].startswith(f"50B 11 00 {low:02X} {high:02X}")
    answer = rig.ask(f"50A 10 00 {low:02X} {high:02X} {got[0][-11:]}", 0.01)
    written = "10 00" if PARAMETERS[index].writable else "10 80"
    assert answer[0][4:9] == written


def test_start_and_stop_measure_start_and_stop_the_lists() -> None:
    rig = start({"format": "ldmrs", "streaming": "command"}, [CAR])
    assert lists(rig.run(0.5), "ListHeader") == []
    rig.hear("50A 20 00")
    assert len(lists(rig.run(0.5), "ListHeader")) == 7
    rig.hear("50A 21 00")
    rig.run(0.05)
    assert lists(rig.run(0.5), "ListHeader") == []


def test_the_output_bits_switch_objects_and_warnings_off() -> None:
    rig = start({"format": "ldmrs"}, [CAR])
    rig.run(0.1)
    rig.hear("50A 10 00 12 10 40 00 00 00")
    rig.run(0.05)
    assert {emission.label for emission in rig.run(1.5)} == {"ErrorsWarnings"}
    rig.hear("50A 10 00 12 10 60 00 00 00")
    rig.run(0.01)
    assert rig.run(1.5) == []


def test_ntp_time_is_that_of_the_host_from_the_fraction_on() -> None:
    rig = start({"format": "ldmrs"}, [])
    rig.run(0.4)  # a list at 0.9 s
    rig.hear("50A 30 00 00 00 78 56 34 12")
    before = decoded(rig, rig.run(0.07), "ListTime")[-1]
    assert before["NtpSeconds"] == 0
    reported_ns = rig.now_ns
    rig.hear("50A 31 00 00 00 00 00 00 80")
    after = decoded(rig, rig.run(0.2), "ListTime")[-1]
    listed_ns = [e.due_ns for e in rig.sent if e.label == "ListHeader"][-1] - 5 * MS
    assert after["NtpSeconds"] == 0x12345678
    assert after["NtpFraction"] / 2**32 == pytest.approx(0.5 + (listed_ns - reported_ns) / SECOND, abs=1e-9)


def test_any_base_id_moves_sixteen_identifiers_and_the_ego_frames_stay() -> None:
    rig = start({"format": "ldmrs", "base_id": 0x123, "velocities": "absolute"}, [CAR])
    rig.run(0.01)
    for frame in EGO:
        rig.hear(frame)
    sent = rig.run(0.2)
    found = {emission.label: emission.address.peer for emission in sent if emission.address}
    assert found["ListHeader"] == 0x123
    assert found["ListTrailer"] == 0x12B
    assert rig.ask("12D 20 00", 0.01) == ["12E 20 00 00 00 00 00 00 00"]
    assert decoded(rig, sent, "ObjTrack1")[-1]["VelX"] == pytest.approx(12.5 + 13.88 + 0.036 * 1.8, abs=0.05)


def test_a_new_base_id_is_answered_on_the_old_one_and_lists_follow_on_the_new_one() -> None:
    rig = start({"format": "ldmrs"}, [CAR])
    rig.run(0.1)
    assert rig.ask("50A 10 00 10 10 00 06 00 00", 0.01) == ["50B 10 00 00 00 00 00 00 00"]
    assert {e.address.peer & ~0xF for e in rig.run(0.3) if e.address} == {0x600}
    assert rig.ask("60A 20 00", 0.01) == ["60B 20 00 00 00 00 00 00 00"]


def test_saved_parameters_survive_reset_and_others_do_not() -> None:
    rig = start({"format": "ldmrs"}, [CAR])
    rig.run(0.1)
    rig.ask("50A 10 00 13 10 07 00 00 00", 0.01)
    rig.ask("50A 04 00", 0.01)
    rig.ask("50A 10 00 13 10 09 00 00 00", 0.01)
    assert rig.ask("50A 00 00", 0.4) == []  # no reply to a reset, and silence while it boots
    assert sum(isinstance(event, Restarted) for event in rig.events) == 2
    rig.run(0.2)
    assert rig.ask("50A 11 00 13 10", 0.01) == ["50B 11 00 13 10 07 00 00 00"]
    rig.ask("50A 1A 00", 0.01)
    assert rig.ask("50A 11 00 13 10", 0.01) == ["50B 11 00 13 10 41 00 00 00"]


def test_without_ego_motion_velocities_are_not_valid_and_a_warning_says_so() -> None:
    rig = start({"format": "ldmrs", "ntp_start_s": 0}, [CAR])
    sent = rig.run(1.5)
    assert "502 00 09 EC FF 4C 80 08 00" in lines(sent)  # both raw 0x800
    assert decoded(rig, sent, "ErrorsWarnings")[0]["WarnReg2"] == 1 << 8


def test_without_ego_motion_relative_velocities_can_take_their_place() -> None:
    rig = start({"format": "ldmrs", "without_ego": "relative"}, [CAR])
    sent = rig.run(0.1)
    assert decoded(rig, sent, "ListHeader")[0]["VelocitiesRelative"] == 1
    assert decoded(rig, sent, "ObjTrack1")[0]["VelX"] == pytest.approx(12.5)


def test_the_worked_warning_shows_cold_and_no_time() -> None:
    rig = start({"format": "ldmrs", "temperature_c": -31}, [])
    for _ in range(4):
        rig.run(0.3)
        for frame in STANDING:
            rig.hear(frame)
    assert "50F 00 00 00 00 08 00 00 08" in lines(rig.sent)


def test_axis_aligned_boxes_hold_the_turned_ones() -> None:
    car = object_lines(axis_aligned=True)[0]
    data = bytes.fromhex(car[3][4:])
    box = load("ldmrs.dbc").decode("ObjBox2", data)
    cosine, sine = math.cos(math.radians(3)), math.sin(math.radians(3))
    assert box["BoxSizeX"] == pytest.approx(4.2 * cosine + 1.8 * sine, abs=0.005)
    assert box["BoxSizeY"] == pytest.approx(4.2 * sine + 1.8 * cosine, abs=0.005)
    assert box["BoxYaw"] == 0.0


def test_class_bytes_are_filled_only_when_asked_for() -> None:
    car, walker = object_lines(class_in_reserved=True)
    assert car[2][:15] == "504 05 05 64 1E"
    assert walker[2][:15] == "504 09 03 64 03"


@pytest.mark.parametrize(("density", "points"), [(0, 1), (1, 4), (2, 5)])
def test_contour_density_chooses_the_points(density: int, points: int) -> None:
    car, walker = object_lines(density)
    assert car[4][4:9] == f"05 {points:02X}"
    assert len(car) == 5 + -(-(points - 1) // 3)
    assert walker[4].startswith("506 09 01")


def test_a_contour_adds_up_to_the_points_without_drift() -> None:
    outline = tuple((10.0 + 0.0137 * k, 5.0 - 0.0191 * k) for k in range(200))
    rig = start({"format": "ldmrs"}, [thing(1, 11.0, 3.0, contour_m=outline)])
    frames = lists(rig.run(0.2), "ListHeader")[0]
    head = decoded(rig, frames, "ContourHeader")[0]
    assert head["NumPoints"] == 200
    x, y = head["StartX"], head["StartY"]
    walk = [(item[f"Dx{k}"], item[f"Dy{k}"]) for item in decoded(rig, frames, "ContourPoints") for k in (1, 2, 3)]
    for (dx, dy), (want_x, want_y) in zip(walk, outline[1:], strict=False):
        x, y = x + dx, y + dy
        assert abs(x - want_x) < 0.026
        assert abs(y - want_y) < 0.026
    assert walk[199:] == [(0.0, 0.0)] * (len(walk) - 199)


@pytest.mark.parametrize("outline", [((10.0, 0.0), (10.0, 5.2)), tuple((10.0, 0.01 * k) for k in range(255))])
def test_a_contour_that_does_not_fit_is_not_usable_and_starts_at_the_closest_point(outline: Any) -> None:
    rig = start({"format": "ldmrs"}, [thing(1, 11.0, 3.0, contour_m=outline)])
    frames = lists(rig.run(0.2), "ListHeader")[0]
    head = decoded(rig, frames, "ContourHeader")[0]
    assert (head["NumPoints"], head["StartX"], head["StartY"]) == (255, 10.0, 0.0)
    assert decoded(rig, frames, "ContourPoints") == []


def test_without_a_contour_the_nearest_point_of_the_box_stands_for_it() -> None:
    rig = start({"format": "ldmrs"}, [thing(1, 20.0, 0.0)])
    head = decoded(rig, rig.run(0.05), "ContourHeader")[0]
    assert (head["NumPoints"], head["StartX"], head["StartY"]) == (1, pytest.approx(17.8), 0.0)


def outlined(count: int) -> list[DetectedObject]:
    """Objects with one frame of contour points each."""
    return [replace(o, contour_m=((4.0, 0.0), (4.1, 0.3), (4.2, 0.5))) for o in crowd(count)]


def test_when_the_bus_is_full_as_many_of_the_nearest_as_fit_are_listed() -> None:
    rig = start({"format": "ldmrs"}, outlined(65))
    found = lists(rig.run(1.0), "ListHeader")[:-1]
    for frames in found:
        header = decoded(rig, frames, "ListHeader")[0]
        tracks = decoded(rig, frames, "ObjTrack1")
        assert header["NumObjects"] == len(tracks)
        assert decoded(rig, frames, "ListTrailer")[0]["NumMessages"] == len(frames) - 1
        assert max(item["PosX"] for item in tracks) == pytest.approx(5.0 + 2.0 * (len(tracks) - 1))
        # the maker's figure: some 50 objects with one contour frame each
        assert 50 <= len(tracks) < 60
    dues = [frames[0].due_ns for frames in found]
    assert {b - a for a, b in itertools.pairwise(dues)} == {80 * MS}


def test_at_25_hz_half_as_many_fit() -> None:
    rig = start({"format": "ldmrs", "scan_frequency_hz": 25}, outlined(65))
    assert 25 <= decoded(rig, rig.run(0.2), "ListHeader")[1]["NumObjects"] <= 30


def test_the_look_ahead_priority_prefers_what_is_near_along_the_road() -> None:
    objects = [thing(1, 30.0, 0.0), thing(2, 8.0, 12.0), thing(3, -2.0, 1.0), thing(4, 3.0, 20.0)]
    for priority, first in (("radial", [3, 2]), ("look_ahead", [4, 2])):
        rig = start({"format": "ldmrs", "priority": priority, "max_objects": 2}, objects)
        tracks = decoded(rig, rig.run(0.05), "ObjTrack1")
        places = {(-2.0, 1.0): 3, (8.0, 12.0): 2, (3.0, 20.0): 4, (30.0, 0.0): 1}
        assert [places[round(t["PosX"], 2), round(t["PosY"], 2)] for t in tracks] == first


def test_ages_count_scans_and_gate_the_list() -> None:
    def life(now_ns: int) -> list[DetectedObject]:
        k = (now_ns - BOOT_NS) // (80 * MS)
        return [thing(1, 20.0, 0.0, coasting_s=0.08 * max(0, k - 4))]

    rig = start({"format": "ldmrs", "min_age_scans": 3, "max_prediction_scans": 2}, life)
    ages = [
        [(int(item["Age"]), int(item["PredictionAge"])) for item in decoded(rig, frames, "ObjTrack2")]
        for frames in lists(rig.run(0.8), "ListHeader")
    ]
    assert ages[:8] == [[], [], [(3, 0)], [(4, 0)], [(5, 0)], [(6, 1)], [(7, 2)], []]


def test_ages_end_at_255() -> None:
    rig = start({"format": "ldmrs", "scan_frequency_hz": 50}, [CAR])
    assert decoded(rig, rig.run(6.0), "ObjTrack2")[-1]["Age"] == 255


def test_the_mounting_turns_objects_into_the_vehicle_s_frame() -> None:
    rig = start(
        {"format": "ldmrs", "mount_x_cm": 360, "mount_y_cm": 50, "mount_yaw_deg": 90.0, "without_ego": "relative"},
        [thing(1, 10.0, 0.0, velocity_m_s=(1.0, 0.0, 0.0), contour_m=((9.0, 0.0),))],
    )
    sent = rig.run(0.05)
    track = decoded(rig, sent, "ObjTrack1")[0]
    assert [track[name] for name in ("PosX", "PosY", "VelX", "VelY")] == pytest.approx([3.6, 10.5, 0.0, 1.0])
    head = decoded(rig, sent, "ContourHeader")[0]
    assert (head["StartX"], head["StartY"]) == pytest.approx((3.6, 9.5))
    assert decoded(rig, sent, "ObjBox2")[0]["BoxYaw"] == pytest.approx(90.0)


def test_ego_frames_of_another_version_are_not_taken() -> None:
    rig = start({"format": "ldmrs"}, [CAR])
    rig.run(0.01)
    rig.hear("303 01 00 00")
    rig.hear("304 01 00 00")
    assert rig.dropped() == [DropReason.BAD_ARGUMENT] * 2


def test_the_rig_runs_a_slow_bus_without_overrun() -> None:
    rig: Rig = start({"format": "ldmrs", "bitrate": 125_000}, crowd(65))
    headers = decoded(rig, rig.run(0.5), "ListHeader")
    assert 10 <= headers[1]["NumObjects"] <= 17
    assert rig.dropped() == []
