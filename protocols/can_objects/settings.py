"""Reading of a scenario's `device:` table: every key checked, unknown ones refused with what is known.

Belongs here: how a key is read. Not: which keys a format has.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from protocols.errors import DeviceSettingError


class DeviceKeys:
    """A scenario's table over the model's own; each value is taken once, `finish` refuses what nobody took."""

    def __init__(self, device: Mapping[str, Any], facts: Mapping[str, Any], prefix: str = "") -> None:
        self._values: dict[str, Any] = {**facts, **device}
        self._prefix = prefix
        self._known: list[str] = []

    def integer(self, key: str, default: int, low: int, high: int) -> int:
        """An integer from `low` to `high`."""
        value = self._take(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self._error(key, value, f"an integer from {low} to {high}")
        return value

    def number(self, key: str, default: float, low: float, high: float) -> float:
        """A number from `low` to `high`."""
        value = self._take(key, default)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or not low <= value <= high:
            raise self._error(key, value, f"a number from {low:g} to {high:g}")
        return float(value)

    def flag(self, key: str, default: bool) -> bool:
        """true or false."""
        value = self._take(key, default)
        if not isinstance(value, bool):
            raise self._error(key, value, "true or false")
        return value

    def choice(self, key: str, default: str, allowed: Sequence[str]) -> str:
        """One of a few words."""
        value = self._take(key, default)
        if not isinstance(value, str) or value not in allowed:
            raise self._error(key, value, " | ".join(allowed))
        return value

    def number_of(self, key: str, default: float, allowed: Sequence[float]) -> float:
        """One of a few numbers."""
        value = self._take(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or value not in allowed:
            raise self._error(key, value, " | ".join(f"{number:g}" for number in allowed))
        return float(value)

    def words(self, key: str, allowed: Sequence[str]) -> tuple[str, ...]:
        """A list of words, empty by default."""
        value = self._take(key, ())
        if not isinstance(value, list | tuple) or any(word not in allowed for word in value):
            raise self._error(key, value, f"a list of {', '.join(allowed)}")
        return tuple(value)

    def integers(self, key: str, default: Sequence[int], low: int, high: int) -> tuple[int, ...]:
        """As many integers from `low` to `high` as the default has."""
        value = self._take(key, tuple(default))
        fits = isinstance(value, list | tuple) and len(value) == len(default)
        if not fits or any(isinstance(v, bool) or not isinstance(v, int) or not low <= v <= high for v in value):
            raise self._error(key, value, f"{len(default)} integers from {low} to {high}")
        return tuple(value)

    def table(self, key: str) -> Mapping[str, Any] | None:
        """A table, None when it is absent."""
        value = self._take(key, None)
        if value is not None and not isinstance(value, Mapping):
            raise self._error(key, value, "a table")
        return value

    def finish(self) -> None:
        """Refuse the first key that nobody has taken."""
        for key, value in self._values.items():
            raise self._error(str(key), value, f"no such key; known: {', '.join(sorted(self._known))}")

    def _take(self, key: str, default: Any) -> Any:
        self._known.append(key)
        return self._values.pop(key, default)

    def _error(self, key: str, found: object, allowed: str) -> DeviceSettingError:
        return DeviceSettingError(self._prefix + key, found, allowed)


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
            bitrate=round(keys.number_of("bitrate", bitrate, rates)),
            # no public source states the times; ours, so that a host sees silence first and a list at a known instant
            boot_ns=round(keys.number("boot_ms", 500.0, 0.0, 60_000.0) * 1e6),
            evaluation_ns=round(keys.number("evaluation_ms", 5.0, 0.0, 1000.0) * 1e6),
            e2e=keys.table("e2e"),
        )
