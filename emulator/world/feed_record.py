"""What a feed may move in a scenario: the book of its samples, as a run keeps it and as a recording is read again.

Belongs here: names, slots and shapes of a scenario for a book of poses. Not: the book itself (live), who feeds it
(runtime).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from emulator.live.book import Book, Rules
from emulator.live.files import read
from emulator.live.samples import ActorSample
from emulator.live.tracks import World
from emulator.scenario.live_options import LiveActors
from emulator.scenario.scenario import Scenario

BEFORE_S = 0.005
"So long around instants tracks are handed over: of velocities."


def book_of(scenario: Scenario, keep_all: bool = False) -> Book:
    """Of a scenario with `live:`. `keep_all`: nothing is forgotten, as of a file that is wholly known."""
    live = scenario.live
    assert live is not None
    names = [actor.id for actor in scenario.actors]
    if live.actors.fed is not None:
        names = [name for name in names if name in live.actors.fed]
    bind = dict(live.bind) | ({} if live.ego is None else {"host": live.ego})
    guess = live.place.kind.startswith("osi-")
    rules = Rules(live.between, live.silent.after_s, live.silent.then, live.jump_m_s, live.host, guess, keep_all)
    return Book(rules, names, bind, live.spawn_slots, live.static_slots, shape_of(live.actors))


def shape_of(actors: LiveActors) -> Callable[[ActorSample], str]:
    """Of an actor that is not in the scenario: by its model, its class, else a box, or nothing."""

    def chosen(one: ActorSample) -> str:
        model = "" if one.model is None else one.model.replace("\\", "/").rpartition("/")[2].rpartition(".")[0]
        model = model or (one.model or "")
        if model in actors.models:
            return actors.models[model]
        if one.class_ in actors.classes:
            return str(one.class_)
        return "box" if actors.unknown == "box" else "none"

    return chosen


class Played:
    """The feed of a recording, wholly known: where everything was, with hindsight."""

    def __init__(self, scenario: Scenario, recording: Path) -> None:
        """`ScenarioError` where it cannot be read."""
        self.book = book_of(scenario, keep_all=True)
        for reported in read("recording", recording):
            self.book.take(reported.update, reported.run_ns, reported.again)

    def world(self, begin_s: float, end_s: float) -> World:
        """Everything from `begin_s` to `end_s`."""
        return self.book.world(begin_s - BEFORE_S, end_s + BEFORE_S)
