"""Object lists of whole scenarios: which sweeps they are made of, where objects are, and that nothing else decides."""

from __future__ import annotations

import math
import pickle
from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import cantools
import numpy as np
import pytest

from emulator.errors import ScenarioError
from emulator.instrument.observer import Observer, Payload
from emulator.judging.trial import Trial
from emulator.measuring.measuring import restore, states
from emulator.objects.measure import ObjectMeasure
from emulator.objects.metrics import ListedScan, ObjectScore, reported
from emulator.objects.sweeps import SessionSweeps, end_ns, sweeps_of
from emulator.objects.truth import Witness
from emulator.runtime import assembly
from emulator.scenario import scenario
from emulator.scenario.tables import Mount
from emulator.sensors.spec import load_spec
from emulator.world.scene import build as build_scene
from protocols.scan import DetectedObject, ScanPlan
from protocols.session import Address
from protocols.wire import ANY, wire_of

MS = 1_000_000
YARD = """\
schema: 1
seed: 3
actors:
  - {id: ego, class: car, motion: {velocity_m_s: [5, 0, 0]}}
  - id: van
    class: truck
    shape: {box: {size_m: [5, 2, 2]}}
    material: white_plaster
    motion: {at_m: [20, 1, 0], velocity_m_s: [5, 0, 0]}
  - id: post
    shape: {box: {size_m: [0.5, 0.5, 2]}}
    material: white_plaster
    motion: {at_m: [30, -4, 0]}
sensors:
  - id: scanner
    model: sick-lms291-s05
    mount: {actor: ego, at_m: [0, 0, 1]}
    device: {resolution_deg: 0.5, field_deg: 100}
"""
LIST = "  - {id: lister, model: can-ars408, from: [scanner], mount: {actor: ego, at_m: [0, 0, 1]}}\n"


class Frames(Observer):
    """Keeps the frames of the sensor that lists."""

    def __init__(self) -> None:
        self.frames: list[Payload] = []

    def payload(self, payload: Payload) -> None:
        if payload.sensor == "lister":
            self.frames.append(payload)


def measure_of(text: str = YARD + LIST, sensor: str = "lister") -> ObjectMeasure:
    made = assembly.build_measures(scenario.loads(text, Path("yard.yaml")))[sensor]
    assert isinstance(made, ObjectMeasure)
    return made


def plan(start_ms: float, sweep: int, epoch: int = 1) -> ScanPlan:
    nothing = np.zeros(0)
    return ScanPlan(epoch, sweep, round(start_ms * MS), nothing, nothing, nothing, 0.005, wants_objects=True)


def run(measure: ObjectMeasure, first: int, last: int, epoch: int = 1, cycle_ms: float = 75.0) -> list[ListedScan]:
    lists = []
    for number in range(first, last):
        made = measure(plan(500 + cycle_ms * number, number, epoch))
        assert isinstance(made, ListedScan)
        lists.append(made)
    return lists


def named(made: ListedScan) -> Mapping[str | None, DetectedObject]:
    return {item.actor: item for item in made.objects}


# ---------------------------------------------------------------- sweeps without a host


@pytest.mark.parametrize(
    ("model", "device", "period_ms"),
    [
        ("sick-lms291-s05", {"resolution_deg": 0.5, "field_deg": 180}, 1000 / 37.5),
        ("sick-lms200-30106", {"resolution_deg": 1.0, "field_deg": 180}, 1000 / 75.0),
        ("sick-ld-lrs1000", {"motor_hz": 10, "step_deg": 0.5}, 100.0),
        ("paper-905nm", {}, 40.0),
    ],
)
def test_a_source_measures_at_its_own_rate_without_any_host(
    model: str, device: dict[str, object], period_ms: float
) -> None:
    sensor = f"sensors: [{{id: a, model: {model}, device: {device}}}]"
    loaded = scenario.loads(f"schema: 1\n{sensor}\n", Path("a.yaml"))
    session = assembly.new_session(loaded, 0) if load_spec(model).family else None
    sweeps = sweeps_of(load_spec(model), session)
    found = [one for ms in range(20_000, 22_000, 5) if (one := sweeps.newest(ms * MS)) is not None]
    starts = sorted({one.start_ns for one in found})
    assert np.diff(starts) == pytest.approx(period_ms * MS, rel=1e-6)
    assert all(end_ns(one) <= ms * MS for one, ms in zip(found, range(20_000, 22_000, 5), strict=True))
    assert len(starts) == pytest.approx(2000 / period_ms, abs=2)


def test_which_sweep_is_the_newest_does_not_depend_on_who_asked_before() -> None:
    def sweeps() -> SessionSweeps:
        loaded = scenario.loads(YARD, Path("yard.yaml"))
        return SessionSweeps(assembly.new_session(loaded, 0), wire_of("lms2xx") or ANY)

    steadily, once, back = sweeps(), sweeps(), sweeps()
    for ms in range(0, 8000, 7):
        last = steadily.newest(ms * MS)
    straight = once.newest(ms * MS)
    back.newest((ms + 200) * MS)
    again = back.newest(ms * MS)
    assert last is not None
    assert straight is not None
    assert again is not None
    for other in (straight, again):
        assert (other.sweep, other.start_ns) == (last.sweep, last.start_ns)
        assert np.array_equal(other.azimuth_rad, last.azimuth_rad)


def test_after_hours_without_a_list_sweeps_go_on_as_if_they_had_been_counted() -> None:
    loaded = scenario.loads(YARD, Path("yard.yaml"))
    sweeps = SessionSweeps(assembly.new_session(loaded, 0), wire_of("lms2xx") or ANY)
    early, late = sweeps.newest(10_000 * MS), sweeps.newest(7_210_000 * MS)
    assert early is not None
    assert late is not None
    turns = (late.sweep - early.sweep) / 2  # the mirror turns twice for half a degree
    assert turns == pytest.approx(7200 * 37.5, abs=1)
    # the period is known to the nanosecond a block of sixteen sweeps
    assert (late.start_ns - early.start_ns) / turns == pytest.approx(1e9 / 37.5, abs=0.1)
    assert 0 <= 7_210_000 * MS - end_ns(late) < 27 * MS
    assert sweeps.newest(10_000 * MS) is not None


@pytest.mark.parametrize("step_ms", [1, 13, 400])
@pytest.mark.parametrize(
    ("model", "device"),
    [
        ("sick-lms291-s05", {"resolution_deg": 0.25, "field_deg": 100}),
        ("sick-ld-lrs1000", {"motor_hz": 5, "step_deg": 0.25}),
    ],
)
def test_the_block_that_is_continued_is_what_the_session_goes_on_to_want(
    model: str, device: dict[str, object], step_ms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = scenario.loads(f"schema: 1\nsensors: [{{id: a, model: {model}, device: {device}}}]\n", Path("a.yaml"))
    family = str(load_spec(model).family)
    quick = SessionSweeps(assembly.new_session(loaded, 0), wire_of(family) or ANY)
    found = [quick.newest(ms * MS) for ms in range(1, 16_000, step_ms)]
    monkeypatch.setattr("emulator.objects.sweeps._repeats", lambda *_: False)
    slow = SessionSweeps(assembly.new_session(loaded, 0), wire_of(family) or ANY)
    assert slow.newest(16_000 * MS) is not None
    every = max(1, len(found) // 60)
    for one, ms in zip(found[::every], range(1, 16_000, step_ms)[::every], strict=True):
        other = slow.newest(ms * MS)
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            assert one.sweep == other.sweep
            assert one.start_ns == pytest.approx(other.start_ns, abs=40)
            assert np.array_equal(one.azimuth_rad, other.azimuth_rad)


# ---------------------------------------------------------------- lists


def test_objects_are_where_they_are_as_seen_from_the_moving_sensor() -> None:
    lists = run(measure_of(), 0, 30)
    van, post = named(lists[-1])["van"], named(lists[-1])["post"]
    assert van.position_m[:2] == pytest.approx((20.0, 1.0), abs=0.4)
    assert van.velocity_m_s == pytest.approx((0.0, 0.0, 0.0), abs=0.3)
    assert van.size_m[1] == pytest.approx(2.0, abs=0.3)
    t_s = lists[-1].plan.start_ns * 1e-9
    assert post.position_m[:2] == pytest.approx((30.0 - 5.0 * t_s, -4.0), abs=0.3)
    assert post.velocity_m_s == pytest.approx((-5.0, 0.0, 0.0), abs=0.4)


def test_the_truth_lies_beside_in_the_same_frame() -> None:
    made = run(measure_of(), 0, 3)[-1]
    t_s = made.plan.start_ns * 1e-9
    van, post = sorted(made.truth, key=lambda item: item.actor, reverse=True)
    assert (van.actor, post.actor) == ("van", "post")
    assert van.position_m == pytest.approx((20.0, 1.0, 0.0), abs=1e-9)
    assert van.size_m == (5.0, 2.0, 2.0)
    assert van.velocity_m_s == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert post.position_m == pytest.approx((30.0 - 5.0 * t_s, -4.0, 0.0), abs=1e-9)
    assert post.velocity_m_s == pytest.approx((-5.0, 0.0, 0.0), abs=1e-9)
    assert 0.5 < van.visible_share <= 1.0
    assert 0.3 < post.visible_share <= 1.0


def test_a_sensor_mounted_elsewhere_tells_the_same_objects_in_its_own_frame() -> None:
    turned = LIST.replace("at_m: [0, 0, 1]", "at_m: [2, 1, 0.4], yaw_deg: 90")
    here, there = run(measure_of(), 0, 20)[-1], run(measure_of(YARD + turned), 0, 20)[-1]
    for actor in ("van", "post"):
        x, y, _ = named(here)[actor].position_m
        assert named(there)[actor].position_m[:2] == pytest.approx((y - 1.0, -(x - 2.0)), abs=0.15)
        vx, vy, _ = named(here)[actor].velocity_m_s
        assert named(there)[actor].velocity_m_s[:2] == pytest.approx((vy, -vx), abs=0.3)


def test_two_sources_are_fused_into_one_list() -> None:
    aside = """\
  - id: aside
    model: sick-lms291-s05
    mount: {actor: ego, at_m: [0, 0, 1], yaw_deg: -90}
    device: {resolution_deg: 0.5, field_deg: 100}
"""
    beside = "  - {id: hut, shape: {box: {size_m: [2, 1, 2]}}, material: white_plaster, motion: {at_m: [6, -8, 0]}}\n"
    text = YARD.replace("sensors:\n", beside + "sensors:\n") + aside
    both = run(measure_of(text + LIST.replace("[scanner]", "[scanner, aside]")), 0, 12)[-1]
    alone = run(measure_of(text + LIST), 0, 12)[-1]
    assert {"van", "post"} <= set(named(alone))
    assert set(named(both)) == {"van", "post", "hut"}
    assert "hut" not in named(alone)
    assert all([item.actor for item in both.objects].count(actor) == 1 for actor in ("van", "post", "hut"))


def test_the_same_plans_give_the_same_lists() -> None:
    one, other = run(measure_of(), 0, 10), run(measure_of(), 0, 10)
    assert [item.objects for item in one] == [item.objects for item in other]
    assert [item.truth for item in one] == [item.truth for item in other]


def test_another_process_goes_on_from_what_one_remembers() -> None:
    measure, plain = measure_of(), measure_of()
    run(measure, 0, 6)
    before = run(plain, 0, 6)
    other = measure_of()
    restore({"lister": other}, pickle.loads(pickle.dumps(states({"lister": measure, "front": lambda plan: plan}))))
    after, wanted = run(other, 6, 12), run(plain, 6, 12)
    assert [item.objects for item in after] == [item.objects for item in wanted]
    assert {item.track for item in after[0].objects} == {item.track for item in before[-1].objects} != set()


def test_a_plan_given_twice_gives_the_same_list_and_changes_nothing() -> None:
    measure, plain = measure_of(), measure_of()
    for number in range(8):
        wanted = plan(500 + 75 * number, number)
        first, second = measure(wanted), measure(wanted)
        assert first.objects == second.objects == plain(wanted).objects
        assert second.plan is wanted


def test_lists_made_again_after_a_changed_setting_go_on_from_what_was_known() -> None:
    measure, plain = measure_of(), measure_of()
    before = run(measure, 0, 10)
    run(plain, 0, 8)
    # three lists had been made ahead of time when a host changed the raster at list 8
    again = measure(plan(500 + 75 * 8, 8, epoch=2))
    assert again.objects == plain(plan(500 + 75 * 8, 8, epoch=2)).objects == before[8].objects
    assert {item.track for item in again.objects} == {item.track for item in before[7].objects}


def test_a_skipped_list_is_bridged_and_a_long_pause_begins_anew() -> None:
    measure = measure_of()
    known = run(measure, 0, 10)[-1]
    bridged = measure(plan(500 + 75 * 12, 10))
    assert {item.track for item in bridged.objects} == {item.track for item in known.objects}
    assert measure(plan(500 + 75 * 60, 11)).objects == ()


def test_a_device_that_was_switched_off_knows_nothing() -> None:
    measure = measure_of()
    assert len(run(measure, 0, 10)[-1].objects) == 2
    assert measure(plan(500 + 75 * 11, 0, epoch=2)).objects == ()


def test_faster_lists_than_sweeps_move_objects_on_without_calling_them_unseen() -> None:
    measure = measure_of()
    lists = run(measure, 0, 200, cycle_ms=10.0)
    vans = [named(made)["van"] for made in lists[20:]]
    assert {item.track for item in vans} == {vans[0].track}
    assert {item.coasting_s for item in vans} == {0.0}
    ages = np.diff([item.age_s for item in vans])
    assert ages == pytest.approx(0.01, abs=1e-9)


def test_the_scenario_chooses_how_objects_are_made() -> None:
    options = "objects: {segmentation: actor, classification: actor, confirm_hits: 1}}\n"
    made = run(measure_of(YARD + LIST.replace("}}\n", "}, " + options)), 0, 1)[0]
    assert named(made)["van"].category == "truck"
    assert run(measure_of(), 0, 1)[0].objects == ()
    ideal = run(measure_of(YARD + LIST.replace("}}\n", "}, " + options)), 0, 4)[-1]
    assert {item.actor for item in ideal.objects} == {"van", "post"}


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("objects: {segmentation: magic}", "objects.segmentation: 'magic'; want"),
        ("objects: {coast_s: -1}", "objects.coast_s"),
        ("objects: {height_m: [2, 1]}", "want the lower end first"),
        ("objects: {cost_s: 1}", "cost_s"),
    ],
)
def test_a_bad_choice_is_told_with_its_line(line: str, text: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        scenario.loads(YARD + LIST.replace("}}\n", "}, " + line + "}\n"), Path("yard.yaml"))
    assert text in str(caught.value)
    assert str(caught.value).startswith("yard.yaml:19: ")


def test_a_scanner_with_choices_about_objects_is_refused() -> None:
    with pytest.raises(ScenarioError, match="lists no objects"):
        scenario.loads(YARD + "    objects: {coast_s: 1}\n" + LIST, Path("yard.yaml"))


# ---------------------------------------------------------------- truth and figures


def test_a_turning_carrier_is_known_by_its_motion() -> None:
    text = YARD.replace(
        "motion: {velocity_m_s: [5, 0, 0]}}", "motion: {at_m: [1, 2, 0], yaw_deg: 90, yaw_rate_deg_s: 18}}"
    )
    world = build_scene(scenario.loads(text, Path("turn.yaml")))
    motion = Witness(world, Mount(actor="ego", at_m=(2.0, 0.0, 0.0))).motion(0.0)
    assert (motion.x_m, motion.y_m) == pytest.approx((1.0, 4.0))
    assert motion.yaw_rad == pytest.approx(math.pi / 2)
    assert motion.yaw_rate_rad_s == pytest.approx(math.radians(18.0), rel=1e-6)
    assert (motion.vx_m_s, motion.vy_m_s) == pytest.approx((-2.0 * math.radians(18.0), 0.0), abs=1e-9)
    post = {item.actor: item for item in Witness(world, Mount(actor="ego")).objects(0.0).values()}["post"]
    # it stands; seen from a sensor that turns to the left it moves to the right about it
    rate = math.radians(18.0)
    assert post.position_m[:2] == pytest.approx((-6.0, -29.0))
    assert post.velocity_m_s[:2] == pytest.approx((-29.0 * rate, 6.0 * rate), rel=1e-6)


def test_figures_are_told_by_object_and_distance() -> None:
    score = ObjectScore()
    for made in run(measure_of(), 0, 30):
        score.add(made.objects, made.truth)
    assert score.lists == 30
    assert score.total.precision == 1.0
    assert score.total.recall >= 0.9
    assert {actor for actor, _ in score.by_actor_and_distance_m} == {"van", "post"}
    post = [end for actor, end in score.by_actor_and_distance_m if actor == "post"]
    assert post == [20.0, 40.0]
    lines = list(reported(score.as_json()))
    assert "precision recall" in lines[0]
    assert any(line.startswith("  post, up to 20 m") for line in lines)
    assert lines[-1].split()[:2] == ["all", "1.000"]


def test_a_module_that_only_ranges_tells_at_once_what_comes_back() -> None:
    text = YARD + LIST.replace("can-ars408", "can-leddar-vu8")
    made = run(measure_of(text), 0, 1)[0]
    assert {item.actor for item in made.objects} == {"van", "post"}
    session = assembly.new_sessions(scenario.loads(text, Path("yard.yaml")))[1]
    session.power_on(0)
    session.advance(600 * MS)
    session.receive(bytes([3]), 600 * MS, Address(0, 0x740))
    wanted = session.next_plan()
    assert wanted is not None
    session.submit(replace(made, plan=wanted))
    frames = [(item.address.peer, item.payload) for item in session.take_emissions(700 * MS) if item.address]
    ranges = [int.from_bytes(data[:2], "little") * 0.01 for peer, data in frames if peer >= 0x752]
    assert min(ranges) == pytest.approx(17.5, abs=0.3)


@pytest.mark.parametrize(
    ("model", "device", "layout", "heads"),
    [
        ("can-ars408", {}, "ars408.dbc", {0x60A, 0x60B}),
        ("can-ars408", {"output": "clusters"}, "ars408.dbc", {0x600, 0x701}),
        ("can-ldmrs", {"scan_frequency_hz": 50}, "ldmrs.dbc", {0x500, 0x502, 0x508}),
        ("can-esr", {"radiate": "always"}, "esr.dbc", {0x500, 0x4E0}),
        ("can-leddar-vu8", {"streaming": "start"}, "leddar_vu8.dbc", {0x751, 0x752}),
        ("can-leddar-m16", {"streaming": "start"}, "leddar_m16.dbc", {0x751, 0x750}),
    ],
)
def test_every_format_carries_what_the_echoes_show_and_cantools_decodes_it(
    model: str, device: dict[str, object], layout: str, heads: set[int]
) -> None:
    listing = LIST.replace("can-ars408", model).replace("}}\n", f"}}, device: {device}}}\n")
    trial = Trial(scenario.loads(YARD + listing + "duration_s: 1.2\n", Path("yard.yaml")), watchers=[seen := Frames()])
    verdict = trial.finish()
    trial.close()
    database = cantools.database.load_file(str(files("protocols.can_objects").joinpath(layout)))
    assert heads <= {frame.peer for frame in seen.frames}
    for frame in seen.frames:
        database.decode_message(frame.peer, frame.data)
    assert verdict.sensors[1]["objects"]["total"]["recall"] > 0.8


def test_lists_do_not_depend_on_the_processes_that_measure() -> None:
    digests = set()
    for workers in (0, 1, 2):
        trial = Trial(scenario.loads(YARD + LIST + "duration_s: 1\n", Path("yard.yaml")), workers)
        digests.add(trial.finish().sha256)
        trial.close()
    assert len(digests) == 1
