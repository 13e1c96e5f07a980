"""Inputs at their ends: every row of section 6.3 of the project's physics specification, and named refusals beyond."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.errors import EmulatorError, ScenarioError, SceneError
from emulator.physics import radiometry
from emulator.physics.detection import detect
from emulator.physics.detector import Detector
from emulator.physics.pulse import Pulse
from emulator.physics.subechoes import SubEchoes
from emulator.sensing.measure import Measure
from protocols.scan import SATURATED, Scan
from tests.sensing.rig import QUIET, build, grey, plan, plate

CLEAR = {"visibility_m": 1e9}
FAN = np.linspace(-40.0, 40.0, 81)


def same(one: Scan, two: Scan) -> bool:
    """To the last bit."""
    return all(
        getattr(one, name).tobytes() == getattr(two, name).tobytes()
        for name in ("range_m", "intensity", "flags", "actor")
    )


def extinction(measure: Measure) -> float:
    return measure.air.at(0.0).everywhere.extinction_per_m


# ------------------------------------------------------------------------------- divergence
@pytest.mark.parametrize("rule", ["spiral", "laguerre", "grid", "adaptive"])
def test_a_beam_without_divergence_is_its_axis(tmp_path: Path, rule: str) -> None:
    world = [plate(20.0, "half", 12.0), plate(30.0, "white", 60.0)]
    thin = build(tmp_path, world, physics={"divergence_deg": 0.0, "rule": rule, "sub_beams": 64})
    axis = build(tmp_path, world, physics={"rule": "axis", "divergence_deg": 0.0})
    assert same(thin(plan(FAN)), axis(plan(FAN)))
    nearly = build(tmp_path, world, physics={"divergence_deg": 1e-200, "rule": rule, "sub_beams": 64})
    assert same(nearly(plan(FAN)), axis(plan(FAN)))


@pytest.mark.parametrize("law", ["marshall_palmer", "carbonneau"])
def test_a_beam_of_nearly_no_divergence_in_rain_and_snow_is_its_axis(tmp_path: Path, law: str) -> None:
    scans = []
    for divergence_deg in (0.0, 1e-200):
        physics = {**QUIET, "rule": "axis", "divergence_deg": divergence_deg}
        weather = {"rain": {"rate_mm_h": 20.0, "law": law}, "snow": {"rate_mm_h": 2.0}}
        scans.append(build(tmp_path, [plate(20.0, "half")], weather=weather, physics=physics)(plan(FAN)))
    assert same(*scans)


@pytest.mark.parametrize("model", ["paper-905nm", "sick-ld-lrs1000"])
@pytest.mark.parametrize("offset_nm", [500.0, -3000.0])
def test_a_laser_beside_its_filter_sees_no_drop(tmp_path: Path, model: str, offset_nm: float) -> None:
    weather = {"rain": {"rate_mm_h": 50.0, "echoes": "drops"}, "snow": {"rate_mm_h": 1.0}}
    physics = {**QUIET, "filter_offset_nm": offset_nm}
    scan = build(tmp_path, [plate(5.0, "white")], model=model, weather=weather, physics=physics)(plan(FAN))
    assert np.isnan(scan.range_m).all()


def test_a_gate_before_the_overlap_sees_nothing_of_a_layer(tmp_path: Path) -> None:
    physics = {"gate_m": 0.2, "near_gate_m": 0.0, "pulse_fwhm_ns": 0.1, "false_alarms": False}
    layer = {"top_m": 1.0, "extinction_per_m": 0.01}
    for weather in ({"layers": [layer]}, {"layers": [{**layer, "extinction_per_m": 1.0}]}):
        measure = build(tmp_path, model="sick-ld-lrs1000", weather=weather, physics=physics)
        assert measure.model.overlap_start_m > 0.2
        assert np.isnan(measure(plan(FAN)).range_m).all()


@pytest.mark.parametrize("radius_m", [1e-6, 1e-4, 1e-2, 1.0])
def test_a_beam_without_divergence_sees_a_wire_of_any_width_or_not(tmp_path: Path, radius_m: float) -> None:
    wire = {"cylinder": {"radius_m": radius_m, "height_m": 4.0}, "at_m": [20.0, 0.0, -2.0], "material": "white"}
    measure = build(tmp_path, [wire], weather=CLEAR, physics={**QUIET, "divergence_deg": 0.0, "rule": "spiral"})
    on, off = np.degrees([0.5, 1.5]) * np.arcsin(radius_m / 20.0)
    scan = measure(plan([0.0, on, off, 10.0]))
    front = 20.0 - radius_m
    assert scan.range_m[0, 0] == pytest.approx(front, abs=0.01 * radius_m + 1e-9)
    assert np.isfinite(scan.range_m[:2, 0]).all()
    assert np.isnan(scan.range_m[2:]).all()
    assert float(radiometry.fill_cylinder(radius_m, 0.0)) == pytest.approx(1.0, abs=1e-2)


@pytest.mark.parametrize("divergence_deg", [10.0, 20.0])
@pytest.mark.parametrize("x0", [-0.4, 0.0, 0.4])
def test_half_a_plane_under_a_beam_of_10_and_20_degrees_has_its_share(
    tmp_path: Path, divergence_deg: float, x0: float
) -> None:
    """RMS error of the spiral on a random edge: 0.07 N^-0.75 (section 7), 4.4e-3 at 256, a tenth of it at 4096."""
    w_m = 20.0 * float(np.tan(np.radians(0.5 * divergence_deg)))
    world = [plate(20.0, "white", 2000.0, x0 * w_m - 1000.0, 2000.0)]
    for sub_beams, allowed in ((256, 1.5e-2), (4096, 2e-3)):
        physics = {**QUIET, "divergence_deg": divergence_deg, "rule": "spiral", "sub_beams": sub_beams}
        found = build(tmp_path, world, weather=CLEAR, physics=physics).view(plan([0.0])).echoes
        assert found.blocked.sum() == pytest.approx(float(radiometry.fill_edge(x0, 1.0)), abs=allowed)


@pytest.mark.parametrize("divergence", [20.001, [0.1, 20.001], 25.0, 180.0, -1e-9])
def test_a_divergence_over_20_degrees_is_refused_by_name(tmp_path: Path, divergence: Any) -> None:
    with pytest.raises(ScenarioError, match=r"scene.yaml:1: sensors.front.physics.divergence_deg.*want"):
        build(tmp_path, physics={"divergence_deg": divergence})


# ------------------------------------------------------------------------------- pulses
def test_a_pulse_of_a_tenth_of_a_nanosecond_needs_less_than_a_megabyte_a_beam(tmp_path: Path) -> None:
    """Gate of 1.67 us, 250 m: 267 000 bins of a sixteenth of the pulse if they were all kept."""
    posts = [plate(20.0 + 30.0 * k, "white", 100.0, 50.0 - 1e-3 * k) for k in range(5)]
    physics = {
        **QUIET, "pulse_fwhm_ns": 0.1, "rule": "spiral", "sub_beams": 256, "echoes": "all", "max_echoes": 8,
        "system_constant_m2": 1e7, "gate_m": 250.0,
    }  # fmt: skip
    measure = build(tmp_path, posts, weather=CLEAR, physics=physics)
    assert measure.model.bin_m == pytest.approx(measure.model.pulse.fwhm_m / 16.0)
    wanted = plan([0.0])
    scan = measure(wanted)
    tracemalloc.start()
    again = measure(wanted)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6
    assert same(scan, again)
    seen = scan.range_m[np.isfinite(scan.range_m)]
    assert seen == pytest.approx([20.0, 50.0, 80.0, 110.0, 140.0][: len(seen)], abs=1e-3)
    assert len(seen) >= 2


def test_mixed_echoes_of_a_short_pulse_part_where_a_long_one_joins_them(tmp_path: Path) -> None:
    edges = [plate(20.0, "white", 100.0, 50.0), plate(20.1, "white")]
    count = {}
    for fwhm_ns in (0.1, 16.0):
        physics = {**QUIET, "pulse_fwhm_ns": fwhm_ns, "rule": "spiral", "echoes": "all", "max_echoes": 4,
                   "system_constant_m2": 75000.0, "detection": "peak"}  # fmt: skip
        scan = build(tmp_path, edges, weather=CLEAR, physics=physics)(plan([0.0]))
        count[fwhm_ns] = int(np.isfinite(scan.range_m).sum())
    assert count == {0.1: 2, 16.0: 1}


@pytest.mark.parametrize("method", ["leading_edge", "constant_fraction", "peak", "centroid"])
@pytest.mark.parametrize("shape", ["sin2", "gauss"])
@pytest.mark.parametrize("fwhm_ns", [1000.0, 1e5])
def test_a_pulse_of_a_microsecond_and_of_a_hundred_is_one_echo(
    tmp_path: Path, method: str, shape: str, fwhm_ns: float
) -> None:
    """300 m of light: two plates 10 m apart are one echo, between or before them."""
    edges = [plate(100.0, "white", 100.0, 50.0), plate(110.0, "white")]
    physics = {**QUIET, "pulse_fwhm_ns": fwhm_ns, "pulse": shape, "detection": method, "rule": "spiral",
               "echoes": "all", "max_echoes": 4, "system_constant_m2": 1e7}  # fmt: skip
    scan = build(tmp_path, edges, weather=CLEAR, physics=physics)(plan([0.0]))
    seen = scan.range_m[np.isfinite(scan.range_m)]
    assert len(seen) == 1
    # the walk of a mixed pulse is a share of its length
    assert 90.0 < seen[0] < 120.0 or fwhm_ns > 1e4
    one = build(tmp_path, [plate(100.0, "white")], weather=CLEAR, physics=physics)(plan([0.0]))
    assert one.range_m[0, 0] == pytest.approx(100.0, abs=2e-5)  # slant rays of the bundle: 9e-6 m


def test_the_blind_zone_after_a_clipped_echo_does_not_end_with_a_long_pulse(tmp_path: Path) -> None:
    edges = [plate(20.0, "white", 100.0, 50.0), plate(60.0, "white")]
    seen = {}
    for fwhm_ns in (16.0, 1000.0):
        physics = {**QUIET, "pulse_fwhm_ns": fwhm_ns, "rule": "spiral", "echoes": "all", "max_echoes": 4,
                   "system_constant_m2": 1e6}  # fmt: skip
        scan = build(tmp_path, edges, weather=CLEAR, physics=physics)(plan([0.0]))
        seen[fwhm_ns] = int(np.isfinite(scan.range_m).sum())
    assert seen == {16.0: 2, 1000.0: 1}


# ------------------------------------------------------------------------------- near gate, saturation
@pytest.mark.parametrize("range_m", [0.05, 0.5, 0.899])
def test_nothing_is_seen_before_beam_and_field_of_view_meet(tmp_path: Path, range_m: float) -> None:
    """r1 of paper-905nm: 0.9 m."""
    measure = build(
        tmp_path, [plate(range_m, "white", 3.0, 0.0, 3.0)], weather=CLEAR, physics={**QUIET, "rule": "axis"}
    )
    assert np.isnan(measure(plan([0.0])).range_m).all()
    fog = build(
        tmp_path, [plate(range_m, "white", 3.0, 0.0, 3.0)], weather={"fog": {"visibility_m": 5.0}},
        physics={**QUIET, "rule": "axis", "full": True},
    )  # fmt: skip
    assert np.isnan(fog(plan([0.0])).range_m).all()


def test_nothing_is_reported_from_before_a_near_gate(tmp_path: Path) -> None:
    physics = {**QUIET, "rule": "axis", "near_gate_m": 5.0}
    scans = [build(tmp_path, [plate(r, "white")], weather=CLEAR, physics=physics)(plan([0.0])) for r in (4.99, 5.01)]
    assert np.isnan(scans[0].range_m).all()
    assert scans[1].range_m[0, 0] == pytest.approx(5.01, abs=1e-6)


@pytest.mark.parametrize("walk_table", [False, True])
def test_an_echo_a_million_times_over_the_noise_saturates(tmp_path: Path, walk_table: bool) -> None:
    physics = {**QUIET, "rule": "spiral", "sub_beams": 64, "system_constant_m2": 4e8, "full_scale_snr": 2000.0,
               "walk_table": walk_table, "divergence_deg": 1e-4}  # fmt: skip
    scan = build(tmp_path, [plate(20.0, "white")], weather=CLEAR, physics=physics)(plan([0.0]))
    assert scan.flags.tolist() == [SATURATED]
    # with a table the walk of the clipped height is taken off: a third of a metre too much is at most one of 10
    assert scan.range_m[0, 0] == pytest.approx(20.0, abs=0.3 if walk_table else 5e-3)


# ------------------------------------------------------------------------------- visibility and rain at their ends
FOG_AT_1_M = {
    "kim": 3.91202300543, "kruse": 3.79969445894, "naboulsi_advection": 3.94057590000,
    "naboulsi_radiation": 4.02272292150, "ijaz": 3.84764852427,
}  # fmt: skip
"Tables of section 3.2, first lines, 905 nm."
RAIN_AT_300 = {"carbonneau": 0.0113161631618, "itu": 0.0116919749869, "marshall_palmer": 0.0132578982003}
"Table of section 3.3, last line."


@pytest.mark.parametrize("law", list(FOG_AT_1_M))
def test_fog_from_1_m_to_1000_km_is_finite_and_thins_out(tmp_path: Path, law: str) -> None:
    visibility = [1.0, 3.0, 10.0, 100.0, 500.0, 1e3, 5.9e3, 6e3, 6.1e3, 4.9e4, 5e4, 5.1e4, 1e6]
    found = [
        extinction(build(tmp_path, weather={"fog": {"visibility_m": v, "law": law}}, physics={"full": True}))
        for v in visibility
    ]
    assert found[0] == pytest.approx(FOG_AT_1_M[law], rel=1e-11)
    assert (np.diff(found) < 0.0).all()
    assert found[-1] > 0.0


@pytest.mark.parametrize("law", list(RAIN_AT_300))
@pytest.mark.parametrize("echoes", ["drops", "continuum", "auto", "off"])
def test_rain_from_none_to_300_mm_h_is_finite_and_thickens(tmp_path: Path, law: str, echoes: str) -> None:
    rates = [0.0, 1e-300, 1e-9, 0.1, 10.0, 100.0, 300.0]
    found, scans = [], []
    for rate in rates:
        rain = {"rate_mm_h": rate, "law": law, "echoes": echoes, "forward_scatter": False}
        measure = build(tmp_path, [plate(20.0, "white")], weather={"visibility_m": 1e12, "rain": rain})
        found.append(extinction(measure))
        scans.append(measure(plan(FAN)))
    clear = extinction(build(tmp_path, weather={"visibility_m": 1e12}))
    assert found[0] == clear
    assert (np.diff(found) >= 0.0).all()
    assert found[-1] - clear == pytest.approx(RAIN_AT_300[law], rel=1e-11)
    for scan in scans:
        seen = np.isfinite(scan.range_m)
        assert np.array_equal(seen, np.isfinite(scan.intensity))
        assert seen.any()
    dry = build(tmp_path, [plate(20.0, "white")], weather={"visibility_m": 1e12})(plan(FAN))
    assert same(scans[0], dry)


@pytest.mark.parametrize("weather", [{"fog": {"visibility_m": 1.0}}, {"fog": {"visibility_m": 1e6}},
                                     {"rain": {"rate_mm_h": 300.0}}, {"snow": {"rate_mm_h": 300.0}}])  # fmt: skip
@pytest.mark.parametrize("model", ["paper-905nm", "sick-lms291-s05", "sick-ld-lrs1000"])
def test_weather_at_its_ends_gives_numbers_on_every_sensor(tmp_path: Path, weather: Any, model: str) -> None:
    scan = build(tmp_path, [plate(15.0, "half")], weather=weather, model=model)(plan(FAN))
    seen = np.isfinite(scan.range_m)
    assert np.array_equal(seen, np.isfinite(scan.intensity))
    assert (scan.range_m[seen] >= 0.0).all()
    assert not np.isinf(scan.range_m).any()


@pytest.mark.parametrize("weather", [{"fog": {"visibility_m": 0}}, {"fog": {"visibility_m": -5.0}},
                                     {"rain": {"rate_mm_h": -1.0}}, {"rain": {"rate_mm_h": 1e4}},
                                     {"visibility_m": 0}, {"snow": {"rate_mm_h": -1e-9}}])  # fmt: skip
def test_weather_that_is_none_is_refused_by_name(tmp_path: Path, weather: Any) -> None:
    with pytest.raises(ScenarioError, match=r"scene.yaml:1: weather\..*want a number"):
        build(tmp_path, weather=weather)


# ------------------------------------------------------------------------------- wavelength
@pytest.mark.parametrize(("wavelength_nm", "law", "reported"), [
    (532.0, "kim", True), (1550.0, "kim", False), (532.0, "ijaz", True), (1550.0, "ijaz", False),
    (532.0, "naboulsi_advection", True), (2000.0, "kruse", True),
])  # fmt: skip
def test_a_law_outside_its_wavelengths_gives_its_value_and_a_warning(
    tmp_path: Path, wavelength_nm: float, law: str, reported: bool
) -> None:
    weather = {"fog": {"visibility_m": 200.0, "law": law}}
    measure = build(tmp_path, [plate(20.0, "half")], weather=weather, physics={"wavelength_nm": wavelength_nm})
    outside = [line for line in measure.warnings if "wavelength" in line and law in line]
    assert bool(outside) == reported
    assert 0.0 < extinction(measure) < 0.1
    assert np.isfinite(measure(plan([0.0])).intensity).all()


def test_a_visibility_outside_a_law_is_not_clamped(tmp_path: Path) -> None:
    """Section 3.2, lines with an asterisk: computed, and told."""
    measure = build(tmp_path, weather={"fog": {"visibility_m": 4000.0, "law": "naboulsi_advection"}})
    assert extinction(measure) == pytest.approx(0.000985143975000, rel=1e-11)
    assert any("visibility 4000 m outside 50 to 1000 m" in line for line in measure.warnings)


def test_a_material_without_a_value_at_a_wavelength_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no value for 532 nm"):
        build(tmp_path, [plate(20.0, "asphalt")], physics={"wavelength_nm": 532.0})


# ------------------------------------------------------------------------------- nothing to see, or all around
@pytest.mark.parametrize("rule", ["axis", "spiral", "laguerre", "grid", "adaptive"])
@pytest.mark.parametrize("model", ["paper-905nm", "sick-lms291-s05", "sick-ld-lrs1000"])
def test_an_empty_scene_is_a_scan_without_echoes(tmp_path: Path, rule: str, model: str) -> None:
    physics = {"rule": rule, "sub_beams": 16, "false_alarms": False}
    scan = build(tmp_path, model=model, physics=physics)(plan(FAN, max_echoes=2))
    assert scan.range_m.shape[0] == 81
    assert np.isnan(scan.range_m).all()
    assert np.isnan(scan.intensity).all()
    assert (scan.actor == -1).all()
    assert not scan.flags.any()


def test_an_actor_without_a_shape_and_a_plane_seen_edge_on_are_not_seen(tmp_path: Path) -> None:
    edge_on = {"plane": {"size_m": [4.0, 4.0]}, "at_m": [20.0, 0.0, 0.0], "material": "white"}
    measure = build(tmp_path, [edge_on], actors=[{"id": "ghost"}], physics={**QUIET, "divergence_deg": 0.0})
    scan = measure(plan([0.0, 1.0]))
    assert np.isnan(scan.range_m).all()


def test_a_target_of_no_area_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "line.obj").write_text("o line\nv 5 -1 0\nv 5 0 0\nv 5 1 0\nf 1 2 3\n", encoding="utf-8")
    with pytest.raises(SceneError, match="have no area; want a surface"):
        build(tmp_path, [{"mesh": "line.obj", "material": "white"}])
    with pytest.raises(ScenarioError, match=r"world\[0\].plane.size_m\[1\]: 0; want a number > 0"):
        build(tmp_path, [{"plane": {"size_m": [1.0, 0]}, "material": "white"}])


@pytest.mark.parametrize("shape", [{"box": {"size_m": [6.0, 4.0, 3.0]}}, {"sphere": {"radius_m": 3.0}},
                                   {"cylinder": {"radius_m": 3.0, "height_m": 3.0}}])  # fmt: skip
@pytest.mark.parametrize("rule", ["axis", "spiral", "adaptive"])
def test_a_sensor_inside_an_object_sees_its_inner_faces(tmp_path: Path, shape: Any, rule: str) -> None:
    around = {**shape, "material": "white"}
    physics = {**QUIET, "rule": rule, "sub_beams": 16, "depth": 1}
    measure = build(
        tmp_path, [around, plate(20.0, "white")], mount={"at_m": [0.2, 0.1, 1.5]}, weather=CLEAR, physics=physics
    )
    scan = measure(plan(np.arange(-180.0, 180.0, 5.0)))
    assert np.isfinite(scan.range_m[:, 0]).all()
    assert (scan.range_m[:, 0] < 4.0).all()
    assert (scan.range_m[:, 0] > 1.5).all()
    assert measure._caster.counters.suspicious == 0  # type: ignore[attr-defined]


def test_a_sensor_on_a_surface_and_in_a_corner_gives_numbers(tmp_path: Path) -> None:
    box = {"box": {"size_m": [2.0, 2.0, 2.0]}, "material": "white"}
    for at_m in ([1.0, 0.0, 1.0], [1.0, 1.0, 2.0], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]):
        measure = build(tmp_path, [box, plate(20.0, "white")], mount={"at_m": at_m}, physics={"rule": "spiral"})
        scan = measure(plan(np.arange(-180.0, 180.0, 15.0)))
        assert not np.isinf(scan.range_m).any()
        assert np.array_equal(np.isfinite(scan.range_m), np.isfinite(scan.intensity))


# ------------------------------------------------------------------------------- equal echoes, equal runs
@pytest.mark.parametrize("method", ["leading_edge", "constant_fraction", "peak", "centroid"])
def test_three_equal_sub_echoes_at_one_range_are_one_of_three_times_the_energy(method: Any) -> None:
    detector = Detector(Pulse(16e-9), 5.0, method)
    three = detect(SubEchoes.of(np.zeros(3, np.int64), np.full(3, 20.0), np.full(3, 10.0)), 1, detector)
    one = detect(SubEchoes.of(np.zeros(1, np.int64), np.full(1, 20.0), np.full(1, 30.0)), 1, detector)
    assert three.amplitude[0, 0] == one.amplitude[0, 0] == 30.0
    assert three.range_m[0, 0] == one.range_m[0, 0]


def test_three_strips_side_by_side_return_what_one_plate_does(tmp_path: Path) -> None:
    physics = {**QUIET, "rule": "spiral", "sub_beams": 256}
    strips = [plate(20.0, "half", 0.02, 0.02 * k) for k in (-1, 0, 1)]
    parts = build(tmp_path, strips, weather=CLEAR, physics=physics)(plan([0.0]))
    whole = build(tmp_path, [plate(20.0, "half", 0.06)], weather=CLEAR, physics=physics)(plan([0.0]))
    assert parts.range_m == pytest.approx(whole.range_m, abs=1e-9, nan_ok=True)
    assert parts.intensity == pytest.approx(whole.intensity, rel=1e-9, nan_ok=True)


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("rule", ["axis", "spiral", "adaptive"])
def test_a_scan_measured_twice_is_the_same_to_the_last_bit(tmp_path: Path, noise: bool, rule: str) -> None:
    world = [plate(20.0, "half", 12.0), {"sphere": {"radius_m": 1.0}, "at_m": [9.0, 2.0, -1.0], "material": "dark"}]
    weather = {"fog": {"visibility_m": 200.0}, "rain": {"rate_mm_h": 20.0, "echoes": "drops"}}
    physics = {"rule": rule, "sub_beams": 32, "noise": noise, "echoes": "all", "max_echoes": 4}
    measures = [build(tmp_path, world, weather=weather, physics=physics) for _ in range(2)]
    scans = [measure(plan(FAN, sweep=3)) for measure in measures for _ in range(2)]
    assert all(same(scans[0], other) for other in scans[1:])


# ------------------------------------------------------------------------------- refused by name
@pytest.mark.parametrize(("keys", "reported"), [
    ({"world": [{"box": {"size_m": [1.0, 1.0, 1e10]}, "material": "white"}]}, r"world\[0\].box.size_m\[2\]"),
    ({"world": [{"sphere": {"radius_m": 1e-12}, "material": "white"}]}, r"sphere.radius_m: 1e-12; want a number >="),
    ({"world": [{**plate(20.0, "white"), "at_m": [1e300, 0.0, 0.0]}]}, r"world\[0\].at_m\[0\]: 1e\+300; want"),
    ({"world": [{**plate(20.0, "white"), "yaw_deg": 1e300}]}, r"world\[0\].yaw_deg"),
    ({"actors": [{"id": "a", "motion": {"velocity_m_s": [3e8, 0.0, 0.0]}}]}, r"actors.a.motion.velocity_m_s\[0\]"),
    ({"actors": [{"id": "a", "motion": {"yaw_rate_deg_s": 1e9}}]}, r"actors.a.motion.yaw_rate_deg_s"),
    ({"actors": [{"id": "a", "motion": {"waypoints": [{"t_s": 1e300, "at_m": [0.0, 0.0, 0.0]}]}}]}, r"waypoints"),
    ({"mount": {"at_m": [0.0, -1e10, 0.0]}}, r"sensors.front.mount.at_m\[1\]"),
    ({"physics": {"gate_m": 1e9}}, r"sensors.front.physics.gate_m"),
    ({"physics": {"system_constant_m2": 1e300}}, r"sensors.front.physics.system_constant_m2"),
    ({"physics": {"threshold_to_noise": 1e300}}, r"sensors.front.physics.threshold_to_noise"),
    ({"physics": {"exit_diameter_mm": 1e12}}, r"sensors.front.physics.exit_diameter_mm"),
    ({"physics": {"range_noise_mm": 1e300}}, r"sensors.front.physics.range_noise_mm"),
    ({"physics": {"bin_ns": 1e-9}}, r"sensors.front.physics: bin_ns: 1e-09; want at least"),
    ({"physics": {"pulse_fwhm_ns": 1e6}}, r"sensors.front.physics.pulse_fwhm_ns"),
    ({"physics": {"pulse_fwhm_ns": 1e-3}}, r"sensors.front.physics.pulse_fwhm_ns"),
    ({"physics": {"photons": {"bin_ns": 1e-300}}}, r"physics.photons.bin_ns"),
    ({"physics": {"photons": {"pair_rate_hz": 1e30}}}, r"physics.photons.pair_rate_hz"),
])  # fmt: skip
def test_what_the_model_cannot_do_is_refused_by_name(tmp_path: Path, keys: dict[str, Any], reported: str) -> None:
    with pytest.raises(EmulatorError, match=reported) as caught:
        build(tmp_path, keys.pop("world", ()), **keys)
    assert "scene.yaml:1: " in str(caught.value)
    assert "want" in str(caught.value)


def test_materials_of_no_and_of_all_reflectance_give_numbers(tmp_path: Path) -> None:
    for rho in (0.0, 1e-300, 1e-12, 1.0):
        measure = build(tmp_path, [plate(20.0, "x")], materials={"x": grey(rho)}, physics=QUIET)
        scan = measure(plan([0.0]))
        assert np.isfinite(scan.range_m).all() == (rho == 1.0)
