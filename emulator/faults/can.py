"""Faults of CAN frames and of the bus: errors of the controller, check headers, lengths, identifiers, floods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

from pydantic import Field

from emulator.config.names import nearest
from emulator.faults.acts import Act, Gear
from emulator.faults.config import Common
from emulator.faults.kinds import TO_HOST, Keys, Kind, Target
from emulator.faults.plug import Holding
from emulator.transports.can_link import CanLink
from emulator.transports.can_wire import BUS_OFF, ERROR_PASSIVE, TRANSMIT_ERROR, CanWire, Node
from protocols.can_frame import EXTENDED, frame_bits, is_identifier
from protocols.session import Address, Emission, LinkKind

CAN = (LinkKind.CAN,)
NEXT = "The next frame is correct again."


class BusOffKeys(Keys):
    """Of a controller that leaves the bus."""

    off_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 0.0
    "How long its firmware waits before it starts the controller again; at least the 128 x 11 bits of ISO 11898-1."


class BusOff(Act):
    """Errors until the controller leaves the bus."""

    def __init__(self, keys: BusOffKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._off_ns = round(keys.off_s * 1e9)

    def _links(self) -> list[CanLink]:
        return [link for link in self.gear.links if isinstance(link, CanLink)]

    def begin(self, now_ns: int) -> None:
        self.gear.hit(now_ns)
        for link in self._links():
            link.node.recovery_ns = self._off_ns
            link.disturb(max(1, -(-(BUS_OFF - link.node.error_counter) // TRANSMIT_ERROR)))

    def end(self, now_ns: int) -> None:
        for link in self._links():
            link.restart(now_ns)

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        for link in self._links():
            if link.node.off_until_ns is not None and emission.due_ns < link.node.off_until_ns:
                return self.gear.lost(emission)
        return None


class ErrorPassive(BusOff):
    """Errors until the controller is error passive."""

    def __init__(self, keys: Keys, gear: Gear) -> None:
        Act.__init__(self, gear)

    def begin(self, now_ns: int) -> None:
        self.gear.hit(now_ns)
        for link in self._links():
            link.disturb(max(0, -(-(ERROR_PASSIVE - link.node.error_counter) // TRANSMIT_ERROR)))

    def end(self, now_ns: int) -> None:
        for link in self._links():
            link.node.disturbed = 0


class E2eCounterKeys(Keys):
    """Of a counter of the end-to-end protection."""

    change: Annotated[int, Field(ge=-255, le=255)] | None = None
    "Added to the counter; None: it stands still at what it was."


class E2eCounter(Act):
    """The protection's counter jumps or stands, its checksum is right."""

    def __init__(self, keys: E2eCounterKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._change = keys.change
        self._stands: dict[tuple[Address | None, str], int] = {}

    def seen(self, emission: Emission) -> None:
        framing = self.gear.framing(emission.address)
        count = None if framing is None or self._change is not None else framing.e2e_counter(emission)
        if count is not None:
            self._stands[emission.address, emission.label] = count

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        framing = self.gear.framing(emission.address)
        count = None if framing is None else framing.e2e_counter(emission)
        if framing is None or count is None:
            return None
        change = self._change
        if change is None:
            stands = self._stands.setdefault((emission.address, emission.label), count)
            change = stands - count
        payload = framing.with_e2e_counter(emission, change)
        if payload is None or payload == emission.payload:
            return None
        self.gear.hit(now_ns, emission.label)
        return [replace(emission, payload=payload)]


class E2eCheck(Act):
    """The protection's checksum is wrong."""

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        framing = self.gear.framing(emission.address)
        payload = None if framing is None else framing.bad_e2e_check(emission)
        if payload is None:
            return None
        self.gear.hit(now_ns, emission.label)
        return [self.gear.spoilt(emission, payload)]


class DlcKeys(Keys):
    """Of a wrong data length."""

    data_bytes: Annotated[int, Field(ge=0, le=8)]
    "How many bytes the frame has instead; more are filled with zeros."


class WrongDlc(Act):
    """A frame of another length."""

    def __init__(self, keys: DlcKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._size = keys.data_bytes

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        if len(emission.payload) == self._size:
            return None
        self.gear.hit(now_ns, f"{emission.label}: {len(emission.payload)} bytes")
        self.gear.took("bytes", max(0, len(emission.payload) - self._size))
        payload = emission.payload[: self._size].ljust(self._size, b"\0")
        return [self.gear.spoilt(emission, payload)]


class Missing(Act):
    """A message is never sent."""

    def send(self, emission: Emission, now_ns: int) -> list[Emission]:
        self.gear.hit(now_ns, emission.label)
        return self.gear.lost(emission)


class ShiftKeys(Keys):
    """Of foreign identifiers."""

    shift: Annotated[int, Field(ge=-0x1FFFFFFF, le=0x1FFFFFFF)] = 0x10
    "Added to the identifier."


class Shifted(Act):
    """Frames under another identifier."""

    def __init__(self, keys: ShiftKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._shift = keys.shift

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        address = emission.address
        if address is None:
            return None
        flag = address.peer & EXTENDED
        peer = (address.peer & ~EXTENDED) + self._shift | flag
        if (address.peer & ~EXTENDED) + self._shift < 0 or not is_identifier(peer):
            return None
        self.gear.hit(now_ns, f"{emission.label}: {peer & ~EXTENDED:#x}")
        self.gear.damaged(emission)
        return [replace(emission, address=Address(address.link, peer), sweep=None)]


class BurstKeys(Keys):
    """Of a burst of frames."""

    frames: Annotated[int, Field(ge=2, le=1000)] = 20
    "How many of the same, back to back."


class Burst(Act):
    """The same frame again and again."""

    def __init__(self, keys: BurstKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._frames = keys.frames

    def send(self, emission: Emission, now_ns: int) -> list[Emission]:
        self.gear.hit(now_ns, emission.label)
        return [emission] + [replace(emission, sweep=None)] * (self._frames - 1)


class SignalKeys(Keys):
    """Of a signal with a value that it must not have."""

    signal: Annotated[str, Field(min_length=1, max_length=100)]
    "Name in the DBC, as `DistLong`; in every message that has it, or in that of `label`."
    raw: Annotated[int, Field(ge=0, le=2**64 - 1)] | None = None
    "Raw value, cut to the signal's bits; None: all bits are one, the usual `not available`."


class Signal(Act):
    """A signal out of its range."""

    def __init__(self, keys: SignalKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keys = keys

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        framing = self.gear.framing(emission.address)
        if framing is None:
            return None
        raw = framing.all_ones(emission.label, self._keys.signal) if self._keys.raw is None else self._keys.raw
        payload = framing.with_signal(emission, self._keys.signal, raw)
        if payload is None or payload == emission.payload:
            return None
        self.gear.hit(now_ns, f"{emission.label}.{self._keys.signal}")
        return [replace(emission, payload=payload)]


class RateKeys(Keys):
    """Of lists that come too seldom."""

    keep_every: Annotated[int, Field(ge=2, le=1000)] = 2
    "Of so many lists one is sent."


class SlowRate(Act):
    """Lists are left out, whole."""

    def __init__(self, keys: RateKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keep = keys.keep_every
        self._lists = 0
        self._leaving_out = False

    def begin(self, now_ns: int) -> None:
        self._lists, self._leaving_out = 0, False

    def send(self, emission: Emission, now_ns: int) -> list[Emission] | None:
        if emission.sweep is not None:
            self._leaving_out = self._lists % self._keep != 0
            self._lists += 1
        if not self._leaving_out:
            return None
        if emission.sweep is not None:
            self.gear.hit(now_ns, emission.label)
        return self.gear.lost(emission)


class BabbleKeys(Keys):
    """Of a node that babbles."""

    identifier: Annotated[int, Field(ge=0, le=0x7FF)] = 0
    "Of its frames; the lower, the more of the device's own frames must wait."
    load: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    "Share of the bus that it takes."


class Babble(Holding):
    """A foreign node floods the bus."""

    SLICE_NS = 10_000_000

    def __init__(self, keys: BabbleKeys, gear: Gear) -> None:
        super().__init__(gear)
        self._keys = keys
        self._nodes: list[tuple[CanWire, Node]] = []
        self._until_ns: int | None = None

    def begin(self, now_ns: int) -> None:
        super().begin(now_ns)
        wires = [link.wire for link in self.gear.links if isinstance(link, CanLink)]
        self._nodes = [(wire, wire.join("babbling")) for wire in wires]
        self._until_ns = now_ns

    def end(self, now_ns: int) -> None:
        for wire, node in self._nodes:
            wire.clear(node)
            wire.leave(node)
        self._nodes, self._until_ns = [], None

    def next_ns(self) -> int | None:
        return self._until_ns

    def release(self, now_ns: int) -> list[Emission]:
        while self._until_ns is not None and self._until_ns <= now_ns:
            for wire, node in self._nodes:
                data = bytes(8)
                frame_ns = frame_bits(self._keys.identifier, data) * 1e9 / wire.bitrate / self._keys.load
                for index in range(int(self.SLICE_NS / frame_ns) + 1):
                    wire.put(node, self._keys.identifier, data, self._until_ns + round(index * frame_ns))
            self._until_ns += self.SLICE_NS
        return []


def _protected(keys: Keys, common: Common, target: Target) -> str | None:
    table = {**(target.facts or {}), **(target.device or {})}
    e2e = table.get("e2e")
    if not isinstance(e2e, dict):
        return f"{target.sensor} has no end-to-end protection; want `e2e` in its device table"
    messages = e2e.get("messages")
    if common.label is not None and isinstance(messages, dict) and common.label not in messages:
        return f"{common.label} is not protected; want one of {', '.join(messages)}"
    return None


def _layout(target: Target) -> Any:
    from importlib import import_module

    from protocols.can_objects import FORMATS
    from protocols.can_objects.layout import load

    table = {**(target.facts or {}), **(target.device or {})}
    name = FORMATS.get(str(table.get("format")))
    return None if name is None else load(import_module(name).SESSION.LAYOUT_FILE)


def unknown_message(label: str, target: Target) -> str | None:
    """`found; want allowed` for a label that no message of an object list's format has."""
    if target.messages is not None:
        return None if label in target.messages else f"message {label!r}; want {nearest(label, target.messages)}"
    layout = _layout(target) if target.family == "can_objects" else None
    if layout is None or label in layout.messages:
        return None
    return f"message {label!r}; want {nearest(label, layout.messages)}"


def _known_signal(keys: Any, common: Common, target: Target) -> str | None:
    if target.messages is not None:
        sent = [target.messages.get(common.label, ())] if common.label else target.messages.values()
        known = list(dict.fromkeys(name for names in sent for name in names))
        is_known = keys.signal in known or not known
        return None if is_known else f"signal {keys.signal!r}; want {nearest(keys.signal, known)}"
    layout = _layout(target)
    if layout is None or (common.label is not None and common.label not in layout.messages):
        return None  # a wrong label is informed of every fault
    messages = [layout[common.label]] if common.label else layout.messages.values()
    known = list(dict.fromkeys(name for message in messages for name in message.signals))
    return None if keys.signal in known else f"signal {keys.signal!r}; want {nearest(keys.signal, known)}"


def _missing(keys: Keys, common: Common, target: Target) -> str | None:
    return "without label; want the name of a message" if common.label is None else None


def _kind(name: str, summary: str, act: Callable[..., Act], keys: type[Keys] = Keys, **more: object) -> Kind:
    given: dict[str, object] = {"directions": TO_HOST, "links": CAN} | more
    return Kind(name, "can", summary, str(given.pop("ends", NEXT)), keys, act, **given)  # type: ignore[arg-type]


OBJECTS = ("can_objects",)

KINDS: tuple[Kind, ...] = (
    _kind(
        "bus_off",
        "The device's frames are destroyed until its controller leaves the bus; frames to send are lost.",
        BusOff,
        BusOffKeys,
        lasts="state",
        ends="The controller recovers after `off_s`, at the latest when the fault ends; frames due then are sent.",
    ),
    _kind(
        "error_passive",
        "The device's frames are destroyed and sent again until its controller is error passive.",
        ErrorPassive,
        lasts="state",
        ends="Good frames decrease the error counters; the controller is error active again.",
    ),
    _kind(
        "e2e_counter",
        "The counter of the end-to-end protection jumps or stops; its checksum is correct.",
        E2eCounter,
        E2eCounterKeys,
        families=OBJECTS,
        check=_protected,
        ends="The counter has the value that it would have without the fault.",
    ),
    _kind(
        "e2e_checksum",
        "The checksum of the end-to-end protection is wrong.",
        lambda keys, gear: E2eCheck(gear),
        families=OBJECTS,
        check=_protected,
    ),
    _kind("wrong_dlc", "A frame has another number of bytes.", WrongDlc, DlcKeys),
    _kind(
        "missing_message",
        "The message that `label` names is never sent.",
        lambda keys, gear: Missing(gear),
        lasts="state",
        families=OBJECTS,
        check=_missing,
        ends="The message is sent again in its position.",
    ),
    _kind("shifted_identifier", "Frames have another identifier.", Shifted, ShiftKeys),
    _kind(
        "frame_burst",
        "A frame is sent many times, back to back.",
        Burst,
        BurstKeys,
        ends="Each frame is sent once; frames queued behind the burst follow.",
    ),
    _kind(
        "invalid_signal",
        "A signal has a value outside its range, or the value for `not available`.",
        Signal,
        SignalKeys,
        families=OBJECTS,
        check=_known_signal,
    ),
    _kind(
        "slow_rate",
        "Lists are sent at half their rate, or less; omitted lists are missing completely.",
        SlowRate,
        RateKeys,
        lasts="state",
        ends="Every list is sent again.",
    ),
    _kind(
        "babbling_node",
        "A foreign node floods the bus with frames of higher priority.",
        Babble,
        BabbleKeys,
        lasts="state",
        directions=(),
        check=None,
        ends="The bus is free; frames that could not be queued are lost and counted.",
    ),
)
