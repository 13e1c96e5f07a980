"""What was written is read, up to where a file was cut; bytes that are not those that were written are found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import CRCValidationError, StreamReader

from emulator.commands.cli import main
from emulator.judging.trial import Trial
from emulator.recording import writer
from emulator.recording.compare import differences
from emulator.recording.reader import RecordedRun, read_run
from emulator.recording.streaming import Cut, Progress, items
from emulator.recording.writer import RecordingError
from emulator.scenario import scenario
from tests.recording.older import write_older

CASE = """\
schema: 1
duration_s: 0.6
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100}}
  - {id: top, model: sick-ld-lrs1000, links: ["tcp:127.0.0.1:0"], device: {delays: fast, step_deg: 4.0}}
"""


TRIED = 200
"Bytes, one after the other."


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with its end, of a dozen chunks."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer, "CHUNK_BYTES", 6_000)
        trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=folder)
        trial.finish()
        trial.close()
    return folder / "run.mcap"


def chunk_ends(path: Path) -> list[int]:
    """Where each chunk with its index ends, by a stranger's reader."""
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None
    return [one.chunk_start_offset + one.chunk_length + one.message_index_length for one in summary.chunk_indexes]


def unfinished(path: Path, target: Path) -> Path:
    """The same without its end, as after `kill -9`."""
    target.write_bytes(path.read_bytes()[: chunk_ends(path)[-1]])
    return target


def payloads(run: RecordedRun) -> dict[tuple[str, int], int]:
    return {key: len(wire.payloads) for key, wire in run.sent.items()}


def reported(run: RecordedRun) -> list[bytes]:
    return [one.data for _, wire in sorted(run.sent.items()) for one in wire.payloads]


def test_a_strangers_reader_finds_every_checksum_right_and_every_message_by_its_index(finished: Path) -> None:
    run = read_run(finished)
    with finished.open("rb") as file:
        assert sum(1 for _ in StreamReader(file, validate_crcs=True).records) > 100
        file.seek(0)
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert len(summary.chunk_indexes) >= 10
        assert summary.statistics.chunk_count == len(summary.chunk_indexes)
        count = summary.statistics.message_count
        assert (
            sum(1 for _ in reader.iter_messages()) == count == sum(summary.statistics.channel_message_counts.values())
        )
        found = [message.data for _, _, message in reader.iter_messages(topics=["/front/0/tx"], log_time_order=False)]
        assert sorted(found) == sorted(one.data for one in run.sent["front", 0].payloads)
        assert [item.name for item in reader.iter_attachments()] == ["scenario.yaml"]
        assert [item.name for item in reader.iter_metadata()] == ["lidaremu", "lidaremu.end"]
        # each entry of the index leads to the message that it tells of
        for index in summary.chunk_indexes:
            assert set(index.message_index_offsets) <= set(summary.channels)


def test_a_file_cut_at_any_byte_opens_up_to_its_last_whole_chunk(finished: Path, tmp_path: Path) -> None:
    whole, ends = finished.read_bytes(), chunk_ends(finished)
    everything = reported(read_run(finished))
    cut = tmp_path / "cut.mcap"
    at_chunk: dict[int, int] = {}
    for end in ends:  # with nothing behind it
        cut.write_bytes(whole[:end])
        at_chunk[end] = sum(payloads(read_run(cut)).values())
    assert len(set(at_chunk.values())) > 5
    for size in np.sort(np.random.default_rng(5).choice(np.arange(ends[0], len(whole)), 60, replace=False)).tolist():
        cut.write_bytes(whole[:size])
        run = read_run(cut)
        assert run.cut
        # a chunk is read as soon as it is whole, its index behind it may be missing
        least = at_chunk[max(end for end in ends if end <= size)]
        most = min((at_chunk[end] for end in ends if end > size), default=least)
        assert least <= sum(payloads(run).values()) <= most
        assert set(reported(run)) <= set(everything)
        assert isinstance(list(items(cut, Progress()))[-1], Cut)


def test_zeros_that_a_power_failure_leaves_are_a_cut(finished: Path, tmp_path: Path) -> None:
    path = unfinished(finished, tmp_path / "run.mcap")
    count = payloads(read_run(path))
    path.write_bytes(path.read_bytes() + bytes(5_000))
    run = read_run(path)
    assert "nothing but zeros" in run.cut
    assert payloads(run) == count


@pytest.mark.parametrize("ended", [True, False])
def test_a_byte_that_was_altered_anywhere_is_found(finished: Path, tmp_path: Path, ended: bool) -> None:
    """With its end any byte at all; without, any but those that nobody reads, and those that look like a cut."""
    path = tmp_path / "run.mcap"
    path.write_bytes(finished.read_bytes()) if ended else unfinished(finished, path)
    whole, run = path.read_bytes(), read_run(path)
    everything, rng = reported(run), np.random.default_rng(6)
    refused = 0
    for at in rng.choice(np.arange(8, len(whole)), TRIED, replace=False).tolist():
        data = bytearray(whole)
        data[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        try:
            run = read_run(path)
        except RecordingError as error:
            refused += str(error).startswith(f"{path}: ")
        else:
            assert not ended, f"byte {at} of {len(whole)}"
            found = reported(run)
            assert found == everything or run.cut  # nothing else is taken for what was recorded
            assert set(found) <= set(everything)
    assert refused == TRIED if ended else refused > 0.9 * TRIED


def test_an_altered_chunk_is_named_with_its_place_and_by_every_command(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with finished.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    start = summary.chunk_indexes[3].chunk_start_offset
    data = bytearray(finished.read_bytes())
    data[start + 70] ^= 0x10
    path = tmp_path / "run.mcap"
    path.write_bytes(data)
    with path.open("rb") as file, pytest.raises((CRCValidationError, RuntimeError)):
        list(StreamReader(file, validate_crcs=True).records)
    for command in (["diff", path, finished], ["replay", path, "--at-once"], ["report", path]):
        assert main(list(map(str, command))) == 2
        assert f"{path}: altered: " in (said := capsys.readouterr().err)
        assert f"chunk at byte {start}" in said


def test_what_is_behind_the_end_or_gone_from_the_middle_is_found(finished: Path, tmp_path: Path) -> None:
    whole, ends = finished.read_bytes(), chunk_ends(finished)
    path = tmp_path / "run.mcap"
    for data in (
        whole + b"\0" + whole[-8:],
        whole[: ends[2]] + whole[ends[3] :],  # a chunk is missing
        whole[: ends[2]] + whole[ends[1] : ends[2]] + whole[ends[2] :],  # one is there twice
        whole[: ends[2] + 10] + whole[ends[2] + 11 :],  # a byte is missing
    ):
        path.write_bytes(data)
        with pytest.raises(RecordingError, match="altered: "):
            read_run(path)


def test_a_recording_of_an_older_version_opens_as_ever(finished: Path, tmp_path: Path) -> None:
    old = tmp_path / "run.mcap"
    write_older(finished, old)
    assert differences(read_run(old), read_run(finished)) == []
    assert main(["diff", str(old), str(finished)]) == 0
    old.write_bytes(old.read_bytes()[:20_000])
    assert read_run(old).cut == "the file ends within a record"


def test_two_runs_make_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        trial = Trial(scenario.loads(CASE, Path("case.yaml")), record=tmp_path / name)
        trial.finish()
        trial.close()
    files = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert files == ["run.mcap", "scenario.yaml", "top.pcapng"]
    for name in files:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
