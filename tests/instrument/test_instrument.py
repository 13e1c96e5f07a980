"""One sensor on its links: what is asked for, measured, sent and counted. The session is scripted."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.errors import EmulatorError
from emulator.instrument.instrument import LOOK_AHEAD_NS, Instrument
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.measuring import InPlace
from emulator.runtime import virtual
from emulator.runtime.virtual import VirtualRun
from emulator.transports.link import Link, Received
from protocols.errors import ScanRefused
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Dropped, DropReason, Emission, Event, LinkKind, ModeChanged, Restarted, Session

PERIOD_NS = 40_000_000


def plan(epoch: int, sweep: int, start_ns: int) -> ScanPlan:
    one = np.zeros(1)
    return ScanPlan(epoch, sweep, start_ns, one, one, one)


class ScriptedSession(Session):
    """Sends a scan every 40 ms; `S` stops it, `G` starts it, `E` changes a setting, anything else is echoed."""

    def __init__(self) -> None:
        self.on, self.epoch, self.sweep = False, 0, 0
        self.heard: list[tuple[int, bytes, Address | None]] = []
        self.links: list[tuple[Address, LinkKind | None]] = []
        self.queue: list[Emission] = []
        self.events: list[Event] = []
        self.lines: list[tuple[bool, bool, int, Address]] = []

    def modem_lines(self, dtr: bool, rts: bool, now_ns: int, address: Address) -> None:
        self.lines.append((dtr, rts, now_ns, address))

    def power_on(self, now_ns: int) -> None:
        self.events.append(Restarted(now_ns))

    def connected(self, now_ns: int, address: Address, kind: LinkKind) -> None:
        self.links.append((address, kind))

    def disconnected(self, now_ns: int, address: Address) -> None:
        self.links.append((address, None))

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        self.heard.append((now_ns, data, address))
        if data == b"G":
            self.on = True
        elif data == b"S":
            self.on, self.queue = False, []
        elif data == b"E":
            self.epoch += 1
        else:
            self.queue.append(Emission(now_ns, data, address, label="echo"))

    def advance(self, now_ns: int) -> None:
        pass

    def next_deadline(self) -> int | None:
        return min((item.due_ns for item in self.queue), default=None)

    def next_plan(self) -> ScanPlan | None:
        return plan(self.epoch, self.sweep, self.sweep * PERIOD_NS) if self.on else None

    def submit(self, scan: Scan) -> None:
        if scan.plan.epoch != self.epoch:
            raise ScanRefused("another epoch")
        self.queue.append(Emission(scan.plan.start_ns + PERIOD_NS, b"scan", sweep=self.sweep, label="B0"))
        self.sweep += 1

    def take_emissions(self, now_ns: int) -> list[Emission]:
        due = [item for item in self.queue if item.due_ns <= now_ns]
        self.queue = [item for item in self.queue if item.due_ns > now_ns]
        return due

    def take_events(self) -> list[Event]:
        events, self.events = self.events, []
        return events


class ListLink(Link):
    """Keeps what is sent; gives what the test puts into `incoming`."""

    def __init__(self, kind: LinkKind) -> None:
        super().__init__()
        self.kind = kind
        self.incoming: list[Received] = []
        self.sent: list[tuple[int, bytes, int | None]] = []
        self.closed = 0

    @property
    def url(self) -> str:
        return "list:"

    def filenos(self) -> tuple[int, ...]:
        return ()

    def receive(self, now_ns: int) -> list[Received]:
        incoming, self.incoming = self.incoming, []
        return incoming

    def send(self, payload: bytes, due_ns: int, peer: int | None = None, line_speed: int | None = None) -> None:
        self.sent.append((due_ns, payload, peer))

    def flush(self, now_ns: int) -> int | None:
        return None

    def close(self) -> None:
        self.closed += 1


class Rig:
    def __init__(self, *kinds: LinkKind) -> None:
        self.session = ScriptedSession()
        self.links = [ListLink(kind) for kind in kinds]
        self.plans: list[int] = []
        self.instrument = Instrument("front", self.session, self.links, InPlace({"front": self.measure}))
        self.run = VirtualRun([self.instrument])
        self.run.power_on()

    def measure(self, wanted: ScanPlan) -> Scan:
        self.plans.append(wanted.sweep)
        return Scan.empty(wanted)

    def hear(self, data: bytes, link: int = 0, peer: int = 0) -> None:
        self.links[link].incoming.append(Received(peer, data))


def test_scans_leave_at_their_own_instants_whenever_they_were_computed() -> None:
    rig = Rig(LinkKind.SERIAL)
    rig.hear(b"G")
    rig.run.advance(1_000_000_000)
    assert [due for due, payload, _ in rig.links[0].sent if payload == b"scan"] == [k * PERIOD_NS for k in range(1, 26)]
    assert rig.instrument.stats.scans_sent == 25
    assert rig.instrument.stats.rate_hz == pytest.approx(25.0, rel=1e-12)


def test_the_rate_is_that_of_the_streams_and_not_of_the_pauses_between_them() -> None:
    rig = Rig(LinkKind.SERIAL)
    rig.hear(b"G")
    rig.run.advance(10 * PERIOD_NS)
    rig.hear(b"S")
    rig.session.events.append(ModeChanged(10 * PERIOD_NS, "25"))
    rig.run.advance(1_000_000_000)
    assert rig.instrument.stats.rate_hz == pytest.approx(25.0, rel=1e-12)
    sent = rig.instrument.stats.scans_sent
    rig.session.sweep = 25
    rig.hear(b"G")
    rig.run.advance(2_000_000_000)
    assert rig.instrument.stats.scans_sent == sent + 25
    assert rig.instrument.stats.rate_hz == pytest.approx(25.0, rel=1e-12)


def test_nothing_is_measured_earlier_than_the_look_ahead() -> None:
    rig = Rig(LinkKind.SERIAL)
    rig.hear(b"G")
    rig.run.advance(0)
    assert max(rig.plans) == LOOK_AHEAD_NS // PERIOD_NS


def test_modem_lines_that_a_host_sets_are_told_to_the_session() -> None:
    rig = Rig(LinkKind.SERIAL)
    rig.run.advance(1_000)
    rig.links[0].incoming.append(Received(0, lines=(False, True)))
    rig.run.advance(2_000_000)
    assert [(dtr, rts, address) for dtr, rts, _, address in rig.session.lines] == [(False, True, Address(0, 0))]
    assert rig.session.heard == []


def test_nothing_is_measured_that_nobody_asked_for() -> None:
    rig = Rig(LinkKind.SERIAL)
    rig.run.advance(10_000_000_000)
    assert rig.plans == []


def test_a_stopped_stream_is_withdrawn_before_it_leaves() -> None:
    rig = Rig(LinkKind.SERIAL)
    rig.hear(b"G")
    rig.run.advance(100_000_000)
    rig.hear(b"S")
    rig.run.advance(1_000_000_000)
    assert [due for due, _, _ in rig.links[0].sent] == [40_000_000, 80_000_000]


def test_a_reply_goes_to_the_link_and_the_peer_that_asked() -> None:
    rig = Rig(LinkKind.STREAM, LinkKind.STREAM)
    rig.links[1].incoming.append(Received(7, b"who", opened=True))
    rig.run.advance(1)
    assert rig.links[0].sent == []
    assert [(payload, peer) for _, payload, peer in rig.links[1].sent] == [(b"who", 7)]
    assert rig.session.links == [(Address(1, 7), LinkKind.STREAM)]
    assert rig.instrument.stats.replies_sent == 1


def test_a_fixed_link_is_connected_at_power_on_and_a_hosts_leaving_is_told() -> None:
    rig = Rig(LinkKind.SERIAL, LinkKind.STREAM)
    assert rig.session.links == [(Address(0, 0), LinkKind.SERIAL)]
    rig.links[1].incoming.append(Received(3, b"bye", opened=True, closed=True))
    rig.run.advance(1)
    assert rig.session.links[1:] == [(Address(1, 3), LinkKind.STREAM), (Address(1, 3), None)]
    assert rig.session.heard[-1][1] == b"bye"


def test_a_scan_of_settings_that_have_changed_is_counted_and_measured_anew() -> None:
    session = ScriptedSession()
    pending: list[ScanPlan] = []

    class Later:
        def request(self, sensor: str, wanted: ScanPlan, conditions: Conditions = NORMAL) -> None:
            pending.append(wanted)

        def collect(self, sensor: str) -> list[Scan]:
            done = [Scan.empty(wanted) for wanted in pending] if release else []
            if release:
                pending.clear()
            return done

    release = False
    instrument = Instrument("front", session, [ListLink(LinkKind.SERIAL)], Later())
    instrument.power_on(0)
    session.on = True
    instrument.step(0)
    session.epoch += 1
    instrument.step(1)
    assert [(item.epoch, item.sweep) for item in pending] == [(0, 0), (1, 0)]
    release = True
    instrument.step(2)
    assert instrument.stats.scans_dropped == {"withdrawn by a changed setting": 1}
    assert session.sweep >= 1


def test_drops_are_counted_by_what_was_dropped() -> None:
    rig = Rig(LinkKind.SERIAL)
    rig.session.events += [
        Dropped(0, DropReason.BAD_CHECKSUM, count=3),
        Dropped(0, DropReason.LINE_BUSY, count=7),
    ]
    rig.run.advance(1)
    assert rig.instrument.stats.input_dropped == {"bad checksum": 3}
    assert rig.instrument.stats.scans_dropped == {"line slower than the scan rate": 7}
    assert rig.instrument.stats.restarts == 1


def test_a_sensor_that_never_rests_is_stopped_rather_than_hang_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(virtual, "MAX_STEPS_AT_ONCE", 1000)
    rig = Rig(LinkKind.SERIAL)
    rig.session.take_emissions = lambda now_ns: [Emission(now_ns, b"x")]  # type: ignore[method-assign]
    with pytest.raises(EmulatorError, match="does not come to rest"):
        rig.run.advance(1)


def test_a_sensor_that_rests_is_not_woken_by_input_that_waits_for_it() -> None:
    rig = Rig(LinkKind.STREAM)
    link, clock = rig.links[0], [0]
    turn = rig.instrument.input_budget.turn
    turn.clock_ns = lambda: clock[0]
    link.flush = lambda now_ns: 5  # type: ignore[method-assign,assignment]
    "What a link says whose intake was to open again at 5 ns, and was not asked since."

    def dear(*_: object) -> None:
        clock[0] += 4_000_000

    rig.session.receive = dear  # type: ignore[method-assign,assignment]
    rig.hear(b"flood")
    wake = rig.instrument.step(10)
    assert wake == 10 + 4 * 4_000_000
    assert rig.instrument.step(11) == wake
    assert rig.instrument.step(wake) == 5, "now it is asked for at once"
