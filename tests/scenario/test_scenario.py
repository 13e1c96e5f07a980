"""Scenario files: what they mean, and every way of getting one wrong told by file, line and key."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.errors import ScenarioError
from emulator.scenario import scenario
from emulator.scenario.scenario import Scenario, load, loads
from tests.draws import cases

ROOT = Path(__file__).resolve().parent.parent.parent
HEAD = "schema: 1\n"
SENSOR = "sensors: [{id: front, model: sick-lms291-s05}]\n"


def read(text: str, *overrides: str) -> Scenario:
    return loads(HEAD + text, Path("test.yaml"), overrides)


def faults(text: str, *overrides: str) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        read(text, *overrides)
    return str(caught.value).splitlines()


# ---------------------------------------------------------------- what a file means


def test_the_example_of_the_contract_is_read(tmp_path: Path) -> None:
    """The example of interfaces.md with meshes of the package, without what a later test refuses by name."""
    text = """
schema: 1
seed: 7
duration_s: 30
world:
  - {mesh: "builtin:house.glb", material: asphalt}
  - {plane: {size_m: [200, 20]}, at_m: [50, 0, 0], material: asphalt}
actors:
  - id: ego
    motion: {at_m: [0, 0, 0], velocity_m_s: [13.9, 0, 0]}
  - id: car
    shape: {mesh: "builtin:car.glb"}
    materials: {body: car_paint_grey, glass: window_glass, bumper: bumper_plastic}
    material: tyre_rubber
    class: car
    motion: {waypoints: [{t_s: 0, at_m: [60, 2, 0], yaw_deg: 180}, {t_s: 10, at_m: [10, 2, 0], yaw_deg: 180}]}
weather:
  fog: {visibility_m: 200, law: kim}
  rain: {rate_mm_h: 10, law: carbonneau}
  sun: {total_w_m2: 1370, azimuth_deg: 120, elevation_deg: 30}
  changes: [{t_s: 12, fog: {visibility_m: 50}}]
sensors:
  - id: front
    model: sick-lms291-s05
    mount: {actor: ego, at_m: [3.6, 0, 0.5], yaw_deg: 0, pitch_deg: 0, roll_deg: 0}
    device: {resolution_deg: 0.5, field_deg: 180, unit: cm}
    mode: operational
    links: ["pty:./front"]
"""
    (tmp_path / "s.yaml").write_text(text)
    found = load(str(tmp_path / "s.yaml"))
    assert (found.seed, found.duration_s, found.source, found.folder) == (7, 30.0, tmp_path / "s.yaml", tmp_path)
    assert found.actors[1].class_ == "car"
    assert found.actors[1].motion.waypoints[1].at_m == (10.0, 2.0, 0.0)
    assert found.sensors[0].mount.at_m == (3.6, 0.0, 0.5)
    assert found.sensors[0].device == {"resolution_deg": 0.5, "field_deg": 180, "unit": "cm"}
    assert found.weather.fog is not None
    assert found.weather.at(12.0).fog.visibility_m == 50.0  # type: ignore[union-attr]


def test_defaults_are_those_of_the_documentation() -> None:
    found = read(SENSOR)
    assert (found.seed, found.duration_s, found.world, found.actors) == (0, None, (), ())
    sensor = found.sensors[0]
    assert (sensor.mount.actor, sensor.mount.at_m, sensor.mode, sensor.links) == (None, (0, 0, 0), "operational", ())
    assert found.weather.fog is None


def test_a_scenario_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        read(SENSOR).seed = 3  # type: ignore[misc]


def test_keys_of_tables_without_a_model_are_kept_as_they_are() -> None:
    found = read("materials: {mine: {rho: {905: 0.3, 1550: 0.2}, model: lambert}}\n")
    assert found.materials == {"mine": {"rho": {"905": 0.3, "1550": 0.2}, "model": "lambert"}}
    assert "mine" in found.known_materials
    assert "asphalt" in found.known_materials


# ---------------------------------------------------------------- what is refused

BAD = [
    ("sed: 1\n", "test.yaml:2: sed: unknown key; did you mean seed? want one of actors, duration_s, "),
    ("seed: -1\n", "test.yaml:2: seed: -1; want a number >= 0"),
    ("seed: 1.5\n", "test.yaml:2: seed: 1.5; want a whole number"),
    ("seed: true\n", "test.yaml:2: seed: True; want a whole number"),
    ("duration_s: 0\n", "test.yaml:2: duration_s: 0; want a number > 0"),
    ("duration_s: .inf\n", "test.yaml:2: duration_s: inf; want a finite number"),
    ("duration_s: '3'\n", "test.yaml:2: duration_s: '3'; want a number"),
    ("world: {}\n", "test.yaml:2: world: {}; want a list"),
    ("world: [3]\n", "test.yaml:2: world[0]: 3; want keys with values"),
    ("world:\n  - {box: {size_m: [1, 2]}, material: brick}\n",
     "test.yaml:3: world[0].box.size_m: 2 values; want a list of 3 numbers"),
    ("world:\n  - {box: {size_m: [1, 2, 0]}, material: brick}\n",
     "test.yaml:3: world[0].box.size_m[2]: 0; want a number > 0"),
    ("world:\n  - {material: brick}\n",
     "test.yaml:3: world[0]: no shape; want exactly one of mesh, frames, plane, box, cylinder, sphere"),
    ("world:\n  - {plane: {size_m: [1, 1]}, box: {size_m: [1, 1, 1]}, material: brick}\n",
     "test.yaml:3: world[0]: plane and box; want exactly one of mesh, frames, plane, box, cylinder, sphere"),
    ("world:\n  - {sphere: {radius_m: 1}, scale: 2, material: brick}\n",
     "test.yaml:3: world[0]: sphere with up or scale; want these for mesh or frames only"),
    ("world:\n  - {sphere: {radius_m: 1, segments: 3}, material: brick}\n",
     "test.yaml:3: world[0].sphere.segments: 3; want a number >= 4"),
    ("world:\n  - mesh: meshes/none.glb\n", "test.yaml:3: world[0].mesh: 'meshes/none.glb': no such file in .; want"),
    ("world:\n  - mesh: none.stp\n", "test.yaml:3: world[0].mesh: 'none.stp'; want a mesh file ending in .glb, "),
    ("world:\n  - mesh: builtin:cra.glb\n", "test.yaml:3: world[0].mesh: 'builtin:cra.glb'; want builtin:car.glb or "),
    ("world:\n  - mesh: \"a\\0b.glb\"\n", "test.yaml:3: world[0].mesh: 'a\\x00b.glb': no such file"),
    ("world:\n  - {plane: {size_m: [1, 1]}, material: asfalt}\n",
     "test.yaml:3: world[0].material: 'asfalt'; want a material: asphalt, "),
    ("actors:\n  - {id: a, shape: {mesh: builtin:car.glb}, materials: {body: granite}}\n",
     "test.yaml:3: actors.a.materials.body: 'granite'; want a material: "),
    ("actors:\n  - {id: a, material: brick}\n",
     "test.yaml:3: actors.a.material: the actor has no shape that it could cover; want a shape, or no material"),
    ("actors: [{shape: {sphere: {radius_m: 1}}, material: brick}]\n", "test.yaml:2: actors[0].id: missing; want this"),
    ("actors: [{id: 3}]\n", "test.yaml:2: actors[0].id: 3; want a text"),
    ("actors: [{id: 3a}]\n", "test.yaml:2: actors.3a.id: '3a'; want a text of the form"),
    ("actors:\n  - {id: a}\n  - {id: a}\n",
     "test.yaml:4: actors[1].id: 'a' is also the id of number 0; want unique ids"),
    ("actors: [{id: world}]\n", "test.yaml:2: actors.world.id: 'world' is reserved for everything that does not move"),
    ("actors: [{id: a, class: lorry}]\n", "test.yaml:2: actors.a.class: 'lorry'; want 'car', 'truck', "),
    ("actors: [{id: a, motion: {at_m: [0, 0, .nan]}}]\n", "test.yaml:2: actors.a.motion.at_m[2]: nan; want a finite"),
    ("actors: [{id: a, motion: {at_m: [0, 0, true]}}]\n", "test.yaml:2: actors.a.motion.at_m[2]: True; want a num"),
    ("actors: [{id: a, motion: {waypoints: []}}]\n", "test.yaml:2: actors.a.motion.waypoints: 0 of them; want at"),
    ("actors:\n  - id: a\n    motion:\n      waypoints: [{t_s: 1, at_m: [0, 0, 0]}]\n      velocity_m_s: [1, 0, 0]\n",
     "test.yaml:6: actors.a.motion.velocity_m_s: beside waypoints; want either waypoints, or a start with a velocity"),
    ("actors:\n  - id: a\n    motion:\n      waypoints:\n"
     "        - {t_s: 1, at_m: [0, 0, 0]}\n        - {t_s: 1, at_m: [0, 0, 0]}\n",
     "test.yaml:7: actors.a.motion.waypoints[1].t_s: 1 after 1; want rising times"),
    ("actors: [{id: a, motion: {waypoints: [{t_s: 1, at_m: [0, 0, 0]}], loop: true}}]\n",
     "test.yaml:2: actors.a.motion.waypoints: 1 of them; want at least one, two for a loop"),
    ("actors: [{id: a, motion: {loop: true}}]\n", "test.yaml:2: actors.a.motion.loop: without waypoints; want"),
    ("sensors: [{id: s}]\n", "test.yaml:2: sensors.s.model: missing; want this key"),
    ("sensors: [{id: s, model: sick-lms219-s05}]\n", "test.yaml:2: sensors.s.model: 'sick-lms219-s05'; want sick-lms"),
    ("sensors: [{id: s, model: sick-lms291-s05, mount: {actor: ego}}]\n",
     "test.yaml:2: sensors.s.mount.actor: 'ego'; want none: the list is empty; leave it out for the world"),
    ("sensors: [{id: s, model: sick-lms291-s05, mount: {yaw: 3}}]\n",
     "test.yaml:2: sensors.s.mount.yaw: unknown key; did you mean yaw_deg? want one of "),
    ("sensors: [{id: s, model: sick-lms291-s05, mode: dream}]\n",
     "test.yaml:2: sensors.s.mode: 'dream'; want 'operational' or 'seed'"),
    ("sensors: [{id: s, model: sick-lms291-s05, links: pty:./x}]\n",
     "test.yaml:2: sensors.s.links: 'pty:./x'; want a list"),
    ("sensors: [{id: s, model: sick-lms291-s05, links: ['ptty:./x']}]\n", "test.yaml:2: sensors.s.links[0]: 'ptty:"),
    ("sensors: [{id: s, model: sick-lms291-s05, links: ['tcp:nowhere']}]\n", "test.yaml:2: sensors.s.links[0]: "),
    ("sensors:\n  - {id: s, model: sick-lms291-s05, links: ['pty:./x']}\n"
     "  - {id: t, model: sick-lms291-s05, links: ['pty:./x']}\n",
     "test.yaml:4: sensors.t.links[0]: 'pty:./x' is also a link of s; want a link used only once"),
    ("sensors: [{id: s, model: sick-lms291-s05, device: {a: [1, {b: .nan}]}}]\n",
     "test.yaml:2: sensors.s.device.a[1].b: nan; want a finite number"),
    ("sensors: [{id: s, model: paper-905nm, links: ['pty:./x']}]\n",
     "test.yaml:2: sensors.s.links: paper-905nm has no wire protocol; want no links"),
    ("sensors: [{id: s, model: sick-lms291-s05, from: [s]}]\n",
     "test.yaml:2: sensors.s.from: sick-lms291-s05 measures itself; want this key left out"),
    ("sensors: [{id: s, model: can-ars408}]\n", "test.yaml:2: sensors.s.from: missing; want the sensors that can-ars"),
    ("sensors: [{id: s, model: can-ars408, from: [x]}]\n", "test.yaml:2: sensors.s.from[0]: 'x'; want none"),
    ("weather: {fog: {visibility_m: -20.0}}\n", "test.yaml:2: weather.fog.visibility_m: -20.0; want a number > 0"),
    ("weather: {plumes: [{at_m: [0, 0, 0], size_m: [1, 2e9, 1], extinction_per_m: 0.1}]}\n",
     "test.yaml:2: weather.plumes[0].size_m[1]: 2000000000.0; want a number <= 1e+09"),
    ("weather: {plumes: [{at_m: [0, -3e9, 0], size_m: [1, 1, 1], extinction_per_m: 0.1}]}\n",
     "test.yaml:2: weather.plumes[0].at_m[1]: -3000000000.0; want a number >= -1e+09"),
    ("weather: {layers: [{top_m: 5e9, extinction_per_m: 0.1}]}\n",
     "test.yaml:2: weather.layers[0].top_m: 5000000000.0; want a number <= 1e+09"),
    ("weather: {layers: [{top_m: 5, extinction_per_m: 1e7}]}\n",
     "test.yaml:2: weather.layers[0].extinction_per_m: 10000000.0; want a number <= 1e+06"),
    ("weather: {spray: {length_m: 1e12}}\n",
     "test.yaml:2: weather.spray.length_m: 1000000000000.0; want a number <= 1e+09"),
    ("weather: {fgo: {}}\n", "test.yaml:2: weather.fgo: unknown key; did you mean fog? want one of "),
    ("weather: {spray: {behind: [x]}}\n", "test.yaml:2: weather.spray.behind[0]: 'x'; want none: the list is empty"),
    ("materials: {mine: {rho: 2}}\n", "test.yaml:2: materials.mine.rho: 2; want a number from 0 to 1"),
    ("materials: {mine: {ro: 0.2}}\n", "test.yaml:2: materials.mine.ro: unknown key; want rho"),
    ("materials: {mine: 3}\n", "test.yaml:2: materials.mine: 3; want keys with values"),
    ("schema: 1\n", "test.yaml:2: schema: given twice, first in line 1; want each key only once"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "reported"), BAD, ids=[reported.split(": ")[1] + str(n) for n, (_, reported) in enumerate(BAD)]
)
def test_one_fault_is_told_in_one_line(text: str, reported: str) -> None:
    lines = faults(text)
    assert len(lines) == 1
    assert lines[0].startswith(reported)
    assert "; want " in lines[0] or "? want " in lines[0]


def test_all_faults_are_told_at_once_in_the_order_of_the_file() -> None:
    text = "".join(text for text, _ in (BAD[0], BAD[3])) + (
        "world:\n  - {box: {size_m: [1, 2, 0]}, material: granite}\n"
        "actors:\n  - {id: a, motion: {at_m: [0, .nan, x]}}\n"
        "weather: {fog: {}}\n"
        "sensors:\n  - {id: s, model: nothing, mount: {actor: b, yaw: 2}, links: ['no:such']}\n"
    )
    keys = [line.split(": ")[1] for line in faults(text)]
    assert sorted(keys) == sorted([
        "sed", "seed", "world[0].box.size_m[2]", "world[0].material", "actors.a.motion.at_m[1]",
        "actors.a.motion.at_m[2]", "weather.fog", "sensors.s.model", "sensors.s.mount.actor", "sensors.s.mount.yaw",
        "sensors.s.links[0]",
    ])  # fmt: skip
    numbers = [int(line.split(":")[1]) for line in faults(text)]
    assert numbers == sorted(numbers)


@pytest.mark.parametrize("schema", ["2", "one", "1.5", ""])
def test_another_schema_is_refused(schema: str) -> None:
    with pytest.raises(ScenarioError, match=r"x.yaml:1: schema: .*; want 1"):
        loads(f"schema: {schema}\n", Path("x.yaml"))


@pytest.mark.parametrize("text", ["", "# nothing\n", "[]", "hello", "3"])
def test_a_file_that_is_no_table_is_refused(text: str) -> None:
    with pytest.raises(ScenarioError, match=r"^x.yaml:1: file: "):
        loads(text, Path("x.yaml"))


def test_empty_parts_pass() -> None:
    read("faults: []\nexpect: []\nrecord: {}\n")


def test_more_actors_than_fit_are_refused() -> None:
    text = "actors:\n" + "".join(f"  - {{id: a{k}}}\n" for k in range(10_001))
    (reported,) = faults(text)
    assert reported.startswith("test.yaml:2: actors: ")
    assert reported.endswith("want at most 10000 of them")


@given(data=st.data())
@settings(max_examples=cases(150), deadline=None)
def test_any_value_anywhere_gives_a_scenario_or_faults(data: st.DataObject) -> None:
    keys = (
        "schema seed world actors weather materials sensors faults expect record id shape mesh box size_m motion "
        "waypoints t_s at_m mount actor model links from device fog changes spray behind on material loop rho"
    ).split()
    leaves = st.none() | st.booleans() | st.integers(-3, 10**30) | st.floats() | st.sampled_from([*keys, "", "pty:x"])
    tree = st.recursive(
        leaves,
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(keys), inner, max_size=4),
        max_leaves=12,
    )
    table = {"schema": 1} | data.draw(st.dictionaries(st.sampled_from(keys), tree, max_size=5))
    text = json.dumps(table).replace("NaN", ".nan").replace("-Infinity", "-.inf").replace("Infinity", ".inf")
    reported = ""
    try:
        loads(text, Path("x.yaml"))
    except ScenarioError as error:
        reported = str(error)
    assert all(line.startswith("x.yaml:1: ") for line in reported.splitlines())


# ---------------------------------------------------------------- names, dump, schema


def test_built_in_scenarios_are_found_by_name_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = load("flat_wall")
    assert found.source.name == "flat_wall.yaml"
    (tmp_path / "flat_wall").write_text("schema: 1\nseed: 99\n")
    assert load("flat_wall").seed == 99  # a path wins


@pytest.mark.parametrize("name", ["flat_wal", "nothing at all", "a/b", "", "."])
def test_an_unknown_name_names_what_there_is(name: str) -> None:
    with pytest.raises(ScenarioError, match=r"flat_wall|no such file"):
        load(name)


def test_a_message_can_be_made_for_any_key() -> None:
    found = read(SENSOR)
    error = found.fault("sensors.0.device.unit", "km", "cm or mm")
    assert str(error) == "test.yaml:2: sensors.front.device.unit: 'km'; want cm or mm"
    assert found.label("sensors.0.model") == "test.yaml:2: sensors.front.model"


@pytest.mark.parametrize("name", scenario.builtin_names())
def test_what_is_dumped_is_read_as_the_same_scenario_anywhere(name: str, tmp_path: Path) -> None:
    found = load(name, ["weather.fog.visibility_m=300", "weather.changes=[{t_s: 1, fog: null}]"], seed=5)
    (tmp_path / "again.yaml").write_text(scenario.dump(found))
    again = load(str(tmp_path / "again.yaml"))
    assert again.model_dump(exclude={"world", "actors"}) == found.model_dump(exclude={"world", "actors"})
    assert [item.motion for item in again.actors] == [item.motion for item in found.actors]
    assert again.weather.at(2.0).fog is None
    for one, other in zip((*again.world, *again.actors), (*found.world, *found.actors), strict=True):
        one_shape, other_shape = (getattr(item, "shape", item) for item in (one, other))
        if other_shape is not None and other_shape.mesh is not None:
            assert again.resolve(one_shape.mesh).samefile(found.resolve(other_shape.mesh))
    assert scenario.dump(again) == scenario.dump(found)


def test_a_dump_is_the_same_whatever_was_dumped_before() -> None:
    texts = ["weather: {fog: {visibility_m: 50}}\n", "weather: {fog: {visibility_m: 50.0}, rain: {rate_mm_h: 2}}\n", ""]
    found = [read(SENSOR + text) for text in texts]
    fresh = []
    for one in found:
        scenario._written.cache_clear()
        fresh.append(scenario.dump(one))
    assert len(set(fresh)) == 3
    assert [scenario.dump(one) for one in found * 2] == fresh * 2
    kept = scenario._written.cache_info()
    assert kept.misses < kept.hits, "what two have in common is written once"


def test_every_default_is_in_the_dump() -> None:
    text = scenario.dump(
        read(SENSOR + "actors: [{id: a, shape: {cylinder: {radius_m: 1, height_m: 2}}, material: brick}]\n")
    )
    for part in ("seed: 0", "mode: operational", "yaw_deg: 0.0", "segments: 64", "class: unknown", "links: []"):
        assert part in text
    assert "scale" not in text
    assert "waypoints" not in text


def test_meshes_elsewhere_are_dumped_by_absolute_path(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    found = loads(HEAD + "world: [{mesh: m.obj, material: brick}]\n", tmp_path / "s.yaml")
    assert f"mesh: {tmp_path / 'm.obj'}" in scenario.dump(found)


def test_the_published_schema_is_current() -> None:
    """Written anew by `scenario.write_schema(Path("docs/scenario.schema.json"))`."""
    stored = json.loads((ROOT / "docs" / "scenario.schema.json").read_text(encoding="utf-8"))
    assert stored == scenario.json_schema()


def test_the_schema_describes_its_keys() -> None:
    schema = scenario.json_schema()
    assert schema["properties"]["schema"] == {"const": 1, "title": "Schema", "type": "integer"} or "const" in str(
        schema["properties"]["schema"]
    )
    assert "from" in schema["$defs"]["SensorConfig"]["properties"]
    assert "class" in schema["$defs"]["Actor"]["properties"]
    assert schema["$defs"]["Mount"]["additionalProperties"] is False
    assert schema["$defs"]["Sphere"]["properties"]["radius_m"]["exclusiveMinimum"] == 0.0
    assert "Meridians" in schema["$defs"]["Sphere"]["properties"]["segments"]["description"]
