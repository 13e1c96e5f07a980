"""Reads recordings: our own folders, those of killed runs too, and what other tools have recorded.

`read_run` for everything in a `run.mcap`; `read_wire` for what a device sent, whoever recorded it.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Channel, Message, Metadata

from emulator.config.budgets import loads_json
from emulator.recording import layout
from emulator.recording.bounds import ENDS, MOST_BYTES, Altered, Ends, TooLarge, bearable, check_blf, mcap_records
from emulator.recording.can_logs import LoggedFrame, read_candump, read_with_library
from emulator.recording.captures import read_segments, streams_of
from emulator.recording.folder import RecordingError
from emulator.recording.layout import RecordedScan, decode_scan
from emulator.recording.line_dumps import telegrams_of
from emulator.recording.pcapng import LD_PORT
from protocols.device_clock import DeviceStamp
from protocols.scan import Floats

DAMAGE = (McapError, struct.error, ValueError, LookupError, EOFError, OverflowError, TypeError, RecursionError)
"What reading a damaged file ends with: lengths, names, numbers and JSON in it may be anything."


def damage(error: Exception) -> str:
    """What is wrong with a file, for people."""
    if isinstance(error, Ends):
        return str(error)
    if isinstance(error, EndOfFile | EOFError | struct.error):
        return ENDS
    return f"{type(error).__name__}: {error}".removesuffix(": ")


NOT_OURS = "no recording of lidaremu, or one cut within its first bytes"


def altered(path: Path, error: Altered, ours: bool) -> str:
    """What is said of a file whose bytes are not those that were written."""
    if not ours:
        return f"{path}: {NOT_OURS}: altered: {error}"
    return f"{path}: altered: {error}; want the file as it was written"


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
    actual_ns: int | None = None
    "When its last bit had left indeed, at the latest; None: not recorded, as in virtual time, where it is `end_ns`."

    @property
    def late_ns(self) -> int:
        """By how much it left later than it was due."""
        return 0 if self.actual_ns is None else max(0, self.actual_ns - self.end_ns)


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
    offsets: dict[str, list[Floats | None]] = field(default_factory=dict)
    "Of each scan, when each of its beams fired after its start [s], shared by those that have the same; None: unknown."
    clocks: dict[str, list[tuple[int, DeviceStamp]]] = field(default_factory=dict)
    "Sensor -> sweep and what its telegram reported of the device's time."
    events: list[tuple[int, str, dict[str, object]]] = field(default_factory=list)
    cut: str = ""
    "Why reading ended before the file's own end; empty for a whole file."


def _data_of(path: Path, most: int | None = None) -> bytes:
    """The whole file, or its first bytes; what is too large is refused before it is read."""
    try:
        bearable(path)
        with path.open("rb") as file:
            return file.read(MOST_BYTES if most is None else most)
    except OSError as error:
        raise RecordingError(f"{path}: cannot read: {error.strerror}") from None
    except TooLarge as error:
        raise RecordingError(f"{path}: {error}") from None


def read_run(path: Path) -> RecordedRun:
    """A recording of ours, given its folder or its `run.mcap`; a cut one as far as it goes. Raises `RecordingError`."""
    if path.is_dir():
        path = path / layout.FILE_NAME
    if _data_of(path, 8) != b"\x89MCAP0\r\n":
        raise RecordingError(f"{path}: not an MCAP file; want a recording's folder or its {layout.FILE_NAME}")
    run = RecordedRun(path)
    channels: dict[int, Channel] = {}
    offsets: dict[str, Floats] = {}
    origins: dict[str, Floats | None] = {}
    version = None
    with path.open("rb") as file:
        try:
            for record in mcap_records(file, MOST_BYTES):
                if isinstance(record, Metadata) and record.name == layout.META_NAME:
                    version = record.metadata.get("layout", "")
                    if version != str(layout.VERSION):
                        raise RecordingError(f"{path}: layout {version!r}; this version reads {layout.VERSION}")
                elif isinstance(record, Attachment):
                    run.scenario = record.data.decode("utf-8", "replace")
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    _take(run, channels[record.channel_id], record, offsets, origins)
        except TooLarge as error:
            raise RecordingError(f"{path}: {error}") from None
        except Altered as error:
            raise RecordingError(altered(path, error, version is not None)) from None
        except DAMAGE as error:
            run.cut = damage(error)
    if version is None:
        raise RecordingError(f"{path}: {NOT_OURS}")
    return run


def _take(
    run: RecordedRun,
    channel: Channel,
    message: Message,
    offsets: dict[str, Floats],
    origins: dict[str, Floats | None],
) -> None:
    meta = channel.metadata
    if channel.message_encoding == layout.WIRE_ENCODING:
        table = run.sent if meta["direction"] == "tx" else run.received
        key = (meta["sensor"], int(meta["link"]))
        wire = table.setdefault(key, WireOf(*key, meta["kind"], meta["url"]))
        sweep = message.sequence - 1 if message.sequence else None
        peer, baud = int(meta["peer"]), int(meta["baud"])
        wire.payloads.append(WirePayload(message.log_time, message.publish_time, message.data, peer, baud, sweep))
    elif channel.message_encoding == layout.LEFT_ENCODING:
        _left(run, (meta["sensor"], int(meta["link"])), message.data)
    elif channel.message_encoding == layout.SCAN_ENCODING:
        scan = decode_scan(message.data).begun_at(origins.get(meta["sensor"]))
        offset_s = offsets.get(meta["sensor"])
        run.scans.setdefault(meta["sensor"], []).append(scan)
        known = offset_s is not None and len(offset_s) == len(scan.azimuth_rad)
        run.offsets.setdefault(meta["sensor"], []).append(offset_s if known else None)
    elif channel.message_encoding == layout.BEAMS_ENCODING:
        offsets[meta["sensor"]] = np.frombuffer(message.data, "<f8").astype(np.float64)
    elif channel.message_encoding == layout.ORIGINS_ENCODING:
        origins[meta["sensor"]] = layout.decode_origins(message.data)
    elif channel.message_encoding == layout.CLOCK_ENCODING:
        row = loads_json(message.data)
        run.clocks.setdefault(meta["sensor"], []).append((row.pop("sweep"), DeviceStamp(**row)))
    elif channel.message_encoding == layout.EVENT_ENCODING:
        row = loads_json(message.data)
        run.events.append((message.log_time, meta["sensor"], row))
        if row.get("event") == "CutShort":
            _cut_short(run, meta["sensor"], row)


def _left(run: RecordedRun, key: tuple[str, int], data: bytes) -> None:
    """When payloads that were recorded before had left."""
    payloads = run.sent[key].payloads if key in run.sent else []
    for number, _, actual_ns in np.frombuffer(data, layout.LEFT).tolist():
        if number < len(payloads):
            payloads[number] = replace(payloads[number], actual_ns=actual_ns)


def _cut_short(run: RecordedRun, sensor: str, row: dict[str, object]) -> None:
    """A request has ended a telegram that was recorded when it began: only its first bytes left."""
    at_ns, left, of = row.get("at_ns"), row.get("left"), row.get("of")
    if not (isinstance(at_ns, int) and isinstance(left, int) and isinstance(of, int) and 0 < left < of):
        return
    for wire in run.sent.values():
        last = wire.payloads[-1] if wire.payloads else None
        if wire.sensor != sensor or last is None or len(last.data) != of or not last.start_ns <= at_ns < last.end_ns:
            continue
        end_ns = last.end_ns if not last.baud else last.start_ns + -(-left * 10**10 // last.baud)
        wire.payloads[-1] = replace(last, data=last.data[:left], end_ns=max(at_ns, end_ns))


def is_ours(path: Path) -> bool:
    """Whether a path is read as a recording of ours: a folder, or a .mcap file."""
    return path.is_dir() or path.suffix == ".mcap"


def read_strange(path: Path, port: int = LD_PORT, baud: int = DEFAULT_BAUD) -> RecordedRun:
    """What another tool recorded, as a run of links without a name: for `diff`. Raises `RecordingError`."""
    wires = enumerate(read_wire(path, port, baud))
    return RecordedRun(path, sent={("wire", link): replace(wire, sensor="wire", link=link) for link, wire in wires})


def read_wire(path: Path, port: int = LD_PORT, baud: int = DEFAULT_BAUD) -> list[WireOf]:
    """What devices sent, from any recording that is known. Raises `RecordingError`.

    A folder or .mcap: ours. .pcap, .pcapng: of the device's `port`, a wire for each host connected at the same time.
    .blf, .asc, .log: CAN. Anything else is a raw dump of a serial line at `baud`, one payload a telegram; its times
    are made of the bytes' own duration.
    """
    if is_ours(path):
        return [wire for wire in read_run(path).sent.values() if wire.payloads]
    data = _data_of(path)
    if not data:
        raise RecordingError(f"{path}: empty")
    if path.suffix in (".pcap", ".pcapng"):
        return _from_capture(path, data, port)
    if path.suffix in (".blf", ".asc", ".log"):
        return [WireOf(path.stem, 0, "can", f"socketcand:127.0.0.1:0/{path.stem}", _from_log(path, data))]
    return [WireOf(path.stem, 0, "serial", f"pty:./{path.stem}", _from_dump(data, baud))]


def _from_dump(data: bytes, baud: int) -> list[WirePayload]:
    """Telegrams of a SICK's line, and what stands between them, one behind the other."""
    byte_ns = 10 * 10**9 // baud
    payloads, at = [], 0
    for part in telegrams_of(data):
        payloads.append(WirePayload(at * byte_ns, (at + len(part)) * byte_ns, part, baud=baud))
        at += len(part)
    return payloads


def _from_capture(path: Path, data: bytes, port: int) -> list[WireOf]:
    """A stream for each of the hosts that were connected at the same time; the first on the device's own port."""
    try:
        segments = list(read_segments(data))
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from None
    found = streams_of(segments, port)
    if not found:
        ports = Counter(item.source[1] for item in segments if item.data)
        reported = ", ".join(str(number) for number, _ in ports.most_common(8)) or "none did"
        raise RecordingError(f"{path}: no data sent by port {port}; want --port of the device, one of: {reported}")
    first = found[0][0][0]
    wires = []
    for number, parts in enumerate(found):
        name, at_port = (path.stem, port) if not number else (f"{path.stem}-{number + 1}", 0)
        payloads = [WirePayload(at_ns - first, at_ns - first, part) for at_ns, part in parts]
        wires.append(WireOf(name, 0, "stream", f"tcp:127.0.0.1:{at_port}", payloads))
    return wires


def _from_log(path: Path, data: bytes) -> list[WirePayload]:
    try:
        if path.suffix == ".blf":
            check_blf(data)
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
