"""A scenario that the page itself has started: a daemon of ours with built-in hosts, which can begin again.

Belongs here: starting and ending them. Not: asking the daemon (live), the hosts (guests).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

from emulator.runtime.own_daemon import own_daemon
from emulator.scenario.scenario import Scenario
from emulator.view.frames import Frame
from emulator.view.guests import Guests, free_links
from emulator.view.live import LiveSource

LONG_S = 1e8
"A daemon of our own goes on until the page is closed: at the scenario's end its time stands."


class OwnSource:
    """A daemon on a scenario at real time's pace. `frame` and `order` may be called from different threads."""

    length_s: float | None = None
    can_restart = True

    def __init__(self, scenario: str, tell: Callable[[str], None]) -> None:
        """Raises `DaemonError` when it does not start."""
        self._scenario, self._tell = scenario, tell
        self._held: ExitStack
        self._source: LiveSource
        self._held, self._source = self._started()

    def _started(self) -> tuple[ExitStack, LiveSource]:
        with ExitStack() as held:
            options = ["--speed", "1", f"--duration={LONG_S}"]
            links = self._scenario
            daemon = held.enter_context(own_daemon(links, options, lambda at: free_links(links, at), self._heard))
            guests = Guests(daemon.ready["sensors"], self._tell)
            held.callback(guests.close)
            source = LiveSource(daemon.control, daemon)
            source.stand_at_end()
            return held.pop_all(), source

    def _heard(self, event: Mapping[str, Any]) -> None:
        if event.get("event") == "incident":
            self._tell("{at_s:.3f} s: {on}: {kind}: {text}".format_map(event))

    @property
    def title(self) -> str:
        """The scenario's name."""
        return self._source.title

    @property
    def scenario(self) -> Scenario:
        """As the daemon has it."""
        return self._source.scenario

    @property
    def failed(self) -> bool:
        """Whether the present daemon has ended, and not as asked."""
        return self._source.failed

    def frame(self) -> Frame:
        """What the daemon has now."""
        source = self._source
        found = source.frame()
        return found if source is self._source else self._source.frame()  # it has begun again meanwhile

    def order(self, method: str, params: Mapping[str, Any]) -> Any:
        """An order to the daemon; `restart` begins the scenario again, on links of its own."""
        if method != "restart":
            return self._source.order(method, params)
        held, (self._held, self._source) = self._held, self._started()  # the old one shows until the new one runs
        held.close()
        return {"now_s": 0.0}

    def close(self) -> None:
        """End the daemon and the hosts."""
        self._held.close()
