"""Our own host of the LMS2xx: what it reads of telegrams beyond the common one, and that damage is counted."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.hosts.lms2xx import Lms2xxView, TelegramReader
from protocols.lms2xx.telegrams import (
    Header,
    all_values,
    range_and_intensity,
    range_and_reflectivity,
    read_values,
    reply,
)
from protocols.lms2xx.values import MEASURING_MODES

VIEW = Lms2xxView(MEASURING_MODES[0], 180, 1.0)
RANGES = np.array([800, 900, 1000], np.uint16)


def read(payload: bytes) -> TelegramReader:
    reader = TelegramReader()
    reader.feed(reply(payload, 0x10))
    return reader


@pytest.mark.parametrize(
    ("payload", "intensity"),
    [
        (all_values(RANGES, Header(3)), None),
        (range_and_intensity([(1, 3, Header(3), RANGES, np.array([5, 6, 7], np.uint16))]), [5.0, 6.0, 7.0]),
        (range_and_reflectivity(RANGES, Header(3), 1, 3, np.array([5, 6, 7], np.uint8)), [5.0, 6.0, 7.0]),
        (range_and_reflectivity(RANGES, Header(3), 2, 3, np.array([6, 7], np.uint8)), None),
    ],
)
def test_intensities_are_shown_where_every_beam_has_one(payload: bytes, intensity: list[float] | None) -> None:
    telegram = read(payload).take()
    assert telegram is not None
    values = read_values(telegram)
    assert values is not None
    scan = VIEW.decode(0, values)
    np.testing.assert_allclose(scan.range_m, [8.0, 9.0, 10.0])
    np.testing.assert_allclose(np.degrees(scan.azimuth_rad), [-90.0, -89.0, -88.0])
    assert scan.intensity is None if intensity is None else scan.intensity.tolist() == intensity  # type: ignore[union-attr]


def test_a_damaged_telegram_is_counted_and_the_next_one_read() -> None:
    whole = reply(all_values(RANGES, Header(3)), 0x10)
    damaged = bytearray(whole)
    damaged[7] ^= 1
    reader = TelegramReader()
    reader.feed(bytes(damaged) + whole)
    assert reader.take() is not None
    assert reader.take() is None
    assert reader.errors == 1
