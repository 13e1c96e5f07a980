"""LDROBOT's scanners that only send: LD06, LD19, STL-27L.

`codec` has the packet, this module the device: models, settings, when a packet leaves. Not: optics (the sensor specs).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from protocols.framing import Framing
from protocols.ldrobot.codec import HEAD, SAMPLES, SIZE, STAMP_MS, encode_packets, with_crc
from protocols.scan import Floats, Scan
from protocols.session import CommandRow, Emission, LinkKind
from protocols.skeleton.family import ModelFamily
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.one_way import OneWaySession
from protocols.skeleton.sweeps import Sweep, Telegram
from protocols.skeleton.turning import Motor, Samples, TurningSession
from protocols.wire import Wire

HZ, LEAST_HZ, MOST_HZ = 10.0, 5.0, 13.0
"Speed with the PWM pin open or low, and limits (spec 2.1)."
HZ_OF_DUTY = 25.0
"A duty of 40 % is 10 Hz (spec 2.1); linear: ours."
TICK_NS = Fraction(1_000_000)
STAMP_BITS = 15


@dataclass(frozen=True)
class Model:
    """Facts of one model (spec 2.1)."""

    model: str
    baud: int
    rate_hz: int
    "Samples a second."
    most_m: float


MODELS: Mapping[str, Model] = {
    one.model: one
    for one in (
        Model("ldrobot-ld06", 230_400, 4500, 12.0),
        Model("ldrobot-ld19", 230_400, 4500, 12.0),
        Model("ldrobot-stl-27l", 921_600, 21_600, 25.0),
    )
}


class LdrobotSession(TurningSession, OneWaySession):
    """One LD or STL; it streams from power-on, when its motor is at speed, and reads nothing."""

    GROUP = SAMPLES
    clock_tick_ns = TICK_NS
    clock_bits = STAMP_BITS

    def __init__(self, model: Model, motor: Motor) -> None:
        super().__init__(motor.spin_up_ns, motor, model.rate_hz)
        self.model = model
        self.LINE_SPEED = model.baud  # type: ignore[misc]

    def _sweep_of(self, samples: Samples) -> Sweep:
        azimuth = -np.radians(samples.angle_deg % 360.0)
        return Sweep(azimuth, np.zeros(len(azimuth)), samples.after_s, samples.end_s, self.model.most_m,
                     wants_intensity=True)  # fmt: skip

    def _telegrams(self, scan: Scan) -> Iterator[Telegram]:
        samples, plan = self._samples(scan.plan.sweep), scan.plan
        last_s = samples.after_s[SAMPLES - 1 :: SAMPLES]
        after_ns = np.ceil(1e9 * last_s).astype(np.int64)
        reported = [self.clock.reported(plan.start_ns + int(after), TICK_NS, STAMP_BITS) for after in after_ns]
        stamps = np.array([one.device_ns // int(TICK_NS) for one in reported])
        packets = encode_packets(
            round(360.0 * samples.hz), samples.angle_deg, scan.range_m[:, 0], brightness(scan), stamps,
            self.model.most_m,
        )  # fmt: skip
        for after, packet in zip(after_ns.tolist(), packets, strict=True):
            yield Telegram(after, packet, "packet")


def brightness(scan: Scan) -> Floats:
    """Intensity 0..255 of the first echo; no source has the law: 100 at the threshold, 20 more for each doubling."""
    with np.errstate(invalid="ignore", divide="ignore"):
        level = 100.0 + 20.0 * np.log2(scan.intensity[:, 0])
    return np.asarray(np.clip(np.nan_to_num(np.rint(level), nan=0.0), 0.0, 255.0), np.float64)


class LdrobotFraming(Framing):
    """One packet per emission."""

    def bad_check(self, one: Emission) -> bytes | None:
        """A wrong CRC."""
        data = one.payload
        return data[:-1] + bytes((data[-1] ^ 0x55,)) if _is_packet(data) else None

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """Another time stamp, in ms."""
        data = one.payload
        if not _is_packet(data):
            return None
        stamp = (int.from_bytes(data[44:46], "little") + change) % STAMP_MS
        return with_crc(data[:44] + stamp.to_bytes(2, "little") + data[46:])

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another second byte: type and number of samples."""
        return with_crc(one.payload[:1] + bytes((code & 0xFF,)) + one.payload[2:]) if _is_packet(one.payload) else None

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        """Values of an old packet with angles, speed and time stamp of a new one."""
        was, now = old.payload, fresh.payload
        return with_crc(now[:6] + was[6:42] + now[42:]) if _is_packet(was) and _is_packet(now) else None


def _is_packet(data: bytes) -> bool:
    return len(data) == SIZE and data[:2] == HEAD


def motor_of(keys: DeviceKeys) -> Motor:
    """The motor as the scenario's `device:` table has it."""
    duty = keys.number("pwm_duty", "Duty of the PWM pin; 0: low or open, the device keeps 10 Hz.", 0.0, 0.0, 1.0)
    hz = min(max(HZ_OF_DUTY * duty, LEAST_HZ), MOST_HZ) if duty else HZ
    spin_up = keys.number(
        "spin_up_s", "From power-on until the motor is at speed and the stream begins.", 1.5, 0.0, 60.0
    )
    wobble = keys.number("speed_wobble", "Most that the speed of the motor differs, as a share.", 0.005, 0.0, 0.2)
    return Motor(hz, round(1e9 * spin_up), wobble)


ABSENT = tuple(
    CommandRow(f"54 {code}", what, "absent", "spec 2.3", "of the LD14P; ignored")
    for code, what in (("A0", "start"), ("A1", "stop"), ("A2", "speed"), ("A8", "version of the board"))
)
"It has no commands; those of a relative are listed."
FAMILY = ModelFamily(
    name="ldrobot",
    models=MODELS,
    usual="ldrobot-ld19",
    build=lambda keys, model: LdrobotSession(model, motor_of(keys)),
    rows=ABSENT,
    wire=Wire((LinkKind.SERIAL,), lambda kind: LdrobotFraming(), LinkKind.SERIAL),
    tcp_is_line=True,
)
