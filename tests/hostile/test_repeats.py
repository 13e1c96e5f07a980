"""The sweeps that a long soak repeats, and the sockets that killed processes leave."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import numpy as np
import pytest

from emulator.endurance.guests import Guestbook, Judge
from emulator.endurance.repeats import CYCLE, FRESH, KINDS_KEPT, SCANS_KEPT, Repeated
from emulator.hosts.scans import HostScan
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.runtime.control import new_path
from protocols.scan import Scan, ScanPlan


def plan(sweep: int, gain: float = 1.0) -> ScanPlan:
    angles = np.array([0.0, 0.1])
    return ScanPlan(1, sweep, 1000 * sweep, angles, np.zeros(2), np.zeros(2), gain=gain)


class Counted:
    """Measures the number of its call."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, wanted: ScanPlan, conditions: Conditions = NORMAL) -> Scan:
        self.calls += 1
        echo = np.full((2, 1), float(self.calls))
        return Scan(wanted, echo, echo, np.zeros(2, np.uint8), np.full((2, 1), -1, np.int32))


def test_the_first_of_each_cycle_are_measured_and_the_rest_repeats_the_last_of_them() -> None:
    inner = Counted()
    repeated = Repeated(inner)
    scans = [repeated(plan(sweep)) for sweep in range(2 * CYCLE)]
    assert inner.calls == repeated.measured == 2 * FRESH
    assert repeated.repeated == 2 * (CYCLE - FRESH)
    assert [scan.plan.sweep for scan in scans] == list(range(2 * CYCLE))  # each under its own plan
    seen = {scan.range_m[0, 0] for scan in scans[FRESH:CYCLE]}
    assert seen == set(range(FRESH - SCANS_KEPT + 1, FRESH + 1))
    assert scans[CYCLE].range_m[0, 0] == FRESH + 1


def test_another_setting_is_measured_anew_and_few_kinds_are_kept() -> None:
    inner = Counted()
    repeated = Repeated(inner)
    for sweep in range(FRESH + 1):
        repeated(plan(sweep))
    assert repeated.repeated == 1
    for kind in range(KINDS_KEPT):
        repeated(plan(kind, gain=2.0 + kind))
    assert inner.calls == FRESH + KINDS_KEPT
    repeated(plan(0))  # forgotten meanwhile
    assert repeated.repeated == 1


def test_sockets_of_ended_processes_go_and_others_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = new_path().parent
    gone = 2**22 + 1  # beyond the kernel's largest process number
    listening = []
    for name in (f"{gone}.sock", f"{gone + 1}.sock", "mine.sock", "1.sock"):
        one = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        one.bind(str(folder / name))
        if name.startswith(str(gone + 1)):  # in another container
            one.listen(1)
        listening.append(one)
    (folder / f"{gone + 2}.txt").write_text("")
    assert new_path() == folder / f"{os.getpid()}.sock"
    for one in listening:
        one.close()
    assert {path.name for path in folder.iterdir()} == {f"{gone + 1}.sock", "mine.sock", "1.sock", f"{gone + 2}.txt"}


@pytest.mark.parametrize(("wrong", "faults"), [(0, {}), (1, {}), (3, {"wrong range": 1})])
def test_an_echo_of_noise_is_no_fault_and_a_wrong_wall_is(wrong: int, faults: dict[str, int]) -> None:
    book = Guestbook()
    ranges = np.full(9, 8.0)
    ranges[4 : 4 + wrong] = [6.5, 6.5, 7.0][:wrong]
    Judge(book, 9, np.inf, 0)(5, HostScan(0, np.radians(np.arange(-4.0, 5.0)), ranges))
    assert dict(book.faults) == faults
