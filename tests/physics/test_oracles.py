"""Every formula of the physics at every reference value, within the value's own tolerance."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from emulator.physics import (
    atmosphere,
    background,
    brdf,
    counting,
    noise,
    photons,
    precipitation,
    pulse,
    radiometry,
    softtarget,
    tilted,
)

CASES = json.loads((Path(__file__).parent / "data" / "physics_oracles.json").read_text(encoding="utf-8"))["cases"]

FORMULAS: dict[str, Callable[..., Any]] = {
    "fog_kruse": atmosphere.fog_kruse,
    "fog_kim": atmosphere.fog_kim,
    "fog_naboulsi_advection": atmosphere.fog_naboulsi_advection,
    "fog_naboulsi_radiation": atmosphere.fog_naboulsi_radiation,
    "fog_ijaz": atmosphere.fog_ijaz,
    "smoke_ijaz": atmosphere.smoke_ijaz,
    "dust_esmail": atmosphere.dust_esmail,
    "rain_carbonneau": atmosphere.rain_carbonneau,
    "rain_japan": atmosphere.rain_japan,
    "rain_itu_mu0": atmosphere.rain_itu_mu0,
    "rain_marshall_palmer": atmosphere.rain_marshall_palmer,
    "fall_speed_atlas": atmosphere.fall_speed_atlas,
    "rain_one_size": atmosphere.rain_one_size,
    "rain_stokes": atmosphere.rain_stokes,
    "snow_wet": atmosphere.snow_wet,
    "snow_dry": atmosphere.snow_dry,
    "db_per_km": atmosphere.db_per_km,
    "transmission_two_way": atmosphere.transmission_two_way,
    "log10_transmission_two_way": atmosphere.log10_transmission_two_way,
    "q_forward": atmosphere.q_forward,
    "fog_return": softtarget.fog_return,
    "fog_peak_range": softtarget.fog_peak_range,
    "fog_peak_power": softtarget.fog_peak_power,
    "fog_plus_wall": softtarget.fog_plus_wall,
    "fog_to_wall_ratio": softtarget.fog_to_wall_ratio,
    "fog_bound": softtarget.fog_bound,
    "overlap_start": radiometry.overlap_start,
    "overlap_full": radiometry.overlap_full,
    "rain_drops_in_beam": precipitation.rain_drops_in_beam,
    "drop_backscatter": precipitation.drop_backscatter,
    "rain_false_echo_mean": precipitation.rain_false_echo_mean,
    "echo_extended": radiometry.echo_extended,
    "system_constant": radiometry.system_constant,
    "max_range_extended": radiometry.max_range_extended,
    "max_range_cylinder": radiometry.max_range_cylinder,
    "max_range_sphere": radiometry.max_range_sphere,
    "fill_edge": radiometry.fill_edge,
    "fill_strip": radiometry.fill_strip,
    "fill_disc": radiometry.fill_disc,
    "fill_disc_offset": radiometry.fill_disc_offset,
    "fill_cylinder": radiometry.fill_cylinder,
    "fill_sphere": radiometry.fill_sphere,
    "tophat_edge": radiometry.tophat_edge,
    "tophat_sphere": radiometry.tophat_sphere,
    "tophat_cylinder": radiometry.tophat_cylinder,
    "edge_energy_ratio": radiometry.edge_energy_ratio,
    "echo_retro": radiometry.echo_retro,
    "tilted_plane_energy": tilted.tilted_plane_energy,
    "tilted_plane_mean_range": tilted.tilted_plane_mean_range,
    "tilted_plane_range_std": tilted.tilted_plane_range_std,
    "peak_power_sin2": pulse.peak_power_sin2,
    "peak_power_gauss": pulse.peak_power_gauss,
    "walk_sin2": pulse.walk_sin2,
    "walk_gauss": pulse.walk_gauss,
    "cfd_sin2": pulse.cfd_sin2,
    "tilt_range_sigma": pulse.tilt_range_sigma,
    "tilt_peak_gauss": pulse.tilt_peak_gauss,
    "tilt_peak_sin2": pulse.tilt_peak_sin2,
    "two_echo_peak": pulse.two_echo_peak,
    "two_echo_limit_gauss": pulse.two_echo_limit_gauss,
    "crlb_sin2": pulse.crlb_sin2,
    "solar_blackbody": background.solar_blackbody,
    "background_surface": background.background_surface,
    "sun_share": background.sun_share,
    "filter_line_share": background.filter_line_share,
    "filter_angle_shift": background.filter_angle_shift,
    "excess_noise": noise.excess_noise,
    "noise_current": noise.noise_current,
    "normal_tail": noise.normal_tail,
    "log10_normal_tail": noise.log10_normal_tail,
    "detection_probability": noise.detection_probability,
    "false_alarm_samples": noise.false_alarm_samples,
    "false_alarm_rice": noise.false_alarm_rice,
    "tnr_for_false_alarms": noise.tnr_for_false_alarms,
    "adc_noise": noise.adc_noise,
    "speed_noise": noise.speed_noise,
    "fresnel_unpolarised": brdf.fresnel_unpolarised,
    "pane_transmission": brdf.pane_transmission,
    "oren_nayar_back": brdf.oren_nayar_back,
    "ggx_back": brdf.ggx_back,
    "phong_back": brdf.phong_back,
    "kubelka_munk": brdf.kubelka_munk,
    "saunderson": brdf.saunderson,
    "wet_reflectance": brdf.wet_reflectance,
    "retro_equivalent": brdf.retro_equivalent,
    "beams_on_target": counting.beams_on_target,
    "edge_extension": counting.edge_extension,
    "pose_step_error": counting.pose_step_error,
    "doppler_shift": photons.doppler_shift,
    "photoelectrons": photons.photoelectrons,
    "first_photon_bin": photons.first_photon_bin,
    "coincidence_ratio": photons.coincidence_ratio,
}


def evaluated(formula: str, inputs: dict[str, str]) -> float:
    """Our function at the inputs of a case: degrees become radians, everything else is SI already."""
    values: dict[str, float] = {}
    for key, text in inputs.items():
        value = float(text)
        if key.endswith("_deg"):
            key, value = f"{key[:-4]}_rad", math.radians(value)
        values[key] = value
    return float(FORMULAS[formula](**values))


@pytest.mark.parametrize("formula", FORMULAS)
def test_a_formula_meets_its_reference_values(formula: str) -> None:
    wrong = {}
    for case in CASES:
        if case["formula"] == formula:
            expected, found = float(case["expected"]), evaluated(formula, case["inputs"])
            if not abs(found - expected) <= float(case["rtol"]) * abs(expected):
                wrong[case["name"]] = (found, expected)
    assert wrong == {}


def test_every_formula_of_the_reference_has_a_function_and_every_function_a_case() -> None:
    assert {case["formula"] for case in CASES} == set(FORMULAS)
    assert len(FORMULAS) == 92
    assert len(CASES) == 488


def test_the_comparison_would_see_a_wrong_digit() -> None:
    case = next(case for case in CASES if case["name"] == "table 2 car")
    found = evaluated(case["formula"], {**case["inputs"], "rho": "0.7500001"})
    assert abs(found - float(case["expected"])) > float(case["rtol"]) * float(case["expected"])
