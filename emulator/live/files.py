"""Feeds from files: OSI traces, JSON lines, and the feed of a recording.

Belongs here: files to updates, in their order, read as they are needed. Not: formats of one message (osi, json_lines).
"""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from emulator.errors import ScenarioError
from emulator.live import json_lines
from emulator.live.osi import ground_truth, sensor_view
from emulator.live.samples import BadSample, Update

MOST_MESSAGE = 64 << 20
FEED_TOPIC = "/world/feed"
"Of a recording."
GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class Reported:
    """One update of a file."""

    known_ns: int
    "From after this instant of the run on it is known."
    run_ns: int
    update: Update
    again: bool = False


def read(kind: str, path: Path) -> Iterator[Reported]:
    """Updates of a file; `ScenarioError` where it cannot be read, `BadSample` counts for a message of it."""
    try:
        if kind == "osi-trace":
            return _stamped(_osi_trace(path))
        if kind == "osi-mcap":
            return _stamped(_osi_mcap(path))
        if kind == "recording":
            return iter(list(_recorded(path)))
        return _stamped(_json_file(path))
    except OSError as error:
        raise ScenarioError(f"{path}: {error.strerror or error}; want a file that can be read") from None


def _stamped(updates: Iterator[Update]) -> Iterator[Reported]:
    """From the first stamp on, which is the beginning of the run; each is known when the one before holds."""
    first: int | None = None
    before_ns = -1
    for update in updates:
        stamp = update.t_ns
        if stamp is None:
            continue
        first = stamp if first is None else first
        yield Reported(before_ns, stamp - first, update)
        before_ns = stamp - first


def _open(path: Path) -> IO[bytes]:
    with path.open("rb") as file:
        packed = file.read(2) == GZIP
    return gzip.open(path, "rb") if packed else path.open("rb")  # type: ignore[return-value]


def _osi_trace(path: Path) -> Iterator[Update]:
    """Length and message, one after the other; a whole one is wanted to begin with, a torn end is the end."""
    decode = sensor_view if "_sv_" in path.name else ground_truth
    with _open(path) as file:
        first = True
        while len(head := file.read(4)) == 4:
            size = int.from_bytes(head, "little")
            if not 0 < size <= MOST_MESSAGE:
                if first:
                    raise ScenarioError(f"{path}: a message of {size} bytes; want an OSI trace (.osi)")
                return
            data = file.read(size)
            if len(data) < size:
                if first:
                    raise ScenarioError(f"{path}: {len(data)} of {size} bytes of the first message; want a whole one")
                return
            try:
                yield _either(data, decode) if first else decode(data)
            except BadSample as error:
                if first:
                    raise ScenarioError(f"{path}: {error}") from None
                continue
            if first and decode is ground_truth and not _is_ground_truth(data):
                decode = sensor_view
            first = False


def _is_ground_truth(data: bytes) -> bool:
    try:
        return bool(ground_truth(data).actors)
    except BadSample:
        return False


def _either(data: bytes, decode: object) -> Update:
    if decode is ground_truth and _is_ground_truth(data):
        return ground_truth(data)
    try:
        return sensor_view(data)
    except BadSample:
        return ground_truth(data)


def _osi_mcap(path: Path) -> Iterator[Update]:
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    with path.open("rb") as file:
        found = False
        try:
            for schema, _, message in make_reader(file).iter_messages():
                name = "" if schema is None else schema.name
                if name not in ("osi3.GroundTruth", "osi3.SensorView"):
                    continue
                found = True
                try:
                    yield ground_truth(message.data) if name == "osi3.GroundTruth" else sensor_view(message.data)
                except BadSample:
                    continue
        except (McapError, struct.error) as error:
            raise ScenarioError(f"{path}: {error}; want an MCAP file with osi3.GroundTruth") from None
        if not found:
            raise ScenarioError(f"{path}: no osi3.GroundTruth; want an MCAP file with one")


def _json_file(path: Path) -> Iterator[Update]:
    with path.open("rb") as file:
        for number, line in enumerate(file, 1):
            if not line.strip():
                continue
            try:
                yield json_lines.decoded(line)
            except BadSample as error:
                raise ScenarioError(f"{path}:{number}: {error}") from None


def _recorded(path: Path) -> Iterator[Reported]:
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    file = path / "run.mcap" if path.is_dir() else path
    with file.open("rb") as data:
        try:
            for _, _, message in make_reader(data).iter_messages(topics=[FEED_TOPIC], log_time_order=False):
                row = json.loads(message.data)
                yield Reported(
                    row["known_ns"], row["run_ns"], json_lines.of_json(row["update"]), row.get("again", False)
                )
        except (McapError, struct.error, ValueError, KeyError, TypeError) as error:
            raise ScenarioError(f"{file}: {error}; want a recording with a feed") from None
