"""Numbers, sums, lines and values, against the specification's worked examples and an independent decoder."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from emulator.hosts.scip_reading import decode_number, decode_values, joined
from protocols.scan import DAZZLED, Scan, ScanPlan
from protocols.scip import codec
from protocols.scip.codec import Form
from protocols.scip.models import MODELS
from tests.protocols.scip import rig

LIMITS = MODELS["hokuyo-utm-30lx"].limits


@pytest.mark.parametrize(
    ("value", "width", "text"),
    [(1234, 2, "CB"), (5432, 3, "1Dh"), (16_000_000, 4, "m2@0"), (12345, 4, "030i"), (0, 3, "000"), (19, 3, "00C"),
     (1000, 3, "0?X"), (3700, 3, "0id"), (65533, 3, "?om")],
)  # fmt: skip
def test_numbers_are_those_of_the_maker_s_table(value: int, width: int, text: str) -> None:
    assert codec.encode_number(value, width) == text.encode()
    assert decode_number(text.encode()) == value


@pytest.mark.parametrize(
    ("line", "total"),
    [
        ("00", "P"),
        ("01", "Q"),
        ("02", "R"),
        ("99", "b"),
        ("03", "S"),
        ("0E", "e"),
        ("10", "Q"),
        ("98", "a"),
        ("0B", "b"),
    ],
)
def test_sums_of_status_lines(line: str, total: str) -> None:
    assert codec.summed(line.encode()) == f"{line}{total}\n".encode()


@pytest.mark.parametrize(
    ("key", "value", "line"),
    [("MODL", "UTM-30LX(Hokuyo Automatic Co.,Ltd.)", "MODL:UTM-30LX(Hokuyo Automatic Co.,Ltd.);U"),
     ("DMAX", "60000", "DMAX:60000;J"), ("AFRT", "540", "AFRT:540;0"),
     ("STAT", "Stable 000 no error.", "STAT:Stable 000 no error.;f")],
)  # fmt: skip
def test_sums_of_key_lines_are_taken_without_the_semicolon(key: str, value: str, line: str) -> None:
    assert codec.key_line(key, value) == line.encode() + b"\n"


@given(st.integers(0, 2**24 - 1), st.sampled_from(codec.WIDTHS))
def test_a_number_reads_back(value: int, width: int) -> None:
    value &= (1 << 6 * width) - 1
    text = codec.encode_number(value, width)
    assert len(text) == width
    assert decode_number(text) == rig.number(text.decode()) == value
    assert codec.encode_words(np.array([value]), width).tobytes() == text


@pytest.mark.parametrize("bad", [b"0/0", b"00p", b"\xff"])
def test_a_character_that_is_no_number_is_refused(bad: bytes) -> None:
    with pytest.raises(ValueError, match=r"want 0x30\.\.0x6f"):
        decode_number(bad)


@given(st.binary(max_size=400).map(lambda data: bytes(48 + byte % 64 for byte in data)))
def test_data_is_cut_at_64_characters_whatever_the_step(data: bytes) -> None:
    lines = codec.blocks(data).split(b"\n")[:-1]
    assert [len(line) for line in lines[:-1]] == [65] * (len(lines) - 1)
    assert joined(lines) == data
    if lines:
        hurt = [bytes((lines[0][0] ^ 1,)) + lines[0][1:], *lines[1:]]
        with pytest.raises(ValueError, match="their sum"):
            joined(hurt)


LEVELS = arrays.arrays(np.int64, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(23, 60_000))


@st.composite
def echoes(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Ascending distances (n, 3), and how many of them each step has."""
    distance = np.sort(draw(LEVELS), axis=1)
    return distance, draw(arrays.arrays(np.int64, len(distance), elements=st.integers(1, 3)))


@given(echoes(), st.booleans())
def test_values_of_several_echoes_read_back(found: tuple[np.ndarray, np.ndarray], intensity: bool) -> None:
    distance, counts = found
    wanted = np.where(np.arange(3) < counts[:, None], distance, -1)
    form = Form(3, intensity, 3)
    ranges, strength = decode_values(codec.encode_values(wanted, wanted, form), form)
    expected = np.where(wanted >= 0, wanted, np.nan)[:, : ranges.shape[1]]
    np.testing.assert_array_equal(np.rint(1000 * ranges), expected)
    if intensity:
        np.testing.assert_array_equal(strength, expected)


def test_several_echoes_are_written_as_in_the_specification() -> None:
    distance = np.array([[1045, -1, -1], [1050, 1550, -1], [1055, -1, -1]])
    assert codec.encode_values(distance, distance, Form(3, False, 3)) == b"0@E0@J&0H>0@O"
    strength = np.array([[2009, -1, -1], [2010, 1005, -1], [2015, -1, -1]])
    text = codec.encode_values(distance, strength, Form(3, True, 3))
    assert text.startswith(b"0@E0OI0@J0OJ&0H>0?]0@O")


def scan_of(range_m: list[list[float]], flags: list[int] | None = None) -> Scan:
    size = len(range_m)
    plan = ScanPlan(0, 0, 0, np.zeros(size), np.zeros(size), np.zeros(size))
    ranges = np.array(range_m)
    kept = np.array(flags or [0] * size, np.uint8)
    return Scan(plan, ranges, np.where(np.isnan(ranges), np.nan, 2.0), kept, np.zeros(ranges.shape, np.int32))


def test_words_for_no_echo_for_blindness_and_beyond_the_limits() -> None:
    nan = np.nan
    scan = scan_of(
        [[nan, nan], [1.2345, nan], [0.01, 2.0], [61.0, nan], [nan, nan], [3.0, 2.0]], [0, 0, 0, 0, DAZZLED, 0]
    )
    distance, strength = codec.words_of(scan, LIMITS)
    assert distance.tolist() == [[1, -1], [1234, -1], [2000, -1], [1, -1], [0, -1], [2000, 3000]]
    assert strength[:, 0].tolist() == [0, 100, 100, 0, 0, 100]


def test_a_cluster_has_its_least_distance_and_words_count_as_farthest() -> None:
    distance = np.array([[1], [900], [800], [1], [1], [700], [650]])
    merged, strength = codec.merged(distance, 10 * distance, 3, 23)
    assert merged[:, 0].tolist() == [800, 700, 650]
    assert strength[:, 0].tolist() == [8000, 7000, 6500]
    assert codec.merged(np.array([[1], [1]]), np.array([[0], [0]]), 2, 23)[0].tolist() == [[1]]
    for one in (0, 1):
        assert codec.merged(distance, distance, one, 23)[0] is distance


def test_two_characters_hold_no_more_than_4095() -> None:
    assert codec.encode_values(np.array([[4094], [4095], [60_000]]), np.zeros((3, 1), np.int64), Form(2)) == b"onoooo"


@pytest.mark.parametrize("text", [b"0?", b"&0?X", b"0?X&0", b"0?X0"])
def test_values_that_are_not_whole_are_refused(text: bytes) -> None:
    with pytest.raises(ValueError, match="want"):
        decode_values(text, Form(3, False, 3))
