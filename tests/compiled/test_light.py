"""What comes back from hits, by arrays and by compiled loops: strengths, order, what goes on from glass."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.casting.hits import Hits
from emulator.physics.arrays import exp_or_zero
from emulator.physics.materials import MODELS, SurfaceTable, material_from_mapping
from emulator.sensing.model import SensorModel, sensor_model
from emulator.sensing.paths import Seen, Surfaces, returned
from emulator.sensing.rays import Rays
from emulator.sensors.physics_options import PhysicsOptions
from emulator.sensors.spec import load_spec
from tests.compiled.both import both
from tests.draws import cases

pytest.importorskip("numba")

KEYS: dict[str, dict[str, Any]] = {
    "lambert": {"rho": 0.5},
    "oren_nayar": {"rho": 0.4, "slope_rad": 0.4},
    "phong": {"rho": 0.3, "rho_specular": 0.4, "exponent": 20.0},
    "ggx": {"rho": 0.3, "f0": 0.05, "roughness": 0.2},
    "coated": {"rho": 0.3, "roughness": 0.1},
    "mirror": {"rho": 0.01, "specular": 0.9},
    "glass": {"rho": 0.02},
    "retro": {"rho": 0.3, "retro_cd_lx_m2": 250.0},
}


def table_of(*models: str, wet: bool = False) -> SurfaceTable:
    return SurfaceTable.of([material_from_mapping(m, {"model": m, **KEYS[m]}) for m in models], 905.0, wet)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("wet", [False, True])
def test_every_model_of_a_surface_reflects_the_same(model: str, wet: bool) -> None:
    table = table_of(model, wet=wet)
    cosine = np.linspace(1.0, 0.0, 101)
    hits = hits_of(np.full(101, 9.0), np.zeros(101, np.int32), cosine)
    one, other = both(lambda: seen(hits, np.arange(101), table))
    np.testing.assert_allclose(one.echoes.amplitude, other.echoes.amplitude, rtol=1e-12)
    if model not in ("mirror", "glass", "phong"):
        assert np.ptp(one.echoes.amplitude) > 0.0


def test_the_exponential_is_that_of_the_library() -> None:
    alpha = np.concatenate([[0.0, 1e-300, 1e-9], np.geomspace(1e-4, 28.0, 300), [40.0, 1e3]])
    hits, beam, table = (
        hits_of(np.full(1, 10.0), np.zeros(1, np.int32), np.ones(1)),
        np.zeros(1, int),
        table_of("lambert"),
    )
    clear, *dimmed = (both(lambda a=a: seen(hits, beam, table, a))[1].echoes.amplitude[0] for a in alpha)  # type: ignore[misc]
    np.testing.assert_allclose(np.array(dimmed) / clear, exp_or_zero(-20.0 * alpha[1:]), rtol=1e-13, atol=1e-240)


@given(
    seed=st.integers(0, 100_000),
    sub_beams=st.sampled_from([1, 2, 7, 61, 64, 65, 300]),
    missing=st.sampled_from([0.0, 0.2, 0.97, 1.0]),
    even=st.booleans(),
    glossy=st.booleans(),
    reach_m=st.sampled_from([90.0, 60.0, 1.0]),
    extinction=st.sampled_from([0.0, 1e-6, 1e-4, 0.02]),
)
@settings(max_examples=cases(200))
def test_hits_become_the_same_sub_echoes(
    seed: int, sub_beams: int, missing: float, even: bool, glossy: bool, reach_m: float, extinction: float
) -> None:
    """Equal ranges, beams of one ray or many or none, misses, what is out of reach, near walls."""
    rng = np.random.default_rng(seed)
    beams = int(rng.integers(1, 30))
    count = beams * sub_beams
    beam = np.arange(beams).repeat(sub_beams)
    if not even:  # as adaptive ones are; each has a ray at least
        beam = np.sort(np.concatenate([np.arange(beams), rng.integers(0, beams, count - beams)]))
    range_m = np.round(rng.uniform(0.0, float(rng.choice([3.0, 80.0])), count), int(rng.integers(0, 6)))
    range_m[rng.random(count) < missing] = np.nan
    models = MODELS if glossy else ("lambert", "ggx", "retro")
    material = rng.integers(0, len(models), count).astype(np.int32)
    material[np.isnan(range_m)] = -1
    hits, table = hits_of(range_m, material, rng.random(count)), table_of(*models)
    one, other = both(lambda: seen(hits, beam, table, extinction, reach_m, beams))
    for name in ("beam", "range_m", "blocked", "source"):
        np.testing.assert_array_equal(getattr(one.echoes, name), getattr(other.echoes, name), err_msg=name)
    np.testing.assert_allclose(one.echoes.amplitude, other.echoes.amplitude, rtol=1e-9)
    np.testing.assert_array_equal(one.nearest_m, other.nearest_m)
    np.testing.assert_array_equal(one.axis_material, other.axis_material)
    assert (np.diff(other.echoes.beam) >= 0).all()


def hits_of(range_m: np.ndarray, material: np.ndarray, cosine: np.ndarray) -> Hits:
    hits = Hits.misses(len(range_m))
    normal = np.array([-1.0, 0.0, 0.0]) * np.isfinite(range_m)[:, None]
    actor = np.where(material >= 0, np.arange(len(range_m)) % 5, -1).astype(np.int32)
    return replace(hits, range_m=range_m, material=material, cosine=cosine, actor=actor, normal=normal)


@dataclass(frozen=True)
class Even:
    """Air that is the same everywhere."""

    extinction_per_m: float
    uneven: bool = False

    def depth(self, origin_m: Any, direction: Any, length_m: Any, t_s: Any) -> Any:
        return self.extinction_per_m * length_m


class Nothing:
    """A scene behind all glass, in which nothing stands."""

    def first_hits(self, origin_m: Any, direction: Any, t_s: Any, **more: Any) -> Hits:
        return Hits.misses(len(direction))


def lms291() -> SensorModel:
    return sensor_model(load_spec("sick-lms291-s05"), PhysicsOptions(), "operational")


def seen(
    hits: Hits, beam: np.ndarray, table: SurfaceTable, extinction: float = 0.0, reach_m: float = 90.0, beams: int = 0
) -> Seen:
    """What comes back where `beam` (m,) had these hits."""
    m, model = len(beam), lms291()
    n = beams or int(beam[-1]) + 1
    along = np.tile([1.0, 0.0, 0.0], (m, 1))
    share = np.random.default_rng(7).random(m)
    axis = np.minimum(beam.searchsorted(np.arange(n)), m - 1)
    rays = Rays(np.zeros((m, 3)), along, np.zeros(m), beam, share, axis, np.zeros((n, 3)), along[axis], along[axis])
    far = reach_m - 4.0 * model.pulse.half_support_m
    return returned(hits, rays, Nothing(), Surfaces.of(table), Even(extinction), model, 1.0, far)
