"""The ego's own controllers on CAN: frames at their cycle, with the true motion by a DBC file.

Belongs here: when a frame leaves and what is in it. Not: the motion (world), keys of the scenario (scenario), the bus.

It is an `Instrument` without sweeps, so that clocks, links, recordings and counts are those of a sensor.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from emulator.scenario.vehicle_options import NAME, VehicleBus
from emulator.world.ego import EgoMotion, EgoState
from protocols.can_frame import EXTENDED
from protocols.can_objects.framing import CanFraming
from protocols.can_objects.layout import MessageLayout, SignalLayout, layout_of
from protocols.errors import ScanRefused
from protocols.scan import Scan, ScanPlan
from protocols.session import Address, Emission
from protocols.skeleton.session import EventSession

KM_H = 3.6
MPH = 3600.0 / 1609.344
STANDSTILL_M_S = 0.01
"Slower is neither forwards nor backwards."

Quantity = Callable[[EgoState], float]


def quantities(wheelbase_m: float, steering_ratio: float) -> Mapping[str, Quantity]:
    """What the sources of `vehicle_bus` are, in the unit of their names."""
    wheel = steering_ratio
    return {
        "speed_m_s": lambda ego: ego.speed_m_s,
        "speed_km_h": lambda ego: KM_H * ego.speed_m_s,
        "speed_mph": lambda ego: MPH * ego.speed_m_s,
        "speed_abs_m_s": lambda ego: abs(ego.speed_m_s),
        "speed_abs_km_h": lambda ego: KM_H * abs(ego.speed_m_s),
        "speed_abs_mph": lambda ego: MPH * abs(ego.speed_m_s),
        "direction": direction,
        "yaw_rate_deg_s": lambda ego: math.degrees(ego.yaw_rate_rad_s),
        "yaw_rate_rad_s": lambda ego: ego.yaw_rate_rad_s,
        "steering_deg": lambda ego: math.degrees(ego.steering_rad(wheelbase_m)),
        "steering_rad": lambda ego: ego.steering_rad(wheelbase_m),
        "steering_wheel_deg": lambda ego: wheel * math.degrees(ego.steering_rad(wheelbase_m)),
        "steering_wheel_rad": lambda ego: wheel * ego.steering_rad(wheelbase_m),
    }


def direction(ego: EgoState) -> float:
    """0 stands, 1 forwards, 2 backwards."""
    return 0.0 if abs(ego.speed_m_s) < STANDSTILL_M_S else 1.0 if ego.speed_m_s > 0.0 else 2.0


@dataclass(eq=False)
class _Cyclic:
    """One message on its way."""

    layout: MessageLayout
    peer: int
    cycle_ns: float
    offset_ns: int
    fixed: dict[str, int]
    "Raw values of constants, and of signals that nobody names."
    sources: dict[str, Quantity]
    counters: tuple[str, ...]
    sent: int = 0
    "Frames, skipped ones too: the place in the raster."
    first_ns: int = 0
    due_ns: int = 0

    def begin(self, now_ns: int) -> None:
        """The raster starts."""
        self.first_ns, self.sent = now_ns + self.offset_ns, 0
        self.due_ns = self.first_ns

    def pass_on(self) -> None:
        """To the next frame."""
        self.sent += 1
        self.due_ns = self.first_ns + round(self.sent * self.cycle_ns)


class VehicleSession(EventSession):
    """Sends; what it hears is not for it."""

    def __init__(self, options: VehicleBus, database: Any, ego: EgoMotion) -> None:
        """`database`: of cantools, judged by the scenario's checks."""
        super().__init__()
        self.ego = ego
        self._table = quantities(options.wheelbase_m or 0.0, options.steering_ratio or 0.0)
        self._messages = [self._cyclic(options, name, database) for name in options.messages]
        self.skipped: Counter[str] = Counter()
        "Frames by message that had no time: the process did not run."
        self.frames: Counter[str] = Counter()
        self.limited: Counter[str] = Counter()
        "Values beyond a signal's limits, by message.signal; the limit was sent."
        self.on_limited: Callable[[int, str, str], None] = lambda now_ns, on, text: None
        "Informed of the first one of each signal."
        self._state: tuple[int, EgoState] | None = None

    def _cyclic(self, options: VehicleBus, name: str, database: Any) -> _Cyclic:
        message, chosen = database.get_message_by_name(name), options.messages[name]
        layout = layout_of(message)
        fixed: dict[str, int] = {}
        for signal in message.signals:
            raw = signal.raw_initial
            fixed[signal.name] = int(raw) if raw is not None else 0
        sources, counters = {}, []
        for key, value in chosen.signals.items():
            if value == "counter":
                counters.append(key)
            elif isinstance(value, str):
                sources[key] = self._table[value]
            else:
                fixed[key] = layout.signals[key].quantise_one(float(value))
        cycle_ms = float(chosen.cycle_ms or message.cycle_time)
        peer = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        return _Cyclic(layout, peer, cycle_ms * 1e6, round(chosen.offset_ms * 1e6), fixed, sources, tuple(counters))

    @property
    def messages(self) -> Mapping[str, MessageLayout]:
        """Those that it sends, by their names."""
        return {one.layout.name: one.layout for one in self._messages}

    def framing(self, session: object, kind: object) -> CanFraming:
        """Of its frames, for faults that change them."""
        return CanFraming(self, None, {name for one in self._messages for name in one.counters})

    # ------------------------------------------------------------ a session

    def power_on(self, now_ns: int) -> None:
        """From here on messages have their instants."""
        for one in self._messages:
            one.begin(now_ns)

    def receive(self, data: bytes, now_ns: int, address: Address | None = None) -> None:
        """Frames of others are not for it."""

    def advance(self, now_ns: int) -> None:
        """Nothing happens in it but frames that are due."""
        self._now_ns = max(self._now_ns, now_ns)

    def next_deadline(self) -> int | None:
        """Of the next frame."""
        return min(one.due_ns for one in self._messages)

    def next_plan(self) -> ScanPlan | None:
        """It measures nothing."""
        return None

    def submit(self, scan: Scan) -> None:
        """It has asked for none."""
        raise ScanRefused("a vehicle measures nothing")

    def take_emissions(self, now_ns: int) -> list[Emission]:
        """Frames due by now, each with the motion at its own instant; those a whole cycle late are skipped."""
        found = []
        while (one := min(self._messages, key=lambda message: message.due_ns)).due_ns <= now_ns:
            due_ns = one.due_ns
            one.pass_on()
            if one.due_ns <= now_ns:
                self.skipped[one.layout.name] += 1
                continue
            found.append(Emission(due_ns, self._payload(one, due_ns), Address(0, one.peer), label=one.layout.name))
        return found

    def account(self) -> dict[str, object]:
        """Frames sent, skipped, and values limited."""
        return {"frames": dict(self.frames), "skipped": dict(self.skipped), "limited": dict(self.limited)}

    # ------------------------------------------------------------ what is in a frame

    def _payload(self, one: _Cyclic, due_ns: int) -> bytes:
        name = one.layout.name
        raw = dict(one.fixed)
        if one.sources:
            ego = self._at(due_ns)
            for key, quantity in one.sources.items():
                raw[key] = self._raw(f"{name}.{key}", one.layout.signals[key], quantity(ego), due_ns)
        for key in one.counters:
            raw[key] = self.frames[name] % (one.layout.signals[key].raw_max + 1)
        self.frames[name] += 1
        return one.layout.frame(raw)

    def _at(self, due_ns: int) -> EgoState:
        if self._state is None or self._state[0] != due_ns:
            self._state = due_ns, self.ego.at(due_ns)
        return self._state[1]

    def _raw(self, label: str, layout: SignalLayout, value: float, now_ns: int) -> int:
        """The nearest raw value; the limit for what lies outside, reported once."""
        raw = layout.quantise_one(value)
        exact = (value - layout.offset) / layout.scale
        if not layout.raw_min - 0.5 <= exact <= layout.raw_max + 0.5:
            self.limited[label] += 1
            if self.limited[label] == 1:
                limit = raw * layout.scale + layout.offset
                text = f"{label}: {value:.6g} is beyond the signal's limits; {limit:.6g} is sent"
                self.on_limited(now_ns, NAME, text)
        return raw
