"""A feed in a run: when sweeps are asked for, what limits hold, what the fixture and the report tell."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from emulator.errors import LinkError, ScenarioError
from emulator.judging.rig import Rig
from emulator.live.json_lines import MOST_BYTES, update_of
from emulator.live.receivers import MOST_OSI, Budget, line_in, message_in
from emulator.live.samples import BadSample
from emulator.runtime import assembly
from emulator.runtime.feeding import Feeding
from emulator.runtime.lead import FIRST_NS, FIRST_SPREAD, MARGIN_NS, SPREADS, Lead
from emulator.scenario.scenario import Scenario, dump, loads
from protocols.lms2xx.variants import STANDARD, comb
from protocols.scan import ScanPlan
from tests.live.test_osi import WORKED

MS = 1_000_000
CASE = """
schema: 1
actors: [{id: ego}, {id: car}]
sensors: [{id: front, model: sick-lms291-s05, links: ["pty:./front"]}]
live: LIVE
"""


def case(live: str, folder: Path = Path()) -> Scenario:
    return loads(CASE.replace("LIVE", live), folder / "case.yaml")


def feeding(live: str, real: Callable[[], int] | None = lambda: 0) -> tuple[Feeding, Any]:
    scenario = case(live)
    assert scenario.live is not None
    front = SimpleNamespace(sensor="front", poked=False, ledger=SimpleNamespace(now_ns=0))
    return Feeding(scenario, scenario.live, [front], real), front  # type: ignore[list-item]


def plan(start_ns: int) -> ScanPlan:
    nothing = np.zeros(11)
    return ScanPlan(0, 1, start_ns, nothing, nothing, np.linspace(0.0, 0.0133, 11), 0.0267)


def fed(found: Feeding, ms: int, stamp_ms: int | None = None) -> None:
    stamp = {} if stamp_ms is None else {"t_ns": stamp_ms * MS}
    found.take(update_of({"actors": [{"id": "car", "at_m": [0.01 * ms, 0, 0]}], **stamp}), ms * MS)


def test_in_real_time_a_sweep_is_asked_for_as_late_as_it_can_be_sent_in_time() -> None:
    found, _ = feeding("{feed: control, clock: {map: arrival}}")
    sweep, earliest = plan(1000 * MS), 750 * MS
    found.world("front", sweep, 900 * MS)
    found.came("front", sweep, 904 * MS)
    wanted_ns = round((1.0 + SPREADS * FIRST_SPREAD) * 4 * MS) + MARGIN_NS
    assert found.ask_ns("front", sweep, earliest) == 1026_700_000 - wanted_ns


def test_one_that_takes_longer_is_asked_for_earlier_from_then_on_and_a_stall_is_forgotten() -> None:
    found, _ = feeding("{feed: control, clock: {map: arrival}}")
    sweep = plan(1000 * MS)
    led = [1026_700_000 - found.ask_ns("front", sweep, 0)]
    for took in (4, 20, 4, *400 * (4,)):
        found.world("front", sweep, 900 * MS)
        found.came("front", sweep, (900 + took) * MS)
        led.append(1026_700_000 - found.ask_ns("front", sweep, 0))
    assert led[0] == FIRST_NS + MARGIN_NS, "none is late before it is known"
    assert led[2] > 20 * MS
    assert led[3] > 20 * MS, "the next one may take as long"
    assert led[50] - led[-1] < (led[2] - led[-1]) / 2
    assert led[-1] < led[1], "by now it is known that they take the same"
    assert led[-1] == pytest.approx(4 * MS + MARGIN_NS, rel=0.1)


def test_times_that_are_off_their_mean_by_as_much_have_so_many_times_that_for_room() -> None:
    lead = Lead()
    for number in range(2000):
        lead.add(10.0 * MS + (1.0 if number % 2 else -1.0) * MS)
    # of a mean that follows by 1/8 what alternates by 1 to both sides is off it by 1 / (1 - 1/16)
    off, mean = 16.0 / 15.0, 10.0 + 1.0 / 15.0
    assert lead.ns - MARGIN_NS == pytest.approx((mean + SPREADS * off) * MS, rel=1e-6)


@pytest.mark.parametrize(("spread", "most", "in_3000"), [(0.02, 1.1, 0), (0.05, 1.22, 0), (0.08, 1.35, 1)])
def test_an_even_machine_has_little_room_and_an_uneven_one_enough(spread: float, most: float, in_3000: int) -> None:
    lead, rng = Lead(), np.random.default_rng(2)
    led, late = [], 0
    for took_ns in 16.0 * MS * np.exp(spread * rng.standard_normal(3000)):
        led.append(lead.ns - MARGIN_NS)
        late += took_ns + 0.3 * MS > lead.ns  # what the sender needs behind it
        lead.add(took_ns)
    assert late <= in_3000
    assert float(np.median(led)) < most * 16.0 * MS


@pytest.mark.parametrize(
    ("before", "stall_ms", "most"), [(0, 2000.0, 240), (500, 1000.0, 220), (500, 200.0, 140)],
    ids=["the first one fills tables", "a second", "a fifth"],
)  # fmt: skip
def test_what_took_long_once_is_forgotten(before: int, stall_ms: float, most: int) -> None:
    lead = Lead()
    for took in [20.0 * MS] * before + [stall_ms * MS]:
        lead.add(took)
    assert lead.ns > 0.9 * stall_ms * MS, "the next one may take as long"
    lead.add(20.0 * MS)
    sweeps = 1
    while lead.ns > 40.0 * MS:
        lead.add(20.0 * MS)
        sweeps += 1
    assert sweeps < most


def test_what_the_sender_comes_late_to_ask_for_is_part_of_what_measuring_takes() -> None:
    now = [900 * MS]
    found, _ = feeding("{feed: control, clock: {map: arrival}}", lambda: now[0])
    sweep = plan(1000 * MS)
    due_ns = found.ask_ns("front", sweep, 0)
    now[0] = due_ns + 3 * MS
    found.ask_ns("front", sweep, 0)
    found.world("front", sweep, now[0])
    found.came("front", sweep, now[0] + 4 * MS)
    late = found.report()["measuring_ms"]
    assert isinstance(late, dict)
    assert late["worst"] == pytest.approx(7.0)
    found.ask_ns("front", plan(1050 * MS), 0)  # another one, of which nothing was said before it was late
    found.world("front", plan(1026 * MS), 1040 * MS)
    found.came("front", plan(1026 * MS), 1041 * MS)
    again = found.report()["measuring_ms"]
    assert isinstance(again, dict)
    assert again["worst"] == pytest.approx(7.0)


def test_or_as_soon_as_all_poses_are_known_that_its_beams_want() -> None:
    found, front = feeding("{feed: control, clock: {map: arrival}}")
    sweep = plan(1000 * MS)
    fed(found, 1010)
    assert found.ask_ns("front", sweep, 750 * MS) > 950 * MS
    assert not front.poked
    fed(found, 1014)
    assert front.poked
    assert found.ask_ns("front", sweep, 750 * MS) == 750 * MS


def test_in_virtual_time_at_its_end() -> None:
    found, _ = feeding("{feed: control}", None)
    assert found.ask_ns("front", plan(1000 * MS), 750 * MS) == 1026_700_000


def test_a_feeders_clock_is_mapped_and_its_restart_told() -> None:
    found, _ = feeding("{feed: control, clock: {delay_s: 0.02}, latency_s: 0.005}")
    for ms in range(0, 500, 10):
        fed(found, ms, 70_000 + ms)
    assert found.book.newest_s == pytest.approx(0.490 + 0.025)
    fed(found, 500, 3)
    assert found.book.counts["restart"] == 1
    assert found.report()["offset_ms"] == pytest.approx(497.0)


def test_silence_ends_the_run_only_where_that_is_wanted() -> None:
    for then, why in (("stop", "no poses for 0.6 s"), ("hold", "")):
        found, _ = feeding(f"{{feed: control, clock: {{map: arrival}}, silent: {{after_s: 0.5, then: {then}}}}}")
        assert found.look(10_000 * MS) == "", "it has not begun"
        fed(found, 1000)
        assert found.look(1400 * MS) == ""
        assert found.look(1600 * MS) == why


def test_an_address_that_is_taken_is_told() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        found, _ = feeding(f"{{feed: 'json-udp://127.0.0.1:{taken.getsockname()[1]}'}}")
        with pytest.raises(LinkError, match="want a free address"):
            found.open()


def test_more_updates_a_second_than_may_be_are_not_read() -> None:
    budget = Budget(1000)
    assert sum(budget.has_room(1000 * MS) for _ in range(500)) == 100
    assert sum(budget.has_room(1050 * MS) for _ in range(500)) == 50


@pytest.mark.parametrize(
    ("live", "reported"),
    [
        ("{feed: 'json-udp://0.0.0.0:47100'}", "beyond_loopback: true"),
        ("{feed: 'json-udp://192.168.1.4:47100'}", "beyond_loopback: true"),
        ("{feed: 'json-udp://example.org:1'}", "want an address"),
        ("{feed: 'json-udp:47100'}", "want json-udp://HOST:PORT"),
        ("{feed: 'json-udp://127.0.0.1:99999'}", "want 0 to 65535"),
        ("{feed: 'osi-trace:nothing.osi'}", "no file"),
        ("{feed: 'recording:nothing'}", "no recording"),
        ("{feed: control, ego: nobody}", "no actor 'nobody'"),
        ("{feed: control, bind: {x: nobody}}", "no actor 'nobody'"),
        ("{feed: control, actors: {models: {a: b}}}", "one of classes"),
        ("{feed: control, actors: {pool: 501}}", "pool"),
        ("{feed: control, colour: red}", "unknown key"),
        ("{feed: 'json-udp://127.0.0.1:1', clock: {map: lockstep}}", "lockstep"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(live: str, reported: str) -> None:
    with pytest.raises(ScenarioError, match=r"case.yaml:5: live") as found:
        case(live)
    assert reported in str(found.value)


def test_beyond_this_machine_where_it_is_said() -> None:
    assert case("{feed: 'json-udp://0.0.0.0:47100', beyond_loopback: true}").live is not None
    assert case("{feed: 'json-tcp://[::1]:0'}").live is not None


def test_a_dumped_scenario_is_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.jsonl").write_text('{"t_s": 0, "actors": []}\n')
    first = case(
        "{feed: 'json-file:a.jsonl', actors: {spawn: true, classes: {car: {mesh: 'builtin:car.glb'}}}}", tmp_path
    )
    again = loads(dump(first), Path("elsewhere/x.yaml"))
    assert again.live is not None
    assert again.live.place.path == str((tmp_path / "a.jsonl").resolve())


def test_the_fixture_moves_actors(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(CASE.replace("LIVE", "{feed: control}"))
    with Rig(str(path), tmp_path) as rig:
        rig.move("car", [1, 2, 0], velocity_m_s=[1, 0, 0])
        rig.advance(0.1)
        rig.move("car", [1.1, 2, 0], velocity_m_s=[1, 0, 0])
        assert rig.feed()["received"] == 2
        with pytest.raises(BadSample, match="at_m"):
            rig.move("car", [float("nan"), 0, 0])
        rig.poses([{"id": "nobody", "at_m": [0, 0, 0]}])
        assert rig.feed()["not wanted"] == 1
    path.write_text(CASE.partition("live:")[0])
    (tmp_path / "other").mkdir()
    with Rig(str(path), tmp_path / "other") as rig, pytest.raises(LookupError, match="live"):
        rig.move("car", [0, 0, 0])


def test_osi_by_tcp_arrives_each_message_after_its_length(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(CASE.replace("LIVE", "{feed: 'osi-tcp://127.0.0.1:0', ego: ego}"))
    data = len(WORKED).to_bytes(4, "little") + WORKED
    with Rig(str(path), tmp_path) as rig:
        kind, _, port = str(rig.feed_url).rpartition(":")
        assert kind == "osi-tcp://127.0.0.1"
        with socket.create_connection(("127.0.0.1", int(port))) as feeder:
            for byte in data:
                feeder.sendall(bytes((byte,)))
            while not rig.feed().get("received"):
                rig.advance(0.001)
            feeder.sendall((1 << 31).to_bytes(4, "little"))
            assert feeder.recv(1) == b"", "a length that cannot be ends the connection"
            while not rig.feed().get("dropped"):
                rig.advance(0.001)


def test_what_is_held_of_a_stream_has_a_limit() -> None:
    assert message_in(bytearray(b"\x03\0\0")) is None
    held = bytearray(b"\x03\0\0\0abcd")
    assert (message_in(held), held) == (b"abc", bytearray(b"d"))
    for size in (0, MOST_OSI + 1, 2**32 - 1):
        with pytest.raises(BadSample, match="little-endian"):
            message_in(bytearray(size.to_bytes(4, "little")))
    held = bytearray(b"{}\n[")
    assert (line_in(held), line_in(held)) == (b"{}", None)
    with pytest.raises(BadSample, match="bytes without its end"):
        line_in(bytearray(MOST_BYTES + 1))


def test_updates_by_udp_and_tcp_arrive(tmp_path: Path) -> None:
    from emulator.live.client import Feeder

    for kind in ("json-udp", "json-tcp"):
        path = tmp_path / f"{kind}.yaml"
        path.write_text(CASE.replace("LIVE", f"{{feed: '{kind}://127.0.0.1:0'}}"))
        (tmp_path / kind).mkdir()
        with Rig(str(path), tmp_path / kind) as rig, Feeder(str(rig.feed_url)) as feeder:
            while not rig.feed().get("received"):
                feeder.move("car", [1.0, 0.0, 0.0])
            feeder._socket.sendall(b"nonsense\n")
            while not rig.feed().get("dropped"):
                feeder.move("car", [1.0, 0.0, 0.0])


@pytest.mark.parametrize(("took_ms", "most_ms"), [(3, 7.0), (10, 10.0)])
def test_poses_at_the_beams_are_as_old_as_feed_and_measuring_make_them(took_ms: int, most_ms: float) -> None:
    """On a machine that has time: an LMS291 at 37.5 Hz, whose sweep takes so long to measure; none is late."""
    now = [0]
    found, _ = feeding("{feed: 'json-udp://127.0.0.1:0'}", lambda: now[0])
    rng, number, k, late = np.random.default_rng(1), 0, 0, 0
    fire = np.linspace(0.0, 0.0267, 361)
    while number < 200:
        sweep = ScanPlan(0, number, 1000 * MS + round(number * 1e9 / 37.5), fire, fire, fire, 1 / 37.5)
        came_ns = round(10 * k * MS + (0.1 + rng.exponential(0.05)) * MS)
        ask_ns = found.ask_ns("front", sweep, sweep.start_ns - 250 * MS)
        now[0] = max(now[0], min(came_ns, ask_ns))
        if came_ns <= ask_ns:
            row = {"id": "car", "at_m": [0.1 * k, 0, 0]}
            found.take(update_of({"t_ns": 10 * k * MS, "actors": [row]}), came_ns)
            k += 1
            continue
        found.world("front", sweep, now[0])
        done_ns = now[0] + round(took_ms * rng.uniform(0.9, 1.1) * MS)
        late += done_ns > sweep.start_ns + round(1e9 / 37.5)
        found.came("front", sweep, done_ns)
        number += 1
    age = found.report()["age_ms"]
    assert isinstance(age, dict)
    assert age["median"] <= most_ms
    assert late == 0
    report = found.report()
    medians = {}
    for name in ("newest_ms", "ahead_ms", "measuring_ms"):
        row = report[name]
        assert isinstance(row, dict)
        medians[name] = row["median"]
    assert medians["measuring_ms"] == pytest.approx(took_ms, rel=0.1)
    assert medians["newest_ms"] < 10.0 + 1.0, "a period of the feed, and its way"
    if took_ms == 3:
        assert medians["ahead_ms"] == 0.0, "most beams have fired"
    assert any("the newest sample is" in line and "play-out delay" in line for line in found.lines())


@pytest.mark.parametrize(("took_ms", "most_ms"), [(14, 9.2), (16, 9.6), (17, 10.5)])
def test_poses_at_the_beams_of_a_busy_lms291(took_ms: int, most_ms: float) -> None:
    """Its own beams, which fire in the first half of each turn; the sender wakes up 0.2 ms late and needs 0.3 ms."""
    now, ages = [0], []
    found, _ = feeding("{feed: 'json-udp://127.0.0.1:0'}", lambda: now[0])
    found.book.ages.note = lambda age_s, beyond: ages.append(age_s)  # type: ignore[method-assign]
    rng, number, k, late = np.random.default_rng(1), 0, 0, 0
    beams = comb(STANDARD, None)
    while number < 600:
        start_ns = 1000 * MS + round(number * 2e9 / 75)
        sweep = ScanPlan(0, number, start_ns, beams.azimuth_rad, beams.elevation_rad, beams.fire_offset_s, 2 / 75)
        came_ns = round(10 * k * MS + (0.1 + rng.exponential(0.05)) * MS)
        ask_ns = found.ask_ns("front", sweep, start_ns - 250 * MS)
        if came_ns <= ask_ns:
            now[0] = max(now[0], came_ns)
            found.take(update_of({"t_ns": 10 * k * MS, "actors": [{"id": "car", "at_m": [0.1 * k, 0, 0]}]}), came_ns)
            k += 1
            continue
        now[0] = max(now[0], ask_ns) + round(rng.exponential(0.2) * MS)
        found.world("front", sweep, now[0])
        now[0] += round(took_ms * MS * np.exp(0.03 * rng.standard_normal()))
        late += now[0] + 0.3 * MS > start_ns + 2e9 / 75
        found.came("front", sweep, now[0])
        number += 1
    assert late == 0
    assert 1e3 * float(np.median(np.concatenate(ages[40:]))) < most_ms


@pytest.mark.parametrize(("cores", "processes"), [(1, 1), (2, 1), (3, 2), (4, 3), (16, 4)])
def test_a_fed_run_has_processes_for_the_parts_of_a_sweep(
    monkeypatch: pytest.MonkeyPatch, cores: int, processes: int
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: set(range(cores)))
    text = CASE.replace("LIVE", "{feed: control}").replace("s05,", "s05, mount: {actor: ego},")
    drives = loads(text, Path("case.yaml"))
    assert assembly.fed_processes(drives) == processes
    assert assembly.fed_processes(loads(text[: text.index("live:")], Path("case.yaml"))) == 1
    assert assembly.fed_processes(case("{feed: control}")) == 1, "one at rest is not divided"
