"""Reading of a scenario's `device:` table: every key is checked, unknown ones are refused with the known ones.

Belongs here: how a key is read. Not: which keys a family has.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from protocols.errors import DeviceSettingError
from protocols.session import DeviceKey

Value = TypeVar("Value")


class DeviceKeys:
    """A scenario's table over that of the model; each value is read once, `finish` refuses those that were not read."""

    def __init__(self, device: Mapping[str, Any], facts: Mapping[str, Any], prefix: str = "") -> None:
        self._values: dict[str, Any] = {**facts, **device}
        self._of_model = facts.keys() - device.keys()
        self._prefix = prefix
        self.known: list[DeviceKey] = []
        "Keys read so far."

    def integer(self, key: str, meaning: str, default: int | None, low: int, high: int) -> int:
        """An integer from `low` to `high`; without a default it must be there."""
        entry = DeviceKey(key, f"an integer from {low} to {high}", str(default), meaning)
        found = self._take(entry, default, lambda value: type(value) is int and low <= value <= high)
        if found is None:
            raise self.wrong(key, None, entry.allowed)
        return found

    def number(self, key: str, meaning: str, default: float, low: float, high: float) -> float:
        """A number from `low` to `high`."""
        found: float = self._take(
            DeviceKey(key, f"a number from {low:g} to {high:g}", f"{default:g}", meaning),
            default,
            lambda value: type(value) in (int, float) and low <= value <= high,
        )
        return float(found)

    def flag(self, key: str, meaning: str, default: bool) -> bool:
        """true or false."""
        text = "true" if default else "false"
        return self._take(
            DeviceKey(key, "true or false", text, meaning), default, lambda value: isinstance(value, bool)
        )

    def choice(self, key: str, meaning: str, default: str, allowed: Sequence[str]) -> str:
        """One of a few words."""
        entry = DeviceKey(key, " | ".join(allowed), default, meaning)
        return self._take(entry, default, lambda value: isinstance(value, str) and value in allowed)

    def number_of(self, key: str, meaning: str, default: float, allowed: Sequence[float]) -> float:
        """One of a few numbers."""
        found: float = self._take(
            DeviceKey(key, " | ".join(f"{number:.12g}" for number in allowed), f"{default:.12g}", meaning),
            default,
            lambda value: type(value) in (int, float) and value in allowed,
        )
        return float(found)

    def text(self, key: str, meaning: str, default: str, longest: int) -> str:
        """Printable ASCII, at most `longest` characters; a number is accepted as written."""
        entry = DeviceKey(key, f"text of at most {longest} printable ASCII characters", default, meaning)
        found: Any = self._take(
            entry,
            default,
            lambda value: (
                type(value) in (str, int)
                and str(value).isascii()
                and str(value).isprintable()
                and len(str(value)) <= longest
            ),
        )
        return str(found)

    def words(self, key: str, meaning: str, allowed: Sequence[str]) -> tuple[str, ...]:
        """A list of words, empty by default."""
        found: Sequence[str] = self._take(
            DeviceKey(key, f"a list of {', '.join(allowed)}", "[]", meaning),
            (),
            lambda value: isinstance(value, list | tuple) and all(word in allowed for word in value),
        )
        return tuple(found)

    def integers(self, key: str, meaning: str, default: Sequence[int], low: int, high: int) -> tuple[int, ...]:
        """As many integers from `low` to `high` as the default has."""
        found: Sequence[int] = self._take(
            DeviceKey(key, f"{len(default)} integers from {low} to {high}", str(list(default)), meaning),
            tuple(default),
            lambda value: (
                isinstance(value, list | tuple)
                and len(value) == len(default)
                and all(type(number) is int and low <= number <= high for number in value)
            ),
        )
        return tuple(found)

    def numbers(
        self, key: str, meaning: str, default: Sequence[float] | None, limits: Sequence[tuple[float, float]]
    ) -> tuple[float, ...]:
        """As many numbers as there are limits; without a default they must be there."""
        ranges = " and ".join(f"{low:g}..{high:g}" for low, high in limits)
        entry = DeviceKey(key, f"{len(limits)} numbers of {ranges}", str(default), meaning)
        found: Sequence[float] | None = self._take(
            entry,
            default,
            lambda value: (
                isinstance(value, list | tuple)
                and len(value) == len(limits)
                and all(
                    type(number) in (int, float) and low <= number <= high
                    for number, (low, high) in zip(value, limits, strict=True)
                )
            ),
        )
        if found is None:
            raise self.wrong(key, None, entry.allowed)
        return tuple(float(number) for number in found)

    def wrong(self, key: str, found: object, allowed: str) -> DeviceSettingError:
        """The refusal of a key, with the place of its table."""
        return DeviceSettingError(self._prefix + key, found, allowed)

    def table(self, key: str, meaning: str) -> Mapping[str, Any] | None:
        """A table, None when it is absent."""
        entry = DeviceKey(key, "a table", "none", meaning)
        nothing: Mapping[str, Any] | None = None
        return self._take(entry, nothing, lambda value: value is None or isinstance(value, Mapping))

    def finish(self, of: Collection[str] | None = None) -> None:
        """Refuse the first key that was not read; `of`: check only these."""
        for key, value in self._values.items():
            if of is not None and key not in of:
                continue
            names = ", ".join(sorted(entry.name for entry in self.known))
            raise DeviceSettingError(self._prefix + str(key), value, f"no such key; known: {names}")

    def _take(self, entry: DeviceKey, default: Value, fits: Callable[[Any], bool]) -> Value:
        value: Value = self._values.pop(entry.name, default)
        # shown of a model: its own word, as its name
        own = entry.name in self._of_model and isinstance(value, str)
        self.known.append(replace(entry, default=str(value)) if own else entry)
        # the default need not be among what a file may say: it stands for an absent key
        if value is not default and not fits(value):
            raise DeviceSettingError(self._prefix + entry.name, value, entry.allowed)
        return value
