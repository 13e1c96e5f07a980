"""What the files of a recording are called: a log a bus, whatever channels are called and links look like."""

from __future__ import annotations

import re
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.judging.rig import free_links
from emulator.judging.trial import Trial
from emulator.recording.can_logs import read_candump
from emulator.recording.names import LONGEST, bus_names, distinct, plain, planned
from emulator.recording.reader import read_run
from emulator.recording.writer import RecordingError
from emulator.scenario import scenario
from tests.draws import cases

LISTS = """\
schema: 1
duration_s: 0.8
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
"""


def lists(*links: str) -> str:
    """A scenario with a sensor that lists objects on each of those links."""
    rows = [
        f'  - {{id: list{number}, model: can-ars408, from: [front], links: ["{url}"]}}\n'
        for number, url in enumerate(links, 1)
    ]
    return LISTS + "".join(rows)


def stems(*links: str) -> list[str]:
    return [name.stem for name in bus_names({url: url for url in links}).values()]


@pytest.mark.parametrize(
    ("links", "names"),
    [
        (["socketcand:127.0.0.1:5000/can0"], ["can0"]),
        (["socketcand:127.0.0.1:5000/can0", "socketcand:127.0.0.1:5000/can1"], ["can0", "can1"]),
        (["socketcand:127.0.0.1:5000/can0", "socketcand:127.0.0.1:5001/can0"], ["can0-5000", "can0-5001"]),
        (["socketcand::5000/can0", "socketcand:[::1]:5001/can0"], ["can0-5000", "can0-5001"]),
        (["socketcand:127.0.0.1:0/can0", "socketcand:127.0.0.1:5001/can0"], ["can0", "can0-2"]),
        (["socketcand:127.0.0.1:5000/can0", "socketcand:127.0.0.2:5000/can0"], ["can0", "can0-2"]),
        (["can:virtual:x", "can:socketcan:x"], ["x-virtual", "x-socketcan"]),
        (["slcan:./left/can", "slcan:./right/can"], ["can-left", "can-right"]),
        (["slcan:./can", "slcan:./other/can"], ["can", "can-2"]),
        (["can:virtual:can0", "socketcand:127.0.0.1:5000/CAN0"], ["can0-virtual", "CAN0-5000"]),
        (["can:virtual:a/b", "can:virtual:..", "can:virtual:käfig"], ["b", "_.", "k_fig"]),
        (["can:virtual:run", "can:virtual:scenario"], ["run", "scenario"]),
        (["socketcand::1/a", "socketcand::2/a", "socketcand::3/a-1"], ["a-1", "a-2", "a-1-2"]),
    ],
)
def test_buses_of_one_channel_name_get_names_of_their_own(links: list[str], names: list[str]) -> None:
    found = stems(*links)
    assert found == names
    assert stems(*links) == found


@settings(max_examples=cases(200), deadline=None, derandomize=True)
@given(texts=st.lists(st.text(max_size=300), max_size=8), sensors=st.lists(st.from_regex(r"[a-z]{1,3}\Z"), unique=True))
def test_names_of_files_are_plain_and_no_two_are_the_same_anywhere(texts: list[str], sensors: list[str]) -> None:
    found = distinct([plain(text, "can") for text in texts])
    assert all(re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9_.-]*", name) and len(name) <= LONGEST + 4 for name in found)
    files = ["run.mcap", *planned(found, sensors)]
    assert len({name.casefold() for name in files}) == len(files)


def test_names_that_differ_in_capitals_alone_are_numbered() -> None:
    assert distinct(["Front", "front", "front-2", "front"]) == ["Front", "front-3", "front-2", "front-4"]


def logged(path: Path) -> list[tuple[int, bytes, str]]:
    """Identifier, data and channel of each line."""
    return [(one.peer, one.data, one.channel) for one in read_candump(path.read_text().splitlines())]


def test_two_buses_of_one_channel_name_get_two_logs_and_two_sensors_of_a_bus_one(tmp_path: Path) -> None:
    links = [f"socketcand:127.0.0.1:{port}/can0" for port in (5000, 5001, 5001)]
    trial = Trial(scenario.loads(lists(*links), Path("case.yaml")), record=tmp_path / "run")
    trial.finish()
    trial.close()
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == [
        *(f"can0-{port}{ending}" for port in (5000, 5001) for ending in (".asc", ".blf", ".log")),
        "run.mcap",
        "scenario.yaml",
    ]
    one, two = (logged(tmp_path / "run" / f"can0-{port}.log") for port in (5000, 5001))
    assert len(one) >= 3
    assert len(two) == 2 * len(one)  # each frame of both sensors, once
    assert {channel for _, _, channel in one + two} == {"can0"}
    sent = read_run(tmp_path / "run").sent
    assert [(peer, data) for peer, data, _ in one] == [(item.peer, item.data) for item in sent["list1", 0].payloads]
    for port, lines in ((5000, one), (5001, two)):
        for ending in (".asc", ".blf"):
            with can.LogReader(tmp_path / "run" / f"can0-{port}{ending}") as frames:
                assert [bytes(frame.data) for frame in frames] == [data for _, data, _ in lines]


def test_a_channel_called_like_another_file_of_the_recording_is_no_trouble(tmp_path: Path) -> None:
    text = lists("can:virtual:run", "can:virtual:scenario", "can:virtual:front")
    trial = Trial(scenario.loads(text, Path("case.yaml")), record=tmp_path / "run")
    trial.finish()
    trial.close()
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert {"run.mcap", "run.log", "scenario.yaml", "scenario.log", "front.log"} <= names


def test_the_name_of_a_log_with_a_number_is_looked_for_too(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "can0-5001.blf").write_text("mine")
    text = lists("socketcand::5000/can0", "socketcand::5001/can0")
    with pytest.raises(RecordingError, match=r"can0-5001\.blf"):
        Trial(scenario.loads(text, Path("case.yaml")), record=tmp_path / "run")


def test_a_rigs_free_ports_leave_two_buses_two(tmp_path: Path) -> None:
    links = [*(f"socketcand:127.0.0.1:{port}/can0" for port in (5000, 5001, 5001)), "socketcand:127.0.0.1:5001/can1"]
    found = free_links(scenario.loads(lists(*links), Path("case.yaml")), tmp_path)
    urls = [found[f"list{number}"][0] for number in (1, 2, 3, 4)]
    assert urls[0] == "socketcand:127.0.0.1:0/can0"
    assert urls[1] == urls[2] != urls[0]
    assert urls[3].replace("can1", "can0") == urls[1]
