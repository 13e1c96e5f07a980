"""Models and families that do not come with the package: a spec file beside a scenario, an entry point of a package."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import pytest

import protocols
from emulator.errors import ScenarioError
from emulator.scenario import scenario
from emulator.sensors.spec import load_spec, name_of

SCENARIO = """\
schema: 1
sensors:
  - {id: front, model: MODEL, links: ["loop:front"]}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shipped = load_spec("sick-lms291-s05")
    keys = [f"{key}: {value}" for key, value in (("model", "acme-x1"), ("extends", shipped.model))]
    (tmp_path / "acme-x1.yaml").write_text("\n".join(keys) + "\n", encoding="utf-8")
    return tmp_path


def loaded(folder: Path, model: str) -> scenario.Scenario:
    return scenario.loads(SCENARIO.replace("MODEL", model), folder / "run.yaml")


def test_a_spec_file_beside_the_scenario_is_a_model(folder: Path) -> None:
    model = loaded(folder, "acme-x1.yaml").sensors[0].model
    assert Path(model) == folder / "acme-x1.yaml"
    assert load_spec(model).model == name_of(model) == "acme-x1"
    assert load_spec(model).optics == load_spec("sick-lms291-s05").optics
    assert name_of("sick-lms291-s05") == "sick-lms291-s05"


def test_a_model_that_no_file_holds_is_told_with_the_line(folder: Path) -> None:
    with pytest.raises(ScenarioError, match=r"run\.yaml:3: sensors\.front\.model: .*nothing\.yaml.*no such file"):
        loaded(folder, "nothing.yaml")


def test_what_is_wrong_with_a_spec_file_is_told_with_its_own_line(folder: Path) -> None:
    (folder / "acme-x2.yaml").write_text("model: acme-x2\nextends: sick-lms291\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"acme-x2\.yaml:2: extends: 'sick-lms291'; want one of .*sick-lms291-s05"):
        loaded(folder, "acme-x2.yaml")


def test_a_package_brings_a_family_and_cannot_take_a_name_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("acme_lidar")
    module.FAMILY = object()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "acme_lidar", module)
    points = [EntryPoint(name, "acme_lidar", protocols.GROUP) for name in ("acme", "lms2xx")]
    monkeypatch.setattr(protocols, "entry_points", lambda group: points if group == protocols.GROUP else [])
    protocols.families.cache_clear()
    try:
        assert protocols.family("acme") is module.FAMILY
        assert protocols.families()["lms2xx"] == "protocols.lms2xx"
        with pytest.raises(KeyError, match="unknown family 'acne'; known: acme, can_objects, cola, hesai, ld, ldrobot"):
            protocols.family("acne")
    finally:
        protocols.families.cache_clear()
