"""Photon counters that are blind after a count: closed forms, and photons one at a time (drawn here)."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.physics import dead_time
from emulator.physics.dead_time import DeadTime

CASES = json.loads((Path(__file__).parent / "data" / "joins_receiver.json").read_text(encoding="utf-8"))
SPAD = [case for case in CASES if case["kind"] == "spad"]


def one_at_a_time(rate: float, dead: float, *, paralysable: bool, trap: tuple[float, float], gate: float, shots: int) -> np.ndarray:  # noqa: E501 # fmt: skip
    """Counts of each shot; lengths in bins. In all shots at once: each takes its next photon, or its trap's release."""
    rng, counts, shot = np.random.default_rng(3), np.zeros(shots), np.arange(shots)
    number = rng.poisson(rate * gate, shots)
    arrivals = rng.uniform(0.0, gate, (shots, number.max() + 1))
    arrivals[np.arange(number.max() + 1) >= number[:, None]] = np.inf
    arrivals.sort(axis=1)
    taken, ready, release = np.zeros(shots, np.int64), np.zeros(shots), np.full(shots, np.inf)
    while True:
        photon = arrivals[shot, taken]
        t = np.minimum(photon, release)
        on = t < gate
        if not on.any():
            return counts
        released = on & (release < photon)
        release[released] = np.inf
        taken += on & ~released
        counted = on & (t >= ready)
        counts += counted
        heard = counted | (on & ~released) if paralysable else counted
        ready[heard] = t[heard] + dead
        trapped = counted & (rng.uniform(size=shots) < trap[0])
        release[trapped] = (t + rng.exponential(trap[1], shots))[trapped]


@pytest.mark.parametrize("case", SPAD, ids=lambda case: case["name"])
def test_closed_forms_of_steady_light(case: dict[str, Any]) -> None:
    given, expected = case["setup"], case["expected"]
    r, d = given["rate_hz"], given["dead_time_s"]
    p, t = given["afterpulse_probability"], given["trap_time_s"]
    assert float(dead_time.rate_non_paralysable(r, d)) == pytest.approx(expected["rate_non_paralysable_hz"], rel=1e-8)
    assert float(dead_time.rate_paralysable(r, d)) == pytest.approx(expected["rate_paralysable_hz"], rel=1e-8)
    after = float(dead_time.afterpulse_after_dead_time(p, d, t))
    assert after == pytest.approx(expected["afterpulse_after_dead_time"], rel=1e-8)
    assert float(dead_time.rate_with_afterpulses(r, d, p, t)) == pytest.approx(expected["rate_with_afterpulses_hz"], rel=1e-8)  # noqa: E501 # fmt: skip
    assert float(dead_time.fano_non_paralysable(r, d)) == pytest.approx(expected["fano_non_paralysable"], rel=1e-8)
    peak = float(dead_time.rate_paralysable(1.0 / d, d))
    assert peak == pytest.approx(expected["peak_rate_paralysable_hz"], rel=1e-8)


@pytest.mark.parametrize("dead", [3.0, 7.4, 40.0])
@pytest.mark.parametrize("rate", [0.002, 0.02])
def test_the_chain_over_bins_tends_to_both_laws(rate: float, dead: float) -> None:
    light = np.full((1, 2000), rate)
    live = DeadTime(dead).histogram(light, 1, None)[0, 1000:].mean()
    assert live == pytest.approx(rate / (1.0 + rate * dead), rel=3e-4)
    live = DeadTime(dead, paralysable=True).histogram(light, 1, None)[0, 1000:].mean()
    assert live == pytest.approx(rate * math.exp(-rate * dead), rel=3e-4)


@pytest.mark.parametrize("paralysable", [False, True])
@pytest.mark.parametrize("trap", [(0.0, 1.0), (0.5, 30.0)])
def test_drawn_counts_have_the_mean_and_the_spread_of_photons_drawn_one_at_a_time(
    paralysable: bool, trap: tuple[float, float]
) -> None:
    rate, dead, gate, beams = 0.03, 12.5, 500, 1500
    chain = DeadTime(dead, paralysable, 1, *trap)
    drawn = chain.histogram(np.full((beams, gate), rate), 1, np.random.default_rng(1)).sum(axis=1)
    mean = float(chain.histogram(np.full((1, gate), rate), 1, None).sum())
    alone = one_at_a_time(rate, dead, paralysable=paralysable, trap=trap, gate=gate, shots=1500)
    error = math.hypot(alone.std(), drawn.std()) / math.sqrt(1500)
    assert float(drawn.mean()) == pytest.approx(float(alone.mean()), abs=4.0 * error + 0.004 * float(alone.mean()))
    assert mean == pytest.approx(float(drawn.mean()), abs=4.0 * error)
    assert float(drawn.var()) == pytest.approx(float(alone.var()), rel=0.17)
    if trap[0] == 0.0 and not paralysable:
        fano = float(drawn.var() / drawn.mean())
        assert fano == pytest.approx(float(dead_time.fano_non_paralysable(rate, dead)), rel=0.12)


def test_a_photomultiplier_fills_up_as_the_law_of_cells_says() -> None:
    light = np.zeros((1, 10))
    for n in (1.0, 50.0, 400.0):
        light[0, 3] = n
        fired = float(DeadTime(20.0, cells=100).histogram(light, 1, None).sum())
        assert fired == pytest.approx(float(dead_time.cells_fired(n, 100)), rel=1e-9)
    many = DeadTime(20.0, cells=100).histogram(np.repeat(light, 4000, axis=0), 1, np.random.default_rng(0)).sum(axis=1)
    p = -math.expm1(-4.0)
    assert many.mean() == pytest.approx(100.0 * p, rel=2e-3)
    assert many.var() == pytest.approx(100.0 * p * (1.0 - p), rel=0.12)


def test_a_first_flash_hides_a_second_until_the_dead_time_is_over() -> None:
    light = np.zeros((1, 60))
    light[0, [10, 25, 50]] = 50.0
    counts = DeadTime(20.0).histogram(light, 1000, None)[0]
    assert counts[10] == pytest.approx(1000.0, rel=1e-9)
    assert counts[25] < 1e-6
    assert counts[50] == pytest.approx(1000.0, rel=1e-9)
    longer = DeadTime(26.0, paralysable=True).histogram(light, 1000, None)[0]
    assert longer[50] < 1e-6, "the photon that was not counted prolonged it"
