"""Paths of links of a run that others take away: when they are looked at, and what is told."""

from __future__ import annotations

import os
import select
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from emulator.instrument.instrument import Instrument
from emulator.process.clock import ManualClock
from emulator.process.incidents import KINDS, Incidents
from emulator.runtime import path_guard
from emulator.runtime.daemon import Daemon
from emulator.runtime.path_guard import AGAIN_NS, LOOK_NS, PathGuard
from emulator.transports.link import Link
from emulator.transports.schemes import open_link
from emulator.transports.stable_path import GONE, RESTORED, TAKEN
from emulator.transports.turns import Turn


@pytest.fixture
def links(tmp_path: Path) -> Iterator[list[Link]]:
    opened = [open_link(f"pty:{tmp_path / 'front'}"), open_link(f"slcan:{tmp_path / 'can'}"), open_link("loop:none")]
    yield opened
    for link in opened:
        link.close()


@pytest.fixture
def sensor(links: list[Link]) -> Instrument:
    return cast(Instrument, SimpleNamespace(sensor="front", links=tuple(links)))


def reported(incidents: Incidents) -> list[tuple[str, object, str]]:
    return [(str(row["kind"]), row["at_s"], str(row["text"]).rpartition("/")[2]) for row in incidents.rows()]


def readable(found: PathGuard) -> bool:
    return bool(select.select([found.fileno()], [], [], 0)[0])


def test_the_kinds_are_those_of_the_run() -> None:
    assert {RESTORED, TAKEN, GONE} <= set(KINDS)


def test_every_path_is_looked_at_once_a_second_where_nothing_is_told(
    sensor: Instrument, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none_left() -> Any:
        raise OSError(24, "no instance left")

    monkeypatch.setattr(path_guard, "FolderWatch", none_left)
    incidents = Incidents()
    found = PathGuard([sensor], incidents)
    assert found.fileno() == -1
    found.look(0)
    for name in ("front", "can"):
        (tmp_path / name).unlink()
    found.look(LOOK_NS - 1)
    assert not reported(incidents)
    assert found.next_ns() == LOOK_NS
    found.look(LOOK_NS, at_ns=7 * LOOK_NS)
    assert reported(incidents) == [(RESTORED, 7.0, f"{name}: was removed; restored") for name in ("front", "can")]
    assert (tmp_path / "front").is_symlink()
    assert (tmp_path / "can").is_symlink()


def test_a_change_is_seen_at_once_and_a_busy_folder_wakes_nobody_until_the_next_look(
    sensor: Instrument, tmp_path: Path
) -> None:
    incidents = Incidents()
    found = PathGuard([sensor], incidents)
    found.look(0)
    assert not readable(found)
    (tmp_path / "front").unlink()
    assert readable(found)
    found.changed(5)
    assert reported(incidents) == [(RESTORED, 5e-9, "front: was removed; restored")]
    for number in range(100):
        (tmp_path / f"{number}").touch()
    assert not readable(found)
    assert found.next_ns() == 5 + AGAIN_NS
    (tmp_path / "front").unlink()
    found.look(5 + AGAIN_NS)  # nothing that happened meanwhile is missed
    assert len(reported(incidents)) == 2
    found.changed(6 + AGAIN_NS)  # our own link was a change too
    found.look(6 + 2 * AGAIN_NS)
    assert not readable(found)
    (tmp_path / "more").touch()
    assert readable(found)


def test_a_folder_that_comes_back_is_watched_again(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    link = open_link(f"pty:{folder / 'front'}")
    incidents = Incidents()
    found = PathGuard([cast(Instrument, SimpleNamespace(sensor="front", links=(link,)))], incidents)
    found.look(0)
    folder.rename(tmp_path / "away")
    assert readable(found)
    found.changed(1)
    folder.mkdir()
    found.look(LOOK_NS)
    found.look(2 * LOOK_NS)
    assert [kind for kind, _, _ in reported(incidents)] == [GONE, RESTORED]
    (folder / "front").unlink()
    assert readable(found)
    link.close()
    found.close()


def test_a_run_without_paths_takes_no_descriptor_and_is_never_woken() -> None:
    link = open_link("loop:none")
    before = os.listdir("/proc/self/fd")
    found = PathGuard([cast(Instrument, SimpleNamespace(sensor="front", links=(link,)))], Incidents())
    assert (found.fileno(), found.next_ns()) == (-1, None)
    assert os.listdir("/proc/self/fd") == before


def test_the_daemon_puts_back_what_is_removed_while_nothing_else_is_due(links: list[Link], tmp_path: Path) -> None:
    class Idle:
        """A session that never wants anything, its line unplugged of time."""

        sensor, poked, connections_seen, powered, wanted_ns, lived_ns = "front", False, 0, False, -1, -1

        def __init__(self) -> None:
            self.links = tuple(links)
            self.input_budget = SimpleNamespace(turn=Turn(), rests=lambda now_ns: False)

        def close(self) -> None:
            pass

    clock = ManualClock()
    daemon = Daemon([cast(Instrument, Idle())], clock)
    asked = 0

    def removed() -> bool:
        nonlocal asked
        asked += 1
        if asked == 2:
            (tmp_path / "front").unlink()
        if asked == 4:
            assert (tmp_path / "front").is_symlink()
            (tmp_path / "can").unlink()
            clock.set(LOOK_NS)
        return asked < 6

    daemon.run(while_true=removed)  # the clock stands: the first change is told by the kernel, the second found in time
    assert [row["text"] for row in daemon.incidents.rows()] == [
        f"{tmp_path / name}: was removed; restored" for name in ("front", "can")
    ]
    daemon.close()
