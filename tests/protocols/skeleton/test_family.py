"""A family with a table of models: what a spec may say of the model, and the keys of each."""

from __future__ import annotations

from pathlib import Path

import pytest

from emulator.errors import SpecError
from emulator.sensors.spec import load_spec_file
from protocols import family
from protocols.errors import DeviceSettingError

USUAL = {"scip": "hokuyo-utm-30lx", "rplidar": "rplidar-a1m8", "ldrobot": "ldrobot-ld19", "ydlidar": "ydlidar-x4"}


@pytest.mark.parametrize(("name", "model"), USUAL.items())
def test_a_spec_of_no_such_model_is_refused_with_its_line(name: str, model: str, tmp_path: Path) -> None:
    with pytest.raises(DeviceSettingError, match=r"model"):
        family(name).new_session({}, {"model": "x1"})
    path = tmp_path / "my-scanner.yaml"
    path.write_text(f"schema: 1\nmodel: my-scanner\nextends: {model}\ndevice: {{model: x1}}\n", encoding="utf-8")
    with pytest.raises(SpecError, match=rf"my-scanner\.yaml:4: device\.model: 'x1'; want .*{model}"):
        load_spec_file(path)


@pytest.mark.parametrize(("name", "model"), USUAL.items())
def test_keys_are_those_of_the_model_with_its_defaults(name: str, model: str) -> None:
    found = family(name)
    assert found.device_keys() == found.keys_of_model({"model": model})  # type: ignore[attr-defined]
    speeds = {"rplidar-s2m1": "10", "rplidar-a1m8": "7"}
    for one, hz in speeds.items() if name == "rplidar" else ():
        keys = {key.name: key for key in found.keys_of_model({"model": one})}  # type: ignore[attr-defined]
        assert keys["turn_hz"].default == hz
