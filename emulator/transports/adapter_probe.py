"""What one serial adapter really does: its latency timer, the speeds it takes, how fast bytes leave and return.

Belongs here: questions for `lidaremu doctor --serial`. Bytes are written to the device: whatever is on the line hears
them. Not: what the machine has in general (probes).
"""

from __future__ import annotations

import contextlib
import os
import termios
from collections.abc import Callable
from pathlib import Path

import numpy as np
import serial

from emulator.errors import LinkError
from emulator.process.clock import Clock
from emulator.transports.probes import Probe
from emulator.transports.tty_modes import read_modes

SPEEDS = (9_600, 19_200, 38_400, 57_600, 115_200, 500_000)
"Those of the LMS2xx and the LD."
SLOWEST_TIMER_MS = 2
"An FTDI's 16 ms of delivery hold a telegram of 13 ms back by more than its period."
LOOP_BAUD, LOOP_TRIES, LOOP_S = 38_400, 20, 0.3
PAYLOAD_S = 0.2
"Of sending, at each speed measured."
CLOSE = 0.02
"Share by which a measured speed may differ: a receiver fails at 5 %."


def probe_adapter(device: str, clock: Clock, sysfs: Path = Path("/sys/class/tty")) -> list[Probe]:
    """Answers about one adapter; `LinkError` when it cannot be opened."""
    try:
        port = serial.Serial(os.path.realpath(device), SPEEDS[0], timeout=LOOP_S, write_timeout=5.0)
    except (serial.SerialException, OSError, ValueError) as error:
        number = getattr(error, "errno", None)
        raise LinkError(f"cannot open {device}: {os.strerror(number) if number else error}") from None
    try:
        with contextlib.closing(port):
            found = [_latency_timer(device, sysfs), _speeds(port)]
            bridged = _loop(port, clock)
            return [*found, bridged, _pace(port, clock, bridged.works)]
    except (serial.SerialException, OSError, termios.error) as error:
        raise LinkError(f"{device}: lost while it was measured: {error}") from None


def _latency_timer(device: str, sysfs: Path) -> Probe:
    """FTDI's, as the driver shows it; others have none that can be read."""
    name = Path(os.path.realpath(device)).name
    place = sysfs / name / "device" / "latency_timer"
    driver = sysfs / name / "device" / "driver"
    reported = os.path.basename(os.path.realpath(driver)) if driver.exists() else "no driver's name"
    try:
        ms = int(place.read_text())
    except (OSError, ValueError):
        return Probe("latency timer", True, f"none that the driver shows ({reported})")
    advice = "" if ms <= SLOWEST_TIMER_MS else f"; want {SLOWEST_TIMER_MS} or less: echo 1 > {place}"
    return Probe("latency timer", ms <= SLOWEST_TIMER_MS, f"{ms} ms ({reported}){advice}")


def _speeds(port: serial.Serial) -> Probe:
    """Which speeds are taken, and what the driver makes of them."""
    taken, refused = [], []
    for baud in SPEEDS:
        try:
            port.baudrate = baud
            real = read_modes(port.fileno()).sends_baud
        except (serial.SerialException, OSError, termios.error, ValueError) as error:
            refused.append(f"{baud} refused: {error}")
            continue
        if abs(real - baud) > CLOSE * baud:
            refused.append(f"{baud} becomes {real}")
        else:
            taken.append(str(baud))
    return Probe("speeds", not refused, "; ".join([f"taken: {', '.join(taken) or 'none'}", *refused]))


def _loop(port: serial.Serial, clock: Clock) -> Probe:
    """Whether what is sent comes back, and after how long: one byte at a time."""
    port.baudrate = LOOP_BAUD
    port.reset_input_buffer()
    took_us: list[float] = []
    for number in range(LOOP_TRIES):
        began_ns = clock.now_ns()
        port.write(bytes((number,)))
        came = port.read(1)
        if came != bytes((number,)):
            back = f"{came.hex()} came for {number:02x}" if came else "nothing came back"
            return Probe("loop-back", False, f"{back}; bridge TXD and RXD (pins 2 and 3) to measure delays")
        took_us.append((clock.now_ns() - began_ns) * 1e-3)
    median, worst = float(np.median(took_us)), max(took_us)
    wire_us = 1e7 / LOOP_BAUD
    detail = f"a byte and back: median {median:.0f} us, worst {worst:.0f} us; {wire_us:.0f} us of it on the line"
    return Probe("loop-back", True, f"{detail}, at {LOOP_BAUD} baud")


def _pace(port: serial.Serial, clock: Clock, bridged: bool) -> Probe:
    """How fast bytes really leave: between a short and a long block, so that fixed delays drop out."""
    reported, good = [], True
    for baud in (LOOP_BAUD, SPEEDS[-1]):
        try:
            port.baudrate = baud
        except (serial.SerialException, OSError, ValueError):
            continue
        port.reset_input_buffer()
        size = max(64, round(baud / 10 * PAYLOAD_S))
        move: Callable[[int], int] = lambda count: _moved(port, clock, count, bridged)  # noqa: E731
        span_ns = move(size) - move(size // 4)
        real = 10 * (size - size // 4) / max(1, span_ns) * 1e9
        if span_ns <= 0 or real > 10 * baud:
            reported.append(f"{baud} baud: bytes leave at once: no line behind it, or one that buffers them all")
            good = False
        else:
            reported.append(f"{baud} baud: really {real:.0f}")
            good = good and abs(real - baud) <= CLOSE * baud
    way = "there and back" if bridged else "by the driver's own word of what has left"
    return Probe("real speed", good, f"{'; '.join(reported)} ({way})")


def _moved(port: serial.Serial, clock: Clock, count: int, bridged: bool) -> int:
    """Nanoseconds until so many bytes have left, or have come back."""
    began_ns = clock.now_ns()
    port.write(bytes(count))
    if bridged:
        missing = count
        while missing > 0 and (came := port.read(missing)):
            missing -= len(came)
    else:
        termios.tcdrain(port.fileno())
    return clock.now_ns() - began_ns
