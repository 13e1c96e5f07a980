"""What is wrong with samples is defined, counted and told, and never an exception."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from emulator.live.book import Book, Rules
from emulator.live.json_lines import update_of
from emulator.live.samples import ActorSample, Update

MS = 1_000_000


def at(x: float, name: str = "car", **more: object) -> ActorSample:
    return ActorSample(name, (x, 0.0, 0.0), **more)  # type: ignore[arg-type]


def test_duplicates_and_late_updates_are_counted_and_change_nothing() -> None:
    book = Book(names=["car"])
    for ms, x in ((0, 0.0), (10, 0.1), (10, 7.0), (5, 9.0), (20, 0.2)):
        book.take(Update(None, (at(x),)), ms * MS)
    assert (book.counts["duplicate"], book.counts["out of order"]) == (1, 1)
    ((_, track),) = book.world(0.0, 1.0).tracks
    assert track.at_m[:, 0].tolist() == [0.0, 0.1, 0.2]


def test_actors_may_come_in_updates_of_their_own_at_one_instant() -> None:
    book = Book(names=["car", "ego"])
    book.take(Update(None, (at(1.0),)), 0)
    book.take(Update(None, (at(2.0, "ego"),)), 0)
    assert book.actors() == ["car", "ego"]
    assert book.counts["duplicate"] == 0


def test_gaps_of_sequence_numbers_are_lost_updates() -> None:
    book = Book(names=["car"])
    for seq in (1, 2, 5, 6):
        book.take(Update(None, (at(0.0),), seq=seq), seq * MS)
    assert book.counts["lost"] == 2


@pytest.mark.parametrize(
    "bad",
    [
        at(math.nan),
        at(math.inf),
        at(2e7),
        at(0.0, velocity_m_s=(math.nan, 0.0, 0.0)),
        at(0.0, size_m=(-1.0, 1.0, 1.0)),
        at(0.0, name=""),
        at(0.0, reference="roof"),
    ],
)
def test_numbers_that_cannot_be_drop_the_update(bad: ActorSample) -> None:
    book = Book(names=["car"])
    assert not book.take(Update(None, (bad,)), 0)
    assert book.counts["dropped"] == 1
    assert "want" in book.events[0][1]
    assert book.actors() == []


def test_an_actor_of_nobody_is_told_once() -> None:
    book = Book(names=["car"])
    for k in range(5):
        book.take(Update(None, (at(0.0, "ghost"),)), k)
    assert book.counts["not wanted"] == 5
    assert len(book.events) == 1


def test_ten_thousand_objects_fill_the_slots_and_no_more() -> None:
    book = Book(names=["car"], slots=[f"live_{k:02d}" for k in range(20)])
    book.take(Update(None, tuple(at(float(k), str(k)) for k in range(10_000))), 0)
    assert len(book.actors()) == 20
    assert book.counts["too many actors"] == 9980
    book.take(Update(None, (at(3.0, "9000"),), snapshot=True), MS)
    assert book.actors() == ["live_00"] or len(book.actors()) == 0  # the first such update found no slot free
    book.take(Update(None, (at(3.0, "9000"),), snapshot=True), 2 * MS)
    assert len(book.actors()) == 1


def test_removed_actors_are_gone_from_that_instant_and_may_come_again() -> None:
    book = Book(names=["car"])
    book.take(Update(None, (at(0.0),)), 0)
    book.take(Update(None, removed=("car",)), 100 * MS)
    book.take(Update(None, (at(5.0),)), 200 * MS)
    tracks = [track for _, track in book.world(0.0, 0.3).tracks]
    when = np.array([0.05, 0.15, 0.25])
    assert [one.there(when).tolist() for one in tracks] == [[True, False, False], [False, False, True]]
    assert book.counts["jumps"] == 0
    assert book.world(0.12, 0.15).gone == {"car"}


def test_an_id_that_is_something_else_now_is_removed_and_comes() -> None:
    book = Book(slots=["live_0", "live_1"], shape_of=lambda one: one.class_ or "box")
    book.take(Update(None, (at(0.0, "7", class_="car"),)), 0)
    book.take(Update(None, (at(0.0, "7", class_="pedestrian"),)), 100 * MS)
    shapes = [track.shape for _, track in book.world(0.0, 0.2).tracks]
    assert shapes == ["car", "pedestrian"]
    assert [text for _, text in book.events] == ["7 (live_0) comes", "7 (live_0) goes", "7 (live_0) comes"]


def test_a_restart_clears_what_was_spawned_and_the_next_pose_is_a_jump() -> None:
    book = Book(names=["car"], slots=["live_0"])
    book.take(Update(None, (at(0.0), at(1.0, "9"))), 0)
    book.take(Update(None, (at(0.1), at(1.0, "9"))), 100 * MS)
    book.restart(0.15, "restart")
    book.take(Update(None, (at(0.2),)), 200 * MS)
    assert book.actors() == ["car"]
    ((_, track), *_) = book.world(0.1, 0.3).tracks
    assert track.pose(np.array([0.19, 0.2]))[0][:, 0].tolist() == [0.1, 0.2]
    assert book.counts["restart"] == 1


def test_what_the_feeder_calls_its_own_is_bound() -> None:
    book = Book(names=["ego"], bind={"host": "ego", "entity:Target": "ego"})
    book.take(Update(None, (at(1.0, "14", host=True),)), 0)
    book.take(Update(None, (at(2.0, "14"),)), MS)
    assert book.actors() == ["ego"]
    assert book.counts["not wanted"] == 0


def test_ages_and_errors_of_extrapolation() -> None:
    book = Book(names=["car"])
    for k in range(10):
        book.take(Update(None, (at(0.2 * k, velocity_m_s=(20.0, 0.0, 0.0)),)), 10 * k * MS)
    book.asked(np.array([0.085, 0.09, 0.095, 0.1]))
    assert (book.ages.beams, book.ages.extrapolated) == (4, 2)
    book.take(Update(None, (at(2.05, velocity_m_s=(20.0, 0.0, 0.0)),)), 100 * MS)
    reported = book.ages.report()
    assert reported["error_mm"]["worst"] == pytest.approx(50.0, abs=0.01)  # type: ignore[index]
    assert reported["age_ms"]["worst"] == pytest.approx(10.0, abs=0.1)  # type: ignore[index]


def test_memory_is_bounded() -> None:
    book = Book(names=["car"])
    for k in range(20_000):
        book.take(Update(None, (at(0.01 * k, velocity_m_s=(1.0, 0.0, 0.0)),)), k * MS)
    ((_, track),) = book.world(0.0, 30.0).tracks
    assert len(track.t_s) <= 13_000
    assert not track.begins


def test_rules_come_from_outside() -> None:
    book = Book(Rules("hold", jump_m_s=1e6), names=["car"])
    book.take(Update(None, (at(0.0, velocity_m_s=(0.0, 0.0, 0.0)),)), 0)
    book.take(Update(None, (at(90.0, velocity_m_s=(0.0, 0.0, 0.0)),)), MS)
    assert book.counts["jumps"] == 0


def test_who_joins_late_finds_its_ego_by_name() -> None:
    book = Book(names=["me"], bind={"host": "me"})
    book.take(Update(None, (ActorSample("36", (1, 0, 0), name="Ego"),)), 0)
    assert book.actors() == ["me"]


@pytest.mark.parametrize(
    ("host", "guess", "actors", "found"),
    [
        (None, True, (("14", "Target"), ("3", "Ego")), "3"),
        (None, True, (("14", None), ("9", None), ("121", None)), "9"),
        (None, False, (("14", None), ("9", None)), None),
        ("14", True, (("14", None), ("9", None)), "14"),
        ("entity:Target", True, (("14", "Target"), ("9", "Ego")), "14"),
        ("Target", False, (("14", "Target"), ("9", "Ego")), "14"),
        (None, True, (("2", "car"), ("9", None)), "9"),
    ],
)
def test_who_never_heard_the_hosts_id_finds_the_ego(
    host: str | None, guess: bool, actors: tuple[tuple[str, str | None], ...], found: str | None
) -> None:
    book = Book(Rules(host=host, guess_host=guess), names=["me", "car"], bind={"host": "me"})
    reported = tuple(replace(at(1.0, one), name=name) for one, name in actors)
    book.take(Update(None, reported), 0)
    assert book.host == found
    assert ("me" in book.actors()) == (found is not None)
    guessed = [text for _, text in book.events if "the smallest id" in text]
    assert len(guessed) == (found == "9" and host is None)


def test_a_host_that_is_told_later_is_the_ego_from_then_on() -> None:
    book = Book(Rules(guess_host=True), names=["me"], bind={"host": "me"})
    book.take(Update(None, (at(1.0, "5"), at(2.0, "7"))), 0)
    assert book.host == "5"
    book.take(Update(None, (at(1.0, "5"), at(2.0, "7")), host="7"), 10_000_000)
    assert book.host == "7"


def test_a_flood_of_one_sort_of_news_hides_no_other() -> None:
    book = Book(names=("car",))
    for k in range(3000):
        book.take(update_of({"actors": [{"id": f"stranger {k}", "at_m": [0, 0, 0]}], f"key {k}": 1}), k * 1_000_000)
        book.refuse(f"actors.{k}.at_m: none; want [x, y, z]", k * 1e-3)
    book.restart(3.0, "restart")
    told = [text for _, text in book.events]
    assert len(told) == 61
    assert sum(text.endswith("; others are counted") for text in told) == 3
    assert told[-1] == "the feeder's clock: restart"
    assert (book.counts["not wanted"], book.counts["dropped"]) == (3000, 3000)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("turn_deg", [0.0, 2.0])
def test_how_wrong_an_extrapolation_was_is_that_of_its_track(stated: bool, turn_deg: float) -> None:
    """However it is computed: the quick way for what does not turn, and the track for the rest."""
    rng = np.random.default_rng(4)
    book, wrong = Book(names=("car",)), []
    for k in range(60):
        at = [0.1 * k + rng.normal(0.0, 0.004), rng.normal(0.0, 0.004), 0.0]
        row = {"id": "car", "at_m": at, "yaw_deg": turn_deg * k}
        row |= {"velocity_m_s": [10.0, 0.1, 0.0]} if stated else {}
        if k > 2:
            track = book.world(0.01 * k - 0.01, 0.01 * k).tracks[0][1]
            wrong.append(float(np.linalg.norm(track.pose(np.array([0.01 * k]))[0][0] - at)))
        book.take(update_of({"actors": [row]}), 10_000_000 * k)
        if k > 1:
            book.asked(np.array([0.01 * k + 0.005]))
    found = book.ages.report()["error_mm"]
    assert isinstance(found, dict)
    assert found["worst"] == pytest.approx(1e3 * max(wrong), abs=1e-3)
    assert found["median"] == pytest.approx(1e3 * np.median(wrong), rel=0.1)
