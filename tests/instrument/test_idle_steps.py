"""Steps at instants at which bytes leave a line and the session, as it has told, has nothing to do."""

from __future__ import annotations

import pytest

from emulator.instrument.instrument import Instrument
from emulator.measuring.measuring import InPlace
from emulator.runtime.virtual import VirtualRun
from emulator.transports.loopback import Loops
from emulator.transports.schemes import open_link
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Emission, Event, Restarted, Session

MS = 1_000_000
BAUD = 9_600
BYTES = 96
"100 ms of the line."


class Counted(Session):
    """Sends a long telegram at power-on and a short one at 30 ms; notes what it hears and when it is asked."""

    def __init__(self) -> None:
        self.asked_ns: list[int] = []
        self.heard: list[tuple[int, bytes]] = []
        self.queue: list[Emission] = []
        self.events: list[Event] = []

    def power_on(self, now_ns: int) -> None:
        self.queue = [Emission(now_ns, bytes(BYTES)), Emission(now_ns + 30 * MS, b"short")]

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        self.heard.append((now_ns, data))

    def advance(self, now_ns: int) -> None:
        self.asked_ns.append(now_ns)

    def next_deadline(self) -> int | None:
        return min((item.due_ns for item in self.queue), default=None)

    def next_plan(self) -> ScanPlan | None:
        return None

    def submit(self, scan: Scan) -> None:
        raise AssertionError("nothing is wanted")

    def take_emissions(self, now_ns: int) -> list[Emission]:
        due = [item for item in self.queue if item.due_ns <= now_ns]
        self.queue = [item for item in self.queue if item.due_ns > now_ns]
        return due

    def take_events(self) -> list[Event]:
        events, self.events = self.events, []
        return events


class Rig:
    def __init__(self) -> None:
        loops = Loops()
        self.session = Counted()
        link = open_link("loop:front", True, loops=loops)
        link.set_speed(BAUD)
        self.host = loops["front"].connect()
        self.instrument = Instrument("front", self.session, [link], InPlace({}))
        self.run = VirtualRun([self.instrument])
        self.run.power_on()


def test_bytes_leave_in_groups_and_the_session_is_asked_only_when_it_is_due() -> None:
    rig = Rig()
    while rig.run.step(200 * MS):
        pass
    assert set(rig.session.asked_ns) == {0, 30 * MS}
    assert len(rig.host.arrivals) > 40
    left = [int(time) for one in rig.host.arrivals for time in one.times_ns]
    assert left == [-(-k * 10**10 // BAUD) for k in range(1, BYTES + 6)]


@pytest.mark.parametrize("at_ms", [1, 31, 55])
def test_what_a_host_says_between_two_groups_is_heard_at_its_instant(at_ms: int) -> None:
    rig = Rig()
    rig.run.advance(500_000)
    rig.host.write(b"?", at_ms * MS)
    rig.run.advance(200 * MS)
    assert rig.session.heard == [(at_ms * MS, b"?")]


def test_what_the_session_has_told_late_is_noted_in_the_next_step() -> None:
    rig = Rig()
    rig.run.advance(50 * MS)
    rig.session.events.append(Restarted(50 * MS))
    wake_ns = rig.run.next_wake()
    assert wake_ns is not None
    rig.run.step(wake_ns)
    assert rig.instrument.take_events() == [Restarted(50 * MS)]


def test_a_sensor_that_is_poked_asks_its_session() -> None:
    rig = Rig()
    rig.run.advance(50 * MS)
    before = len(rig.session.asked_ns)
    rig.instrument.poked = True
    rig.run.advance(51 * MS)
    assert len(rig.session.asked_ns) > before


def test_a_power_cut_between_two_groups_ends_the_bytes_and_power_back_begins_anew() -> None:
    rig = Rig()
    rig.run.advance(50 * MS)
    arrived = sum(len(one.data) for one in rig.host.arrivals)
    assert rig.instrument.power_off(50 * MS) == BYTES + 5 - arrived
    rig.run.advance(60 * MS)
    assert sum(len(one.data) for one in rig.host.arrivals) == arrived
    rig.instrument.power_back(60 * MS)
    rig.run.advance(300 * MS)
    assert sum(len(one.data) for one in rig.host.arrivals) == arrived + BYTES + 5
