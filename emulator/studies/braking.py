"""The base paper's application: does a car that relies on the lidar stop in time, in every weather?

Detection range of a car and a pedestrian, measured through the whole path, against reaction and braking distance.
Belongs here: the comparison. Not: the stages (stage), the paper's objects (targets).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from emulator.studies import drawing
from emulator.studies.effort import Effort
from emulator.studies.report import Column, Picture, Section, Table, Value
from emulator.studies.stage import Stage
from emulator.studies.targets import CAR, CLEAR, PAPER, PEDESTRIAN, TABLE_3, Air, Thing, rain, snow

GRAVITY_M_S2 = 9.81
KM_H = 1.0 / 3.6
ROAD = {"dry": "dry", "wet": "wet", "snow": "snow-covered"}

WEATHERS: tuple[Air, ...] = (
    CLEAR,
    *TABLE_3[1:],
    rain(10.0),
    rain(35.0),
    rain(70.0),
    snow("wet", 3.0),
    snow("dry", 3.0),
)


@dataclass(frozen=True)
class Driving:
    """What is assumed of driver, tyre and road."""

    speeds_km_h: tuple[float, ...] = (30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0, 110.0, 120.0, 130.0)
    reaction_s: float = 1.0
    friction_dry: float = 0.75
    friction_wet: float = 0.40
    friction_snow: float = 0.30

    def friction(self, road: Literal["dry", "wet", "snow"]) -> float:
        """Coefficient of friction on such a road."""
        return {"dry": self.friction_dry, "wet": self.friction_wet, "snow": self.friction_snow}[road]

    def stopping_m(self, speed_km_h: float, road: Literal["dry", "wet", "snow"]) -> float:
        """Reaction and braking distance: v t + v^2 / (2 mu g)."""
        v = speed_km_h * KM_H
        return v * self.reaction_s + v * v / (2.0 * self.friction(road) * GRAVITY_M_S2)

    def safe_km_h(self, sight_m: float, road: Literal["dry", "wet", "snow"]) -> float:
        """Speed from which the car just stops within `sight_m`."""
        brake = self.friction(road) * GRAVITY_M_S2
        lost = brake * self.reaction_s
        return (math.sqrt(lost * lost + 2.0 * brake * sight_m) - lost) / KM_H


@dataclass(frozen=True)
class Reading:
    """One way to say `detected`."""

    key: str
    title: str
    mode: Literal["seed", "operational"]
    echoes: Literal["last", "strongest"]


PAPERS = Reading("snr_1", "the paper's limit, SNR = 1", "seed", "strongest")
LAST = Reading("threshold_last", "threshold for 1e-4 false alarms, last echo", "operational", "last")
STRONGEST = Reading("threshold_strongest", "the same, strongest echo", "operational", "strongest")
READINGS = (PAPERS, LAST, STRONGEST)
SHOWN = (PAPERS, LAST)
"Those with a picture."


def detection_m(thing: Thing, air: Air, reading: Reading) -> float:
    """Largest range at which the reported echo of a beam on the thing is its own; 0: at none.

    No noise is drawn: at the threshold half of the echoes are detected. The weather's own echoes are in the signal
    except in the paper's mode.
    """
    physics = {"echoes": reading.echoes, "noise": False}
    stage = Stage(thing.target, PAPER, mode=reading.mode, weather=air.weather, physics=physics)
    return stage.farthest_m(thing.farthest_m(stage.measure.model, stage.extinction_per_m))


Sight = dict[tuple[str, str, str], float]
"(thing, weather, reading) -> detection range. [m]"


def sight(effort: Effort) -> Sight:
    """All detection ranges."""
    weathers = WEATHERS[:: effort.every]
    return {
        (thing.name, air.name, reading.key): detection_m(thing, air, reading)
        for thing in (CAR, PEDESTRIAN)
        for air in weathers
        for reading in READINGS
    }


def application(driving: Driving, effort: Effort) -> Section:
    """Detection range against stopping distance in every weather."""
    seen = sight(effort)
    weathers = WEATHERS[:: effort.every]
    enough = {
        (thing.name, reading.key): sum(
            seen[thing.name, air.name, reading.key] >= driving.stopping_m(speed, air.road)
            for air in weathers
            for speed in driving.speeds_km_h
        )
        for thing in (CAR, PEDESTRIAN)
        for reading in SHOWN
    }
    cells = len(weathers) * len(driving.speeds_km_h)
    counted = "; ".join(
        f"{thing.name.split(',')[0].lower()}, {reading.title}: {enough[thing.name, reading.key]}"
        for thing in (CAR, PEDESTRIAN)
        for reading in SHOWN
    )
    return Section(
        "Application: is the safety distance enough?",
        (
            f"Stopping distance is v t + v²/(2 μ g) with a reaction time of {driving.reaction_s:g} s and friction "
            f"{driving.friction_dry:g} on dry, {driving.friction_wet:g} on wet and {driving.friction_snow:g} on "
            "snow-covered road; fog leaves the road dry. All of them are options of the command. Car and pedestrian "
            "are those of table 2 (white body 0.75, dark clothes 0.05), met face-on by a beam of the paper's lidar; "
            "that a beam of a scan points at them is a further condition.",
            f"Of {cells} pairs of weather and speed the range is enough in: {counted}.",
            '"SNR = 1" is the paper\'s limit, at which a real receiver would see noise 18 times in every gate; the '
            "threshold for one false alarm in ten thousand gates stands at 5.02 times the noise. There the weather "
            "sends light back: a sensor that reports the strongest echo reports the fog before its window instead of "
            "what stands farther off, one that reports the last echo finds it as long as it rises from the fog's tail.",
        ),
        (margin_picture(driving, seen, weathers), curve_picture(driving, seen, weathers)),
        (range_table(driving, seen, weathers), margin_table(driving, seen, weathers)),
    )


def range_table(driving: Driving, seen: Sight, weathers: tuple[Air, ...]) -> Table:
    """Detection ranges and the largest safe speeds."""
    rows: list[tuple[Value, ...]] = []
    for thing in (CAR, PEDESTRIAN):
        for air in weathers:
            ranges = [seen[thing.name, air.name, reading.key] for reading in READINGS]
            safe = [driving.safe_km_h(ranges[n], air.road) for n in range(len(SHOWN))]
            rows.append((thing.name, air.name, driving.friction(air.road), *ranges, *safe))
    return Table(
        "braking_ranges",
        "Detection range and the largest speed from which the car stops in time",
        (
            Column("object", "object"),
            Column("weather", "weather"),
            Column("friction", "friction"),
            *(Column(f"{reading.key}_m", f"{reading.title} (m)", ".1f") for reading in READINGS),
            *(Column(f"safe_{reading.key}_km_h", f"safe speed, {reading.title} (km/h)", ".0f") for reading in SHOWN),
        ),
        tuple(rows),
    )


def margin_table(driving: Driving, seen: Sight, weathers: tuple[Air, ...]) -> Table:
    """One row for every object, weather and speed."""
    rows: list[tuple[Value, ...]] = []
    for thing in (CAR, PEDESTRIAN):
        for air in weathers:
            for speed in driving.speeds_km_h:
                stop = driving.stopping_m(speed, air.road)
                margins = [seen[thing.name, air.name, reading.key] - stop for reading in SHOWN]
                verdict = [margin >= 0.0 for margin in margins]
                rows.append((thing.name, air.name, speed, stop, margins[0], verdict[0], margins[1], verdict[1]))
    return Table(
        "braking",
        "Range less stopping distance",
        (
            Column("object", "object"),
            Column("weather", "weather"),
            Column("speed_km_h", "speed (km/h)", ".0f"),
            Column("stopping_m", "stopping distance (m)", ".1f"),
            Column("margin_snr_1_m", "margin at SNR = 1 (m)", "+.1f"),
            Column("enough_snr_1", "enough"),
            Column("margin_threshold_m", "margin at the threshold, last echo (m)", "+.1f"),
            Column("enough_threshold", "enough"),
        ),
        tuple(rows),
    )


def margin_picture(driving: Driving, seen: Sight, weathers: tuple[Air, ...]) -> Picture:
    """Cells of weather and speed: how much is left."""
    from matplotlib.colors import TwoSlopeNorm

    made, panels = drawing.figure(2, 2, size=(14.0, 1.6 + 0.72 * len(weathers)))
    speeds = driving.speeds_km_h
    for panel, (thing, reading) in zip(panels, [(t, r) for t in (CAR, PEDESTRIAN) for r in SHOWN], strict=True):
        stop = np.array([[driving.stopping_m(speed, air.road) for speed in speeds] for air in weathers])
        margin = np.array([[seen[thing.name, air.name, reading.key]] for air in weathers]) - stop
        drawing.bare(panel)
        panel.imshow(margin, cmap="RdBu", norm=TwoSlopeNorm(0.0, -150.0, 150.0), aspect="auto")
        for row, column in np.ndindex(margin.shape):
            value = float(margin[row, column])
            panel.text(
                column, row, f"{value:+.0f}".replace("-", "−"), ha="center", va="center", fontsize=8.5,
                color="white" if abs(value) > 95.0 else "#1b1f24",
            )  # fmt: skip
        panel.set_xticks(range(len(speeds)), [f"{speed:g}" for speed in speeds])
        panel.set_yticks(range(len(weathers)), [air.name for air in weathers])
        panel.set_title(f"{thing.name.split(',')[0]}: {reading.title}", fontsize=10)
        panel.set_xlabel("speed (km/h)")
    caption = "Detection range less stopping distance in metres; blue: the car stops in time."
    return Picture("braking", "Range less stopping distance", drawing.png(made), caption)


def curve_picture(driving: Driving, seen: Sight, weathers: tuple[Air, ...]) -> Picture:
    """Stopping distance over speed, with every weather where its detection range meets its road's curve."""
    made, panels = drawing.figure(2, size=(14.0, 5.6))
    line = np.linspace(0.0, max(driving.speeds_km_h), 120)
    roads: tuple[Literal["dry", "wet", "snow"], ...] = ("dry", "wet", "snow")
    for panel, thing in zip(panels, (CAR, PEDESTRIAN), strict=True):
        for number, road in enumerate(roads):
            stop = np.array([driving.stopping_m(float(speed), road) for speed in line])
            drawing.curve(panel, line, stop, number, f"{ROAD[road]} road, μ = {driving.friction(road):g}")
        ranges = [seen[thing.name, air.name, PAPERS.key] for air in weathers]
        top = 1.25 * max(ranges)
        for air, range_m in zip(weathers, ranges, strict=True):
            safe = driving.safe_km_h(range_m, air.road)
            colour = drawing.COLOURS[roads.index(air.road)]
            panel.axhline(range_m, color=colour, linewidth=0.8, linestyle=(0, (2, 3)))
            if safe <= line[-1]:
                drawing.measured(panel, np.array([safe]), np.array([range_m]), roads.index(air.road))
        drawing.right_labels(panel, [air.name for air in weathers], ranges, top)
        panel.set(
            xlabel="speed (km/h)", ylabel="distance (m)", xlim=(0, line[-1]), ylim=(0, top),
            title=f"{thing.name.split(',')[0]}, SNR = 1",
        )  # fmt: skip
        panel.legend(frameon=True, edgecolor="none", fontsize=9, loc="upper left")
    caption = (
        "Solid: stopping distance. Dotted: detection range in each weather. Marks: the speed from which the car "
        "just stops."
    )
    return Picture("braking_curves", "Stopping distance over speed", drawing.png(made), caption)
