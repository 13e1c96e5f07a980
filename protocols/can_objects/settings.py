"""Keys of a scenario's `device:` table that every format of object lists has.

Belongs here: what is common. Not: how a key is read (skeleton/keys.py), and which keys a format has beside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from protocols.skeleton.keys import DeviceKeys


@dataclass(frozen=True)
class CommonSettings:
    """What every format has."""

    bitrate: int
    "Bit rate by which the device spaces its frames; the link has its own."
    boot_ns: int
    "Silence after power-on."
    evaluation_ns: int
    "From the instant a list describes to its first frame."
    e2e: Mapping[str, Any] | None

    @classmethod
    def read(cls, keys: DeviceKeys, bitrate: int, rates: Sequence[int]) -> CommonSettings:
        """Take the common keys; `bitrate` is the format's default."""
        return cls(
            bitrate=round(
                keys.number_of(
                    "bitrate",
                    "bit rate by which the device spaces its frames, and that of a bus whose link gives none",
                    bitrate,
                    rates,
                )
            ),
            # no public source states the times; ours, so that a host sees silence first and a list at a known instant
            boot_ns=round(keys.number("boot_ms", "silence after power-on", 500.0, 0.0, 60_000.0) * 1e6),
            evaluation_ns=round(
                keys.number("evaluation_ms", "from the instant a list describes to its first frame", 5.0, 0.0, 1000.0)
                * 1e6
            ),
            e2e=keys.table(
                "e2e", "AUTOSAR end-to-end protection: {profile, messages: {NAME: {data_id, offset_bytes}}}"
            ),
        )
