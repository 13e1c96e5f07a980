"""What becomes of telegrams at the links of one sensor: handed over, counted as sent, or lost with a reason.

Belongs here: from a telegram that leaves to its links and to the account. Not: which leaves when (instrument, the
session), what faults make of it (injection), bytes on their way (transports).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from emulator.instrument.observers import Observers
from emulator.instrument.stats import InstrumentStats
from emulator.transports.link import Link
from protocols.session import DropReason, Emission, LinkKind

if TYPE_CHECKING:
    from emulator.instrument.fault_hooks import Passed

HANDED_KEPT = 256
"A link whose host does not read gives up more than its buffers hold."


class Outlet:
    """The links of one sensor, as telegrams leave by them."""

    def __init__(self, links: Sequence[Link], stats: InstrumentStats, observers: Observers) -> None:
        self._links, self._stats, self._observers = tuple(links), stats, observers
        self._ledger, self._owed = stats.ledger, stats.owed
        self._handed: deque[Emission] = deque(maxlen=HANDED_KEPT)
        "Telegrams with scans that links have taken last: one may still give them up whole."
        for link in self._links:
            link.on_given_up = self._given_up

    def take(self, emission: Emission) -> None:
        """A telegram leaves, and is counted."""
        self._note_sent(emission, self._send(emission))

    def leave(self, passed: Passed) -> None:
        """What of a telegram leaves now leaves; its scan is counted, once."""
        emission = passed.emission
        refused = [(one, self._send(one, only)) for one, only in passed.leaving]
        if emission is None:
            for one, why in refused:
                if why is not None:
                    self._stats.note_lost(one, why)
            return
        reasons = [why for one, why in refused if one.sweep is not None]
        sent = [one for one, _, _ in passed.made if one.payload or not emission.payload]
        carrying = [one for one in sent if one.sweep == emission.sweep]  # others were held back, and are on account
        if passed.counted:
            return
        if carrying:  # a repeated telegram is one scan, or one reply
            self._note_sent(carrying[0], None if None in reasons or not reasons else reasons[0])
        elif emission.sweep is not None and passed.taker is not None:
            self._ledger.send(emission, f"fault {passed.taker}")

    def _note_sent(self, emission: Emission, refused: str | None) -> None:
        """Count a telegram as sent, or as what its links refused it for."""
        if refused is None or emission.sweep is None:
            self._stats.note_telegram(emission)
        else:
            self._ledger.send(emission, refused)

    def _send(self, emission: Emission, only: int | None = None) -> str | None:
        """Hand a telegram to its links, or to one of them; why not one of them has taken it, None if one has."""
        address = emission.address
        self._observers.reported(emission)
        targets = (
            range(len(self._links)) if address is None else range(len(self._links))[address.link : address.link + 1]
        )
        peer = None if address is None else address.peer
        if emission.sweep is not None:
            self._handed.append(emission)
            self._owed.sent(emission.due_ns, emission.sweep)
        why: str | None = None
        taken = False
        for index in targets if only is None else (only,):
            link = self._links[index]
            refused = link.stats.payloads_dropped
            self._observers.leaving(index, peer, emission)
            if emission.cuts:
                link.cut(emission.due_ns)
            elif emission.pause is not None and link.kind is LinkKind.SERIAL:
                count, resume_ns = emission.pause
                begin, rest = emission.payload[:count], emission.payload[count:]
                self._handed.extend(replace(emission, payload=part) for part in (begin, rest))  # one may be given up
                link.send(begin, emission.due_ns, peer)
                link.send(rest, resume_ns, peer, emission.line_speed)
            elif emission.place is not None:
                link.send_to(emission.payload, emission.due_ns, emission.place)
            else:
                link.send(emission.payload, emission.due_ns, peer, emission.line_speed)
            if emission.hangs_up:
                link.hang_up(emission.due_ns, peer)
            if link.stats.payloads_dropped == refused:
                self._observers.left(index, peer, emission)
                taken = True
            else:
                slow = DropReason.LINE_BUSY if link.kind in (LinkKind.SERIAL, LinkKind.CAN) else DropReason.HOST_SLOW
                why = slow.value
        if why is not None and not emission.scans:
            self._break_off(emission, why)
        return None if taken else why

    def _break_off(self, rest: Emission, reason: str) -> None:
        """A frame of a scan has found no room: nobody reads the scan that has begun on that link."""
        link = None if rest.address is None else rest.address.link
        begun = (one for one in reversed(self._handed) if one.address is not None and one.address.link == link)
        if (emission := next(begun, None)) is not None:
            self._stats.note_lost(emission, reason)

    def _given_up(self, payload: bytes) -> None:
        """A link has given up a telegram that it had taken."""
        for emission in self._handed:
            if emission.payload is payload:
                self._stats.note_lost(emission, DropReason.HOST_SLOW.value)
                return
