"""From arrays to compiled loops while a real-time run lives: the first start on a machine waits for no compiler.

Belongs here: when loops are built, and when a process with loops is started, tried and ready to take the place of one
with arrays; one at a time. Not: how it takes that place, nor what happens to a process that serves (supervision); what
is built and how (compiled.build). A run on a virtual clock has none of this: it keeps the form it began with.

Nothing here is a fault of the run: what goes wrong is reported once, and arrays go on.
"""

from __future__ import annotations

import select
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from emulator.measuring.homes import Handover, Home, Successor
from emulator.measuring.worker import LOOPS, Handle, Pipe
from emulator.process import time_limits
from emulator.process.time_limits import Stillness

BUILDING = "compiled loops are being built for this machine, once, beside the run; until then arrays compute the sweeps"
IN_USE = "compiled loops are in use; built in {0:.0f} s"
NOT_USED = "compiled loops are not used in this run: {0}; arrays go on"


class Building(Protocol):
    """Loops that are being built; see `compiled.build.Builder`."""

    def poll(self) -> bool | None:
        """None while it works; then whether it has come to its end in order."""

    def why(self) -> str:
        """How it has ended."""

    def close(self) -> None: ...


class Upgrade:
    """Has loops built and then gets, for one home after the other, a successor ready that has them."""

    def __init__(
        self,
        build: Callable[[], Building],
        launch: Callable[[bool], Handle],
        epoll: select.epoll,
        notes: list[str],
        began_ns: int,
    ) -> None:
        """`build` begins at once, and may raise `OSError`; `notes` get what is to be reported; `began_ns`: running
        time."""
        self._launch, self._epoll, self._notes, self._began_ns = launch, epoll, notes, began_ns
        self._building: Building | None = None
        self._built_s = 0.0
        self.is_over = False
        "All have loops, or none will any more."
        self.loops = False
        "Processes are started with loops."
        self._still = Stillness(0)
        try:
            self._building = build()
            self._notes.append(BUILDING)
        except OSError as error:
            self._give_up((), f"no process can be started: {error.strerror or error}")

    def check(self, homes: Sequence[Home], now_ns: int) -> None:
        """Go on, a step at a time; called about every `time_limits.TICK_NS` of running time."""
        if self._building is not None:
            self._look_at_building(self._building, now_ns)
        if self.is_over or not self.loops:
            return
        under_way = next((home for home in homes if home.successor is not None), None)
        if under_way is not None:
            self._judge(homes, under_way, now_ns)
            return
        left = [home for home in homes if home.form != LOOPS]
        if not left:
            self.is_over = True
            self._notes.append(IN_USE.format(self._built_s))
        for home in left:
            if home.state == "ready":  # one that is started now has loops anyway
                self._start(homes, home, now_ns)
                return

    def attend(self, number: int, homes: Sequence[Home], now_ns: int) -> Home | None:
        """The descriptor of a successor has something to read, or room; the home whose successor is warm by now."""
        home = next((one for one in homes if one.successor is not None and one.successor.fileno == number), None)
        if home is None or home.successor is None:
            return None
        successor, was_warm = home.successor, home.successor.is_warm
        successor.pipe.flush()
        try:
            for word, what, result in successor.pipe.take():
                successor.since_ns = now_ns
                if word == "refused":
                    self._give_up(homes, f"{home.name} with loops: {'; '.join(result)}")
                    return None
                if word == "ready":
                    if what != LOOPS:
                        self._give_up(homes, "they cannot be loaded")
                        return None
                    successor.form = what
                    for sweep in home.latest.values():
                        successor.pipe.put(sweep.as_sent())
                        successor.unanswered += 1
                elif word in ("scan", "failed"):
                    successor.unanswered -= 1
        except EOFError:
            self._give_up(homes, f"{home.name} with loops has ended before it was ready")
            return None
        self._epoll.modify(number, select.EPOLLIN | (select.EPOLLOUT if successor.pipe.is_full else 0))
        if not successor.is_warm or was_warm:
            return None
        home.owed.appendleft(Handover())
        return home

    def taken(self, home: Home) -> Successor | None:
        """The successor, which serves from now on; None where there is none that could, then there is none any more."""
        successor, home.successor = home.successor, None
        if successor is None:
            return None
        home.owed = deque(work for work in home.owed if not isinstance(work, Handover))
        if successor.is_warm or not successor.form:
            return successor
        self._discard(successor)
        return None

    def close(self, homes: Sequence[Home]) -> list[Handle]:
        """End what is under way; the processes that have been ordered to end."""
        self.is_over = True
        if self._building is not None:
            self._building.close()
            self._building = None
        ended = [home.successor.handle for home in homes if home.successor is not None]
        self._drop(homes)
        return ended

    def _look_at_building(self, building: Building, now_ns: int) -> None:
        done = building.poll()
        if done is None:
            return
        self._building = None
        if done:
            self.loops, self._built_s = True, (now_ns - self._began_ns) * 1e-9
        else:
            self._give_up((), f"they could not be built ({building.why()})")
        building.close()

    def _start(self, homes: Sequence[Home], home: Home, now_ns: int) -> None:
        try:
            handle = self._launch(True)
        except OSError as error:
            self._give_up(homes, f"no process can be started: {error.strerror or error}")
            return
        home.successor = Successor(handle, Pipe(handle.pipe), handle.pipe.fileno(), now_ns)
        self._still = Stillness(now_ns)
        self._epoll.register(home.successor.fileno, select.EPOLLIN)

    def _judge(self, homes: Sequence[Home], home: Home, now_ns: int) -> None:
        """Give a successor up that does not get ready, by the limits of a process that serves."""
        assert home.successor is not None
        if home.successor.is_warm:
            return
        first = bool(home.successor.form)
        most_ns = time_limits.FIRST_SWEEP_NS if first else time_limits.BUILD_NS
        idle_ns = time_limits.IDLE_NS if first else time_limits.IDLE_BUILD_NS
        still_ns = self._still.look(now_ns, home.successor.handle.cpu_ns())
        if now_ns - home.successor.since_ns > most_ns or still_ns > idle_ns:
            self._give_up(homes, f"{home.name} with loops hung")

    def _give_up(self, homes: Sequence[Home], why: str) -> None:
        self.is_over, self.loops = True, False
        self._notes.append(NOT_USED.format(why))
        self._drop(homes)

    def _drop(self, homes: Sequence[Home]) -> None:
        for home in homes:
            if home.successor is not None:
                home.owed = deque(work for work in home.owed if home.holds(work) or not isinstance(work, Handover))
                self._discard(home.successor)
                home.successor = None

    def _discard(self, successor: Successor) -> None:
        self._epoll.unregister(successor.fileno)
        successor.pipe.close()
        successor.handle.kill()
