"""The last value that a codec takes and the first that it refuses; what it makes of NaN, infinity and nothing."""

from __future__ import annotations

import numpy as np
import pytest

from protocols.checksums import TABLE_BYTES, crc16_lms, crc16_lms_by_steps, sum8
from protocols.errors import EncodeError
from protocols.lms2xx import outputs
from protocols.lms2xx import telegrams as wire
from protocols.lms2xx.values import MEASURING_MODES, intensity_words, reflectivity_bytes, reflectivity_words
from protocols.scan import DAZZLED, SATURATED, Scan, ScanPlan

NO_FLAGS = np.zeros(4, np.uint8)
STRANGE = np.array([np.nan, np.inf, 0.5, 1.0])


def test_addresses_and_lengths_end_where_the_frame_does() -> None:
    assert wire.frame(0, b"\x31")[1] == 0
    assert wire.frame(255, b"\x31")[1] == 255
    assert wire.frame(0, bytes(65_535))[2:4] == b"\xff\xff"
    for address, payload, reported in (
        (-1, b"1", "address -1, payload of 1 bytes"),
        (256, b"1", "address 256"),
        (0, b"", "payload of 0 bytes"),
        (0, bytes(65_536), "payload of 65536 bytes"),
    ):
        with pytest.raises(EncodeError, match=reported):
            wire.frame(address, payload)


@pytest.mark.parametrize("extra", [-1, 0, 1, 300])
def test_long_messages_have_the_checksum_of_the_listing(extra: int) -> None:
    data = bytes(index * 37 & 0xFF for index in range(TABLE_BYTES + extra))
    assert crc16_lms(data) == crc16_lms_by_steps(data)


def test_a_sum_is_taken_modulo_256() -> None:
    assert sum8(b"\xff\xff\x03") == 1
    assert sum8(b"") == 0


def reported(payload: bytes, indices: bytes = b"", status: int = 0x10) -> wire.MeasuredValues:
    found = wire.open_frame(wire.reply(payload + indices, status))
    assert found is not None
    values = wire.read_values(found)
    assert values is not None
    return values


WORDS = np.array([100, 200, 300], np.uint16)
MORE = np.array([7, 8, 9], np.uint16)
HEADER = wire.Header(3, 1)


@pytest.mark.parametrize(
    ("payload", "command", "first", "scans", "extra"),
    [
        (wire.all_values(WORDS, HEADER), 0xB0, 1, 1, []),
        (wire.mean_values(5, WORDS, HEADER), 0xB6, 1, 5, []),
        (wire.sub_range(41, 43, WORDS, HEADER), 0xB7, 41, 1, []),
        (wire.mean_sub_range(250, 300, 302, WORDS, HEADER), 0xBF, 300, 250, []),
        (wire.range_and_reflectivity(WORDS, HEADER, 2, 3, np.array([11, 255], np.uint8)), 0xC4, 1, 1, [11, 255]),
        (wire.range_and_intensity([(4, 6, HEADER, WORDS, MORE)]), 0xF5, 4, 1, [7, 8, 9]),
    ],
)
@pytest.mark.parametrize("indices", [b"", b"\x11\x22"])
def test_every_telegram_of_values_is_read_back_whole(
    payload: bytes, command: int, first: int, scans: int, extra: list[int], indices: bytes
) -> None:
    found = reported(payload, indices)
    assert (found.command, found.header, found.first, found.scans) == (command, HEADER, first, scans)
    assert found.values.tolist() == WORDS.tolist()
    assert found.extra.tolist() == extra
    assert found.values.dtype == found.extra.dtype == np.uint16
    assert found.indices == ((0x11, 0x22) if indices else None)
    assert found.status == 0x10


def test_of_several_groups_the_first_is_read() -> None:
    found = reported(wire.range_and_intensity([(4, 6, HEADER, WORDS, MORE), (10, 12, HEADER, MORE, WORDS)]))
    assert (found.first, found.values.tolist(), found.extra.tolist()) == (4, [100, 200, 300], [7, 8, 9])


def test_the_shortest_telegram_of_values_holds_none() -> None:
    found = reported(wire.all_values(WORDS[:0], wire.Header(0)))
    assert (found.values.tolist(), found.extra.tolist(), found.status) == ([], [], 0x10)
    assert wire.read_values(wire.Telegram(0x80, 0xB0, b"\x00\x00")) is None


@pytest.mark.parametrize(("behind", "reported"), [(0, False), (1, True), (2, False), (3, True), (4, False), (7, False)])
def test_behind_the_values_stand_one_byte_or_three(behind: int, reported: bool) -> None:
    data = HEADER.encode() + wire.value_bytes(WORDS)
    assert (wire.read_values(wire.Telegram(0x80, 0xB0, data + bytes(behind))) is not None) is reported
    assert wire.read_values(wire.Telegram(0x80, 0xB0, data[:-1])) is None
    assert wire.read_values(wire.Telegram(0x80, 0xA0, data + bytes(behind))) is None


def test_no_echo_has_no_reflectivity_and_more_than_all_light_has_the_most() -> None:
    assert reflectivity_words(STRANGE, NO_FLAGS).tolist() == [0, 65_535, 50, 100]
    assert reflectivity_words(np.array([655.34, 655.36, 1e6]), NO_FLAGS[:3]).tolist() == [65_534, 65_535, 65_535]
    assert reflectivity_words(None, NO_FLAGS).tolist() == [0, 0, 0, 0]
    assert reflectivity_words(None, NO_FLAGS).dtype == reflectivity_words(STRANGE, NO_FLAGS).dtype == np.uint16
    assert reflectivity_bytes(STRANGE, NO_FLAGS).tolist() == [0, 254, 50, 100]


def test_no_echo_has_no_intensity_and_the_strongest_ends_the_scale() -> None:
    raw, normal = MEASURING_MODES[0x0E], MEASURING_MODES[0x0D]
    words = intensity_words(np.array([np.nan, np.inf, 1.0, 63.0, 64.0, 0.5]), np.ones(6), raw)
    assert words.tolist() == [0, 13_000, 7000, 12_977, 13_000, 7000]
    assert intensity_words(np.ones(4), STRANGE, normal).tolist() == [0, 65_000, 500, 1000]
    assert intensity_words(np.ones(3), np.array([65.4, 65.6, 1e9]), normal).tolist() == [65_400, 65_535, 65_535]
    assert words.dtype == intensity_words(np.ones(4), STRANGE, normal).dtype == np.uint16


def plan(beams: int) -> ScanPlan:
    return ScanPlan(0, 0, 0, np.zeros(beams), np.zeros(beams), np.zeros(beams))


def test_a_sweep_without_room_for_echoes_has_none() -> None:
    flags = np.array([0, DAZZLED, 0], np.uint8)
    for range_m in (np.zeros((3, 0)), np.zeros(3)):
        found = outputs.nearest(Scan(plan(3), range_m, range_m, flags, np.full((3, 1), -1, np.int32)))
        assert np.isnan(found.range_m).tolist() == np.isnan(found.intensity).tolist() == [True] * 3
        assert found.flags.tolist() == flags.tolist()


def test_a_mean_keeps_what_any_of_its_scans_told() -> None:
    mean = outputs.Mean(4, 10.0)
    nan = np.nan
    first = outputs.Measured(
        np.array([10.0, nan, nan, 2.0]), np.ones(4), np.array([SATURATED, DAZZLED, 0, DAZZLED], np.uint8)
    )
    second = outputs.Measured(np.array([10.0, nan, nan, 4.0]), np.ones(4), np.array([0, 0, 0, 0], np.uint8))
    mean.add(first)
    mean.add(second)
    result = mean.result()
    assert result.range_m[0] == 10.0
    assert np.isnan(result.range_m[1:]).all(), "the last beam: half of its single values are missing"
    assert result.flags.tolist() == [SATURATED, DAZZLED, 0, 0]
    assert result.flags.dtype == np.uint8


@pytest.mark.parametrize("unit", [0, 1])
def test_every_telegram_of_values_tells_its_unit_and_its_own_beams(unit: int) -> None:
    form = outputs.Format(MEASURING_MODES[0x0D], unit, False, 100.0)
    measured = outputs.Measured(np.array([1.0, 2.0, 3.0, 4.0]), np.full(4, 25.0), NO_FLAGS)
    centimetres = np.array([100, 200, 300, 400]) * (10 if unit else 1)
    for command, groups, beams in (
        (outputs.ALL, (), [0, 1, 2, 3]),
        (outputs.MEAN, (), [0, 1, 2, 3]),
        (outputs.SUB_RANGE, ((2, 3),), [1, 2]),
        (outputs.MEAN_SUB_RANGE, ((1, 2),), [0, 1]),
        (outputs.REFLECTIVITY, ((2, 4),), [0, 1, 2, 3]),
        (outputs.INTENSITY, ((2, 4),), [1, 2, 3]),
    ):
        found = reported(outputs.encode(outputs.Output(command, 1, groups), measured, form, None))
        assert found.header == wire.Header(len(beams), unit), hex(command)
        assert found.values.tolist() == centimetres[beams].tolist(), hex(command)
    reflectivity = outputs.encode(outputs.Output(outputs.REFLECTIVITY, 1, ((2, 4),)), measured, form, None)
    assert reported(reflectivity).extra.tolist() == [100, 225, 254]  # 25 R^2 / 100, in per cent


def test_modes_with_reflector_bits_tell_them_in_every_telegram() -> None:
    form = outputs.Format(MEASURING_MODES[0x01], 1, False, 100.0)
    measured = outputs.Measured(np.array([1.0, 2.0, 3.0, 4.0]), np.full(4, 100.0), NO_FLAGS)  # 1, 4, 9, 16 x white
    found = reported(outputs.encode(outputs.Output(outputs.ALL), measured, form, None))
    assert (found.values >> 13).tolist() == [0, 2, 3, 4]
    assert (found.values & 0x1FFF).tolist() == [1000, 2000, 3000, 4000]
