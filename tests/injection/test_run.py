"""When faults begin and end: triggers, durations, seeds, live orders, accounts; what is told of wrong ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from emulator.commands.catalogue import rows
from emulator.errors import ScenarioError
from emulator.faults.catalogue import kinds
from emulator.faults.reading import FaultError
from emulator.judging.trial import Trial, run_trial
from emulator.recording.transcript import Transcript
from emulator.scenario import scenario
from protocols.lms2xx.schedule import AHEAD_SCANS
from tests.faults.bench import Bench


def hit_times(bench: Bench, number: int = 1) -> list[float]:
    return [event.at_ns * 1e-9 for event in bench.reported("hit") if event.number == number]


# ---------------------------------------------------------------- triggers


def test_by_time_one_telegram_is_hit() -> None:
    bench = Bench("line", {"do": "drop_telegram", "at_s": 2.0}).until(4.0)
    assert [2.0 <= at_s < 2.03 for at_s in hit_times(bench)] == [True]
    assert bench.row()["state"] == "over"


def test_the_nth_telegram_is_counted_from_the_first_one_on() -> None:
    clean = Bench("line").until(3.0).sent()
    bench = Bench("line", {"do": "drop_telegram", "at_telegram": 50}).until(3.0)
    assert [one.data for one in bench.sent()] == [one.data for one in [*clean[:49], *clean[50:]]]


def test_every_nth_scan_is_hit_and_no_reply() -> None:
    bench = Bench("line", {"do": "drop_telegram", "every": 10, "of": "scans"}).until(3.0)
    measured = bench.instrument.stats.scans_sent + 10
    assert bench.row()["hits"] == measured // 10 or bench.row()["hits"] == len(bench.sent(label="B0")) // 9
    assert {one.label for one in bench.sent()} == {"ACK", "A0", "B0", "B1"}


def test_count_ends_a_fault_for_good() -> None:
    bench = Bench("line", {"do": "drop_telegram", "every": 5, "count": 4}).until(4.0)
    assert (bench.row()["hits"], bench.row()["begun"], bench.row()["state"]) == (4, 4, "over")


def test_a_command_begins_it_each_time_it_is_taken() -> None:
    bench = Bench("line", {"do": "lose_reply", "on_command": "20 48", "for_telegrams": 2}).until(12.0)
    assert bench.row()["begun"] >= 2, "the host asks again, and ACK and reply are lost again"
    assert bench.row()["hits"] == 2 * bench.row()["begun"]
    assert not bench.decoded(0.0, 12.0)


def test_a_command_is_named_as_a_whole_word() -> None:
    bench = Bench("line", {"do": "drop_telegram", "on_command": "2"}).until(2.0)
    assert bench.row()["begun"] == 0


def test_by_chance_as_often_as_it_says_and_the_same_for_the_same_seed() -> None:
    keys = {"do": "drop_telegram", "probability": 0.25, "of": "scans"}
    one, two, other = (Bench("line", keys, seed=seed).until(12.0) for seed in (1, 1, 2))
    assert hit_times(one) == hit_times(two)
    assert hit_times(one) != hit_times(other)
    sent = one.instrument.stats.scans_sent
    share = one.row()["hits"] / (sent + one.row()["hits"])
    assert share == pytest.approx(0.25, abs=3 * (0.25 * 0.75 / 430) ** 0.5)


def test_two_faults_of_the_same_kind_draw_for_themselves() -> None:
    keys = {"do": "drop_telegram", "probability": 0.1}
    bench = Bench("line", keys, keys).until(6.0)
    assert set(hit_times(bench, 1)) != set(hit_times(bench, 2))


def test_an_expression_begins_it_at_the_end_of_the_scan_that_shows_it_and_ends_it_when_it_is_true_no_more() -> None:
    bench = Bench("line", {"do": "hang", "when": "front.nearest_m < 4"})
    measuring, request = bench.measuring, bench.measuring.request

    def nearer(sensor: str, plan: Any, *more: Any) -> None:
        request(sensor, plan, *more)
        if 2.0e9 < plan.start_ns < 3.0e9:
            measuring.done[sensor][-1].range_m[:] = 3.0

    measuring.request = nearer  # type: ignore[method-assign]
    bench.until(2.9)
    assert [event.at_ns * 1e-9 for event in bench.reported("begin")] == [pytest.approx(2.02, abs=0.04)]
    bench.until(5.0)
    assert [event.at_ns * 1e-9 for event in bench.reported("end")] == [pytest.approx(3.02, abs=0.04)]
    assert bench.row()["state"] == "waiting"


def test_at_s_beside_another_trigger_says_from_when_on_it_counts() -> None:
    bench = Bench("line", {"do": "drop_telegram", "at_s": 2.0, "at_telegram": 3, "of": "scans"}).until(3.0)
    clean = [one.start_ns for one in Bench("line").until(3.0).sent(2.0, label="B0")]
    assert hit_times(bench) == [pytest.approx(clean[2] * 1e-9, abs=1e-3)]


# ---------------------------------------------------------------- durations


def test_for_s_and_for_telegrams() -> None:
    by_time = Bench("line", {"do": "drop_telegram", "at_s": 2.0, "for_s": 0.5}).until(4.0)
    assert by_time.row()["hits"] in (18, 19)
    by_number = Bench("line", {"do": "drop_telegram", "at_s": 2.0, "for_telegrams": 7}).until(4.0)
    assert by_number.row()["hits"] == 7


def test_a_state_holds_until_it_is_cleared() -> None:
    bench = Bench("line", {"do": "hang", "at_s": 2.0}).until(4.0)
    assert bench.row()["state"] == "active"
    assert bench.faults.clear(1, 4_000_000_000)["state"] == "over"
    assert bench.until(6.0).decoded(5.0, 6.0) >= 37


def test_a_fault_on_one_link_leaves_the_other_alone() -> None:
    bench = Bench("line", {"do": "drop_telegram", "at_s": 0.0, "for_s": 9.0, "of": "scans"}, links=1).until(3.0)
    assert not bench.sent(label="B0")
    two = Bench("line", hosts=True, links=2)
    two.faults.add({"on": "front", "do": "drop_telegram", "link": 1, "for_s": 9.0, "of": "scans"}, 0)
    two.until(3.0)
    assert {one.link for one in two.sent(label="B0")} == {0}
    assert two.instrument.stats.scans_dropped == {}, "they went out on the first link"
    assert two.decoded(2.0, 3.0) >= 37


# ---------------------------------------------------------------- accounts


@pytest.mark.parametrize("do", ["drop_telegram", "bad_checksum", "truncate_telegram", "hang", "flip_bits"])
def test_every_scan_is_on_account(do: str) -> None:
    entry = {"do": do, "at_s": 2.0, "for_s": 0.5}
    bench = Bench("line", entry).until(4.0)
    stats = bench.instrument.stats
    lost = stats.scans_dropped[f"fault {do}"]
    assert lost > 10
    clean = Bench("line").until(4.0).instrument.stats
    assert clean.scans_measured - clean.scans_sent == AHEAD_SCANS + 1, "measured ahead, and the one on its way"
    assert stats.scans_sent + stats.scans_dropped.total() == clean.scans_sent
    assert stats.scans_measured == clean.scans_measured
    assert lost == stats.scans_dropped.total()


def test_hits_are_told_up_to_a_bound_and_all_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("emulator.injection.running.MOST_HITS_REPORTED", 5)
    bench = Bench("line", {"do": "drop_telegram", "at_s": 1.0, "for_s": 1.0}).until(3.0)
    assert len(bench.reported("hit")) == 5
    assert bench.row()["hits"] > 30


def test_a_run_without_faults_has_nothing_of_them() -> None:
    bench = Bench("line").until(1.0)
    assert bench.instrument.faults is None


# ---------------------------------------------------------------- live


def test_a_live_fault_begins_at_once_and_has_a_number() -> None:
    bench = Bench("line").until(2.0)
    number = bench.faults.add({"on": "front", "do": "drop_telegram", "count": 3}, 2_000_000_000)
    assert number == 1
    bench.until(4.0)
    assert bench.row()["hits"] == 3
    assert 2.0 <= min(hit_times(bench)) < 2.05
    assert bench.faults.add({"on": "front", "do": "hang", "for_s": 1}, 4_000_000_000) == 2


def test_a_live_fault_that_cannot_be_is_told_with_what_is_allowed() -> None:
    bench = Bench("line")
    with pytest.raises(FaultError, match=r"do: 'drop_telegrm'; want a fault: drop_telegram"):
        bench.faults.add({"on": "front", "do": "drop_telegrm"}, 0)
    with pytest.raises(FaultError, match=r"on: 'rear'; want one of front"):
        bench.faults.add({"on": "rear", "do": "drop_telegram"}, 0)
    with pytest.raises(FaultError, match=r"on: missing; want front"):
        bench.faults.add({"do": "drop_telegram"}, 0)
    for link in (99, True, -1):
        with pytest.raises(FaultError) as reported:
            bench.faults.add({"on": "front", "do": "hang", "link": link}, 0)
        assert "\n" not in str(reported.value), "one mistake, one line"
    with pytest.raises(FaultError, match=r"number: 7; want none"):
        bench.faults.clear(7, 0)
    assert bench.faults.rows() == []


# ---------------------------------------------------------------- files

HEAD = """\
schema: 1
sensors:
  - {id: front, model: sick-lms291-s05, links: ["pty:./a"]}
  - {id: ld, model: sick-ld-lrs1000, links: ["tcp:127.0.0.1:0"]}
  - {id: objects, model: can-ars408, from: [front], links: ["socketcand:127.0.0.1:0/can0"]}
actors:
  - {id: car, shape: {box: {size_m: [4, 2, 1.5]}}, material: concrete}
faults:
"""


@pytest.mark.parametrize(
    ("entry", "reported"),
    [
        ("{on: front, do: drop_telegrm, at_s: 1}", "do: 'drop_telegrm'; want a fault: drop_telegram"),
        ("{on: frnt, do: drop_telegram, at_s: 1}", "on: 'frnt'; want front or one of front, ld, objects"),
        ("{on: front, do: drop_telegram}", "do: drop_telegram without a trigger; want one of at_s, at_telegram"),
        ("{on: front, do: power_cycle, at_s: 1}", "off_s: missing; want this key"),
        ("{on: front, do: power_cycle, at_s: 1, off_s: -3}", "off_s: -3; want a number > 0"),
        ("{on: front, do: power_cycle, at_s: 1, off_s: 3, for_s: 2}", "for_s: power_cycle does not have it; want"),
        ("{on: front, do: power_cycle, at_s: 1, of_s: 3, off_s: 3}", "of_s: unknown key; want off_s or one of"),
        ("{on: front, do: bus_off, at_s: 1}", "do: bus_off: front has links of the kind serial; want can"),
        ("{on: ld, do: wrong_baud, baud: 9600, at_s: 1}", "wrong_baud: ld has links of the kind stream; want serial"),
        ("{on: front, do: refuse_connections, at_s: 1}", "do: refuse_connections: front has pty:./a; want a tcp link"),
        ("{on: ld, do: wrong_address, at_s: 1}", "do: wrong_address: telegrams of sick-ld-lrs1000 have no such field"),
        ("{on: objects, do: e2e_counter, at_s: 1}", "e2e_counter: objects has no end-to-end protection; want"),
        ("{on: objects, do: missing_message, at_s: 1, label: ObjGenral}", "message 'ObjGenral'; want ObjGeneral, "),
        ("{on: objects, do: drop_telegram, every: 2, label: ObjGenral}", "label: message 'ObjGenral'; want ObjGeneral"),
        ("{on: objects, do: lost_object, at_s: 1, actor: bus}", "do: lost_object: actor 'bus'; want one of car"),
        ("{on: objects, do: invalid_signal, at_s: 1, signal: DistLon}", "signal 'DistLon'; want DistLong"),
        ("{on: front, do: drop_telegram, at_telegram: 0}", "at_telegram: 0; want a number >= 1"),
        ("{on: front, do: drop_telegram, every: 2, probability: 0.5}", "probability: beside every; want one trigger"),
        ("{on: front, do: drop_telegram, every: 2, for_s: 1, for_telegrams: 2}", "for_telegrams: beside for_s; want"),
        ("{on: front, do: drop_telegram, probability: 1.5}", "probability: 1.5; want a number <= 1"),
        ("{on: front, do: gap, gap_s: 1, at_s: 1, direction: from_host}", "direction: 'from_host'; want to_host"),
        ("{on: front, do: flip_bits, at_s: 1, direction: from_host, label: B0}", "label: beside direction from_host"),
        ("{on: front, do: drop_telegram, at_s: 1, link: 1}", "link: 1; want a number below 1"),
        ("{on: front, do: hang, when: front.nearest_m}", "when: 'front.nearest_m': a number where true or false"),
        ("{on: front, do: hang, when: front.nearest_on(cart) < 3}", "actor 'cart'; want car or another of world, car"),
        ("{on: front, do: hang, when: front.scans_per_s < 3}", "front.scans_per_s: known only at the end of a run;"),
        ("{on: front, do: hang, when: 1 < 2}", "when: '1 < 2': no sensor named; want something like"),
    ],
)  # fmt: skip
def test_a_wrong_fault_is_told_by_file_line_and_key(entry: str, reported: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        scenario.loads(HEAD + f"  - {entry}\n", Path("case.yaml"))
    lines = str(caught.value).splitlines()
    assert [line for line in lines if line.startswith("case.yaml:9: faults[0].") and reported in line], lines


def test_right_faults_pass_and_are_dumped_as_they_were() -> None:
    entry = '{on: front, do: power_cycle, when: "front.nearest_on(car) < 10", off_s: 3}'
    loaded = scenario.loads(HEAD + f"  - {entry}\n", Path("case.yaml"))
    again = scenario.loads(scenario.dump(loaded), Path("again.yaml"))
    assert again.faults == loaded.faults


def test_the_catalogue_has_forty_faults_and_more_each_with_a_sentence() -> None:
    table = rows("faults")
    assert len(table) == len(kinds()) >= 58
    assert {row["layer"] for row in table} == {
        "photon", "mechanics", "measurement", "clock", "telegram", "byte", "link", "can",
    }  # fmt: skip
    assert all(str(row[key]).endswith(".") for row in table for key in ("summary", "ends"))
    keys = {row["key"]: row for row in rows("faults", "power_cycle")}
    assert keys["off_s"]["default"] == "required"
    assert "for_s" not in keys
    with pytest.raises(KeyError, match="want power_cycle"):
        rows("faults", "power_cicle")


# ---------------------------------------------------------------- whole runs

WHOLE = {
    "schema": 1,
    "seed": 5,
    "duration_s": 3,
    "world": [{"box": {"size_m": [0.3, 9, 4]}, "at_m": [6, 0, 0], "material": "concrete"}],
    "sensors": [
        {"id": "front", "model": "sick-lms291-s05", "device": {"resolution_deg": 1}},
        {"id": "rear", "model": "sick-lms291-s05", "device": {"resolution_deg": 1}},
    ],
    "faults": [
        {"on": "front", "do": "line_noise", "bit_error_rate": 1e-5, "at_s": 0.5, "for_s": 1},
        {"on": "rear", "do": "drop_telegram", "probability": 0.1},
        {"on": "rear", "do": "hang", "when": "front.nearest_m < 7", "for_s": 0.3},
    ],
    "expect": [{"that": "rear.faults(hang) == 1 and rear.faults(drop_telegram) > 2"}],
}


@pytest.mark.parametrize("workers", [0, 2])
def test_the_same_scenario_and_seed_give_the_same_bytes_in_place_and_by_workers(workers: int) -> None:
    loaded = scenario.loads(json.dumps(WHOLE), Path("whole.yaml"))
    found = run_trial(loaded, workers)
    assert found.held, found.judgements
    assert found.sha256 == run_trial(loaded, 0).sha256
    assert found.sensors[1]["faults"]["hang"] == {"begun": 1, "hits": 1}


def test_an_expression_on_one_sensor_begins_a_fault_of_another_that_rests() -> None:
    trial = Trial(scenario.loads(json.dumps(WHOLE), Path("whole.yaml")))
    assert isinstance(trial.transcript, Transcript)
    rear = trial.instruments[1]
    assert rear.faults is not None
    trial.finish()
    trial.close()
    assert rear.faults.running[-1].begun == 1


def test_the_page_has_the_catalogue() -> None:
    from emulator.faults.page import written

    text = (Path(__file__).resolve().parents[2] / "docs" / "faults.md").read_text(encoding="utf-8")
    assert text == written(text), "python -m emulator.faults.page"


def test_single_hits_now_and_then_are_told_as_hits_and_begin_once() -> None:
    bench = Bench("line", {"do": "drop_telegram", "every": 3, "of": "scans", "count": 20}).until(5.0)
    assert [len(bench.reported(what)) for what in ("begin", "hit", "end")] == [1, 20, 1]


@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
def test_scans_that_a_device_forgets_without_power_are_on_account(kind: str) -> None:
    bench = Bench(kind, {"do": "power_cycle", "at_s": 2.0, "off_s": 0.3}).until(2.2)
    stats = bench.instrument.stats
    assert stats.scans_dropped["switched off"] > 0
    assert stats.ledger.account()["asked"] == stats.scans_sent + stats.scans_dropped.total()


# ---------------------------------------------------------------- several at once


def test_two_power_cuts_that_overlap_are_one_start_up_at_the_end_of_the_longer() -> None:
    cuts = [{"do": "power_cycle", "at_s": 3.0, "off_s": 1.0}, {"do": "power_cycle", "at_s": 3.5, "off_s": 1.0}]
    bench = Bench("line", *cuts, {"do": "reboot", "at_s": 3.7}).until(13.0)
    assert bench.instrument.stats.restarts == 2
    assert bench.sent(label="90")[0].start_ns == 6_500_000_000, "two seconds after the second one has ended"
    assert bench.until(14.0).decoded(13.0, 14.0) >= 37


def test_two_wrong_speeds_leave_the_right_one_behind() -> None:
    first = {"do": "wrong_baud", "baud": 1200, "at_s": 2.0, "for_s": 1.0}
    second = {"do": "wrong_baud", "baud": 115_200, "at_s": 2.5, "for_s": 1.0}
    bench = Bench("line", first, second).until(3.6)
    assert bench.links[0].speed == 500_000
    assert bench.until(9.0).decoded(8.0, 9.0) >= 37


def test_a_port_is_open_again_when_the_last_one_lets_go_of_it() -> None:
    plug, refusal = {"do": "unplug", "at_s": 2.0, "for_s": 3.0}, {"do": "refuse_connections", "at_s": 3.0, "for_s": 5.0}
    bench = Bench("tcp", plug, refusal, {"do": "power_cycle", "at_s": 2.5, "off_s": 1.0}).until(7.9)
    assert not bench.end.connected
    assert bench.until(40.0).end.connected
    assert bench.decoded(39.0, 40.0) == 10


@pytest.mark.parametrize("kind", ["line", "tcp", "can"])
def test_a_slow_link_that_is_cleared_is_fast_again_at_once_and_what_waited_leaves(kind: str) -> None:
    bench = Bench(kind).until(3.0)
    number = bench.faults.add({"on": "front", "do": "slow_link", "bytes_per_s": 20}, 3_000_000_000)
    bench.until(4.0)
    trickled = sum(len(one.data) for one in bench.sent(3.0, 4.0) if one.end_ns > 3.05e9)
    assert trickled < 60
    bench.faults.clear(number, 4_000_000_000)
    bench.until(7.0)
    healthy = Bench(kind).until(7.0)
    if kind != "line":  # whose own pace lets the slower half of a second's telegrams go
        late = [one.sweep for one in bench.sent() if one.sweep is not None]
        assert late == [one.sweep for one in healthy.sent() if one.sweep is not None], "each scan once, in its order"
    assert [one.data for one in bench.sent(5.5)] == [one.data for one in healthy.sent(5.5)]
    assert [one.start_ns for one in bench.sent(5.5)] == [one.start_ns for one in healthy.sent(5.5)]
    assert bench.instrument.stats.scans_sent == healthy.instrument.stats.scans_sent


def test_what_waits_for_a_slow_link_is_gone_when_the_power_is_cut() -> None:
    bench = Bench("tcp").until(3.0)
    bench.faults.add({"on": "front", "do": "slow_link", "bytes_per_s": 20}, 3_000_000_000)
    bench.until(4.0)
    cut = bench.faults.add({"on": "front", "do": "power_cycle", "off_s": 0.5}, 4_000_000_000)
    bench.until(4.4)
    taken = bench.row(cut)["taken"]
    assert taken["bytes"] > 5_000
    assert bench.sent(4.001, 4.4) == []


def test_a_telegram_held_back_on_one_link_leaves_there_alone() -> None:
    bench = Bench("line", links=2).until(3.0)
    bench.faults.add({"on": "front", "do": "slow_link", "bytes_per_s": 1000, "link": 1, "for_s": 1.0}, 3_000_000_000)
    bench.until(6.0)
    first = [one.data for one in bench.sent(3.1) if one.link == 0]
    healthy = [one.data for one in Bench("line", links=2).until(6.0).sent(3.1) if one.link == 0]
    assert first == healthy


def test_a_run_forgets_faults_that_are_over_and_takes_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("emulator.injection.run.MOST_FAULTS", 3)
    bench = Bench("line", {"do": "drop_telegram", "every": 7}).until(1.0)
    for turn in range(6):
        number = bench.faults.add({"on": "front", "do": "range_offset"}, bench.run.clock.now_ns())
        assert number == turn + 2
        bench.until(1.5 + turn)
        bench.faults.clear(number, bench.run.clock.now_ns())
    assert [row["number"] for row in bench.faults.rows()] == [1, 6, 7]
    assert bench.instrument.faults is not None
    counts = bench.instrument.faults.counts()["range_offset"]
    assert counts["begun"] == 6, "forgotten ones stay on account"
    assert bench.instrument.faults.hits_of("range_offset") == counts["hits"] > 6
    bench.until(30.0)
    assert len(bench.instrument.faults.live) == 1
    bench.faults.add({"on": "front", "do": "range_offset", "for_s": 0.1}, bench.run.clock.now_ns())
    bench.until(31.0)
    assert len(bench.instrument.conditions.faults) == 1, "plans do not carry what is long over"
    for _ in range(2):
        bench.faults.add({"on": "front", "do": "drop_telegram", "every": 7}, 0)
    with pytest.raises(FaultError, match="3 faults are waiting or active; want some of them cleared"):
        bench.faults.add({"on": "front", "do": "hang"}, 0)


def test_a_device_that_stops_with_its_motor_is_hit() -> None:
    bench = Bench("tcp", {"do": "mirror_stuck", "at_s": 3.0, "for_s": 0.5}).until(4.0)
    assert bench.row()["hits"] >= 1
