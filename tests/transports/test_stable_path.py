"""Whose path it is: what is replaced, what is left alone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from emulator.errors import LinkError
from emulator.transports.stable_path import StablePath

GONE = "/dev/pts/4000000"
"A terminal that does not exist."


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "front"


def test_it_leads_to_its_target_and_leaves_nothing_behind(port: Path) -> None:
    place = StablePath(str(port), "/dev/pts/7")
    assert os.readlink(port) == "/dev/pts/7"
    place.remove()
    place.remove()
    assert os.listdir(port.parent) == []


def test_a_link_that_leads_nowhere_is_replaced(port: Path) -> None:
    port.symlink_to(GONE)
    place = StablePath(str(port), "/dev/pts/7")
    assert os.readlink(port) == "/dev/pts/7"
    place.remove()
    assert os.listdir(port.parent) == []


def test_after_a_crash_a_terminal_number_that_lives_again_does_not_block(port: Path) -> None:
    master, slave = os.openpty()  # somebody else's terminal, with the number that ours had
    port.symlink_to(os.ttyname(slave))
    (port.parent / ".front.lidaremu").write_text("999999\n")
    place = StablePath(str(port), "/dev/pts/7")
    assert os.readlink(port) == "/dev/pts/7"
    place.remove()
    os.close(master)
    os.close(slave)


def test_a_path_in_use_by_a_running_emulator_is_refused_with_its_process(port: Path) -> None:
    place = StablePath(str(port), GONE)
    with pytest.raises(LinkError, match=rf"in use by a running emulator \(process {os.getpid()}\)"):
        StablePath(str(port), "/dev/pts/7")
    assert os.readlink(port) == GONE
    place.remove()
    StablePath(str(port), "/dev/pts/7").remove()


def test_a_file_of_that_name_is_never_touched(port: Path) -> None:
    port.write_text("precious")
    with pytest.raises(LinkError, match="a file of that name exists"):
        StablePath(str(port), "/dev/pts/7")
    assert port.read_text() == "precious"
    assert os.listdir(port.parent) == ["front"]


def test_a_folder_of_that_name_is_never_touched(port: Path) -> None:
    port.mkdir()
    with pytest.raises(LinkError, match="a folder of that name exists"):
        StablePath(str(port), "/dev/pts/7")


@pytest.mark.parametrize("target", ["/dev/null", "/dev/ttyUSB77", "elsewhere"])
def test_a_link_of_somebody_else_is_never_touched(port: Path, target: str) -> None:
    port.symlink_to(target)
    with pytest.raises(LinkError, match=f"a link to {target} that is not ours"):
        StablePath(str(port), "/dev/pts/7")
    assert os.readlink(port) == target


def test_a_live_terminal_of_somebody_else_is_never_touched(port: Path) -> None:
    master, slave = os.openpty()
    port.symlink_to(os.ttyname(slave))
    with pytest.raises(LinkError, match="not ours"):
        StablePath(str(port), "/dev/pts/7")
    os.close(master)
    os.close(slave)


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=f"folder {tmp_path / 'no'} does not exist"):
        StablePath(str(tmp_path / "no" / "front"), "/dev/pts/7")


def test_a_link_that_has_been_replaced_meanwhile_stays(port: Path) -> None:
    place = StablePath(str(port), "/dev/pts/7")
    port.unlink()
    port.write_text("mine now")
    place.remove()
    assert os.listdir(port.parent) == ["front"]


def test_a_forked_child_takes_nothing_away(port: Path) -> None:
    place = StablePath(str(port), GONE)
    child = os.fork()
    if child == 0:
        place.remove()
        os._exit(0)
    os.waitpid(child, 0)
    assert os.readlink(port) == GONE
    with pytest.raises(LinkError, match="in use"):
        StablePath(str(port), "/dev/pts/7")
    place.remove()


def test_a_lock_that_was_removed_while_we_took_it_is_taken_anew(port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = []
    real = StablePath._open_lock

    def removed_once(self: StablePath) -> int:
        fd = real(self)
        opened.append(fd)
        if len(opened) == 1:
            os.unlink(port.parent / ".front.lidaremu")
        return fd

    monkeypatch.setattr(StablePath, "_open_lock", removed_once)
    place = StablePath(str(port), GONE)
    assert len(opened) == 2
    with pytest.raises(LinkError, match="in use"):
        StablePath(str(port), GONE)
    place.remove()


def test_a_name_too_long_for_the_file_system_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="File name too long"):
        StablePath(str(tmp_path / ("x" * 300)), "/dev/pts/7")
