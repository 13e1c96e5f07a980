"""Writes a run into a folder while it goes on. A killed run leaves everything up to its last payload.

Each message is handed to the kernel at once: nothing waits in this process. BLF and ASC are written at the end, from
frames that are in `run.mcap` and in the candump log already.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import BinaryIO, TextIO

import numpy as np
from mcap.writer import CompressionType, Writer

from emulator import __version__
from emulator.errors import EmulatorError
from emulator.faults.events import FaultEvent
from emulator.instrument import Instrument
from emulator.recording import layout
from emulator.recording.can_logs import LoggedFrame, candump_line, read_candump, write_with_library
from emulator.recording.pcapng import LD_PORT, PcapngWriter
from emulator.scenario import Scenario, dump
from emulator.transports.urls import parse_url
from emulator.watching import Payload, Watcher
from protocols.device_clock import Told
from protocols.scan import Floats, Scan, ScanPlan
from protocols.session import Event, LinkKind

SAME_FRAME = 4096
"Frames of a bus that are remembered: every sensor on it tells of each, the log has it once."


SAME_INSTANT_S = 5e-8
"Beams fired within it of each other are the same: devices count in ticks of some nanoseconds."


class RecordingError(EmulatorError):
    """A recording that cannot be written or read."""


class Recorder(Watcher):
    """Everything of a run into one folder."""

    def __init__(self, folder: Path, scenario: Scenario, instruments: Sequence[Instrument], truth: bool = True) -> None:
        """Makes the folder, and looks on at every instrument. `RecordingError` when that cannot be."""
        self.folder = folder
        self._instruments = {one.sensor: one for one in instruments}
        self._truth = truth
        self.failure = ""
        "Why the recording ended before the run; empty while it goes on."
        self.on_failure: Callable[[str], None] = lambda text: None
        self._channels: dict[tuple[object, ...], int] = {}
        self._captures: dict[str, PcapngWriter] = {}
        self._logs: dict[str, TextIO] = {}
        self._seen: dict[str, dict[int, None]] = {}
        "Of each bus the ends of its last frames: every sensor on it tells of each frame."
        self._text = dump(scenario)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "scenario.yaml").write_text(self._text, encoding="utf-8")
            self._file: BinaryIO = (folder / layout.FILE_NAME).open("xb")
        except FileExistsError:
            raise RecordingError(f"{folder}: holds a recording already; want another folder, or an empty one") from None
        except OSError as error:
            raise RecordingError(f"{folder}: cannot record there: {error.strerror}") from None
        self._writer = Writer(self._file, compression=CompressionType.NONE, use_chunking=False)
        self._writer.start("", f"lidaremu {__version__}")
        self._writer.add_metadata(layout.META_NAME, {"layout": str(layout.VERSION), "version": __version__})
        self._writer.add_attachment(0, 0, "scenario.yaml", "application/yaml", self._text.encode())
        self._wire = self._writer.register_schema("lidaremu.Wire", "text", (layout.__doc__ or "").encode())
        self._scan = self._writer.register_schema("lidaremu.Scan", "text", layout.SCAN_LAYOUT.encode())
        self._clock = self._writer.register_schema("lidaremu.Clock", "jsonschema", b'{"type": "object"}')
        self._beams = self._writer.register_schema("lidaremu.Beams", "text", b"float64 fire_offset_s[n]")
        self._offsets: dict[str, Floats] = {}
        self._told: dict[str, tuple[int, int]] = {}
        "Sensor -> the sweep whose time was written last, and its instant: it is told once for each host."
        self._event = self._writer.register_schema("lidaremu.Event", "jsonschema", b'{"type": "object"}')
        self._file.flush()
        for instrument in instruments:
            instrument.watch(self)

    def payload(self, payload: Payload) -> None:
        self._guarded(lambda: self._payload(payload))

    def _guarded(self, write: Callable[[], None]) -> None:
        """A full disk ends the recording, not the run."""
        if self.failure:
            return
        try:
            write()
        except OSError as error:
            self.failure = f"{self.folder}: recording ended: {error.strerror or error}"
            self.on_failure(self.failure)

    def _payload(self, payload: Payload) -> None:
        link = self._instruments[payload.sensor].links[payload.link]
        baud = payload.pace[2] if payload.pace is not None else 0
        key = (payload.sensor, payload.link, payload.sent, payload.peer, baud)
        channel = self._channels.get(key)
        if channel is None:
            channel = self._channels[key] = self._writer.register_channel(
                f"/{payload.sensor}/{payload.link}/{'tx' if payload.sent else 'rx'}",
                layout.WIRE_ENCODING,
                self._wire,
                {
                    "sensor": payload.sensor,
                    "link": str(payload.link),
                    "kind": link.kind.value,
                    "url": link.url,
                    "direction": "tx" if payload.sent else "rx",
                    "peer": str(payload.peer),
                    "baud": str(baud),
                },
            )
        sequence = 0 if payload.sweep is None else (payload.sweep + 1) & 0xFFFFFFFF
        self._writer.add_message(channel, max(0, payload.start_ns), payload.data, max(0, payload.end_ns), sequence)
        self._file.flush()
        if link.kind is LinkKind.CAN:
            self._log(link.url, payload)
        elif link.kind is not LinkKind.SERIAL or link.url.startswith(("tcp:", "udp:")):
            self._capture(link.url, payload, link.kind is LinkKind.DATAGRAM or link.url.startswith("udp:"))

    def scan(self, sensor: str, scan: Scan) -> None:
        if self._truth:
            self._note_beams(sensor, scan.plan)
            self._add(sensor, "scan", layout.SCAN_ENCODING, self._scan, scan.plan.start_ns, layout.encode_scan(scan))

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
            self._add(sensor, "beams", layout.BEAMS_ENCODING, self._beams, plan.start_ns, data)

    def told(self, sensor: str, sweep: int, told: Told) -> None:
        if self._truth and self._told.get(sensor) != (sweep, told.true_ns):
            self._told[sensor] = sweep, told.true_ns
            data = json.dumps({"sweep": sweep} | asdict(told)).encode()
            self._add(sensor, "clock", layout.CLOCK_ENCODING, self._clock, told.true_ns, data)

    def event(self, sensor: str, event: Event | FaultEvent) -> None:
        told = {key: _plain(value) for key, value in asdict(event).items()}
        row = {"event": type(event).__name__} | told
        self._add(sensor, "event", layout.EVENT_ENCODING, self._event, event.at_ns, json.dumps(row).encode())

    def note(self, now_ns: int, row: dict[str, object]) -> None:
        """Something about the whole run: a change of the weather, a fault, an order of the user's."""
        self._add("run", "event", layout.EVENT_ENCODING, self._event, now_ns, json.dumps(row).encode())

    def _add(self, sensor: str, what: str, encoding: str, schema: int, at_ns: int, data: bytes) -> None:
        self._guarded(lambda: self._write(sensor, what, encoding, schema, at_ns, data))

    def _write(self, sensor: str, what: str, encoding: str, schema: int, at_ns: int, data: bytes) -> None:
        key = (sensor, what)
        if key not in self._channels:
            about = {"sensor": sensor}
            self._channels[key] = self._writer.register_channel(f"/{sensor}/{what}", encoding, schema, about)
        self._writer.add_message(self._channels[key], max(0, at_ns), data, max(0, at_ns))
        self._file.flush()

    def _capture(self, url: str, payload: Payload, datagram: bool) -> None:
        if payload.sensor not in self._captures:
            path = self.folder / f"{payload.sensor}.pcapng"
            self._captures[payload.sensor] = PcapngWriter(path, f"{payload.sensor} {url}")
        port = parse_url(url).target.rpartition(":")[2]
        number = int(port) if port.isdigit() else LD_PORT
        device, peer = (2112, payload.peer or number) if datagram else (number, payload.peer)
        self._captures[payload.sensor].add(payload.start_ns, payload.data, payload.sent, device, peer, datagram)

    def _log(self, url: str, payload: Payload) -> None:
        bus = _bus_name(url)
        seen = self._seen.setdefault(bus, {})
        if payload.end_ns in seen:
            return
        seen[payload.end_ns] = None
        if len(seen) > SAME_FRAME:
            del seen[next(iter(seen))]
        if bus not in self._logs:
            self._logs[bus] = (self.folder / f"{bus}.log").open("w", encoding="ascii", newline="\n")
        self._logs[bus].write(candump_line(LoggedFrame(payload.end_ns, payload.peer, payload.data, bus)))
        self._logs[bus].flush()

    def close(self) -> None:
        """Finish every file."""
        if self._file.closed:
            return
        self._guarded(self._finish)
        closing = [self._file.close]
        closing += [capture.close for capture in self._captures.values()]
        closing += [log.close for log in self._logs.values()]
        for close in closing:
            with contextlib.suppress(OSError):  # told when it first happened
                close()

    def _finish(self) -> None:
        from emulator.daemon import summary

        ends = {name: json.dumps(summary(one)) for name, one in self._instruments.items()}
        self._writer.add_metadata(layout.END_NAME, ends)
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        for bus, log in self._logs.items():
            log.flush()
            with (self.folder / f"{bus}.log").open(encoding="ascii") as lines:
                paths = [self.folder / f"{bus}{ending}" for ending in (".blf", ".asc")]
                write_with_library(paths, read_candump(lines))


def _bus_name(url: str) -> str:
    """Name of a bus for files: the channel in the link's text, with what file names cannot hold replaced."""
    target = parse_url(url).target
    name = target.rpartition("/")[2].rpartition(":")[2] or "can"
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name)


def _plain(value: object) -> object:
    """A field of an event for JSON; numbers of sweeps as start, stop and step."""
    return [value.start, value.stop, value.step] if isinstance(value, range) else getattr(value, "value", value)
