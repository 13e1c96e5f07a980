"""What a receiver makes of a line whose sender has another speed: framing garbage, bit by bit, the same every time.

Both ends send eight data bits, least significant first, between a start bit (low) and a stop bit (high); the line idles
high. The receiver waits for a falling edge, looks again half a bit of its own later (a line that is high again was a
glitch), then samples eight data bits and the stop bit in their middles. A low stop bit is a framing error; the next
start is the next falling edge. Time is counted in exact integers, no rounding decides a bit.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FRAME_BITS = 10
TOLERANCE = 0.02
"Speeds closer than this are read without error: a sample 9.5 bits behind the edge goes wrong at 0.5 / 9.5 = 5 %."


def same_speed(one: int, other: int) -> bool:
    """Whether a receiver at one speed reads a sender at the other without error."""
    return abs(one - other) <= TOLERANCE * max(one, other)


@dataclass(frozen=True)
class Sampled:
    """What a receiver took from the line."""

    values: NDArray[np.uint8]
    "The eight sampled bits of each frame, (n,)."
    framing_error: NDArray[np.bool_]
    "Its stop bit was low, (n,)."

    def as_tty(self, ignore_break: bool, ignore_errors: bool, zero_errors: bool) -> bytes:
        """What a program reads from a Linux serial port in raw mode.

        A low line for a whole frame is a break: a zero byte, or nothing with IGNBRK or BRKINT (`ignore_break`). Other
        framing errors are dropped with IGNPAR (`ignore_errors`), read as zero with INPCK (`zero_errors`), else as
        sampled. Source: Linux drivers/tty/serial/8250 (status masks) and n_tty (parity errors, breaks).
        """
        broken = self.framing_error & (self.values == 0)
        failed = self.framing_error & ~broken
        values = np.where(failed & zero_errors, np.uint8(0), self.values)
        keep = ~((broken & ignore_break) | (failed & ignore_errors))
        return bytes(values[keep].tobytes())


def line_levels(data: bytes) -> NDArray[np.uint8]:
    """Level of the line in each bit of `data` sent without pauses, (10 * len(data),)."""
    frames = np.ones((len(data), FRAME_BITS), dtype=np.uint8)
    frames[:, 0] = 0
    frames[:, 1:9] = np.unpackbits(np.frombuffer(data, dtype=np.uint8)[:, None], axis=1, bitorder="little")
    return frames.reshape(-1)


class Receiver:
    """A receiver at `to_baud` on a line that is driven at `from_baud`; it may be fed in pieces."""

    def __init__(self, from_baud: int, to_baud: int) -> None:
        if from_baud < 1 or to_baud < 1:
            raise ValueError(f"line speeds {from_baud} and {to_baud}; want baud > 0")
        self.speeds = (from_baud, to_baud)
        # Time in units of 1 / (2 * from_baud * to_baud) s: halves of both bits are whole numbers.
        self._sent_bit = 2 * to_baud
        self._half_bit = from_baud
        self._levels = np.ones(1, dtype=np.uint8)
        self._from = 0
        "No start is looked for before this, counted from the beginning of `_levels`."

    def feed(self, data: bytes, idle_after: bool) -> Sampled:
        """The frames that `data` completes. `idle_after`: the line rests behind it, nothing stays unfinished."""
        idle = np.ones(2 * FRAME_BITS * (self._sent_bit + 2 * self._half_bit) // self._sent_bit, dtype=np.uint8)
        tail = [idle] if idle_after else []
        levels = np.concatenate([self._levels, line_levels(data), *tail])
        edges = (np.flatnonzero((levels[1:] == 0) & (levels[:-1] == 1)) + 1) * self._sent_bit
        sampled = self._sample(levels.tobytes(), edges.tolist())
        if idle_after:
            self._levels, self._from = np.ones(1, dtype=np.uint8), 0
        else:
            used = max(0, self._from // self._sent_bit - 1)
            self._levels, self._from = levels[used:], self._from - used * self._sent_bit
        return sampled

    def _sample(self, levels: bytes, edges: list[int]) -> Sampled:
        half, sent_bit, end = self._half_bit, self._sent_bit, len(levels) * self._sent_bit
        values, errors = bytearray(), bytearray()
        index = bisect_left(edges, self._from)
        while index < len(edges):
            start = edges[index]
            stop = start + 19 * half
            if stop >= end:
                self._from = start
                break
            if levels[(start + half) // sent_bit]:
                self._from = start + half
            else:
                bits = [levels[(start + (2 * bit + 3) * half) // sent_bit] for bit in range(8)]
                values.append(sum(level << bit for bit, level in enumerate(bits)))
                errors.append(not levels[stop // sent_bit])
                self._from = stop
            index = bisect_left(edges, self._from, index + 1)
        else:
            self._from = max(self._from, end - sent_bit)
        return Sampled(np.frombuffer(bytes(values), dtype=np.uint8), np.frombuffer(bytes(errors), dtype=np.uint8) != 0)


def resample(data: bytes, from_baud: int, to_baud: int) -> Sampled:
    """What a receiver at `to_baud` takes from `data` sent at `from_baud`, the line idle before and after."""
    return Receiver(from_baud, to_baud).feed(data, idle_after=True)
