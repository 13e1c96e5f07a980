"""Faults of links and of power: what a plug, a switch, a network stack, or a host's own mistake does.

Not: what a session does when it is switched on (its family), how a link hangs up (transports).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

from pydantic import Field

from emulator.faults.acts import Act, Gear
from emulator.faults.config import Common
from emulator.faults.kinds import FROM_HOST, Keys, Kind, Target
from emulator.transports.link import Received
from protocols.session import Emission, LinkKind

STREAMS = (LinkKind.STREAM, LinkKind.SERIAL)
AGAIN = "Hosts find the link at the same place and reconnect; the device kept running."


class Holding(Act):
    """Something that holds for a time and is one hit."""

    def begin(self, now_ns: int) -> None:
        self.gear.hit(now_ns)


class Unplug(Holding):
    """The plug is out."""

    def begin(self, now_ns: int) -> None:
        super().begin(now_ns)
        for link in self.gear.links:
            if link.kind is LinkKind.CAN:
                self.gear.took("bytes", link.clear())
                continue
            link.unplug()
            self.gear.instrument.connections_seen += 1
        self.gear.instrument.torn_off(now_ns)
        self.gear.instrument.poked = True  # a link that was read in this step already reports its hosts in the next

    def end(self, now_ns: int) -> None:
        for link in self.gear.links:
            if link.kind is not LinkKind.CAN:
                link.plug()
                self.gear.instrument.connections_seen += 1

    def send(self, emission: Emission, now_ns: int) -> list[Emission]:
        return self.gear.lost(emission)

    def hear(self, received: Received, link: int, now_ns: int) -> list[Received]:
        self.gear.swallowed(len(received.data))
        return [] if not received.closed else [replace(received, data=b"")]


class PowerKeys(Keys):
    """Of a power cut."""

    off_s: Annotated[float, Field(gt=0.0, le=1e6)]
    "How long the power is away; the device's own start-up follows."


class Power(Holding):
    """The power is away; the device boots when it is back."""

    def begin(self, now_ns: int) -> None:
        super().begin(now_ns)
        self.gear.took("bytes", self.gear.instrument.power_off(now_ns))
        for link in self.gear.instrument.links:
            if link.kind is LinkKind.STREAM:
                self.gear.took("connections", link.abandon_hosts())
        self.gear.instrument.connections_seen += 1

    def end(self, now_ns: int) -> None:
        for link in self.gear.instrument.links:
            if link.kind is LinkKind.STREAM:
                link.revive()
        self.gear.instrument.connections_seen += 1
        self.gear.instrument.power_back(now_ns)


class Reboot(Power):
    """The device starts again at once."""

    def begin(self, now_ns: int) -> None:
        super().begin(now_ns)
        super().end(now_ns)

    def end(self, now_ns: int) -> None:
        return None


class Hang(Holding):
    """The device says nothing and hears nothing; its links stay as they are."""

    def send(self, emission: Emission, now_ns: int) -> list[Emission]:
        return self.gear.lost(emission)

    def hear(self, received: Received, link: int, now_ns: int) -> list[Received]:
        self.gear.swallowed(len(received.data))
        return [replace(received, data=b"")]


class SlowKeys(Keys):
    """Of a slow link."""

    bytes_per_s: Annotated[float, Field(gt=0.0, le=1e9)]
    "What still goes through."
    buffer_bytes: Annotated[int, Field(ge=1, le=10**8)] = 65_536
    "What may wait for it; telegrams that find no room are lost."


class Slow(Holding):
    """Bytes leave at a rate of their own, in pieces."""

    PIECE_S = 0.01

    counts_itself = True

    def __init__(self, keys: SlowKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._rate, self._room = keys.bytes_per_s, keys.buffer_bytes
        self._free_ns: dict[int | None, int] = {}
        self._waiting: dict[int | None, deque[Emission]] = {}
        "By link: telegrams that have not wholly left, the first one without what has."
        self._begun: set[int | None] = set()
        "Links on which the first one has begun."
        self._holds = False

    def begin(self, now_ns: int) -> None:
        super().begin(now_ns)
        self._free_ns.clear()
        self._holds = True

    def end(self, now_ns: int) -> None:
        self._holds = False

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        key = None if emission.address is None else emission.address.link
        if not self._holds:  # it has ended in this very step: what waits goes first
            return [*self._rest(key, now_ns), emission]
        waiting = self._waiting.setdefault(key, deque())
        if sum(len(one.payload) for one in waiting) + len(emission.payload) > self._room:
            return self.gear.lost(emission)
        waiting.append(emission)
        self.gear.held(emission)
        return []

    @property
    def busy(self) -> bool:
        return any(self._waiting.values())

    def next_ns(self) -> int | None:
        if not self._holds:
            return 0 if self.busy else None
        return min((self._due_ns(key) for key, waiting in self._waiting.items() if waiting), default=None)

    def release(self, now_ns: int) -> list[Emission]:
        found: list[Emission] = []
        for key, waiting in self._waiting.items():
            if not self._holds:
                found += self._rest(key, now_ns)
            while waiting and self._due_ns(key) <= now_ns:
                found.append(self._piece(key))
        return found

    def cut(self) -> list[Emission]:
        lost = [one for waiting in self._waiting.values() for one in waiting]
        self._waiting.clear()
        self._begun.clear()
        return lost

    def _due_ns(self, key: int | None) -> int:
        return max(self._waiting[key][0].due_ns, self._free_ns.get(key, 0))

    def _piece(self, key: int | None) -> Emission:
        """What leaves next on that link."""
        waiting, due_ns = self._waiting[key], self._due_ns(key)
        first = waiting[0]
        size = max(1, round(self._rate * self.PIECE_S))
        if self.gear.kind(first.address) in (LinkKind.DATAGRAM, LinkKind.CAN):
            size = len(first.payload)
        part, rest = first.payload[:size], first.payload[size:]
        self._free_ns[key] = due_ns + round(len(part) / self._rate * 1e9)
        sweep = None if key in self._begun else first.sweep
        if rest:
            waiting[0] = replace(first, payload=rest)
            self._begun.add(key)
            return replace(first, payload=part, due_ns=due_ns, sweep=sweep, line_speed=None)
        waiting.popleft()
        self._begun.discard(key)
        return replace(first, payload=part, due_ns=due_ns, sweep=sweep)

    def _rest(self, key: int | None, now_ns: int) -> list[Emission]:
        """All that waits for that link, now."""
        waiting = self._waiting.get(key, deque())
        found = [replace(one, due_ns=now_ns) for one in waiting]
        if key in self._begun:
            found[0] = replace(found[0], sweep=None)
            self._begun.discard(key)
        waiting.clear()
        return found


class ResetHosts(Act):
    """Connections are reset."""

    def begin(self, now_ns: int) -> None:
        for link in self.gear.links:
            count = link.reset_hosts()
            self.gear.took("connections", count)
            self.gear.hit(now_ns, f"{count} connections")
        self.gear.instrument.torn_off(now_ns)
        self.gear.instrument.connections_seen += 1
        self.gear.instrument.poked = True


class RefuseHosts(Holding):
    """New connections are refused; existing ones stay."""

    def begin(self, now_ns: int) -> None:
        super().begin(now_ns)
        for link in self.gear.links:
            link.refuse_hosts(True)
        self.gear.instrument.connections_seen += 1

    def end(self, now_ns: int) -> None:
        for link in self.gear.links:
            link.refuse_hosts(False)
        self.gear.instrument.connections_seen += 1


class BaudKeys(Keys):
    """Of a wrong line speed."""

    baud: Annotated[int, Field(ge=50, le=10_000_000)]
    "Speed of the device's line meanwhile."


class WrongBaud(Holding):
    """The device's line has another speed than the device says."""

    def __init__(self, keys: BaudKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._baud = keys.baud

    @property
    def _own(self) -> dict[int, list[int | None]]:
        assert self.gear.instrument.faults is not None
        return self.gear.instrument.faults.own_speeds

    def begin(self, now_ns: int) -> None:
        super().begin(now_ns)
        for index, link in zip(self.gear.indices, self.gear.links, strict=True):
            own = self._own.setdefault(index, [])
            own.append(own[0] if own else link.speed)
            self.gear.instrument.set_line_speed(index, now_ns, self._baud)

    def end(self, now_ns: int) -> None:
        for index in self.gear.indices:
            own = self._own[index].pop()
            if not self._own[index]:
                self.gear.instrument.set_line_speed(index, now_ns, own)

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        if emission.line_speed is None:
            return None
        for index in self.gear.indices if emission.address is None else [emission.address.link]:
            self._own[index] = [emission.line_speed] * len(self._own.get(index, ()))
        return [replace(emission, line_speed=None)]


class LoseInput(Act):
    """What a host has sent does not arrive."""

    def hear(self, received: Received, link: int, now_ns: int) -> list[Received]:
        if not received.data:
            return [received]
        self.gear.hit(now_ns, f"{len(received.data)} bytes")
        self.gear.swallowed(len(received.data))
        return [replace(received, data=b"")]


def _on_tcp(keys: Keys, common: Common, target: Target) -> str | None:
    urls = target.urls if common.link is None or common.link >= len(target.urls) else (target.urls[common.link],)
    if urls and not any(url.partition(":")[0] in ("tcp", "loop") for url in urls):
        return f"{target.sensor} has {', '.join(urls)}; want a tcp link"
    return None


def _kind(name: str, summary: str, ends: str, act: Callable[..., Act], keys: type[Keys] = Keys, **more: object) -> Kind:
    given: dict[str, object] = {"lasts": "state"} | more
    return Kind(name, "link", summary, ends, keys, act, **given)  # type: ignore[arg-type]


KINDS: tuple[Kind, ...] = (
    _kind(
        "unplug",
        "The plug is pulled: the path of a pty vanishes and its host is hung up, TCP connections are reset and the"
        " port is closed, a CAN bus is silent.",
        AGAIN,
        lambda keys, gear: Unplug(gear),
    ),
    _kind(
        "power_cycle",
        "The power is off for `off_s`: output stops within a byte, TCP connections stay open on the host's side"
        " and are silent; then the device's own start-up with its delay and its telegrams.",
        "The device has started: volatile settings are lost, a host must configure it again; on an old TCP connection"
        " the first data that it sends are answered by a reset.",
        lambda keys, gear: Power(gear),
        PowerKeys,
        lasts="own",
        own_s=lambda keys: keys.off_s,
    ),
    _kind(
        "reboot",
        "The device resets itself: its output breaks off, its start-up with its delay and its telegrams follows.",
        "As after a power cut.",
        lambda keys, gear: Reboot(gear),
        lasts="own",
        own_s=lambda keys: 0.0,
    ),
    _kind(
        "hang",
        "The device neither sends nor receives on any link, like hung firmware; connections are accepted and stay.",
        "It continues with the same settings and stream; counters have advanced.",
        lambda keys, gear: Hang(gear),
    ),
    _kind(
        "half_open",
        "TCP connections are accepted and held, but nothing is answered or read.",
        "The same connections are served again.",
        lambda keys, gear: Hang(gear),
        links=(LinkKind.STREAM,),
    ),
    _kind(
        "slow_link",
        "The rate is limited to `bytes_per_s`; telegrams that exceed the buffer are lost.",
        "Queued data is sent, then telegrams are on time.",
        Slow,
        SlowKeys,
    ),
    _kind(
        "reset_connections",
        "All TCP connections are reset at once.",
        "Hosts can reconnect immediately.",
        lambda keys, gear: ResetHosts(gear),
        lasts="own",
        own_s=lambda keys: 0.0,
        links=STREAMS,
        check=_on_tcp,
    ),
    _kind(
        "refuse_connections",
        "New connections are refused; existing ones stay.",
        "The port accepts connections again.",
        lambda keys, gear: RefuseHosts(gear),
        links=STREAMS,
        check=_on_tcp,
    ),
    _kind(
        "wrong_baud",
        "The line speed differs from the one agreed on: both sides receive bytes with framing errors.",
        "The line has the agreed speed, including changes made meanwhile.",
        WrongBaud,
        BaudKeys,
        links=(LinkKind.SERIAL,),
    ),
    _kind(
        "lose_input",
        "Data of a host does not reach the device.",
        "The next request is answered.",
        lambda keys, gear: LoseInput(gear),
        lasts="telegrams",
        directions=FROM_HOST,
    ),
)
