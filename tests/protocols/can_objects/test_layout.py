"""Frames packed as arrays against cantools, message by message: the DBC files are the only layout."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocols.can_objects.layout import Layout, MessageLayout, load
from protocols.errors import EncodeError
from tests.draws import cases

FILES = ("ars408.dbc", "ldmrs.dbc", "esr.dbc", "leddar_vu8.dbc", "leddar_m16.dbc")


def database(name: str) -> Any:
    text = files("protocols.can_objects").joinpath(name).read_text(encoding="utf-8")
    return cantools.database.load_string(text, database_format="dbc", strict=True)


DATABASES = {name: database(name) for name in FILES}
MESSAGES = sorted(
    (file_name, message.name)
    for file_name, found in DATABASES.items()
    for message in found.messages
    if not message.is_multiplexed() and not (message.name.startswith("Track_") and message.name > "Track_02")
)


@pytest.mark.parametrize(("file_name", "name"), MESSAGES)
@settings(max_examples=cases(15))
@given(data=st.data())
def test_frames_are_the_ones_that_cantools_packs(file_name: str, name: str, data: st.DataObject) -> None:
    layout = load(file_name)[name]
    rows = data.draw(
        st.lists(st.fixed_dictionaries({s.name: physical(s) for s in layout.signals.values()}), max_size=3)
    )
    columns = {signal: np.array([row[signal] for row in rows]) for signal in layout.signals}
    expected = [bytes(DATABASES[file_name].get_message_by_name(name).encode(row, strict=False)) for row in rows]
    assert layout.frames(len(rows), **columns) == expected
    assert [layout.frame(**row) for row in rows] == expected


def physical(signal: Any) -> st.SearchStrategy[float]:
    return st.integers(signal.raw_min, signal.raw_max).map(lambda raw: raw * signal.scale + signal.offset)


@pytest.mark.parametrize(("file_name", "name"), MESSAGES)
def test_values_beyond_a_signal_end_at_its_limits(file_name: str, name: str) -> None:
    layout = load(file_name)[name]
    for signal in layout.signals.values():
        low, high, none = layout.frames(3, **{signal.name: np.array([-1e12, 1e12, np.nan])})
        decode = DATABASES[file_name].get_message_by_name(name).decode
        slack = signal.scale * 1e-6
        assert decode(low, decode_choices=False)[signal.name] == pytest.approx(
            signal.raw_min * signal.scale + signal.offset, abs=slack
        )
        assert decode(high, decode_choices=False)[signal.name] == pytest.approx(
            signal.raw_max * signal.scale + signal.offset, abs=slack
        )
        assert none == low
        assert [layout.frame(**{signal.name: value}) for value in (-1e12, 1e12, float("nan"))] == [low, high, none]


@pytest.mark.parametrize(("file_name", "name"), MESSAGES)
def test_the_used_bytes_are_those_that_some_signal_changes(file_name: str, name: str) -> None:
    layout = load(file_name)[name]
    changed: set[int] = set()
    for signal in layout.signals.values():
        for bit in range(signal.bits):
            raw = 1 << bit
            if signal.raw_min < 0 and bit == signal.bits - 1:
                raw = -raw
            frame = layout.frame({signal.name: raw})
            changed |= {index for index, byte in enumerate(frame) if byte != layout.frame()[index]}
    assert changed == layout.used_bytes


@pytest.mark.parametrize("file_name", FILES)
def test_limits_and_used_bytes_of_a_file_read_anew_are_those_that_cantools_tells(file_name: str) -> None:
    layout = Layout(file_name)
    for name, message in layout.messages.items():
        reported = DATABASES[file_name].get_message_by_name(name)
        bits = [bit for bit, owner in enumerate(owners(reported)) if owner]
        assert message.used_bytes == {bit // 8 for bit in bits}
        assert set(message.signals) == {signal.name for signal in reported.signals}
        for signal in reported.signals:
            mine = message.signals[signal.name]
            assert (mine.name, mine.bits) == (signal.name, signal.length)
            assert mine.little_endian is (signal.byte_order == "little_endian")
            whole = 1 << signal.length
            low, high = (-whole // 2, whole // 2 - 1) if signal.is_signed else (0, whole - 1)
            # printed limits are those of the nearest raw values inside, to a thousandth of a step
            for limit, raw, end in ((signal.minimum, mine.raw_min, low), (signal.maximum, mine.raw_max, high)):
                if limit is None:
                    assert raw == end
                    continue
                wanted = (float(limit) - float(signal.offset)) / float(signal.scale)
                assert low <= raw <= high
                assert raw == end or abs(raw - wanted) < 0.999
                inside = raw - wanted if end == low else wanted - raw
                assert inside > -1e-3


def owners(message: Any) -> list[str]:
    """For each bit as it is sent, the signal that has it."""
    found = [""] * (8 * message.length)
    for signal in message.signals:
        for number in range(signal.length):
            if signal.byte_order == "little_endian":
                bit = signal.start + number
                place = 8 * (bit // 8) + 7 - bit % 8
            else:
                place = 8 * (signal.start // 8) + 7 - signal.start % 8 + number
            found[place] = signal.name
    return found


def test_all_esr_tracks_have_the_layout_of_the_first() -> None:
    messages = load("esr.dbc").messages
    tracks = [messages[f"Track_{number:02d}"] for number in range(1, 65)]
    assert [track.identifier for track in tracks] == list(range(0x500, 0x540))
    assert all(track.signals == tracks[0].signals for track in tracks)


@pytest.mark.parametrize(("name", "raw"), [("ObjId", 256), ("ObjId", -1), ("DynProp", 8)])
def test_a_raw_value_that_does_not_fit_is_our_own_fault(name: str, raw: int) -> None:
    message: MessageLayout = load("ars408.dbc")["ObjGeneral"]
    with pytest.raises(EncodeError, match=name):
        message.frames(2, {name: [0, raw]})
    with pytest.raises(EncodeError, match=name):
        message.frame({name: raw})


def test_a_signal_that_the_message_does_not_have_is_refused_with_those_it_has() -> None:
    with pytest.raises(EncodeError, match=r"ObjGeneral has no signal Speed; it has ObjId"):
        load("ars408.dbc")["ObjGeneral"].frame(Speed=1.0)


@pytest.mark.parametrize("name", FILES)
def test_every_layout_file_names_its_source(name: str) -> None:
    text = files("protocols.can_objects").joinpath(name).read_text(encoding="utf-8")
    assert 'CM_ "Source: ' in text
