"""What a kind of fault is: its keys, for whom it exists, how long it lasts, what carries it out.

Not here: the kinds themselves (the layers), a fault of a run (run).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from emulator.config.tables import DescribedTable
from protocols.session import LinkKind
from protocols.wire import changing, impaired_by, wire_of

if TYPE_CHECKING:
    from emulator.faults.acts import Act, Gear
    from emulator.faults.config import Common

TO_HOST = ("to_host",)
BOTH_WAYS = ("to_host", "from_host")
FROM_HOST = ("from_host",)


class Keys(DescribedTable):
    """Keys of one kind of fault; none by itself."""


VEHICLE = "vehicle_bus"
"In place of a family: who sends the ego's motion on CAN."
ON_VEHICLE = (
    "drop_telegram", "repeat_telegram", "reorder_telegrams", "delay_telegram", "wrong_counter", "stale_scan",
    "flip_bits", "replace_bytes", "unplug", "hang", "bus_off", "error_passive", "wrong_dlc", "missing_message",
    "shifted_identifier", "frame_burst", "invalid_signal", "babbling_node",
)  # fmt: skip
"Kinds that it can have. `stale_scan`: frames with the values of an earlier one, and counters that go on."


@dataclass(frozen=True)
class Target:
    """The sensor that a fault is on, as far as it is known before a run."""

    sensor: str
    model: str
    family: str | None
    links: tuple[LinkKind, ...]
    "Kinds of its links; of a sensor without any, the kind of the link that it would get."
    sees: str = "beams"
    "beams | objects"
    facts: Mapping[str, Any] | None = None
    "The spec's `device` table."
    device: Mapping[str, Any] | None = None
    "The scenario's."
    urls: tuple[str, ...] = ()
    "Texts of its links."
    actors: tuple[str, ...] | None = None
    "Of the scene; None: not known."
    messages: Mapping[str, tuple[str, ...]] | None = None
    "Of a vehicle bus: the messages that it sends -> their signals."
    counted: tuple[str, ...] = ()
    "Those of these messages that have a counter."


@dataclass(frozen=True)
class Kind:
    """One name that `do` may have."""

    name: str
    layer: str
    "photon | mechanics | measurement | clock | telegram | byte | link | can"
    summary: str
    "One sentence: what the host sees."
    ends: str
    "How its end shows."
    keys: type[Keys] = Keys
    act: Callable[[Any, Gear], Act] | None = None
    "Carries it out where bytes are sent and received: (its keys, what it can reach)."
    measured: bool = False
    "Carried out where sweeps are measured: it goes with their plans."
    lasts: Literal["telegrams", "state", "own"] = "telegrams"
    """telegrams: hits single ones, one each time it begins unless the file says more. state: holds until its end, for
    ever when the file gives none. own: its keys say how long."""
    own_s: Callable[[Any], float] | None = None
    "How long a fault with these keys lasts."
    families: tuple[str, ...] = ()
    "Empty: all."
    needs: str = ""
    "A method of `protocols.framing.Framing` that telegrams of the family must support."
    needs_part: str = ""
    "What `Session.impair` of the family must take (`Wire.impaired`)."
    needs_session: bool = False
    "It is the device that shows it: a model without a protocol has none."
    links: tuple[LinkKind, ...] = ()
    "Kinds of link on which it exists; empty: all."
    sees: tuple[str, ...] = ("beams", "objects")
    directions: tuple[str, ...] = ()
    "Ways that the bytes may go; empty: it has none."
    of: Literal["all", "scans", "replies"] = "all"
    "Which telegrams it hits unless the file says otherwise."
    check: Callable[[Any, Common, Target], str | None] | None = None
    "What else cannot be: `found; want allowed`, or None."

    @property
    def counts_telegrams(self) -> bool:
        """Whether `of`, `label` and `direction` mean something to it without a trigger that counts."""
        return bool(self.directions)

    def is_for(self, family: str | None) -> bool:
        """Whether it exists on sensors of that family."""
        if self.families:
            return family in self.families
        if family is None:
            return not (self.needs or self.needs_part or self.needs_session)
        wire = wire_of(family)
        if wire is None:
            return True
        return (not self.needs or wire.changes(self.needs)) and (
            not self.needs_part or self.needs_part in wire.impaired
        )

    def known_families(self) -> tuple[str, ...]:
        """Those that it is for, by name; empty: all."""
        if self.needs_part:
            return impaired_by(self.needs_part)
        return self.families or (changing(self.needs) if self.needs else ())

    def unfit(self, target: Target) -> str | None:
        """Why it does not exist on that sensor, `found; want allowed`; None when it does."""
        if target.family == VEHICLE:
            return None if self.name in ON_VEHICLE else f"{VEHICLE} is no sensor; want {_or(ON_VEHICLE)}"
        if not self.is_for(target.family):
            found = _or(self.known_families()) if self.known_families() else "a family"
            return f"{target.model} speaks {target.family or 'no protocol'}; want a sensor of {found}"
        if target.sees not in self.sees:
            lists = "lists objects" if target.sees == "objects" else "lists no objects"
            other = "a sensor that lists objects" if target.sees == "beams" else "one of the sensors in its `from`"
            return f"{target.model} {lists}; want {other}"
        if self.links and target.links and not set(self.links) & set(target.links):
            found = _or(sorted({kind.value for kind in target.links}))
            return f"{target.sensor} has links of the kind {found}; want {_or([kind.value for kind in self.links])}"
        return None


def _or(words: tuple[str, ...] | list[str]) -> str:
    return " or ".join(words)
