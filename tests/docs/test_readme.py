"""What the README shows is true: its scenario builds, its bytes are what a session says, its commands exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from emulator.commands.cli import commands
from emulator.runtime.assembly import build_measures, new_sessions
from emulator.scenario import scenario
from emulator.sensors.spec import load_spec
from protocols import family

README = Path(__file__).resolve().parent.parent.parent / "README.md"


def blocks() -> list[str]:
    text = README.read_text(encoding="utf-8")
    return ["\n".join(line[4:] for line in block.splitlines()) for block in re.findall(r"(?:^    .*\n)+", text, re.M)]


def test_the_scenario_of_the_readme_loads_and_builds(tmp_path: Path) -> None:
    text = next(block for block in blocks() if block.startswith("schema:"))
    loaded = scenario.loads(text, tmp_path / "readme.yaml")
    assert len(new_sessions(loaded)) == 1
    assert set(build_measures(loaded)) == {"front"}


def test_every_command_of_the_readme_exists() -> None:
    named = set(re.findall(r"^lidaremu ([a-z]+)", "\n".join(blocks()), re.M))
    assert {"run", "demo", "look", "check", "list"} <= named <= set(commands.commands)


def test_the_dialogue_of_the_readme_is_what_the_session_says() -> None:
    dialogue = next(block for block in blocks() if block.startswith("host    02"))
    lines = [(line[:6].strip(), hexes(line[8:])) for line in dialogue.splitlines()]
    session = family("lms2xx").new_session({}, load_spec("sick-lms291-s05").device)
    session.power_on(0)
    session.take_emissions(0)
    now_ns, heard = 1_000_000_000, b""
    for who, data in lines:
        if who == "host":
            session.receive(data, now_ns)
            heard = b""
            for _ in range(60):
                session.advance(now_ns)
                heard += b"".join(item.payload for item in session.take_emissions(now_ns))
                now_ns += 1_000_000
        elif data[:5] != bytes.fromhex("02 80 D6 02 B0"):  # the scan itself needs a world
            assert data in heard, data.hex(" ")


def hexes(text: str) -> bytes:
    found = re.match(r"(?:[0-9A-F]{2} )+", text + " ")
    assert found is not None, text
    return bytes.fromhex(found[0])


@pytest.mark.parametrize("link", re.findall(r"\]\(([^)#]+)\)", README.read_text(encoding="utf-8")))
def test_every_page_the_readme_points_to_is_there(link: str) -> None:
    assert (README.parent / link).exists()
