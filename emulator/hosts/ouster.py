"""Hosts for Ouster: one on a connection for `look` and `view`, one in virtual time for `lidaremu test`.

Belongs here: what a driver does with packets. It shares the codec with the device, and nothing else. A scan is the
layer nearest to the horizon of a frame. Ranges are those from where beams begin.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from emulator.errors import LinkError
from emulator.hosts.describe import Described, Speaker, row_of, unknown
from emulator.hosts.lines import Line
from emulator.hosts.packets import PacketHost, PacketScript
from emulator.hosts.scans import HostCloud, HostScan
from emulator.hosts.scripted import HostEnd
from protocols.ouster.codec import IMU_LEGACY, PROFILES, Columns, Profile, decode
from protocols.ouster.models import MODELS
from protocols.scan import Floats

ASK = b"GET /packets HTTP/1.1\r\n\r\n"
REPLY = b"HTTP/1.1 "
START_S = 5.0
FIELD = b"X-Metadata: "
MOST_PACKETS = 512
"Of a frame: 4096 columns have 256."
LONGEST_HEAD = 32_768
ROWS = (32, 64, 128)


@dataclass(frozen=True, eq=False)
class Known:
    """What metadata says, as far as points need it."""

    title: str
    profile: Profile
    fusa: bool
    turn: int
    elevation_rad: Floats
    azimuth_rad: Floats
    offset_m: float
    forward_rad: float
    "Azimuth of column 0 in the sensor's frame."
    mark: bytes
    "With which a packet begins at `mark_at`; empty: LEGACY."
    mark_at: int

    @property
    def size(self) -> int:
        """Bytes of a packet."""
        return self.profile.size(len(self.elevation_rad))


def known_of(found: Mapping[str, Any]) -> Known:
    """Of the objects of `sensor/metadata`; raises LookupError, TypeError, ValueError when it is none."""
    info, beams, form = found["sensor_info"], found["beam_intrinsics"], found["lidar_data_format"]
    profile = PROFILES[form.get("udp_profile_lidar", "LEGACY")]
    fusa = profile.fusa or form.get("header_type") == "FUSA"
    init_id, serial = int(info.get("initialization_id", 0)), int(info["prod_sn"])
    turned = found["lidar_intrinsics"]["lidar_to_sensor_transform"]
    mark = init_id.to_bytes(3, "little") + (b"" if fusa else serial.to_bytes(5, "little"))
    elevation, azimuth = (np.radians(np.asarray(beams[f"beam_{one}_angles"], float)) for one in ("altitude", "azimuth"))
    if elevation.shape != azimuth.shape or len(elevation) not in ROWS:
        raise ValueError("no angles of 32, 64 or 128 rows")
    return Known(
        f"Ouster {info['prod_line']}", profile, fusa, int(form["columns_per_frame"]), elevation, azimuth,
        float(beams["lidar_origin_to_beam_origin_mm"]) / 1000.0, float(np.arctan2(turned[4], turned[0])),
        b"" if profile.legacy else mark, 1 if fusa else 4,
    )  # fmt: skip


def guessed(data: bytes) -> Known | None:
    """Of datagrams without metadata: by length, with the angles of a recorded OS1; None: no such length, or LEGACY."""
    again = data.find(data[4:12], 12) if len(data) > 12 and data[:2] == b"\x01\x00" else -1
    size = again - 4 if again > 0 else len(data)
    for profile in PROFILES.values():
        for rows in ROWS:
            if profile.size(rows) == size and not (profile.legacy or profile.fusa):
                model = MODELS[f"ouster-os1-{rows}"]
                elevation, azimuth = (np.radians(one) for one in model.angles("U"))
                offset_m = model.offset_mm / 1000.0
                title, mark = "Ouster, angles of an OS1", data[4:12]
                return Known(title, profile, False, 1024, elevation, azimuth, offset_m, np.pi, mark, 4)
    return None


class FrameReader:
    """Frames out of a stream of packets in any chunking; a frame ends where another number begins."""

    def __init__(self) -> None:
        self._held = b""
        self._packets: list[bytes] = []
        self._frame: int | None = None
        self._scans = 0
        self._known: Known | None = None
        self.errors = 0
        "Places where no packet began."
        self.title = "Ouster"

    def feed(self, data: bytes) -> Iterator[HostScan]:
        """Frames that are whole by now."""
        self._held += data
        while self._held:
            if self._held.startswith(REPLY):
                head, end, rest = self._held.partition(b"\r\n\r\n")
                if not end:
                    if len(self._held) > LONGEST_HEAD:
                        self._held, self.errors = b"", self.errors + 1
                    return
                self._held = rest
                self._read_head(head)
                continue
            if REPLY.startswith(self._held):
                return
            if self._known is None:
                self._known = guessed(self._held)
                if self._known is None:
                    self._skip()
                    return
            known = self._known
            if len(self._held) < known.size:
                return
            if self._held[known.mark_at : known.mark_at + len(known.mark)] != known.mark:
                self._skip()
                continue
            packet, self._held = self._held[: known.size], self._held[known.size :]
            yield from self._take(known, packet)

    def _skip(self) -> None:
        """To where a reply or a packet may begin."""
        self.errors += 1
        known = self._known
        places = [self._held.find(REPLY, 1)]
        if known is not None and known.mark:
            places.append(self._held.find(known.mark, known.mark_at + 1) - known.mark_at)
        found = [at for at in places if at > 0]
        self._held = self._held[min(found) :] if found else b""

    def _read_head(self, head: bytes) -> None:
        for line in head.split(b"\r\n"):
            if line.startswith(FIELD):
                try:
                    self._known = known_of(json.loads(line[len(FIELD) :]))
                except (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError):
                    self.errors += 1
                    return
                self.title = self._known.title
                self._packets.clear()

    def _take(self, known: Known, packet: bytes) -> Iterator[HostScan]:
        if known.profile.legacy:
            frame = int.from_bytes(packet[10:12], "little")
        else:
            frame = int.from_bytes(packet[4:8] if known.fusa else packet[2:4], "little")
        if self._packets and (frame != self._frame or len(self._packets) >= MOST_PACKETS):
            yield self._scan(known)
            self._packets.clear()
        self._frame = frame
        self._packets.append(packet)

    def _scan(self, known: Known) -> HostScan:
        said = decode(known.profile, len(known.elevation_rad), b"".join(self._packets), known.fusa)
        columns = said.columns
        layer = int(np.argmin(np.abs(known.elevation_rad)))
        turn = known.turn if columns.number.max() < known.turn else int(columns.number.max()) + 1
        head = known.forward_rad - 2.0 * np.pi * columns.number / turn
        seen = columns.valid
        words = np.where(seen, columns.range_mm[0][:, layer], 0)
        range_m = np.where(words > 0, words / 1000.0 - known.offset_m, np.nan)
        bright = np.where(words > 0, columns.reflectivity[0][:, layer], np.nan)
        azimuth = _wrapped(head - known.azimuth_rad[layer])
        self._scans += 1
        place = f"{np.degrees(known.elevation_rad[layer]):g} deg of {len(known.elevation_rad)} layers"
        detail = f"{known.profile.name}, {place}, frame {said.frame[0]}"
        cloud = _cloud(known, columns, head)
        return HostScan(self._scans - 1, azimuth[seen], range_m[seen], detail, bright[seen], cloud)


def _wrapped(angle: Floats) -> Floats:
    return np.asarray(np.pi - (np.pi - angle) % (2.0 * np.pi))


def _cloud(known: Known, columns: Columns, head: Floats) -> HostCloud:
    """Every beam's first return."""
    column, row = np.nonzero(columns.range_mm[0])
    return HostCloud(
        _wrapped(head[column] - known.azimuth_rad[row]),
        known.elevation_rad[row],
        columns.range_mm[0][column, row] / 1000.0 - known.offset_m,
        columns.reflectivity[0][column, row].astype(np.float64),
    )


class OusterHost(PacketHost):
    """Asks for packets on a TCP connection; raises `LinkError` when none come."""

    asks_after_errors = True  # another configuration, perhaps

    def __init__(self, line: Line, baud: int | None) -> None:
        """`baud`: of no meaning; None: the device is left as it is, which a request for packets does too."""
        super().__init__(line, FrameReader(), ASK, START_S, lambda first: _begun(first, line.asks) is not None)
        if not _begun(self._first, line.asks):
            raise LinkError("no Ouster sends packets there")


def _begun(first: bytes, asks: bool) -> bool | None:
    """Whether packets come; None: not known yet."""
    if not asks:
        return True if guessed(first) is not None else None
    head, whole, _ = first.partition(b"\r\n\r\n")
    if first.startswith(b"HTTP/1.1 200") and FIELD in first:
        return True
    return False if whole and FIELD not in head else None


class OusterScript(PacketScript):
    """A host in virtual time."""

    def __init__(self, line: HostEnd, on_scan: Callable[[int, HostScan], None]) -> None:
        super().__init__(line, on_scan, FrameReader, ASK, asks_after_errors=True)


def ouster_script(line: HostEnd, on_scan: Callable[[int, HostScan], None], device: Mapping[str, Any]) -> OusterScript:
    """For `lidaremu test`."""
    return OusterScript(line, on_scan)


def described(speaker: Speaker, data: bytes, kind: str, peer: int, sent: bool) -> list[Described]:
    """Fields of a lidar packet, an IMU packet, a request or its reply."""
    if sent and len(data) == IMU_LEGACY.size:
        values = np.asarray(IMU_LEGACY.unpack(data))
        return [
            Described("time stamp", str(int(values[1])), "ns"),
            Described("acceleration", row_of(values[3:6], 4), "g"),
            Described("rate", row_of(values[6:], 3), "deg/s"),
        ]
    known = guessed(data) if sent else None
    if known is not None and len(data) == known.size:
        said = decode(known.profile, len(known.elevation_rad), data)
        columns = said.columns
        return [
            Described("profile", f"{known.profile.name}, or another of this length"),
            Described("frame", str(said.frame[0])),
            Described("time stamp", str(columns.stamp_ns[0]), "ns"),
            Described("columns", row_of(columns.number)),
            Described("distances", row_of(columns.range_mm[0, 0] / 1000.0, 3), "m"),
            Described("reflectivities", row_of(columns.reflectivity[0, 0])),
        ]
    head, _, body = data.partition(b"\r\n\r\n")
    lines = [*head.split(b"\r\n")[:1], body]
    return [Described("line", repr(line)[2:-1][:200]) for line in lines if line] or [unknown(data, "empty")]
