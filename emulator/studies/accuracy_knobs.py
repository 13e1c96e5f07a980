"""What other settings cost and give: bin width, fog nodes, instants of a sweep, threads, points.

Belongs here: one table a setting. Not: rules for sub-beams (accuracy_rules, accuracy_path), terms left out
(accuracy_leaving).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from emulator.physics import pulse, softtarget
from emulator.physics.arrays import Floats
from emulator.physics.constants import SPEED_OF_LIGHT_M_S
from emulator.physics.detection import detect
from emulator.physics.detector import Detector, Method
from emulator.physics.pulse import Pulse
from emulator.physics.subechoes import SubEchoes
from emulator.process.clock import SystemClock
from emulator.scenario import scenario
from emulator.scenario.scenario import Scenario
from emulator.sensing.measure import Measure
from emulator.sensing.measure import build as build_measure
from emulator.studies import points
from emulator.studies.accuracy_path import CountingCaster
from emulator.studies.points import LMS291
from emulator.studies.report import Column, Table, Value
from emulator.studies.stage import Stage, plate
from emulator.world import scene
from protocols.scan import Scan, ScanPlan

FWHM_S = 16e-9
BINS_NS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
PHASES = 64
THRESHOLD_OF_PEAK = 0.1
FOG_NODES = (2, 4, 6, 8, 10, 12, 16)
STEPS = (1, 2, 4, 8, 16, 32, 64, 361)
SPEED_M_S = 30.0
PLATE_M = 1.75
PLATE_AT_M = (10.0, 20.0, 40.0)


# ------------------------------------------------------------------------------- bin width
def bins() -> Table:
    """Range error by the step of a sampled pulse: what samples alone give, and the product's detector."""
    rows: list[tuple[Value, ...]] = []
    for bin_ns in BINS_NS:
        peak, edge = plain_samples(bin_ns)
        rows.append((bin_ns, 1e3 * peak, 1e3 * edge, *(1e3 * product_error(bin_ns, method) for method in METHODS)))
    return Table(
        "accuracy_bins",
        "Bin width: largest range error over all phases, sin^2 pulse of 16 ns (mm)",
        (
            Column("bin_ns", "bin (ns)", ".2f"),
            Column("samples_peak_mm", "parabola through samples", ".3f"),
            Column("samples_edge_mm", "edge, linear between samples", ".2f"),
            Column("product_peak_mm", "product: peak", ".2g"),
            Column("product_edge_mm", "product: leading edge", ".2g"),
            Column("product_centroid_mm", "product: centroid", ".2g"),
        ),
        tuple(rows),
        "Orders 3 and 2 for what samples alone tell. The product, here with every cluster sampled and against the true "
        "range, knows which pulses are under way at a sample: crossings and maxima of one cosine have a closed form.",
    )


METHODS: tuple[Method, ...] = ("peak", "leading_edge", "centroid")


def plain_samples(bin_ns: float) -> tuple[float, float]:
    """Largest error of a parabola's vertex and of a linear crossing at a tenth, over `PHASES` phases. [m]"""
    wave, step = Pulse(FWHM_S), 0.5e-9 * SPEED_OF_LIGHT_M_S * bin_ns
    reach = math.ceil(2.0 * wave.half_support_m / step) + 2
    place = step * (np.arange(PHASES) + 0.5) / PHASES
    x = step * np.arange(-reach, reach + 1)
    value = wave.profile(x - place[:, None])
    row, top = np.arange(PHASES), np.argmax(value, axis=1)
    a, b, c = (value[row, top + k] for k in (-1, 0, 1))
    peak = x[top] + 0.5 * step * (a - c) / (a - 2.0 * b + c) - place
    at = np.argmax(value >= THRESHOLD_OF_PEAK, axis=1)
    low, high = value[row, at - 1], value[row, at]
    crossing = x[at - 1] + step * (THRESHOLD_OF_PEAK - low) / (high - low)
    exact = float(pulse.walk_sin2(FWHM_S, 1.0 / THRESHOLD_OF_PEAK)) - wave.start_lead_m
    return float(np.max(np.abs(peak))), float(np.max(np.abs(crossing - place - exact)))


def product_error(bin_ns: float, method: Method) -> float:
    """Largest range error of two equal echoes 10 mm apart, all sampled so, against their middle. [m]

    Where both are under way their sum is one pulse about the middle, which the walk table sets right for any method.
    """
    wave, step = Pulse(FWHM_S), 0.5e-9 * SPEED_OF_LIGHT_M_S * bin_ns
    middle = 30.0 + step * (np.arange(PHASES) + 0.5) / PHASES
    beam = np.repeat(np.arange(PHASES), 2)
    place = (middle[:, None] + np.array([-0.005, 0.005])).ravel()
    echoes = SubEchoes.of(beam, place, np.full(2 * PHASES, 25.0))
    detector = Detector(
        wave, 5.0, method=method, resolution_m=0.001, bin_s=1e-9 * bin_ns, sampled=True, walk_table=True
    )
    return float(np.max(np.abs(detect(echoes, PHASES, detector).range_m[:, 0] - middle)))


# ------------------------------------------------------------------------------- fog
def fog() -> Table:
    """Error of the fog integral by the number of nodes, against its closed form."""
    x = np.linspace(1.0, 60.0, 400)
    rows: list[tuple[Value, ...]] = []
    for nodes in FOG_NODES:
        rows.append((nodes, *(fog_error(x, visibility, nodes) for visibility in (20.0, 40.0, 200.0))))
    return Table(
        "accuracy_fog",
        "Fog: largest error over the largest return",
        (
            Column("nodes", "nodes", "d"),
            *(Column(f"error_{v}_m", f"visibility {v} m", ".1e") for v in (20, 40, 200)),
        ),
        tuple(rows),
        "Nodes of Gauss-Legendre in ln r on both sides of the full overlap. The product uses the closed form; the "
        "nodes serve media without one.",
    )


def fog_error(x_m: Floats, visibility_m: float, nodes: int) -> float:
    """Largest error over the largest value, overlap from 0.9 m to 1 m."""
    alpha = math.log(20.0) / visibility_m
    exact = softtarget.fog_shape(x_m, alpha, 0.9, 1.0, 250.0, FWHM_S)
    found = softtarget.fog_shape_nodes(x_m, alpha, 0.9, 1.0, 250.0, FWHM_S, nodes)
    return float(np.max(np.abs(found - exact)) / np.max(exact))


# ------------------------------------------------------------------------------- instants of a sweep
def steps() -> Table:
    """Range error when a sweep of 13.3 ms is computed for so many instants rather than one for each beam."""
    stage = Stage(plate(200.0, 200.0, 0.5), "sick-lms291-s05", physics={"noise": False})
    rows: list[tuple[Value, ...]] = []
    exact, _ = _at_instants(stage, 361, None)
    for count in STEPS:
        found, seconds = _at_instants(stage, 361, count)
        bound = SPEED_M_S * 0.01333 / count if count < 361 else 0.0
        rows.append((count, float(np.nanmax(np.abs(found - exact))), bound, 1e6 * seconds / 361))
    return Table(
        "accuracy_steps",
        "Instants of a sweep: wall leaving at 30 m/s, 361 beams in 13.3 ms",
        (
            Column("instants", "instants", "d"),
            Column("range_error_m", "range error (m)", ".2e"),
            Column("bound_m", "speed times interval (m)", ".2e"),
            Column("us_per_beam", "us/beam", ".1f"),
        ),
        tuple(rows),
        "The product gives every beam its own instant: nothing is saved by fewer, because moving bodies are not "
        "rebuilt; rays are turned into their frame one by one.",
    )


def _at_instants(stage: Stage, n: int, count: int | None) -> tuple[Floats, float]:
    """Ranges of n beams at 20 m on, and seconds; every beam fires at the first of its interval's instants."""
    offset = 0.01333 * np.arange(n) / n
    if count is not None:
        offset = 0.01333 * np.floor(offset / 0.01333 * count + 1e-9) / count
    # the stage's target leaves at 1 m/s: time runs at its speed
    at = 20.0 + SPEED_M_S * offset
    stage.scan(at)
    clock = SystemClock()
    scan = stage.scan(at)
    return scan.range_m[:, 0], 1e-9 * clock.now_ns()


# ------------------------------------------------------------------------------- threads
def sweep_of(measure: Measure, sweep: int, step_deg: float = 0.5) -> Scan:
    """180 degrees at this step, a sweep of an LMS291."""
    azimuth = np.radians(np.arange(-90.0, 90.0 + 0.5 * step_deg, step_deg))
    n = len(azimuth)
    zero = np.zeros(n)
    return measure(ScanPlan(0, sweep, 20_000_000 * sweep, azimuth, zero, 0.01333 * np.arange(n) / n))


def built(loaded: Scenario, sensor: str, physics: dict[str, object] | None = None) -> tuple[Measure, CountingCaster]:
    """The measuring function of one sensor of a scenario; with `physics` without noise and with these choices."""
    if physics is not None:
        physics = {"noise": False, **physics}
        sensors = tuple(
            one.model_copy(update={"physics": one.physics.model_copy(update=physics)}) for one in loaded.sensors
        )
        loaded = loaded.model_copy(update={"sensors": sensors})
    world = scene.build(loaded)
    caster = CountingCaster(world)
    return build_measure(loaded, world, caster, sensor), caster


def threads(sweeps: int) -> Table:
    """Time for sweeps of the street by so many threads, each with its own measuring function."""
    loaded = scenario.load("street")
    sensor = loaded.sensors[0].id
    each = [built(loaded, sensor)[0] for _ in range(4)]
    alone: list[Scan] = []
    rows: list[tuple[Value, ...]] = []
    for count in (1, 2, 4):
        for measure in each[:count]:
            sweep_of(measure, 0)
        clock = SystemClock()
        with ThreadPoolExecutor(count) as pool:
            parts = list(pool.map(partial(_sweeps, each, count, sweeps), range(count)))
        seconds = 1e-9 * clock.now_ns()
        found = [parts[sweep % count][sweep // count] for sweep in range(sweeps)]
        alone = alone or found
        same = all(np.array_equal(a.range_m, b.range_m, equal_nan=True) for a, b in zip(alone, found, strict=True))
        rows.append((count, 1e3 * seconds / sweeps, same))
    return Table(
        "accuracy_threads",
        "Threads: a sweep of 361 beams of the street",
        (
            Column("threads", "threads", "d"),
            Column("ms_per_sweep", "ms/sweep", ".1f"),
            Column("same", "same scans as one thread", ""),
        ),
        tuple(rows),
        "Numbers are keyed by scenario, sensor, sweep and beam, so the order of computing changes nothing. The daemon "
        "measures in processes of its own rather than threads.",
    )


def _sweeps(each: Sequence[Measure], count: int, sweeps: int, thread: int) -> list[Scan]:
    return [sweep_of(each[thread], number) for number in range(thread, sweeps, count)]


# ------------------------------------------------------------------------------- points
def point_counts(rules: Sequence[str], counts: Sequence[int], phases: int) -> Table:
    """Mean number of points on a plate by rule and sub-beams, against the closed form."""
    rows: list[tuple[Value, ...]] = []
    for rule in rules:
        for count in counts:
            chosen = {"rule": rule, "sub_beams": count}
            stage = Stage(plate(PLATE_M, 4.0, 0.5), LMS291.model, physics={"noise": False, "full": True, **chosen})
            off = [point_error(stage, range_m, phases) for range_m in PLATE_AT_M]
            rows.append((rule, count, max(abs(one) for one in off), *off))
    return Table(
        "accuracy_points",
        "Mean number of points on a plate of 1.75 m, LMS291: off the closed form",
        (
            Column("rule", "rule"),
            Column("sub_beams", "sub-beams", "d"),
            Column("worst", "worst", ".3f"),
            *(Column(f"off_{r:g}_m", f"at {r:g} m", "+.3f") for r in PLATE_AT_M),
        ),
        tuple(rows),
        f"Mean of {phases} positions of the beam grid. The plate has 4 m height.",
    )


def point_error(stage: Stage, range_m: float, phases: int) -> float:
    """Mean number of points off the closed form."""
    model, alpha = stage.measure.model, stage.extinction_per_m
    wanted = points.expected_points(model, alpha, LMS291, PLATE_M, 0.5, np.array([range_m]))[0]
    return points.mean_points(stage, LMS291, range_m, 0.5 * PLATE_M, phases) - float(wanted)
