"""A device that lists objects, driven in virtual time: what it sends, when, and what it says of its hosts.

Nothing sleeps: `run` moves the clock from one deadline to the next and hands in the objects of the moment as scans.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from protocols.can_objects import FAMILY
from protocols.can_objects.layout import Layout, load
from protocols.can_objects.session import CanObjectSession
from protocols.scan import DetectedObject, Scan
from protocols.session import Address, Dropped, DropReason, Emission, Event, LinkKind

MS = 1_000_000
SECOND = 1_000_000_000
BOOT_NS = 500 * MS

Objects = Callable[[int], Sequence[DetectedObject]]


def thing(track: int, x: float, y: float, **more: Any) -> DetectedObject:
    """An object with the few things that most tests do not care about filled in."""
    values: dict[str, Any] = {
        "position_m": (x, y, 0.0),
        "velocity_m_s": (0.0, 0.0, 0.0),
        "size_m": (4.4, 1.8, 1.5),
        "yaw_rad": 0.0,
        "category": "car",
    }
    return DetectedObject(track=track, **(values | more))


def crowd(count: int) -> tuple[DetectedObject, ...]:
    """Objects at different distances and bearings, all seen."""
    return tuple(
        thing(100 + k, 5.0 + 2.0 * k, ((k * 7) % 11) - 5.0, velocity_m_s=(0.5 * k - 10.0, 0.1 * k, 0.0), age_s=0.1 * k)
        for k in range(count)
    )


@dataclass
class Rig:
    """One device and the clock."""

    session: CanObjectSession
    objects: Objects
    now_ns: int = 0
    sent: list[Emission] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    @property
    def layout(self) -> Layout:
        return load(self.session.LAYOUT_FILE)

    def run(self, seconds: float) -> list[Emission]:
        """Advance; the frames that became due meanwhile."""
        before, end_ns = len(self.sent), self.now_ns + round(seconds * SECOND)
        while True:
            self._step()
            wakes = [self.session.next_deadline()]
            plan = self.session.next_plan()
            if plan is not None:
                wakes.append(plan.start_ns)
            wake = min((w for w in wakes if w is not None), default=end_ns)
            if wake >= end_ns:
                break
            self.now_ns = max(wake, self.now_ns + 1)
        self.now_ns = end_ns
        self._step()
        return self.sent[before:]

    def _step(self) -> None:
        self.session.advance(self.now_ns)
        plan = self.session.next_plan()
        if plan is not None and plan.start_ns <= self.now_ns:
            self.session.submit(replace(Scan.empty(plan), objects=tuple(self.objects(plan.start_ns))))
        self.sent += self.session.take_emissions(self.now_ns)
        self.events += self.session.take_events()

    def hear(self, text: str, *, link: int = 0) -> None:
        """A host's frame, written `200 B9 1F 40 00 08 8C 01 00`."""
        identifier, *data = text.split()
        self.session.receive(bytes.fromhex("".join(data)), self.now_ns, Address(link, int(identifier, 16)))
        self.events += self.session.take_events()

    def ask(self, text: str, seconds: float = 0.2) -> list[str]:
        """A host's frame and what follows on other identifiers than lists have, within some time."""
        self.hear(text)
        apart = LIST_MESSAGES | {"SensorVersion", "ErrorsWarnings"}
        return [line(emission) for emission in self.run(seconds) if emission.label not in apart]

    def dropped(self) -> list[DropReason]:
        """Reasons for which something went no further, so far."""
        return [event.reason for event in self.events if isinstance(event, Dropped)]


LIST_MESSAGES = frozenset(
    "ObjListHeader ObjGeneral ObjQuality ObjExtended ObjWarning ClusterListHeader ClusterGeneral ClusterQuality "
    "ListHeader ListTime ObjTrack1 ObjTrack2 ObjClassBox1 ObjBox2 ContourHeader ContourPoints ListTrailer "
    "DetectionCount Detection Detections FlaggedDetection".split()
)


def start(device: dict[str, Any], objects: Objects | Sequence[DetectedObject] = (), links: int = 1) -> Rig:
    """A device that has booted, its first frames still to come."""
    session = FAMILY.new_session(device, {})
    assert isinstance(session, CanObjectSession)
    for index in range(links):
        session.connected(0, Address(index, 0), LinkKind.CAN)
    rig = Rig(session, objects if callable(objects) else lambda _: objects)
    session.power_on(0)
    rig.now_ns = BOOT_NS
    return rig


def line(emission: Emission) -> str:
    """`60A 03 04 B0 10`."""
    assert emission.address is not None
    return " ".join([f"{emission.address.peer:03X}", emission.payload.hex(" ").upper()])


def lines(emissions: Sequence[Emission]) -> list[str]:
    return [line(emission) for emission in emissions]


def lists(emissions: Sequence[Emission], header: str = "ObjListHeader") -> list[list[Emission]]:
    """Frames grouped by the header that opens each list; what precedes the first header is left out."""
    found: list[list[Emission]] = []
    for emission in emissions:
        if emission.label == header:
            found.append([])
        if found and emission.label in LIST_MESSAGES:
            found[-1].append(emission)
    return found


def decoded(rig: Rig, emissions: Sequence[Emission], name: str) -> list[dict[str, float]]:
    """Physical values of all frames of one message."""
    return [rig.layout.decode(name, emission.payload) for emission in emissions if emission.label == name]
