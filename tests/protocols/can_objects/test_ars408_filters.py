"""ARS408-21: filters, their worked frames and each criterion by a pair of objects that it tells apart."""

from __future__ import annotations

from typing import Any

import pytest

from protocols.can_objects.layout import load
from protocols.scan import DetectedObject
from protocols.session import CommandHandled, DropReason
from tests.protocols.can_objects.rig import crowd, decoded, lists, start, thing

DISTANCE_0_80 = "202 8E 00 00 03 20 00 00 00"
X_MINUS_10_120 = "202 D6 09 92 0C 1C 00 00 00"
"The worked frames: objects, distance 0 to 80 m; objects, x -10 to 120 m."

STATE_DISTANCE_0_80 = "204 8C 00 00 03 20"


def command(
    index: int, low: float, high: float, *, objects: bool = True, active: bool = True, valid: bool = True
) -> str:
    names = load("ars408.dbc").alternatives("FilterConfig")[index]
    values: dict[str, float] = {"Index": index, "ForObjects": objects, "Active": active, "Valid": valid}
    data = load("ars408.dbc").encode("FilterConfig", values | dict(zip(names, (low, high), strict=True)))
    return f"202 {data.hex(' ')}"


def test_the_worked_filters_are_answered_with_the_worked_state() -> None:
    rig = start({"format": "ars408"})
    rig.run(0.1)
    assert rig.ask(DISTANCE_0_80) == ["203 00 08", STATE_DISTANCE_0_80]
    assert rig.ask(X_MINUS_10_120) == ["203 00 10", STATE_DISTANCE_0_80, "204 D4 09 92 0C 1C"]
    answer = rig.ask(command(1, 0, 100, objects=False))
    assert answer[0] == "203 08 10"  # one cluster filter, two object filters
    assert answer[2] == STATE_DISTANCE_0_80


def test_a_sender_with_five_bytes_is_understood() -> None:
    rig = start({"format": "ars408"})
    rig.run(0.1)
    assert rig.ask(DISTANCE_0_80[: len("202 8E 00 00 03 20")]) == ["203 00 08", STATE_DISTANCE_0_80]
    assert rig.ask("202 8E 00 00 03") == []
    assert rig.dropped() == [DropReason.BAD_LENGTH]


def test_a_filter_is_switched_off_again() -> None:
    rig = start({"format": "ars408"})
    rig.run(0.1)
    rig.ask(DISTANCE_0_80)
    assert rig.ask(command(1, 0, 80, active=False)) == ["203 00 00"]


def test_without_valid_nothing_changes_and_the_state_is_told() -> None:
    rig = start({"format": "ars408"})
    rig.run(0.1)
    rig.ask(DISTANCE_0_80)
    assert rig.ask(command(1, 0, 10, valid=False)) == ["203 00 08", STATE_DISTANCE_0_80]
    assert rig.dropped() == []
    assert [e.outcome for e in rig.events if isinstance(e, CommandHandled)] == ["done", "Valid is 0: nothing changed"]


def test_an_object_criterion_is_refused_for_clusters() -> None:
    rig = start({"format": "ars408"})
    rig.run(0.1)
    assert rig.ask(command(9, -5, 5, objects=False)) == ["203 00 00"]
    assert rig.dropped() == [DropReason.BAD_ARGUMENT]


CASES: list[tuple[int, float, float, DetectedObject, DetectedObject]] = [
    (1, 0.0, 80.0, thing(1, 48.0, 63.9), thing(1, 48.0, 64.3)),
    (2, -10.0, 10.0, thing(1, 50.0, 8.5), thing(1, 50.0, -9.5)),
    (3, 2.0, 10.0, thing(1, 20.0, 0.0, velocity_m_s=(-5.0, 0, 0)), thing(1, 20.0, 0.0, velocity_m_s=(-1.0, 0, 0))),
    (3, 2.0, 10.0, thing(1, 20.0, 0.0, velocity_m_s=(1.0, 0, 0)), thing(1, 0.0, 20.0, velocity_m_s=(0, -11.0, 0))),
    (4, 2.0, 10.0, thing(1, 20.0, 0.0, velocity_m_s=(-1.0, 0, 0)), thing(1, 20.0, 0.0, velocity_m_s=(1.0, 0, 0))),
    (6, 1.0, 5.0, thing(1, 20.0, 0.0, age_s=1.5), thing(1, 20.0, 0.0, age_s=0.5)),
    (7, 1.0, 9.0, thing(1, 20.0, 0.0), thing(1, 20.0, 0.0, size_m=(9.0, 2.5, 3.0))),
    (8, 5.0, 7.0, thing(1, 20.0, 0.0, existence=0.95), thing(1, 20.0, 0.0, existence=0.85)),
    (9, -4.0, 4.0, thing(1, 20.0, 3.8), thing(1, 20.0, -4.3)),
    (10, -10.0, 120.0, thing(1, 119.8, 0.0), thing(1, 120.4, 0.0)),
    (11, 2.0, 5.0, thing(1, 20.0, 0.0, velocity_m_s=(0, 1.0, 0)), thing(1, 20.0, 0.0, velocity_m_s=(0, -1.0, 0))),
    (12, 2.0, 9.0, thing(1, 20.0, 0.0, velocity_m_s=(1.0, 0, 0)), thing(1, 20.0, 0.0, velocity_m_s=(-1.0, 0, 0))),
    (13, 2.0, 5.0, thing(1, 20.0, 0.0, velocity_m_s=(0, -1.0, 0)), thing(1, 20.0, 0.0, velocity_m_s=(0, 1.0, 0))),
    (14, 2.0, 9.0, thing(1, 20.0, 0.0, velocity_m_s=(-1.0, 0, 0)), thing(1, 20.0, 0.0, velocity_m_s=(1.0, 0, 0))),
    (15, 0.0, 0b10, thing(1, 20.0, 0.0), thing(1, 20.0, 0.0, category="truck")),
]


@pytest.mark.parametrize(("index", "low", "high", "passes", "fails"), CASES)
def test_each_criterion_lists_one_of_two_objects(
    index: int, low: float, high: float, passes: DetectedObject, fails: DetectedObject
) -> None:
    for item, expected in ((passes, 1), (fails, 0)):
        rig = start({"format": "ars408"}, [item])
        rig.run(0.01)
        rig.hear(command(index, low, high))
        assert len(decoded(rig, lists(rig.run(0.2))[-1], "ObjGeneral")) == expected


def test_the_cross_section_filter_looks_at_the_one_that_the_scenario_gives() -> None:
    rig = start({"format": "ars408", "rcs_dbm2": 10.0}, crowd(3))
    rig.run(0.01)
    rig.hear(command(5, 5.0, 20.0))
    assert len(decoded(rig, lists(rig.run(0.2))[-1], "ObjGeneral")) == 3
    rig.hear(command(5, 11.0, 20.0))
    assert len(decoded(rig, lists(rig.run(0.2))[-1], "ObjGeneral")) == 0


def test_the_number_filter_cuts_after_sorting() -> None:
    rig = start({"format": "ars408"}, crowd(10))
    rig.run(0.01)
    rig.hear(command(0, 0, 3))
    general = decoded(rig, lists(rig.run(0.2))[-1], "ObjGeneral")
    assert [item["DistLong"] for item in general] == pytest.approx([5.0, 7.0, 9.0])


def test_a_cluster_filter_leaves_objects_alone_and_the_other_way_round() -> None:
    objects = [thing(1, 20.0, 0.0), thing(2, 60.0, 0.0)]
    for output, header, general, expected in (
        ("objects", "ObjListHeader", "ObjGeneral", 2),
        ("clusters", "ClusterListHeader", "ClusterGeneral", 1),
    ):
        rig = start({"format": "ars408", "output": output}, objects)
        rig.run(0.01)
        rig.hear(command(1, 0.0, 40.0, objects=False))
        assert len(decoded(rig, lists(rig.run(0.2), header)[-1], general)) == expected


@pytest.mark.parametrize(("rule", "listed"), [("maker", 0), ("tier4", 1)])
def test_left_to_right_can_be_taken_as_one_driver_has_it(rule: str, listed: int) -> None:
    rightwards: dict[str, Any] = {"velocity_m_s": (0.0, -1.0, 0.0)}
    rig = start({"format": "ars408", "lateral_filters": rule}, [thing(1, 20.0, 0.0, **rightwards)])
    rig.run(0.01)
    rig.hear(command(11, 2.0, 5.0))
    assert len(decoded(rig, lists(rig.run(0.2))[-1], "ObjGeneral")) == listed


def test_filters_are_forgotten_over_power_off() -> None:
    rig = start({"format": "ars408"}, [thing(1, 100.0, 0.0)])
    rig.run(0.01)
    rig.hear(DISTANCE_0_80)
    assert decoded(rig, lists(rig.run(0.2))[-1], "ObjGeneral") == []
    rig.session.power_on(rig.now_ns)
    assert len(decoded(rig, lists(rig.run(0.7))[-1], "ObjGeneral")) == 1
