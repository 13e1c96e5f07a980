"""Reads a `run.mcap` piece by piece, so that an hour of it needs no more memory than a second.

Belongs here: records in the order of the file to whoever takes them. Not: a whole run in memory (reader).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.records import Attachment, Channel, Message, Metadata
from numpy.typing import NDArray

from emulator.config.budgets import loads_json
from emulator.recording import layout
from emulator.recording.bounds import Altered, TooLarge, mcap_records, regular
from emulator.recording.folder import RecordingError
from emulator.recording.layout import RecordedScan, decode_scan
from emulator.recording.reader import DAMAGE, NOT_OURS, WirePayload, altered, damage
from protocols.scan import Floats


@dataclass(frozen=True)
class Head:
    """The version of what follows, and the scenario as it was run."""

    version: str
    scenario: str


@dataclass(frozen=True)
class Wire:
    """A payload on a link."""

    sensor: str
    link: int
    kind: str
    url: str
    sent: bool
    payload: WirePayload


@dataclass(frozen=True, eq=False)
class Left:
    """When payloads of a link had left, (n,) each. [ns]"""

    sensor: str
    link: int
    due_ns: NDArray[np.int64]
    actual_ns: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Beams:
    """When each beam of the sweeps that follow is fired after the sweep's start, (n,). [s]"""

    sensor: str
    fire_offset_s: Floats


@dataclass(frozen=True, eq=False)
class Measured:
    """A sweep, or a list of objects."""

    sensor: str
    scan: RecordedScan


@dataclass(frozen=True)
class Reported:
    """Something that happened; `sensor` is `run` for what concerns the whole run."""

    at_ns: int
    sensor: str
    row: Mapping[str, Any]


@dataclass(frozen=True)
class End:
    """Counters of each sensor at the end of the run."""

    sensors: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Cut:
    """The file ends here, before its end: why."""

    reason: str


Item = Head | Wire | Left | Beams | Measured | Reported | End | Cut


@dataclass
class Progress:
    """How far reading has come. [bytes]"""

    done: int = 0
    total: int = 0


def mcap_of(path: Path) -> Path:
    """The `run.mcap` of a recording's folder, or the file itself; raises `RecordingError` when there is none."""
    file = path / layout.FILE_NAME if path.is_dir() else path
    try:
        regular(file)
        with file.open("rb") as opened:
            magic = opened.read(8)
    except OSError as error:
        raise RecordingError(f"{file}: cannot read: {error.strerror}") from None
    except TooLarge as error:
        raise RecordingError(f"{file}: {error}") from None
    if magic != b"\x89MCAP0\r\n":
        raise RecordingError(f"{file}: not an MCAP file; want a recording's folder or its {layout.FILE_NAME}")
    return file


def items(path: Path, progress: Progress) -> Iterator[Item]:
    """Everything in a recording, given its folder or its file; a cut one ends with `Cut`. Raises `RecordingError`."""
    file_path = mcap_of(path)
    progress.total = file_path.stat().st_size
    channels: dict[int, Channel] = {}
    begun = False
    with file_path.open("rb") as file:
        try:
            for item in _items(file, file_path, channels, progress):
                begun = True
                yield item
        except TooLarge as error:
            raise RecordingError(f"{file_path}: {error}") from None
        except Altered as error:
            raise RecordingError(altered(file_path, error, begun)) from None
        except DAMAGE as error:
            if begun:
                yield Cut(damage(error))
    if not begun:
        raise RecordingError(f"{file_path}: {NOT_OURS}")


def _items(file: BinaryIO, path: Path, channels: dict[int, Channel], progress: Progress) -> Iterator[Item]:
    version = None
    origins: dict[str, Floats | None] = {}
    for record in mcap_records(file):
        progress.done = file.tell()
        if isinstance(record, Metadata) and record.name == layout.META_NAME:
            if record.metadata.get("layout") != str(layout.VERSION):
                found = record.metadata.get("layout", "")
                raise RecordingError(f"{path}: layout {found!r}; this version reads {layout.VERSION}")
            version = record.metadata.get("version", "")
        elif isinstance(record, Metadata) and record.name == layout.END_NAME:
            yield End({sensor: loads_json(text) for sensor, text in record.metadata.items()})
        elif version is None:
            continue
        elif isinstance(record, Attachment):
            yield Head(version, record.data.decode("utf-8", "replace"))
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            found_item = _message(channels[record.channel_id], record, origins)
            if found_item is not None:
                yield found_item


def _message(channel: Channel, message: Message, origins: dict[str, Floats | None]) -> Item | None:
    meta, encoding = channel.metadata, channel.message_encoding
    if encoding == layout.WIRE_ENCODING:
        sweep = message.sequence - 1 if message.sequence else None
        payload = WirePayload(
            message.log_time, message.publish_time, message.data, int(meta["peer"]), int(meta["baud"]), sweep
        )
        return Wire(meta["sensor"], int(meta["link"]), meta["kind"], meta["url"], meta["direction"] == "tx", payload)
    if encoding == layout.LEFT_ENCODING:
        rows = np.frombuffer(message.data, layout.LEFT)
        due_ns, actual_ns = (rows[name].astype(np.int64) for name in ("due_ns", "actual_ns"))
        return Left(meta["sensor"], int(meta["link"]), due_ns, actual_ns)
    if encoding == layout.SCAN_ENCODING:
        return Measured(meta["sensor"], decode_scan(message.data).begun_at(origins.get(meta["sensor"])))
    if encoding == layout.BEAMS_ENCODING:
        return Beams(meta["sensor"], np.frombuffer(message.data, "<f8").astype(np.float64))
    if encoding == layout.ORIGINS_ENCODING:
        origins[meta["sensor"]] = layout.decode_origins(message.data)
    if encoding == layout.EVENT_ENCODING:
        row = loads_json(message.data)
        return Reported(message.log_time, meta["sensor"], row if isinstance(row, dict) else {"event": str(row)})
    return None
