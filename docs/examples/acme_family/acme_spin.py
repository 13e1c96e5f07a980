"""ACME S4, an invented spinning scanner of four layers that only sends datagrams. A whole family in one module.

Belongs here: what goes over the wire and when. Not: what the device sees (acme-s4.yaml, and the emulator).

A turn is 180 columns, two degrees apart, clockwise from straight ahead; a datagram has twelve of them and leaves when
the last has fired. Little-endian: `S4`, number of the turn (16 bits), time of the first column in microseconds since
power-on (32 bits), then a column each of azimuth in hundredths of a degree (16 bits) and, layer by layer from below,
range in 4 mm (16 bits, 0: no echo) and intensity (8 bits).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from protocols.scan import Scan
from protocols.skeleton.family import SimpleFamily
from protocols.skeleton.instants import SECOND_NS
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.one_way import OneWaySession, packets
from protocols.skeleton.sweeps import Sweep, Telegram

ELEVATION_DEG = np.array([-6.0, -3.0, 0.0, 3.0])
LAYERS, COLUMNS, COLUMNS_A_PACKET = len(ELEVATION_DEG), 180, 12
AZIMUTH_CDEG = np.arange(COLUMNS) * (36_000 // COLUMNS)
LAYER_S = 2e-6
"From layer to layer of a column."
STEP_M = 0.004
MAX_RANGE_M = 200.0
BOOT_NS = 2 * SECOND_NS
TICK_NS = Fraction(1000)

COLUMN = np.dtype([("azimuth_cdeg", "<u2"), ("beams", np.dtype([("range", "<u2"), ("intensity", "u1")]), LAYERS)])
PACKET = np.dtype([("mark", "S2"), ("turn", "<u2"), ("time_us", "<u4"), ("columns", COLUMN, COLUMNS_A_PACKET)])


class SpinSession(OneWaySession):
    """One ACME S4."""

    clock_tick_ns = TICK_NS
    clock_bits = 32
    count_bits = 16

    def __init__(self, turn_hz: float) -> None:
        super().__init__(BOOT_NS, SECOND_NS / Fraction(turn_hz))
        column_s = 1.0 / (turn_hz * COLUMNS)
        self._turn = Sweep(
            azimuth_rad=-np.radians(np.repeat(AZIMUTH_CDEG / 100.0, LAYERS)),
            elevation_rad=np.radians(np.tile(ELEVATION_DEG, COLUMNS)),
            fire_offset_s=(np.arange(COLUMNS)[:, None] * column_s + np.arange(LAYERS) * LAYER_S).ravel(),
            duration_s=1.0 / turn_hz,
            max_range_m=MAX_RANGE_M,
            wants_intensity=True,
        )

    def _sweep(self, number: int) -> Sweep:
        return self._turn

    def _telegrams(self, scan: Scan) -> Iterator[Telegram]:
        turn = np.zeros(COLUMNS // COLUMNS_A_PACKET, PACKET)
        turn["mark"], turn["turn"] = b"S4", (scan.plan.sweep + self.first_count) & 0xFFFF
        columns = turn["columns"].reshape(COLUMNS)
        columns["azimuth_cdeg"] = AZIMUTH_CDEG
        words = np.nan_to_num(np.round(scan.range_m[:, 0] / STEP_M), nan=0.0)
        columns["beams"]["range"] = np.where(words <= MAX_RANGE_M / STEP_M, words, 0.0).reshape(COLUMNS, LAYERS)
        strength = np.clip(np.nan_to_num(np.round(scan.intensity[:, 0]), nan=0.0), 0.0, 255.0)
        columns["beams"]["intensity"] = strength.reshape(COLUMNS, LAYERS)
        turn["columns"] = columns.reshape(turn["columns"].shape)
        offsets_s = self._turn.fire_offset_s
        for packet, (beams, after_ns) in zip(turn, packets(offsets_s, COLUMNS_A_PACKET * LAYERS), strict=True):
            reported = self.clock.reported(
                scan.plan.start_ns + round(1e9 * scan.plan.fire_offset_s[beams.start]), TICK_NS, 32
            )
            packet["time_us"] = reported.ticks
            yield Telegram(after_ns, packet.tobytes(), "columns", reported)


def new_session(keys: DeviceKeys) -> SpinSession:
    """Of a scenario's `device:` table."""
    return SpinSession(keys.number_of("turn_hz", "turns a second", 10, (5, 10, 20)))


class SpinFamily(SimpleFamily):
    """With a host of its own."""

    def script(self, line: Any, on_scan: Callable[[int, Any], None]) -> Any:
        """For `lidaremu test`: a host in virtual time."""
        from acme_host import SpinScript

        return SpinScript(line, on_scan)


FAMILY = SpinFamily("acme_spin", tcp_is_line=False, build=new_session)
