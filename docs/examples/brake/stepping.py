"""Time in a run of the scenario: steps of the car, and the scans that have come by then.

Imports little: a campaign starts a process with it for every case.
"""

from __future__ import annotations

import time
from typing import Protocol

from car import Car

from emulator.live.client import Lockstep

STEP = 0.02
"Of the vehicle model. [s]"
AHEAD = 3.3
"Drives begin so far from it in time at their speed, before the brake may act; and 5 m. [s]"
TIME_LIMIT = 20.0


class Host(Protocol):
    """Asks the scanner for its stream."""

    count: int
    "Scans so far."

    def start(self) -> None:
        """Ask for all scans."""

    def scans(self) -> list[list[tuple[float, float]]]:
        """What has come since the last call."""


class World:
    """A run of the scenario, and time in it."""

    def __init__(self, host: Host) -> None:
        self.host, self.t, self.waiting = host, 0.0, []

    def actor(self, car: Car, jump: bool = False) -> dict[str, object]:
        """The ego for the feed."""
        at = {"id": "ego", "at_m": [car.x, 0.0, 0.0], "velocity_m_s": [car.speed, 0.0, 0.0], "reference": "origin"}
        return at | ({"jump": True} if jump else {})


class Virtual(World):
    """By lock-step; a scan acts two steps after it was measured, when its last byte is there, in every run."""

    def __init__(self, host: Host, feed: str) -> None:
        super().__init__(host)
        self.world = Lockstep(feed)
        self.sent = [0, 0, 0]
        "Scans up to now, up to the step before, up to the one before that."

    def step(self, car: Car, jump: bool = False) -> list[list[tuple[float, float]]]:
        """Time goes on; the scans that have come."""
        self.t = round(self.t + STEP, 6)
        done = self.world.step(self.t, [self.actor(car, jump)])
        self.sent = [self.sent[0] + done["sent"]["front"], *self.sent[:2]]
        until = time.monotonic() + TIME_LIMIT
        while self.host.count < self.sent[2]:
            self.waiting += self.host.scans()
            if time.monotonic() > until:
                raise SystemExit("no scans")
        count = len(self.waiting) - (self.host.count - self.sent[2])
        found, self.waiting = self.waiting[:count], self.waiting[count:]
        return found


def begin(world: World) -> None:
    """The scanner streams, seen from the start."""
    world.host.start()
    time.sleep(0.1)  # in virtual time the request must be there before time moves
    car = Car(0.0, 1.0)
    while not world.step(car):
        if world.t > TIME_LIMIT:
            raise SystemExit("the scanner does not stream")
