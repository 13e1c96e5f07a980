"""No event is lost within the bound, and their order stays."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from protocols.session import Address, CommandHandled, Dropped, DropReason, Event, ModeChanged, Restarted
from protocols.skeleton.events import EventLog


@given(st.integers(1, 20), st.lists(st.integers(0, 40), max_size=8))
def test_each_take_gives_the_newest_up_to_the_bound_in_their_order(most: int, runs: list[int]) -> None:
    log, number = EventLog(most), 0
    for run in runs:
        put: list[Event] = []
        for _ in range(run):
            log.mode(number, f"mode {number}")
            put.append(ModeChanged(number, f"mode {number}"))
            number += 1
        assert len(log) == min(run, most)
        assert log.take() == put[-most:]
    assert log.take() == []


def test_each_word_makes_its_event() -> None:
    log, host = EventLog(), Address(0, 7)
    log.restarted(1)
    log.drop(2, DropReason.BAD_CHECKSUM, "of a line", 5)
    log.handled(3, "ID")
    log.unsent(4, DropReason.LATE, range(3, 6), "held up", 2, host)
    log.unsent(5, DropReason.LATE, range(3, 3))
    log.extend([ModeChanged(6, "idle")])
    log.add(ModeChanged(7, "off"))
    assert log.take() == [
        Restarted(1),
        Dropped(2, DropReason.BAD_CHECKSUM, "of a line", 5),
        CommandHandled(3, "ID", "done"),
        Dropped(4, DropReason.LATE, "held up", 3, range(3, 6), 2, host),
        ModeChanged(6, "idle"),
        ModeChanged(7, "off"),
    ]
