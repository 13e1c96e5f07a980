"""A device of any family on a link in memory. On a line hosts have a speed of their own: both ends hear bit by bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from emulator.transports.loopback import LoopHost, LoopLink
from protocols import family
from protocols.scan import Scan, ScanPlan
from protocols.session import Address

MS, SECOND = 1_000_000, 1_000_000_000
LOOK_AHEAD_NS = 250 * MS
LINE = Address(0, 0)


def wall(plan: ScanPlan) -> Scan:
    """2 m all around."""
    scan = Scan.empty(plan, plan.max_echoes)
    scan.range_m[:, 0], scan.intensity[:, 0] = 2.0, 16.0
    return scan


class LineRig:
    """One session on one line, switched on at 0."""

    def __init__(
        self,
        name: str,
        model: str,
        device: Mapping[str, Any] | None = None,
        world: Callable[[ScanPlan], Scan] = wall,
        serial: bool = True,
    ) -> None:
        self.session: Any = family(name).new_session(device or {}, {"model": model})
        self.link, self.world, self.now_ns, self.serial = LoopLink("line", serial), world, 0, serial
        if serial:
            self.session.connected(0, LINE, self.link.kind)
        self.session.power_on(0)

    def host(self, baud: int | None = None) -> LoopHost:
        """A host that opens the port now."""
        return self.link.connect(self.now_ns, baud)

    def _step(self) -> None:
        session, link, now_ns = self.session, self.link, self.now_ns
        for received in link.receive(now_ns):
            address = Address(0, received.peer)
            if received.opened:
                session.connected(now_ns, address, link.kind)
            session.receive(received.data, now_ns, address)
            if received.foreign is not None:
                session.other_speed(*received.foreign, now_ns, address)
            if received.closed:
                session.disconnected(now_ns, address)
        session.advance(now_ns)
        while (plan := session.next_plan()) is not None and plan.start_ns <= now_ns + LOOK_AHEAD_NS:
            session.submit(self.world(plan))
        for one in session.take_emissions(now_ns):
            peer = None if self.serial or one.address is None else one.address.peer
            link.send(one.payload, one.due_ns, peer, one.line_speed)
        link.flush(now_ns)

    def run(self, duration_ns: int, step_ns: int = MS) -> None:
        """Time passes, in steps of `step_ns`."""
        until_ns = self.now_ns + duration_ns
        while self.now_ns < until_ns:
            self._step()
            self.now_ns = min(until_ns, self.now_ns + step_ns)
        self._step()

    def ask(self, host: LoopHost, data: bytes, within_ns: int) -> bytes:
        """What a host reads within some time of its request."""
        host.read()
        host.write(data, self.now_ns)
        self.run(within_ns)
        return host.read()
