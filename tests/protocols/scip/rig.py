"""A SCIP session in virtual time, a world that answers its plans, and a decoder independent of `protocols`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from protocols.scan import Scan, ScanPlan
from protocols.scip import FAMILY
from protocols.scip.session import ScipSession
from protocols.session import Address, Dropped, DropReason, Emission, LinkKind

MS, SECOND = 1_000_000, 1_000_000_000
LOOK_AHEAD_NS = 250 * MS
LINE = Address(0, 0)
World = Callable[[ScanPlan], Scan]


def steps_away(plan: ScanPlan) -> Scan:
    """The worked scene of the specification: step s is at 1000 + 5 s mm, with intensity 2000 + s."""
    scan = Scan.empty(plan, 3)
    index = np.arange(len(plan))
    scan.range_m[:, 0] = (1000 + 5 * index) / 1000.0
    scan.intensity[:, 0] = (2000 + index) / 50.0
    return scan


@dataclass
class Read:
    """One reply, decoded by the letter of the specification."""

    echo: str
    status: str
    lines: list[str]
    due_ns: int = 0

    @property
    def stamp(self) -> int:
        return number(self.lines[0])

    @property
    def data(self) -> str:
        return "".join(self.lines[1:])

    def distances(self, width: int = 3) -> list[int]:
        return [number(self.data[at : at + width]) for at in range(0, len(self.data), width)]


def number(text: str) -> int:
    value = 0
    for char in text:
        assert "0" <= char <= "o", text
        value = value * 64 + ord(char) - 48
    return value


def unsummed(line: str) -> str:
    text, found = line[:-1], line[-1]
    summed = text[:-1] if re.fullmatch("(?s)[A-Z]{4}:.*;", text) else text
    assert chr(sum(map(ord, summed)) % 64 + 48) == found, line
    return text


def read(data: bytes, due_ns: int = 0) -> list[Read]:
    """All replies; each ends with an empty line, every line has its sum."""
    text = data.decode("ascii")
    assert not text or text.endswith("\n\n"), text
    found = []
    for one in text.split("\n\n")[:-1]:
        echo, status, *lines = one.split("\n")
        assert all(len(line) <= 65 for line in lines if ":" not in line)
        found.append(Read(echo, unsummed(status), [unsummed(line) for line in lines], due_ns))
    return found


class Rig:
    """One session switched on, its motor at speed."""

    def __init__(
        self,
        model: str = "hokuyo-utm-30lx",
        device: Mapping[str, Any] | None = None,
        world: World = steps_away,
        kind: LinkKind = LinkKind.SERIAL,
        ready: bool = True,
    ) -> None:
        settings = {"boot_s": 0.0, "spin_up_s": 0.0, **(device or {})}
        self.session: ScipSession = FAMILY.new_session(settings, {"model": model})
        self.world, self.kind, self.now_ns = world, kind, 0
        self.sent: list[Emission] = []
        self.events: list[Any] = []
        if kind is LinkKind.SERIAL:
            self.session.connected(0, LINE, kind)
        self.session.power_on(0)
        self.run(10 * MS if ready else 0)

    def step(self) -> int | None:
        session = self.session
        session.advance(self.now_ns)
        while (plan := session.next_plan()) is not None and plan.start_ns <= self.now_ns + LOOK_AHEAD_NS:
            session.submit(self.world(plan))
        self.sent += session.take_emissions(self.now_ns)
        self.events += session.take_events()
        plan = session.next_plan()
        wakes = [session.next_deadline(), None if plan is None else plan.start_ns - LOOK_AHEAD_NS]
        return min((wake for wake in wakes if wake is not None), default=None)

    def run(self, duration_ns: int) -> None:
        until_ns = self.now_ns + duration_ns
        while (wake_ns := self.step()) is not None and wake_ns <= until_ns:
            self.now_ns = max(self.now_ns, wake_ns)
        self.now_ns = until_ns

    def take(self, address: Address | None = None) -> list[Read]:
        """Replies and scans since the last call."""
        mine = [one for one in self.sent if (address is None or one.address == address) and one.payload]
        self.sent = [one for one in self.sent if one not in mine]
        return [reply for one in mine for reply in read(one.payload, one.due_ns)]

    def raw(self) -> bytes:
        found, self.sent = b"".join(one.payload for one in self.sent), []
        return found

    def put(self, text: str, address: Address = LINE) -> None:
        self.session.receive(text.encode("latin-1"), self.now_ns, address)

    def ask(self, command: str, within_ns: int = 2 * MS, address: Address = LINE) -> Read:
        """The one reply to a command."""
        self.put(command + "\n", address)
        self.run(within_ns)
        (reply,) = self.take(address)
        assert reply.echo == command
        return reply

    def status(self, command: str, within_ns: int = 2 * MS) -> str:
        return self.ask(command, within_ns).status

    def dropped(self) -> list[DropReason]:
        found = [one.reason for one in self.events if isinstance(one, Dropped)]
        self.events = []
        return found
