"""Start-up traces of five real drivers, byte for byte, with the time limits that each of them keeps.

The requests are those seen by running the unmodified drivers (sicktoolbox, Miro, Fawkes) or read from their sources
(Stanford, COMTEST); what the driver insists on in a reply is asserted where it is sent.
"""

from __future__ import annotations

import numpy as np
import pytest

from protocols.scan import Scan, ScanPlan
from protocols.session import Address, LinkKind
from tests.protocols.ld import reader
from tests.protocols.ld.reader import ProfileRead, read_frames, read_profile, request, words
from tests.protocols.ld.rig import MS, SECOND, Rig, scan_of

IDENTITY_ITEMS = [0x00, 0x01, 0x02, 0x03, 0x04, 0x10, 0x11, 0x12, 0x20, 0x21, 0x22]


def ramp(plan: ScanPlan) -> Scan:
    """Beam i at (5 + i / 256) m: each range names its beam."""
    return scan_of(plan, 5.0 + np.arange(len(plan)) / 256, 3.0)


class Sicktoolbox:
    """What `SickLD` does: one request at a time, 5 s each; it holds one telegram and looks every millisecond."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.last_ns = -SECOND
        self.last_was_reply = False

    def ask(self, *message: int) -> list[int]:
        """Send, then skip telegrams until the reply comes."""
        self.rig.put(request(*message))
        until_ns = self.rig.now_ns + 5 * SECOND
        while True:
            payload = self._take(until_ns - self.rig.now_ns)
            if payload[:2] == bytes([message[0] >> 8 | 0x80, message[0] & 0xFF]):
                return words(payload)

    def profile(self) -> ProfileRead:
        """The next profile, which must come within a second."""
        return read_profile(self._take(SECOND))

    def _take(self, within_ns: int) -> bytes:
        payload, due_ns = self.rig.next_telegram(within_ns)
        assert len(payload) <= 5816  # its buffer, unchecked
        gap_ns = due_ns - self.last_ns
        is_profile = payload[:2] == b"\x83\x01"
        assert gap_ns >= (5 * MS if is_profile and self.last_was_reply else MS)
        self.last_ns, self.last_was_reply = due_ns, not is_profile
        return payload

    def initialize(self) -> list[str]:
        """`Initialize()`; the identity strings."""
        mode = self.ask(0x0102)[2] & 0xF
        strings = []
        for item in IDENTITY_ITEMS:
            reply = self.ask(0x0101, item)
            data = b"".join(word.to_bytes(2, "big") for word in reply[1:])
            strings.append(data.split(b"\0")[0].decode())
        if mode == 3:
            assert self.ask(0x0403, 0) == [0x8403, 0, 2]
        if mode in (2, 3):
            assert self.ask(0x0402) == [0x8402, 0, 1]
        assert self.ask(0x0202, 5)[:6] == [0x8202, 5, 192, 168, 1, 10]
        assert self.ask(0x0202, 0x10)[:2] == [0x8202, 0x10]
        self.sectors()
        reply = self.ask(0x0105, 0)
        assert reply[1] >> 8 == 0
        return strings

    def sectors(self) -> list[tuple[int, int]]:
        found = []
        for number in range(8):
            code, reported, function, stop = self.ask(0x020B, number)
            assert (code, reported) == (0x820B, number)
            if function == 0:
                assert stop == 0
                break
            found.append((function, stop))
        return found

    def set_sector(self, number: int, function: int, stop: int) -> None:
        assert self.ask(0x020A, number, function, stop, 0)[1] != 0xFFFF
        self.sectors()

    def stream(self, form: int) -> ProfileRead:
        """The first `GetSickMeasurements`."""
        assert self.ask(0x0403, 0) == [0x8403, 0, 2]
        assert self.ask(0x0404) == [0x8404, 0, 3, 0]
        reply = self.ask(0x0301, 0, form)
        assert reply[:2] == [0x8301, form]
        return self.profile()

    def uninitialize(self) -> None:
        assert self.ask(0x0302)[1:] == [0, 3]
        assert self.ask(0x0403, 0) == [0x8403, 0, 2]
        assert self.ask(0x0402) == [0x8402, 0, 1]
        assert self.ask(0x0105, 0) == [0x8105, 0]


@pytest.mark.parametrize("mode", ["idle", "rotate", "measure"])
def test_sicktoolbox_initializes_whatever_mode_it_finds(mode: str) -> None:
    rig = Rig({"mode": mode})
    strings = Sicktoolbox(rig).initialize()
    assert strings[1] == "LD-LRS1000"
    assert len(strings) == 11
    assert rig.modes()[-1] == "idle"


def test_sicktoolbox_wrapper_sets_its_area_and_streams() -> None:
    rig = Rig({"step_deg": 0.25, "sectors": [{"from_deg": 0, "to_deg": 270}]}, world=ramp)
    host = Sicktoolbox(rig)
    host.initialize()
    # sectors first and the new step last, as received from the unmodified driver
    host.set_sector(0, 3, 0x12C0)
    host.set_sector(1, 1, 0x1678)
    host.set_sector(2, 0, 0)
    assert host.ask(0x0201, 0x0010, 0x10, 10, 8) == [0x8201, 0]
    assert host.sectors() == [(3, 0x12C0), (1, 0x1678)]
    profile = host.stream(0x3DFF)
    previous = profile
    for _ in range(20):
        profile = host.profile()
        first, second = profile.sectors
        assert (first.count, second.count) == (601, 0)
        assert (first.start, first.end, second.start, second.end) == (0, 4800, 4808, 5752)
        assert first.distances == list(range(1280, 1881))
        assert set(first.echoes) == {48}
        assert profile.status == 3
        assert profile.sent == previous.sent + 1  # type: ignore[operator]
        assert profile.counter == previous.counter + 1  # type: ignore[operator]
        # the wrapper takes the scan's duration from these, and the period from successive ends
        assert first.end_ms is not None
        assert first.start_ms is not None
        assert first.end_ms - first.start_ms == pytest.approx(300 / 360 * 100, abs=1)
        assert first.end_ms - previous.sectors[0].end_ms == 100  # type: ignore[operator]
        previous = profile
    host.uninitialize()


def test_sicktoolbox_switches_formats_and_areas() -> None:
    rig = Rig(world=ramp)
    host = Sicktoolbox(rig)
    host.initialize()
    host.set_sector(0, 3, 270 * 16)
    host.set_sector(1, 1, 90 * 16 - 8)
    host.set_sector(2, 0, 0)
    assert host.stream(0x39FF).sectors[0].count == 361
    assert host.ask(0x0302) == [0x8302, 0, 3]
    assert host.ask(0x0301, 0, 0x3DFF)[:2] == [0x8301, 0x3DFF]
    assert len(host.profile().sectors[0].echoes) == 361
    assert host.ask(0x0302) == [0x8302, 0, 3]
    assert host.ask(0x0301, 0, 0x39FF)[:2] == [0x8301, 0x39FF]
    assert host.profile().sectors[0].echoes == []
    assert host.ask(0x0302) == [0x8302, 0, 3]
    assert host.ask(0x0403, 0) == [0x8403, 0, 2]
    assert host.ask(0x0402) == [0x8402, 0, 1]
    assert host.ask(0x0201, 0x0010, 0x22, 8, 16) == [0x8201, 0]
    for number, (function, stop) in enumerate(
        [(3, 90 * 16), (1, 99 * 16), (3, 190 * 16), (1, 199 * 16), (3, 230 * 16), (1, 359 * 16)]
    ):
        host.set_sector(number, function, stop)
    host.set_sector(6, 0, 0)
    profile = host.stream(0x39FF)
    assert [sector.count for sector in profile.sectors] == [91, 0, 91, 0, 31, 0]
    before_ns = host.last_ns
    host.profile()
    assert host.last_ns - before_ns == 125 * MS  # 8 Hz
    assert host.ask(0x0209, 1, 1)[:2] == [0x8209, 1]
    assert host.ask(0x0401, 2) == [0x8401, 2]
    assert host.ask(0x0102) == [0x8102, 0, 1]


def test_sicktoolbox_bears_a_spin_up_of_four_and_a_half_seconds_and_no_more() -> None:
    host = Sicktoolbox(Rig({"spin_up_s": 4.5}))
    assert host.ask(0x0403, 0) == [0x8403, 0, 2]
    with pytest.raises(AssertionError, match="no telegram within"):
        Sicktoolbox(Rig({"spin_up_s": 5.5})).ask(0x0403, 0)


def test_stanford_starts_and_streams_with_its_exact_lengths() -> None:
    rig = Rig({"step_deg": 0.5}, world=ramp)

    def ask(length: int, *message: int, within_ns: int = SECOND) -> bytes:
        rig.put(request(*message))
        payload = rig.next_payload(within_ns)
        assert len(payload) + 9 == length  # it reads exactly so many bytes
        rig.run(50 * MS)  # it sleeps after each request: anything more would put it out of step
        assert rig.take() == []
        return b"\x02USP0000" + payload

    for item in (0x00, 0x01, 0x03, 0x04, 0x10, 0x11, 0x12):
        ask(27, 0x0101, item)
    assert ask(19, 0x0202, 0x0010)[12:18] == bytes.fromhex("00 10 00 0a 00 08")
    ask(13, 0x0201, 0x0010, 1, 10, 4)
    assert ask(19, 0x0202, 0x0010)[12:18] == bytes.fromhex("00 01 00 0a 00 04")
    # a leading idle sector, the measured one (end exclusive), a closing one, a terminator
    for sector in ([0, 1, 45 * 16 - 4], [1, 3, 315 * 16 - 4], [2, 1, 5760 - 4], [3, 0, 0]):
        ask(17, 0x020A, *sector, 0)
    ask(15, 0x0403, 10, within_ns=10 * SECOND)
    assert ask(17, 0x0404, within_ns=10 * SECOND)[14:16] == b"\0\0"
    asking = bytes.fromhex("03 01 00 00 3d ff") + bytes(range(11))
    assert len(asking) == 17
    rig.put(reader.frame(asking))
    for number in range(1, 6):
        profile = read_profile(rig.next_payload(SECOND))
        assert profile.sent == number
        assert [sector.count for sector in profile.sectors] == [0, 1080, 0]
        assert (profile.sectors[1].start, profile.sectors[1].end) == (720, 5036)
        # the revolution begins at direction 0, the measured beams are 45 degrees later
        assert profile.sectors[1].start_ms - profile.sectors[0].start_ms in (12, 13)  # type: ignore[operator]
    rig.put(request(0x0401, 2))
    assert rig.next_payload(SECOND) == bytes.fromhex("84 01 00 02")
    rig.run(SECOND)
    assert rig.take() == []


SERIAL = Address(0, 0)


def serial_rig(**device: object) -> Rig:
    return Rig(device, ramp, LinkKind.SERIAL, SERIAL, {"model": "sick-ld-oem1000"})


class Miro:
    """What `laser360` does: lower case, source 00, destination 16; any package is the reply."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        rig.run(0)
        rig.take()

    def send(self, *message: int) -> None:
        count = len(message) + 2
        self.rig.put(reader.package(0x0010, count, 0, *message, lower_case=True))

    def next(self, within_ns: int = 5 * SECOND) -> list[int]:
        until_ns = self.rig.now_ns + within_ns
        while not any(emission.payload for emission in self.rig.sent):
            wake_ns = self.rig.step()
            assert self.rig.sent or (wake_ns is not None and wake_ns <= until_ns)
            self.rig.now_ns = max(self.rig.now_ns, wake_ns or 0)
        (emission,) = self.rig.take()
        ((address, message),) = reader.read_packages(emission.payload)
        assert address == 0x1000
        assert emission.payload.count(b"\x02") == 1 or len(message) > 100
        return message

    def ask(self, *message: int, within_ns: int = 5 * SECOND) -> list[int]:
        self.send(*message)
        return self.next(within_ns)


@pytest.mark.parametrize(("hz", "step", "points"), [(15, 16, 360), (5, 8, 720)])
def test_miro_starts_and_reads_profiles_on_the_serial_line(hz: int, step: int, points: int) -> None:
    rig = serial_rig()
    host = Miro(rig)
    assert host.ask(0x0101, 1)[0] == 0x8101
    assert host.ask(0x0401, 2) == [0x8401, 2]
    assert host.ask(0x0201, 1, 6, 0, 1, 8) == [0x8201, 0]
    assert host.ask(0x0201, 0x0010, 0x0010, 0x000A, step, 0) == [0x8201, 0]
    assert host.ask(0x020A, 0, 3, 5760 - step, 1) == [0x820A, 0, 3, 5760 - step]
    for number in range(1, 8):
        assert host.ask(0x020A, number, 0, 0xFFF0, 1) == [0x820A, number, 0, 2160]
    assert host.ask(0x0403, hz, within_ns=10 * SECOND) == [0x8403, 0, 2]
    assert host.ask(0x0404, 0) == [0x8404, 0, 3, 0]
    assert host.ask(0x0105, 1) == [0x8105, 1]
    for number in (1, 2, 1):
        message = host.ask(0x0301, number, 0x0700)
        assert message[:3] == [0x8301, 0x0700, 0x0101]
        assert len(message) == 3 + 3 * points
        assert message[3::3] == list(range(1280, 1280 + points))
        assert message[4::3] == list(range(0, 5760, step))
        assert set(message[5::3]) == {48}
        rig.run(500 * MS)  # it waits, then asks again
        rig.take()
    assert host.ask(0x0401, 2) == [0x8401, 2]
    rig.run(SECOND)
    assert rig.take() == []


def test_a_package_that_cannot_be_accepted_is_answered_by_nak_and_may_be_repeated() -> None:
    rig = serial_rig()
    rig.run(0)
    rig.take()
    rig.put(b"\x02141000030000010200ff\x03")
    rig.run(10 * MS)
    (emission,) = rig.take()
    assert emission.payload == b"\x15"
    rig.put(reader.package(0x1410, 3, 0, 0x0102))
    rig.run(10 * MS)
    (emission,) = rig.take()
    assert emission.payload == reader.package(0x1014, 5, 0, 0x8102, 0, 1)


def test_a_package_for_another_sensor_is_not_answered() -> None:
    rig = serial_rig()
    rig.run(0)
    rig.take()
    rig.put(reader.package(0x1411, 3, 0, 0x0102))
    rig.run(SECOND)
    assert rig.take() == []


def test_comtest_learns_the_geometry_and_then_reads_bare_distances() -> None:
    rig = Rig(world=ramp)

    def ask(*message: int) -> bytes:
        return rig.ask(*message)

    ask(0x0302)
    assert words(ask(0x0102)) == [0x8102, 0, 1]
    assert words(ask(0x0403, 0)) == [0x8403, 0, 2]
    assert words(ask(0x0404)) == [0x8404, 0, 3, 0]
    learned = read_profile(ask(0x0301, 1, 0x00B0), [0])
    assert [(sector.step, sector.count, sector.start) for sector in learned.sectors] == [(8, 720, 0)]
    rig.run(SECOND)
    assert rig.take() == []  # exactly one
    profile = read_profile(ask(0x0301, 0, 0x0100), [720])
    assert profile.sectors[0].distances == list(range(1280, 2000))
    for _ in range(3):
        rig.next_payload(SECOND)


class Fawkes:
    """What `lase_edl_aqt` does on CAN: identifier 2AB to the sensor, 710 and ID word 3 back."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig

    def send(self, *message: int) -> None:
        for data in reader.can_frames(0x0010, *message):
            self.rig.put(data, Address(0, 0x2AB))

    def next(self, within_ns: int = 5 * SECOND) -> list[int]:
        """The next message, as it comes frame by frame."""
        until_ns = self.rig.now_ns + within_ns
        frames: list[bytes] = []
        while True:
            for emission in self.rig.take(Address(0, 0x710)):
                frames.append(emission.payload)
            if frames:
                count = 1 if frames[0][:2] == b"\0\0" else int.from_bytes(frames[0][2:4], "big")
                if len(frames) == count:
                    ((identity, message),) = reader.read_can(frames)
                    assert identity == 3
                    return message
                assert len(frames) < count
            wake_ns = self.rig.step()
            if not self.rig.sent:
                assert wake_ns is not None
                assert wake_ns <= until_ns
                self.rig.now_ns = max(self.rig.now_ns, wake_ns)

    def ask(self, *message: int) -> list[int]:
        self.send(*message)
        return self.next()


@pytest.mark.parametrize(("hz", "step"), [(15, 8), (20, 16)])
@pytest.mark.parametrize("form", [0x0100, 0x0400, 0x0500])
def test_fawkes_starts_and_reads_profiles_on_can(hz: int, step: int, form: int) -> None:
    rig = Rig({}, ramp, LinkKind.CAN, Address(0, 0), {"model": "lase-eld-l-a"})
    host = Fawkes(rig)
    assert host.ask(0x0302)[0] == 0xFF00, "which it passes over: nothing is being measured"
    rig.dropped()
    assert host.ask(0x0401, 2) == [0x8401, 2]
    assert host.ask(0x0201, 0x0010, 0x0010, hz, step) == [0x8201, 0]
    assert host.ask(0x020A, 0, 3, 5760 - step, 1)[:2] == [0x820A, 0]
    assert host.ask(0x020A, 1, 0, 0, 1)[:2] == [0x820A, 1]
    assert host.ask(0x0403, hz)[-1] == 2
    assert host.ask(0x0404)[-2:] == [3, 0]
    assert host.ask(0x0301, 0, form)[:2] == [0x8301, form]
    points = 5760 // step
    for _ in range(5):
        message = host.next(SECOND)
        assert message[:2] == [0x8301, form]
        assert len(message) == 3 + points * (2 if form == 0x0500 else 1)
        if form & 0x0100:
            assert message[3 :: 2 if form == 0x0500 else 1] == list(range(1280, 1280 + points))
    assert rig.dropped() == []  # 65 of 67 ms of the bus at 15 Hz with both words, and still none is lost
    host.send(0x0401, 2)
    while (message := host.next())[0] == 0x8301:  # at most the one that was on the bus
        assert rig.dropped() == []
    assert message == [0x8401, 2]


def test_a_cancel_on_can_withdraws_what_has_not_begun() -> None:
    rig = Rig({"mode": "measure", "motor_hz": 15}, ramp, LinkKind.CAN, Address(0, 0), {"model": "lase-eld-l-a"})
    host = Fawkes(rig)
    host.ask(0x0301, 0, 0x0100)
    assert host.ask(0x0302)[0] == 0x8302
    rig.run(SECOND)
    assert rig.take() == []


def test_two_hosts_on_tcp_are_served_side_by_side() -> None:
    rig = Rig({"mode": "measure"}, ramp)
    other = Address(0, 2)
    rig.session.connected(0, other, LinkKind.STREAM)
    rig.put(request(0x0301, 0, 0x0100))
    rig.run(250 * MS)
    rig.put(request(0x0301, 2, 0x0403), other)
    rig.run(500 * MS)
    mine = [read_frames(emission.payload)[0] for emission in rig.take(rig.address)]
    theirs = [read_frames(emission.payload)[0] for emission in rig.take(other)]
    assert len(mine) == 7
    assert [payload[2:4] for payload in mine] == [b"\x01\x00"] * 7
    assert [read_profile(payload, [720]).sent for payload in theirs] == [1, 2]
    assert {word for payload in theirs for word in read_profile(payload, [720]).sectors[0].echoes} == {48}
