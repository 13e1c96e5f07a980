"""Telegrams changed from outside with their checks made right again, or wrong on purpose: the contract of a family.

For faults on the wire. Each method takes one emission and gives the bytes that leave instead; None: the protocol has
no such thing there. Not: when something is changed, and the codecs themselves.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from protocols.session import Emission, LinkKind, Session


class Framing:
    """How one family's telegrams lie on one kind of link; a family overrides what it has."""

    def bad_check(self, one: Emission) -> bytes | None:
        """With a wrong check and nothing else wrong."""
        return None

    def with_length(self, one: Emission, change: int) -> bytes | None:
        """The length field says `change` more; checks right."""
        return None

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """The counter says `change` more; checks right."""
        return None

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another response code; checks right."""
        return None

    def with_address(self, one: Emission, address: int) -> bytes | None:
        """From another address; checks right."""
        return None

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        """The values of `old` with the counters of `fresh`; checks right."""
        return None

    def to_be_refused(self, data: bytes) -> bytes | None:
        """What must arrive instead of a host's bytes so that the device refuses them in its own words."""
        return None

    def is_whole(self, data: bytes) -> bool:
        """Whether a host's bytes end in a whole request."""
        return True

    # end-to-end protection of single frames

    def with_e2e_counter(self, one: Emission, change: int) -> bytes | None:
        """The protection's counter says `change` more; its checksum is right."""
        return None

    def e2e_counter(self, one: Emission) -> int | None:
        """What the protection's counter says."""
        return None

    def bad_e2e_check(self, one: Emission) -> bytes | None:
        """The protection's checksum is wrong and nothing else."""
        return None

    # signals of frames

    def with_signal(self, one: Emission, signal: str, raw: int) -> bytes | None:
        """A signal has this raw value; protection, where there is one, is right."""
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
