"""`lidaremu fmu`: a scenario as a co-simulation FMU, by the extra `fmu`."""

from __future__ import annotations

import json
import re
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from emulator.commands.common import LONGEST_S, OK, load_scenario, scenario_options
from emulator.errors import EmulatorError
from emulator.output.lines import say

if TYPE_CHECKING:
    from emulator.scenario.scenario import Scenario

SCENARIO, FILES = "scenario.yaml", "files"
SLAVE = "lidaremu_fmu.py"


@click.command()
@click.argument("scenario")
@scenario_options
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), required=True, metavar="FILE", help="The FMU.")
@click.option("--actor", "actors", multiple=True, metavar="ID", help="Actor with inputs for its pose [all].")
def fmu(
    scenario: str, overrides: Sequence[str], seed: int | None, links: Sequence[str], out: Path, actors: Sequence[str]
) -> int:
    """Pack SCENARIO as a co-simulation FMU (FMI 2.0, OSMP), which runs it in lock-step with its master.

    Inputs: pose of each actor, or OSI SensorView; outputs: scans sent, OSI SensorData. The FMU calls the lidaremu that
    made it, or the command in its parameter `lidaremu`. Needs the extra `fmu`.
    """
    if out.suffix != ".fmu" or not out.absolute().parent.is_dir():
        raise EmulatorError(f"--out: {out}; want a file in an existing folder that ends in .fmu")
    loaded = load_scenario(scenario, (*overrides, "live.feed=lockstep:unix:lockstep"), seed, links)
    known = [actor.id for actor in loaded.actors]
    for name in actors:
        if name not in known:
            from emulator.config.names import nearest

            raise EmulatorError(f"--actor: {name!r}; want {nearest(name, known)}")
    packed = pack(loaded, out, [name for name in known if name in actors or not actors])
    say(f"{out}: {packed['inputs']} actors, {len(packed['sensors'])} sensors; runs {' '.join(packed['command'])}")
    return OK


def pack(scenario: Scenario, out: Path, actors: Sequence[str]) -> dict[str, Any]:
    """Write the FMU; what it was reported. `EmulatorError` without the extra."""
    try:
        from pythonfmu.builder import FmuBuilder
    except ImportError:
        raise EmulatorError("fmu needs pythonfmu: pip install 'lidaremu[fmu]'") from None
    from emulator.judging.trial import rehearse
    from emulator.live import fmu_slave

    rehearse(scenario)
    stem = re.sub(r"\W", "_", out.stem, flags=re.ASCII)
    config: dict[str, Any] = {
        "name": stem if not stem[:1].isdigit() else f"_{stem}",
        "description": f"lidaremu: {scenario.source.stem}",
        "scenario": SCENARIO,
        "command": [sys.executable, "-m", "emulator"],
        "sensors": [sensor.id for sensor in scenario.sensors],
        "actors": {name: start_of(scenario, name) for name in actors},
        "longest_s": LONGEST_S,
    }
    before, modules = list(sys.path), set(sys.modules)
    with tempfile.TemporaryDirectory(prefix="lidaremu-fmu-") as name:
        folder = Path(name)
        parts = [folder / fmu_slave.CONFIG, *place_files(scenario, folder)]
        parts[0].write_text(json.dumps(config, indent=1), encoding="utf-8")
        shutil.copyfile(fmu_slave.__file__, folder / SLAVE)
        made = folder / "made.fmu"
        try:
            FmuBuilder.build_FMU(folder / SLAVE, made, parts)
            without_strangers(made, out)
        except OSError as error:
            raise EmulatorError(f"{out}: cannot be written: {error.strerror}") from None
        finally:
            sys.path[:] = before
            for gone in set(sys.modules) - modules:
                if gone.startswith("lidaremu_fmu"):
                    del sys.modules[gone]
    return config | {"inputs": len(actors)}


def without_strangers(made: Path, out: Path) -> None:
    """The FMU without libraries of systems that lidaremu does not run on."""
    with zipfile.ZipFile(made) as given, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as kept:
        for entry in given.infolist():
            if not entry.filename.startswith("binaries/win"):
                kept.writestr(entry, given.read(entry), zipfile.ZIP_DEFLATED)


def start_of(scenario: Scenario, name: str) -> dict[str, float]:
    """An actor's pose at the start."""
    from emulator.world.scene import motion_of

    pose = motion_of(next(one.motion for one in scenario.actors if one.id == name)).pose(np.zeros(1))
    turned = pose.rotation[0]
    pitch = np.degrees(np.arcsin(np.clip(-turned[2, 0], -1.0, 1.0)))
    roll, yaw = (np.degrees(np.arctan2(*pair)) for pair in ((turned[2, 1], turned[2, 2]), (turned[1, 0], turned[0, 0])))
    at = pose.position_m[0]
    values = (at[0], at[1], at[2], yaw, pitch, roll)
    names = ("x_m", "y_m", "z_m", "yaw_deg", "pitch_deg", "roll_deg")
    return {key: float(value) + 0.0 for key, value in zip(names, values, strict=True)}


def place_files(scenario: Scenario, folder: Path) -> list[Path]:
    """The scenario, and the meshes, models and DBC files that it names, in `folder`; by relative paths there."""
    from ruamel.yaml import YAML

    from emulator.scenario.scenario import dump

    yaml = YAML(typ="safe", pure=True)
    data = yaml.load(dump(scenario))
    (folder / FILES).mkdir()
    reported: dict[str, str] = {}

    def placed(text: str) -> str:
        path = Path(text)
        if not path.is_absolute() or not path.is_file():
            return text
        if text not in reported:
            reported[text] = f"{FILES}/{len(reported)}_{path.name}"
            shutil.copyfile(path, folder / reported[text])
        return reported[text]

    def walk(entry: Any) -> Any:
        if isinstance(entry, dict):
            return {
                key: placed(value)
                if key in ("mesh", "model", "dbc") and isinstance(value, str)
                else [placed(one) for one in value]
                if key == "meshes" and isinstance(value, list)
                else walk(value)
                for key, value in entry.items()
            }
        return [walk(one) for one in entry] if isinstance(entry, list) else entry

    with (folder / SCENARIO).open("w", encoding="utf-8") as file:
        yaml.dump(walk(data), file)
    return [folder / SCENARIO, folder / FILES]
