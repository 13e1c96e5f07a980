"""Our own hosts of the CoLa family: start-up, decoding, giving up; what people are shown of its telegrams."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.errors import LinkError
from emulator.hosts.cola import ColaHost, ColaScript, exact_step, read_scan
from emulator.hosts.describe import Speaker, describe
from emulator.hosts.lines import Line, SocketLine
from emulator.hosts.scans import HostScan
from emulator.process.clock import ManualClock
from protocols.session import Address, LinkKind
from protocols.skeleton.cola_values import ASCII, BINARY
from tests.protocols.cola.reader import ask_a, ask_b, frames
from tests.protocols.cola.rig import MS, ONE, SECOND, Rig


class RigLine(SocketLine):
    """A host's end of a device in virtual time."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.closed = False

    def write(self, data: bytes) -> None:
        self.rig.put(data)

    def read(self, timeout_s: float) -> bytes:
        self.rig.run(10 * MS)
        found = b"".join(one.payload for one in self.rig.sent if one.address == ONE)
        self.rig.sent.clear()
        return found

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize(("model", "points"), [("sick-lms111", 541), ("sick-lms511", 381), ("sick-tim571", 811)])
def test_a_host_logs_in_and_reads_scans(model: str, points: int) -> None:
    rig = Rig(model)
    line = RigLine(rig)
    host = ColaHost(line, 57_600)
    assert host.title.startswith(("LMS", "TiM"))
    scans = [scan for scan, _ in zip((one for one in host.scans(1.0) if one is not None), range(3), strict=False)]
    assert [len(scan.range_m) for scan in scans] == [points] * 3
    assert set(scans[0].range_m) == {10.0}
    assert np.degrees(scans[0].azimuth_rad[[0, -1]]) == pytest.approx([-135, 135] if points != 381 else [-95, 95])
    host.close()
    assert line.closed
    rig.run(SECOND)
    rig.sent.clear()
    rig.run(SECOND)
    assert not rig.sent
    assert host.errors == 0


class Slow(RigLine):
    """The same, with a clock of its own."""

    def __init__(self, rig: Rig, clock: ManualClock) -> None:
        super().__init__(rig)
        self.clock = clock

    def read(self, timeout_s: float) -> bytes:
        self.clock.set(self.clock.now_ns() + 10 * MS)
        return super().read(timeout_s)


def test_a_host_waits_for_a_device_that_is_being_switched_on(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, rig = ManualClock(), Rig(up=False)
    monkeypatch.setattr("emulator.hosts.cola.SystemClock", lambda: clock)
    host = ColaHost(Slow(rig, clock), 57_600)
    assert 10 * SECOND <= rig.now_ns < 11 * SECOND
    scan = next(host.scans(1.0))
    assert scan is not None
    assert len(scan.range_m) == 541
    assert rig.now_ns < 11 * SECOND


class SerialEnd(Line):
    """A host's end of a serial line: at another speed than the device's nothing of use passes."""

    def __init__(self, rig: Rig, clock: ManualClock, speed: int) -> None:
        self.rig, self.clock, self.speed = rig, clock, speed
        self.baud = 0

    def set_baud(self, baud: int) -> None:
        self.baud = baud

    def write(self, data: bytes) -> None:
        if self.baud == self.speed:
            self.rig.session.receive(data, self.rig.now_ns, Address(0, 0))

    def read(self, timeout_s: float) -> bytes:
        self.clock.set(self.clock.now_ns() + 10 * MS)
        self.rig.run(10 * MS)
        found = b"".join(one.payload for one in self.rig.sent)
        self.rig.sent.clear()
        return found

    def fileno(self) -> int:
        raise AssertionError("read is ours")

    def _take(self) -> bytes:
        raise AssertionError("read is ours")

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("speed", "told"), [(57_600, None), (115_200, None), (9_600, None), (230_400, 230_400)])
def test_a_device_is_found_at_the_speed_of_its_line(
    monkeypatch: pytest.MonkeyPatch, speed: int, told: int | None
) -> None:
    clock, rig = ManualClock(), Rig(kind=LinkKind.SERIAL, serial_baud=speed)
    monkeypatch.setattr("emulator.hosts.cola.SystemClock", lambda: clock)
    host = ColaHost(SerialEnd(rig, clock, speed), told)
    assert host.found_baud == speed
    assert host.title == "LMS11x_FieldEval V1.80"


def test_a_line_without_a_device_is_given_up_with_the_speeds_that_were_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, rig = ManualClock(), Rig(kind=LinkKind.SERIAL)
    monkeypatch.setattr("emulator.hosts.cola.SystemClock", lambda: clock)
    with pytest.raises(LinkError, match="57600, 115200, 38400, 19200, 9600 baud"):
        ColaHost(SerialEnd(rig, clock, 1), None)
    assert clock.now_ns() < 8 * SECOND


def test_a_probe_leaves_the_device_as_it_was() -> None:
    rig = Rig()
    host = ColaHost(RigLine(rig), None)
    assert host.title == "LMS11x_FieldEval V1.80"
    host.close()
    assert not rig.session.levels
    assert rig.session.next_plan() is None


def test_a_device_that_refuses_the_name_is_none_of_ours() -> None:
    rig = Rig()

    class Refusing(RigLine):
        def read(self, timeout_s: float) -> bytes:
            return b"\x02sFA 3\x03"

    with pytest.raises(LinkError, match="refuses"):
        ColaHost(Refusing(rig), None)


@pytest.mark.parametrize(("wire", "wanted"), [(1667, 5000 / 3), (3333, 10_000 / 3), (6667, 20_000 / 3), (5000, 5000),
                                              (2500, 2500), (10_000, 10_000), (625, 625)])  # fmt: skip
def test_steps_of_sixths_of_a_degree_are_exact(wire: int, wanted: float) -> None:
    assert exact_step(wire) == pytest.approx(wanted, rel=1e-12)


def test_a_script_asks_again_after_a_power_cut() -> None:
    rig = Rig()
    seen: list[HostScan] = []

    class End:
        baud: int | None = None

        def read(self) -> bytes:
            found = b"".join(one.payload for one in rig.sent)
            rig.sent.clear()
            return found

        def write(self, data: bytes, at_ns: int) -> int:
            rig.put(data)
            return len(data)

    script = ColaScript(End(), lambda now_ns, scan: seen.append(scan))

    def run(seconds: int) -> None:
        for _ in range(seconds * 50):
            script.step(rig.now_ns)
            rig.run(20 * MS)

    run(2)
    assert 90 <= len(seen) <= 101
    rig.session.power_on(rig.now_ns)
    run(10)
    count = len(seen)
    run(5)
    assert len(seen) > count + 90


def test_damaged_arguments_are_no_scan() -> None:
    assert read_scan(0, BINARY, b"\x00\x01") is None
    assert read_scan(0, ASCII, b"1 1 zz") is None


def test_telegrams_are_described_field_by_field() -> None:
    rig = Rig()
    speaker = Speaker("cola")
    assert [row.value for row in describe(speaker, ask_a("sRN LMPscancfg"), sent=False)] == [
        "CoLa-A",
        "sRN",
        "LMPscancfg",
    ]
    assert describe(speaker, b"\x02sFA 3\x03")[-1][1:] == ("3", "variable unknown")
    assert describe(speaker, ask_b("sMN SetAccessMode", "03f4724744"))[-1].value == "3 4101130052"
    rig.put(ask_b("sEN LMDscandata", "01"))
    rig.run(200 * MS)
    reported = {row.name: row.value for row in describe(speaker, rig.sent[-1].payload)}
    assert reported["DIST1"].startswith("10000 10000")
    assert reported["scan frequency"] == "5000"
    for data in (b"\x02", b"\xff\x02", rig.sent[-1].payload[:100], ask_b("sSN LMDscandata", "00")):
        assert describe(speaker, data)
    assert frames(rig.sent[-1].payload)[0][0] == "B"


@pytest.mark.parametrize(
    ("code", "name"), [("9", "unknown type"), ("B", "unknown server"), ("14", "internal"), ("1A", "complex")]
)
def test_error_words_that_our_devices_never_send_are_named_too(code: str, name: str) -> None:
    assert describe(Speaker("cola"), b"\x02sFA %s\x03" % code.encode())[-1][2].startswith(name)
