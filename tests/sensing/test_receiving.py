"""Simple beams in one compiled pass, against arrays: random clusters, media, noise, clipped echoes, false alarms."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import special

from emulator.compiled import switch
from emulator.physics.subechoes import SubEchoes
from emulator.sensing import receiving
from emulator.sensing.daylight import Daylight
from tests.compiled.both import called, differing
from tests.sensing.rig import build, plan

pytest.importorskip("numba")

BEAMS = 600
HAZE = {"visibility_m": 20_000.0}


@pytest.fixture(autouse=True)
def _loops() -> Iterator[None]:
    with switch.switched(True):
        assert switch.kernels() is not None  # else arrays would be compared with themselves
        yield


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Share of beams that the pass over short clusters left, of each sweep."""
    shares: list[float] = []
    loops = switch.kernels()
    step: Any = loops.received

    def noted(beam: Any, range_m: Any, amplitude: Any, source: Any, some: Any, *more: Any) -> Any:
        made = step(beam, range_m, amplitude, source, some, *more)
        shares.append(float(np.mean(some)))
        return made

    monkeypatch.setattr(loops, "received", noted)
    return shares


def random_echoes(seed: int, threshold: float, pulse_m: float, short: bool = False) -> SubEchoes:
    """None, one, several in one cluster, or several clusters, from below the threshold to far above, near and far.

    They stop much or little of the beam. `short`: no cluster is long, nor nearer than 3 m.
    """
    rng = np.random.default_rng(seed)
    beam, range_m, amplitude, source = [], [], [], []
    for k in range(BEAMS):
        for _ in range(int(rng.choice([0, 1, 1, 1, 2, 3]))):
            first, many = float(rng.uniform(0.4, 3.0) if rng.random() < 0.2 else rng.uniform(3.0, 60.0)), 1
            if short:
                first = 3.0 + 5.0 * pulse_m * int(rng.integers(0, 20))
            if rng.random() < 0.5:
                many = int(rng.integers(2, 40))
            width = pulse_m * float(rng.choice([0.0, 0.01, 0.4, 0.95, 0.5 if short else 1.5]))
            height = threshold * 10.0 ** float(rng.uniform(-1.5, 3.0))
            beam += [k] * many
            range_m += list(first + width * rng.random(many))
            amplitude += list(height * rng.random(many) / many)
            source += list(rng.integers(0, 5, many))
    shares = rng.choice([0.0, 1e-3, 0.1], len(beam))
    return SubEchoes.of(np.array(beam), np.array(range_m), np.array(amplitude), shares, np.array(source))


def forms(measure: Any, seed: int, daylight: Daylight, short: bool = False, **options: Any) -> tuple[Any, Any]:
    """A sweep by arrays and by the pass."""
    given = plan(np.zeros(BEAMS), sweep=seed, **options)
    model = measure.model
    found = random_echoes(seed, model.threshold, model.pulse.half_support_m, short)
    return forms_of(measure, found, given, daylight)


def forms_of(measure: Any, found: SubEchoes, given: Any, daylight: Daylight) -> tuple[Any, Any]:
    pair, made = receiving.readings.pair, []  # type: ignore[attr-defined]
    soft = measure._soft.everywhere(measure.air.at(0.0), 1.0)
    for on in (False, True):
        pair.on = on
        try:
            made.append(measure._receiver.receive(given, found, soft, daylight))
        finally:
            pair.on = True
    return made[0], made[1]


@pytest.mark.parametrize("model", ["velodyne-vlp-16", "ouster-os1-128", "sick-lms291-s05"])
@pytest.mark.parametrize(
    ("physics", "weather", "noise", "echoes"),
    [
        ({}, {"visibility_m": 1e9}, False, 4),
        ({}, HAZE, False, 4),
        ({}, HAZE, True, 1),
        ({"threshold_to_noise": 3.0}, HAZE, True, 2),
        ({"full_scale_snr": 60.0, "recovery_ns": 30.0}, {"visibility_m": 1e9}, False, 4),
        ({"floor_reflectance": 0.01, "walk_table": False}, HAZE, False, 4),
        ({"echoes": "strongest"}, HAZE, False, 1),
        ({"echoes": "strongest", "full_scale_snr": 60.0}, HAZE, True, 2),
        ({"echoes": "last"}, HAZE, False, 1),
        ({"echoes": "last", "full_scale_snr": 60.0, "recovery_ns": 30.0}, HAZE, True, 2),
        ({"noise": False}, HAZE, False, 2),
    ],
)
def test_random_clusters_are_reported_alike(
    tmp_path: Path, left: list[float], model: str, physics: dict[str, Any], weather: dict[str, Any], noise: bool,
    echoes: int,
) -> None:  # fmt: skip
    measure = build(tmp_path, model=model, physics=physics, weather=weather)
    rng = np.random.default_rng(1)
    light = Daylight(rng.uniform(1.0, 2.0, BEAMS), rng.random(BEAMS) < 0.05) if noise else Daylight(None, None)
    for seed in range(3):
        one, other = forms(measure, seed, light, max_echoes=echoes)
        assert np.isfinite(one.range_m).any()
        assert not len(differing(one, other))
    assert len(left) == 3
    assert max(left) < 0.7  # the long ones, those near the sensor; all others are settled


@pytest.mark.parametrize("echoes", ["first", "strongest", "last"])
@pytest.mark.parametrize("recovery_ns", [0.0, 40.0])
def test_little_air_and_several_echoes_leave_no_beam(
    tmp_path: Path, left: list[float], echoes: str, recovery_ns: float
) -> None:
    physics = {"echoes": echoes, "recovery_ns": recovery_ns, "full_scale_snr": 200.0}
    measure = build(tmp_path, model="ouster-os1-128", physics=physics, weather=HAZE)
    for seed in range(3):
        for most in (1, 2):
            one, other = forms(measure, seed, Daylight(None, None), short=True, max_echoes=most)
            assert not len(differing(one, other))
            assert np.isfinite(one.range_m).all(axis=1).sum() > BEAMS / 10
    assert max(left) == 0.0


def test_an_echo_that_just_reaches_the_threshold_in_air_is_crossed_on_its_parabola(
    tmp_path: Path, left: list[float]
) -> None:
    measure = build(tmp_path, model="velodyne-vlp-16", physics={"noise": False}, weather=HAZE)
    soft, threshold = measure._soft.everywhere(measure.air.at(0.0), 1.0), measure.model.threshold
    assert soft is not None
    rng = np.random.default_rng(3)
    range_m = rng.uniform(2.0, 4.0, BEAMS)
    amplitude = threshold * (1.0 + 1e-4 * rng.uniform(-0.1, 0.9, BEAMS)) - soft.wave(range_m)
    beams = np.arange(BEAMS)
    found = SubEchoes.of(beams, range_m, amplitude, np.zeros(BEAMS), np.zeros(BEAMS, np.int64))
    one, other = forms_of(measure, found, plan(np.zeros(BEAMS)), Daylight(None, None))
    assert np.isfinite(one.range_m[:, 0]).sum() > BEAMS / 2
    assert not len(differing(one, other))
    assert left == [0.0]


def test_normal_numbers_are_those_of_scipy() -> None:
    from emulator.compiled.normal import normals

    tails = 10.0 ** -np.linspace(1.0, 15.9, 2000)
    chance = np.concatenate([np.linspace(1e-6, 1.0 - 1e-6, 20_001), tails, 1.0 - tails])
    out, low, power = (np.zeros(len(chance)) for _ in range(3))
    called(normals)(chance, len(chance), out, low, power)
    np.testing.assert_allclose(out, special.ndtri(chance), rtol=5e-15, atol=1e-15)
