"""A host of the object lists on CAN: joins a bus, finds out which format it carries, keeps the device going.

Sends nothing to a device that speaks by itself, but what an ESR and a Vu8 want before they do.
"""

from __future__ import annotations

from collections.abc import Iterator

from emulator.errors import EmulatorError, LinkError
from emulator.hosts.can_lines import CanLine
from emulator.hosts.object_lists import READERS, ListReader, reader_of, recognised
from emulator.hosts.scans import HostObjects
from emulator.process.clock import SystemClock

LISTEN_S = 3.0
"The longest common cycle is 80 ms; a slow one is set by hand."
ENOUGH_NS = 300_000_000
"A bus with traffic is listened to for so long before it counts as understood: two lists of any format."
ALIVE_NS = 100_000_000
"A missing host message is noticed after half a second by an ESR."


class CanObjectHost:
    """Connects in the constructor; raises `LinkError` when the bus carries no list that is known."""

    def __init__(self, line: CanLine, model: str | None = None, more: bool = False) -> None:
        self._line = line
        self._clock = SystemClock()
        self._alive_ns = 0
        self._reader = self._chosen(model) if model is not None else self._recognise()
        for frame in self._reader.hello(more):
            line.write(frame)
        self.title = self._reader.model

    @property
    def errors(self) -> int:
        """Lists that were not whole."""
        return self._reader.errors

    def scans(self, timeout_s: float) -> Iterator[HostObjects | None]:
        """Lists as they arrive; None when none came for `timeout_s`."""
        while True:
            yield self._next(timeout_s)

    def close(self) -> None:
        """End what was asked for, leave the bus."""
        try:
            for frame in self._reader.goodbye():
                self._line.write(frame)
        except LinkError:
            pass  # a device that has gone need not be left tidy
        self._line.close()

    def _next(self, timeout_s: float) -> HostObjects | None:
        end_ns = self._clock.now_ns() + int(timeout_s * 1e9)
        while True:
            now_ns = self._clock.now_ns()
            if now_ns >= self._alive_ns:
                self._alive_ns = now_ns + ALIVE_NS
                for frame in self._reader.keep_alive():
                    self._line.write(frame)
            heard = self._line.read(max(0.0, min(end_ns, self._alive_ns) - now_ns) * 1e-9)
            found = None if heard is None else self._reader.feed(heard)
            if found is not None:
                return found
            if heard is None and self._clock.now_ns() >= end_ns:
                return None

    def _chosen(self, model: str) -> ListReader:
        """The reader of that model; on a bus where it is heard already, with the identifiers it has there."""
        try:
            named = reader_of(model)
        except KeyError as error:
            raise EmulatorError(f"--model: {error.args[0]}") from None
        if named.hello(False) or named.keep_alive():
            return named  # it wants to be spoken to first
        try:
            heard = self._recognise()
        except LinkError:
            return named
        return heard if type(heard) is type(named) else named

    def _recognise(self) -> ListReader:
        begun_ns = self._clock.now_ns()
        first_ns: int | None = None
        heard: dict[int, None] = {}
        while (now_ns := self._clock.now_ns()) < begun_ns + int(LISTEN_S * 1e9):
            frame = self._line.read(0.05)
            if frame is not None:
                first_ns = now_ns if first_ns is None else first_ns
                heard[frame.identifier] = None
            if first_ns is not None and now_ns >= first_ns + ENOUGH_NS:
                reader = recognised(heard)
                if reader is not None:
                    return reader
        seen = ", ".join(f"{one & 0x1FFFFFFF:X}" for one in sorted(heard)[:12])
        raise LinkError(
            f"no object list recognised within {LISTEN_S:g} s:"
            f" {f'identifiers received: {seen}' if seen else 'the bus is silent; a Vu8 or M16 sends only on request'};"
            f" --model names one of {', '.join(READERS)}"
        )
