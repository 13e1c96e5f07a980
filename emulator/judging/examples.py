"""Fifty small scenarios whose answers are known in closed form: a CI job's first test, and a measure of speed.

A wall across the x axis at a known distance, a box that crosses in front of it, and the weather; each lasts one second
of virtual time. Written as files, so that a driver's repository can begin with them and change them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

DISTANCES_M = (3.0, 6.0, 12.0, 20.0)
LMS291_RATES = ((1.0, 180, 75.0), (0.5, 180, 37.5), (0.25, 100, 18.75))
"Resolution [deg], field [deg], whole scans per second: 75 Hz of the mirror over 1, 2, 4 interlaced sweeps."
WEATHERS = {
    "clear": "{}",
    "haze": "{fog: {visibility_m: 500}}",
    "rain": "{rain: {rate_mm_h: 5}}",
}
OTHER_MODELS = (
    "sick-lms200-30106",
    "sick-lms211-30106",
    "sick-lms211-30206",
    "sick-lms220-30106",
    "sick-lms221-30106",
    "sick-lms221-30206",
    "sick-lms291-s14",
    "sick-lms291-s15",
)
LD_SETTINGS = ((5, 1.0), (5, 2.0), (10, 1.0), (10, 2.0), (15, 2.0), (20, 2.0))
"Speed of the head [Hz], angle step [deg]."


def _text(model: str, device: str, distance_m: float, weather: str, expect: list[str]) -> str:
    box_m = distance_m / 2.0
    lines = "".join(f"  - {line}\n" for line in expect)
    return f"""\
# Wall at {distance_m:g} m, box crossing at {box_m:g} m. Made by lidaremu test --examples.
schema: 1
seed: 1
duration_s: 1
world:
  - {{plane: {{size_m: [6, 60]}}, at_m: [{distance_m:g}, 0, 1], pitch_deg: -90, material: white_plaster}}
actors:
  - id: box
    class: car
    shape: {{box: {{size_m: [0.4, 0.8, 1.6]}}}}
    material: car_paint_white
    motion: {{at_m: [{box_m:g}, -1.2, 0], velocity_m_s: [0, 0.5, 0]}}
weather: {weather}
sensors:
  - {{id: front, model: {model}, mount: {{at_m: [0, 0, 1]}}, device: {device}}}
expect:
{lines}"""


def _common(distance_m: float) -> list[str]:
    oblique_m = distance_m / 0.984807753012208  # cosine of 10 degrees
    spread_m = 0.12
    return [
        f"{{that: median(front.range_at(10)), within: [{oblique_m - spread_m:.3f}, {oblique_m + spread_m:.3f}]}}",
        "{that: max(front.points_on(box)), at_least: 1}",
        "{that: front.scans_dropped + front.input_dropped, equals: 0}",
        "{that: front.restarts, equals: 1}",
    ]


def texts() -> Iterator[tuple[str, str]]:
    """Name and text of each of the fifty."""
    for distance_m, (step, field, rate), name in itertools.product(DISTANCES_M, LMS291_RATES, WEATHERS):
        device = f"{{resolution_deg: {step:g}, field_deg: {field}, unit: cm}}"
        expect = [
            *_common(distance_m),
            f"{{that: front.scans_per_s, within: [{rate - 0.05:g}, {rate + 0.05:g}]}}",
            "{that: front.range_error_m, at_most: 0.0051}",
        ]
        yield (
            f"lms291_{name}_{distance_m:g}m_{step * 100:03.0f}",
            _text("sick-lms291-s05", device, distance_m, WEATHERS[name], expect),
        )
    for model in OTHER_MODELS:
        expect = [*_common(5.0), "{that: count(front.points), at_least: 10}"]
        yield model.removeprefix("sick-").replace("-", "_"), _text(model, "{}", 5.0, "{}", expect)
    for hz, step in LD_SETTINGS:
        expect = [
            *_common(8.0),
            f"{{that: front.scans_per_s, within: [{hz - 0.05:g}, {hz + 0.05:g}]}}",
            "{that: front.range_error_m, at_most: 0.0021}",
        ]
        device = f"{{delays: fast, motor_hz: {hz}, step_deg: {step:g}}}"
        yield (
            f"ld_{hz}hz_{step * 100:03.0f}",
            _text("sick-ld-lrs1000" if hz <= 10 else "sick-ld-oem1000", device, 8.0, "{}", expect),
        )


def write(folder: Path) -> list[Path]:
    """Write the fifty into a folder; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, text in texts():
        paths.append(folder / f"{name}.yaml")
        paths[-1].write_text(text, encoding="utf-8")
    return paths
