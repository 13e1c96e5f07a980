"""Monitoring fields against scenes: borders in closed form, flags, outputs, minima, teaching."""

from __future__ import annotations

import math

import numpy as np
import pytest

from protocols.lms2xx.evaluation import Fields, segment_minima
from protocols.lms2xx.fields import FACTORY, RADIAL, RECTANGLE, SEGMENTED, Field, border_m, decode
from protocols.lms2xx.telegrams import Telegram, open_frame, read_values, word
from protocols.scan import DAZZLED, Scan, ScanPlan
from protocols.session import DropReason
from tests.protocols.lms2xx.rig import Measure, Rig, wall

WHOLE = (0, 100, 181)
INSTALL = "20 00 53 49 43 4B 5F 4C 4D 53"
RADIUS_A = "40 01 40 B4 00 32 00 01 00 B8 0B"
"Field A of set 1: 3000 mm all around."
RECTANGLE_A = "40 01 40 B4 00 32 00 00 00 E8 03 D0 07 B8 0B"
"1 m to the left, 2 m to the right, 3 m deep."


def post(at_deg: float, range_m: float, width_deg: float = 2.0, behind_m: float = 7.5) -> Measure:
    """A post before a wall; angles as on the wire."""

    def measure(plan: ScanPlan) -> Scan:
        n = len(plan)
        angle = np.degrees(plan.azimuth_rad) + 90.0
        ranges = np.where(np.abs(angle - at_deg) <= width_deg / 2, range_m, behind_m)
        empty = np.zeros((n, 1), np.int32)
        return Scan(plan, ranges[:, None], np.full((n, 1), 5.0), np.zeros(n, np.uint8), empty)

    return measure


def with_field(measure: Measure, *writes: str, **device: object) -> Rig:
    rig = Rig.on(measure=measure, baud=500_000, unit="mm", **device)  # type: ignore[arg-type]
    rig.set_speed(500_000)
    rig.reply_to(INSTALL)
    for text in writes:
        assert rig.reply_to(text)[1:3] == b"\xc0\x01"
    rig.reply_to("20 25")
    return rig


def test_a_radial_border_is_the_same_on_each_beam_and_ends_with_the_field() -> None:
    border = border_m(Field(RADIAL, 1, 100, 50, (3000,)), *WHOLE)
    assert border[40:141] == pytest.approx(3.0)
    assert not border[:40].any()
    assert not border[141:].any()


def test_a_rectangle_s_border_is_its_nearest_side() -> None:
    border = border_m(Field(RECTANGLE, 1, 180, 50, (1000, 2000, 3000)), *WHOLE)
    assert border[[0, 90, 180]] == pytest.approx([2.0, 3.0, 1.0])
    assert border[60] == pytest.approx(3.0 / math.sin(math.radians(60)))
    assert border[30] == pytest.approx(2.0 / math.cos(math.radians(30)))
    assert border[120] == pytest.approx(1.0 / math.cos(math.radians(60)))


def test_corners_of_a_segmented_field_are_joined_by_straight_lines() -> None:
    field = Field(SEGMENTED, 1, 180, 50, (1000,) * 11)
    border = border_m(field, *WHOLE)
    assert border[::18] == pytest.approx(1.0), "corners"
    assert border[9::18] == pytest.approx(math.cos(math.radians(9))), "half-way along a chord"
    uneven = border_m(Field(SEGMENTED, 1, 180, 50, (1000, 2000) + (2000,) * 8), *WHOLE)
    assert uneven[0] == pytest.approx(1.0)
    assert uneven[20] == pytest.approx(2.0)
    angles = np.radians(np.arange(21))
    x, y = uneven[:21] * np.cos(angles), uneven[:21] * np.sin(angles)
    assert np.ptp(np.diff(y) / np.diff(x)) < 1e-9, "one straight line"


def test_a_field_with_a_corner_at_the_scanner_has_no_extent_there() -> None:
    border = border_m(Field(SEGMENTED, 1, 180, 50, (0,) * 5 + (1000,) * 6), *WHOLE)
    assert border[:90].max() == 0.0
    assert np.isfinite(border).all()


@pytest.mark.parametrize("reserved", ["00", "00 00 00 00 00 00"])
@pytest.mark.parametrize(("shape", "sizes"), [(0, (1, 2, 3)), (1, (9,)), (2, tuple(range(19)))])
def test_a_field_is_read_with_one_reserved_byte_or_with_six(reserved: str, shape: int, sizes: tuple[int, ...]) -> None:
    count = bytes((18,)) if shape == 2 else b""
    data = bytes.fromhex("02 01 B4 00 64 00") + bytes((shape,)) + bytes.fromhex(reserved) + count
    data += b"".join(word(size) for size in sizes)
    assert decode(data) == (2, 1, Field(shape, 0, 180, 100, sizes))


@pytest.mark.parametrize(("angle", "code", "count"), [("B4 00", 0xFE, 360), ("64 00", 0xFF, 400)])
def test_the_largest_numbers_of_segments_have_their_own_codes(angle: str, code: int, count: int) -> None:
    rig = with_field(wall())
    rig.reply_to(INSTALL)
    radii = "".join(f" {5 + place % 7:02X} 00" for place in range(count + 1))
    for reserved in ("00", "00 00 00 00 00 00"):
        body = f"01 40 {angle} 32 00 02 {reserved} {code:02X}" + radii
        assert rig.reply_to("40 " + body, 8.0) == b"\x06\xc0\x01" + bytes.fromhex(body) + b"\x10"
    assert rig.reply_to("45 01 00")[1 + 1 + 8 :] == bytes.fromhex(f"{code:02X}{radii} 10")


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("40 03 40 B4 00 32 00 01 00 B8 0B", "C0 00"),
        ("40 01 43 B4 00 32 00 01 00 B8 0B", "C0 00"),
        ("40 01 40 B4 00 19 00 01 00 B8 0B", "C0 00"),
        ("40 01 40 B4 00 32 00 03 00 B8 0B", "C0 00"),
        ("40 01 40 B4 00 32 00 01 00 B8 0B 00", "C0 00"),
        ("40 01 40 B4 00 32 00 02 00 0B" + " 32 00" * 12, "92"),
        ("40 01 40 64 00 32 00 02 00 09" + " 32 00" * 10, "92"),
        ("46 01 40 B4 00 32 00 01 05 00 00 00 00 00", "92"),
        ("46 01 40 B4 00 32 00 02 05 00 00 00 00 00", "92"),
        ("46 00 40 B4 00 32 00 00 05 00 00 00 00 00", "92"),
        ("66 03", "E6 00 03"),
        ("69 64 00 02 00 05 00", "E9 00"),
        ("69 64 01 05 00 02 00", "E9 00"),
        ("69 28 01 02 00 05 00", "E9 00"),
        ("69 64 02 02 00 05 00", "E9 00"),
        ("7C 00 5B", "FC 00"),
        ("7C 00 00 00 00 7C", "FC 00"),
        ("7C 00 00 00 00 FE", "FC 00"),
        ("7C 00 00 00 00 00 03", "FC 00"),
        ("42 02 00 53 49 43 4B 5F 4C 4D 53", "C2 00"),
        ("42 00 00 53 49 43 4B 20 4C 4D 53", "C2 00"),
        ("41 03", "92"),
        ("45 03 00", "92"),
        ("45 01 03", "92"),
    ],
)
def test_a_bad_argument_has_its_own_word_of_refusal_and_changes_nothing(text: str, start: str) -> None:
    rig = with_field(wall())
    rig.reply_to(INSTALL)
    before = rig.session.device
    assert rig.reply_to(text)[1:].startswith(bytes.fromhex(start))
    assert rig.session.device == before
    assert rig.dropped()


def test_an_lms200_takes_no_pitch() -> None:
    for model, answer in (("sick-lms200-30106", 0), ("sick-lms291-s05", 1)):
        rig = Rig.on(model)
        rig.reply_to(INSTALL)
        assert rig.reply_to("7C 01 00")[1:3] == bytes((0xFC, answer))
        rig.reply_to(INSTALL)
        assert rig.reply_to("7C 00 A6")[1:3] == bytes((0xFC, answer)), "-90 deg"


def test_values_in_a_field_carry_its_flag() -> None:
    rig = with_field(post(90.0, 2.0), RADIUS_A)
    rig.ask("37 B4 00 B6 00")
    values = read_values(rig.await_reply(0xB7, 1.0))  # type: ignore[arg-type]
    assert values is not None
    assert [hex(value) for value in values.values.tolist()] == ["0x27d0"] * 3, "2000 mm, bit 13"
    rig.ask("36 02")
    means = read_values(rig.await_reply(0xB6, 1.0))  # type: ignore[arg-type]
    assert means is not None
    assert means.values[180] == 2000, "means have no flags"


@pytest.mark.parametrize(
    ("mode", "bits"), [("00", (0x2000, 0x4000, 0)), ("02", (0x2000, 0x4000, 0x8000)), ("04", (0x4000, 0x8000, 0))]
)
def test_each_measuring_mode_has_its_own_bits_for_the_fields(mode: str, bits: tuple[int, ...]) -> None:
    for name, bit in enumerate(bits):
        write = f"40 01 4{name} B4 00 32 00 01 00 B8 0B"
        rig = with_field(post(90.0, 2.0), write, configuration=f"00 00 46 00 00 {mode}")
        rig.ask("37 B5 00 B5 00")
        values = read_values(rig.await_reply(0xB7, 1.0))  # type: ignore[arg-type]
        assert values is not None
        assert values.values.tolist() == [2000 | bit]


def test_the_outputs_are_low_for_the_fields_with_an_object_and_in_installation_mode() -> None:
    rig = with_field(post(45.0, 2.0), RADIUS_A)
    assert rig.reply_to("4A")[1:] == bytes.fromhex("CA 00 01 01 10")
    rig.measure = wall(7.5)
    assert rig.reply_to("4A")[1:] == bytes.fromhex("CA 01 01 01 10")
    rig.reply_to(INSTALL)
    assert rig.reply_to("4A")[1:] == bytes.fromhex("CA 00 00 00 10")
    assert Rig.on("sick-lms291-s14").reply_to("4A")[1:] == bytes.fromhex("CA 01 01 01 18")


def test_an_object_must_be_there_for_as_many_scans_as_block_77_says() -> None:
    rig = with_field(wall(7.5), RADIUS_A)
    near, far = post(45.0, 2.0), wall(7.5)
    count = 0

    def flicker(plan: ScanPlan) -> Scan:
        nonlocal count
        count += 1
        return (near if count % 2 else far)(plan)

    rig.measure = flicker
    assert rig.reply_to("4A")[2] == 1, "two scans in a row by default"
    rig.reply_to(INSTALL)
    rig.reply_to("77 00 00 46 00 00 00 01 00 00 01")
    rig.reply_to("20 25")
    assert {rig.reply_to("4A")[2] for _ in range(4)} == {0, 1}


def test_a_subtractive_field_b_is_taken_out_of_a() -> None:
    sets = (Field(RADIAL, 1, 180, 50, (3000,)), Field(RADIAL, 1, 180, 50, (2500,)), FACTORY)
    near, none = np.full(181, 2.0), np.zeros(181, np.uint8)
    assert Fields(sets).infringed(near, none, WHOLE) == (True, True, False)
    assert Fields(sets, subtractive=True).infringed(near, none, WHOLE) == (False, True, False)
    third = (sets[0], sets[1], sets[1])
    assert Fields(third, True, special=True).infringed(near, none, WHOLE) == (False, False, True)


def test_dazzle_is_an_object_below_availability_level_2() -> None:
    flags = np.zeros(181, np.uint8)
    flags[7] = DAZZLED
    far = np.full(181, 9.0)
    assert Fields((FACTORY,) * 3).infringed(far, flags, WHOLE) == (True, True, True)
    assert Fields((FACTORY,) * 3, dazzle_counts=False).infringed(far, flags, WHOLE) == (False, False, False)


def test_the_smallest_value_of_each_segment_is_streamed() -> None:
    rig = with_field(post(45.0, 2.0))
    rig.ask("20 20")
    values = read_values(rig.await_reply(0xB0, 1.0))  # type: ignore[arg-type]
    assert values is not None
    assert values.values.tolist() == [7500, 7500, 2000] + [7500] * 7
    assert rig.session.device.mode == 0x20


def test_segments_without_a_beam_or_an_echo_have_no_distance() -> None:
    narrow = segment_minima(FACTORY, np.full(101, 3.0), (4000, 100, 101))
    assert np.isnan(narrow[[0, 1, 8, 9]]).all()
    assert narrow[2:8] == pytest.approx(3.0)


@pytest.mark.parametrize("mode", ["20 21", "20 23"])
def test_only_scans_with_an_object_are_sent_and_the_others_are_accounted_for(mode: str) -> None:
    rig = with_field(wall(7.5), RADIUS_A)
    rig.ask(mode)
    rig.wait(1.0)
    assert not rig.scans()
    kept = rig.dropped().count(DropReason.KEPT)
    assert kept >= 34
    rig.measure = post(45.0, 2.0)
    rig.wait(1.0)
    assert len(rig.scans()) >= 34
    # every scan since the mode began is either sent or told of
    assert len(rig.plans) - len(rig.scans()) - rig.dropped().count(DropReason.KEPT) <= 3


def test_vertical_distances_look_down_the_corridor_of_a_rectangle() -> None:
    rig = with_field(post(60.0, 2.5), RECTANGLE_A)
    ahead = round(2500 * math.sin(math.radians(59.0)))
    for text in ("30 02", "20 22"):
        rig.ask(text)
        values = read_values(rig.await_reply(0xB0, 1.0))  # type: ignore[arg-type]
        assert values is not None
        # at 180 deg the wall to the left stands beside the corridor, at its very end it is 0 ahead
        assert values.values.tolist()[1:] == [0x1FF7, 0x1FF7], "free fields of segments"
        assert values.values[0] == ahead


def test_vertical_distances_of_a_field_of_segments_tell_its_nearest_value() -> None:
    rig = with_field(post(60.0, 2.5), "40 01 41 B4 00 32 00 02 00 0A" + " B8 0B" * 11)
    rig.ask("30 02")
    values = read_values(rig.await_reply(0xB0, 1.0))  # type: ignore[arg-type]
    assert values is not None
    assert values.values.tolist() == [0x1FF7, 2500, 0x1FF7]


def test_minima_of_sub_ranges() -> None:
    rig = with_field(post(45.0, 2.0))
    rig.ask("20 2C 02 01 00 B5 00 B6 00 69 01")
    values = read_values(rig.await_reply(0xB7, 1.0))  # type: ignore[arg-type]
    assert values is not None
    assert (values.first, values.values.tolist()) == (1, [2000, 7500])


def test_values_come_with_the_borders_of_the_fields() -> None:
    rig = with_field(wall(1.5))
    for text in ("3E 01 00 01 00", "20 29 01 00 01 00"):
        rig.ask(text)
        telegram = rig.await_reply(0xBE, 1.0)
        assert telegram is not None
        assert telegram.data == bytes.fromhex("01 00 01 00 04 40 DC 05 32 00 32 00 32 00 10")


def test_a_hundred_values_with_fields_fill_814_bytes_and_more_are_refused() -> None:
    rig = with_field(wall(1.5))
    rig.ask("3E 01 00 64 00")
    rig.wait(0.2)
    assert len(rig.scans()[-1].payload) == 814
    rig.flush_input()
    assert rig.reply_to("3E 01 00 65 00")[1] == 0x92


def test_places_in_the_plane_are_right_and_ahead() -> None:
    rig = Rig.on(measure=wall(10.0), baud=500_000)
    rig.set_speed(500_000)
    rig.ask("76 01 00 03 00")
    telegram = rig.await_reply(0xF6, 1.0)
    assert telegram is not None
    assert telegram.data == bytes.fromhex("01 00 03 00 03 00 E8 03 00 00 E8 03 09 00 E8 03 11 00 10")
    rig.ask("76 69 01 69 01")
    left = rig.await_reply(0xF6, 1.0)
    assert left is not None
    assert left.data[6:10] == bytes.fromhex("E8 83 00 00"), "to the left x is negative"
    assert rig.reply_to("76 01 00 C9 00")[1] == 0x92, "201 places"


def taught(rig: Rig) -> Telegram:
    rig.ask("45 01 00")
    telegram = rig.await_reply(0xC5, 1.0)
    assert telegram is not None
    return telegram


def test_a_taught_field_is_the_nearest_of_all_scans_less_the_difference() -> None:
    rig = with_field(wall(6.0))
    rig.reply_to(INSTALL)
    assert rig.reply_to("46 01 40 B4 00 64 00 00 64 00 00 00 00 00")[1:3] == b"\xc6\x03"
    rig.wait(0.3)
    rig.measure = post(90.0, 4.0, behind_m=6.0)
    rig.wait(0.3)
    rig.measure = wall(6.0)
    rig.wait(0.3)
    assert not rig.scans(), "none of it leaves"
    assert rig.dropped().count(DropReason.KEPT) > 20
    assert rig.reply_to("46 01 40 B4 00 64 00 01 64 00 00 00 00 00")[1:3] == b"\xc6\x01"
    data = taught(rig).data
    assert data[:8] == bytes.fromhex("01 43 00 B4 00 64 00 00"), "set 1, taught A in mm, 180 deg at 1"
    radii = np.frombuffer(data[8:-1], "<u2")
    assert len(radii) == 181
    assert (radii[90], radii[20]) == (3900, 5900)
    rig.ask("30 03")
    values = read_values(rig.await_reply(0xB0, 1.0))  # type: ignore[arg-type]
    assert values is not None
    assert (len(values.values), values.values[180], values.values[40]) == (361, 3900, 5900)


def test_a_taught_field_of_another_step_and_angle_and_the_usual_difference() -> None:
    rig = with_field(wall(6.0))
    rig.reply_to(INSTALL)
    rig.reply_to("46 02 02 64 00 19 00 00 64 00 00 00 01 00")
    rig.wait(0.2)
    assert rig.reply_to("46 02 02 64 00 19 00 01 64 00 00 00 01 00")[1:3] == b"\xc6\x01"
    field = rig.session.device.field_sets[1][2]
    assert (len(field.sizes), set(field.sizes), field.unit) == (401, {593}, 0), "6.00 - 0.07 m, in cm"


def test_teaching_that_is_aborted_or_left_changes_no_field() -> None:
    rig = with_field(wall(6.0))
    assert rig.reply_to("30 03")[1] == 0x92, "nothing was taught"
    rig.reply_to(INSTALL)
    rig.reply_to("46 01 40 B4 00 64 00 00 64 00 00 00 00 00")
    assert rig.reply_to("46 01 41 B4 00 64 00 01 64 00 00 00 00 00")[1] == 0x92, "another field"
    assert rig.reply_to("46 01 40 B4 00 64 00 02 64 00 00 00 00 00")[1:3] == b"\xc6\x00"
    rig.reply_to("46 01 40 B4 00 64 00 00 64 00 00 00 00 00")
    rig.reply_to("20 25")
    rig.reply_to(INSTALL)
    assert rig.reply_to("46 01 40 B4 00 64 00 01 64 00 00 00 00 00")[1] == 0x92
    assert rig.session.device.field_sets == ((FACTORY,) * 3, (FACTORY,) * 3)
    rig.wait(0.5)
    assert rig.session.next_plan() is None


def test_another_active_set_counts_in_the_stream_at_once() -> None:
    rig = with_field(post(45.0, 2.0), "40 02 40 B4 00 32 00 01 00 B8 0B")
    rig.ask("20 20")
    rig.wait(0.5)
    assert open_frame(rig.scans()[-1].payload).data[0] == 10  # type: ignore[union-attr]
    rig.flush_input()
    assert rig.reply_to("41 02")[1:3] == b"\xc1\x02"
    rig.wait(0.5)
    assert open_frame(rig.scans()[-1].payload).data[0] == 1, "a circle has one segment"  # type: ignore[union-attr]
    assert rig.session.device.fields is not None
    assert rig.session.device.mode == 0x20
