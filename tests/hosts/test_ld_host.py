"""Our own host of the LD family: what it reads out of profiles, how it starts, what it says when a device will not."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from emulator.errors import LinkError
from emulator.hosts.ld import LdHost, PackageFraming, UspFraming, read_profile, status_text
from emulator.hosts.lines import SocketLine
from tests.protocols.ld.reader import package, read_frames, read_packages, request, words

MEASURING, IDLE = [0, 3], [0, 1]
NAME = [0x4C44, 0x2D4C, 0x5253, 0x3130, 0x3030, 0]


def profile(form: int, *, sectors: int = 2) -> list[int]:
    """Two sectors of half a degree's steps: 359.5, 0.0 and 0.5 degrees at 10 m, none, 2 m; then one without points."""
    found = [0x8301, form, sectors]
    found += [value for bit, value in ((1, 7), (2, 8), (4, 0)) if form & bit]
    for number, start, distances in ((0, 5752, (2560, 0, 512)), (1, 16, ()))[:sectors]:
        head = ((8, number), (0x10, 8), (0x20, len(distances)), (0x40, 1000), (0x80, start))
        found += [value for bit, value in head if form & bit]
        for index, distance in enumerate(distances):
            point = ((0x100, distance), (0x200, (start + 8 * index) % 5760), (0x400, 99))
            found += [value for bit, value in point if form & bit]
        found += [value for bit, value in ((0x800, 1001), (0x1000, 8)) if form & bit]
    return found + ([0, 3] if form & 0x2000 else [])


@pytest.mark.parametrize("form", [0x39FF, 0x3DFF, 0x3FFF, 0x01B8, 0x01B0, 0x07B7, 0x3FB0])
def test_a_profile_of_any_format_with_its_geometry_is_read(form: int) -> None:
    read = read_profile(profile(form))
    assert read is not None
    np.testing.assert_allclose(np.degrees(read[0]), [0.5, 0.0, -0.5], atol=1e-12)
    np.testing.assert_array_equal(read[1], [10.0, np.nan, 2.0])


@pytest.mark.parametrize(("form", "amplitude"), [(0x3DFF, 99.0), (0x3FFF, 99.0), (0x39FF, None), (0x0DB8, 99.0)])
def test_amplitudes_are_read_where_the_format_has_them(form: int, amplitude: float | None) -> None:
    read = read_profile(profile(form))
    assert read is not None
    if amplitude is None:
        assert read.amplitude is None
    else:
        assert read.amplitude is not None
        np.testing.assert_array_equal(read.amplitude, [amplitude, np.nan, amplitude])


def test_direction_0_may_lie_elsewhere() -> None:
    read = read_profile(profile(0x39FF), np.radians(90.0))
    assert read is not None
    np.testing.assert_allclose(np.degrees(read.azimuth_rad), [90.5, 90.0, 89.5], atol=1e-12)


@pytest.mark.parametrize("form", [0x0100, 0x39DF, 0x397F, 0x39EF, 0x38FF])
def test_a_profile_without_its_geometry_or_distances_is_not_read(form: int) -> None:
    assert read_profile(profile(form)) is None


def test_a_profile_cut_anywhere_is_not_read() -> None:
    whole = profile(0x01B8)
    for length in range(len(whole)):
        assert read_profile(whole[:length]) is None


def test_angles_are_to_the_left_and_within_half_a_turn() -> None:
    read = read_profile([0x8301, 0x01B0, 1, 960, 6, 0, *[256] * 6])
    assert read is not None
    np.testing.assert_allclose(np.degrees(read[0]), [0, -60, -120, -180, 120, 60])


def test_mode_and_motor_are_told_by_name_or_code() -> None:
    reported = {words: status_text([0x8301, 0x2000, 1, *words]) for words in ((0, 3), (0, 0x42), (0, 0xA7))}
    assert list(reported.values()) == ["measure", "rotate, motor too slow", "code 7, motor code A"]
    assert status_text([0x8301, 0x0100, 0]) == ""


class Played(SocketLine):
    """A TCP line whose other end answers from a table, one reply a request, in the order of its list."""

    def __init__(self, replies: dict[int, list[list[int]]]) -> None:
        self.replies = {service: deque(answers) for service, answers in replies.items()}
        self.asked: list[list[int]] = []
        self.pending = b""
        self.closed = False

    def fileno(self) -> int:
        return -1

    def write(self, data: bytes) -> None:
        (payload,) = read_frames(data)
        self.asked.append(words(payload))
        for answer in self.replies.get(self.asked[-1][0], ()):
            self.pending += request(*answer)

    def read(self, timeout_s: float) -> bytes:
        data, self.pending = self.pending, b""
        return data

    def _take(self) -> bytes:
        return self.read(0.0)

    def close(self) -> None:
        self.closed = True


def device(status: list[int], verdict: int = 0) -> Played:
    return Played(
        {
            0x0302: [[0x8302, *status]],
            0x0101: [profile(0x39FF), [0x8101, *NAME, *status]],
            0x0102: [[0x8102, *status]],
            0x0403: [[0x8403, 0, 2]],
            0x0404: [[0x8404, 0, 2 if verdict else 3, verdict]],
            0x0402: [[0x8402, 0, 1]],
            0x0301: [profile(0x39FF), profile(0x0100), profile(0x39FF)],
        }
    )


def test_a_resting_device_is_started_and_left_resting() -> None:
    line = device(IDLE)
    host = LdHost(line, 38_400)
    assert host.title == "LD-LRS1000"
    scans = host.scans(0.01)
    first, second, none = next(scans), next(scans), next(scans)
    assert first is not None
    assert second is not None
    assert none is None
    assert (first.number, second.number, first.detail) == (0, 1, "measure")
    host.close()
    services = [asked[0] for asked in line.asked]
    assert services == [0x0302, 0x0101, 0x0102, 0x0403, 0x0404, 0x0301, 0x0302, 0x0403, 0x0402]
    assert line.asked[5] == [0x0301, 0, 0x3DFF]
    assert line.closed


def test_a_measuring_device_is_left_measuring() -> None:
    line = device(MEASURING)
    LdHost(line, 38_400).close()
    assert [asked[0] for asked in line.asked] == [0x0302, 0x0101, 0x0102, 0x0301, 0x0302]


def test_a_device_that_will_not_measure_is_told_with_its_error() -> None:
    with pytest.raises(LinkError, match=r"error 2 \(mean pulse\)"):
        LdHost(device(IDLE, verdict=2), 38_400)
    with pytest.raises(LinkError, match=r"error 9 \(code 9\)"):
        LdHost(device(IDLE, verdict=9), 38_400)


def test_a_failure_is_told_by_its_service() -> None:
    line = device(IDLE)
    line.replies[0x0403] = deque([[0xFF00, 0, 1]])
    with pytest.raises(LinkError, match="refuses service 0403"):
        LdHost(line, 38_400)
    line = device(MEASURING)
    line.replies[0x0301] = deque([[0xFF00, 0, 3]])
    with pytest.raises(LinkError, match="refuses to send profiles"):
        next(LdHost(line, 38_400).scans(0.01))


def test_a_device_that_refuses_amplitudes_is_asked_without_them() -> None:
    line = device(MEASURING)
    host = LdHost(line, 38_400)
    line.pending = request(0xFF00, 0, 3)
    scan = next(host.scans(0.01))
    assert line.asked[-2:] == [[0x0301, 0, 0x3DFF], [0x0301, 0, 0x39FF]]
    assert scan is not None
    assert scan.intensity is None


def test_frames_are_packed_and_read_for_tcp() -> None:
    framing = UspFraming()
    assert framing.errors == 0
    assert framing.pack(bytes.fromhex("0102")) == bytes.fromhex("02 55 53 50 00 00 00 02 01 02 03")
    long = bytes(2880 * 6)
    assert framing.feed(b"noise" + framing.pack(long) + b"\x02USP") == [long]


def test_packages_are_packed_and_read_for_serial_lines() -> None:
    framing = PackageFraming()
    assert framing.pack(bytes.fromhex("0403000a")) == b"\x02" + b"1410000400000403000A9130" + b"\x03"
    mine = package(0x1014, 4, 0, 0x8102, 0, lower_case=True)
    assert framing.feed(b"\x15" + package(0x1000, 4, 0, 0x8102, 0) + mine) == [bytes.fromhex("81020000")]
    assert read_packages(framing.pack(bytes(4)).lower()) == [(0x1410, [0, 0])]


def test_a_line_that_never_answers_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("emulator.hosts.ld.REPLY_S", 0.01)
    with pytest.raises(LinkError, match="no reply to service 0302"):
        LdHost(Played({}), 38_400)
