"""Reads recordings: our own folders, cut ones too, and what other tools have recorded.

`read_run` for everything in a `run.mcap`; `read_wire` for what a device sent, whoever recorded it.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Message, Metadata
from mcap.stream_reader import StreamReader

from emulator.recording import layout
from emulator.recording.can_logs import LoggedFrame, read_candump, read_with_library
from emulator.recording.layout import RecordedScan, decode_scan
from emulator.recording.pcapng import read_segments, stream_of
from emulator.recording.writer import RecordingError

MOST_RECORD = 1 << 28
LD_PORT = 49_152
DEFAULT_BAUD = 38_400


@dataclass(frozen=True)
class WirePayload:
    """Bytes on one link."""

    start_ns: int
    end_ns: int
    data: bytes
    peer: int = 0
    baud: int = 0
    "0: not paced."
    sweep: int | None = None


@dataclass
class WireOf:
    """What one sensor said on one link, or a host to it."""

    sensor: str
    link: int
    kind: str
    "serial | stream | datagram | can"
    url: str
    payloads: list[WirePayload] = field(default_factory=list)


@dataclass
class RecordedRun:
    """A whole `run.mcap`."""

    path: Path
    scenario: str = ""
    sent: dict[tuple[str, int], WireOf] = field(default_factory=dict)
    received: dict[tuple[str, int], WireOf] = field(default_factory=dict)
    scans: dict[str, list[RecordedScan]] = field(default_factory=dict)
    events: list[tuple[int, str, dict[str, object]]] = field(default_factory=list)
    cut: str = ""
    "Why reading ended before the file's own end; empty for a whole file."


def _data_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: cannot read: {error.strerror}") from None


def read_run(path: Path) -> RecordedRun:
    """A recording of ours, given its folder or its `run.mcap`; a cut one as far as it goes. Raises `RecordingError`."""
    if path.is_dir():
        path = path / layout.FILE_NAME
    if _data_of(path)[:8] != b"\x89MCAP0\r\n":
        raise RecordingError(f"{path}: not an MCAP file; want a recording's folder or its {layout.FILE_NAME}")
    run = RecordedRun(path)
    channels: dict[int, Channel] = {}
    version = None
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, record_size_limit=MOST_RECORD).records:
                if isinstance(record, Metadata) and record.name == layout.META_NAME:
                    version = record.metadata.get("layout", "")
                    if version != str(layout.VERSION):
                        raise RecordingError(f"{path}: layout {version!r}; this version reads {layout.VERSION}")
                elif isinstance(record, Attachment):
                    run.scenario = record.data.decode("utf-8", "replace")
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    _take(run, channels[record.channel_id], record)
        except (McapError, struct.error, ValueError, LookupError, EOFError, UnicodeDecodeError, OverflowError) as error:
            run.cut = f"{type(error).__name__}: {error}"
    if version is None:
        raise RecordingError(f"{path}: no recording of lidaremu, or one cut within its first bytes")
    return run


def _take(run: RecordedRun, channel: Channel, message: Message) -> None:
    meta = channel.metadata
    if channel.message_encoding == layout.WIRE_ENCODING:
        table = run.sent if meta["direction"] == "tx" else run.received
        key = (meta["sensor"], int(meta["link"]))
        wire = table.setdefault(key, WireOf(*key, meta["kind"], meta["url"]))
        sweep = message.sequence - 1 if message.sequence else None
        peer, baud = int(meta["peer"]), int(meta["baud"])
        wire.payloads.append(WirePayload(message.log_time, message.publish_time, message.data, peer, baud, sweep))
    elif channel.message_encoding == layout.SCAN_ENCODING:
        run.scans.setdefault(meta["sensor"], []).append(decode_scan(message.data))
    elif channel.message_encoding == layout.EVENT_ENCODING:
        run.events.append((message.log_time, meta["sensor"], json.loads(message.data)))


def read_wire(path: Path, port: int = LD_PORT, baud: int = DEFAULT_BAUD) -> list[WireOf]:
    """What devices sent, from any recording that is known. Raises `RecordingError`.

    A folder or .mcap: ours. .pcap, .pcapng: of the device's `port`. .blf, .asc, .log: CAN. Anything else is a raw dump
    of a serial line at `baud`, its times made of the bytes' own duration.
    """
    if path.is_dir() or path.suffix == ".mcap":
        return [wire for wire in read_run(path).sent.values() if wire.payloads]
    data = _data_of(path)
    if not data:
        raise RecordingError(f"{path}: empty")
    if path.suffix in (".pcap", ".pcapng"):
        return [WireOf(path.stem, 0, "stream", f"tcp:127.0.0.1:{port}", _from_capture(path, data, port))]
    if path.suffix in (".blf", ".asc", ".log"):
        return [WireOf(path.stem, 0, "can", f"socketcand:127.0.0.1:0/{path.stem}", _from_log(path, data))]
    byte_ns = 10 * 10**9 // baud
    whole = WirePayload(0, len(data) * byte_ns, data, baud=baud)
    return [WireOf(path.stem, 0, "serial", f"pty:./{path.stem}", [whole])]


def _from_capture(path: Path, data: bytes, port: int) -> list[WirePayload]:
    try:
        found = stream_of(read_segments(data), port)
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from None
    if not found:
        raise RecordingError(f"{path}: nothing that port {port} sent over TCP or UDP; want --port of the device")
    first = found[0][0]
    return [WirePayload(at_ns - first, at_ns - first, part) for at_ns, part in found]


def _from_log(path: Path, data: bytes) -> list[WirePayload]:
    try:
        frames: Sequence[LoggedFrame] = (
            list(read_candump(data.decode("ascii", "replace").splitlines()))
            if path.suffix == ".log"
            else read_with_library(path)
        )
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from None
    if not frames:
        raise RecordingError(f"{path}: no CAN frame in it")
    first = min(frame.at_ns for frame in frames)
    ordered = sorted(frames, key=lambda frame: frame.at_ns)
    return [WirePayload(one.at_ns - first, one.at_ns - first, one.data, one.peer) for one in ordered]
