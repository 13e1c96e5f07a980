"""A recording cut or damaged anywhere: read as far as it goes, or refused with its name; never anything else."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from emulator.commands.cli import main
from emulator.judging.trial import Trial
from emulator.recording.can_logs import LoggedFrame, candump_line, write_with_library
from emulator.recording.layout import decode_scan
from emulator.recording.reader import RecordedRun, read_run, read_wire
from emulator.recording.writer import RecordingError
from emulator.scenario import scenario
from tests.draws import cases

CASE = """\
schema: 1
duration_s: 0.5
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
  - {id: top, model: sick-ld-lrs1000, links: ["tcp:127.0.0.1:0"], device: {delays: fast, step_deg: 4.0}}
"""
Read = TypeVar("Read")
NAMES = ("run.mcap", "can.log", "can.asc", "can.blf")
anywhere = settings(max_examples=cases(60), deadline=None, derandomize=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("whole") / "run"
    trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=made)
    trial.finish()
    trial.close()
    frames = [LoggedFrame(10**9 + 250_000 * n, 0x600 + n % 7, bytes([n % 256] * (n % 9)), "can") for n in range(300)]
    (made / "can.log").write_text("".join(map(candump_line, frames)), encoding="ascii")
    write_with_library([made / "can.asc", made / "can.blf"], frames)
    assert all((made / name).stat().st_size > 500 for name in NAMES)
    return made


def read(reader: Callable[[Path], Read], path: Path) -> Read | None:
    """What was read; None when it was refused, with its name."""
    try:
        return reader(path)
    except RecordingError as error:
        reported = str(error)
    assert reported.startswith(str(path))
    return None


def payloads(run: RecordedRun) -> dict[tuple[str, int], list[bytes]]:
    return {key: [one.data for one in wire.payloads] for key, wire in run.sent.items()}


@anywhere
@given(share=st.floats(0.0, 1.0))
@example(share=0.0)
@example(share=1.0)
def test_a_recording_of_ours_cut_anywhere_gives_what_is_before_the_cut(folder: Path, share: float) -> None:
    whole = (folder / "run.mcap").read_bytes()
    size = round(share * len(whole))
    cut = folder.parent / "cut.mcap"
    cut.write_bytes(whole[:size])
    everything = payloads(read_run(folder))
    run = read(read_run, cut)
    if run is None:
        assert size < 2_000  # within the first records, before the layout's own
        return
    assert bool(run.cut) == (size < len(whole))
    for key, found in payloads(run).items():
        assert found == everything[key][: len(found)]


@anywhere
@given(share=st.floats(0.0, 0.999999), value=st.integers(1, 255))
def test_a_damaged_recording_of_ours_is_read_or_refused(folder: Path, share: float, value: int) -> None:
    data = bytearray((folder / "run.mcap").read_bytes())
    data[int(share * len(data))] ^= value
    damaged = folder.parent / "damaged.mcap"
    damaged.write_bytes(data)
    read(read_run, damaged)


def test_a_range_that_damage_has_made_a_signalling_nan_is_no_warning() -> None:
    data = struct.pack("<qqiII", 0, 0, 0, 1, 1) + 4 * struct.pack("<I", 0x7FA00000) + bytes(5) + b"[]"
    assert np.isnan(decode_scan(data).range_m[0, 0])


@anywhere
@given(name=st.sampled_from(NAMES[1:]), share=st.floats(0.0, 1.0))
@example(name="can.blf", share=0.01)
def test_a_can_log_cut_anywhere_gives_what_is_before_the_cut(folder: Path, name: str, share: float) -> None:
    whole = (folder / name).read_bytes()
    cut = folder.parent / f"cut-{name}"
    cut.write_bytes(whole[: round(share * len(whole))])
    everything = [one.data for one in read_wire(folder / name)[0].payloads]
    wires = read(read_wire, cut)
    found = [] if wires is None else [one.data for one in wires[0].payloads]
    assert found[:-1] == everything[: max(0, len(found) - 1)]  # a line of text may end in the middle of its bytes
    assert len(found) <= len(everything)


@pytest.mark.parametrize("share", [0.0, 0.0005, 0.3])
def test_the_commands_tell_a_cut_and_never_trace_back(
    folder: Path, tmp_path: Path, share: float, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = (folder / "run.mcap").read_bytes()
    (tmp_path / "cut").mkdir()
    (tmp_path / "cut" / "run.mcap").write_bytes(whole[: int(share * len(whole))])
    code = main(["diff", str(folder), str(tmp_path / "cut")])
    reported = capsys.readouterr()
    assert code == (1 if share > 0.1 else 2)
    assert "cut" in reported.err or "not an MCAP file" in reported.err
    assert "Traceback" not in reported.err


@pytest.mark.parametrize("name", ["run.mcap", "x.pcap", "x.blf", "x.log", "x.bin"])
def test_a_pipe_and_a_folder_are_refused_and_not_waited_for(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / name
    os.mkfifo(pipe)
    (tmp_path / "folder.pcap").mkdir()
    for path, reported in ((pipe, "not a regular file"), (tmp_path / "folder.pcap", "folder.pcap")):
        for command in (["diff", str(path), str(path)], ["replay", str(path), "--at-once"], ["report", str(path)]):
            assert main(command) == 2
            assert reported in capsys.readouterr().err
