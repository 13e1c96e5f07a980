"""Which revolutions are to be measured, which were, and the contents of their profiles.

The device measures a revolution only if a host has requested its profile. Revolutions are counted from the head's
origin, so that a late scan never shifts the next one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from protocols.errors import ScanRefused
from protocols.ld.device import Device, Geometry
from protocols.ld.head import SECOND_NS, Rotation
from protocols.ld.profiles import Field, Layout, Revolution, Words, distance_words, echo_words, layout
from protocols.ld.sectors import TICKS
from protocols.scan import DAZZLED, Floats, Scan, ScanPlan
from protocols.skeleton.wanted import Wanted

MAX_AHEAD = 4
"Revolutions that may be measured before the first of them has ended."

MAX_LAYOUTS = 16
"Formats of which the layout is kept; hosts use one or two."


@dataclass(frozen=True)
class Need:
    """What one host still wants."""

    first_ns: int
    left: int | None
    "None: no end."
    echoes: bool


@dataclass(frozen=True, eq=False)
class Measured:
    """A revolution whose scan has come."""

    sweep: int
    revolution: int
    start_ns: int
    end_ns: int
    distances: Words
    echoes: Words | None


class Outstanding(NamedTuple):
    """What the plan given out last is for."""

    revolution: int
    end_ns: int


class Revolutions:
    """Plans and scans while the device is in MEASURE."""

    def __init__(self) -> None:
        self._wanted: Wanted[Outstanding] = Wanted()
        self.measured: deque[Measured] = deque()
        self.late = range(0)
        "Revolutions that passed without being measured, since last asked."
        self.stream = 0
        "Number of the stream: from when a host wants profiles until none does, or the settings change."
        self._next = 0
        self._rested = False
        "No host wanted a profile for a while."
        self._layouts: dict[int, Layout] = {}

    def begin(self) -> list[int]:
        """Settings have changed: nothing planned or measured so far counts any more; the sweeps that this costs."""
        gone = [item.sweep for item in self.measured]
        self.stream += 1
        self.measured.clear()
        self._wanted.renew()
        self._layouts.clear()
        self._next = 0
        return gone

    def rethink(self, now_ns: int) -> None:
        """A host requests more of a revolution than was planned: plan those again that have not begun."""
        self._wanted.renew()
        while self.measured and self.measured[-1].start_ns >= now_ns:
            self._next = self.measured.pop().revolution

    def next_end_ns(self) -> int | None:
        """When the next measured revolution has ended."""
        return self.measured[0].end_ns if self.measured else None

    def ended(self, now_ns: int) -> Iterator[Measured]:
        """Take the measured revolutions that have ended."""
        while self.measured and self.measured[0].end_ns <= now_ns:
            yield self.measured.popleft()

    def lacks_echoes(self) -> bool:
        """Whether something planned or measured comes without amplitudes."""
        planned = self._wanted.plan is not None and not self._wanted.plan.wants_intensity
        return planned or any(item.echoes is None for item in self.measured)

    def plan(self, device: Device, needs: Sequence[Need], now_ns: int) -> ScanPlan | None:
        """The revolution wanted next, the same until its scan comes."""
        geometry, rotation = device.geometry, device.rotation
        if geometry is None or rotation is None or not needs or len(self.measured) >= MAX_AHEAD:
            self._wanted.forget()
            if not needs:
                self._rested = True
            return None
        if self._wanted.plan is None:
            self._choose(geometry, rotation, needs, device.model.max_range_m, now_ns)
        return self._wanted.plan

    def _choose(
        self, geometry: Geometry, rotation: Rotation, needs: Sequence[Need], max_range_m: float, now_ns: int
    ) -> None:
        wanted = [
            rotation.first_from(need.first_ns, geometry.first)
            for need in needs
            if need.left is None or need.left > sum(item.start_ns >= need.first_ns for item in self.measured)
        ]
        if not wanted:
            return
        # one that has ended already is passed over: a device that cannot keep up skips, it does not lag
        running = rotation.first_from(now_ns + 1, geometry.first) - 1
        due = max(self._next, min(wanted))
        if self._rested or due > self._next:  # what nobody wanted in between is no gap in a stream
            self.stream += 1
            self._rested = False
        revolution = max(due, running)
        self.late = range(due, revolution)
        start_ns = rotation.passes_ns(revolution, geometry.first)
        slowed, offsets_s = rotation.slowed(start_ns), geometry.fire_offset_s
        plan = ScanPlan(
            epoch=self._wanted.epoch,
            sweep=rotation.first_sweep + revolution,
            start_ns=start_ns,
            azimuth_rad=geometry.azimuth_rad,
            elevation_rad=geometry.elevation_rad,
            fire_offset_s=offsets_s if slowed == 1.0 else offsets_s * slowed,
            duration_s=slowed / rotation.hz,
            max_echoes=2 if geometry.near_field_m else 1,
            max_range_m=max_range_m,
            wants_intensity=any(need.echoes for need in needs),
            stream=self.stream,
            period_ns=round(SECOND_NS * slowed / rotation.hz),
        )
        self._wanted.ask(plan, Outstanding(revolution, rotation.passes_ns(revolution + 1, geometry.first)))

    def submit(self, scan: Scan, geometry: Geometry | None, max_range_m: float) -> None:
        """Take the scan of the plan given out; `ScanRefused` for any other."""
        plan = scan.plan
        asked = self._wanted.expect(plan, len(scan.range_m))
        if geometry is None:
            raise ScanRefused(f"sweep {plan.sweep}: the device measures no more")
        range_m, intensity = _reported(scan, geometry.near_field_m)
        distances = distance_words(range_m, max_range_m)
        echoes = echo_words(intensity, distances) if plan.wants_intensity else None
        self.measured.append(Measured(plan.sweep, asked.revolution, plan.start_ns, asked.end_ns, distances, echoes))
        self._next = asked.revolution + 1
        self._wanted.forget()

    def give_up(self, plan: ScanPlan) -> None:
        """The plan given out will not be measured; `ScanRefused` for any other. What has ended by then is late."""
        self._next = self._wanted.expect(plan).revolution
        self._wanted.renew()

    def layout(self, form: int, geometry: Geometry) -> Layout:
        """The layout of a format under the present geometry."""
        found = self._layouts.get(form)
        if found is None:
            if len(self._layouts) >= MAX_LAYOUTS:
                self._layouts.clear()
            found = self._layouts[form] = layout(form, geometry.sectors, geometry.step)
        return found


def wants_echoes(form: int) -> bool:
    """Whether a format holds amplitudes."""
    return bool(form & Field.ECHO)


def _reported(scan: Scan, near_field_m: float) -> tuple[Floats, Floats]:
    """Range and intensity of the one echo a beam that the device reports: the nearest, behind the suppressed field."""
    range_m, intensity = scan.range_m[:, 0], scan.intensity[:, 0]
    if near_field_m:
        shown = scan.range_m >= near_field_m
        column = np.argmax(shown, axis=1)
        beam = np.arange(len(column))
        range_m = np.where(shown[beam, column], scan.range_m[beam, column], np.nan)
        intensity = scan.intensity[beam, column]
    if scan.flags.any():
        range_m = np.where(scan.flags & DAZZLED, np.nan, range_m)
    return range_m, intensity


def revolution_of(
    item: Measured, device: Device, geometry: Geometry, rotation: Rotation, first_count: int = 0
) -> Revolution:
    """What all profiles of a measured revolution have in common."""
    rate = TICKS * rotation.hz

    def clock(ticks: int) -> int:
        after_ns = (ticks * SECOND_NS + rate // 2) // rate
        if not rotation.motor.is_true:
            after_ns = round(after_ns * rotation.slowed(item.start_ns))
        return device.clock_ms(item.start_ns + after_ns) & 0xFFFF

    return Revolution(
        count=(item.sweep + first_count) & 0xFFFF,
        distances=item.distances,
        echoes=item.echoes,
        start_ms=[clock(span.offset) for span in geometry.sectors],
        end_ms=[clock(span.offset + span.length) for span in geometry.sectors],
        status=device.status,
    )
