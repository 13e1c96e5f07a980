"""Faults of whole telegrams: lost, repeated, late, out of order, with wrong fields and right checks, wrong replies.

How a family frames its telegrams, and how their checks are made right again, is `protocols.framing`'s.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

from pydantic import Field

from emulator.faults import states
from emulator.faults.acts import Act, Gear
from emulator.faults.config import Common
from emulator.faults.kinds import FROM_HOST, TO_HOST, Keys, Kind, Target
from emulator.transports.link import Received
from protocols.framing import Framing
from protocols.session import Emission
from protocols.wire import wire_of

NEXT_ONE = "The next telegram is correct again."


class Drop(Act):
    """A telegram never leaves."""

    def send(self, emission: Emission, now_ns: int) -> list[Emission]:
        self.gear.hit(now_ns, emission.label)
        return self.gear.lost(emission)


class TimesKeys(Keys):
    """Of a repeated telegram."""

    times: Annotated[int, Field(ge=1, le=10_000)] = 1
    "How often it comes again."


class Repeat(Act):
    """A telegram comes again at once."""

    def __init__(self, keys: TimesKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._times = keys.times

    def send(self, emission: Emission, now_ns: int) -> list[Emission]:
        self.gear.hit(now_ns, emission.label)
        first = replace(emission, line_speed=None)
        return [first] * self._times + [emission]


class BehindKeys(Keys):
    """Of telegrams out of order."""

    behind: Annotated[int, Field(ge=1, le=64)] = 1
    "How many telegrams overtake it."


class Reorder(Act):
    """A telegram leaves behind those that follow it."""

    LONGEST_NS = 1_000_000_000
    "It does not wait longer for others to overtake it."
    counts_itself = True

    def __init__(self, keys: BehindKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._behind = keys.behind
        self._held: list[tuple[int, Emission]] = []
        "(telegrams that are still to overtake it, it)"

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        if not self._held:
            self.gear.hit(now_ns, emission.label)
            self._held.append((self._behind, replace(emission, line_speed=None)))
            self.gear.held(emission)
            return [] if emission.line_speed is None else [replace(emission, payload=b"", sweep=None)]
        left, held = self._held[0]
        if left > 1:
            self._held[0] = (left - 1, held)
            return None
        self._held.clear()
        return [emission, replace(held, due_ns=emission.due_ns)]

    @property
    def busy(self) -> bool:
        return bool(self._held)

    def next_ns(self) -> int | None:
        return self._held[0][1].due_ns + self.LONGEST_NS if self._held else None

    def release(self, now_ns: int) -> list[Emission]:
        wake_ns = self.next_ns()
        if wake_ns is None or wake_ns > now_ns:
            return []
        held = [replace(one, due_ns=now_ns) for _, one in self._held]
        self._held.clear()
        return held

    def cut(self) -> list[Emission]:
        lost = [one for _, one in self._held]
        self._held.clear()
        return lost


class DelayKeys(Keys):
    """Of late telegrams."""

    delay_s: Annotated[float, Field(gt=0.0, le=3600.0)]
    "How much later they leave; on a line and a connection all that follows waits behind them."


class Delay(Act):
    """Telegrams leave late, in their order."""

    def __init__(self, keys: DelayKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._delay_ns = round(keys.delay_s * 1e9)

    def send(self, emission: Emission, now_ns: int) -> list[Emission]:
        self.gear.hit(now_ns, emission.label)
        return [replace(emission, due_ns=emission.due_ns + self._delay_ns)]


class TruncateKeys(Keys):
    """Of telegrams cut short."""

    keep_bytes: Annotated[int, Field(ge=1, le=10**9)] | None = None
    "What is left of it; None: half."


class Truncate(Act):
    """A telegram breaks off."""

    def __init__(self, keys: TruncateKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keep = keys.keep_bytes

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        size = len(emission.payload)
        keep = max(1, size // 2) if self._keep is None else self._keep
        if keep >= size:
            return None
        self.gear.hit(now_ns, f"{keep} of {size} bytes")
        self.gear.took("bytes", size - keep)
        return [self.gear.spoilt(emission, emission.payload[:keep])]


class Changed(Act):
    """A telegram with another field, by the family's framing."""

    def __init__(self, gear: Gear, change: Callable[[Framing, Emission], bytes | None], spoils: bool) -> None:
        """`spoils`: no host takes the scan out of it."""
        super().__init__(gear)
        self._change, self._spoils = change, spoils

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        framing = self.gear.framing(emission.address)
        payload = None if framing is None else self._change(framing, emission)
        if payload is None or payload == emission.payload:
            return None
        self.gear.hit(now_ns, emission.label)
        return [self.gear.spoilt(emission, payload) if self._spoils else replace(emission, payload=payload)]


class LengthKeys(Keys):
    """Of a wrong length field."""

    change: Annotated[int, Field(ge=-65_535, le=65_535)] = 7
    "Added to what the length field says."


class CounterKeys(Keys):
    """Of a wrong counter."""

    change: Annotated[int, Field(ge=-65_535, le=65_535)] = 5
    "Added to what the counter says."


class TypeKeys(Keys):
    """Of a wrong response code."""

    code: Annotated[int, Field(ge=0, le=0xFFFF)] = 0x92
    "Instead of the telegram's own; LMS2xx: one byte, LD: a word."


class AddressKeys(Keys):
    """Of a wrong address."""

    address: Annotated[int, Field(ge=0, le=0xFFFF)] = 5
    "Instead of the device's own; LMS2xx: one byte, LD: a word."


class StaleKeys(Keys):
    """Of an old scan."""

    age: Annotated[int, Field(ge=1, le=64)] = 1
    "How many telegrams before."


class Stale(Act):
    """The values of an earlier telegram under fresh counters."""

    def __init__(self, keys: StaleKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._old: dict[tuple[int | None, str], deque[Emission]] = {}
        self._age = keys.age
        self._frozen: dict[tuple[int | None, str], Emission] = {}

    def begin(self, now_ns: int) -> None:
        self._frozen.clear()

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        key = (None if emission.address is None else emission.address.link, emission.label)
        kept = self._old.setdefault(key, deque(maxlen=self._age))
        if len(kept) < self._age:
            kept.append(emission)
            return None
        old = self._frozen.setdefault(key, kept[0])
        framing = self.gear.framing(emission.address)
        payload = None if framing is None else framing.stale(old, emission)
        if payload is None:
            return None
        self.gear.hit(now_ns, emission.label)
        return [self.gear.spoilt(emission, payload)]

    def seen(self, emission: Emission) -> None:
        key = (None if emission.address is None else emission.address.link, emission.label)
        self._old.setdefault(key, deque(maxlen=self._age)).append(emission)


class Refuse(Act):
    """A request reaches the device in a form that it refuses: nothing is carried out, the refusal is its own."""

    LONGEST = 4096
    "Bytes of a request that are waited for; what is longer passes."

    def __init__(self, gear: Gear) -> None:
        super().__init__(gear)
        self._held: dict[tuple[int, int], bytes] = {}

    def hear(self, received: Received, link: int, now_ns: int) -> list[Received] | None:
        framing = self.gear.instrument.framing(self.gear.instrument.links[link].kind)
        if framing is None or not received.data:
            return None
        whole = self._held.pop((link, received.peer), b"") + received.data
        if not framing.is_whole(whole) and len(whole) < self.LONGEST:
            self._held[link, received.peer] = whole  # a line brings a request byte by byte
            return [replace(received, data=b"")]
        data = framing.to_be_refused(whole)
        if data is not None:
            self.gear.hit(now_ns)
        return [replace(received, data=whole if data is None else data)]

    def end(self, now_ns: int) -> None:
        self.gear.swallowed(sum(map(len, self._held.values())))
        self._held.clear()


def _has(method: str) -> Callable[[Keys, Common, Target], str | None]:
    """A check: whether the family's framing on the target's links has such a field."""

    def check(keys: Keys, common: Common, target: Target) -> str | None:
        from protocols.framing import Framing

        known = _framings(target, common.link)
        if known and all(getattr(type(one), method) is getattr(Framing, method) for one in known):
            return f"telegrams of {target.model} have no such field there; want another fault, or another link"
        return None

    return check


def _framings(target: Target, link: int | None) -> list[Framing]:
    wire = wire_of(target.family)
    if wire is None or wire.framing is None:
        return []  # of another package: known when the run begins
    links = target.links if link is None or link >= len(target.links) else (target.links[link],)
    return [wire.framing(kind) for kind in links or (wire.usual,)]


def _has_counter(keys: Keys, common: Common, target: Target) -> str | None:
    if target.messages is None or (common.label in target.counted if common.label else target.counted):
        return None
    found = f"{common.label} has no counter" if common.label else "no message has a counter"
    return f"{found}; want {' or '.join(target.counted) or 'a signal that is `counter`'}"


def _changes_check(keys: LengthKeys | CounterKeys, common: Common, target: Target) -> str | None:
    return "change 0 changes nothing; want another number" if keys.change == 0 else None


def _all(
    *checks: Callable[[Keys, Common, Target], str | None] | Callable[..., str | None],
) -> Callable[[Keys, Common, Target], str | None]:
    def check(keys: Keys, common: Common, target: Target) -> str | None:
        return next((reported for one in checks if (reported := one(keys, common, target)) is not None), None)

    return check


def _kind(name: str, summary: str, ends: str = NEXT_ONE, **more: object) -> Kind:
    more.setdefault("directions", TO_HOST)
    return Kind(name, "telegram", summary, ends, **more)  # type: ignore[arg-type]


def _refusing(name: str, summary: str, ends: str, part: str) -> Kind:
    """A state of the device itself, of families that have that part."""
    return _kind(
        name, summary, ends, act=lambda keys, gear: states.Impairing(gear, part, 1.0), directions=(), lasts="state",
        needs_part=part,
    )  # fmt: skip


KINDS: tuple[Kind, ...] = (
    _kind(
        "drop_telegram",
        "A telegram is not sent.",
        "The next telegram is on time; counters on the wire show the gap.",
        act=lambda keys, gear: Drop(gear),
    ),
    _kind(
        "repeat_telegram",
        "A telegram is repeated immediately with the same bytes.",
        "Each telegram is sent once.",
        keys=TimesKeys,
        act=Repeat,
    ),
    _kind(
        "reorder_telegrams",
        "A telegram is sent after telegrams that should follow it.",
        "Telegrams are in order; one that no telegram followed is sent after a second.",
        keys=BehindKeys,
        act=Reorder,
    ),
    _kind(
        "delay_telegram",
        "A telegram is late, and on a line or connection also those queued behind it.",
        "Queued telegrams are sent at line speed, then telegrams are on time.",
        keys=DelayKeys,
        act=Delay,
    ),
    _kind(
        "truncate_telegram",
        "A telegram is cut; the next one is on time.",
        keys=TruncateKeys,
        act=Truncate,
    ),
    _kind(
        "bad_checksum",
        "A telegram has a wrong checksum and no other error.",
        act=lambda keys, gear: Changed(gear, lambda framing, one: framing.bad_check(one), True),
        needs="bad_check",
        check=_has("bad_check"),
    ),
    _kind(
        "wrong_length",
        "The length field of a telegram is wrong; its checksum is correct.",
        keys=LengthKeys,
        act=lambda keys, gear: Changed(gear, lambda framing, one: framing.with_length(one, keys.change), True),
        needs="with_length",
        check=_all(_changes_check, _has("with_length")),
    ),
    _kind(
        "wrong_counter",
        "The counter of a telegram, profile or list jumps; the checksum is correct.",
        "The counter continues as without the fault.",
        keys=CounterKeys,
        act=lambda keys, gear: Changed(gear, lambda framing, one: framing.with_counter(one, keys.change), False),
        check=_all(_changes_check, _has("with_counter"), _has_counter),
    ),
    _kind(
        "wrong_type",
        "A telegram has another response code; its checksum is correct.",
        keys=TypeKeys,
        act=lambda keys, gear: Changed(gear, lambda framing, one: framing.with_type(one, keys.code), True),
        needs="with_type",
        check=_has("with_type"),
    ),
    _kind(
        "wrong_address",
        "A telegram has the address of another device; its checksum is correct.",
        keys=AddressKeys,
        act=lambda keys, gear: Changed(gear, lambda framing, one: framing.with_address(one, keys.address), True),
        needs="with_address",
        check=_has("with_address"),
    ),
    _kind(
        "stale_scan",
        "An old scan is repeated with new counters: the scene is frozen, and nothing on the wire shows it.",
        "Values are current again.",
        keys=StaleKeys,
        act=Stale,
        of="scans",
        check=_has("stale"),
    ),
    _kind(
        "lose_reply",
        "A reply is missing, ACK included; the command has been carried out.",
        "The next request is answered.",
        act=lambda keys, gear: Drop(gear),
        of="replies",
        needs="to_be_refused",
    ),
    _kind(
        "slow_reply",
        "A reply is late, as from a busy device.",
        "Replies are on time.",
        keys=DelayKeys,
        act=Delay,
        of="replies",
    ),
    _kind(
        "refuse_command",
        "A request is refused (NAK, service failure) and not carried out.",
        "The same request is accepted.",
        act=lambda keys, gear: Refuse(gear),
        directions=FROM_HOST,
        needs="to_be_refused",
        check=_has("to_be_refused"),
    ),
    _refusing(
        "device_busy",
        "The device answers every request with `device busy`; scans continue.",
        "Requests are carried out.",
        "busy",
    ),
    _refusing(
        "refuse_login",
        "The device refuses every login, also with the correct password.",
        "Logins succeed; those from before the fault were never lost.",
        "login",
    ),
    _refusing(
        "no_pps",
        "The pulses of the GPS receiver do not reach the device; its clock continues by its own quartz.",
        "They arrive again; the device locks to them again.",
        "no pps",
    ),
    *states.KINDS,
)
