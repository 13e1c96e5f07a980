"""`lidaremu check` refuses, with file and line, what `test` and `run` would."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from emulator.commands.cli import main

HEAD = "schema: 1\nactors: [{id: car}]\nsensors:\n"
FRONT = "  - {id: front, model: sick-lms291-s05%s}\n"
LD = "  - {id: %s, model: sick-ld-oem1000, links: ['%s']}\n"


def refused(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    path = tmp_path / "case.yaml"
    path.write_text(text, encoding="utf-8")
    assert main(["check", str(path)]) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("that", "reported"),
    [
        ("frnt.points", "sensor 'frnt'; want front"),
        ("front.pionts", "front.pionts; want points"),
        ("max(front.points_on(cra)) > 1", "actor 'cra'; want car"),
        ("front.points >", "want a number"),
    ],
)
def test_names_in_expect(that: str, reported: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    err = refused(HEAD + FRONT % "" + f"expect:\n  - {{that: '{that}', at_least: 1}}\n", tmp_path, capsys)
    assert "case.yaml:6: " in err
    assert reported in err


def test_faults_in_expect_and_elsewhere_are_told_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = HEAD + FRONT % ", device: {field_deg: 7}" + "expect: [{that: frnt.points, at_least: 1}]\n"
    err = refused(text, tmp_path, capsys)
    assert "sensor 'frnt'" in err
    assert "field_deg" in err


def test_faults_in_expect_are_told_beside_wrong_links_and_models(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = HEAD + LD % ("a", "tcp:127.0.0.1:2111") + LD % ("b", "tcp::2111") + "  - {id: c, model: sick-lms2x1}\n"
    text += "expect:\n  - {that: a.pionts, at_least: 1}\n  - {that: b.points, below: 1}\n"
    err = refused(text, tmp_path, capsys)
    reported = ["also a link of a", "sick-lms2x1", "a.pionts; want points", "below: 1; want that"]
    places = [err.index(one) for one in reported]
    assert places == sorted(places)
    assert "\n5 errors" not in err
    assert main(["check", str(tmp_path / "case.yaml"), "--json"]) == 2
    assert len(json.loads(capsys.readouterr().out)["faults"]) == 4


@pytest.mark.parametrize(
    ("sensor", "reported"),
    [
        (FRONT % ", links: ['socketcand:127.0.0.1:0/can0']", "lms2xx is not spoken on socketcand; want a link of pty"),
        (FRONT % ", links: ['can:virtual:x']", "lms2xx is not spoken on can"),
        (
            FRONT % "" + "  - {id: o, model: can-ars408, from: [front], links: ['pty:./x']}\n",
            "can_objects is not spoken on pty; want a link of socketcand, slcan, can",
        ),
    ],
)
def test_a_link_that_the_family_does_not_speak(
    sensor: str, reported: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reported in refused(HEAD + sensor, tmp_path, capsys)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("tcp:127.0.0.1:2111", "tcp::2111"),
        ("tcp:*:2111", "tcp:127.0.0.1:2111"),
        ("pty:./a", "pty:a"),
        ("pty:./b/../a", "pty:a?speed=ignore"),
        ("udp:127.0.0.1:5000?listen=7000", "udp:127.0.0.1:5001?listen=7000"),
        ("serial:/dev/ttyUSB0", "serial:/dev/../dev/ttyUSB0?baud=38400"),
    ],
)
def test_two_links_in_one_place(first: str, second: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    err = refused(HEAD + LD % ("a", first) + LD % ("b", second), tmp_path, capsys)
    assert f"{second!r} is also a link of a; want a link used only once" in err
    assert "case.yaml:5: " in err


def test_a_port_of_a_can_server_and_of_a_sensor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bus = "  - {id: o, model: can-ars408, from: [a], links: ['socketcand:127.0.0.1:2111/can0']}\n"
    err = refused(HEAD + LD % ("a", "tcp:127.0.0.1:2111") + bus, tmp_path, capsys)
    assert "is also a link of a" in err


def test_links_that_may_be_shared(tmp_path: Path) -> None:
    text = HEAD + LD % ("a", "tcp:127.0.0.1:0") + LD % ("b", "tcp:127.0.0.1:0") + LD % ("c", "tcp:127.0.0.2:2111")
    text += LD % ("d", "tcp:127.0.0.1:2111")
    for number, url in enumerate(("socketcand:127.0.0.1:5000/can0", "socketcand:127.0.0.1:5000/can1", "slcan:./s")):
        text += f"  - {{id: o{number}, model: can-ars408, from: [a], links: ['{url}']}}\n"
        text += f"  - {{id: p{number}, model: can-ars408, device: {{sensor_id: 1}}, from: [a], links: ['{url}']}}\n"
    path = tmp_path / "case.yaml"
    path.write_text(text, encoding="utf-8")
    assert main(["check", str(path)]) == 0


@pytest.mark.parametrize("line", ["\t- {id: front}", "  \t- {id: front}", "  - id: front\n\tmodel: x"])
def test_a_tab_is_told_to_be_spaces(line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    err = refused(f"schema: 1\nsensors:\n{line}\n", tmp_path, capsys)
    assert "a tab where a line is indented; want spaces: use spaces to indent" in err


@pytest.mark.parametrize(
    ("model", "near"),
    [("lms291", "sick-lms291-s05"), ("SICK_LMS291_S05", "sick-lms291-s05"), ("oem1000", "sick-ld-oem1000"),
     ("vu8", "can-leddar-vu8"), ("ars408-21", "can-ars408"), ("ld-lrs", "sick-ld-lrs1000")],
)  # fmt: skip
def test_an_unknown_model_points_to_the_list_and_to_the_nearest(
    model: str, near: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    err = refused(f"schema: 1\nsensors: [{{id: front, model: {model}}}]\n", tmp_path, capsys)
    assert "see `lidaremu list sensors`" in err
    assert near in err
