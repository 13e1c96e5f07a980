"""Folders of predictable names: what somebody may have planted there is refused, and said."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from emulator.errors import EmulatorError, LinkError
from emulator.process import private_folder
from emulator.runtime import control_socket
from emulator.runtime.control_socket import default_folder, new_path
from emulator.transports.shim import build_shim


def test_it_is_made_for_this_user_alone(tmp_path: Path) -> None:
    folder = private_folder.private_folder(tmp_path / "a" / "b", "go away")
    assert folder.stat().st_mode & 0o777 == 0o700
    assert private_folder.private_folder(folder, "go away") == folder


def plant_link(place: Path) -> None:
    elsewhere = place.parent / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    place.symlink_to(elsewhere)


def plant_link_to_nowhere(place: Path) -> None:
    place.symlink_to(place.parent / "nowhere")


def plant_file(place: Path) -> None:
    place.write_text("")


def plant_open(place: Path) -> None:
    place.mkdir()
    place.chmod(0o755)


PLANTED = [
    (plant_link, "a link to {}/elsewhere"),
    (plant_link_to_nowhere, "a link to {}/nowhere"),
    (plant_file, "a file"),
    (plant_open, "mode 0755"),
]


@pytest.mark.parametrize(("plant", "found"), PLANTED)
def test_what_is_planted_there_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plant: Callable[[Path], None], found: str
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    plant(tmp_path / "lidaremu")
    with pytest.raises(LinkError) as caught:
        new_path()
    want = "want a folder of this user alone, mode 0700: remove it, or set XDG_RUNTIME_DIR, or --control PATH"
    assert str(caught.value) == f"{tmp_path / 'lidaremu'}: {found.format(tmp_path)}; {want}"
    assert not list(tmp_path.rglob("*.sock"))


def test_a_folder_of_somebody_else_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "lidaremu").mkdir(mode=0o700)
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.raises(LinkError, match=f"lidaremu: a folder of user {tmp_path.stat().st_uid}; want"):
        default_folder()


@pytest.mark.parametrize(("mode", "allowed"), [(0o777, False), (0o1777, True), (0o755, True), (0o775, True)])
def test_a_folder_that_others_may_replace_is_refused(tmp_path: Path, mode: int, allowed: bool) -> None:
    (tmp_path / "above").mkdir()
    (tmp_path / "above").chmod(mode)
    folder = tmp_path / "above" / "ours"
    if allowed:
        assert private_folder.private_folder(folder, "go away") == folder
        return
    with pytest.raises(EmulatorError, match=r"above \(user \d+, mode 0777\) others can replace it; want .*go away"):
        private_folder.private_folder(folder, "go away")


def test_without_a_folder_of_the_user_it_lies_in_the_temporary_one_under_the_users_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(control_socket.tempfile, "gettempdir", lambda: str(tmp_path))
    assert default_folder() == tmp_path / f"lidaremu-{os.getuid()}"


def test_a_library_to_preload_is_not_taken_from_a_folder_that_was_planted(tmp_path: Path) -> None:
    plant_link(tmp_path / "lidaremu")
    with pytest.raises(EmulatorError, match=r"a link to .*; want a folder of this user alone"):
        build_shim({"PATH": os.environ["PATH"], "CC": "/bin/true", "XDG_CACHE_HOME": str(tmp_path)})


@pytest.mark.parametrize("plant", [plant_file, plant_link, plant_link_to_nowhere, plant_open])
def test_a_control_socket_takes_the_place_of_nothing_but_a_dead_socket(
    tmp_path: Path, plant: Callable[[Path], None]
) -> None:
    place = tmp_path / "control.sock"
    plant(place)
    before = sorted(tmp_path.rglob("*")), place.lstat().st_ino
    with pytest.raises(LinkError, match=r"control\.sock: a (file|link|folder) of that name exists; want a free path"):
        control_socket.Doorway(place)
    assert (sorted(tmp_path.rglob("*")), place.lstat().st_ino) == before
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(tmp_path / "dead.sock"))
    doorway = control_socket.Doorway(tmp_path / "dead.sock")
    with pytest.raises(LinkError, match="cannot listen for control: Address already in use"):
        control_socket.Doorway(tmp_path / "dead.sock")
    doorway.close()
    assert not (tmp_path / "dead.sock").exists()


def test_who_finds_a_control_socket_finds_somebody_who_listens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before: list[bool] = []
    link = os.link

    def linked(aside: Path, path: Path, **words: bool) -> None:
        before.append(control_socket.answers(aside) and not os.path.lexists(path))
        link(aside, path, **words)

    monkeypatch.setattr(control_socket.os, "link", linked)
    doorway = control_socket.Doorway(tmp_path / "control.sock")
    assert before == [True]
    assert [one.name for one in tmp_path.iterdir()] == ["control.sock"]
    doorway.close()
