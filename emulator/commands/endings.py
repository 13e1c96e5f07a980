"""When a run will end and why it has ended: what `run` says of it at `ready` and at its end.

Belongs here: words. Not: what ends a run (daemon, virtual_daemon).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from emulator.scenario.scenario import Scenario


@dataclass(frozen=True)
class Ending:
    """When a run ends by itself."""

    at_s: float | None
    "Seconds after `ready`; None: it goes on until it is stopped."
    by: str
    "Who says so: the command line's or the scenario's key; empty where nobody does."
    round_s: float | None
    "The world begins again after so long; None: never."

    @classmethod
    def of(cls, scenario: Scenario, duration_s: float | None) -> Ending:
        """Of a run with `--duration` or without."""
        if duration_s is not None:
            return cls(duration_s, "--duration", scenario.round_s)
        if scenario.loop or scenario.duration_s is None:
            return cls(None, "", scenario.round_s)
        return cls(scenario.duration_s, "duration_s of the scenario", None)

    @property
    def until_ns(self) -> int | None:
        """For the daemon."""
        return None if self.at_s is None else int(self.at_s * 1e9)

    def as_json(self) -> dict[str, object]:
        """Keys of `ready`."""
        return {"ends_at_s": self.at_s, "ends_by": self.by or None, "round_s": self.round_s}

    def reported(self) -> str:
        """One line for a user."""
        again = "" if self.round_s is None else f"; the world begins again every {self.round_s:g} s"
        if self.at_s is None:
            return f"runs until it is stopped{again}"
        way = "; --loop begins the world again instead" if self.by.startswith("duration_s") else again
        return f"ends after {self.at_s:g} s ({self.by}){way}"
