"""The scenario `fog_objects` judged once in virtual time, and its lists read by strangers.

The run takes some seconds; all tests here look at the same one.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import cantools
import pytest

from emulator.instrument.observer import Observer, Payload
from emulator.judging.trial import Trial, Verdict
from emulator.scenario.scenario import load
from protocols.scan import DetectedObject, Scan

ROAD_USERS = ("lorry", "car", "courier", "cyclist")


class Keeper(Observer):
    """Keeps the frames and lists of one sensor."""

    def __init__(self) -> None:
        self.frames: list[Payload] = []
        self.lists: list[Scan] = []

    def payload(self, payload: Payload) -> None:
        if payload.sensor == "radar":
            self.frames.append(payload)

    def scan(self, sensor: str, scan: Scan) -> None:
        if sensor == "radar":
            self.lists.append(scan)

    def objects_at(self, t_s: float) -> tuple[DetectedObject, ...]:
        return next(scan.objects for scan in self.lists if scan.plan.start_ns * 1e-9 >= t_s)


@pytest.fixture(scope="module")
def run() -> Iterator[tuple[Trial, Verdict, Keeper]]:
    keeper = Keeper()
    trial = Trial(load("fog_objects"), watchers=[keeper])
    yield trial, trial.finish(), keeper
    trial.close()


def test_every_expectation_holds(run: tuple[Trial, Verdict, Keeper]) -> None:
    _, verdict, _ = run
    assert [item for item in verdict.judgements if not item.held] == []
    assert len(verdict.judgements) >= 15


def test_the_report_has_figures_for_each_road_user_and_distance(run: tuple[Trial, Verdict, Keeper]) -> None:
    _, verdict, _ = run
    figures = next(item["objects"] for item in verdict.sensors if item["id"] == "radar")
    assert {row["actor"] for row in figures["by_actor_and_distance"]} == {*ROAD_USERS, "walker"}
    assert "objects" not in next(item for item in verdict.sensors if item["id"] == "scanner")
    for row in figures["by_actor"].values():
        assert 0.0 <= row["position_m"] < 3.0
        assert row["speed_m_s"] < 1.5


def test_cantools_decodes_every_frame_and_finds_the_objects(run: tuple[Trial, Verdict, Keeper]) -> None:
    _, _, keeper = run
    layout = cantools.database.load_file(str(files("protocols.can_objects").joinpath("ars408.dbc")))
    listed: list[list[dict[str, Any]]] = []
    wanted: list[int] = []
    for frame in keeper.frames:
        message = layout.get_message_by_frame_id(frame.peer)
        values = message.decode(frame.data, decode_choices=False)
        if frame.peer == 0x60A:
            listed.append([])
            wanted.append(values["NumObjects"])
        elif frame.peer == 0x60B:
            listed[-1].append(values)
    assert [len(rows) for rows in listed[:-1]] == wanted[:-1]
    assert len(listed) == pytest.approx(len(keeper.lists), abs=4)
    for scan, rows in list(zip(keeper.lists, listed, strict=False))[::20]:
        truly = sorted((item.position_m[0], item.position_m[1]) for item in scan.objects)
        decoded = sorted((row["DistLong"], row["DistLat"]) for row in rows)
        assert len(truly) == len(decoded)
        for one, other in zip(truly, decoded, strict=True):
            # the format tells the nearest side's middle or the centre: half a length apart at most
            assert other == pytest.approx(one, abs=2.6)


def test_openpilots_parser_sees_the_echoes_objects(run: tuple[Trial, Verdict, Keeper]) -> None:
    pytest.importorskip("opendbc", reason="opendbc has no wheel for this Python")
    from tests.protocols.can_objects.test_openpilot import ford_points

    _, _, keeper = run
    objects = keeper.objects_at(9.0)
    assert {item.actor for item in objects} == set(ROAD_USERS)
    found = ford_points(objects)[-1]
    assert not found.errors.canError
    for item in objects:
        near = min(found.points, key=lambda point: abs(point.dRel - item.position_m[0]))
        assert near.dRel == pytest.approx(item.position_m[0], abs=0.2)
        assert near.yRel == pytest.approx(item.position_m[1], abs=0.2)
    assert len(ford_points(keeper.objects_at(17.5))[-1].points) == 0
