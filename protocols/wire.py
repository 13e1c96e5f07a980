"""What a family states of its wire before there is a device: kinds of links, framing, what makes a device measure.

Belongs here: the statement, and finding it by the family's name. Not: the statements themselves (`FAMILY.wire`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from protocols import families, family
from protocols.framing import Framing
from protocols.session import LinkKind


@dataclass(frozen=True)
class Wire:
    """One family's wire."""

    links: tuple[LinkKind, ...]
    "Kinds of links that it uses; the first is the one that a sensor without links gets."
    framing: Callable[[LinkKind], Framing] | None = None
    "How its telegrams are changed on such a link; None: known only when there is a device."
    asked_on: LinkKind | None = None
    "Link on which `requests` make a device measure all the time; None: nothing makes it."
    requests: tuple[bytes, ...] = ()
    impaired: tuple[str, ...] = ()
    "What `Session.impair` of its devices takes beside window and motor."

    @property
    def usual(self) -> LinkKind:
        """The link that a sensor without links gets."""
        return self.links[0]

    @property
    def on_can_only(self) -> bool:
        """Whether it is a family of CAN frames."""
        return self.links == (LinkKind.CAN,)

    def changes(self, method: str) -> bool:
        """Whether telegrams on any of its links have what that method of `Framing` changes."""
        if self.framing is None:
            return True  # not known yet
        return any(getattr(type(self.framing(kind)), method) is not getattr(Framing, method) for kind in self.links)


@runtime_checkable
class HasWire(Protocol):
    """A family that states its wire."""

    @property
    def wire(self) -> Wire: ...


ANY = Wire((LinkKind.SERIAL, LinkKind.STREAM, LinkKind.DATAGRAM, LinkKind.CAN))
"Of a family that states nothing."


def wire_of(name: str | None) -> Wire | None:
    """The wire of the family of that name; None: there is no such family."""
    if name is None or name not in families():
        return None
    found = family(name)
    return found.wire if isinstance(found, HasWire) else ANY


def impaired_by(what: str) -> tuple[str, ...]:
    """Names of the families whose devices can be impaired so."""
    return tuple(name for name in families() if (wire := wire_of(name)) is not None and what in wire.impaired)


def changing(method: str) -> tuple[str, ...]:
    """Names of the families whose telegrams have what that method of `Framing` changes."""
    found = [name for name in families() if (wire := wire_of(name)) is not None and wire.changes(method)]
    return tuple(found)
