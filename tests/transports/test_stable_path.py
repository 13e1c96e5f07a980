"""Whose path it is: what is replaced, what is left alone."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from emulator.errors import LinkError
from emulator.transports.stable_path import FREE, SECOND_NS, StablePath

GONE = "/dev/pts/4000000"
"A terminal that does not exist."


@pytest.fixture
def port(tmp_path: Path) -> Path:
    (tmp_path / "folder").mkdir()
    return tmp_path / "folder" / "front"


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
    with pytest.raises(LinkError, match=f"a link to {target} not made by lidaremu"):
        StablePath(str(port), "/dev/pts/7")
    assert os.readlink(port) == target


def test_a_live_terminal_of_somebody_else_is_never_touched(port: Path) -> None:
    master, slave = os.openpty()
    port.symlink_to(os.ttyname(slave))
    with pytest.raises(LinkError, match="not made by lidaremu"):
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


def reported(place: StablePath, now_ns: int = 0) -> list[str]:
    return [f"{one.kind}: {one.text.removeprefix(place.path + ': ')}" for one in place.tend(now_ns)]


@pytest.fixture
def place(port: Path) -> Iterator[StablePath]:
    made = StablePath(str(port), GONE)
    yield made
    made.remove()


def test_a_link_that_stands_is_told_nothing_of(place: StablePath) -> None:
    assert reported(place) == []


def test_a_link_that_was_removed_is_put_back_and_told_once(place: StablePath, port: Path) -> None:
    port.unlink()
    assert reported(place) == ["link restored: was removed; restored"]
    assert os.readlink(port) == GONE
    assert reported(place) == []


def test_a_link_that_was_renamed_is_put_back_and_the_other_name_left(place: StablePath, port: Path) -> None:
    port.rename(port.parent / "old")
    assert reported(place) == ["link restored: was removed; restored"]
    assert os.readlink(port) == os.readlink(port.parent / "old") == GONE


@pytest.mark.parametrize("target", ["/dev/pts/4000001", "/no/such/place"])
def test_a_link_to_nowhere_in_its_place_is_replaced_and_said_where_it_led(
    place: StablePath, port: Path, target: str
) -> None:
    port.unlink()
    port.symlink_to(target)
    assert reported(place) == [f"link restored: a link to {target} was there; restored"]
    assert os.readlink(port) == GONE


def put_file(port: Path) -> None:
    port.write_text("precious")


def put_folder(port: Path) -> None:
    port.mkdir()
    (port / "precious").write_text("precious")


def put_link(port: Path) -> None:
    port.symlink_to("/dev/null")


@pytest.mark.parametrize(
    ("put", "what"), [(put_file, "a file"), (put_folder, "a folder"), (put_link, "a link to /dev/null")]
)
def test_what_is_somebody_elses_is_left_alone_until_it_goes(
    place: StablePath, port: Path, put: Callable[[Path], None], what: str
) -> None:
    port.unlink()
    put(port)
    before = sorted(str(path) for path in port.parent.rglob("*"))
    assert reported(place) == [f"link path taken: {what} exists there; left alone, restored when it is gone"]
    assert reported(place, 5 * SECOND_NS) == []
    assert sorted(str(path) for path in port.parent.rglob("*")) == before
    port.rename(port.parent / "elsewhere")
    assert reported(place, 6 * SECOND_NS) == ["link restored: was removed; restored"]


def test_a_living_terminal_in_its_place_is_left_alone_and_what_is_dead_is_not(place: StablePath, port: Path) -> None:
    master, slave = os.openpty()
    port.unlink()
    port.symlink_to(os.ttyname(slave))
    assert reported(place)[0].startswith("link path taken: a link to /dev/pts/")
    os.close(slave)
    os.close(master)
    assert reported(place, 1)[0].startswith("link restored: a link to /dev/pts/")


def test_a_link_that_its_mover_puts_back_is_told(place: StablePath, port: Path) -> None:
    port.rename(port.parent / "old")
    port.write_text("for a while")
    reported(place)
    (port.parent / "old").replace(port)
    assert reported(place) == ["link restored: points here again"]


def test_of_two_running_owners_the_one_that_came_later_keeps_the_path_until_it_ends(port: Path) -> None:
    first = StablePath(str(port), GONE)
    shutil.rmtree(port.parent)
    port.parent.mkdir()
    second = StablePath(str(port), "/dev/pts/4000001")  # nothing shows that the path was taken
    for number in range(100):
        found = reported(first, number * SECOND_NS)
        assert found[:1] == [] if number else "in use by a running emulator" in found[0], found
        assert reported(second, number * SECOND_NS) == []
        assert os.readlink(port) == "/dev/pts/4000001"
    second.remove()
    assert reported(first, 100 * SECOND_NS) == ["link restored: was removed; restored"]
    with pytest.raises(LinkError, match="in use by a running emulator"):
        StablePath(str(port), "/dev/pts/4000001")
    first.remove()
    assert os.listdir(port.parent) == []


def test_what_a_later_owner_left_behind_is_taken_over_though_its_terminal_lives_again(port: Path) -> None:
    first = StablePath(str(port), GONE)
    shutil.rmtree(port.parent)
    port.parent.mkdir()
    master, slave = os.openpty()  # somebody else's terminal, with the number that the later owner's had
    port.symlink_to(os.ttyname(slave))
    (port.parent / ".front.lidaremu").write_text("999999\n")
    assert reported(first)[0].startswith("link restored: a link to /dev/pts/")
    first.remove()
    os.close(master)
    os.close(slave)


def test_a_lock_that_was_removed_is_taken_anew_so_that_no_other_owner_comes(place: StablePath, port: Path) -> None:
    (port.parent / ".front.lidaremu").unlink()
    assert reported(place) == []
    port.unlink()
    with pytest.raises(LinkError, match="in use by a running emulator"):
        StablePath(str(port), "/dev/pts/4000001")
    assert reported(place) == ["link restored: was removed; restored"]


def test_a_folder_that_is_gone_is_told_and_waited_for(place: StablePath, port: Path) -> None:
    shutil.rmtree(port.parent)
    assert reported(place) == [
        f"link path gone: folder {port.parent} is gone; the link is restored when it exists again"
    ]
    assert reported(place, SECOND_NS) == []
    port.parent.mkdir()
    assert reported(place, 2 * SECOND_NS) == ["link restored: was removed; restored"]
    assert sorted(os.listdir(port.parent)) == [".front.lidaremu", "front"]


def test_who_is_robbed_again_and_again_waits_longer_each_time(place: StablePath, port: Path) -> None:
    at_s = []
    for second in range(1000):
        port.unlink(missing_ok=True)
        assert len(place.tend(second * SECOND_NS)) == port.is_symlink()
        at_s += [second] if port.is_symlink() else []
    assert at_s[:FREE] == list(range(FREE))
    gaps = [after - before for before, after in pairwise(at_s[FREE - 1 :])]
    assert gaps[:7] == [1, 2, 4, 8, 16, 32, 60]
    assert set(gaps[7:]) == {60}
    port.unlink(missing_ok=True)
    assert reported(place, 2000 * SECOND_NS) == ["link restored: was removed; restored"]
    port.unlink()
    assert reported(place, 2000 * SECOND_NS) == ["link restored: was removed; restored"]  # all is forgiven


def test_a_lock_in_whose_place_stands_something_else_is_refused(port: Path) -> None:
    os.mkfifo(port.parent / ".front.lidaremu")
    with pytest.raises(LinkError, match="not a file of this user"):
        StablePath(str(port), GONE)


def test_after_its_end_and_in_a_forked_child_nothing_is_put_back(port: Path) -> None:
    place = StablePath(str(port), GONE)
    port.unlink()
    child = os.fork()
    if child == 0:
        os._exit(len(place.tend(0)))
    assert os.waitpid(child, 0)[1] == 0
    place.remove()
    assert reported(place) == []
    assert os.listdir(port.parent) == []
