"""Modification of telegrams for fault injection, with correct or deliberately wrong checksums: a family's contract.

Each method takes one emission and returns the bytes to send instead; None: the protocol has no such field there.
Belongs here: the contract. Not: when something is changed, and the codecs.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from protocols.session import Emission, LinkKind, Session


class Framing:
    """Framing of one family's telegrams on one kind of link; a family overrides what it supports."""

    def bad_check(self, one: Emission) -> bytes | None:
        """With a wrong checksum and no other error."""
        return None

    def with_length(self, one: Emission, change: int) -> bytes | None:
        """The length field is `change` higher; the checksum is correct."""
        return None

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """The counter is `change` higher; the checksum is correct."""
        return None

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another response code; the checksum is correct."""
        return None

    def with_address(self, one: Emission, address: int) -> bytes | None:
        """From another address; the checksum is correct."""
        return None

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        """The values of `old` with the counters of `fresh`; the checksum is correct."""
        return None

    def to_be_refused(self, data: bytes) -> bytes | None:
        """What must arrive instead of a host's bytes so that the device refuses them."""
        return None

    def is_whole(self, data: bytes) -> bool:
        """Whether a host's bytes end with a complete request."""
        return True

    # end-to-end protection of single frames

    def with_e2e_counter(self, one: Emission, change: int) -> bytes | None:
        """The protection's counter is `change` higher; its checksum is correct."""
        return None

    def e2e_counter(self, one: Emission) -> int | None:
        """The protection's counter."""
        return None

    def bad_e2e_check(self, one: Emission) -> bytes | None:
        """The protection's checksum is wrong; no other error."""
        return None

    # signals of frames

    def with_signal(self, one: Emission, signal: str, raw: int) -> bytes | None:
        """A signal has this raw value; the protection, if any, is correct."""
        return None

    def signals(self, label: str) -> tuple[str, ...]:
        """Names of the signals of a message."""
        return ()

    def all_ones(self, label: str, signal: str) -> int:
        """The largest raw value that the bits of a signal hold."""
        return 0


@runtime_checkable
class Frames(Protocol):
    """A family that knows the framing of its telegrams."""

    def framing(self, session: Session, kind: LinkKind) -> Framing | None:
        """That of one device on one kind of link."""
