"""Truth against lists: precision, recall, errors, and what was there to be seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from emulator.objects.metrics import ObjectScore, TruthObject, judge, visible_share
from emulator.objects.points import View
from protocols.scan import DetectedObject
from tests.objects.flatland import Box, look


def found(actor: str | None, x: float, y: float = 0.0, **more: object) -> DetectedObject:
    values: dict[str, object] = {
        "track": 1,
        "position_m": (x, y, 0.0),
        "velocity_m_s": (0.0, 0.0, 0.0),
        "size_m": (4.0, 2.0, 1.5),
        "yaw_rad": 0.0,
        "category": "car",
        "actor": actor,
    }
    return DetectedObject(**(values | more))  # type: ignore[arg-type]


def truth(actor: str, x: float, y: float = 0.0, share: float = 1.0) -> TruthObject:
    return TruthObject(actor, (x, y, 0.0), (0.0, 0.0, 0.0), (4.0, 2.0, 1.5), 0.0, share)


def test_a_list_is_split_into_right_wrong_missing_and_hidden() -> None:
    objects = [found("a", 10.0), found("a", 11.5), found("wall", 5.0), found(None, 8.0), found("b", 40.0)]
    truths = [truth("a", 10.2), truth("b", 30.0), truth("c", 20.0), truth("d", 50.0, share=0.02)]
    judged = judge(objects, truths)
    assert [(f.position_m[0], t.actor) for f, t in judged.matched] == [(10.0, "a")]
    assert sorted(o.position_m[0] for o in judged.false) == [5.0, 8.0, 11.5, 40.0]
    assert [t.actor for t in judged.missed] == ["b", "c"]
    assert [t.actor for t in judged.hidden] == ["d"]


def test_the_figures_are_those_of_the_definitions() -> None:
    score = ObjectScore()
    score.add([found("a", 10.3, 0.4)], [truth("a", 10.0)])
    score.add([found("a", 10.0, velocity_m_s=(3.0, 4.0, 0.0), size_m=(5.0, 2.4, 9.0))], [truth("a", 10.0)])
    score.add([found(None, 10.0)], [truth("a", 10.0)])
    total = score.total
    assert (total.seen, total.false, total.missed) == (2, 1, 1)
    assert (total.precision, total.recall) == pytest.approx((2 / 3, 2 / 3))
    assert total.position_m == pytest.approx(math.sqrt(0.25 / 2))
    assert total.speed_m_s == pytest.approx(math.sqrt(25 / 2))
    assert total.size_m == pytest.approx(0.5 * (1.0 + 0.4) / 2)


def test_figures_are_kept_for_each_actor_and_each_class_of_distance() -> None:
    score = ObjectScore()
    score.add([found("a", 9.0), found("b", 55.0)], [truth("a", 9.0), truth("b", 55.0), truth("c", 15.0)])
    assert {name: (s.seen, s.missed) for name, s in score.by_actor.items()} == {"a": (1, 0), "b": (1, 0), "c": (0, 1)}
    assert {end: (s.seen, s.missed) for end, s in score.by_distance_m.items()} == {
        10.0: (1, 0),
        20.0: (0, 1),
        60.0: (1, 0),
    }
    assert math.isnan(score.by_actor["c"].position_m)
    assert math.isnan(score.by_actor["c"].precision)


def test_nothing_to_judge_has_no_figures() -> None:
    total = ObjectScore().total
    assert math.isnan(total.precision)
    assert math.isnan(total.recall)
    assert math.isnan(total.position_m)


@pytest.mark.parametrize(("cover", "share"), [(0.0, 1.0), (1.0, 0.5), (2.0, 0.0)])
def test_the_visible_share_is_that_of_the_beams_that_reach_it(cover: float, share: float) -> None:
    target = Box(1, 40.0, 0.0, length_m=0.2, width_m=4.0)
    screen = Box(2, 20.0, -1.0 + 0.5 * cover, length_m=0.2, width_m=cover)
    boxes = [target] if cover == 0.0 else [target, screen]
    view = look(boxes, 0.0, beams=14401)
    real = TruthObject("a", (40.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.2, 4.0, 0.0))
    assert visible_share(view, real, 1) == pytest.approx(share, abs=0.02)


def test_the_visible_share_of_a_turned_sensor_is_the_same() -> None:
    target = Box(1, 40.0, 0.0, length_m=0.2, width_m=4.0)
    view = look([target], 0.0)
    turned = View(view.scan, np.zeros(3), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    real = TruthObject("a", (0.0, 40.0, 0.0), (0.0, 0.0, 0.0), (0.2, 4.0, 0.0), yaw_rad=math.pi / 2)
    assert visible_share(turned, real, 1) == pytest.approx(1.0)
    assert visible_share(view, real, 1) == 0.0


def test_what_lies_above_all_beams_is_not_to_be_seen() -> None:
    view = look([Box(1, 40.0, 0.0)], 0.0)
    sign = TruthObject("a", (40.0, 0.0, 6.0), (0.0, 0.0, 0.0), (4.4, 1.8, 1.0))
    assert visible_share(view, sign, 1) == 0.0
