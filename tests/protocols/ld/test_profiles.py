"""Profiles: published bytes, every combination of format bits read by a stranger, and the rounding of values."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.ld.profiles import ALL_FIELDS, Revolution, distance_words, echo_words, encode_profile, layout
from protocols.ld.sectors import Function, Sector, Span, check, spans, table_of
from protocols.ld.usp import encode_frame
from tests.protocols.ld.reader import read_profile

N, NONE = Function.NORMAL, Function.NO_MEASUREMENT

EXAMPLE_SPANS = spans(table_of([Sector(N, 1456), Sector(NONE, 1432)]), 8)
EXAMPLE = Revolution(
    count=7,
    distances=np.array([0x0A00, 0x0A0A, 0x0A14], np.uint16),
    echoes=np.array([100, 101, 102], np.uint16),
    start_ms=[5000, 5000],
    end_ms=[5000, 5100],
    status=(0, 3),
)

WORKED = {
    # recomputed in the protocol's description, one layer (UPS p. 32): two sectors, 90..91 degrees in steps of 0.5,
    # profile 1, counter 7
    0x39FF: """02 55 53 50 00 00 00 32 83 01 39 ff 01 02 00 01 00 07 00 00
               00 00 00 08 00 03 13 88 05 a0 0a 00 0a 0a 0a 14 13 88 05 b0
               00 01 00 08 00 00 13 88 05 b8 13 ec 05 98 00 00 00 03 00""",
    0x3DFF: """02 55 53 50 00 00 00 38 83 01 3d ff 01 02 00 01 00 07 00 00
               00 00 00 08 00 03 13 88 05 a0 0a 00 00 64 0a 0a 00 65 0a 14 00 66 13 88 05 b0
               00 01 00 08 00 00 13 88 05 b8 13 ec 05 98 00 00 00 03 63""",
    0x3FFF: """02 55 53 50 00 00 00 3e 83 01 3f ff 01 02 00 01 00 07 00 00
               00 00 00 08 00 03 13 88 05 a0 0a 00 05 a0 00 64 0a 0a 05 a8 00 65 0a 14 05 b0 00 66 13 88 05 b0
               00 01 00 08 00 00 13 88 05 b8 13 ec 05 98 00 00 00 03 dc""",
    0x0100: "02 55 53 50 00 00 00 0c 83 01 01 00 01 02 0a 00 0a 0a 0a 14 94",
    0x00B0: "02 55 53 50 00 00 00 12 83 01 00 b0 01 02 00 08 00 03 05 a0 00 08 00 00 05 b8 2a",
}


@pytest.mark.parametrize("form", WORKED)
def test_a_worked_profile_has_these_bytes(form: int) -> None:
    payload = encode_profile(layout(form, EXAMPLE_SPANS, 8), 1, EXAMPLE)
    assert encode_frame(payload) == bytes.fromhex(WORKED[form])


SIZES = [
    # measured points, sectors, payload bytes of 39FF, 3DFF, 3FFF, 0100
    (181, 2, 406, 768, 1130, 368), (361, 2, 766, 1488, 2210, 728), (721, 2, 1486, 2928, 4370, 1448),
    (1081, 2, 2206, 4368, 6530, 2168), (1440, 1, 2910, 5790, 8670, 2886), (2880, 1, 5790, 11550, 17310, 5766),
]  # fmt: skip


@pytest.mark.parametrize(("points", "sectors", "ranges", "echoes", "everything", "bare"), SIZES)
def test_profiles_have_the_published_sizes(
    points: int, sectors: int, ranges: int, echoes: int, everything: int, bare: int
) -> None:
    found = [Span(number, N, 0, 0, 0, 0, points if number == 0 else 0) for number in range(sectors)]
    sizes = [layout(form, found, 2).size for form in (0x39FF, 0x3DFF, 0x3FFF, 0x0100)]
    assert sizes == [ranges, echoes, everything, bare]


@st.composite
def geometries(draw: st.DrawFn) -> tuple[tuple[Span, ...], int]:
    """Legal sectors at a legal step, up to eight of them, four measuring."""
    step = draw(st.sampled_from([8, 12, 16, 24, 48, 96, 320, 1440]))
    cuts = draw(st.lists(st.integers(0, 5760 // step - 1), min_size=1, max_size=8, unique=True))
    first = draw(st.integers(0, len(cuts) - 1))
    ordered = sorted(cuts)
    stops = [step * mark for mark in ordered[first:] + ordered[:first]]
    active = draw(st.lists(st.sampled_from([N, NONE, Function.REFERENCE]), min_size=len(stops), max_size=len(stops)))
    table = table_of([Sector(function, stop) for function, stop in zip(active, stops, strict=True)])
    if check(table, 5, step) != 0:
        table = table_of([Sector(N, stops[0])])
    return spans(table, step), step


@given(st.integers(0, ALL_FIELDS), geometries(), st.integers(0, 70_000), st.integers(0, 0xFFFF))
def test_a_stranger_reads_every_combination_of_fields(
    form: int, geometry: tuple[tuple[Span, ...], int], sent: int, seed: int
) -> None:
    sectors, step = geometry
    points = [span.points for span in sectors]
    values = np.random.default_rng(seed)
    revolution = Revolution(
        count=seed,
        distances=values.integers(0, 65536, sum(points), np.uint16),
        echoes=values.integers(0, 65536, sum(points), np.uint16),
        start_ms=values.integers(0, 65536, len(points)).tolist(),
        end_ms=values.integers(0, 65536, len(points)).tolist(),
        status=(0, 3),
    )
    made = layout(form, sectors, step)
    payload = encode_profile(made, sent, revolution)
    assert len(payload) == made.size
    profile = read_profile(payload, points)
    assert (profile.form, profile.layers, len(profile.sectors)) == (form, 1, len(sectors))
    assert profile.sent == (sent & 0xFFFF if form & 1 else None)
    assert profile.counter == (seed if form & 2 else None)
    assert profile.layer == (0 if form & 4 else None)
    assert profile.status == (3 if form & 0x2000 else None)
    at = 0
    for index, (sector, span) in enumerate(zip(profile.sectors, sectors, strict=True)):
        assert sector.number == (index if form & 0x0008 else None)
        assert sector.step == (step if form & 0x0010 else None)
        assert sector.count == (span.points if form & 0x0020 else None)
        assert sector.start_ms == (revolution.start_ms[index] if form & 0x0040 else None)
        assert sector.start == (span.start if form & 0x0080 else None)
        assert sector.end_ms == (revolution.end_ms[index] if form & 0x0800 else None)
        assert sector.end == (span.stop if form & 0x1000 else None)
        part = slice(at, at + span.points)
        assert sector.distances == (revolution.distances[part].tolist() if form & 0x0100 else [])
        directions = [(span.start + step * beam) % 5760 for beam in range(span.points)]
        assert sector.directions == (directions if form & 0x0200 else [])
        assert sector.echoes == (revolution.echoes[part].tolist() if form & 0x0400 else [])  # type: ignore[index]
        at += span.points


@pytest.mark.parametrize(
    ("range_m", "word"),
    [
        (10.0, 0x0A00),
        (0.5, 128),
        (10 + 0.5 / 256, 0x0A01),  # half up
        (np.nextafter(10 + 0.5 / 256, 0), 0x0A00),
        (250.0, 0xFA00),
        (65535 / 256, 65535),
        (65535.4 / 256, 0),  # beyond the wire: no echo, never wrapped
        (256.0, 0),
        (1e9, 0),
        (np.inf, 0),
        (np.nan, 0),
        (-1.0, 0),
        (0.0, 0),
    ],
)
def test_a_range_becomes_this_word(range_m: float, word: int) -> None:
    assert distance_words(np.array([range_m])).tolist() == [word]


@given(st.floats(0.01, 255.99))
def test_a_range_is_off_by_at_most_half_a_step(range_m: float) -> None:
    (word,) = distance_words(np.array([range_m]))
    assert abs(int(word) / 256 - range_m) <= 1 / 512


def test_an_echo_beyond_the_model_is_none() -> None:
    assert distance_words(np.array([249.9, 250.0, 250.1]), 250.0).tolist() == [63974, 64000, 0]


def test_a_model_that_sees_farther_than_the_wire_can_tell_does_not_wrap() -> None:
    assert distance_words(np.array([255.0, 256.0, 300.0]), 1000.0).tolist() == [65280, 0, 0]


@pytest.mark.parametrize(("sent", "word"), [(1, 1), (65535, 65535), (65536, 0), (10**6, 16960)])
def test_the_running_number_of_profiles_wraps(sent: int, word: int) -> None:
    payload = encode_profile(layout(0x0001, EXAMPLE_SPANS, 8), sent, EXAMPLE)
    assert read_profile(payload).sent == word


def test_the_amplitude_grows_in_proportion_and_never_wraps() -> None:
    found = distance_words(np.full(7, 10.0))
    words = echo_words(np.array([1.0, 2.0, 6.25, 4095.9, 1e12, np.nan, 0.001]), found)
    assert words.tolist() == [16, 32, 100, 65534, 65535, 0, 1]
    assert echo_words(np.array([50.0]), np.array([0], np.uint16)).tolist() == [0]


def test_a_scan_without_echoes_is_a_profile_of_zeros() -> None:
    # `Scan.empty` is NaN throughout; warnings of numpy would be errors here
    nothing = np.full(3, np.nan)
    assert distance_words(nothing).tolist() == [0, 0, 0]
    assert echo_words(nothing, distance_words(nothing)).tolist() == [0, 0, 0]
