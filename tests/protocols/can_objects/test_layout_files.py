"""A layout read anew from its DBC file says of every message and signal what cantools says."""

from __future__ import annotations

import math
from importlib.resources import files
from typing import Any

import cantools
import pytest

from protocols.can_objects import layout as layouts

FILES = ("ars408.dbc", "ldmrs.dbc", "esr.dbc", "leddar_vu8.dbc", "leddar_m16.dbc")


@pytest.fixture(params=FILES, scope="module")
def pair(request: pytest.FixtureRequest) -> tuple[layouts.Layout, Any]:
    text = files("protocols.can_objects").joinpath(request.param).read_text(encoding="utf-8")
    found = layouts.Layout(request.param)
    assert found.file_name == request.param
    return found, cantools.database.load_string(text, database_format="dbc", strict=True)


def test_every_message_has_its_identifier_length_and_cycle(pair: tuple[layouts.Layout, Any]) -> None:
    layout, database = pair
    assert set(layout.messages) == {one.name for one in database.messages if not one.is_multiplexed()}
    for message in database.messages:
        assert layout.identifier(message.name) == message.frame_id
        assert layout.length(message.name) == message.length
        assert layout.cycle_ns(message.name) == (message.cycle_time or 0) * 1_000_000
        assert layout.name_of(message.frame_id) == message.name
        if not message.is_multiplexed():
            one = layout[message.name]
            assert (one.name, one.identifier, one.length) == (message.name, message.frame_id, message.length)
    assert layout.name_of(0x7FF0) is None
    assert any(layout.cycle_ns(message.name) for message in database.messages) or layout.file_name != "ars408.dbc"


def test_every_signal_stands_where_the_file_has_it(pair: tuple[layouts.Layout, Any]) -> None:
    """Bits and limits, by what cantools packs into a frame when that signal alone is all ones."""
    layout, database = pair
    for message in (one for one in database.messages if not one.is_multiplexed()):
        found = layout[message.name]
        assert list(found.signals) == [signal.name for signal in message.signals]
        for signal in message.signals:
            one = found.signals[signal.name]
            assert (one.name, one.bits) == (signal.name, signal.length)
            assert (one.scale, one.offset) == (float(signal.scale), float(signal.offset))
            assert one.little_endian == (signal.byte_order == "little_endian")
            ones = -1 if signal.is_signed else 2**one.bits - 1
            whole = {each.name: 0 for each in message.signals} | {signal.name: ones}
            packed = message.encode(whole, scaling=False, strict=False)
            expected = int.from_bytes(packed, "little" if one.little_endian else "big")
            assert (2**one.bits - 1) << one.shift == expected, signal.name
            lowest = -(2 ** (one.bits - 1)) if signal.is_signed else 0
            low, high = lowest, lowest + 2**one.bits - 1
            if signal.minimum is not None:
                low = max(low, math.ceil(round((float(signal.minimum) - one.offset) / one.scale, 4)))
            if signal.maximum is not None:
                high = min(high, math.floor(round((float(signal.maximum) - one.offset) / one.scale, 4)))
            assert (one.raw_min, one.raw_max) == (low, high), signal.name


def test_short_frames_are_filled_with_zeros_and_long_ones_cut(pair: tuple[layouts.Layout, Any]) -> None:
    layout, database = pair
    for message in (one for one in database.messages if not one.is_multiplexed()):
        data = bytes(range(1, 1 + message.length))
        expected = message.decode(data, decode_choices=False)
        assert layout.decode(message.name, data) == layout.decode(message.name, data + b"\xff") == expected
        short = message.decode(data[:-1] + b"\0", decode_choices=False)
        assert layout.decode(message.name, data[:-1]) == short
        names = [one.name for one in layout.decoded_signals(message.name, data)]
        assert names == [signal.name for signal in message.signals]


def test_signals_are_decoded_as_text_with_their_units(pair: tuple[layouts.Layout, Any]) -> None:
    layout, database = pair
    for message in database.messages:
        data = bytes(17 * index & 0x3F for index in range(message.length - 1))
        values = message.decode(data + b"\0", decode_choices=True)
        expected = [
            (
                one.name,
                f"{values[one.name]:.6g}" if isinstance(values[one.name], float) else str(values[one.name]),
                one.unit,
            )
            for one in message.signals
            if one.name in values
        ]
        reported = layout.decoded_signals(message.name, data)
        assert [(one.name, one.value, one.unit or None) for one in reported] == expected
        assert all(isinstance(one.unit, str) for one in reported)


def test_messages_with_alternatives_are_packed_in_the_units_of_the_file(pair: tuple[layouts.Layout, Any]) -> None:
    layout, database = pair
    several = [one for one in database.messages if one.is_multiplexed()]
    for message in several:
        for number, names in layout.alternatives(message.name).items():
            chosen = [one for one in message.signals if one.multiplexer_ids and number in one.multiplexer_ids]
            assert names == tuple(one.name for one in chosen)
            base = {one.name: 0 for one in message.signals if not one.multiplexer_ids}
            base |= {one.name: number for one in message.signals if one.is_multiplexer}
            values = base | {one.name: one.scale * 3 + one.offset for one in chosen}
            frame = layout.encode(message.name, values)
            assert frame == bytes(message.encode(values, scaling=True, strict=False))
            read = message.decode(frame, decode_choices=False)
            for one in chosen:
                assert read[one.name] == pytest.approx(one.scale * 3 + one.offset)


@pytest.mark.parametrize(
    ("value", "raw"),
    [(math.nan, -8), (math.inf, 7), (-math.inf, -8), (1e300, 7), (-1e300, -8), (0.26, 1), (0.24, 0), (-0.26, -1)],
)
def test_one_value_and_many_become_the_same_number(value: float, raw: int) -> None:
    signal = layouts.SignalLayout("x", 0.5, 0.0, -8, 7, 4, True, 0)
    assert signal.quantise_one(value) == raw
    assert signal.quantise([value]).tolist() == [raw]
    assert signal.quantise([value]).dtype == "int64"
