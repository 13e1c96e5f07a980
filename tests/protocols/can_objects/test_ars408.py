"""ARS408-21: the worked list of the maker's tables, and how the device behaves over time.

The worked frames were computed by shift arithmetic and by cantools from the tables that decode the 38 s recording in
AbdelmoutalibDOUADI/ars408_driver (docs and CAN_Recording); unmodified classes of tier4/ars408_driver and
nacayu/ARS_408_ROS_Toolkit read the same values from them. `B9 1F 40 00 08 8C 01 00` is Apollo's front radar default.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from protocols.can_frame import frame_bits
from protocols.can_objects.ars408_lists import (
    ANGLE_RMS_DEG,
    LINEAR_RMS,
    object_list,
    probability_codes,
    rms_codes,
)
from protocols.can_objects.layout import load
from protocols.can_objects.table import ObjectTable
from protocols.session import Address, CommandHandled, Dropped, DropReason, LinkKind, ModeChanged
from tests.protocols.can_objects.rig import BOOT_NS, MS, SECOND, crowd, decoded, line, lines, lists, start, thing

WORKED_LIST = """
60A 03 04 B0 10
60B 07 50 13 F6 7D A0 00 99
60B 13 53 B4 10 80 5F C0 A8
60B 03 57 33 E0 72 60 01 79
60C 07 63 DD 39 D6 C0 E8
60C 13 63 DD 39 D6 C0 E8
60C 03 63 DD 39 D6 C0 64
60D 07 76 CF A1 70 80 16 09
60D 13 7D 10 E2 6E 00 2D 0D
60D 03 7D 0F A0 70 80 03 03
""".split("\n")[1:-1]

EGO = "300 42 B6", "301 7F 06"
"Forward 13.88 m/s, -2.5 deg/s."
APOLLO = "200 B9 1F 40 00 08 8C 01 00"


def worked_table() -> ObjectTable:
    known: dict[str, Any] = {
        "position_std_m": (0.105, 0.224),
        "velocity_std_m_s": (0.174, 0.616),
        "acceleration_std_m_s2": (0.616, 1.023),
        "yaw_std_rad": math.radians(10.971 - 1e-9),
    }
    return ObjectTable.of(
        [
            thing(
                1, 12.4, -1.8, velocity_m_s=(-2.5, 0, 0), acceleration_m_s2=(-0.5, 0), size_m=(4.4, 1.8, 1.5), **known
            ),
            thing(
                2,
                35.6,
                3.4,
                velocity_m_s=(0.25, -0.5, 0),
                acceleration_m_s2=(0, 0.2),
                size_m=(9.0, 2.6, 3.0),
                yaw_rad=math.radians(-4),
                category="truck",
                **known,
            ),
            thing(
                3,
                58.0,
                -6.2,
                velocity_m_s=(-13.75, 0, 0),
                size_m=(0.6, 0.6, 1.0),
                category="point",
                existence=0.7,
                **known,
            ),
        ]
    )


def test_the_worked_list_comes_out_byte_for_byte() -> None:
    frames = object_list(
        load("ars408.dbc"),
        0,
        worked_table(),
        np.array([7, 19, 3]),
        np.array([False, False, True]),
        np.array([0, 0, 1]),
        counter=1200,
        interface_version=1,
        rcs_dbm2=np.array([12.5, 20.0, -3.5]),
        quality=True,
        extended=True,
        region_bits=None,
    )
    assert [f"{f.identifier:03X} {f.payload.hex(' ').upper()}" for f in frames] == WORKED_LIST


def test_start_up_is_silence_then_state_and_version_then_lists() -> None:
    rig = start({"format": "ars408"}, crowd(2))
    assert rig.session.take_emissions(BOOT_NS - 1) == []
    sent = rig.run(0.1)
    assert lines(sent[:2]) == ["201 40 1F 40 00 10 F4 00 00", "700 04 1E 02 00"]
    assert [emission.label for emission in sent[2:]] == ["ObjListHeader"] + ["ObjGeneral"] * 2 + ["ObjQuality"] * 2 + [
        "ObjExtended"
    ] * 2 + ["ObjListHeader"] + ["ObjGeneral"] * 2 + ["ObjQuality"] * 2 + ["ObjExtended"] * 2


def test_state_follows_the_ego_motion_of_the_host() -> None:
    rig = start({"format": "ars408"})
    rig.run(0.01)
    expectations = [
        ((), "201 40 1F 40 00 10 F4 00 00"),
        (EGO[:1], "201 40 1F 40 00 10 B4 00 00"),
        (EGO[1:], "201 40 1F 40 00 10 74 00 00"),
        (EGO, "201 40 1F 40 00 10 34 00 00"),
    ]
    for frames, state in expectations:
        rig.run(0.6)  # whatever was heard before is stale by now
        for frame in frames:
            rig.hear(frame)
        assert rig.ask("200 00 00 00 00 00 00 00 00")[0] == state


def test_apollos_configuration_is_obeyed_and_mirrored_at_once() -> None:
    rig = start({"format": "ars408", "max_distance_m": 120, "quality": False, "extended": False, "sort": "rcs"})
    rig.run(0.5)
    assert rig.ask(APOLLO)[0] == "201 C0 1F 40 00 20 F4 00 00"  # stored; sorting is not among what it sets
    state = decoded(rig, rig.sent, "SensorState")[-1]
    assert (state["MaxDistance"], state["OutputType"], state["SendQuality"], state["SendExtended"]) == (250, 1, 1, 1)
    assert CommandHandled(rig.now_ns - 200 * MS, "SensorConfig", "done") in rig.events


def test_what_is_not_flagged_stays_as_it_is() -> None:
    rig = start({"format": "ars408"})
    rig.run(0.1)
    assert rig.ask("200 00 FF FF FF FF FE FE FF")[0] == "201 40 1F 40 00 10 F4 00 00"


def test_the_stored_configuration_survives_power_off_and_the_other_does_not() -> None:
    rig = start({"format": "ars408"})
    rig.run(0.1)
    rig.hear("200 90 00 00 00 00 80 00 00")  # quality off, stored
    rig.hear("200 20 00 00 00 00 00 00 00")  # extended off, not stored
    rig.run(0.1)
    rig.session.power_on(rig.now_ns)
    rig.run(1.0)
    state = decoded(rig, rig.sent, "SensorState")[-1]
    assert (state["SendQuality"], state["SendExtended"], state["NvmWriteOk"]) == (0, 1, 0)


@pytest.mark.parametrize(
    ("frame", "names"),
    [
        ("200 08 00 00 00 18 00 00 00", "OutputType 3"),
        ("200 04 00 00 00 E0 00 00 00", "Power 7"),
        ("200 01 00 00 00 00 00 00 00", "MaxDistance 0"),
        ("200 40 00 00 00 00 30 00 00", "SortIndex 3"),
        ("200 00 00 00 00 00 00 0F 00", "RcsThreshold 7"),
    ],
)
def test_an_unknown_value_is_left_out_and_the_state_shows_the_old_one(frame: str, names: str) -> None:
    rig = start({"format": "ars408"})
    rig.run(0.1)
    assert rig.ask(frame)[0] == "201 40 1F 40 00 10 F4 00 00"
    drop = next(event for event in rig.events if isinstance(event, Dropped))
    assert drop.reason is DropReason.BAD_ARGUMENT
    assert names in drop.detail


@pytest.mark.parametrize("sensor_id", range(8))
def test_a_sensor_id_shifts_every_identifier(sensor_id: int) -> None:
    rig = start({"format": "ars408", "sensor_id": sensor_id, "control_relay": True}, crowd(1))
    sent = rig.run(0.05)
    shift = 0x10 * sensor_id
    found = {emission.label: emission.address.peer for emission in sent if emission.address}
    assert found == {
        "SensorState": 0x201 + shift,
        "SensorVersion": 0x700 + shift,
        "RelayControl": 0x008,
        "ObjListHeader": 0x60A + shift,
        "ObjGeneral": 0x60B + shift,
        "ObjQuality": 0x60C + shift,
        "ObjExtended": 0x60D + shift,
    }
    assert rig.ask(f"{0x202 + shift:03X} 8E 00 00 03 20 00 00 00")[0] == f"{0x203 + shift:03X} 00 08"


def test_a_new_sensor_id_moves_the_answer_already_and_the_old_one_is_deaf() -> None:
    rig = start({"format": "ars408"})
    rig.run(0.1)
    assert rig.ask("200 02 00 00 00 03 00 00 00")[0].startswith("231 40 1F 40 00 13")
    assert rig.ask("200 02 00 00 00 04 00 00 00") == []
    assert rig.dropped() == [DropReason.OTHER_ADDRESS]
    assert rig.ask("230 02 00 00 00 04 00 00 00")[0].startswith("241")


def test_lists_come_every_75_ms_and_state_and_version_once_a_second() -> None:
    rig = start({"format": "ars408"}, crowd(6))
    sent = rig.run(2.9)
    headers = [emission.due_ns for emission in sent if emission.label == "ObjListHeader"]
    assert {after - before for before, after in itertools.pairwise(headers)} == {75 * MS}
    states = [emission.due_ns for emission in sent if emission.label == "SensorState"]
    assert [round((due - BOOT_NS) / SECOND) for due in states] == [0, 1, 2]
    versions = [emission.due_ns for emission in sent if emission.label == "SensorVersion"]
    state_ns = [round(frame_bits(0x201, e.payload) * 2000) for e in sent if e.label == "SensorState"]
    assert [version - state for state, version in zip(states, versions, strict=True)] == state_ns


def test_frames_of_a_list_follow_each_other_as_the_bus_carries_them() -> None:
    rig = start({"format": "ars408"}, crowd(6))
    frames = lists(rig.run(0.1))[0]
    for before, after in itertools.pairwise(frames):
        assert before.address is not None
        assert after.due_ns - before.due_ns == frame_bits(before.address.peer, before.payload) * 2000
    # recorded: a list of six objects takes 4.6 ms
    assert frames[-1].due_ns + 250_000 - frames[0].due_ns == pytest.approx(4.6 * MS, rel=0.05)


def test_cyclic_frames_never_split_a_list() -> None:
    rig = start({"format": "ars408", "cycle_ms": 20}, crowd(20))
    labels = [emission.label for emission in rig.run(3.9)]
    inside = "ObjListHeader ObjGeneral ObjQuality ObjExtended".split()
    for index, label in enumerate(labels):
        if label == "SensorState":
            assert index == 0 or labels[index - 1] == "ObjExtended"
            assert labels[index + 1] == "SensorVersion"
    assert set(labels) == {*inside, "SensorState", "SensorVersion"}


def test_a_full_bus_lengthens_the_period_and_loses_no_list() -> None:
    rig = start({"format": "ars408", "cycle_ms": 40}, crowd(100))
    found = lists(rig.run(5.0))
    assert all(len(frames) == 301 for frames in found[:-1])
    counters = [int.from_bytes(frames[0].payload[1:3], "big") for frames in found]
    assert counters == list(range(0, 2 * len(found), 2))
    starts = [frames[0].due_ns for frames in found]
    ends = [frames[-1].due_ns for frames in found]
    assert all(end < start for end, start in zip(ends, starts[1:], strict=False))
    assert rig.dropped() == []
    # no pause but for the longest frame itself and, once a second, state and version
    assert all(start - end < 1 * MS for end, start in zip(ends, starts[1:], strict=False))


def test_the_counter_wraps_and_steps_as_set() -> None:
    rig = start({"format": "ars408", "counter_step": 30000})
    headers = decoded(rig, rig.run(0.3), "ObjListHeader")
    assert [header["MeasCounter"] for header in headers] == [0, 30000, 60000, 24464]


def test_an_empty_list_is_a_header_alone() -> None:
    rig = start({"format": "ars408"})
    assert lines(lists(rig.run(0.1))[0]) == ["60A 00 00 00 10"]


def test_of_more_than_a_hundred_objects_the_nearest_are_listed_nearest_first() -> None:
    rig = start({"format": "ars408", "cycle_ms": 200}, crowd(120))
    frames = lists(rig.run(0.3))[0]
    general = decoded(rig, frames, "ObjGeneral")
    distances = [math.hypot(item["DistLong"], item["DistLat"]) for item in general]
    assert len(distances) == 100
    assert max(distances) < 206.0
    assert all(after > before - 0.3 for before, after in itertools.pairwise(distances))
    for name in ("ObjQuality", "ObjExtended"):
        assert [item["ObjId"] for item in decoded(rig, frames, name)] == [item["ObjId"] for item in general]


def test_beyond_256_tracks_the_nearest_have_numbers_and_the_rest_wait() -> None:
    objects = tuple(thing(k, 10.0 + 0.1 * k, 0.0) for k in range(300))
    rig = start({"format": "ars408", "cycle_ms": 200}, objects)
    general = decoded(rig, lists(rig.run(0.3))[0], "ObjGeneral")
    assert [item["ObjId"] for item in general] == list(range(100))


def test_unsorted_lists_are_in_the_order_of_numbers() -> None:
    def moving(now_ns: int) -> list[Any]:
        swapped = now_ns > BOOT_NS + 80 * MS
        return [thing(1, 40.0 if swapped else 10.0, 0), thing(2, 10.0 if swapped else 40.0, 0)]

    rig = start({"format": "ars408", "sort": "unsorted"}, moving)
    found = lists(rig.run(0.35))
    assert [[item["ObjId"] for item in decoded(rig, frames, "ObjGeneral")] for frames in found[:4]] == [[0, 1]] * 4


def test_objects_beyond_the_maximum_distance_are_left_out() -> None:
    rig = start({"format": "ars408", "max_distance_m": 50}, [thing(1, 49.9, 0), thing(2, 49.9, 5.0), thing(3, 51.0, 0)])
    assert [item["DistLat"] for item in decoded(rig, lists(rig.run(0.1))[0], "ObjGeneral")] == [
        pytest.approx(0.0, abs=1e-9)
    ]


def test_a_new_object_is_new_once_then_measured_then_predicted_and_its_number_is_used_again() -> None:
    def life(now_ns: int) -> list[Any]:
        k = (now_ns - BOOT_NS) // (75 * MS)
        first = [] if k >= 5 else [thing(1, 20.0, 0.0, coasting_s=max(0, k - 2) * 0.075, existence=0.7)]
        second = [thing(2, 30.0, 0.0)] if k >= 6 else []
        return first + second

    rig = start({"format": "ars408"}, life)
    states = [
        [(int(q["ObjId"]), int(q["MeasState"])) for q in decoded(rig, frames, "ObjQuality")]
        for frames in lists(rig.run(0.6))[:8]
    ]
    assert states == [[(0, 1)], [(0, 2)], [(0, 2)], [(0, 3)], [(0, 3)], [], [(0, 1)], [(0, 2)]]


def test_quality_and_extended_frames_can_be_switched_off_while_running() -> None:
    rig = start({"format": "ars408"}, crowd(3))
    rig.run(0.2)
    rig.hear("200 30 00 00 00 00 00 00 00")
    labels = {emission.label for frames in lists(rig.run(0.3))[1:] for emission in frames}
    assert labels == {"ObjListHeader", "ObjGeneral"}


def test_output_none_silences_lists_but_not_the_state_and_objects_start_them_again() -> None:
    rig = start({"format": "ars408"}, crowd(3))
    rig.run(0.2)
    rig.hear("200 08 00 00 00 00 00 00 00")
    rig.run(0.1)
    labels = {emission.label for emission in rig.run(2.0)}
    assert labels == {"SensorState", "SensorVersion"}
    assert rig.session.next_plan() is None
    rig.hear("200 08 00 00 00 08 00 00 00")
    assert len(lists(rig.run(0.3))) >= 4
    modes = [event.mode for event in rig.events if isinstance(event, ModeChanged)]
    assert modes == ["output none", "output objects"]


def test_a_cluster_list_counts_near_and_far_and_leaves_predicted_objects_out() -> None:
    objects = [thing(1, 20.0, 0.0), thing(2, 100.0, 3.0), thing(3, 30.0, 0.0, coasting_s=0.2), thing(4, 71.0, 0.0)]
    rig = start({"format": "ars408", "output": "clusters"}, objects)
    frames = lists(rig.run(0.1), "ClusterListHeader")[0]
    # the rear of the car at 71 m is at 68.8 m
    assert lines(frames[:1]) == ["600 02 01 00 00 10"]
    assert [emission.label for emission in frames] == ["ClusterListHeader"] + ["ClusterGeneral"] * 3 + [
        "ClusterQuality"
    ] * 3
    general = decoded(rig, frames, "ClusterGeneral")
    assert [item["ClusterId"] for item in general] == [0, 1, 2]
    assert [item["DistLong"] for item in general] == pytest.approx([17.8, 68.8, 97.8])


@pytest.mark.parametrize(
    ("velocity", "before", "code"),
    [
        ((-13.88, 0.0, 0.0), None, 1),  # stands, has stood since it was seen
        ((0.0, 0.0, 0.0), None, 0),  # moves along
        ((-27.76, 0.0, 0.0), None, 2),  # comes towards us
        ((-13.88, 5.0, 0.0), None, 6),  # crosses
        ((-13.88, 0.0, 0.0), (0.0, 0.0, 0.0), 7),  # stands, has moved
        ((-13.88, 0.0, 0.0), (-13.88, 5.0, 0.0), 5),  # stands, has crossed
    ],
)
def test_motion_is_told_relative_to_the_ground(velocity: Any, before: Any, code: int) -> None:
    def objects(now_ns: int) -> list[Any]:
        early = now_ns < BOOT_NS + 200 * MS
        return [thing(1, 30.0, 0.0, velocity_m_s=before if early and before else velocity, age_s=2.0)]

    rig = start({"format": "ars408"}, objects)
    for _ in range(5):
        rig.hear("300 42 B6")
        rig.hear("301 80 00")
        rig.run(0.1)
    assert decoded(rig, rig.sent, "ObjGeneral")[-1]["DynProp"] == code


def test_a_young_standing_object_is_only_a_candidate_and_without_ego_motion_nothing_is_known() -> None:
    rig = start({"format": "ars408"}, [thing(1, 30.0, 0.0, age_s=0.1)])
    assert decoded(rig, rig.run(0.1), "ObjGeneral")[0]["DynProp"] == 4
    rig.hear("300 00 00")
    rig.hear("301 80 00")
    assert decoded(rig, rig.run(0.1), "ObjGeneral")[-1]["DynProp"] == 3


def test_a_turning_car_sees_a_post_as_standing() -> None:
    # at 2 m/s and 0.5 rad/s to the left, a post at (10, 4) moves with (-2 + 0.5 * 4, -0.5 * 10) relative to us
    rig = start({"format": "ars408"}, [thing(1, 10.0, 4.0, velocity_m_s=(0.0, -5.0, 0.0), age_s=2.0)])
    rig.run(0.01)
    rig.hear("300 40 64")
    rig.hear(f"301 {round(32768 + math.degrees(0.5) * 100):04X}")
    assert decoded(rig, rig.run(0.2), "ObjGeneral")[-1]["DynProp"] == 1


def test_deviation_codes_are_the_bounds_that_the_layout_names() -> None:
    choices = load("ars408.dbc")._database.get_message_by_name("ObjQuality")
    for signal, bounds, unit in (("DistLongRms", LINEAR_RMS, "m"), ("OrientRms", ANGLE_RMS_DEG, "deg")):
        names = choices.get_signal_by_name(signal).choices
        assert [str(names[code]) for code in range(31)] == [
            f"le_{bound:g}_{unit}".replace(".", "p") for bound in bounds
        ]
    deviations = np.array([0.0, 0.005, 0.0051, 9.9, 10.0, 10.1, np.nan])
    assert rms_codes(deviations).tolist() == [0, 0, 1, 30, 30, 31, 31]


def test_existence_codes_follow_the_maker_s_classes() -> None:
    probabilities = np.array([0.0, 0.2499, 0.25, 0.6, 0.75, 0.9, 0.989, 0.99, 0.999, 1.0])
    assert probability_codes(probabilities).tolist() == [1, 1, 2, 3, 4, 5, 5, 6, 7, 7]


def test_objects_that_are_not_finite_are_left_out_and_extreme_ones_saturate() -> None:
    nan = float("nan")
    objects = [thing(1, nan, 0.0), thing(2, 20.0, 0.0, velocity_m_s=(1e9, -1e9, 0.0), size_m=(1e3, 1e3, 1.0))]
    rig = start({"format": "ars408"}, objects)
    frames = lists(rig.run(0.1))[0]
    general, extended = decoded(rig, frames, "ObjGeneral"), decoded(rig, frames, "ObjExtended")
    assert [(item["VrelLong"], item["VrelLat"]) for item in general] == [(127.75, -64.0)]
    assert [(item["Length"], item["Width"]) for item in extended] == [(51.0, 51.0)]


def test_faults_of_the_scenario_show_in_the_state() -> None:
    rig = start({"format": "ars408", "errors": ["temperature", "interference"]})
    state = decoded(rig, rig.run(0.1), "SensorState")[0]
    assert (state["ErrTemperature"], state["Interference"], state["ErrVoltage"]) == (1, 1, 0)


def test_collision_regions_warn_after_their_time_and_tell_the_relay() -> None:
    rig = start({"format": "ars408", "control_relay": True}, [thing(1, 10.0, 0.0), thing(2, 30.0, 0.0)])
    rig.run(0.1)
    region = load("ars408.dbc")["CollisionRegionConfig"].frame(
        {"Activate": 1, "CoordinatesValid": 1, "RegionId": 2}, P1X=20.0, P1Y=-2.0, P2X=0.0, P2Y=2.0
    )
    answers = rig.ask(f"401 {region.hex(' ')}", 0.01)
    assert [answer[:3] for answer in answers] == ["408", "402"]
    rig.hear("400 0A 05")  # on, 0.5 s
    early = rig.run(0.3)
    assert {item["RegionBits"] for item in decoded(rig, early, "ObjWarning")} == {0}
    late = lists(rig.run(1.5))[-2]
    assert {item["ObjId"]: item["RegionBits"] for item in decoded(rig, late, "ObjWarning")} == {0: 4, 1: 0}
    regions = decoded(rig, rig.sent, "CollisionRegionState")[-1]
    assert (regions["RegionId"], regions["WarningLevel"], regions["NumObjects"]) == (2, 1, 1)
    assert (regions["P1X"], regions["P2Y"]) == pytest.approx((20.0, 2.0))
    assert decoded(rig, rig.sent, "RelayControl")[-1]["RegionBits"] == 4
    rig.hear("400 80 00")  # off, regions cleared
    assert {emission.label for emission in lists(rig.run(0.3))[-1]}.isdisjoint({"ObjWarning"})


def test_every_link_of_the_sensor_gets_every_frame_once() -> None:
    rig = start({"format": "ars408"}, crowd(2), links=2)
    sent = rig.run(0.2)
    by_link = [[line(e) for e in sent if e.address is not None and e.address.link == index] for index in (0, 1)]
    assert by_link[0] == by_link[1]
    assert len([emission for emission in sent if emission.sweep is not None]) == len(lists(sent)) // 2


def test_a_sensor_without_can_links_stays_on_its_own() -> None:
    rig = start({"format": "ars408"})
    rig.session.connected(0, Address(3, 0), LinkKind.STREAM)
    assert {emission.address.link for emission in rig.run(0.1) if emission.address} == {0}


def test_a_plan_asks_for_objects_only_and_stays_the_same_until_submitted() -> None:
    rig = start({"format": "ars408"})
    rig.session.advance(rig.now_ns)
    plan = rig.session.next_plan()
    assert plan is not None
    assert plan is rig.session.next_plan()
    assert (len(plan), plan.wants_objects, plan.start_ns, plan.duration_s) == (0, True, BOOT_NS, 0.005)


def test_power_on_counts_sweeps_and_cycles_from_the_beginning() -> None:
    rig = start({"format": "ars408"}, crowd(2))
    first = lines(rig.run(0.4))
    rig.session.power_on(rig.now_ns)
    rig.now_ns += BOOT_NS
    assert lines(rig.run(0.4)) == first
