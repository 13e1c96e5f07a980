"""What hosts may send: anything. Nothing raises, everything is counted, and the lists go on."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocols.can_objects import FORMATS
from protocols.session import Address, CommandHandled, Dropped, DropReason, ModeChanged, Restarted
from tests.draws import cases
from tests.protocols.can_objects.rig import Rig, crowd, decoded, lines, lists, start

LISTENING = {"ars408": 0x200, "ldmrs": 0x50A, "esr": 0x4F1, "leddar_vu8": 0x740, "leddar_m16": 0x740}
IDENTIFIERS = [0x200, 0x202, 0x300, 0x301, 0x400, 0x401, 0x50A, 0x303, 0x304, 0x306, 0x4F0, 0x4F1, 0x740]

frames = st.tuples(
    st.sampled_from(IDENTIFIERS) | st.integers(0, 0x7FF) | st.integers(1 << 31, (1 << 31) + 0x1FFFFFFF),
    st.binary(max_size=8) | st.lists(st.sampled_from([0, 1, 2, 0x10, 0x12, 0x7F, 0xFF]), max_size=8).map(bytes),
    st.integers(0, 120_000_000),
)


@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=cases(40))
@given(said=st.lists(frames, max_size=20))
def test_no_frame_of_a_host_disturbs_a_device_beyond_what_it_may(name: str, said: list[tuple[int, bytes, int]]) -> None:
    rig = start({"format": name}, crowd(5))
    for identifier, data, pause_ns in said:
        rig.session.receive(data, rig.now_ns, Address(0, identifier))
        rig.run(pause_ns * 1e-9)
    rig.run(0.2)
    dues = [emission.due_ns for emission in rig.sent]
    assert dues == sorted(dues)
    assert all(len(emission.payload) <= 8 for emission in rig.sent)
    for emission in rig.sent:
        assert emission.address is not None
        assert 0 <= emission.address.peer <= 0x7FF
    known = CommandHandled | Dropped | ModeChanged | Restarted
    assert all(isinstance(event, known) for event in rig.events)
    complete(rig)


def complete(rig: Rig) -> None:
    """Every ARS408 list that was begun and followed by another is whole."""
    if rig.session.LAYOUT_FILE != "ars408.dbc":
        return
    for group in lists(rig.sent)[:-1]:
        count = decoded(rig, group, "ObjListHeader")[0]["NumObjects"]
        assert sum(emission.label == "ObjGeneral" for emission in group) == count


@pytest.mark.parametrize("name", FORMATS)
def test_frames_of_others_are_told_once_and_counted_after_that(name: str) -> None:
    rig = start({"format": name})
    rig.run(0.1)
    for _ in range(7):
        rig.hear("123 01 02 03")
        rig.hear("124")
    rig.run(1.0)
    foreign = [event for event in rig.events if isinstance(event, Dropped) and event.reason is DropReason.OTHER_ADDRESS]
    assert [event.count for event in foreign] == [1, 1, 12]
    assert "0x123" in foreign[0].detail


@pytest.mark.parametrize("name", FORMATS)
def test_an_extended_identifier_is_another_one(name: str) -> None:
    rig = start({"format": name})
    rig.run(0.1)
    rig.session.receive(bytes(8), rig.now_ns, Address(0, LISTENING[name] | 1 << 31))
    rig.events += rig.session.take_events()
    assert rig.dropped()[-1] is DropReason.OTHER_ADDRESS


@pytest.mark.parametrize("name", FORMATS)
def test_a_booting_device_hears_nothing(name: str) -> None:
    rig = start({"format": name})
    rig.session.power_on(rig.now_ns)
    rig.session.receive(bytes(8), rig.now_ns + 1, Address(0, LISTENING[name]))
    assert [event.reason for event in rig.session.take_events() if isinstance(event, Dropped)] == [DropReason.BOOTING]


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_no_frame_is_dropped_by_its_length(name: str) -> None:
    rig = start({"format": name})
    rig.run(0.1)
    rig.session.receive(bytes(9), rig.now_ns, Address(0, LISTENING[name]))
    rig.session.receive(b"", rig.now_ns, Address(0, LISTENING[name]))
    rig.session.receive(bytes(8), rig.now_ns, None)
    rig.events += rig.session.take_events()
    assert rig.dropped() == [DropReason.BAD_LENGTH] * 3


@pytest.mark.parametrize("name", FORMATS)
def test_a_device_that_is_off_is_deaf_and_silent(name: str) -> None:
    from protocols.can_objects import FAMILY

    session = FAMILY.new_session({"format": name}, {})
    session.receive(bytes(8), 5, Address(0, LISTENING[name]))
    session.advance(10**12)
    assert (session.take_emissions(10**12), session.take_events(), session.next_plan(), session.next_deadline()) == (
        [],
        [],
        None,
        None,
    )


def test_an_answer_goes_to_the_link_that_asked_and_the_state_to_all() -> None:
    rig = start({"format": "ldmrs"}, links=2)
    rig.run(0.1)
    rig.hear("50A 20 00", link=1)
    replies = [emission for emission in rig.run(0.05) if emission.label == "Reply"]
    assert [emission.address.link for emission in replies if emission.address] == [1]


def test_an_answer_does_not_wait_for_the_end_of_a_long_list() -> None:
    rig = start({"format": "ars408"}, crowd(100))
    rig.run(0.03)  # in the middle of a list
    asked_ns = rig.now_ns
    rig.hear("202 8E 00 00 03 20 00 00 00")
    answers = [e for e in rig.run(0.01) if e.label in ("FilterStateHeader", "FilterState")]
    assert len(answers) == 2
    assert answers[0].due_ns - asked_ns < 300_000
    assert lists(rig.run(0.2))[0] != []


@pytest.mark.parametrize("name", FORMATS)
def test_the_same_input_gives_the_same_frames(name: str) -> None:
    def run() -> list[str]:
        device: dict[str, Any] = {"format": name}
        rig = start(device, crowd(30))
        for k in range(10):
            rig.hear(f"{LISTENING[name]:03X} 03 00 00 00 00 00 00 0{k}")
            rig.run(0.07)
        return [f"{emission.due_ns} {text}" for emission, text in zip(rig.sent, lines(rig.sent), strict=True)]

    assert run() == run()
