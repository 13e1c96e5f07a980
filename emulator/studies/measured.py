"""Values that others measured with real sensors, skies and leaves, and what whole sensors in scenes make of them.

Belongs here: prints that need a scene, a sensor or a receiver to be reproduced, a few hundred beams each. Not: laws and
integrals (further), the base paper (ranges, figures, points).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from emulator.casting import raycast
from emulator.physics import foliage, photons, sunlight
from emulator.physics.arrays import Floats
from emulator.physics.dead_time import DeadTime
from emulator.scenario import scenario
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.studies.effort import Effort
from emulator.studies.facts import Fact
from emulator.world import scene
from protocols.scan import ScanPlan

CLEAR: Mapping[str, Any] = {"visibility_m": 1e9}
AXIS: Mapping[str, Any] = {"rule": "axis", "range_noise_mm": 0.0, "false_alarms": False}
APART_S = 20.0
"Between sweeps of which no two see the same flakes."
SNOW_MM_H = 5.0
HINGE_DEG = 57.5
"Zenith angle at which leaf angles hardly matter."
MICHAUD = "Michaud, Lalonde, Giguère 2015, IROS workshop PPNIV"
SLIDES = MICHAUD + ", slide 4"


def sensor(
    model: str,
    world: Sequence[Mapping[str, Any]] = (),
    *,
    weather: Mapping[str, Any] = CLEAR,
    physics: Mapping[str, Any] = AXIS,
    materials: Mapping[str, Any] | None = None,
) -> Measure:
    """A sensor at rest in a scene, from a scenario."""
    text = {
        "schema": 1,
        "seed": 1,
        "world": list(world),
        "materials": dict(materials or {}),
        "weather": dict(weather),
        "sensors": [{"id": "lidar", "model": model, "physics": dict(physics)}],
    }
    loaded = scenario.loads(json.dumps(text), Path("study.yaml"))  # JSON is YAML
    built = scene.build(loaded)
    return build_measure(loaded, built, raycast.Caster(built), "lidar")


def wall(range_m: float, material: str, incidence_deg: float = 0.0) -> dict[str, Any]:
    """A plate of 60 m, turned by the incidence."""
    return {
        "plane": {"size_m": [60.0, 60.0]}, "at_m": [range_m, 0.0, 0.0], "material": material,
        "pitch_deg": -90.0, "yaw_deg": incidence_deg,
    }  # fmt: skip


def sweep(azimuth_rad: Floats, number: int = 0, elevation_rad: float = 0.0) -> ScanPlan:
    """All beams at once, `APART_S` after the sweep before."""
    n = len(azimuth_rad)
    return ScanPlan(
        epoch=0, sweep=number, start_ns=round(1e9 * APART_S) * number, azimuth_rad=azimuth_rad,
        elevation_rad=np.full(n, elevation_rad), fire_offset_s=np.zeros(n), max_echoes=1,
    )  # fmt: skip


def all_round(count: int) -> Floats:
    """Directions of a full turn. [rad]"""
    return np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)


# ------------------------------------------------------------------------------- snow and rain
def snow_facts(effort: Effort) -> list[Fact]:
    """Falling snow in three scanners of one experiment: how far flakes are seen, and the beams themselves."""
    facts = []
    for model, name in (
        ("sick-lms200-30106", "LMS200"), ("sick-lms151", "LMS151"), ("hokuyo-utm-30lx-ew", "UTM-30LX-EW"),
    ):  # fmt: skip
        facts.append(
            Fact(f"{name}: range within which 99 % of flakes are reported", "m", MICHAUD, "memory, abstract", 10.0,
                 flakes_within_m(model, 0.99, effort), "limit",
                 "\"little impact beyond a range of 10 m\"; ours in dry snow of "
                 f"{SNOW_MM_H:g} mm/h, open field, {12 // effort.every} sweeps")
        )  # fmt: skip
    for model, name, printed, why in (
        ("sick-lms200-30106", "LMS200", 165.0, "ours has the 12.9 mrad of MAVS's LMS291; the print is one of 4.5 mrad"),
        ("sick-lms151", "LMS151", 22.0, "ours is SICK's manual, 8 mm and 15 mrad; the print is one of 1.5 mrad"),
        ("hokuyo-utm-30lx-ew", "UTM-30LX-EW", 196.0, "our 8 mrad are a choice, no data sheet had the number"),
    ):
        facts.append(
            Fact(f"{name}: area of the beam at 30 m", "cm²", SLIDES, "read, slides", printed,
                 1e4 * beam_area_m2(model, 30.0), "computed", "to 1/e²; the print's rim is not stated", why=why)
        )  # fmt: skip
    return facts


def flakes_within_m(model: str, share: float, effort: Effort) -> float:
    """Range within which this share of the flakes lies that a scanner in an open field reports."""
    falling = sensor(model, weather={"snow": {"rate_mm_h": SNOW_MM_H, "kind": "dry"}})
    azimuth = all_round(360)
    found = np.concatenate([falling(sweep(azimuth, k)).range_m[:, 0] for k in range(12 // effort.every)])
    return float(np.nanquantile(found, share))


def beam_area_m2(model: str, range_m: float) -> float:
    """Area of a beam at a range, to 1/e2."""
    beam = sensor(model).model.beam
    across = [math.tan(half) * range_m + beam.exit_radius_m for half in (beam.half_angle_x_rad, beam.half_angle_y_rad)]
    return math.pi * across[0] * across[1]


def rain_facts(effort: Effort) -> list[Fact]:
    """A wall behind rain."""
    return [
        Fact("shift of the mean range of a wall in rain", "cm", "Filgueira et al. 2017, Measurement 95",
             "read, abstract", 20.0, max(abs(rain_shift_cm(rate, effort)) for rate in (10.0, 50.0)), "limit",
             "\"always lower than 20 cm\", VLP-16; ours: UTM-30LX before concrete 15 m away, 10 and 50 mm/h"),
    ]  # fmt: skip


def rain_shift_cm(rate_mm_h: float, effort: Effort) -> float:
    """By how much rain moves the mean of the points on a wall 15 m away."""
    means = []
    for weather in (CLEAR, {"rain": {"rate_mm_h": rate_mm_h}}):
        here = sensor("hokuyo-utm-30lx", [wall(15.0, "concrete")], weather=weather, physics={"rule": "axis"})
        azimuth = np.radians(np.linspace(-20.0, 20.0, 161))
        found = [here(sweep(azimuth, k)).range_m[:, 0] * np.cos(azimuth) for k in range(12 // effort.every)]
        on_wall = np.concatenate(found)
        means.append(float(np.mean(on_wall[on_wall > 13.0])))
    return 100.0 * (means[1] - means[0])


# ------------------------------------------------------------------------------- receivers
def receiver_facts(effort: Effort) -> list[Fact]:
    """Timing of a faint echo, dead time, and the pile-up of first photons."""
    wu = "Wu et al. 2025, arXiv 2507.11404"
    width, precision = best_first_photon()
    return [
        Fact("single-shot precision at an SNR of 10, pulse of 3 ns", "cm",
             "Baharmast, Kostamovaara 2020, Opt. Eng. 59(10) 104102", "read, abstract", 5.0,
             100.0 * precision_m(10.0, 3.0, effort), "computed",
             "theirs takes the zero of a bipolar pulse; ours the top (`peak`) behind a pole of 1/(2 FWHM)",
             spread_percent=15.0),
        Fact("largest count rate of a SPAD with 28.5 ns dead time", "1/µs", "Chen et al. 2020, Electronics 9, 1131",
             "read, abstract", 35.0, 1e-6 * saturated_hz(28.5), "computed", "\"around 35 Mcounts/s\"; bins of 0.5 ns"),
        Fact("best width of a pulse for first photons, over the bin of the clock", "1", wu, "read, abstract", 0.56,
             width, "computed", "Cramér-Rao bound of our law of first photons, Gaussian pulse, in steps of 0.02"),
        Fact("error of the range there, times the root of the number of pulses, over the bin", "1", wu,
             "read, abstract", 0.53, precision, "computed", "root mean square over the places of the pulse in its bin",
             why="over what the paper takes the mean is not in its abstract"),
    ]  # fmt: skip


def precision_m(snr: float, fwhm_ns: float, effort: Effort) -> float:
    """Standard deviation of the range to a plate of this signal to noise, by the top of the pulse behind a pole."""
    physics = {
        **AXIS, "pulse_fwhm_ns": fwhm_ns, "detection": "peak", "response": "single_pole",
        "corner_mhz": 1e3 / (2.0 * fwhm_ns), "floor_reflectance": "off", "full_scale_snr": "off", "gate_m": 100.0,
        "threshold_to_noise": 4.0,
    }  # fmt: skip
    dark = {"dark": {"rho": 0.05, "model": "lambert"}}
    range_m = math.sqrt(0.05 * sensor("paper-905nm", physics=physics).model.k_m2 / snr)
    here = sensor("paper-905nm", [wall(range_m, "dark")], physics=physics, materials=dark)
    found = here(sweep(np.zeros(4000 // effort.every))).range_m[:, 0]
    return float(np.std(found[np.abs(found - range_m) < 2.0]))


def saturated_hz(dead_ns: float, bin_ns: float = 0.5) -> float:
    """Counts a second in glaring light, after the first ten dead times of a long gate."""
    bins = math.ceil(100.0 * dead_ns / bin_ns)
    light = np.full((1, bins), 1e11 * 1e-9 * bin_ns)
    counts = DeadTime(dead_ns / bin_ns).histogram(light, 1, None)[0, bins // 10 :]
    return float(np.mean(counts)) / (1e-9 * bin_ns)


def best_first_photon() -> tuple[float, float]:
    """Width of a Gaussian pulse, FWHM over the bin, with the least error of the range, and that error."""
    widths = np.arange(0.40, 0.80, 0.02)
    errors = [min(_first_photon_error(float(width), flux) for flux in (1.0, 1.5, 2.0, 2.5)) for width in widths]
    best = int(np.argmin(errors))
    return float(widths[best]), float(errors[best])


def _first_photon_error(fwhm: float, flux: float, bins: int = 12, step: float = 1e-4) -> float:
    """Cramér-Rao bound of one pulse of a mean of `flux` photoelectrons, all lengths in bins."""
    at = (np.arange(10, dtype=np.float64) + 0.5) / 10.0 - 0.5
    cases = [(at, flux), (at + step, flux), (at - step, flux), (at, flux + step), (at, flux - step)]
    now, right, left, more, less = (_first_photon_shares(place, fwhm, mean, bins) for place, mean in cases)
    seen = np.maximum(now, 1e-300)
    along, bright = (right - left) / (2.0 * step), (more - less) / (2.0 * step)
    reported = np.where(now > 1e-12, 1.0 / seen, 0.0)
    aa, ab, bb = (
        (one * other * reported).sum(axis=1) for one, other in ((along, along), (along, bright), (bright, bright))
    )
    return float(np.sqrt(np.mean(bb / (aa * bb - ab * ab))))


def _first_photon_shares(place: Floats, fwhm: float, flux: float, bins: int) -> Floats:
    """(places, bins + 1) chances that the first photon comes in each bin, or none does."""
    sigma = fwhm / math.sqrt(8.0 * math.log(2.0))
    edges = (np.arange(bins + 1) - 0.5 * bins - place[:, None]) / (math.sqrt(2.0) * sigma)
    below = 0.5 * (1.0 + np.vectorize(math.erf)(edges))
    first = photons.first_photon_distribution(flux * np.diff(below, axis=1))
    return np.concatenate([first, 1.0 - first.sum(axis=1, keepdims=True)], axis=1)


# ------------------------------------------------------------------------------- sky, sheeting
def sky_facts() -> list[Fact]:
    """Twilight."""
    glossary = "AMS Glossary of Meteorology, civil twilight"
    return [
        Fact("illuminance of level ground, sun at 0 deg", "lx", glossary, "read", 497.5, sunlight.illuminance_lx(0.0),
             "computed", "print: 585 to 410; ours: the polynomials of Janiczek and DeYoung 1987", spread_percent=18.0,
             why="why is not known; ours has fallen to 585 lx at -0.4 deg"),
        Fact("illuminance of level ground, sun at -6 deg", "lx", glossary, "read", 2.75, sunlight.illuminance_lx(-6.0),
             "computed", "print: 3.5 to 2", spread_percent=28.0),
    ]  # fmt: skip


def sheeting_facts() -> list[Fact]:
    """Sheeting of one class from the angles of another, as a photometer reads it from the echo of a turned plate."""
    return [
        Fact(f"R_A of white sheeting, {observation:g} deg of observation, {entrance:g} of entrance", "cd/lx/m²",
             "ASTM D4956-01, type II", "read, copy", printed, retro_cd_lx_m2(140.0, observation, entrance), "computed",
             "140 at 0.2 and 4 deg, falling as type I does; from echo, range, K and the plate's area in the beam",
             why="type II falls faster from 0.2 to 0.5 deg than type I")
        for observation, entrance, printed in ((0.2, 30.0, 60.0), (0.5, 4.0, 50.0), (0.5, 30.0, 28.0))
    ]  # fmt: skip


def retro_cd_lx_m2(named: float, observation_deg: float, entrance_deg: float, range_m: float = 10.0) -> float:
    """Intensity over illuminance and area of a plate of sheeting with the angles of ASTM type I, from its echo."""
    sheet = {"sheet": {"rho": 0.0, "model": "retro", "retro_cd_lx_m2": named, "retro_class": "astm_i"}}
    physics = {
        **AXIS, "noise": False, "floor_reflectance": "off", "full_scale_snr": "off",
        "baseline_mm": 1e3 * range_m * math.tan(math.radians(observation_deg)),
    }  # fmt: skip
    here = sensor("paper-905nm", [wall(range_m, "sheet", entrance_deg)], physics=physics, materials=sheet)
    echo = float(here.view(sweep(np.zeros(1))).echoes.amplitude.sum())
    return echo * range_m**2 / (math.pi * here.model.k_m2) * math.cos(math.radians(entrance_deg))


# ------------------------------------------------------------------------------- leaves
def leaf_facts(effort: Effort) -> list[Fact]:
    """Angles of leaves, and what goes through a layer of them."""
    bonan = "Bonan 2019, Climate Change and Terrestrial Ecosystem Modeling, supplemental program 2.2"
    facts = [
        Fact(f"mean inclination of leaves, {law}", "deg", bonan, "read, source code", printed,
             mean_inclination_deg(law), "computed", "from the densities of de Wit")
        for law, printed in (("planophile", 26.76), ("erectophile", 63.24), ("spherical", 57.30))
    ]  # fmt: skip
    return facts + [
        Fact(f"minus ln of the gaps over the leaf area index at {HINGE_DEG:g} deg, {law}", "1",
             "Baret et al. 2010, Agric. For. Meteorol. 150", "memory", 0.93, gap_depth(law, effort), "computed",
             "\"GAI = -ln(P)/0.93\"; ours: beams through a layer of index 1")
        for law in ("planophile", "erectophile", "spherical")
    ]  # fmt: skip


def mean_inclination_deg(law: str) -> float:
    """Of the density by which leaves are drawn."""
    angle = (np.arange(2000, dtype=np.float64) + 0.5) * (0.5 * math.pi / 2000)
    return math.degrees(float(np.sum(angle * foliage.density_of(law, angle)) * 0.5 * math.pi / 2000))


def gap_depth(law: str, effort: Effort) -> float:
    """Minus the logarithm of the share of beams that pass a layer of leaves of index 1 at the hinge angle."""
    height_m = 40.0
    leaf = {"leaf": {"foliage": {"leaf_area_density_m2_m3": 1.0, "leaf_angle": law, "leaf_reflectance": 0.45}}}
    layer = {"box": {"size_m": [200.0, 200.0, 1.0]}, "at_m": [0.0, 0.0, height_m], "material": "leaf"}
    # a leaf seen nearly from its edge answers as well
    physics = {**AXIS, "noise": False, "floor_reflectance": "off", "weather_echoes": False, "system_constant_m2": 1e8}
    here = sensor("paper-905nm", [layer], physics=physics, materials=leaf)
    up = math.radians(90.0 - HINGE_DEG)
    found = here(sweep(all_round(12_000 // effort.every), elevation_rad=up)).range_m[:, 0]
    return -math.log(float(np.mean(np.isnan(found))))


def facts(effort: Effort) -> list[Fact]:
    """All of them."""
    return [
        *snow_facts(effort), *rain_facts(effort), *receiver_facts(effort), *sky_facts(), *sheeting_facts(),
        *leaf_facts(effort),
    ]  # fmt: skip
