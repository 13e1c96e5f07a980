"""What host and device said to each other in a recording, telegram by telegram, with times: text for people.

Belongs here: the order of what was said, and a line of each. Not: what bytes mean (hosts.describe), reading (reader).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from emulator.hosts.describe import Described, Speaker, describe
from emulator.recording.reader import RecordedRun, WireOf, WirePayload

MOST_HEX = 24
"Bytes of a telegram that are shown."


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

    def told(self, speaker: Speaker, several: bool) -> str:
        """One line: when its first bit began, who, what bytes, what they say. `several`: sensors take part."""
        data = self.payload.data
        shown = data[:MOST_HEX].hex(" ").upper() + (f" … ({len(data)})" if len(data) > MOST_HEX else "")
        who = ("device" if self.by_device else "host") + (f" {self.wire.sensor}" if several else "")
        where = f"{self.payload.peer:X}#" if self.wire.kind == "can" else ""
        said = "; ".join(f"{one.name} {one.value} {one.unit}".strip() for one in self.fields(speaker))
        return f"{self.payload.start_ns * 1e-9:12.6f}  {who:<8}  {where}{shown}  {said}".rstrip()


def conversation(run: RecordedRun, wanted: Callable[[Said], bool] = lambda said: True) -> Iterator[Said]:
    """All that was said, in the order in which it began; of one instant the host's first."""
    wires = [(wire, by) for table, by in ((run.received, False), (run.sent, True)) for wire in table.values()]
    rows: Sequence[list[Said]] = [
        sorted((Said(wire, one, by) for one in wire.payloads), key=lambda said: said.payload.start_ns)
        for wire, by in wires
    ]
    for said in heapq.merge(*rows, key=lambda said: (said.payload.start_ns, said.by_device)):
        if wanted(said):
            yield said
