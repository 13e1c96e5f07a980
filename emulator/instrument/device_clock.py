"""A sensor's `clock` table put to work: its session with the time, the quartz and the counters that the table wants.

Belongs here: which key a family can follow. Not: the table (clock_options), the clocks themselves (protocols).
"""

from __future__ import annotations

from emulator.scenario.clock_options import ClockOptions
from protocols.device_clock import DeviceClock, Knot, ns_of_ticks
from protocols.errors import DeviceSettingError
from protocols.quartz import Quartz
from protocols.session import Session
from protocols.timebase import Timebase, seconds_ns


def with_clock(session: Session, options: ClockOptions | None) -> Session:
    """The session, switched off, with that clock. Raises `DeviceSettingError` for what its wire cannot tell."""
    if options is None:
        return session
    _judge(session, options)
    ppb = round(1000.0 * options.drift_ppm)
    quartz = Quartz().at_rate(0, ppb) if options.drives == "schedule" else Quartz()
    before = session.clock
    begin_ns = before.begin_ns
    if options.start_ticks is not None and session.clock_tick_ns is not None:
        begin_ns = ns_of_ticks(options.start_ticks, session.clock_tick_ns)
    begin_ns += seconds_ns(options.offset_s)
    own_ppb = before.ppb(0) + (ppb if options.drives == "stamps" else 0)
    clock = DeviceClock(begin_ns, options.power_cycle == "runs_on", origin=Knot(0, begin_ns, own_ppb))
    for step in options.steps:
        clock = clock.stepped(quartz.own_ns(seconds_ns(step.t_s)), seconds_ns(step.by_s))
    session.clock = clock
    if options.start_count is not None:
        session.first_count = options.start_count
    return session if quartz == Quartz() else Timebase(session, quartz)


def _judge(session: Session, options: ClockOptions) -> None:
    if session.clock_tick_ns is None:
        for key in ("offset_s", "start_ticks", "steps"):
            if getattr(options, key):
                raise DeviceSettingError(key, getattr(options, key), "no such key: this device reports no time")
        if options.drift_ppm and options.drives == "stamps":
            raise DeviceSettingError("drives", "stamps", "schedule: this device reports no time")
    elif options.start_ticks is not None and options.start_ticks >> session.clock_bits:
        raise DeviceSettingError(
            "start_ticks", options.start_ticks, f"0..{(1 << session.clock_bits) - 1}, {session.clock_bits} bits"
        )
    if options.start_count is not None and options.start_count >> session.count_bits:
        allowed = (
            f"0..{(1 << session.count_bits) - 1}" if session.count_bits else "no such key: this device has no counter"
        )
        raise DeviceSettingError("start_count", options.start_count, allowed)
