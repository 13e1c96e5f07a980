"""Virtual time: the same run in whatever processes it is measured, read and stepped."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest

from emulator.errors import LinkError, ScenarioError
from emulator.instrument.observer import Observer, Payload
from emulator.judging.trial import Trial, run_trial
from emulator.runtime import assembly
from emulator.runtime.virtual import ByteSteps
from emulator.scenario import scenario
from emulator.transports.can_link import CanLink
from emulator.transports.link import Received
from emulator.transports.loopback import LoopLink

WALL = """\
schema: 1
seed: 3
duration_s: 0.8
world:
  - {plane: {size_m: [6, 60]}, at_m: [8, 0, 1], pitch_deg: -90, material: white_plaster}
actors:
  - {id: post, shape: {box: {size_m: [0.2, 0.2, 2]}}, material: white_plaster, motion: {at_m: [4, 0, 0]}}
sensors:
  - {id: front, model: sick-lms291-s05, mount: {at_m: [0, 0, 1]}, device: {resolution_deg: 1, field_deg: 100, unit: mm}}
  - {id: top, model: sick-ld-lrs1000, mount: {at_m: [0, 0, 1]}, device: {delays: fast, step_deg: 2.0}}
"""


def load(text: str = WALL) -> scenario.Scenario:
    return scenario.loads(text, Path("case.yaml"))


def expecting(*lines: str, text: str = WALL) -> scenario.Scenario:
    return load(text + "expect:\n" + "".join(f"  - {line}\n" for line in lines))


@pytest.fixture(scope="module")
def reference() -> str:
    return run_trial(load()).sha256


@pytest.mark.parametrize("workers", [1, 2])
def test_worker_processes_change_no_byte_and_no_instant(reference: str, workers: int) -> None:
    assert run_trial(load(), workers).sha256 == reference


def test_the_transcript_is_the_same_however_time_is_stepped(reference: str) -> None:
    trial = Trial(load())
    run = trial.run
    assert run.step_scans(3, 800_000_000) >= 3
    assert run.clock.now_ns() < 800_000_000
    for at_ns in range(run.clock.now_ns(), 800_000_000, 7_654_321):
        run.advance(at_ns)
    assert trial.finish().sha256 == reference


def test_a_step_by_scans_ends_with_the_last_byte_of_the_last_one() -> None:
    trial = Trial(load())
    link = trial.instruments[0].links[0]
    seen: list[Payload] = []
    watcher = Observer()
    watcher.payload = seen.append  # type: ignore[method-assign]
    trial.instruments[0].watch(watcher)
    for count in (1, 1, 3):
        before = [one for one in seen if one.sweep is not None]
        assert trial.run.step_scans(count, 800_000_000, "front") == count
        scans = [one for one in seen if one.sweep is not None]
        assert len(scans) == len(before) + count
        assert scans[-1].end_ns == trial.run.clock.now_ns()
        assert link.stats.bytes_out == sum(len(one.data) for one in seen if one.sent)


def test_a_step_by_lists_on_a_bus_ends_with_the_last_frame_of_the_list() -> None:
    trial = Trial(scenario.load("fog_objects"))
    seen: list[Payload] = []
    watcher = Observer()
    watcher.payload = seen.append  # type: ignore[method-assign]
    radar = next(one for one in trial.instruments if isinstance(one.links[0], CanLink))
    radar.watch(watcher)
    for _ in range(4):
        assert trial.run.step_scans(1, 10_000_000_000, radar.sensor) == 1
        count = len(seen)
        assert trial.run.step_scans(1, trial.run.clock.now_ns() + 20_000_000, radar.sensor) == 0  # a list takes 80 ms
        assert not [one for one in seen[count:] if 0x60B <= one.peer <= 0x60D]
    assert [one.peer for one in seen].count(0x60A) == 4
    assert len([one for one in seen if one.peer == 0x60B]) > 4


class Pulled:
    """A link that goes at an instant, and tells it each time that it is asked."""

    def __init__(self, trial: Trial, index: int, at_ns: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self._link, self._at_ns, self.asked = trial.instruments[index].links[0], at_ns, 0
        self._receive = self._link.receive
        monkeypatch.setattr(self._link, "receive", self.receive)

    def receive(self, now_ns: int) -> list[Received]:
        if now_ns < self._at_ns:
            return self._receive(now_ns)
        self.asked += 1
        raise LinkError(f"{self._link.url}: lost: pulled")


def sent_by(trial: Trial, sensor: int) -> list[Payload]:
    seen: list[Payload] = []
    watcher = Observer()
    watcher.payload = seen.append  # type: ignore[method-assign]
    trial.instruments[sensor].watch(watcher)
    return seen


@pytest.mark.parametrize("lost", [0, 1])
def test_a_sensor_that_loses_its_link_is_told_once_and_the_others_go_on(
    lost: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, hurt = Trial(load()), Trial(load())
    expected, found, silent = sent_by(whole, 1 - lost), sent_by(hurt, 1 - lost), sent_by(hurt, lost)
    pulled = Pulled(hurt, lost, 400_000_000, monkeypatch)
    reported: list[tuple[str, str]] = []
    hurt.run._on_lost = lambda sensor, error: reported.append((sensor, str(error)))
    for trial in (whole, hurt):
        for end_ns in (500_000_000, 800_000_000):
            trial.run.advance(end_ns)
    assert found == expected
    assert found[-1].start_ns > 700_000_000
    assert silent[-1].start_ns < 450_000_000
    name = hurt.instruments[lost].sensor
    assert reported == [(name, f"loop:{name}: lost: pulled")]
    assert pulled.asked == 1
    assert hurt.run.lost == {name}
    hurt.instruments[lost].poked = True  # as a fault ordered for it does
    assert hurt.run.step_scans(1, 900_000_000, name) == 0


def test_a_run_that_nobody_watches_over_ends_with_its_link(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = Trial(load())
    Pulled(trial, 0, 400_000_000, monkeypatch)
    with pytest.raises(LinkError, match="lost: pulled"):
        trial.run.advance(800_000_000)


def test_with_its_last_link_a_virtual_run_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    linked = [f"sensors.{name}.links=['loop:{name}']" for name in ("front", "top")]
    daemon, _ = assembly.start_virtual(scenario.loads(WALL, Path("case.yaml"), linked), 1.0)
    said: list[str] = []
    daemon.on_failure = said.append
    for link in daemon.links:
        monkeypatch.setattr(link, "receive", lambda now_ns, url=link.url: broken(url))
    daemon.power_on()
    daemon.run()
    daemon.close()
    assert said == daemon.lost_links == ["loop:front: lost", "loop:top: lost"]


def broken(url: str) -> list[Received]:
    raise LinkError(f"{url}: lost")


def test_another_seed_gives_other_bytes(reference: str) -> None:
    assert run_trial(load(WALL.replace("seed: 3", "seed: 4"))).sha256 != reference


def test_a_run_can_be_stepped_byte_by_byte(reference: str) -> None:
    trial = Trial(load())
    steps = ByteSteps(trial.run, "front")
    for instrument in trial.instruments:
        instrument.watch(steps)
    out = trial.instruments[0].links[0].stats
    times = []
    for count in range(1, 12):
        assert steps.step(1, 800_000_000) == 1
        assert out.bytes_out == count
        times.append(trial.run.clock.now_ns())
    assert times == sorted(set(times))
    gaps = [later - earlier for earlier, later in itertools.pairwise(times[1:])]
    assert all(gap == pytest.approx(10 / 9600 * 1e9, abs=2) for gap in gaps[:8])  # the reply's bytes at 9600 baud
    assert trial.finish().sha256 == reference


def test_expectations_hold_that_the_scene_and_the_protocol_fix() -> None:
    found = run_trial(
        expecting(
            "{that: front.scans_per_s, within: [74.9, 75.1]}",
            "{that: front.range_at(0), within: [3.85, 3.95]}",
            "{that: front.range_at(10), within: [8.07, 8.17]}",
            "{that: front.range_error_m, at_most: 0.00051}",
            "{that: front.points_on(post), at_least: 2}",
            "{that: front.nearest_on(post), within: [3.85, 3.95]}",
            "{that: top.range_error_m, at_most: 0.0021}",
            "{that: top.scans_read, at_least: 3}",
            "{that: front.scans_dropped + front.input_dropped, equals: 0}",
            '{that: "max(front.gap_s) < 0.014 and count(front.points, ) > 1"}'.replace(", )", ")"),
            "{that: front.scans_sent, at_most: 16, from_s: 0.2, to_s: 0.4}",
        )
    )
    assert [(item.name, item.found) for item in found.judgements if not item.held] == []


def test_an_expectation_that_fails_says_what_was_found() -> None:
    found = run_trial(
        expecting("{that: front.range_at(0), within: [8.9, 9.1], name: far}", "{that: front.object(post), at_least: 1}")
    )
    assert [item.held for item in found.judgements] == [False, False]
    assert found.judgements[0].name == "far"
    assert "3.9" in found.judgements[0].found
    assert found.judgements[0].wanted == "8.9 to 9.1"


@pytest.mark.parametrize(
    ("line", "reported"),
    [
        ("{that: frnt.points}", "case.yaml:12: expect[0].that: 'frnt.points': sensor 'frnt'; want front or another of"),
        ("{that: front.ponts}", "front.ponts; want points"),
        ("{that: front.points_on(lorry)}", "actor 'lorry'; want one of world, post"),
        ("{that: front.points_on}", "actor None"),
        ("{that: front.range_at(left)}", "azimuth in degrees"),
        ("{that: front.points(3)}", "takes nothing in parentheses"),
        ("{that: points}", "want SENSOR.QUANTITY"),
        ("{that: front.points, below: 3}", "expect[0].below: 3; want that, within"),
        ("{that: front.points, within: [2, 1]}", "lower bound first"),
        ("{that: front.points, at_least: many}", "at_least: 'many'; want a number"),
        ("{that: front.points, equals: 1, at_most: 2}", "want one of"),
        ("{that: 'front.points >'}", "want a number, a name or '('"),
    ],
)
def test_an_expectation_of_what_does_not_exist_is_told_before_anything_runs(line: str, reported: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        run_trial(expecting(line))
    assert reported in str(caught.value)


@pytest.mark.parametrize("order", ["at once", "late", "never"])
def test_the_order_in_which_hosts_read_changes_nothing(order: str) -> None:
    digests = []
    for reads in ("at once", order):
        trial = Trial(load())
        trial.run.hosts = ()
        trial.run._host_wakes = []
        hosts = [
            instrument.links[0].connect(at_ns=1)  # type: ignore[attr-defined]
            for instrument in trial.instruments
        ]
        hosts[0].write(bytes.fromhex("02 00 02 00 20 24 34 08"), 50_000_000)
        hosts[1].write(bytes.fromhex("02 55 53 50 00 00 00 04 04 03 00 00 07"), 55_000_000)
        hosts[1].write(bytes.fromhex("02 55 53 50 00 00 00 02 04 04 00"), 60_000_000)
        hosts[1].write(bytes.fromhex("02 55 53 50 00 00 00 06 03 01 00 00 3f ff c2"), 300_000_000)
        for step, at_ns in enumerate(range(0, 700_000_000, 20_000_000)):
            trial.run.advance(at_ns)
            if reads == "at once":
                for host in hosts:
                    host.read()
            elif reads == "late" and step % 7 == 6:
                for host in reversed(hosts):
                    host.read()
        assert trial.transcript.bytes > 2_000
        digests.append(trial.transcript.sha256())
    assert digests[0] == digests[1]


def test_a_host_of_whole_telegrams_reads_them_at_the_same_instants_in_fewer_steps() -> None:
    read, sha, steps = {}, {}, {}
    for woken_whole in (True, False):
        trial = Trial(load())
        (link,) = trial.instruments[0].links
        assert isinstance(link, LoopLink)
        assert link.wakes_whole
        link.wakes_whole = woken_whole
        own_step, count = trial.run.step, itertools.count()

        def step(until_ns: int, own: Any = own_step, count: Any = count) -> bool:
            next(count)
            return bool(own(until_ns))

        trial.run.step = step  # type: ignore[method-assign]
        sha[woken_whole] = trial.finish().sha256
        read[woken_whole] = [at_ns for at_ns, _, _ in trial.series.sensors["front"].read]
        steps[woken_whole] = next(count)
        trial.close()
    assert sha[True] == sha[False]
    assert read[True] == read[False]
    assert len(read[True]) > 10
    assert steps[True] < 0.8 * steps[False]


def test_where_a_fault_may_end_a_telegram_its_parts_are_heard() -> None:
    trial = Trial(load(WALL + "faults: [{do: drop_telegram, on: front, at_s: 0.5, for_s: 0.1}]\n"))
    (link,) = trial.instruments[0].links
    assert isinstance(link, LoopLink)
    assert not link.wakes_whole
    trial.close()
