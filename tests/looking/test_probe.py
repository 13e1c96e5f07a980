"""`probe`: which sensor is behind a link. Lines are played by devices of the product in virtual time."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

from emulator.commands.cli import main
from emulator.errors import LinkError
from emulator.hosts import cola, ld, ldrobot, lms2xx, packets, rplidar, scip, ydlidar
from emulator.hosts.lines import Line
from emulator.looking import probe as probing
from emulator.process.clock import ManualClock
from protocols.lms2xx.telegrams import reply
from tests.hosts.test_listening import SCAN, Radio


class Answering(Line):
    """An LMS2xx at one speed that knows its name, and writes down what it is asked."""

    def __init__(self, clock: ManualClock, speed: int) -> None:
        self._clock, self._speed = clock, speed
        self.baud = 0
        self.asked: list[bytes] = []
        self._waiting = b""

    def fileno(self) -> int:
        raise AssertionError("read is ours")

    def _take(self) -> bytes:
        return b""

    def write(self, data: bytes) -> None:
        if self.baud != self._speed or data[:1] != b"\x02":
            return
        self.asked.append(data[4:-2])
        said = {b"\x20\x25": b"\xa0\x00", b"\x3a": b"\xbaLMS291;S05"}
        self._waiting += reply(said[data[4:-2]], 0x10)

    def read(self, timeout_s: float) -> bytes:
        self._clock.set(self._clock.now_ns() + (0 if self._waiting else round(timeout_s * 1e9) + 1))
        data, self._waiting = self._waiting, b""
        return data

    def set_baud(self, baud: int) -> None:
        self.baud = baud

    def close(self) -> None:
        pass


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> ManualClock:
    made = ManualClock()
    for module in (cola, ld, ldrobot, lms2xx, packets, rplidar, scip, ydlidar):
        monkeypatch.setattr(module, "SystemClock", lambda: made)
    return made


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Callable[[Line], None]:
    return lambda line: monkeypatch.setattr(probing, "open_line", lambda url, baud: line)


@pytest.mark.parametrize("speed", [9_600, 19_200, 38_400, 500_000])
def test_a_device_is_found_at_its_speed_and_left_as_it_was(
    clock: ManualClock, plug: Callable[[Line], None], capsys: pytest.CaptureFixture[str], speed: int
) -> None:
    line = Answering(clock, speed)
    plug(line)
    assert main(["probe", "pty:./x", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == {"link": "pty:./x", "family": "lms2xx", "title": "LMS291; S05", "baud": speed, "answers": True}
    assert line.asked == [b"\x20\x25", b"\x3a"]  # neither speed nor mode is touched
    assert line.baud == speed


def test_a_recording_is_known_as_one(clock: ManualClock, plug: Callable[[Line], None]) -> None:
    plug(Radio(clock, SCAN, lambda _: 38_400))
    found = probing.probe("pty:./x")
    assert (found.family, found.baud, found.answers) == ("lms2xx", 38_400, False)
    assert "at 38400 baud; it sends and answers nothing" in found.reported()


def test_nothing_known_is_told_family_by_family(clock: ManualClock, plug: Callable[[Line], None]) -> None:
    plug(Radio(clock, b"", lambda _: 9_600))
    reported: list[str] = []
    with pytest.raises(LinkError, match=r"no sensor recognised; lms2xx: no LMS2xx answers.*; ld: no LD answers"):
        probing.probe("pty:./x", reported.append)
    families = ("lms2xx", "scip", "rplidar", "ldrobot", "ydlidar", "ld")
    assert reported[:6] == [f"pty:./x: trying {family}" for family in families]


def test_over_tcp_an_ld_is_tried_first() -> None:
    assert [name for name, _ in probing.tries(True)][:3] == ["ld", "cola", "velodyne"]
