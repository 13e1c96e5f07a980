"""What host and device said to each other in a recording, telegram by telegram, with times: text for people.

Belongs here: the order of what was said, and a line of each. Not: what bytes mean (hosts.describe), reading (reader).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from emulator.hosts.describe import Described, Speaker, describe
from emulator.recording.reader import RecordedRun, WireOf, WirePayload

MOST_HEX = 24
"Bytes of a telegram that are shown."


PIECE_NS = 14_000_000
"Within a host's telegram no longer gap is let pass by an LMS2xx (listing, inter-byte time-out)."
USP_HEAD = b"\x02\x02\x02\x02"


@dataclass(frozen=True)
class Said:
    """One payload of a recording."""

    wire: WireOf
    payload: WirePayload
    by_device: bool

    def as_json(self, speaker: Speaker) -> dict[str, object]:
        """Everything of it."""
        fields = [one._asdict() for one in self.fields(speaker)]
        return {
            "at_s": self.payload.start_ns * 1e-9,
            "end_s": self.payload.end_ns * 1e-9,
            "left_s": None if self.payload.actual_ns is None else self.payload.actual_ns * 1e-9,
            "sensor": self.wire.sensor,
            "link": self.wire.link,
            "from": "device" if self.by_device else "host",
            "peer": self.payload.peer,
            "sweep": self.payload.sweep,
            "bytes": self.payload.data.hex(" "),
            "fields": fields,
        }

    def fields(self, speaker: Speaker) -> list[Described]:
        """What the bytes say."""
        return describe(speaker, self.payload.data, self.wire.kind, self.payload.peer, self.by_device)

    @property
    def began_ns(self) -> int:
        """When its first bit began indeed, as far as it is recorded: as late as its last."""
        return self.payload.start_ns + self.payload.late_ns

    def reported(self, speaker: Speaker, several: bool, late: bool = False) -> str:
        """One line: when its first bit was due, who, what bytes, what they say. `several`: sensors take part.

        `late`: with a column of how many milliseconds later than that it left, blank where that is not recorded.
        """
        data = self.payload.data
        shown = data[:MOST_HEX].hex(" ").upper() + (f" … ({len(data)})" if len(data) > MOST_HEX else "")
        who = ("device" if self.by_device else "host") + (f" {self.wire.sensor}" if several else "")
        where = f"{self.payload.peer:X}#" if self.wire.kind == "can" else ""
        said = "; ".join(f"{one.name} {one.value} {one.unit}".strip() for one in self.fields(speaker))
        after = f"{self.payload.late_ns * 1e-6:+9.3f} ms" if self.payload.actual_ns is not None else " " * 12
        at = f"{self.payload.start_ns * 1e-9:12.6f}" + (f"  {after}" if late else "")
        return f"{at}  {who:<8}  {where}{shown}  {said}".rstrip()


def conversation(run: RecordedRun, wanted: Callable[[Said], bool] = lambda said: True) -> Iterator[Said]:
    """All that was said, in the order in which it began; of one instant the host's first."""
    wires = [(wire, by) for table, by in ((run.received, False), (run.sent, True)) for wire in table.values()]
    rows: Sequence[list[Said]] = [
        sorted((Said(wire, one, by) for one in wire.payloads), key=lambda said: said.began_ns) for wire, by in wires
    ]
    for said in _joined(heapq.merge(*rows, key=lambda said: (said.began_ns, said.by_device))):
        if wanted(said):
            yield said


def _joined(pieces: Iterable[Said]) -> Iterator[Said]:
    """Bytes of a host that came in one by one, as on a line, as the telegram that they are."""
    open_: Said | None = None
    for said in pieces:
        if open_ is not None and _goes_on(open_, said):
            one, more = open_.payload, said.payload
            open_ = replace(open_, payload=replace(one, data=one.data + more.data, end_ns=more.end_ns))
            continue
        if open_ is not None:
            yield open_
        open_ = said
    if open_ is not None:
        yield open_


def _goes_on(before: Said, said: Said) -> bool:
    one, more = before.payload, said.payload
    if before.by_device or said.by_device or before.wire is not said.wire or one.peer != more.peer:
        return False
    stream = said.wire.kind in ("serial", "stream")
    return stream and more.start_ns - one.end_ns <= PIECE_NS and not _whole(one.data)


def _whole(data: bytes) -> bool:
    """Whether no byte of a telegram is missing, by its own length or end."""
    if data.startswith(USP_HEAD):
        return len(data) >= 8 and len(data) >= 9 + int.from_bytes(data[4:8], "big")
    if data[-1:] == b"\x03" and len(data) > 6:  # a package of an LD in ASCII
        return True
    return len(data) >= 4 and len(data) >= 6 + int.from_bytes(data[2:4], "little")
