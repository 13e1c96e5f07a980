"""Sensor specs: the shipped files, and what happens to a wrong one."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from emulator.errors import SpecError
from emulator.sensing.model import sensor_model
from emulator.sensors.physics_options import PhysicsOptions
from emulator.sensors.spec import Fact, SensorSpec, list_models, load_spec, load_spec_file
from protocols.livox.settings import facts_of

SHIPPED = {
    "sick-lms200-30106", "sick-lms211-30106", "sick-lms211-30206", "sick-lms211-s07", "sick-lms211-s14",
    "sick-lms211-s15", "sick-lms211-s19", "sick-lms211-s20", "sick-lms220-30106", "sick-lms221-30106",
    "sick-lms221-30206", "sick-lms221-s07", "sick-lms221-s14", "sick-lms221-s15", "sick-lms221-s16",
    "sick-lms221-s19", "sick-lms221-s20", "sick-lms291-s05", "sick-lms291-s14", "sick-lms291-s15",
    "sick-ld-lrs1000", "sick-ld-lrs2100", "sick-ld-lrs3100", "sick-ld-oem1000", "paper-905nm",
    "sick-lms100", "sick-lms111", "sick-lms151", "sick-lms500", "sick-lms511", "sick-tim551", "sick-tim561",
    "sick-tim571", "sick-tim781", "sick-mrs1104",
    "hokuyo-urg-04lx", "hokuyo-ubg-04lx-f01", "hokuyo-uhg-08lx", "hokuyo-utm-30lx", "hokuyo-utm-30lx-ew",
    "hokuyo-ust-10lx", "hokuyo-ust-20lx",
    "velodyne-vlp-16", "velodyne-puck-hi-res", "velodyne-hdl-32e", "velodyne-vlp-32c", "velodyne-vls-128",
    "hesai-xt32", "hesai-xt32m2x", "hesai-qt64", "hesai-pandar40p", "hesai-pandar128e3x", "hesai-ot128", "hesai-at128",
    *(f"ouster-os{kind}-{rows}" for kind in (0, 1, 2) for rows in (32, 64, 128)),
    "rplidar-a1m8", "rplidar-a2m8", "rplidar-a2m12", "rplidar-a3m1", "rplidar-s1m1", "rplidar-s2m1", "rplidar-s3m1",
    "rplidar-c1m1",
    "ldrobot-ld06", "ldrobot-ld19", "ldrobot-stl-27l",
    "ydlidar-x2", "ydlidar-x4", "ydlidar-g4", "ydlidar-tg15", "ydlidar-t-mini",
    "solid-state-raster", "solid-state-rosette", "solid-state-lissajous",
    "can-ars408", "can-ldmrs", "can-leddar-vu8", "can-leddar-m16", "can-esr",
}  # fmt: skip


def facts(table: BaseModel) -> list[Fact[Any]]:
    found: list[Fact[Any]] = []
    for name in type(table).model_fields:
        value = getattr(table, name)
        if isinstance(value, Fact):
            found.append(value)
        elif isinstance(value, BaseModel):
            found += facts(value)
    return found


def test_all_models_are_shipped() -> None:
    assert set(list_models()) == SHIPPED


@pytest.mark.parametrize("model", sorted(SHIPPED))
def test_every_number_of_a_model_has_its_source(model: str) -> None:
    spec = load_spec(model)
    assert spec.model == model
    if spec.sees == "beams":
        assert len(facts(spec)) >= 30
        assert all(len(fact.source) > 3 for fact in facts(spec))


@pytest.mark.parametrize("model", sorted(m for m in SHIPPED if not m.startswith("can")))
def test_sick_numbers_and_the_reference_receiver_follow_the_physics_specification(model: str) -> None:
    made = sensor_model(load_spec(model), PhysicsOptions(), "operational")
    constants = {"sick-ld-lrs": (64000.0, 8e-9), "sick-ld-oem": (16000.0, 8e-9), "paper": (75000.0 / 5.02, 16e-9),
                 "sick-lms200": (1000.0, 4e-9), "sick-lms220": (1000.0, 4e-9),
                 "sick-lms1": (3240.0, 4e-9), "sick-lms5": (7200.0, 2.5e-9), "sick-tim55": (640.0, 2.5e-9),
                 "sick-tim56": (640.0, 2.5e-9), "sick-tim": (695.0, 2.5e-9), "sick-mrs": (2560.0, 4e-9),
                 "hokuyo-utm": (1000.0, 1e-9), "hokuyo-ust-10": (160.0, 1e-9), "hokuyo-ust-20": (640.0, 1e-9),
                 "hokuyo-urg": (17.8, 1e-9), "hokuyo-ubg": (17.8, 1e-9), "hokuyo-uhg": (71.2, 1e-9),
                 "velodyne-vlp-32": (5e4, 6e-9), "velodyne-vls": (7.5e4, 6e-9), "velodyne": (1.25e4, 6e-9),
                 "hesai-xt": (64_000.0, 3e-9), "hesai-qt": (4_000.0, 3e-9), "hesai": (400_000.0, 3e-9),
                 "ouster-os0": (7031.25, 5e-9), "ouster-os1": (36125.0, 5e-9), "ouster-os2": (153125.0, 5e-9),
                 "rplidar-a3": (1000.0, 1e-10), "rplidar-a": (160.0, 1e-10), "rplidar-s1": (1778.0, 1e-9),
                 "rplidar-s2": (1000.0, 1e-9), "rplidar-s3": (2286.0, 1e-9), "rplidar-c1": (360.0, 1e-9),
                 "ldrobot-ld": (144 / 0.7, 1e-9), "ldrobot-stl": (625 / 0.7, 1e-9), "ydlidar-x4": (125.0, 1e-10),
                 "ydlidar-x2": (80.0, 1e-10), "ydlidar-g4": (320.0, 1e-10), "ydlidar-tg": (225 / 0.8, 1e-9),
                 "ydlidar-t-m": (180.0, 1e-9), "solid-state": (64000.0, 3e-9)}  # fmt: skip
    k_m2, fwhm_s = next((value for name, value in constants.items() if model.startswith(name)), (9000.0, 4e-9))
    assert made.k_m2 / made.threshold == pytest.approx(k_m2, rel=2e-4)
    assert made.pulse.fwhm_s == pytest.approx(fwhm_s)
    least_w = 0.1 if made.wavelength_m < 800e-9 else 1.0  # those measure phase, with a beam that is never off
    if made.triangulation is not None:  # and those light a spot without a pause
        least_w = 1e-3
    assert least_w < made.peak_w < 200.0, "peak power of a class 1 laser"


def test_a_velodyne_and_an_ouster_know_how_bright_white_is() -> None:
    from protocols.ouster.models import MODELS as OUSTERS
    from protocols.velodyne.models import MODELS

    for name, model in (*MODELS.items(), *OUSTERS.items()):
        made = sensor_model(load_spec(name), PhysicsOptions(), "operational")
        assert made.k_m2 / made.threshold == pytest.approx(model.white_m2)


def test_a_hesai_knows_how_bright_white_is() -> None:
    from protocols.hesai.models import MODELS

    for name, model in MODELS.items():
        made = sensor_model(load_spec(name), PhysicsOptions(), "operational")
        assert made.k_m2 / made.threshold == pytest.approx(model.white_m2)
        assert load_spec(name).detection.lsb_mm.value == model.unit_mm


@pytest.mark.parametrize("name", [name for name in sorted(SHIPPED) if name.startswith("solid-state")])
def test_a_pattern_knows_how_bright_white_is_and_says_its_field(name: str) -> None:
    spec = load_spec(name)
    made = sensor_model(spec, PhysicsOptions(), "operational")
    pattern, white_m2 = facts_of(spec.device)
    assert made.k_m2 / made.threshold == pytest.approx(white_m2)
    azimuth = np.degrees(np.concatenate([pattern.aim(frame, np.arange(pattern.points))[0] for frame in range(20)]))
    assert spec.geometry is not None
    assert np.ptp(azimuth) == pytest.approx(spec.geometry.field_deg.value, abs=0.1)
    assert 1 / pattern.frame_s == spec.geometry.turn_hz.value[0]


def test_the_papers_lidar_has_eleven_beams_in_ten_degrees_and_a_hundred_watts() -> None:
    spec = load_spec("paper-905nm")
    assert spec.beams is not None
    assert spec.beams.azimuth_deg.value == [-5, -4, -3, -2, -1, 0, 1, 2, 3, 4, 5]
    made = sensor_model(spec, PhysicsOptions(), "seed")
    assert made.peak_w == pytest.approx(100.0, rel=1e-12)
    assert made.threshold == 1.0
    assert not made.noise
    assert not made.weather_echoes


def test_an_extending_file_takes_what_it_does_not_say() -> None:
    parent, child = load_spec("sick-lms291-s05"), load_spec("sick-lms291-s14")
    assert child.optics == parent.optics
    assert child.geometry is not None
    assert child.geometry.field_deg.value == 90
    assert load_spec("sick-lms200-30106").receiver is not None
    assert load_spec("sick-lms200-30106").receiver.floor_reflectance is None  # type: ignore[union-attr]


def test_an_unknown_model_names_the_nearest_one() -> None:
    with pytest.raises(SpecError, match=r"did you mean sick-lms291-s05\?"):
        load_spec("sick-lsm291-s05")


def spec_file(folder: Path, name: str, text: str) -> Path:
    base = files("emulator.sensors").joinpath("sick-lms291-s05.yaml").read_text(encoding="utf-8")
    (folder / "sick-lms291-s05.yaml").write_text(base, encoding="utf-8")
    path = folder / f"{name}.yaml"
    path.write_text(text, encoding="utf-8")
    return path


HEAD = "schema: 1\nextends: sick-lms291-s05\nmodel: mine\ntitle: Mine\n"


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("pulse:\n  fwhm_ns: {value: -4, source: me, evidence: choice}\n",
         "mine.yaml:6: pulse.fwhm_ns.value: -4; want a number >= 0.01"),
        ("optics:\n  divergence_x_mrad: {value: 400, source: me, evidence: choice}\n",
         "mine.yaml:6: optics.divergence_x_mrad.value: 400; want a number <= 349.0"),
        ("pulse:\n  fwhm_ns: {value: .nan, source: me, evidence: choice}\n",
         "mine.yaml:6: pulse.fwhm_ns.value: nan; want a finite number"),
        ("puls:\n  fwhm_ns: 4\n", "mine.yaml:5: puls: unknown key; did you mean pulse?"),
        ("pulse:\n  fwhm_ns: {value: 4, source: me, evidence: rumour}\n",
         "mine.yaml:6: pulse.fwhm_ns.evidence: 'rumour'; want 'seed', 'read'"),
        ("pulse:\n  energy_uj: {value: 4, source: me, evidence: choice}\n", "receiver.system_constant_m2 or"),
        ("extends: nothing\n", "mine.yaml:5: extends: given twice"),
        ("pulse: [1, 2\n", "not YAML"),
        ("pulse: !!python/object:os.system x\n", "mine.yaml:5: pulse: tag"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_by_file_line_and_key(tmp_path: Path, text: str, reported: str) -> None:
    with pytest.raises(SpecError) as caught:
        load_spec_file(spec_file(tmp_path, "mine", HEAD + text))
    assert reported in str(caught.value)


def test_all_faults_of_a_file_are_told_at_once_in_its_order(tmp_path: Path) -> None:
    text = HEAD + (
        "detection:\n  range_noise_mm: {value: x, source: me, evidence: choice}\n"
        "pulse:\n  fwhm_ns: {value: 0, source: me}\n"
    )
    with pytest.raises(SpecError) as caught:
        load_spec_file(spec_file(tmp_path, "mine", text))
    lines = str(caught.value).splitlines()
    assert [line.split("mine.yaml:")[1].partition(" ")[0] for line in lines] == ["6:", "8:", "8:"]


def test_a_fault_in_what_a_file_inherits_is_told_in_the_parents_file(tmp_path: Path) -> None:
    path = spec_file(tmp_path, "mine", HEAD)
    parent = tmp_path / "sick-lms291-s05.yaml"
    parent.write_text(parent.read_text(encoding="utf-8").replace("value: 905,", "value: 90,"), encoding="utf-8")
    with pytest.raises(SpecError, match=r"s05\.yaml:11: optics\.wavelength_nm\.value: 90; want a number >= 300"):
        load_spec_file(path)


@pytest.mark.parametrize("parent", ["mine", "missing", "3"])
def test_a_file_that_extends_itself_or_nothing_is_refused(tmp_path: Path, parent: str) -> None:
    text = HEAD.replace("extends: sick-lms291-s05", f"extends: {parent}")
    with pytest.raises(SpecError, match=r"mine\.yaml:2: extends"):
        load_spec_file(spec_file(tmp_path, "mine", text))


def test_a_file_must_bear_its_models_name(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="want the file's name"):
        load_spec_file(spec_file(tmp_path, "other", HEAD))


def test_a_missing_file_is_a_spec_error(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="no such file"):
        load_spec_file(tmp_path / "none.yaml")


def test_specs_are_frozen() -> None:
    spec: SensorSpec = load_spec("sick-lms291-s05")
    with pytest.raises(ValueError, match="frozen"):
        spec.model = "other"  # type: ignore[misc]
