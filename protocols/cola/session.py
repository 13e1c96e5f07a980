"""One CoLa device: requests of several hosts in either dialect, each with its answer, scans to subscribers.

Belongs here: the device's state over time, and what goes to whom. Not: what names mean (commands), layouts (scandata).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from protocols.cola import filters, login
from protocols.cola.commands import (
    EVENTS,
    METHODS,
    VARIABLES,
    Method,
    Sfa,
    Variable,
    codes,
    default_passwords,
    refusal,
)
from protocols.cola.framing import ColaSplitter, frame
from protocols.cola.models import Pair
from protocols.cola.scandata import Body, Content, Header, content_of
from protocols.cola.settings import CLASSIC, Settings
from protocols.cola.values import ASCII, BINARY, Code, Rejected, decode, encode
from protocols.cola.watching import Watching
from protocols.device_clock import Told
from protocols.scan import Scan
from protocols.session import Address, DropReason, Emission, LinkKind
from protocols.skeleton.instants import SECOND_NS, Raster, earliest
from protocols.skeleton.outbox import Outgoing
from protocols.skeleton.requests import Answer, Command, Refused, Request, RequestSession
from protocols.skeleton.sweeps import Sweep

TICK_NS = Fraction(1000)
SPIN_UP_SHARES = (0.2, 0.5, 0.8)
"Of the time until it measures: STlms says motor start, then rotating, in preparation, ready."
NO_NETWORK_NS = SECOND_NS
"A device that has just been switched on has no network yet; at most half of the time until it measures."
POLLED_NS = 2 * SECOND_NS
"So long after a poll the device goes on measuring for the next one."
STARTED_NS = 20 * SECOND_NS
"The same after LMCstartmeas: MRPT waits ten seconds before its first poll."
IMU_NS = 10_000_000
ANSWERS = {b"sRN": b"sRA", b"sRI": b"sRA", b"sWN": b"sWA", b"sMN": b"sAN", b"sEN": b"sEA"}
UNKNOWN = {b"sRN": Code.VARIABLE_UNKNOWN, b"sWN": Code.VARIABLE_UNKNOWN, b"sMN": Code.METHOD_UNKNOWN,
           b"sEN": Code.EVENT_UNKNOWN}  # fmt: skip
EPOCH, LATEST_US = datetime(1970, 1, 1), 4_102_444_800_000_000
"The calendar ends with 2099."
POLL, WATCH = Address(-1, 0), Address(-1, 1)
"Not hosts, but reasons to measure: polls, and fields."

Host = Address | None


@dataclass(frozen=True)
class Shape:
    """One turn of the mirror at the present settings."""

    sweep: Sweep
    sent: slice
    "Of the beams measured, those in a telegram."
    start: int
    step: int
    "Of these, as the telegram has it."


@dataclass
class Held:
    """A scan that has been measured, for hosts that subscribe before it leaves, and the last one for polls."""

    start_ns: int
    due_ns: int
    body: Body
    told: Told
    sweep: int
    stream: int | None
    sent: bool
    "To anybody."


class ColaSession(RequestSession):
    """One device."""

    clock_tick_ns = TICK_NS
    clock_bits = 32
    count_bits = 16
    REPLY_NS: ClassVar[int] = 2_000_000

    def __init__(self, settings: Settings) -> None:
        model = settings.model
        ready_ns = round(1e9 * settings.ready_s)
        super().__init__(min(NO_NETWORK_NS, ready_ns // 2), model.telegram_ns(settings.pair))
        self.settings = settings
        self._kept: tuple[dict[str, Any], dict[int, int], Pair] = self._delivered()
        "What mEEwriteall has stored: variables, passwords, scan configuration."
        self.values, self.passwords, self.pair = self._delivered()
        self.power_ups = settings.power_ups
        self.window = 1.0
        self._first_power_ns: int | None = None
        self._chain = filters.Chain()
        self._watching = Watching(model.fields)
        self._challenges = 0
        self._reset_state(0)

    def _delivered(self) -> tuple[dict[str, Any], dict[int, int], Pair]:
        settings = self.settings
        values = {
            name: one.factory(settings)
            for name, one in VARIABLES.items()
            if one.factory is not None and one.on(settings.model)
        }
        return values, default_passwords(settings), settings.pair

    def _reset_state(self, now_ns: int) -> None:
        self._began_ns, self._up_ns = now_ns, now_ns + round(1e9 * self.settings.ready_s)
        self._measuring, self._motor_stopped, self._cold = True, False, True
        self._levels: dict[Host, int] = {}
        self._dialects: dict[Host, bytes] = {}
        self._listeners: dict[str, set[Host]] = {name: set() for name in EVENTS}
        self._asking: dict[Host, bytes] = {}
        self._asked: dict[Host, bytes] = {}
        "Challenges that wait for their response."
        self._held: deque[Held] = deque()
        self._poll_until_ns = 0
        self._telegrams_made = 0
        self._date_us: int | None = None
        "Date less device time, in microseconds since 1970; None: it has not been set."
        self._shapes: dict[tuple[int, int], Shape] = {}
        self._line_free_ns: dict[int, int] = {}
        self._imu_goes = False
        self._chain.clear()
        self._watching.clear()

    # power

    def power_on(self, now_ns: int) -> None:
        """What was not stored is lost; for a while without network, measuring later."""
        self.power_ups += 1
        super().power_on(now_ns)

    def _reset(self, now_ns: int) -> None:
        values, passwords, self.pair = self._kept
        self.values, self.passwords = dict(values), dict(passwords)
        if self._first_power_ns is None:
            self._first_power_ns = now_ns
        self._nominal_ns = self.settings.model.telegram_ns(self.pair)
        self._reset_state(now_ns)
        if self.settings.model.serial_line:
            self._outbox.send(Emission(now_ns, b"", line_speed=self.settings.serial_baud, label="power-on"))
        self._events.mode(now_ns, "starting")

    def _start(self, now_ns: int) -> None:
        self._raster = Raster(self._up_ns, self._raster.period_ns)
        self._watch_or_not(now_ns)
        self._events.mode(now_ns, "measuring")

    def store(self) -> None:
        """Everything survives the next power-off."""
        self._kept = dict(self.values), dict(self.passwords), self.pair

    def forget(self, now_ns: int) -> None:
        """As delivered; what is stored stays until the next `store`."""
        self.values, self.passwords, pair = self._delivered()
        self.reconfigure(pair, now_ns)
        self.rearrange(now_ns)

    # state

    def state(self, now_ns: int) -> int:
        """SCdevicestate."""
        if self._motor_stopped or self.contamination()[1]:
            return 2
        if now_ns < self._up_ns or (self.settings.old and any(self._levels.values())):
            return 0
        return self.settings.model.usable_state

    def status(self, now_ns: int) -> list[Any]:
        """STlms."""
        phase = 7
        if not self._measuring or self._motor_stopped:
            phase = 3
        elif now_ns < self._up_ns:
            share = (now_ns - self._began_ns) / max(1, self._up_ns - self._began_ns)
            phase = (1 if self._cold else 4, 4, 5, 6)[sum(share >= one for one in SPIN_UP_SHARES)]
        year, month, day, hour, minute, second, _ = self.date(now_ns)
        return [phase, 0, f"{hour:02}:{minute:02}:{second:02}", f"{day:02}.{month:02}.{year % 100:02}", 0, 0, 0]

    def contamination(self) -> list[int]:
        """Warning and error of the window."""
        return [int(self.window < 0.7), int(self.window < 0.4)]

    def hours(self, now_ns: int) -> int:
        """Operating hours, in 0.1 h."""
        return self.settings.hours + (now_ns - (self._first_power_ns or 0)) // (360 * SECOND_NS)

    def celsius(self, now_ns: int) -> float:
        """Inside the housing: from 25 deg towards 35 in half an hour."""
        return 35.0 - 10.0 * float(np.exp((self._began_ns - now_ns) / (600.0 * SECOND_NS)))

    def ident(self) -> list[str]:
        """Name and version."""
        return [self.settings.model.ident, self.settings.firmware]

    def date(self, at_ns: int) -> tuple[int, ...]:
        """Year to second, and microseconds: from 1970 on since power-on, unless it was set, or has an NTP server."""
        if self.values["TSCRole"] == [1] and self.settings.ntp_epoch_s:
            micro = round(self.settings.ntp_epoch_s * 1e6) + at_ns // 1000
        else:
            micro = self.clock.shown_ns(at_ns) // 1000 + (self._date_us or 0)
        date = EPOCH + timedelta(microseconds=min(max(0, micro), LATEST_US))
        return (*date.timetuple()[:6], date.microsecond)

    def set_date(self, micro: int, now_ns: int) -> None:
        """The device's calendar says so many microseconds since 1970 now."""
        self._date_us = micro - self.clock.shown_ns(now_ns) // 1000

    def impair(self, now_ns: int, what: str, degree: float) -> bool:
        """The window, and the motor of the mirror."""
        self.advance(now_ns)
        if what == "window":
            self.window = degree
        elif what == "motor stopped":
            self._motor_stopped = degree != 0.0
            if self._running:
                self.rearrange(now_ns)
        elif what == "motor status":
            self._motor_wrong = degree != 0.0
        else:
            return super().impair(now_ns, what, degree)
        return True

    _motor_wrong = False

    # measuring

    def start_measuring(self, now_ns: int) -> None:
        """The mirror turns; one that turned goes on. A driver may poll soon: scans are measured for it."""
        if not self._still or not self._measuring:
            self._poll_until_ns = max(self._poll_until_ns, now_ns + STARTED_NS)
            self._subscribe(now_ns, POLL)
        if not self._measuring:
            self._measuring = True
            self._pause(now_ns)

    def stop_measuring(self, now_ns: int) -> None:
        """No scans until it is started again."""
        if self._measuring:
            self._measuring = False
            self.rearrange(now_ns)

    def reconfigure(self, pair: Pair, now_ns: int) -> None:
        """Another frequency or step, after a pause."""
        if pair == self.pair:
            return
        self.pair = pair
        model = self.settings.model
        if model.series in ("lms1", "lms5"):  # the step is that of the scans, the limits stay
            ((_, first, last),) = self.values["LMPoutputRange"][0]
            self.values["LMPoutputRange"] = [[[pair[1], first, last]]]
        self._nominal_ns = model.telegram_ns(pair)
        self._pause(now_ns)

    def _pause(self, now_ns: int) -> None:
        self._cold = self._cold and now_ns < self._up_ns
        self._began_ns, self._up_ns = now_ns, max(self._up_ns, now_ns + round(1e9 * self.settings.change_s))
        self.rearrange(now_ns)

    def rearrange(self, now_ns: int) -> None:
        """Something that scans depend on has changed: those of before are withdrawn."""
        self._shapes.clear()
        self._chain.clear()
        self._watching.clear()
        self._give_up_held(now_ns)
        self._change(now_ns)
        if now_ns < self._up_ns:
            self._raster = Raster(self._up_ns, self._nominal_ns * self._slowed, self._next)
        self._watch_or_not(now_ns)

    def _watch_or_not(self, now_ns: int) -> None:
        self._watching.use(self.values, self.settings.model.fields)
        if self._watching.active:
            self._subscribe(now_ns, WATCH)
        else:
            self._unsubscribe(now_ns, WATCH)

    @property
    def _still(self) -> bool:
        quiet = self.settings.quiet_login and any(self._levels.values())
        return not self._measuring or self._motor_stopped or quiet

    def next_plan(self) -> Any:
        """The sweep wanted next; None while it does not measure."""
        return None if self._running and self._still else super().next_plan()

    @property
    def content(self) -> Content:
        """LMDscandatacfg."""
        return content_of(self.values["LMDscandatacfg"])

    def _filters(self) -> filters.Filters:
        values = self.values
        usual = [filters.ALL if self.content.channels & 0b11110 else filters.FIRST]
        particle, threshold = values["LFPparticle"]
        mean = values.get("LFPmeanfilter", [0, 1, 0])
        return filters.Filters(
            echo=values.get("FREchoFilter", usual)[0],
            fog=self.settings.fog,
            particle_m=threshold / 1000.0 if particle else None,
            median=values.get("LFPmedianfilter", [0])[0] == 1,
            mean=mean[1] if mean[0] else 1,
        )

    def _echoes(self) -> int:
        """In a telegram."""
        bits = self.content.channels.bit_count() if self._filters().echo == filters.ALL else 1
        return min(bits, self.settings.model.echoes)

    def _shape(self, number: int) -> Shape:
        model = self.settings.model
        starts = model.starts(self.pair)
        key = number // model.layers % len(starts), number % model.layers
        if key not in self._shapes:
            self._shapes[key] = self._new_shape(starts[key[0]], model.layers_cdeg[key[1]])
        return self._shapes[key]

    def _new_shape(self, start: int, layer_cdeg: int) -> Shape:
        model, coarse, scale = self.settings.model, self.settings.model.coarse(self.pair), self._scale
        count = model.points(self.pair) if model.series == "mrs" else int((model.stop - start) / coarse) + 1
        ((step, first, last),) = self.values["LMPoutputRange"][0]
        low, high = (min(max(round((edge - start) / coarse), 0), count - 1) for edge in (first, last))
        # a TiM thins its points out by the step written here; an LMS ignores it, as drivers write an old one
        every = max(1, round(step / coarse)) if model.series == "tim" else 1
        sent = slice(low, high + 1, every)
        beams = np.arange(count)
        if not self._watching.active:
            beams, sent = beams[sent], slice(None)
        filtered = self._filters()
        plain = filtered.echo == filters.FIRST and not filtered.fog
        sweep = Sweep(
            azimuth_rad=np.radians((start + beams * float(coarse)) / 1e4 - 90.0),
            elevation_rad=np.full(len(beams), np.radians(-layer_cdeg / 100.0)),
            fire_offset_s=beams.astype(np.float64) * (1e-9 * float(model.beam_ns(self.pair))),
            duration_s=1e-9 * count * float(model.beam_ns(self.pair)),
            max_range_m=65.535 * scale,
            max_echoes=1 if plain else model.echoes,
            wants_intensity=self.content.remission or filtered.fog,
        )
        return Shape(sweep, sent, round(start + low * coarse), round(coarse * every))

    @property
    def _scale(self) -> float:
        found: float = self.values.get("LMDscandatascalefactor", [1.0])[0]
        return found

    def _sweep(self, number: int) -> Sweep:
        return self._shape(number).sweep

    def _kept_back(self, number: int) -> bool:
        """A telegram that is not sent: of a layer switched off, or between those that the output interval leaves."""
        layers = self.settings.model.layers
        on = self.values.get("ScanLayerFilter", [[[1]] * layers])[0]
        return on[number % layers] == [0] or number // layers % self.content.interval != 0

    def _passed_over(self, number: int) -> int:
        if self._watching.active:
            return 0
        layers, interval = self.settings.model.layers, self.content.interval
        behind = -(number // layers) % interval
        found = number if not behind else (number // layers + behind) * layers
        while self._kept_back(found):  # layers that are switched off
            found += 1 if (found + 1) % layers else 1 + (interval - 1) * layers
        return found - number

    def _telegrams(self, scan: Scan) -> list[Any]:
        raise AssertionError("dialects differ from host to host: see submit")

    def submit(self, scan: Scan) -> None:
        """Take the scan of `next_plan`; `ScanRefused` for any other."""
        plan = scan.plan
        self._wanted.expect(plan, len(scan.range_m))
        self._wanted.forget()
        self._next = plan.sweep + 1
        model, shape = self.settings.model, self._shape(plan.sweep)
        end_ns = plan.start_ns + round(1e9 * plan.duration_s)
        turn_ns = plan.start_ns + round(model.turn_ns(self.pair) * self._slowed)
        sent_ns = model.transmission_ns + (turn_ns if model.series in ("lms1", "lms5") else end_ns)
        self._watching.see(scan, end_ns)
        numbers = range(plan.sweep, plan.sweep + 1)
        found = self._chain.add(_cut(scan, shape.sent), self._filters(), plan.sweep % model.layers)
        takers = [
            one for one, since_ns in self._hosts.items() if one not in (POLL, WATCH) and since_ns <= plan.start_ns
        ]
        if found is None or self._kept_back(plan.sweep):
            self._events.unsent(self._now_ns, DropReason.KEPT, numbers, "", plan.stream)
            return
        told = self.clock.told(end_ns if model.stamps_end else plan.start_ns, TICK_NS, 32)
        body = self._body(plan.sweep, found, shape, told, sent_ns)
        held = Held(plan.start_ns, sent_ns, body, told, plan.sweep, plan.stream, False)
        self._let_go(self._now_ns)
        self._held.append(held)
        telegrams: dict[bytes, bytes] = {}
        for address in takers:
            self._send_scan(held, address, telegrams)

    def _send_scan(self, held: Held, address: Host, telegrams: dict[bytes, bytes]) -> None:
        """To one host; `telegrams`: those made already, by dialect."""
        dialect = self._dialects.get(address, ASCII)
        if dialect not in telegrams:
            telegrams[dialect] = _event(dialect, "LMDscandata", held.body.encoded(dialect))
        held.sent = True
        if self._line_takes(address, len(telegrams[dialect]), held.due_ns):
            one = Emission(held.due_ns, telegrams[dialect], address, held.sweep, None, "LMDscandata", held.told)
            self._outbox.put(Outgoing(address, deque([one]), is_scan=True))
        else:
            numbers = range(held.sweep, held.sweep + 1)
            self._events.unsent(self._now_ns, DropReason.LINE_BUSY, numbers, "", held.stream, address)

    def _line_takes(self, address: Host, size: int, due_ns: int) -> bool:
        """Whether a serial line has sent what came before."""
        if address is None or self._connections.kind(address) is not LinkKind.SERIAL:
            return True
        if self._line_free_ns.get(address.link, 0) > due_ns:
            return False
        self._line_free_ns[address.link] = due_ns + size * 10 * SECOND_NS // self.settings.serial_baud
        return True

    def _body(self, number: int, found: filters.Filtered, shape: Shape, told: Told, sent_ns: int) -> Body:
        settings, content = self.settings, self.content
        model = settings.model
        warned, failed = self.contamination()
        status = 1 if self._motor_wrong else 0 if model.series in ("tim", "mrs") else 4 * failed or 2 * warned
        header = Header(
            version=model.version,
            device=model.device_number,
            serial=settings.serial,
            status=status,
            telegrams=self.first_count + self._telegrams_made & 0xFFFF,
            scans=self.first_count + (self._telegrams_made if model.layers > 1 else number) & 0xFFFF,
            scan_us=told.ticks,
            sent_us=self.clock.ticks(sent_ns, TICK_NS, 32),
            inputs=0,
            outputs=8 if model.series == "tim" else self._watching.bits(),
            layer_cdeg=model.layers_cdeg[number % model.layers],
            frequencies=model.frequencies(self.pair),
        )
        self._telegrams_made += 1
        return Body(
            header, found.range_m, found.intensity, found.flags, shape.start, shape.step, self._scale,
            model.nearest_raw, content, self._echoes(),
            encoders=((0, 0),) if content.encoder and self.values.get("LICencset", [0]) != [0] else (),
            name=self.values["LocationName"][0],
            date=self.date(told.true_ns) if content.time and model.sends_time else None,
        )  # fmt: skip

    # polls

    def _poll(self, request: Request) -> Answer | Refused:
        if self._still or request.now_ns < self._up_ns:
            return refusal(Code.CONDITION_FAILED, DropReason.WRONG_MODE)
        self._poll_until_ns = max(self._poll_until_ns, request.now_ns + POLLED_NS)
        self._subscribe(request.now_ns, POLL)
        self._asking[request.address] = request.data[:1]
        self._let_go(request.now_ns)
        if self._held and self._held[0].due_ns <= request.now_ns:
            self._serve_polls(request.now_ns + self.REPLY_NS)
        return Answer(None)

    def _let_go(self, now_ns: int) -> None:
        """Of the scans that have ended keep the last."""
        while len(self._held) > 1 and self._held[1].due_ns <= now_ns:
            self._note_unsent(self._held.popleft(), now_ns)

    def _note_unsent(self, held: Held, now_ns: int) -> None:
        if not held.sent:
            self._events.unsent(now_ns, DropReason.KEPT, range(held.sweep, held.sweep + 1), "", held.stream)

    def _give_up_held(self, now_ns: int) -> None:
        while self._held:
            self._note_unsent(self._held.popleft(), now_ns)

    def _serve_polls(self, due_ns: int) -> None:
        held = self._held[0]
        for address, dialect in self._asking.items():
            payload = _named(dialect, b"sRA", b"LMDscandata", held.body.encoded(dialect))
            sweep, told = (None, None) if held.sent else (held.sweep, held.told)
            self._outbox.send(Emission(due_ns, frame(dialect, payload), address, sweep, None, "LMDscandata", told))
            held.sent = True
        self._asking.clear()

    # time

    def _next_instant(self) -> int | None:
        own = [super()._next_instant()]
        if self._running:
            own += [self._held[0].due_ns if self._asking and self._held else None, self._watching.next_ns()]
            own += [self._poll_until_ns if POLL in self._hosts else None]
        return earliest(own)

    def _happen(self, now_ns: int) -> None:
        due_ns = super()._next_instant()
        if due_ns is not None and due_ns <= now_ns:
            super()._happen(now_ns)
        if not self._running:
            return
        self._let_go(now_ns)
        if self._asking and self._held and self._held[0].due_ns <= now_ns:
            self._serve_polls(now_ns)
        if POLL in self._hosts and self._poll_until_ns <= now_ns:
            self._unsubscribe(now_ns, POLL)
            self._asking.clear()
        if self._watching.due(now_ns):
            self._send_event("LFErec", now_ns, (BINARY,))
            self._send_event("LIDoutputstate", now_ns)

    # fields

    def results(self, now_ns: int) -> list[Any]:
        """LFErec."""
        micro, date = self.clock.ticks(now_ns, TICK_NS, 32), list(self.date(now_ns))
        return self._watching.results(self.values, micro, date)

    def outputs(self, now_ns: int) -> list[Any]:
        """LIDoutputstate."""
        count = self.settings.model.outputs
        flat = [word for pair in self._watching.outputs(count) for word in pair]
        return [0, self.clock.ticks(now_ns, TICK_NS, 32), *flat, [list(self.date(now_ns))]]

    def inputs(self, now_ns: int) -> list[Any]:
        """LIDinputstate: nothing is wired to them."""
        return [0, self.clock.ticks(now_ns, TICK_NS, 32), 0, 0, 0, 0, [list(self.date(now_ns))]]

    def _send_event(self, name: str, now_ns: int, dialects: Sequence[bytes] = (ASCII, BINARY)) -> None:
        variable = VARIABLES[name]
        assert variable.live is not None
        values, text = variable.live(self, now_ns), variable.layout_of(self.settings.model)
        for address in sorted(self._listeners[name], key=str):
            dialect = self._dialects.get(address, ASCII)
            if dialect in dialects:
                self._outbox.send(
                    Emission(now_ns, _event(dialect, name, encode(text, dialect, values)), address, label=name)
                )

    def _send_imu(self, now_ns: int) -> None:
        values = [0.0, 0.0, 9.81, *[0.0] * 6, 1.0, 0.0, 0.0, 0.0]
        micro = self.clock.shown_ns(now_ns) // 1000
        stamp = micro.to_bytes(8, "big") if self.settings.wide_imu else (micro & 0xFFFFFFFF).to_bytes(4, "big")
        data = encode("f32 " * 13, BINARY, values) + stamp
        for address in sorted(self._listeners["InertialMeasurementUnit"], key=str):
            if self._dialects.get(address) == BINARY:
                label = "InertialMeasurementUnit"
                self._outbox.send(Emission(now_ns, _event(BINARY, label, data), address, label=label))

    # hosts

    def _unsubscribe(self, now_ns: int, address: Host) -> None:
        super()._unsubscribe(now_ns, address)
        if not self._hosts:
            self._give_up_held(now_ns)

    def disconnected(self, now_ns: int, address: Address) -> None:
        """A stream's host has gone: its subscriptions, polls and user level with it."""
        super().disconnected(now_ns, address)
        for one in (self._levels, self._dialects, self._asking, self._asked):
            one.pop(address, None)
        for listeners in self._listeners.values():
            listeners.discard(address)

    def log_in(self, level: int, request: Request) -> bool:
        """A host has that level from now on."""
        was_still = self._still
        self._levels[request.address] = level
        if self._still != was_still:
            self.rearrange(request.now_ns)
        return True

    def challenge(self, asked: bytes, request: Request) -> list[Any] | Sfa:
        """GetChallenge: version 1 without a level, version 2 with one and a salt."""
        if self.settings.login == CLASSIC:
            return refusal(Code.METHOD_UNKNOWN, DropReason.UNKNOWN_COMMAND)
        salted = self.settings.login == "challenge 2"
        if len(asked) != int(salted):
            return refusal(Code.TOO_LITTLE if salted else Code.TOO_MUCH)
        self._challenges += 1
        drawn = login.challenge_of(str(self.settings.serial), self._challenges, request.now_ns)
        self._asked[request.address] = drawn
        return [0, drawn + (self._salt if salted else b"")]

    @property
    def _salt(self) -> bytes:
        return login.challenge_of(str(self.settings.serial), 0, 0) if self.settings.login == "challenge 2" else b""

    def answer(self, response: bytes, request: Request) -> list[Any] | Sfa:
        """SetUserLevel: a challenge serves once."""
        if self.settings.login == CLASSIC:
            return refusal(Code.METHOD_UNKNOWN, DropReason.UNKNOWN_COMMAND)
        if len(response) != 33:
            return refusal(Code.TOO_LITTLE if len(response) < 33 else Code.TOO_MUCH)
        drawn, level = self._asked.pop(request.address, None), response[32]
        if drawn is None:
            return [3]
        password = self.settings.passwords.get(level)
        if password is None:
            return [1]
        if login.response(login.long_hash(level, password, self._salt), drawn) != response[:32]:
            return [2]
        self.log_in(level, request)
        return [0]

    # requests

    def _splitter(self, kind: LinkKind | None) -> ColaSplitter:
        return ColaSplitter()

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        """The code is kind and name; the data are dialect, name, a NUL and the arguments."""
        dialect, payload = request[:1], request[1:].lstrip(b" ")
        kind, _, rest = payload.partition(b" ")
        if kind == b"sRI":
            return kind, dialect + b"0\0" + rest
        name, _, arguments = rest.partition(b" ")
        known = kind in UNKNOWN and len(name) <= 64 and name.isalnum()
        return (kind + b" " + name if known else b"?" if payload else b""), dialect + name + b"\0" + arguments

    def _reply(self, request: Request, payload: bytes) -> bytes:
        dialect, name = request.data[:1], request.data[1:].partition(b"\0")[0]
        if request.code == b"sRI" and dialect == BINARY:
            return frame(dialect, b"sRA \0\0" + payload)
        return frame(dialect, _named(dialect, ANSWERS[request.code[:3]], name, payload))

    def _refusal(self, request: Request, refused: Refused) -> bytes | None:
        dialect = request.data[:1]
        if not self._speaks(dialect):
            return None
        self._dialects[request.address] = dialect
        code = refused.code if isinstance(refused, Sfa) else UNKNOWN.get(request.code[:3], Code.COMMAND_UNKNOWN)
        return frame(dialect, b"sFA %X" % code if dialect == ASCII else b"sFA" + int(code).to_bytes(2, "big"))

    def _speaks(self, dialect: bytes) -> bool:
        """Whether it speaks that dialect at present."""
        spoken = BINARY if self.values["EIHstCola"] == [1] else ASCII
        return self.settings.dialect == "both" or dialect == spoken

    def _asked_for(self, request: Request) -> bytes | Answer | Refused:
        """Every row of the table leads here."""
        dialect, (raw, _, data) = request.data[:1], request.data[1:].partition(b"\0")
        if not self._speaks(dialect):
            return Answer(None)
        self._dialects[request.address] = dialect
        kind, name = request.code[:3], raw.decode("ascii", "replace")
        try:
            if kind == b"sRI":
                (index,) = decode("u16", dialect, data)
                return refusal(Code.OUT_OF_BOUNDS) if index else self._read("DeviceIdent", dialect, request.now_ns)
            if kind == b"sRN" and name == "LMDscandata":
                return self._poll(request)
            if kind == b"sEN":
                return self._listen(name, decode("u8", dialect, data)[0], request)
            if kind == b"sMN":
                return self._call(METHODS[name], data, request)
            variable = VARIABLES[name]
            if not variable.on(self.settings.model):
                return refusal(Code.VARIABLE_UNKNOWN, DropReason.UNKNOWN_COMMAND, name)
            if kind == b"sRN":
                return self._read(name, dialect, request.now_ns)
            return self._write(name, variable, data, request)
        except Rejected as rejected:
            return refusal(rejected.code)

    def _read(self, name: str, dialect: bytes, now_ns: int) -> bytes:
        variable = VARIABLES[name]
        values = self.values[name] if variable.live is None else variable.live(self, now_ns)
        return encode(variable.layout_of(self.settings.model), dialect, values)

    def _may(self, level: int, request: Request) -> bool:
        return not self.settings.strict or self._levels.get(request.address, login.RUN) >= level

    def _write(self, name: str, variable: Variable, data: bytes, request: Request) -> bytes | Refused:
        if variable.level is None or not self._may(variable.level, request):
            return refusal(Code.WRITE_DENIED, DropReason.WRONG_MODE)
        values = decode(variable.layout_of(self.settings.model), request.data[:1], data)
        if variable.check is not None and (code := variable.check(self, values)) is not None:
            return refusal(code)
        if values != self.values[name]:
            self.values[name] = values
            if variable.changed is not None:
                variable.changed(self, request.now_ns)
        return b""

    def _call(self, method: Method, data: bytes, request: Request) -> bytes | Answer | Refused:
        if not method.on(self.settings.model):
            return refusal(Code.METHOD_UNKNOWN, DropReason.UNKNOWN_COMMAND)
        if not self._may(method.level, request):
            return refusal(Code.METHOD_DENIED, DropReason.WRONG_MODE)
        dialect = request.data[:1]
        found = method.act(self, decode(method.arguments, dialect, data), request)
        if isinstance(found, Sfa):
            return found
        return Answer(encode(method.result, dialect, found or []), restarts=method.restarts)

    def _listen(self, name: str, on: int, request: Request) -> bytes | Refused:
        address, now_ns = request.address, request.now_ns
        if not EVENTS[name].on(self.settings.model):
            return refusal(Code.EVENT_UNKNOWN, DropReason.UNKNOWN_COMMAND)
        if on > 1:
            return refusal(Code.CONDITION_FAILED)
        (self._listeners[name].add if on else self._listeners[name].discard)(address)
        if name == "LMDscandata" and on:
            if address not in self._hosts:
                for held in self._held if self._hosts else ():
                    if held.start_ns >= now_ns:
                        self._send_scan(held, address, {})
            self._subscribe(now_ns, address)
        elif name == "LMDscandata":
            self._unsubscribe(now_ns, address)
        elif name == "InertialMeasurementUnit" and on and not self._imu_goes:
            self._imu_goes = True
            self._timers.add(now_ns + IMU_NS, IMU_NS, self._send_imu)
        return encode("u8", request.data[:1], [on])

    COMMANDS: ClassVar[Mapping[bytes, Command]] = {
        code.encode(): Command(code, lambda session, request: session._asked_for(request), "") for code in codes()
    }


def _named(dialect: bytes, head: bytes, name: bytes, data: bytes) -> bytes:
    """A payload: in CoLa-B the blank stands even where nothing follows."""
    blank = b" " if data or dialect == BINARY else b""
    return head + b" " + name + blank + data


def _event(dialect: bytes, name: str, data: bytes) -> bytes:
    return frame(dialect, _named(dialect, b"sSN", name.encode(), data))


def _cut(scan: Scan, sent: slice) -> Scan:
    """The beams that are sent."""
    if sent == slice(None):
        return scan
    return replace(
        scan, range_m=scan.range_m[sent], intensity=scan.intensity[sent], flags=scan.flags[sent], actor=scan.actor[sent]
    )
