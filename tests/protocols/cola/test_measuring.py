"""Scans over time: rates, stamps, directions, filters, fields, several hosts, lost power, slow lines."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from protocols.cola.models import MODELS
from protocols.scan import DAZZLED, Scan, ScanPlan
from protocols.session import Address, Dropped, DropReason, LinkKind
from tests.protocols.cola.reader import ask_a, ask_b, frames, read
from tests.protocols.cola.rig import MS, ONE, SECOND, TWO, Rig, scan_of

POINTS = {2500: {1667: 1141, 2500: 761, 5000: 381}, 3500: {2500: 761, 5000: 381}, 5000: {3333: 571, 5000: 381},
          7500: {5000: 381, 10000: 191}, 10000: {6667: 286, 10000: 191}}  # fmt: skip


def start(rig: Rig, to: Address = ONE, *settings: str) -> None:
    rig.log_in(to)
    for one in settings:
        assert rig.a(one, to).startswith(("sWA", "sAN mLMPsetscancfg 0")), one
    rig.run(3 * SECOND)
    rig.forget()
    assert rig.a("sEN LMDscandata 1", to) == "sEA LMDscandata 1"


@pytest.mark.parametrize(("frequency", "step"), [(one, two) for one, steps in POINTS.items() for two in steps])
def test_an_lms5xx_has_the_points_and_the_rate_of_each_pair(frequency: int, step: int) -> None:
    rig = Rig("sick-lms511")
    start(rig, ONE, f"sMN mLMPsetscancfg +{frequency} +1 +{step} -50000 +1850000")
    scans = [rig.scan() for _ in range(5)]
    assert [len(scan.mm()) for scan in scans] == [POINTS[frequency][step]] * 5
    assert {scan.scan_frequency for scan in scans} == {frequency}
    assert [two.scan_us - one.scan_us for one, two in pairwise(scans)] == pytest.approx([1e8 / frequency] * 4, abs=1)
    assert {two.scans - one.scans for one, two in pairwise(scans)} == {1}
    assert scans[0].sent_us - scans[0].scan_us == pytest.approx(1e8 / frequency + 900, abs=1)
    if (frequency, step) in ((2500, 1667), (10000, 6667)):
        assert scans[0].measuring_frequency == 540


def test_directions_go_from_right_to_left_and_beams_have_their_instants() -> None:
    rig = Rig()
    start(rig)
    plan = rig.plans[-1]
    assert np.degrees(plan.azimuth_rad[[0, 270, 540]]) == pytest.approx([-135.0, 0.0, 135.0])
    assert np.diff(plan.fire_offset_s) == pytest.approx(27.78e-6, rel=1e-3)
    assert plan.duration_s == pytest.approx(15.0e-3, rel=1e-2)
    assert not plan.elevation_rad.any()


@pytest.mark.parametrize(
    ("model", "written", "first", "count"),
    [
        ("sick-lms111", "1 1388 FFF92233 22550D", -450_000, 541),
        ("sick-lms111", "+1 +5000 +0 +1800000", 0, 361),
        ("sick-lms111", "+1 +5000 +2600 +7400", 5000, 1),
        ("sick-lms111", "+1 +5000 -450000 +9000000", -450_000, 541),
        ("sick-tim571", "+1 +10000 -450000 +2250000", -450_000, 271),
        ("sick-tim571", "+1 +3333 +0 +100000", 0, 31),
        ("sick-lms511", "+1 +5000 +0 +0", 0, 1),
    ],
)
def test_an_output_range_is_stored_as_written_and_snapped_to_the_grid(
    model: str, written: str, first: int, count: int
) -> None:
    rig = Rig(model)
    start(rig, ONE, f"sWN LMPoutputRange {written}")
    for scan in (rig.scan(), rig.scan()):
        assert (scan.channels["DIST1"][2], len(scan.mm())) == (first, count)
    assert len(rig.plans[-1]) == count, "beams that nobody is told of are not measured"


def test_a_tim_stamps_the_last_beam_and_an_lms_the_first() -> None:
    for model, end in (("sick-tim571", True), ("sick-lms111", False)):
        rig = Rig(model)
        start(rig)
        scan, plan = rig.scan(), rig.plans[0]
        wanted = plan.start_ns + (round(plan.duration_s * 1e9) if end else 0)
        assert scan.scan_us * 1000 == pytest.approx(wanted, abs=1000)
        assert rig.now_ns >= scan.sent_us * 1000


@pytest.mark.parametrize(
    ("asked", "starts"),
    [("+2500 +1 +1250", [-475_000, -476_250]), ("+1250 +1 +625", [-474_375, -475_000, -475_625, -476_250])],
)
def test_an_interlaced_mrs1000_keeps_its_step_and_shifts_its_start(asked: str, starts: list[int]) -> None:
    rig = Rig("sick-mrs1104")
    start(rig, ONE, f"sMN mLMPsetscancfg {asked} -475000 +2275000")
    scans = [rig.scan() for _ in range(8 * len(starts))]
    assert {(len(scan.mm()), scan.channels["DIST1"][3]) for scan in scans} == {(1101, 2500)}
    reported = [scan.channels["DIST1"][2] for scan in scans]
    at = next(k for k in range(1, len(reported)) if reported[k] != reported[k - 1])
    cycle = [reported[at + 4 * k] for k in range(len(starts))]
    assert sorted(cycle) == sorted(starts)
    assert all(len(set(reported[at + 4 * k : at + 4 * k + 4])) == 1 for k in range(len(starts)))
    assert [two.scan_us - one.scan_us for one, two in pairwise(scans)] == [20_000] * (len(scans) - 1)


def test_layers_of_an_mrs1000_look_up_and_down_and_can_be_switched_off() -> None:
    rig = Rig("sick-mrs1104")
    start(rig, ONE, "sWN ScanLayerFilter 4 0 1 1 0")
    layers = [rig.scan().layer for _ in range(4)]
    assert set(layers) == {-250, 250}
    plan = {round(math.degrees(one.elevation_rad[0]), 6): one for one in rig.plans[-4:]}
    assert set(plan) == {2.5, -2.5}
    assert rig.plans[-1].duration_s > 0.06


@pytest.mark.parametrize(("mode", "field"), [(1, 250), (2, 0), (3, -250), (4, -500)])
def test_one_layer_of_an_mrs1000_can_be_sent_alone(mode: int, field: int) -> None:
    rig = Rig("sick-mrs1104")
    start(rig, ONE, f"sWN MMAlignmentMode {mode}")
    scans = [rig.scan() for _ in range(3)]
    assert {scan.layer for scan in scans} == {field}
    assert scans[1].scan_us - scans[0].scan_us == 80_000
    rig.log_in(TWO)
    assert rig.a("sWN MMAlignmentMode 5", TWO) == "sFA 4"
    off = " ".join("0" if layer == field else "1" for layer in (0, -250, 250, -500))
    assert rig.a(f"sWN ScanLayerFilter 4 {off}", TWO) == "sFA 5", "nothing would be left"
    assert rig.a("sWN MMAlignmentMode 0", TWO) == "sWA MMAlignmentMode"
    assert rig.a(f"sWN ScanLayerFilter 4 {off}", TWO) == "sWA ScanLayerFilter"
    assert rig.a(f"sWN MMAlignmentMode {mode}", TWO) == "sFA 4"


@pytest.mark.parametrize(
    ("interval", "switches", "apart"),
    [(1, "1 1 1 1", [1] * 4), (3, "1 1 1 1", [1, 1, 1, 9]), (3, "0 1 0 1", [2, 10] * 2), (50_000, "1 0 0 0", [])],
)
def test_intervals_count_whole_turns_of_the_layers_that_are_on(interval: int, switches: str, apart: list[int]) -> None:
    rig = Rig("sick-mrs1104")
    content = f"sWN LMDscandatacfg 01 00 0 0 0 00 00 0 0 0 0 +{interval}"
    start(rig, ONE, f"sWN ScanLayerFilter 4 {switches}", content)
    rig.run(3 * SECOND)
    numbers = [plan.sweep for plan in rig.plans[-9:]]
    if apart:
        found = [two - one for one, two in pairwise(numbers)]
        assert any(found[k : k + len(apart)] == apart for k in range(5))
    else:
        plan = rig.session.next_plan()
        assert plan is not None
        assert plan.sweep % 200_000 == 0


def test_settings_within_a_pause_do_not_turn_the_numbers_of_sweeps_back() -> None:
    rig = Rig(change_s=5)
    start(rig, ONE, "sMN mLMPsetscancfg +2500 +1 +2500 -450000 +2250000", "sWN LMPoutputRange +1 +2500 +0 +900000",
          "sMN mLMPsetscancfg +5000 +1 +5000 -450000 +2250000", "sWN LMPoutputRange +1 +5000 +0 +1800000")  # fmt: skip
    rig.run(10 * SECOND)
    numbers = [plan.sweep for plan in rig.plans]
    assert numbers == sorted(set(numbers))
    assert numbers[0] >= 0


def test_an_interlaced_lms5xx_has_one_point_more_in_the_first_turn() -> None:
    rig = Rig("sick-lms511")
    start(rig, ONE, "sMN mLMPsetscancfg +10000 +1 +1667 -50000 +1850000")
    scans = [rig.scan() for _ in range(8)]
    assert sorted({len(scan.mm()) for scan in scans}) == [285, 286]
    assert {scan.channels["DIST1"][2] for scan in scans} == {-50_000, -48_333, -46_667, -45_000}


# ---------------------------------------------------------------- echoes and filters


def three_echoes(plan: ScanPlan) -> Scan:
    return scan_of(plan, 5.0, 7.0, np.where(np.arange(len(plan)) % 2, 9.0, np.nan))


@pytest.mark.parametrize(("mode", "wanted"), [
    (0, {"DIST1": [5000, 5000]}), (2, {"DIST1": [7000, 9000]}),
    (1, {"DIST1": [5000, 5000], "DIST2": [7000, 7000], "DIST3": [0, 9000], "DIST4": [0, 0], "DIST5": [0, 0]}),
])  # fmt: skip
def test_the_echo_filter_decides_which_echoes_are_told(mode: int, wanted: dict[str, list[int]]) -> None:
    rig = Rig("sick-lms511", three_echoes)
    start(rig, ONE, f"sWN FREchoFilter {mode}", "sWN LMDscandatacfg 1F 00 0 0 0 00 00 0 0 0 0 +1")
    scan = rig.scan()
    assert {name: scan.mm(name)[:2] for name in scan.channels} == wanted
    assert rig.plans[-1].max_echoes == (1 if mode == 0 else 5)


@pytest.mark.parametrize(("mask", "seen"), [("01", {1}), ("05", {1, 3}), ("13", {1, 2, 5}), ("1F", {1, 2, 3, 4, 5})])
def test_channels_are_those_of_the_mask_and_no_others(mask: str, seen: set[int]) -> None:
    rig = Rig("sick-lms511", world=lambda plan: scan_of(plan, 3.0, 5.0, 7.0, 9.0, 11.0))
    start(rig, ONE, "sWN FREchoFilter 1", f"sWN LMDscandatacfg {mask} 00 0 0 0 00 00 0 0 0 0 +1")
    scan = rig.scan()
    assert set(scan.channels) == {f"DIST{echo}" for echo in seen}
    assert {echo: scan.mm(f"DIST{echo}")[0] for echo in seen} == {echo: 1000.0 + 2000.0 * echo for echo in seen}


def test_only_an_mrs_has_a_table_of_angles() -> None:
    for model, answer in (("sick-lms111", "sFA 4"), ("sick-tim571", "sFA 4"), ("sick-mrs1104", "sWA LMDscandatacfg")):
        rig = Rig(model)
        rig.log_in()
        assert rig.a("sWN LMDscandatacfg 01 00 3 1 0 00 00 0 0 0 0 +1") == answer


def test_the_particle_filter_takes_lone_echoes_away_until_they_stay() -> None:
    def world(plan: ScanPlan) -> Scan:
        ranges = np.full(len(plan), 10.0)
        ranges[100] = 2.0 if plan.sweep % 10 == 5 else 10.0
        ranges[200] = 3.0
        ranges[300:303] = 4.0
        return scan_of(plan, ranges)

    rig = Rig("sick-lms111", world)
    start(rig, ONE, "sWN LFPparticle 1 +500")
    scans = [rig.scan() for _ in range(20)]
    assert {scan.mm()[100] for scan in scans} == {10_000.0, 0.0}
    assert [scan.mm()[200] for scan in scans[1:]] == [3000.0] * 19
    assert {scan.mm()[301] for scan in scans} == {4000.0}


def test_the_mean_filter_averages_and_lowers_the_rate() -> None:
    rig = Rig("sick-lms111", lambda plan: scan_of(plan, 10.0 + 0.1 * (plan.sweep % 2)))
    start(rig, ONE, "sWN LFPmeanfilter 1 +4 0")
    scans = [rig.scan() for _ in range(4)]
    assert {value for scan in scans for value in scan.mm()} == {10_050.0}
    assert [two.scan_us - one.scan_us for one, two in pairwise(scans)] == [80_000] * 3
    assert [two.telegrams - one.telegrams for one, two in pairwise(scans)] == [1] * 3


@pytest.mark.parametrize("model", ["sick-lms511", "sick-mrs1104"])
@pytest.mark.parametrize("written", ["LFPparticle 1 +500", "LFPmedianfilter 1 3", "LFPmeanfilter 1 +3 0"])
def test_one_beam_is_a_scan_with_every_filter(model: str, written: str) -> None:
    rig = Rig(model, access="open", edge_filter_m=0.5)
    rig.a("sWN LMPoutputRange 1 1388 +900000 +900000")
    assert rig.a(f"sWN {written}").startswith("sWA")
    rig.a("sEN LMDscandata 1")
    for _ in range(5):  # until the scan before has the same layer
        scan = rig.scan()
    assert scan.channels["DIST1"][4] == [10_000]


def test_a_poll_is_answered_however_long_a_telegram_takes() -> None:
    rig = Rig("sick-lms511", access="open")
    rig.a("sMN mLMPsetscancfg +2500 +1 +5000 -50000 +1850000")
    rig.a("sWN LMPoutputRange 1 1388 +900000 +900000")
    rig.a("sWN LMDscandatacfg 01 00 0 0 0 00 00 0 0 0 0 +1000")  # every forty seconds
    rig.run(4 * SECOND)
    rig.forget()
    assert rig.a("sRN LMDscandata", within_ns=41 * SECOND).startswith("sRA LMDscandata ")
    rig.run(20 * SECOND)
    assert rig.session.next_plan() is None, "for polls alone it does not go on for ever"


def test_the_median_filter_removes_what_one_direction_shows_once() -> None:
    def world(plan: ScanPlan) -> Scan:
        return scan_of(plan, np.where(np.arange(len(plan)) == plan.sweep % 300, 1.0, 10.0))

    rig = Rig("sick-lms511", world)
    start(rig, ONE, "sWN LFPmedianfilter 1 3")
    rig.scan()
    assert {value for _ in range(5) for value in rig.scan().mm()} == {10_000.0}


@pytest.mark.parametrize("written", ["LFPmedianfilter 1 3", "LFPmeanfilter 1 +3 0", "LFPparticle 1 +500"])
def test_filters_compare_interlaced_scans_of_the_same_directions(written: str) -> None:
    rig = Rig("sick-lms511", world=lambda plan: scan_of(plan, 5.0 + plan.azimuth_rad))
    start(rig, ONE, "sMN mLMPsetscancfg +5000 +1 +1667 -50000 +1850000", "sWN " + written)
    for _ in range(8):
        _, _, first, _, counts = rig.scan().channels["DIST1"]
        wanted = 5000 + 1000 * np.radians((first + np.arange(len(counts)) * 10_000 / 3) / 1e4 - 90)
        assert np.abs(np.asarray(counts) - wanted)[1:-1].max() <= 1.5


def test_the_fog_filter_shows_what_is_behind_a_weak_near_echo() -> None:
    def world(plan: ScanPlan) -> Scan:
        strengths = np.tile([3.0, 50.0], (len(plan), 1))
        return scan_of(plan, 1.5, 12.0, intensity=strengths)

    for fog, wanted in ((False, 1500.0), (True, 12_000.0)):
        rig = Rig("sick-lms111", world, fog_filter=fog)
        start(rig)
        assert set(rig.scan().mm()) == {wanted}


def test_a_scale_of_two_reaches_twice_as_far() -> None:
    rig = Rig("sick-lms511", lambda plan: scan_of(plan, 78.0))
    start(rig)
    assert set(rig.scan().mm()) == {0.0}
    start(rig, TWO, "sWN LMDscandatascalefactor 40000000")
    scan = rig.scan(TWO)
    assert set(scan.mm()) == {78_000.0}
    assert scan.channels["DIST1"][0] == 2.0


def test_dazzled_beams_have_their_own_words() -> None:
    def world(plan: ScanPlan) -> Scan:
        found = scan_of(plan, 10.0)
        flags = found.flags.copy()
        flags[7] = DAZZLED
        return Scan(plan, found.range_m, found.intensity, flags, found.actor)

    rig = Rig("sick-lms511", world)
    start(rig)
    scan = rig.scan()
    assert (scan.mm()[7], scan.mm("RSSI1")[7], scan.mm()[8]) == (1.0, 255.0, 10_000.0)


# ---------------------------------------------------------------- hosts


def test_two_hosts_in_two_dialects_have_subscriptions_of_their_own() -> None:
    rig = Rig()
    start(rig)
    rig.run(100 * MS)
    rig.forget()
    rig.put(ask_b("sEN LMDscandata", "01"), TWO)
    assert rig.next(TWO, 10 * MS)[1] == b"sEA LMDscandata \x01"
    assert rig.next(TWO, 100 * MS)[0] == "B", "though its sweeps were asked for before"
    rig.run(200 * MS)
    rig.forget()
    rig.run(SECOND)
    reported = {to: [read(*frames(one.payload)[0]) for one in rig.sent if one.address == to] for to in (ONE, TWO)}
    assert [len(reported[to]) for to in (ONE, TWO)] == [50, 50]
    assert [one.scans for one in reported[ONE]] == [one.scans for one in reported[TWO]]
    assert {frames(one.payload)[0][0] for one in rig.sent if one.address == ONE} == {"A"}
    rig.session.disconnected(rig.now_ns, ONE)
    rig.forget()
    rig.run(SECOND)
    assert {one.address for one in rig.sent} == {TWO}
    assert len(rig.sent) == 50
    rig.put(ask_b("sEN LMDscandata", "00"), TWO)
    rig.run(SECOND)
    rig.forget()
    rig.run(SECOND)
    assert not rig.sent
    assert rig.session.next_plan() is None


def test_login_stops_the_scans_where_the_device_is_set_so() -> None:
    rig = Rig(quiet_login=True)
    start(rig, ONE)
    rig.forget()
    rig.run(SECOND)
    assert not rig.sent
    assert rig.a("sMN Run") == "sAN Run 1"
    assert len(rig.scan().mm()) == 541


def test_scans_that_a_login_held_back_are_nobodys_when_its_host_hangs_up() -> None:
    rig = Rig("sick-lms511", quiet_login=True)
    assert rig.b("sEN LMDscandata", "01", to=TWO) == b"sEA LMDscandata \x01"
    rig.log_in()
    rig.forget()
    rig.run(2 * SECOND)
    assert not rig.sent
    rig.dropped()
    rig.session.disconnected(rig.now_ns, ONE)
    rig.run(SECOND)
    assert len(rig.sent) == pytest.approx(49, abs=2)
    assert rig.dropped() == [], "the device did not measure: nothing was late"


def test_a_slow_serial_line_loses_whole_telegrams_which_are_counted() -> None:
    rig = Rig(kind=LinkKind.SERIAL, serial_baud=57_600)
    line = Address(0, 0)
    rig.put(ask_a("sEN LMDscandata 1"), line)
    rig.run(5 * SECOND)
    scans = [one for one in rig.sent if one.sweep is not None]
    size = len(scans[0].payload)
    assert 5 * 5760 / size - 2 <= len(scans) <= 5 * 5760 / size + 2
    assert all(two.due_ns - one.due_ns >= size * 10 * SECOND // 57_600 for one, two in pairwise(scans))
    lost = [one for one in rig.events if isinstance(one, Dropped) and one.reason is DropReason.LINE_BUSY]
    assert len(lost) > 150


def test_every_sweep_is_accounted_for() -> None:
    rig = Rig("sick-lms511")
    start(rig, ONE, "sWN LMDscandatacfg 01 00 0 0 0 00 00 0 0 0 0 +3")
    rig.run(SECOND)
    rig.put(ask_a("sRN LMDscandata"), TWO)
    rig.run(SECOND)
    sent = {one.sweep for one in rig.sent if one.sweep is not None}
    rig.dropped()
    rig2 = Rig("sick-lms511")
    start(rig2, ONE, "sWN LMDscandatacfg 01 00 0 0 0 00 00 0 0 0 0 +3")
    rig2.run(2 * SECOND)
    kept = {n for one in rig2.events if isinstance(one, Dropped) and one.sweeps is not None for n in one.sweeps}
    first, last = min(sent), max(sent)
    assert {number for number in range(first, last) if number % 3} <= kept
    assert all(number % 3 == 0 for number in sent)


def test_power_may_go_at_any_instant_and_a_host_begins_anew() -> None:
    rig = Rig(ready_s=1)
    for instant in range(0, 100, 7):
        start(rig)
        rig.run(instant * MS + SECOND)
        rig.session.power_on(rig.now_ns)
        rig.forget()
        rig.run(3 * SECOND)
        assert not [one for one in rig.sent if one.payload]
        scan_counter = 0
    start(rig)
    scan_counter = rig.scan().telegrams
    assert scan_counter < 20


# ---------------------------------------------------------------- fields

RECTANGLE = "sWN field000 3F800000 00000000 1388 FFF92230 1 1 0 1 +900000 +3000 0 +2000 +2000 0 0 1 6 FIELD1 0"
"Two metres square, its middle 3 m straight ahead."
SECTOR = "sWN field001 3F800000 00000000 1388 FFF92230 2 2 1 2 10E FFFF 7D0 12C FFFF 7D0 0 0 0 1 5 right 0"
"From 90 to 105 degrees of the device, 2 m deep."


class Walker:
    """Something that stands `near_m` straight ahead."""

    near_m = 10.0

    def __call__(self, plan: ScanPlan) -> Scan:
        ranges = np.where(np.abs(plan.azimuth_rad) < math.radians(1.1), self.near_m, 10.0)
        return scan_of(plan, ranges)


def test_fields_are_written_evaluated_and_told_as_events() -> None:
    walker = Walker()
    rig = Rig(world=walker)
    rig.log_in()
    assert rig.a(RECTANGLE) == "sWA field000"
    assert rig.a(SECTOR) == "sWA field001"
    assert rig.a("sRN field000").startswith(
        "sRA field000 3F800000 00000000 1388 FFF92230 1 1 0 1 DBBA0 BB8 0 7D0 7D0 0 0 1 6"
    )
    assert rig.b("sEN LIDoutputstate", "01", TWO) == b"sEA LIDoutputstate \x01"
    assert rig.b("sEN LFErec", "01", TWO) == b"sEA LFErec \x01"

    def states() -> list[tuple[int, ...]]:
        found = []
        for one in rig.sent:
            (_, payload), *_ = frames(one.payload)
            if payload.startswith(b"sSN LFErec "):
                data = payload[11:]
                count = int.from_bytes(data[:2], "big")
                assert len(data) == 2 + 43 * count, "the vendor's driver rejects any other length"
                found.append(tuple(data[2 + 43 * k + 23] for k in range(count)))
            if payload.startswith(b"sSN LIDoutputstate "):
                assert len(payload) == 19 + 6 + 5 * 4 + 2 + 11
        rig.forget()
        return found

    rig.run(SECOND)
    assert states()[-1] == (1, 1)
    walker.near_m = 3.5
    rig.run(SECOND)
    assert states() == [(2, 1)]
    walker.near_m = 1.0
    rig.run(SECOND)
    assert states()[-1] == (1, 2)
    walker.near_m = 10.0
    rig.run(SECOND)
    assert states()[-1] == (1, 1)
    assert rig.b("sRN LFErec", to=TWO)[11:13] == b"\x00\x02"
    walker.near_m = 3.0
    start(rig)
    rig.run(SECOND)
    assert rig.scan().outputs == (0, 1)


def test_a_tim_has_its_ready_output_beside_those_of_its_fields() -> None:
    rig = Rig("sick-tim781", world=lambda plan: scan_of(plan, 3.0))
    start(rig, ONE)
    assert rig.scan().outputs == (0, 0b1000)
    assert rig.a_last(RECTANGLE) == "sWA field000"
    rig.run(SECOND)
    rig.forget()
    assert rig.scan().outputs == (0, 0b1001)


def test_a_single_scan_does_not_infringe_a_field() -> None:
    def world(plan: ScanPlan) -> Scan:
        return scan_of(plan, 3.0 if plan.sweep % 20 == 0 else 10.0)

    rig = Rig(world=world)
    rig.log_in()
    rig.a(RECTANGLE)
    rig.run(2 * SECOND)
    (_, changes), *_ = rig.session.watching.outputs(1)
    assert changes <= 2, "free, or first infringed and then free"


def test_the_calendar_begins_in_1970_is_set_by_a_host_or_by_the_time_server() -> None:
    rig = Rig()
    start(rig, ONE, "sWN LMDscandatacfg 01 00 0 0 0 00 00 0 0 0 1 +1")
    reported = rig.scan().time
    assert reported is not None
    assert reported[:3] == (1970, 1, 1)
    assert rig.a_last("sMN LSPsetdatetime +2026 +2 +28 +23 +59 +59 +999999") == "sAN LSPsetdatetime 1"
    assert rig.a_last("sMN LSPsetdatetime +2026 +2 +30 0 0 0 0") == "sAN LSPsetdatetime 0"
    assert rig.a_last("sMN LSPsetdatetime +2026 +2 +28 0 0 0 FFFFFFFF") == "sAN LSPsetdatetime 0"
    rig.forget()
    rig.run(SECOND)
    reported = read(*frames(rig.sent[-1].payload)[0]).time
    assert reported is not None
    assert reported[:3] == (2026, 3, 1)
    served = Rig(ntp_epoch_s=1_700_000_000)
    start(served, ONE, "sWN TSCRole 1", "sWN LMDscandatacfg 01 00 0 0 0 00 00 0 0 0 1 +1")
    reported = served.scan().time
    assert reported is not None
    assert reported[:5] == (2023, 11, 14, 22, 13)


@pytest.mark.parametrize("model", MODELS)
def test_counters_and_clocks_wrap_as_wide_as_the_wire(model: str) -> None:
    rig = Rig(model)
    rig.session.first_count = 65_530
    rig.session.clock = rig.session.clock.set_to(rig.now_ns, (1 << 32) * 1000 - 300_000_000)
    start_us = []
    rig.put(ask_b("sEN LMDscandata", "01"))
    rig.next()
    for _ in range(12):
        scan = rig.scan()
        assert 0 <= scan.telegrams < 65_536
        start_us.append(scan.scan_us)
    period = 1e8 / scan.scan_frequency
    assert all((two - one) % (1 << 32) == pytest.approx(period, abs=1) for one, two in pairwise(start_us))


def test_the_encoder_counts_the_way_of_the_belt() -> None:
    rig = Rig("sick-lms511", encoder_mm_s=-500.0)
    rig.log_in()
    assert rig.a("sWN LICencres 00000000") == "sFA 4"
    assert rig.a("sWN LICencres 3F000000") == "sWA LICencres"  # 0.5 mm per tick
    rig.a("sWN LMDscandatacfg 01 00 1 0 0 01 00 0 0 0 0 +1")
    rig.a("sEN LMDscandata 1")
    assert rig.scan().encoders == [], "LICencset 0: off"
    for mode, sign in ((1, 1), (2, -1)):
        rig.a_last(f"sWN LICencset {mode}")
        rig.forget()
        one, two = rig.scan(), rig.scan()
        (first,), (second,) = one.encoders, two.encoders
        assert (first[1], second[1]) == (500, 500)
        moved = (second[0] - first[0] + 2**31) % 2**32 - 2**31
        # 1000 ticks a second, whatever the number of scans between the two
        assert moved == pytest.approx(sign * (two.scan_us - one.scan_us) * 1e-3, abs=1.0)


def test_the_encoder_begins_at_zero_with_the_power() -> None:
    rig = Rig("sick-lms111", encoder_mm_s=1000.0, access="open")
    for _ in range(2):
        rig.a("sWN LICencset 2")
        rig.a("sWN LMDscandatacfg 01 00 0 0 0 01 00 0 0 0 0 +1")
        rig.a("sEN LMDscandata 1")
        scan = rig.scan()
        ((ticks, _),) = scan.encoders
        assert ticks == pytest.approx(scan.scan_us * 1e-3, abs=1.0), "a tick is 1 mm"
        rig.session.power_on(rig.now_ns)
        rig.run(11 * SECOND)
        rig.forget()


def test_a_step_that_no_telegram_holds_is_refused() -> None:
    for model in MODELS:
        rig = Rig(model, access="open")
        kept = rig.a("sRN LMPoutputRange")
        for step in ("FFFFFFFF", "10000", "0"):
            assert rig.a(f"sWN LMPoutputRange 1 {step} +0 +900000") == "sFA 4"
        assert rig.a("sRN LMPoutputRange") == kept
        assert rig.a("sWN LMPoutputRange 1 FFFF +0 +900000") == "sWA LMPoutputRange"
        assert rig.a("sEN LMDscandata 1") == "sEA LMDscandata 1"
        _, _, first, step, counts = rig.scan().channels["DIST1"]
        assert first + (len(counts) - 1) * step <= 900_000 + 2500


def test_the_zone_shifts_the_time_of_the_server_and_not_that_of_a_host() -> None:
    rig = Rig("sick-lms511", ntp_epoch_s=1_700_000_000, access="open")
    assert rig.a("sWN TSCTCtimezone +15") == "sFA 4"
    assert rig.a("sWN TSCTCtimezone -5") == "sWA TSCTCtimezone"
    rig.a("sMN LSPsetdatetime +2026 +3 +1 +12 0 0 0")
    assert rig.a("sRN STlms").split(" ")[5:8] == ["12:00:00", "8", "01.03.26"]
    rig.a("sWN TSCRole 1")
    assert rig.a("sRN STlms").split(" ")[5:8] == ["17:13:30", "8", "14.11.23"]


def test_the_angle_filter_of_an_mrs_leaves_a_sector_and_every_second_beam() -> None:
    rig = Rig("sick-mrs1104")
    rig.log_in()
    assert rig.a("sRN LFPangleRangeFilter") == "sRA LFPangleRangeFilter 0 C0490FDB 40490FDB BFC90FDB 3FC90FDB 1"
    assert rig.a("sWN LFPangleRangeFilter 1 3F000000 BF000000 BFC90FDB 3FC90FDB 1") == "sFA 4", "from behind to"
    rig.a("sWN LFPangleRangeFilter 1 BF000000 3F000000 BFC90FDB 3FC90FDB 2")  # -0.5 to 0.5 rad
    rig.a("sEN LMDscandata 1")
    counts = np.asarray(rig.scan().channels["DIST1"][4])
    azimuth = np.radians(-137.5 + 0.25 * np.arange(1101))
    wanted = (np.abs(azimuth) <= 0.5) & (np.arange(1101) % 2 == 0)
    np.testing.assert_array_equal(counts > 0, wanted)


def test_the_edge_filter_of_an_mrs_takes_both_sides_of_a_step_away_up_to_sixteen_metres() -> None:
    def world(plan: ScanPlan) -> Scan:
        n = np.arange(len(plan))
        near = np.where(n < 300, 5.0, 5.3)  # a step of 0.3 m: none
        return scan_of(plan, np.where(n < 500, near, np.where(n < 800, 9.0, np.where(n < 1000, 18.0, 30.0))))

    rig = Rig("sick-mrs1104", world, edge_filter_m=0.5)
    rig.a("sEN LMDscandata 1")
    counts = np.asarray(rig.scan().channels["DIST1"][4])
    assert np.flatnonzero(counts == 0).tolist() == [499, 500, 799, 800]
