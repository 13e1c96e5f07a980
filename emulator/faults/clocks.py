"""Faults of the device clock: it jumps, drifts, stops, restarts.

The truth goes into recordings beside what is reported, see docs/clocks.md. Not: a scenario's `clock` table
(device_clock).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from emulator.faults.acts import Act, Gear
from emulator.faults.config import Common
from emulator.faults.kinds import Keys, Kind, Target
from protocols.device_clock import DeviceClock
from protocols.timebase import change_clock, pace, seconds_ns


class ClockStep(Keys):
    """The clock jumps."""

    by_s: Annotated[float, Field(ge=-1e9, le=1e9)] = -0.5
    "Forward; negative: back."
    returns: bool = False
    "At the end of the fault it jumps back by as much."


class ClockDrift(Keys):
    """The quartz is off."""

    ppm: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] = 500.0
    "Too fast, beyond what the scenario's `clock` table says; to a thousandth."
    drives: Literal["schedule", "stamps"] = "schedule"
    "schedule: motor, cycles and delays follow the quartz; stamps: only the time it reports does."


class ClockReset(Keys):
    """The clock begins again, the device goes on."""

    to_s: Annotated[float, Field(ge=0.0, le=1e10)] | None = None
    "What it shows then; none: what it shows at power-on."


class Step(Act):
    """One jump, and the way back if it is wanted."""

    def __init__(self, keys: Any, gear: Gear) -> None:
        super().__init__(gear)
        self._by_ns, self._returns = seconds_ns(keys.by_s), keys.returns

    def _jump(self, now_ns: int, by_ns: int) -> None:
        change_clock(self.gear.session, now_ns, lambda clock, own_ns: clock.stepped(own_ns, by_ns))

    def begin(self, now_ns: int) -> None:
        self._jump(now_ns, self._by_ns)
        self.gear.hit(now_ns)

    def end(self, now_ns: int) -> None:
        if self._returns:
            self._jump(now_ns, -self._by_ns)


class Drift(Act):
    """Another rate while it holds. What has been gained or lost by then stays."""

    def __init__(self, keys: Any, gear: Gear) -> None:
        super().__init__(gear)
        self._ppb, self._schedule = round(1000.0 * keys.ppm), keys.drives == "schedule"

    def _turn(self, now_ns: int, ppb: int) -> None:
        instrument = self.gear.instrument
        if self._schedule:
            instrument.session = pace(instrument.session, now_ns, ppb)
        else:
            change_clock(
                instrument.session, now_ns, lambda clock, own_ns: clock.at_rate(own_ns, clock.ppb(own_ns) + ppb)
            )

    def begin(self, now_ns: int) -> None:
        self._turn(now_ns, self._ppb)
        self.gear.hit(now_ns)

    def end(self, now_ns: int) -> None:
        self._turn(now_ns, -self._ppb)


class Stop(Act):
    """It stands while the fault holds, then goes on from there."""

    def begin(self, now_ns: int) -> None:
        change_clock(self.gear.session, now_ns, DeviceClock.stopped)
        self.gear.hit(now_ns)

    def end(self, now_ns: int) -> None:
        change_clock(self.gear.session, now_ns, DeviceClock.going)


class Reset(Act):
    """It begins again."""

    def __init__(self, keys: Any, gear: Gear) -> None:
        super().__init__(gear)
        self._to_ns = None if keys.to_s is None else seconds_ns(keys.to_s)

    def begin(self, now_ns: int) -> None:
        to_ns = self._to_ns
        change_clock(
            self.gear.session,
            now_ns,
            lambda clock, own_ns: clock.set_to(own_ns, clock.begin_ns if to_ns is None else to_ns),
        )
        self.gear.hit(now_ns)


REPORTING = "a device that reports a time: an LMS2xx, LD, LD-MRS, ESR or Vu8"


def _reports_time(keys: Any, common: Common, target: Target) -> str | None:
    """A radar without stamps can only have its schedule drift."""
    named = {**(target.facts or {}), **(target.device or {})}
    if named.get("format") == "ars408" and getattr(keys, "drives", "stamps") == "stamps":
        return f"{target.model} reports no time; want {REPORTING}"
    return None


def _kind(name: str, keys: type[Keys], summary: str, ends: str, act: Any) -> Kind:
    return Kind(name, "clock", summary, ends, keys, act=act, lasts="state", check=_reports_time)


KINDS: tuple[Kind, ...] = (
    _kind("clock_step", ClockStep, "Time stamps jump once.", "They continue so, or jump back with `returns`.", Step),
    _kind("clock_drift", ClockDrift, "Time stamps and schedule drift away from the host's time.",
          "They keep the offset reached.", Drift),
    _kind("clock_stop", Keys, "Every telegram has the same time stamp.", "The clock continues from where it stopped.",
          lambda keys, gear: Stop(gear)),
    _kind("clock_reset", ClockReset, "Time stamps restart although the device has not restarted.",
          "They continue from there.", Reset),
)  # fmt: skip
