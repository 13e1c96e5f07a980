"""Hosts where nobody answers, as at a recording that is sent again: they listen, at whatever speed. Time is counted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from emulator.errors import LinkError
from emulator.hosts import ld, lms2xx
from emulator.hosts.ld import LdHost
from emulator.hosts.lines import GONE, Line, LineClosed, SocketLine
from emulator.hosts.lms2xx import Lms2xxHost
from emulator.process.clock import ManualClock
from protocols.lms2xx.telegrams import Header, all_values, reply

SCAN = reply(all_values(np.full(181, 800, np.uint16), Header(181)), 0x10)
PERIOD_NS = 200_000_000


class Radio(Line):
    """Sends one message every 0.2 s at a speed of its own and heeds nothing; at another speed its bytes are noise."""

    def __init__(
        self, clock: ManualClock, message: bytes, speed_of: Callable[[float], int], ends_s: float = 1e9
    ) -> None:
        self._clock, self._message, self._speed_of, self._ends_s = clock, message, speed_of, ends_s
        self._sent = 0
        self._baud = 0
        self.written = 0

    def fileno(self) -> int:
        raise AssertionError("read is ours")

    def write(self, data: bytes) -> None:
        self.written += 1

    def _take(self) -> bytes:
        return b""

    def read(self, timeout_s: float) -> bytes:
        now_ns = self._clock.now_ns()
        if now_ns >= self._ends_s * 1e9:
            raise LineClosed(GONE)
        next_ns = (self._sent + 1) * PERIOD_NS
        if next_ns > now_ns + timeout_s * 1e9:
            self._clock.set(now_ns + round(timeout_s * 1e9) + 1)
            return b""
        self._clock.set(max(now_ns, next_ns))
        self._sent += 1
        same = self._speed_of(self._clock.now_ns() * 1e-9) == self._baud or not self._baud
        return self._message if same else bytes(len(self._message))

    def set_baud(self, baud: int) -> None:
        self._baud = baud

    def close(self) -> None:
        pass


class NetRadio(Radio, SocketLine):
    """The same over TCP, where there is no speed."""

    def set_baud(self, baud: int) -> None:
        pass


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> ManualClock:
    made = ManualClock()
    for module in (lms2xx, ld):
        monkeypatch.setattr(module, "SystemClock", lambda: made)
    return made


@pytest.mark.parametrize("speed", [9_600, 19_200, 38_400, 500_000])
def test_a_stream_that_heeds_no_stop_is_listened_to_at_its_speed(clock: ManualClock, speed: int) -> None:
    line = Radio(clock, SCAN, lambda _: speed)
    host = Lms2xxHost(line, 38_400)
    assert host.listens
    assert "listening" in host.title
    scans = [scan for scan, _ in zip(host.scans(0.5), range(20), strict=False) if scan is not None]
    assert len(scans) > 15
    np.testing.assert_allclose(scans[0].range_m, 8.0)
    np.testing.assert_allclose(np.degrees(scans[0].azimuth_rad[[0, -1]]), [-90.0, 90.0])
    asked = line.written
    host.close()
    assert line.written == asked  # nobody would hear it


def test_what_comes_while_speeds_are_tried_is_shown_too(clock: ManualClock) -> None:
    host = Lms2xxHost(Radio(clock, SCAN, lambda _: 9_600), 38_400)
    found_s = clock.now_ns() * 1e-9
    scans = []
    for scan in host.scans(0.5):
        if clock.now_ns() * 1e-9 > found_s:
            break
        scans.append(scan)
    assert len(scans) == round(found_s / 0.2) == 8


def test_a_listener_follows_a_change_of_speed(clock: ManualClock) -> None:
    host = Lms2xxHost(Radio(clock, SCAN, lambda t_s: 9_600 if t_s < 10.0 else 500_000), 38_400)
    seen_s = [clock.now_ns() * 1e-9 for scan, _ in zip(host.scans(0.5), range(200), strict=False) if scan is not None]
    gaps = np.diff(seen_s)
    assert 1.0 < gaps.max() < 5.0
    assert seen_s[-1] > 20.0


def test_a_device_that_was_asked_when_it_was_recorded_tells_its_field(clock: ManualClock) -> None:
    status = bytearray(160)
    status[106:110] = (100).to_bytes(2, "little") + (25).to_bytes(2, "little")
    values = reply(all_values(np.full(401, 500, np.uint16), Header(401)), 0x10)
    host = Lms2xxHost(Radio(clock, reply(b"\xb1" + bytes(status), 0x10) + values, lambda _: 9_600), 9_600, listen=True)
    scan = next(one for one in host.scans(0.5) if one is not None)
    np.testing.assert_allclose(np.degrees(scan.azimuth_rad[[0, -1]]), [-50.0, 50.0])


def test_a_silent_line_is_still_no_device(clock: ManualClock) -> None:
    with pytest.raises(LinkError, match="no LMS2xx answers"):
        Lms2xxHost(Radio(clock, b"", lambda _: 9_600), 38_400)


def test_values_over_tcp_are_listened_to(clock: ManualClock) -> None:
    host = Lms2xxHost(NetRadio(clock, SCAN, lambda _: 0), 38_400)
    assert next(scan for scan in host.scans(0.5)) is not None


def test_profiles_that_nobody_stops_are_listened_to(clock: ManualClock) -> None:
    words = [0x8301, 0x01B8, 1, 0, 8, 3, 5752, 2560, 0, 512]
    message = ld.UspFraming().pack(b"".join(word.to_bytes(2, "big") for word in words))
    host = LdHost(NetRadio(clock, message, lambda _: 0), 38_400)
    assert host.listens
    scan = next(one for one in host.scans(0.5) if one is not None)
    np.testing.assert_array_equal(scan.range_m, [10.0, np.nan, 2.0])


def test_a_line_that_closes_within_probing_says_so_at_once(clock: ManualClock) -> None:
    with pytest.raises(LineClosed, match="the run or the replay has ended"):
        Lms2xxHost(Radio(clock, SCAN, lambda _: 500_000, ends_s=2.0), 38_400)
    assert clock.now_ns() < 2.3e9


def test_replies_in_a_recording_are_not_taken_for_a_device(clock: ManualClock) -> None:
    line = Radio(clock, reply(b"\xa0\x00", 0x10) + SCAN, lambda _: 9_600)  # as if somebody asked it all the time
    host = Lms2xxHost(line, 9_600)
    assert host.listens
    assert clock.now_ns() < 2e9
    assert next(scan for scan in host.scans(0.5)) is not None
