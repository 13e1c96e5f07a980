"""Writes a run into a folder while it goes on. A killed run leaves everything up to its last chunk.

Messages wait in this process until there are `CHUNK_BYTES` of them or they span `CHUNK_NS` of the run, and in a run
that hosts wait for half a second of real time at most. BLF and ASC are written at the end, from the candump log.
A recording that cannot go on ends, with its reason, and is reported as an incident; the run goes on.
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np
from mcap.records import Channel, Schema

from emulator import __version__
from emulator.faults.events import FaultEvent
from emulator.instrument.instrument import Instrument
from emulator.instrument.observer import Observer, Payload
from emulator.process.incidents import Incident, Incidents
from emulator.recording import layout
from emulator.recording.can_logs import LoggedFrame, candump_line, read_candump, write_logs
from emulator.recording.chunks import McapFile, OpenChunk
from emulator.recording.departures import Departures
from emulator.recording.folder import RecordingError as RecordingError
from emulator.recording.folder import RecordingFile, RecordingFolder, RecordingLost, reason
from emulator.recording.names import CAPTURE_ENDING, LOG_ENDINGS, SCENARIO_NAME, BusName, bus_names, planned
from emulator.recording.pcapng import LD_PORT, Packets
from emulator.recording.writing import IN_STEP, Manner, Writing
from emulator.scenario.scenario import Scenario, dump
from emulator.scenario.vehicle_options import NAME as VEHICLE_BUS
from emulator.transports.link import LATENESS_KEPT
from emulator.transports.urls import parse_url
from protocols.device_clock import DeviceStamp
from protocols.scan import Floats, Scan, ScanPlan
from protocols.session import Event, LinkKind

CHUNK_BYTES = 1 << 18
CHUNK_NS = 1_000_000_000
"Of the run's own time."
LOG_BYTES = 1 << 16
"Of a capture or a log that wait together."
MOST_CHANNELS = 50_000
"Of the 65535 that MCAP counts: connections come and go; those after it are recorded without their number."
SAME_FRAME = 4096
"Frames of a bus that are remembered: every sensor on it reports each, the log has it once."
SAME_INSTANT_S = 5e-8
"Beams fired within it of each other are the same: devices count in ticks of some nanoseconds."


@dataclass
class _Pieces:
    """A file beside `run.mcap`, made when there is something for it."""

    name: str
    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    file: RecordingFile | None = None

    def add(self, data: bytes) -> None:
        self.parts.append(data)
        self.size += len(data)


class Recorder(Observer):
    """Everything of a run into one folder."""

    def __init__(
        self,
        folder: Path,
        scenario: Scenario,
        instruments: Sequence[Instrument],
        truth: bool = True,
        incidents: Incidents | None = None,
        now_ns: Callable[[], int] | None = None,
        manner: Manner = IN_STEP,
    ) -> None:
        """Makes the folder, and observes at every instrument. `RecordingError` when that cannot be.

        `incidents` is informed when the recording ends early, at `now_ns()` on the run's clock.
        """
        self.failure = ""
        "Why the recording ended before the run; empty while it goes on."
        self._ended_ns = 0
        self._closed = False
        self._incidents = incidents if incidents is not None else Incidents()
        self._now_ns = now_ns if now_ns is not None else self._last
        self._last_ns = 0
        self._instruments = {one.sensor: one for one in instruments}
        self._truth = truth
        self._sync = manner.sync
        self._channels: dict[tuple[object, ...], int] = {}
        self._known: list[Channel] = []
        self._foreign: dict[str, int] = {}
        "Schemas of others by name."
        self._captures: dict[str, tuple[Packets, _Pieces]] = {}
        self._logs: dict[str, _Pieces] = {}
        self._seen: dict[str, dict[int, None]] = {}
        "Of each bus the ends of its last frames: every sensor on it reports each frame."
        self._departures: dict[tuple[str, int], Departures] | None = {} if manner.late else None
        "Of each sensor's links what has been handed to them and not left; None: all leaves when it is due."
        self._offsets: dict[str, Floats] = {}
        self._origins: dict[str, bytes] = {}
        self._reported: dict[str, tuple[int, int]] = {}
        "Sensor -> the sweep whose time was written last, and its instant: it is reported once for each host."
        self._buses = _buses(scenario, instruments)
        stems = [bus.stem for bus in self._buses.values()]
        self._lock = threading.RLock()
        "Around what waits: a run's thread adds, the recorder's takes it away."
        self._chunk = OpenChunk()
        self._schemas: list[Schema] = []
        self._folder = RecordingFolder(folder, layout.FILE_NAME, planned(stems, list(self._instruments)))
        try:
            self._begin(dump(scenario).encode())
        except OSError as error:
            self._folder.undo()
            raise RecordingError(f"{folder}: cannot record there: {reason(error)}") from None
        self._writing = Writing(manner, self.flush, self._fail)
        self._incidents.listeners.append(self._write_incident)
        for instrument in instruments:
            if manner.late:
                for link in instrument.links:
                    link.stats.departures = deque(maxlen=LATENESS_KEPT)
            instrument.watch(self)

    @property
    def folder(self) -> Path:
        """Where the recording is."""
        return self._folder.path

    def _begin(self, scenario: bytes) -> None:
        self._folder.create(SCENARIO_NAME).write(scenario)
        self._file = McapFile(self._folder.first, f"lidaremu {__version__}")
        self._file.metadata(layout.META_NAME, {"layout": str(layout.VERSION), "version": __version__})
        self._file.attachment(SCENARIO_NAME, "application/yaml", scenario)
        self._wire = self._schema("lidaremu.Wire", "text", (layout.__doc__ or "").encode())
        self._scan = self._schema("lidaremu.Scan", "text", layout.SCAN_LAYOUT.encode())
        self._clock = self._schema("lidaremu.Clock", "jsonschema", b'{"type": "object"}')
        self._beams = self._schema("lidaremu.Beams", "text", b"float64 fire_offset_s[n]")
        self._starts = self._schema("lidaremu.Origins", "text", b"float32 origin_m[n][3]")
        self._event = self._schema("lidaremu.Event", "jsonschema", b'{"type": "object"}')
        if self._departures is not None:
            self._left = self._schema("lidaremu.Left", "text", layout.LEFT_LAYOUT.encode())

    def _schema(self, name: str, encoding: str, data: bytes) -> int:
        self._schemas.append(Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name))
        self._chunk.record(self._schemas[-1])
        return len(self._schemas)

    def _channel(self, topic: str, encoding: str, schema: int, about: dict[str, str]) -> int:
        number = len(self._known) + 1
        channel = Channel(id=number, topic=topic, message_encoding=encoding, metadata=about, schema_id=schema)
        self._known.append(channel)
        self._chunk.record(channel)
        return number

    # ------------------------------------------------------------ what is reported

    def payload(self, payload: Payload) -> None:
        self._guarded(self._payload, payload)

    def departed(self, sensor: str, link: int, due_ns: int, actual_ns: int) -> None:
        self._guarded(self._departed, sensor, link, due_ns, actual_ns)

    def cut(self, sensor: str, link: int, end_ns: int) -> None:
        if self._departures is not None and (sensor, link) in self._departures:
            self._departures[sensor, link].cut(end_ns)

    def scan(self, sensor: str, scan: Scan) -> None:
        if self._truth and not self.failure:
            self._guarded(self._measured, sensor, scan)

    def reported(self, sensor: str, sweep: int, reported: DeviceStamp) -> None:
        if self._truth and self._reported.get(sensor) != (sweep, reported.true_ns):
            self._reported[sensor] = sweep, reported.true_ns
            data = json.dumps({"sweep": sweep} | asdict(reported)).encode()
            self._add(sensor, "clock", layout.CLOCK_ENCODING, self._clock, reported.true_ns, data)

    def event(self, sensor: str, event: Event | FaultEvent) -> None:
        self._guarded(self._happened, sensor, event)

    def note(self, now_ns: int, row: dict[str, object]) -> None:
        """Something about the whole run: a change of the weather, a fault, an order of the user's."""
        self._add("run", "event", layout.EVENT_ENCODING, self._event, now_ns, json.dumps(row).encode())

    def foreign(self, topic: str, schema: str, descriptors: bytes, at_ns: int, data: bytes) -> None:
        """A message of a published schema in protocol buffers, for other tools."""

        def put() -> None:
            key = ("foreign", topic)
            if key not in self._channels:
                known = self._foreign.get(schema)
                if known is None:
                    known = self._foreign[schema] = self._schema(schema, "protobuf", descriptors)
                self._channels[key] = self._channel(topic, "protobuf", known, {})
            self._message(self._channels[key], at_ns, data, at_ns)

        self._guarded(put)

    def feed(self, now_ns: int, row: dict[str, object]) -> None:
        """An update of a feed, as it was used."""
        self._add("world", "feed", layout.EVENT_ENCODING, self._event, now_ns, json.dumps(row).encode())

    def _write_incident(self, incident: Incident) -> None:
        self.note(incident.at_ns, {"event": "Incident"} | incident.as_json())

    def state(self) -> dict[str, object]:
        """How it stands with the recording, ready for JSON: for `status` and the last line of a run."""
        return {
            "folder": str(self.folder),
            "state": "ended" if self.failure else "on",
            "why": self.failure or None,
            "bytes": self._folder.written,
            "at_s": self._ended_ns * 1e-9 if self.failure else None,
        }

    # ------------------------------------------------------------ what waits

    def _guarded(self, add: Callable[..., None], *arguments: object) -> None:
        """Whatever goes wrong ends the recording, not the run."""
        if self.failure or self._closed:
            return
        try:
            with self._lock:
                add(*arguments)
                if self._chunk.size > CHUNK_BYTES or self._chunk.last_ns - self._chunk.first_ns > CHUNK_NS:
                    self._turn()
        except Exception as error:
            self._writing.fail(error)
        self._writing.make_room()

    def _happened(self, sensor: str, event: Event | FaultEvent) -> None:
        row = {"event": type(event).__name__} | {key: _plain(value) for key, value in asdict(event).items()}
        channel = self._of(sensor, "event", layout.EVENT_ENCODING, self._event)
        self._message(channel, event.at_ns, json.dumps(row).encode(), event.at_ns)

    def _payload(self, payload: Payload) -> None:
        link = self._instruments[payload.sensor].links[payload.link]
        baud = payload.pace[2] if payload.pace is not None else 0
        peer = payload.peer if len(self._known) < MOST_CHANNELS else 0
        key = (payload.sensor, payload.link, payload.sent, peer, baud)
        channel = self._channels.get(key)
        if channel is None:
            channel = self._channels[key] = self._channel(
                f"/{payload.sensor}/{payload.link}/{'tx' if payload.sent else 'rx'}",
                layout.WIRE_ENCODING,
                self._wire,
                {
                    "sensor": payload.sensor,
                    "link": str(payload.link),
                    "kind": link.kind.value,
                    "url": link.url,
                    "direction": "tx" if payload.sent else "rx",
                    "peer": str(peer),
                    "baud": str(baud),
                },
            )
        sequence = 0 if payload.sweep is None else (payload.sweep + 1) & 0xFFFFFFFF
        self._message(channel, payload.start_ns, payload.data, payload.end_ns, sequence)
        captured = link.kind is not LinkKind.SERIAL or link.url.startswith(("tcp:", "udp:"))
        if link.kind is LinkKind.CAN:
            self._log(link.url, payload)
        elif captured and (self._departures is None or not payload.sent):
            self._capture(link.url, payload, payload.start_ns)
        if self._departures is not None and payload.sent:
            kept = payload if captured and link.kind is not LinkKind.CAN else None
            self._in_capture(self._departures_of(payload.sensor, payload.link).hand(payload.end_ns, kept))

    def _departures_of(self, sensor: str, link: int) -> Departures:
        assert self._departures is not None
        return self._departures.setdefault((sensor, link), Departures())

    def _departed(self, sensor: str, link: int, due_ns: int, actual_ns: int) -> None:
        if self._departures is not None:
            self._last_ns = max(self._last_ns, actual_ns)
            self._in_capture(self._departures_of(sensor, link).leave(due_ns, actual_ns))

    def _in_capture(self, left: Iterable[tuple[Payload, int]]) -> None:
        """Packets with the instants at which they left, or are due where that is not known."""
        for payload, at_ns in left:
            self._capture(self._instruments[payload.sensor].links[payload.link].url, payload, at_ns)

    def _note_departures(self) -> None:
        """Into the chunk that is about to be full."""
        for (sensor, link), departures in (self._departures or {}).items():
            if (rows := departures.take()) is not None:
                about = {"sensor": sensor, "link": str(link)}
                channel = self._of(sensor, f"{link}/left", layout.LEFT_ENCODING, self._left, about)
                at_ns = int(rows["actual_ns"].max())
                self._message(channel, at_ns, rows.tobytes(), at_ns)

    def _message(self, channel: int, log_ns: int, data: bytes, publish_ns: int, sequence: int = 0) -> None:
        self._last_ns = max(self._last_ns, publish_ns)
        self._chunk.message(channel, max(0, log_ns), data, max(0, publish_ns), sequence)

    def _measured(self, sensor: str, scan: Scan) -> None:
        self._note_beams(sensor, scan.plan)
        self._note_origins(sensor, scan.plan)
        at_ns, data = scan.plan.start_ns, layout.encode_scan(scan)
        self._message(self._of(sensor, "scan", layout.SCAN_ENCODING, self._scan), at_ns, data, at_ns)

    def _note_beams(self, sensor: str, plan: ScanPlan) -> None:
        """When each beam is fired: the same for every sweep until a setting changes."""
        known = self._offsets.get(sensor)
        if known is plan.fire_offset_s or not len(plan):
            return
        if known is None or known.shape != plan.fire_offset_s.shape:
            away_s = np.inf
        else:
            away_s = float(np.abs(known - plan.fire_offset_s).max())
        if away_s > SAME_INSTANT_S:
            self._offsets[sensor] = plan.fire_offset_s
            data = plan.fire_offset_s.astype("<f8").tobytes()
            channel = self._of(sensor, "beams", layout.BEAMS_ENCODING, self._beams)
            self._message(channel, plan.start_ns, data, plan.start_ns)

    def _note_origins(self, sensor: str, plan: ScanPlan) -> None:
        """Where beams begin, if it is not where those of the sweep before did."""
        data = layout.encode_origins(plan.origin_m)
        if data != self._origins.get(sensor, b""):
            self._origins[sensor] = data
            channel = self._of(sensor, "origins", layout.ORIGINS_ENCODING, self._starts)
            self._message(channel, plan.start_ns, data, plan.start_ns)

    def _add(self, sensor: str, what: str, encoding: str, schema: int, at_ns: int, data: bytes) -> None:
        self._guarded(lambda: self._message(self._of(sensor, what, encoding, schema), at_ns, data, at_ns))

    def _of(self, sensor: str, what: str, encoding: str, schema: int, about: dict[str, str] | None = None) -> int:
        key = (sensor, what)
        if key not in self._channels:
            self._channels[key] = self._channel(f"/{sensor}/{what}", encoding, schema, about or {"sensor": sensor})
        return self._channels[key]

    def _capture(self, url: str, payload: Payload, at_ns: int) -> None:
        kind = self._instruments[payload.sensor].links[payload.link].kind
        datagram = kind is LinkKind.DATAGRAM or url.startswith("udp:")
        found = self._captures.get(payload.sensor)
        if found is None:
            found = Packets(f"{payload.sensor} {url}"), _Pieces(payload.sensor + CAPTURE_ENDING)
            self._captures[payload.sensor] = found
            found[1].add(found[0].head)
        port = parse_url(url).target.rpartition(":")[2]
        number = int(port) if port.isdigit() else LD_PORT
        device, peer = (2112, payload.peer or number) if datagram else (number, payload.peer)
        found[1].add(found[0].of(at_ns, payload.data, payload.sent, device, peer, datagram))
        if found[1].size > LOG_BYTES:
            self._turn_pieces(found[1])

    def _log(self, url: str, payload: Payload) -> None:
        seen = self._seen.setdefault(url, {})
        if payload.end_ns in seen:
            return
        seen[payload.end_ns] = None
        if len(seen) > SAME_FRAME:
            del seen[next(iter(seen))]
        bus = self._buses[url]
        if url not in self._logs:
            self._logs[url] = _Pieces(bus.stem + LOG_ENDINGS[0])
        # a frame is reported as the bus carries it, so that in real time this is when it leaves
        at_ns = payload.end_ns if self._departures is None else max(payload.end_ns, self._now_ns())
        frame = LoggedFrame(at_ns, payload.peer, payload.data, bus.channel)
        self._logs[url].add(candump_line(frame).encode("ascii"))
        if self._logs[url].size > LOG_BYTES:
            self._turn_pieces(self._logs[url])

    # ------------------------------------------------------------ what is written

    def _turn(self) -> None:
        """The chunk is full: a new one, and in the same go what waits for the other files."""
        self._note_departures()
        chunk, self._chunk = self._chunk, OpenChunk()
        if chunk.parts:
            self._writing.put(partial(self._file.chunk, chunk), chunk.size)
        for pieces in self._pieces():
            self._turn_pieces(pieces)
        if self._writing.in_step:
            self._writing.put(self._look, 0)

    def _pieces(self) -> list[_Pieces]:
        return [*(pieces for _, pieces in self._captures.values()), *self._logs.values()]

    def _turn_pieces(self, pieces: _Pieces) -> None:
        parts, size = pieces.parts, pieces.size
        pieces.parts, pieces.size = [], 0
        if parts:
            self._writing.put(partial(self._write, pieces, parts), size)

    def _write(self, pieces: _Pieces, parts: list[bytes]) -> None:
        if pieces.file is None:
            pieces.file = self._folder.create(pieces.name)
        pieces.file.write(b"".join(parts))

    def flush(self) -> None:
        """Hand everything to the system, and look whether the files are still there."""
        with self._lock:
            self._turn()
        self._look()

    def _look(self) -> None:
        for what, place in self._folder.look():
            text = f"{what} was moved to {place}; the recording goes on there"
            self._incidents.note("recording moved", self._now_ns(), place, text)

    def _last(self) -> int:
        return self._last_ns

    def _fail(self, error: Exception) -> None:
        why = reason(error)
        self._ended_ns = self._now_ns()
        self.failure = why
        with contextlib.suppress(OSError):  # nobody reads what is said; it is counted all the same
            text = why if isinstance(error, RecordingLost) else f"{why}; what is before can be read"
            self._incidents.note("recording ended", self._ended_ns, str(self.folder), text)

    # ------------------------------------------------------------ the end

    def close(self) -> None:
        """Finish every file; trouble at the end is reported as one on the way."""
        if self._closed:
            return
        with self._lock:
            if not self.failure:
                for departures in (self._departures or {}).values():
                    self._in_capture(departures.end())
                self._turn()
        self._closed = True
        moving = self._writing.close()
        self._writing.do(self._finish)
        self._file.close()
        if not moving:
            return  # the disk stands still: whoever touched a file would, too
        if self.failure:
            self._folder.abandon()
        else:
            self._writing.do(partial(self._folder.close, self._sync))

    def _finish(self) -> None:
        from emulator.instrument.summary import summary

        ends = {name: json.dumps(summary(one)) for name, one in self._instruments.items()}
        self._file.metadata(layout.END_NAME, ends)
        self._file.finish(self._schemas, self._known)
        for url, log in self._logs.items():
            if log.file is not None:
                self._convert(log.file, self._buses[url].stem)
        self._look()

    def _convert(self, log: RecordingFile, stem: str) -> None:
        """The frames of a finished log as BLF and ASC."""
        made = [(ending, self._folder.create(stem + ending, append=False)) for ending in LOG_ENDINGS[1:]]
        opened = [
            (ending, os.fdopen(file.number, "w+b", closefd=False) if ending == ".blf" else _text(file.number, "w"))
            for ending, file in made
        ]
        os.lseek(log.number, 0, os.SEEK_SET)
        try:
            with _text(log.number, "r") as lines:
                write_logs(opened, read_candump(lines))
        finally:
            for _, stream in opened:
                stream.close()
        for _, file in made:
            file.measure()


def _text(number: int, mode: str) -> IO[str]:
    return os.fdopen(number, mode, encoding="ascii", errors="replace", closefd=False)


def _buses(scenario: Scenario, instruments: Sequence[Instrument]) -> dict[str, BusName]:
    """The buses of a run by the address that its links tell; sensors that share one have the same."""
    given = {sensor.id: sensor.links for sensor in scenario.sensors}
    given |= {} if scenario.vehicle_bus is None else {VEHICLE_BUS: (scenario.vehicle_bus.link,)}
    texts: dict[str, str] = {}
    for one in instruments:
        links = given.get(one.sensor, ())
        for number, link in enumerate(one.links):
            if link.kind is LinkKind.CAN:
                texts.setdefault(link.url, links[number] if number < len(links) else link.url)
    return bus_names(texts)


def _plain(value: object) -> object:
    """A field of an event for JSON; numbers of sweeps as start, stop and step."""
    return [value.start, value.stop, value.step] if isinstance(value, range) else getattr(value, "value", value)
