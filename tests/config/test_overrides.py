"""Changes from the command line: any key, into lists by id or number, told like faults of the file."""

from __future__ import annotations

from pathlib import Path

import pytest

from emulator.errors import ScenarioError
from emulator.scenario.scenario import Scenario, load, loads

TEXT = """schema: 1
world: [{plane: {size_m: [6, 60]}, at_m: [8, 0, 0], material: brick}]
actors:
  - {id: ego}
  - {id: car, shape: {box: {size_m: [4, 2, 1]}}, material: brick}
sensors:
  - {id: front, model: sick-lms291-s05, links: ["pty:./a"]}
  - {id: rear, model: sick-lms291-s05, mount: {actor: ego}}
"""


def read(*overrides: str) -> Scenario:
    return loads(TEXT, Path("test.yaml"), overrides)


def reported(*overrides: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        read(*overrides)
    return str(caught.value)


def test_any_key_can_be_set_through_ids_numbers_and_missing_tables() -> None:
    found = read(
        "seed=12",
        "sensors.front.mount.yaw_deg=5",
        "sensors.1.mount.at_m=[1, 2, 3]",
        "sensors[0].device.unit=mm",
        "weather.fog.visibility_m=50",
        "world.0.plane.size_m[1]=7",
        "actors.car.material=asphalt",
        'sensors.rear.links=["tcp:127.0.0.1:0", "pty:./x"]',
        "duration_s= 2.5 ",
    )
    assert (found.seed, found.duration_s) == (12, 2.5)
    assert found.sensors[0].mount.yaw_deg == 5.0
    assert found.sensors[1].mount.at_m == (1.0, 2.0, 3.0)
    assert found.sensors[1].mount.actor == "ego"
    assert found.sensors[0].device == {"unit": "mm"}
    assert found.weather.fog is not None
    assert found.weather.fog.visibility_m == 50.0
    assert found.world[0].plane is not None
    assert found.world[0].plane.size_m == (6.0, 7.0)
    assert found.sensors[1].links == ("tcp:127.0.0.1:0", "pty:./x")


def test_the_last_of_several_changes_holds_and_null_takes_away() -> None:
    assert read("seed=1", "seed=2").seed == 2
    assert read("duration_s=4", "duration_s=null").duration_s is None


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "sensors.frnt.mode=seed",
            "--set sensors.frnt.mode=seed: sensors has no frnt; did you mean front? want front, ",
        ),
        ("sensors.2.mode=seed", "--set sensors.2.mode=seed: sensors has no 2; want front, rear or a number below 2"),
        ("schema.x=4", "--set schema.x=4: schema is a single value; want a table or list"),
        ("seed.x=4", "--set seed.x=4: seed: {'x': 4}; want a whole number"),
        ("world.0.at_m.1.x=4", "--set world.0.at_m.1.x=4: world.0.at_m.1 is a single value; want a table or list"),
        ("seed", "--set seed: not an override; want KEY=VALUE, "),
        ("=4", "--set =4: not an override; want KEY=VALUE, "),
        ("a..b=4", "--set a..b=4: not an override; want KEY=VALUE, "),
        ("seed=[1", "--set seed=[1:1: not YAML: "),
        ("seed=!!int 3", "--set seed=!!int 3:1: file: tag tag:yaml.org,2002:int; want plain data"),
        ("sensors.front.mount.yaw=4", "--set sensors.front.mount.yaw=4: sensors.front.mount.yaw: unknown key; did you"),
        ("seed=x", "--set seed=x: seed: 'x'; want a whole number"),
        (
            "weather.fog.visibility_m=-3",
            "--set weather.fog.visibility_m=-3: weather.fog.visibility_m: -3; want a number",
        ),
        (
            "sensors.rear.mount.actor=nobody",
            "--set sensors.rear.mount.actor=nobody: sensors.rear.mount.actor: 'nobody'",
        ),
        ("duration_s=.nan", "--set duration_s=.nan: duration_s: nan; want a finite number"),
    ],
)
def test_a_change_that_cannot_be_is_told_with_its_text(override: str, message: str) -> None:
    assert reported(override).startswith(message)


def test_all_changes_that_cannot_be_are_told_at_once() -> None:
    assert len(reported("x", "sensors.frnt.a=1", "schema.y=2").splitlines()) == 3


def test_a_change_mends_a_fault_of_the_file() -> None:
    with pytest.raises(ScenarioError):
        loads("schema: 1\nseed: x\n", Path("test.yaml"))
    assert loads("schema: 1\nseed: x\n", Path("test.yaml"), ["seed=3"]).seed == 3


def test_seed_and_links_replace_the_files(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(TEXT)
    found = load(str(tmp_path / "s.yaml"), ["seed=4"], seed=9, links={"front": ["loop:a", "pty:./b"]})
    assert found.seed == 9
    assert found.sensors[0].links == ("loop:a", "pty:./b")
    with pytest.raises(ScenarioError, match=r"--link fron=loop:a: sensors has no fron; did you mean front\?"):
        load(str(tmp_path / "s.yaml"), links={"fron": ["loop:a"]})
    with pytest.raises(ScenarioError, match=r"--link front=nope:x: sensors.front.links\[0\]: 'nope:x'"):
        load(str(tmp_path / "s.yaml"), links={"front": ["nope:x"]})
    with pytest.raises(ScenarioError, match=r"--seed -1: seed: -1; want a number >= 0"):
        load(str(tmp_path / "s.yaml"), seed=-1)


def test_a_file_that_is_no_table_cannot_be_changed() -> None:
    with pytest.raises(ScenarioError, match="--set seed=1: the file is not a table"):
        loads("[1, 2]", Path("x.yaml"), ["seed=1"])


def test_null_takes_away_a_list_and_a_key_that_may_not_be_null() -> None:
    changes = "weather.changes=[{t_s: 1, fog: {visibility_m: 50}}]"
    assert read(changes).weather.changes
    assert read(changes, "weather.changes=null").weather.changes == ()
    assert read("seed=4", "seed=null").seed == read().seed
    assert "sensors[0].id: missing" in reported("sensors.front.id=null")
    assert "did you mean weather?" in reported("wether=null")


def test_null_ends_weather_within_a_change() -> None:
    fog = "weather.fog.visibility_m=50"
    change = "weather.changes=[{t_s: 1, fog: {visibility_m: 20}}]"
    assert read(fog, change, "weather.changes.0.fog=null").weather.at(2.0).fog is None
