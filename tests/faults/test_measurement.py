"""Faults behind the receiver as hosts read them, and that nothing of them stays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from emulator.hosts.scans import HostScan
from emulator.judging.trial import Trial
from emulator.scenario import scenario
from protocols.scan import DetectedObject
from tests.faults.runs import BEGIN_S, END_S, HEAD, Sent, heals, run, same

Pair = Callable[[HostScan, HostScan], bool]


def near(one: np.ndarray, other: np.ndarray, by: float = 0.0011) -> bool:
    """Equal to a millimetre, the step of the wire."""
    return bool(np.allclose(one, other, atol=by, equal_nan=True))


def inside(scan: HostScan, from_deg: float, to_deg: float) -> np.ndarray:
    azimuth = np.degrees(scan.azimuth_rad)
    return (azimuth >= from_deg - 1e-6) & (azimuth <= to_deg + 1e-6)


def only_within(faulty: HostScan, healthy: HostScan, from_deg: float, to_deg: float) -> bool:
    out = ~inside(faulty, from_deg, to_deg)
    return near(faulty.range_m[out], healthy.range_m[out])


CASES: dict[str, tuple[str, Pair]] = {
    "stuck_beams": (
        "do: stuck_beams, from_deg: 10, to_deg: 20, range_m: 1.5",
        lambda a, b: bool(np.all(a.range_m[inside(a, 10, 20)] == 1.5)) and only_within(a, b, 10, 20),
    ),
    "dead_beams": (
        "do: dead_beams, from_deg: -20, to_deg: 5",
        lambda a, b: bool(np.all(np.isnan(a.range_m[inside(a, -20, 5)]))) and only_within(a, b, -20, 5),
    ),
    "range_offset": ("do: range_offset, offset_m: -0.25", lambda a, b: near(a.range_m, b.range_m - 0.25)),
    "range_scale": (
        "do: range_scale, factor: 0.9, from_deg: 0, to_deg: 50",
        lambda a, b: near(a.range_m[inside(a, 0, 50)], 0.9 * b.range_m[inside(a, 0, 50)]) and only_within(a, b, 0, 50),
    ),
    "quantised": (
        "do: quantised, step_m: 0.5",
        lambda a, b: (
            near(a.range_m, np.round(a.range_m / 0.5) * 0.5)
            and bool(np.nanmax(np.abs(a.range_m - b.range_m)) <= 0.2511)
        ),
    ),
    "stuck_bits": (
        "do: stuck_bits, bit: 6, level: 1, step_m: 0.01",
        lambda a, b: bool(np.all(np.rint(a.range_m[~np.isnan(a.range_m)] * 100).astype(int) & 64)),
    ),
    "frozen_scan": ("do: frozen_scan", lambda a, b: True),
}


@pytest.mark.parametrize("name", CASES)
def test_a_fault_of_numbers_shows_on_the_wire_and_its_end(name: str) -> None:
    fault, shows = CASES[name]
    faulty, healthy = run(fault), run()
    pairs = faulty.pairs(healthy)
    assert len(pairs) > 8
    assert all(shows(a, b) for a, b in pairs)
    assert name == "frozen_scan" or not any(same(a, b) for a, b in pairs)
    assert heals(faulty, healthy)


def test_a_noise_burst_scatters_as_told_and_again_in_the_same_way() -> None:
    fault = "do: noise_burst, sigma_m: 0.2, share: 0.5"
    faulty, healthy = run(fault), run()
    off = np.concatenate([a.range_m - b.range_m for a, b in faulty.pairs(healthy)])
    off = off[~np.isnan(off)]
    hit = np.abs(off) > 0.002
    assert np.mean(hit) == pytest.approx(0.5, abs=0.05)
    assert np.std(off[hit]) == pytest.approx(0.2, rel=0.1)
    assert heals(faulty, healthy)
    run.cache_clear()
    assert run(fault).sha256 == faulty.sha256


def test_a_share_of_dead_beams_stays_the_same_for_as_long_as_it_lasts() -> None:
    faulty, healthy = run("do: dead_beams, share: 0.3"), run()
    dead = {tuple(np.flatnonzero(np.isnan(a.range_m) & ~np.isnan(b.range_m))) for a, b in faulty.pairs(healthy)}
    assert len(dead) == 1
    assert 15 < len(next(iter(dead))) < 45
    assert heals(faulty, healthy)


def test_a_frozen_picture_stands_while_the_world_moves_on() -> None:
    more = "  - {id: cart, shape: {box: {size_m: [1, 1, 2]}}, material: white_plaster, motion: MOTION}\n".replace(
        "MOTION", "{at_m: [1.5, 2, 0], velocity_m_s: [1, 0, 0]}"
    )
    faulty, healthy = run("do: frozen_scan", more=more, quiet=False), run(more=more, quiet=False)
    held = faulty.part(BEGIN_S, END_S)
    assert all(same(scan, held[0]) for scan in held)
    assert not same(*(healthy.part(BEGIN_S, END_S)[k] for k in (0, -1)))
    last = healthy.part(0.0, BEGIN_S)[-1]
    assert np.mean(np.abs(held[0].range_m - last.range_m) < 0.1) > 0.95  # other noise, the same picture
    assert heals(faulty, healthy)


def test_ranges_drift_as_the_device_warms_up() -> None:
    fault = "do: range_drift, m_per_k: 0.01, warms_k: 20, time_constant_s: 0.2"
    faulty, healthy = run(fault), run()
    for sweep, (at_ns, scan) in faulty.scans.items():
        since_s = at_ns * 1e-9 - BEGIN_S
        if 0.0 <= since_s < END_S - BEGIN_S:
            grown = 0.2 * (1.0 - np.exp(-since_s / 0.2))
            assert near(scan.range_m, healthy.scans[sweep][1].range_m + grown)
    assert heals(faulty, healthy)


def test_wrong_intensities_leave_the_ranges() -> None:
    faulty, healthy = run("do: wrong_intensity, factor: 0.5", on="top"), run(on="top")
    assert all(np.array_equal(a.range_m, b.range_m, equal_nan=True) for a, b in faulty.pairs(healthy, 0.0))
    words, good = faulty.echoes(), healthy.echoes()
    hit = [sweep for sweep, (at_ns, _) in faulty.scans.items() if BEGIN_S <= at_ns * 1e-9 < END_S]
    assert len(hit) > 4
    for sweep, reported in words.items():
        factor = 0.5 if sweep in hit else 1.0
        whole = good[sweep] < 65535.0
        assert reported[whole] == pytest.approx(factor * good[sweep][whole], abs=1.0)


def test_a_fault_by_chance_holds_in_some_sweeps() -> None:
    text = "do: range_offset, offset_m: 1.0, probability: 0.4"
    faulty, healthy = run(text), run()
    hit = [not same(a, b) for a, b in faulty.pairs(healthy)]
    assert 2 <= sum(hit) < len(hit)
    assert heals(faulty, healthy)


# ------------------------------------------------------------------------------- object lists

LISTS = (
    HEAD.replace("1.1", "1.7")
    + """\
world:
  - {plane: {size_m: [200, 200]}, at_m: [0, 0, 0], material: asphalt}
actors:
  - {id: near, shape: {box: {size_m: [4, 1.8, 1.5]}}, material: white_plaster, class: car, motion: {at_m: [12, 3, 0]}}
  - {id: far, shape: {box: {size_m: [4, 1.8, 1.5]}}, material: white_plaster, class: car, motion: {at_m: [20, -4, 0]}}
sensors:
  - {id: beam, model: sick-ld-lrs1000, device: {delays: fast}, mount: {at_m: [0, 0, 0.8]}}
  - {id: radar, model: can-ars408, from: [beam], mount: {at_m: [0, 0, 0.5]}, links: ["can:virtual:x"]}
"""
)


Lists = dict[int, tuple[DetectedObject, ...]]


def lists(fault: str = "") -> tuple[Lists, list[tuple[int, bytes, int]]]:
    """Lists by the instant in ns, and the frames on the bus."""
    text = LISTS
    if fault:
        text += f"faults:\n  - {{on: radar, at_s: 0.8, for_s: 0.5, {fault}}}\n"
    watcher = Sent()
    trial = Trial(scenario.loads(text, Path("case.yaml")), watchers=[watcher])
    trial.finish()
    trial.close()
    measured = trial.series.sensors["radar"].measured.values()
    frames = [(one.start_ns, one.data, one.peer) for one in watcher.payloads if one.sensor == "radar"]
    return {one.at_ns: one.objects for one in measured}, frames


@pytest.fixture(scope="module")
def healthy_lists() -> tuple[Lists, list[tuple[int, bytes, int]]]:
    found = lists()
    assert {len(items) for at_ns, items in found[0].items() if at_ns > 0.7e9} == {2}
    return found


def counted(frames: list[tuple[int, bytes, int]], from_s: float, to_s: float) -> set[int]:
    """Number of objects that list headers (0x60A) tell."""
    return {data[0] for at_ns, data, peer in frames if peer == 0x60A and from_s < at_ns * 1e-9 < to_s}


@pytest.mark.parametrize(
    ("fault", "count"),
    [
        ("do: ghost_object, x_m: 6.0, vx_m_s: 1.0", 3),
        ("do: lost_object", 1),
        ("do: lost_object, actor: far", 1),
        ("do: swapped_ids", 2),
        ("do: frozen_list", 2),
    ],
)
def test_a_fault_of_lists_shows_on_the_bus_and_its_end(
    fault: str, count: int, healthy_lists: tuple[Lists, list[tuple[int, bytes, int]]]
) -> None:
    made, frames = lists(fault)
    healthy, good = healthy_lists
    assert counted(frames, 0.9, 1.3) == {count}
    held = {at_ns: items for at_ns, items in made.items() if 0.8e9 <= at_ns < 1.3e9}
    assert len(held) > 5
    for at_ns, items in made.items():
        if at_ns not in held:
            assert items == healthy[at_ns]
        elif "ghost" in fault:
            ghost = items[-1]
            assert items[:-1] == healthy[at_ns]
            assert ghost.position_m[0] == pytest.approx(6.0 + (at_ns * 1e-9 - 0.8))
        elif "lost" in fault:
            gone = {"far"} if "far" in fault else {"near"}
            assert {one.actor for one in items} == {"near", "far"} - gone
        elif "swapped" in fault:
            tracks = {one.actor: one.track for one in healthy[at_ns]}
            assert {one.actor: one.track for one in items} == {"near": tracks["far"], "far": tracks["near"]}
        else:
            assert items == next(iter(held.values()))
    tail = [(data, peer) for at_ns, data, peer in frames if at_ns > 1.45e9 and peer in (0x60A, 0x60B)]
    expected = [(data, peer) for at_ns, data, peer in good if at_ns > 1.45e9 and peer in (0x60A, 0x60B)]
    if "swapped" in fault:  # identities on the bus follow tracks: they come back with the lists
        assert len(tail) == len(expected)
    elif "ghost" not in fault and "lost" not in fault:
        assert tail == expected
