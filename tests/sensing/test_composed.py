"""Terms that meet in one beam, each against an integral that imports nothing of the product's formulas.

Written after the model, as a stranger would: panes in fog, a retroreflector's edge behind rain, wires in fog, two panes
at opposite slants.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.sensing import daylight
from emulator.sensing.measure import Measure
from emulator.sensing.photon_receiver import PhotonReceiver
from protocols.scan import ScanPlan
from tests.sensing.one_particle_at_a_time import Rig, first_echoes
from tests.sensing.particle_cases import named
from tests.sensing.rig import QUIET, Floats, build, plan, plate

LMS, PAPER = "sick-lms291-s05", "paper-905nm"
K_M2, HALF_RAD, WINDOW_M = 45_000.0, 0.0064565, 0.005
LMS_OPTICS: dict[str, Any] = {
    **QUIET, "divergence_deg": math.degrees(2.0 * HALF_RAD), "exit_diameter_mm": 2e3 * WINDOW_M, "echoes": "all",
    "max_echoes": 8,
}  # fmt: skip


def glass(internal: float) -> dict[str, Any]:
    return {"glass": {"rho": 0.0, "model": "glass", "index": 1.5, "internal": internal}}


def pane(x_m: float, thick_m: float = 0.0, yaw_deg: float = 0.0) -> dict[str, Any]:
    if not thick_m:
        return {**plate(x_m, "glass", 40.0, 0.0, 6.0), "yaw_deg": yaw_deg}
    box = {"size_m": [thick_m, 40.0, 6.0]}
    return {"box": box, "at_m": [x_m, 0.0, -3.0], "yaw_deg": yaw_deg, "material": "glass"}


def passed(degrees: float, internal: float, index: float = 1.5) -> float:
    """One pane, one way: both faces and all bounces between them, mean of both polarisations."""
    i = math.radians(degrees)
    t = math.asin(math.sin(i) / index)
    s = ((math.cos(i) - index * math.cos(t)) / (math.cos(i) + index * math.cos(t))) ** 2
    p = ((math.cos(t) - index * math.cos(i)) / (math.cos(t) + index * math.cos(i))) ** 2
    inner = internal ** (1.0 / math.cos(t))
    return float(sum(0.5 * (1.0 - r) ** 2 * inner / (1.0 - (r * inner) ** 2) for r in (s, p)))


def echo(measure: Measure, near_m: float, far_m: float) -> tuple[float, float]:
    """Amplitude and mean range of what comes from there."""
    found = measure.view(plan()).echoes
    here = (found.range_m > near_m) & (found.range_m < far_m)
    amplitude = float(found.amplitude[here].sum())
    return amplitude, float((found.amplitude * found.range_m)[here].sum()) / amplitude


@pytest.mark.parametrize("slant_deg", [0.0, 40.0])
@pytest.mark.parametrize("full", [False, True])
def test_a_wall_behind_a_slanted_pane_in_fog(tmp_path: Path, slant_deg: float, full: bool) -> None:
    world = [pane(6.0, yaw_deg=slant_deg), plate(12.0, "half", 60.0, 0.0, 60.0)]
    fog = {"fog": {"visibility_m": 200.0}}
    measure = build(tmp_path, world, model=LMS, weather=fog, materials=glass(0.9), physics={**LMS_OPTICS, "full": full})
    side = np.linspace(-3.0, 3.0, 801) * HALF_RAD
    off = np.hypot(*np.meshgrid(side, side))
    share = np.exp(-2.0 * (off / HALF_RAD) ** 2)
    far = 12.0 / np.cos(off)
    light = share / share.sum() * 0.5 * np.cos(off) * np.exp(-2.0 * math.log(50.0) / 200.0 * far) / far**2
    expected = K_M2 * float(light.sum()) * passed(slant_deg, 0.9) ** 2
    assert echo(measure, 11.0, 13.0)[0] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("thick_m", [0.0, 0.006])
@pytest.mark.parametrize("full", [False, True])
def test_fog_behind_a_pane_is_dimmed_by_it_and_not_gone(tmp_path: Path, thick_m: float, full: bool) -> None:
    """A sensor at a window: the fog's echo of one with as much less light. It was none before."""
    fog = {"fog": {"visibility_m": 30.0}}
    physics = {**QUIET, "echoes": "all", "max_echoes": 8, "near_gate_m": 0.0, "full": full}
    behind = build(tmp_path, [pane(0.5, thick_m)], model=PAPER, weather=fog, materials=glass(0.5), physics=physics)
    less = behind.model.k_m2 * passed(0.0, 0.5) ** 2
    open_air = build(tmp_path, [], model=PAPER, weather=fog, physics={**physics, "system_constant_m2": less})
    one, other = behind(plan()), open_air(plan())
    assert one.range_m[0] == pytest.approx(other.range_m[0], abs=1e-3, nan_ok=True)
    assert one.intensity[0, 0] == pytest.approx(other.intensity[0, 0], rel=1e-3)


def test_fog_ends_at_the_wall_behind_two_panes(tmp_path: Path) -> None:
    """The last bounce stops all that is left, a mirror what it takes: no light of the air is counted twice."""
    world = [pane(2.0, yaw_deg=20.0), pane(4.0, 0.006, yaw_deg=-20.0), plate(9.0, "half", 60.0, 0.0, 60.0)]
    for bounces in (0, 1, 2):
        physics = {**LMS_OPTICS, "bounces": bounces}
        fog = {"fog": {"visibility_m": 60.0}}
        found = (
            build(tmp_path, world, model=LMS, weather=fog, materials=glass(0.8), physics=physics).view(plan()).echoes
        )
        assert found.blocked.sum() == pytest.approx(1.0, abs=1e-12)
        assert (found.blocked >= 0.0).all()
        first = passed(20.0, 0.8) ** 2
        assert found.blocked[found.range_m < 3.0].sum() == pytest.approx(1.0 - first if bounces else 1.0, rel=0.02)
        if bounces == 2:
            assert found.blocked[found.range_m > 8.0].sum() == pytest.approx(first**2, rel=0.02)


def test_photons_of_fog_behind_a_pane_and_beside_a_wire(tmp_path: Path) -> None:
    """Mean counts of a photon counter: what stands before the fog takes its share of it and no more."""
    fog = {"fog": {"visibility_m": 40.0}}
    physics = {**QUIET, "near_gate_m": 0.0, "photons": {}}
    wire = {"cylinder": {"radius_m": 0.0002, "height_m": 4.0}, "at_m": [0.5, 0.0, -2.0], "material": "dark"}

    def counts(*world: dict[str, Any]) -> Floats:
        measure = build(tmp_path, world, model=PAPER, weather=fog, materials=glass(0.5), physics=physics)
        view, receiver = measure.view(plan()), measure._receiver
        soft = measure._soft.everywhere(view.air, 1.0)
        assert soft is not None
        assert isinstance(receiver, PhotonReceiver)
        return np.asarray(receiver.mean_counts(view.echoes, 0, 1, soft, daylight.NIGHT)[0][0], np.float64)

    clear, paned, wired = counts(), counts(pane(0.5)), counts(wire)
    behind = slice(int(1.0 / 0.15), int(20.0 / 0.15))
    assert paned[behind] == pytest.approx(clear[behind] * passed(0.0, 0.5) ** 2, rel=1e-3)
    width = 0.5 * math.tan(0.5e-3 * 1.22173)
    past = 1.0 - math.erf(math.sqrt(2.0) * 0.0002 / width)
    assert wired[behind].sum() / clear[behind].sum() == pytest.approx(past, abs=0.02)


def test_the_edge_of_a_retroreflector_in_rain(tmp_path: Path) -> None:
    """Its edge 0.7 beam radii off the axis: drops before it flicker, their mean is the law's."""
    range_m, sweeps = 20.0, 24
    width = HALF_RAD * range_m + WINDOW_M
    sheet = {"sheet": {"rho": 0.0, "model": "retro", "retro_cd_lx_m2": 100.0}}
    world = [plate(range_m, "sheet", 60.0, 0.7 * width + 30.0, 60.0)]
    rain = {"rain": {"rate_mm_h": 20.0}}
    measure = build(tmp_path, world, model=LMS, weather=rain, materials=sheet, physics=LMS_OPTICS)
    light = []
    for number in range(sweeps):
        found = measure.view(plan(sweep=number, start_s=5.0 * number)).echoes
        light.append(found.amplitude[found.range_m > 19.5].sum())
    alpha = 1.076 * 20.0**0.67 * math.log(10.0) / 1e4 + math.log(50.0) / 23_000.0 * (905.0 / 550.0) ** -1.3
    share = 0.5 * math.erfc(1.4 / math.sqrt(2.0))
    expected = K_M2 * math.pi * 100.0 * share * math.exp(-2.0 * alpha * range_m) / range_m**2
    spread = float(np.std(light)) / math.sqrt(sweeps)
    assert np.mean(light) == pytest.approx(expected, abs=4.0 * spread + 0.002 * expected)


def test_a_wire_in_fog(tmp_path: Path) -> None:
    """Lambert, thinner than a fifth of the beam: the mean over its places in the beam."""
    range_m, radius_m, off_deg = 15.0, 0.015, np.linspace(-0.35, 0.35, 15)
    wire = {"cylinder": {"radius_m": radius_m, "height_m": 8.0}, "at_m": [range_m, 0.0, -4.0], "material": "half"}
    physics = {**LMS_OPTICS, "sub_beams": 1024}
    measure = build(tmp_path, [wire], model=LMS, weather={"fog": {"visibility_m": 100.0}}, physics=physics)
    found = measure.view(plan(off_deg)).echoes
    width = HALF_RAD * range_m + WINDOW_M
    across = np.linspace(-radius_m, radius_m, 2001)
    expected = 0.0
    for beside in range_m * np.radians(off_deg):
        share = math.sqrt(2.0 / math.pi) / width * np.exp(-2.0 * ((across + beside) / width) ** 2)
        chord = np.sqrt(np.maximum(1.0 - (across / radius_m) ** 2, 0.0))
        far = range_m - radius_m * chord
        light = 0.5 * share * chord * np.exp(-2.0 * math.log(50.0) / 100.0 * far) / far**2
        expected += K_M2 * float(light.sum()) * (across[1] - across[0])
    assert float(found.amplitude.sum()) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("slant_deg", "thick_m"), [(30.0, 0.01), (50.0, 0.04)])
def test_two_panes_at_opposite_slants(tmp_path: Path, slant_deg: float, thick_m: float) -> None:
    """Their shifts cancel, their delays add."""
    clear, physics = {"visibility_m": 1e9}, {**QUIET, "rule": "axis", "echoes": "all", "max_echoes": 8}
    wall = plate(20.0, "white")
    both = [pane(6.0, thick_m, slant_deg), pane(10.0, thick_m, -slant_deg), wall]
    alone = echo(build(tmp_path, [wall], weather=clear, physics=physics), 19.5, 20.5)
    behind = echo(build(tmp_path, both, weather=clear, physics=physics, materials=glass(0.95)), 19.5, 20.5)
    assert behind[0] / alone[0] == pytest.approx(passed(slant_deg, 0.95) ** 4, rel=0.01)
    i = math.radians(slant_deg)
    delay_m = 2.0 * thick_m * (math.sqrt(1.5**2 - math.sin(i) ** 2) - math.cos(i))
    assert behind[1] - alone[1] == pytest.approx(delay_m, abs=1e-6)


def counted_one_by_one(rate_per_ns: Floats, shots: int, dead_ns: float, filled: float, trap_ns: float) -> Floats:
    """Histogram of a photon counter, event by event: photons, dead time, traps that free a carrier once, by ns."""
    rng, last = np.random.default_rng(8), len(rate_per_ns)
    below = np.concatenate([[0.0], rate_per_ns.cumsum()])
    counts = np.zeros(last)
    for _ in range(shots):
        photons = np.sort(np.interp(below[-1] * rng.random(rng.poisson(below[-1])), below, np.arange(last + 1.0)))
        ready_ns, freed_ns, at = 0.0, math.inf, 0
        while True:
            at += int(np.searchsorted(photons[at:], ready_ns))
            photon_ns = photons[at] if at < len(photons) else math.inf
            now_ns = min(photon_ns, freed_ns)
            if now_ns >= last:
                break
            counts[int(now_ns)] += 1.0
            if freed_ns <= now_ns:
                freed_ns = math.inf
            ready_ns = now_ns + dead_ns
            if rng.random() < filled:
                freed_ns = min(freed_ns, now_ns + rng.exponential(trap_ns))
            if freed_ns < ready_ns:  # released while blind: lost
                freed_ns = math.inf
    return counts


def test_afterpulses_of_the_fog_behind_a_pane(tmp_path: Path) -> None:
    """A counter with dead time and traps looks through a pane into fog: its histogram, against one event by event."""
    shots, dead_ns, filled, trap_ns = 12_000, 25.3, 0.3, 40.0
    photons = {
        "shots": shots, "bin_ns": 1.0, "dead_time_ns": dead_ns, "afterpulse_probability": filled,
        "trap_time_ns": trap_ns, "dark_count_hz": 2e5,
    }  # fmt: skip
    physics = {**QUIET, "near_gate_m": 0.0, "gate_m": 60.0, "photons": photons, "system_constant_m2": 12.0}
    world = [pane(0.5), plate(18.0, "white")]
    fog = {"fog": {"visibility_m": 60.0}}
    measure = build(tmp_path, world, model=PAPER, weather=fog, materials=glass(0.7), physics=physics)
    view, receiver = measure.view(plan()), measure._receiver
    assert isinstance(receiver, PhotonReceiver)
    soft = measure._soft.everywhere(view.air, 1.0)
    signal, hertz = receiver.mean_counts(view.echoes, 0, 1, soft, daylight.NIGHT)
    generator = np.random.default_rng(1)
    found = receiver._histogram(view.echoes, 0, 1, soft, daylight.NIGHT, generator)[0][0]
    expected = counted_one_by_one(signal[0] + 1e-9 * float(hertz[0]), shots, dead_ns, filled, trap_ns)
    assert 0.5 < signal.sum() < 20.0
    blocks = np.arange(0, len(found) - 20, 20)
    ours, theirs = np.add.reduceat(found, blocks), np.add.reduceat(expected, blocks)
    assert np.abs(ours - theirs).max() < 4.5 * np.sqrt(theirs.max())
    assert (np.abs(ours - theirs) < 4.5 * np.sqrt(np.maximum(theirs, 10.0)) + 0.03 * theirs).all()


def test_flakes_in_an_elliptical_beam_of_four_layers_behind_a_near_gate(tmp_path: Path) -> None:
    """An MRS1104 with a window of 16 mm: as many answers as flakes one at a time in a round beam of the same area."""
    near_m = 2.0
    physics = {**QUIET, "floor_reflectance": 0.004, "near_gate_m": near_m, "exit_diameter_mm": 16.0, "echoes": "first"}
    snow = {"snow": {"rate_mm_h": 5.0, "kind": "dry"}}
    measure = build(tmp_path, model="sick-mrs1104", weather=snow, physics=physics)
    model = measure.model
    azimuth, elevation = (
        one.ravel()
        for one in np.meshgrid(np.radians(np.arange(-100.0, 100.0, 2.0)), np.radians([-3.0, -1.0, 1.0, 3.0]))
    )
    found = []
    for number in range(3):
        zero = np.zeros(len(azimuth))
        sweep = ScanPlan(0, number, number * 20 * 10**9, azimuth, elevation, zero, max_echoes=1)
        found.append(measure(sweep).range_m[:, 0])
    flakes = named("particles_sum", "sick-ld-lrs1000 w0 10 mm gauss floor 0.004, dry snow 5")[0]["setup"]

    class Elliptical(Rig):
        def width(self, r: Floats) -> Floats:
            return np.asarray(np.sqrt((7.4e-3 * r + 8e-3) * (5.2e-3 * r + 8e-3)))

    rig = Elliptical(
        model.k_m2, 0.0, 0.0, True, 5.0, 0.004, model.overlap_start_m, model.overlap_full_m, near_m,
        299792458.0 * model.pulse.fwhm_s, flakes["n0_m3_mm"], flakes["slope_mm"], flakes["kappa_sr"],
        flakes["extinction_per_m"],
    )  # fmt: skip
    ours, theirs = np.isfinite(found), np.isfinite(first_echoes(rig, 1000, 10.0, seed=5))
    p = float(theirs.mean())
    spread = math.sqrt(p * (1.0 - p) * (1.0 / ours.size + 1.0 / theirs.size))
    assert 0.05 < p < 0.2
    assert ours.mean() == pytest.approx(p, abs=4.0 * spread)
