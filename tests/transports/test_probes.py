"""Probes answer, whatever the machine is, and leave nothing open."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from emulator.transports import probes
from emulator.transports.probes import (
    Probe,
    probe_compiler,
    probe_datagrams,
    probe_links,
    probe_open_watch,
    probe_pseudo_terminals,
)


def test_every_question_gets_an_answer_and_nothing_stays_open() -> None:
    before = len(os.listdir("/proc/self/fd"))
    answers = probe_links(os.environ)
    assert len({answer.name for answer in answers}) == 7
    assert all(answer.detail for answer in answers)
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_pseudo_terminal_takes_the_speeds_the_sensors_need() -> None:
    assert probe_pseudo_terminals() == Probe(
        "pseudo-terminals", True, "speeds seen from the other end: 9600, 500000, 123457"
    )


def test_what_is_missing_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert probe_compiler({"PATH": str(tmp_path)}) == Probe("C compiler for --shim", False, "none of cc, gcc, clang")

    def none_left(_path: str) -> None:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(probes, "OpenWatch", none_left)
    assert not probe_open_watch().works
    monkeypatch.setattr(os, "openpty", none_left.__get__("x"))
    assert not probe_pseudo_terminals().works


def test_the_mtu_of_each_interface_is_told_and_which_has_jumbo_frames(tmp_path: Path) -> None:
    for name, mtu in (("eth0", "1500"), ("eth1", "9000"), ("lo", "65536"), ("odd", "no number")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mtu").write_text(f"{mtu}\n")
    (tmp_path / "buffer").write_text("212992\n")
    probe = probe_datagrams(tmp_path, tmp_path / "buffer")
    assert probe.works
    assert "eth0 1500 (datagrams to 1472 bytes leave whole), eth1 9000 (jumbo, datagrams to 8972 bytes" in probe.detail
    assert "lo 65536 (datagrams" in probe.detail
    assert "send buffer 212992 bytes" in probe.detail
    assert not probe_datagrams(tmp_path / "none").works
    assert "send buffer unknown" in probe_datagrams(tmp_path, tmp_path / "none").detail
