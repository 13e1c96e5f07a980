"""openpilot's radar parsers, unmodified from the package `opendbc`, read lists made of the same objects as ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from protocols.scan import DetectedObject
from tests.protocols.can_objects.openpilot_lists import RawFrame, ford_cycle, toyota_cycle
from tests.protocols.can_objects.rig import decoded, lists, start, thing

opendbc = pytest.importorskip("opendbc", reason="opendbc has no wheel for this Python")

NEAR = thing(1, 45.0, -2.2, velocity_m_s=(-3.0, 0.0, 0.0))
FAR = thing(2, 80.0, 2.4, velocity_m_s=(5.5, 0.0, 0.0))


def ford() -> Any:
    from opendbc.car import structs
    from opendbc.car.ford.radar_interface import RadarInterface
    from opendbc.car.ford.values import CAR

    return RadarInterface(structs.CarParams(carFingerprint=CAR.FORD_BRONCO_SPORT_MK1, radarUnavailable=False))


def toyota() -> Any:
    from opendbc.car import structs
    from opendbc.car.toyota.radar_interface import RadarInterface
    from opendbc.car.toyota.values import CAR

    return RadarInterface(structs.CarParams(carFingerprint=CAR.TOYOTA_PRIUS, radarUnavailable=False))


def feed(parser: Any, frames: Sequence[RawFrame], t_ns: int, bus: int) -> Any:
    return parser.update([(t_ns, [(identifier, data, bus) for identifier, data in frames])])


def ford_points(objects: Sequence[DetectedObject], cycles: int = 12) -> list[Any]:
    from opendbc.car.ford.fordcan import CanBus

    parser, found = ford(), []
    bus = CanBus(parser.CP).radar
    for index in range(cycles):
        result = feed(parser, ford_cycle(objects, index), (1 + index) * 33_000_000, bus)
        if result is not None:
            found.append(result)
    return found


def test_the_ford_parser_sees_two_objects_where_they_are_with_stable_numbers() -> None:
    results = ford_points([NEAR, FAR])
    assert len(results) == 3  # one for each round of the four modes
    # in the first round the two modes that the parser uses have nothing to be matched with: two points an object
    assert [len(result.points) for result in results] == [4, 2, 2]
    for result in results[1:]:
        assert not (result.errors.canError)
        assert not (result.errors.wrongConfig)
        assert not (result.errors.radarUnavailableTemporary)
        points = sorted(result.points, key=lambda point: point.dRel)
        for point, item in zip(points, (NEAR, FAR), strict=True):
            assert point.dRel == pytest.approx(item.position_m[0], abs=0.1)
            assert point.yRel == pytest.approx(item.position_m[1], abs=0.1)
            # radial speed: the cosine of a few degrees below the speed along x
            assert point.vRel == pytest.approx(item.velocity_m_s[0], abs=0.05)
    numbers = [[point.trackId for point in result.points] for result in results]
    assert numbers[1] == numbers[2]
    assert set(numbers[1]) <= set(numbers[0])


def test_the_ford_parser_loses_what_is_not_listed_any_more() -> None:
    assert [len(result.points) for result in ford_points([])] == [0, 0, 0]


def test_the_ford_parser_notices_a_scan_index_that_stands_still() -> None:
    from opendbc.car.ford.fordcan import CanBus

    parser = ford()
    bus = CanBus(parser.CP).radar
    results = [feed(parser, ford_cycle([NEAR], 3), (1 + k) * 33_000_000, bus) for k in range(8)]
    assert results[-1].errors.radarUnavailableTemporary


def test_the_toyota_parser_sees_the_objects_from_the_first_list_on() -> None:
    parser = toyota()
    for index in range(5):
        frames = toyota_cycle([NEAR, FAR], index, new=index == 0)
        result = feed(parser, frames, (1 + index) * 50_000_000, 1)
        assert not result.errors.canError
        points = sorted(result.points, key=lambda point: point.dRel)
        assert [(p.dRel, p.yRel, p.vRel) for p in points] == [
            pytest.approx((item.position_m[0], item.position_m[1], item.velocity_m_s[0]), abs=0.04)
            for item in (NEAR, FAR)
        ]


def test_the_toyota_parser_refuses_a_frame_with_a_wrong_checksum() -> None:
    parser = toyota()
    frames = toyota_cycle([NEAR], 0, new=True)
    identifier, data = frames[0]
    frames[0] = (identifier, data[:7] + bytes([data[7] ^ 1]))
    assert list(feed(parser, frames, 50_000_000, 1).points) == []


def test_what_openpilot_sees_is_what_our_own_list_says() -> None:
    rig = start({"format": "ars408"}, [NEAR, FAR])
    general = decoded(rig, lists(rig.run(0.1))[0], "ObjGeneral")
    points = sorted(ford_points([NEAR, FAR])[-1].points, key=lambda point: point.dRel)
    for point, item in zip(points, general, strict=True):
        assert (point.dRel, point.yRel, point.vRel) == pytest.approx(
            (item["DistLong"], item["DistLat"], item["VrelLong"]), abs=0.3
        )
