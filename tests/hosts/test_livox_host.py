"""The built-in host for point packets: on a line, and in words."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.errors import LinkError
from emulator.hosts import packets
from emulator.hosts.lines import Line
from emulator.hosts.livox import FrameReader, LivoxHost, described
from emulator.process.clock import ManualClock
from protocols.livox.codec import encode

AHEAD = np.array([[5.0, 0.0, 0.0], [5.0, 1.0, 0.0], [0.0, 0.0, 0.0], [5.0, -1.0, 2.0]])


def packet(frame: int, count: int = 0) -> bytes:
    return encode(1000, count, frame, 30_000.0, np.where(AHEAD.any(axis=1)[:, None], AHEAD, np.nan), np.full(4, 9.0))


class Heard(Line):
    """A connection on which pieces arrive, then nothing; each read takes a second."""

    def __init__(self, clock: ManualClock, *pieces: bytes) -> None:
        self._clock, self._pieces, self.written = clock, list(pieces), b""

    def fileno(self) -> int:
        return -1

    def write(self, data: bytes) -> None:
        self.written += data

    def _take(self) -> bytes:
        return self._pieces.pop(0) if self._pieces else b""

    def read(self, timeout_s: float) -> bytes:
        self._clock.set(self._clock.now_ns() + 1_000_000_000)
        return self._take()

    def close(self) -> None:
        pass


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> ManualClock:
    made = ManualClock()
    monkeypatch.setattr(packets, "SystemClock", lambda: made)
    return made


def test_a_host_only_listens_on_a_connection_too(clock: ManualClock) -> None:
    data = packet(8, 5) + packet(9) + packet(9, 1) + packet(10)
    line = Heard(clock, b"", data[:50], data[50:])
    host = LivoxHost(line, None)
    scans = host.scans(1.0)
    scan = next(one for one in scans if one is not None)
    assert line.written == b""
    assert host.listens
    assert host.errors == 0
    assert scan.cloud is not None
    assert scan.detail == "6 of 8 points, frame 9"  # of the eighth it has not heard the beginning
    assert scan.number == 0
    assert scan.azimuth_rad == pytest.approx([0.0, 0.0, np.arctan(0.2), np.arctan(0.2)])
    assert scan.cloud.range_m[:3] == pytest.approx([5.0, np.sqrt(26.0), np.sqrt(30.0)])


@pytest.mark.parametrize("data", [b"", b"HTTP/1.1 200 OK\r\n\r\n", b"\x00" * 4000])
def test_another_device_is_none(clock: ManualClock, data: bytes) -> None:
    with pytest.raises(LinkError, match="no point packets"):
        LivoxHost(Heard(clock, data), None)


def test_errors_are_counted() -> None:
    reader = FrameReader()
    assert list(reader.feed(b"\x00rubbish" * 20 + packet(0))) == []
    assert reader.errors == 1


def test_a_packet_is_described_in_words() -> None:
    fields = {one.name: one.value for one in described(None, packet(3, 8), "datagram", 0, True)}  # type: ignore[arg-type]
    assert (fields["frame"], fields["packet"], fields["time stamp"], fields["first to last point"]) == (
        "3",
        "8",
        "1000",
        "30",
    )
    assert fields["y"].startswith("0")
    (nothing,) = described(None, b"x", "datagram", 0, True)  # type: ignore[arg-type]
    assert "no packet" in nothing.unit
