"""CAN frames as other tools log them: candump text, and BLF and ASC through python-can.

candump's lines are written here: python-can appends a direction letter that tshark refuses.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

from emulator.process.quiet_loggers import muted
from protocols.can_frame import EXTENDED

_LINE = re.compile(
    r"\((\d{1,12})\.(\d{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#((?:[0-9A-Fa-f]{2}){0,8})(?:\s+[RT])?\s*\Z"
)


class LoggedFrame(NamedTuple):
    """One frame."""

    at_ns: int
    peer: int
    "Identifier, bit 31 for extended."
    data: bytes
    channel: str


def candump_line(frame: LoggedFrame) -> str:
    """`(seconds.micros) channel ID#DATA`."""
    seconds, micros = divmod(frame.at_ns // 1000, 1_000_000)
    identifier = f"{frame.peer & 0x1FFFFFFF:08X}" if frame.peer & EXTENDED else f"{frame.peer:03X}"
    return f"({seconds:010d}.{micros:06d}) {frame.channel} {identifier}#{frame.data.hex().upper()}\n"


def read_candump(lines: Iterable[str]) -> Iterator[LoggedFrame]:
    """Frames of a candump log; lines that are none (remote, error and FD frames, comments) are passed over."""
    for line in lines:
        match = _LINE.match(line.strip())
        if match:
            seconds, part, channel, identifier, data = match.groups()
            peer = int(identifier, 16) | (EXTENDED if len(identifier) == 8 else 0)
            yield LoggedFrame(int(seconds) * 10**9 + int(part.ljust(9, "0")), peer, bytes.fromhex(data), channel)


def write_with_library(paths: Sequence[Path], frames: Iterable[LoggedFrame]) -> None:
    """The same frames into .blf and .asc files, by the ending of each name."""
    with contextlib.ExitStack() as opened:
        files: list[IO[Any]] = [
            opened.enter_context(path.open("w" if path.suffix == ".asc" else "w+b")) for path in paths
        ]
        write_logs(list(zip((path.suffix for path in paths), files, strict=True)), frames)


def write_logs(files: Sequence[tuple[str, IO[Any]]], frames: Iterable[LoggedFrame]) -> None:
    """Frames into open files, each with its ending; `OSError` when one cannot be written. Closes the files."""
    import can

    writers: list[Any] = []
    file: Any
    for ending, file in files:
        writer: Any = can.ASCWriter(file) if ending == ".asc" else can.BLFWriter(file)
        writers.append(writer)
        # instants count from the start of the run, not from the first frame: as in every other file of it
        if ending == ".asc":
            writer.log_event("Start of the run", 0.0)
        else:
            writer.start_timestamp = 0.0
    for frame in frames:
        message = can.Message(
            timestamp=frame.at_ns * 1e-9,
            arbitration_id=frame.peer & 0x1FFFFFFF,
            is_extended_id=bool(frame.peer & EXTENDED),
            data=frame.data,
            channel=0,
        )
        for writer in writers:
            writer.on_message_received(message)
    for writer in writers:
        writer.stop()


def read_with_library(path: Path) -> list[LoggedFrame]:
    """Frames of a .blf or .asc file, as far as it can be read; `ValueError` when nothing can."""
    with muted("can"):
        return _read_with_library(path)


def _read_with_library(path: Path) -> list[LoggedFrame]:
    import can

    found: list[LoggedFrame] = []
    text = path.suffix == ".asc"
    file: Any
    with path.open("r" if text else "rb") as file:  # a reader that refuses the first bytes would leave it open
        try:
            for message in can.ASCReader(file) if text else can.BLFReader(file):
                if not (message.is_error_frame or message.is_remote_frame or message.is_fd):
                    peer = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
                    at_ns = round(message.timestamp * 1e9)
                    found.append(LoggedFrame(at_ns, peer, bytes(message.data), str(message.channel)))
        except Exception as error:
            # python-can has no single error for a damaged log; what came before the damage is kept
            if not found:
                raise ValueError(f"not a readable log: {error}") from None
    return found
