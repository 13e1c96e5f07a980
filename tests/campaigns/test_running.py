"""Running, resuming, sharding and searching, with a stand-in for the run; the page and tables of what comes of it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import xml.etree.ElementTree as Tree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from emulator.campaigns.campaign import Campaign, Runner, Shard
from emulator.campaigns.case import DiskFull
from emulator.campaigns.engines import InPlace, Processes
from emulator.campaigns.page import write_page
from emulator.campaigns.sensitivity import indices
from emulator.campaigns.store import Store
from emulator.campaigns.table import gather, write_junit
from emulator.errors import EmulatorError
from tests.campaigns.conftest import PLACE, VISIBILITY, stand_in

Make = Callable[[str], Campaign]
GRID = f"factors: {{{VISIBILITY}: {{range: [50, 400], steps: 8}}, '{PLACE}': {{values: [4, 8]}}}}\ndesign: grid\n"
BOTH = f"factors: {{{VISIBILITY}: {{range: [50, 400]}}, '{PLACE}': {{range: [4, 12]}}}}\n"


def run(campaign: Campaign, engine: Any = None, **more: Any) -> tuple[Runner, Store, Any]:
    store = Store(campaign.job.out)
    store.make()
    runner = Runner(campaign, store, engine or InPlace(stand_in), **more)
    return runner, store, runner.run()


def test_what_is_done_is_not_run_again_and_a_damaged_case_is(made: Make) -> None:
    campaign = made(GRID)
    first, store, _ = run(campaign)
    assert (first.progress.before, first.progress.now) == (0, 16)
    assert run(campaign)[0].progress.now == 0
    names = sorted(campaign.names())
    store.place(names[0]).unlink()
    for path in (store.root / "index").iterdir():
        path.unlink()
    store.place(names[1]).write_text("", encoding="utf-8")
    again = run(campaign)[0]
    assert (again.progress.before, again.progress.now) == (14, 2)
    assert not list((store.root / "aside").iterdir())


def test_killed_in_the_middle_it_goes_on_where_it_was(made: Make) -> None:
    campaign = made(GRID)
    left = [5]

    def killed(*given: Any) -> Any:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return stand_in(*given)

    with pytest.raises(KeyboardInterrupt):
        run(campaign, InPlace(killed))
    assert run(campaign)[0].progress.now == 11


def test_shards_together_are_the_whole_with_the_same_rows(made: Make, tmp_path: Path) -> None:
    campaign = made(GRID)
    counts = [run(campaign, shard=Shard(number, 3))[0].progress.now for number in (2, 1, 3)]
    assert sum(counts) == 16
    assert 0 not in counts
    runner, store, _ = run(campaign)
    assert runner.progress.now == 0
    assert len(list(store.rows(campaign.names()))) == 16


def test_a_grid_made_wider_runs_the_new_points_alone(made: Make) -> None:
    run(made(GRID))
    assert run(made(GRID.replace("[4, 8]", "[4, 6, 8]")))[0].progress.now == 8


def test_another_version_is_refused_unless_all_is_run_anew(made: Make) -> None:
    campaign = made(GRID)
    store = Store(campaign.job.out)
    store.make()
    assert not store.begin("0.1", "c.yaml", "d")
    assert not store.begin("0.1", "c.yaml", "d")
    assert store.begin("0.1", "c.yaml", "e"), "a changed campaign is told of"
    with pytest.raises(EmulatorError, match=r"version 0\.1, this is 0\.2"):
        store.begin("0.2", "c.yaml", "e")
    store.forget_version()
    assert not store.begin("0.2", "c.yaml", "e")


def test_a_full_disk_stops_the_campaign_and_nothing_half_written_counts(
    made: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    from emulator.campaigns import case as cases

    campaign = made(GRID.replace("range: [50, 400], steps: 8", "values: [90]").replace("[4, 8]", "[4]"))

    def full(self: Store, row: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Store, "write", full)
    with pytest.raises(DiskFull, match="No space left"):
        run(campaign, InPlace(cases.run_case))
    monkeypatch.undo()
    assert run(campaign)[0].progress.now == 1


def test_a_case_that_crashes_or_hangs_is_counted_and_the_rest_goes_on(made: Make) -> None:
    campaign = made(
        f"factors: {{{VISIBILITY}: {{values: [60, 66, 77, 200, 300]}}}}\ndesign: grid\nlimits: {{seconds: 3}}\n"
    )
    engine = Processes(2, stand_in)
    try:
        runner, store, _ = run(campaign, engine)
    finally:
        engine.close()
    assert runner.progress.verdicts == {"failed": 1, "passed": 2, "crashed": 1, "hung": 1}
    rows = {row["factors"][VISIBILITY]: row for row in store.rows(campaign.names())}
    assert rows[66]["fault"] == "its process ended with signal 9"
    assert rows[77]["fault"] == "no end within 3 s"
    assert run(campaign)[0].progress.now == 0
    assert len(store.done(again=True)) == 3


def test_bisection_finds_where_the_verdict_changes_for_each_of_the_others(made: Make) -> None:
    text = f"factors: {{{VISIBILITY}: {{range: [50, 400]}}, '{PLACE}': {{values: [4, 8]}}}}\n"
    text += f"design: {{boundary: {{of: {VISIBILITY}, tolerance: 0.5}}}}\n"
    runner, _, outcome = run(made(text))
    for row, limit in zip(outcome["found"], (120.0, 140.0), strict=True):
        assert row["state"] == "passes above"
        assert row["low"] <= limit <= row["high"]
        assert row["high"] - row["low"] <= 0.5
    assert runner.progress.now == 2 * (2 + 10)
    again, _, same = run(made(text))
    assert (again.progress.now, same) == (0, outcome)


def test_bisection_tells_where_there_is_no_boundary(made: Make) -> None:
    text = f"factors: {{{VISIBILITY}: {{range: [300, 400]}}}}\ndesign: {{boundary: {{of: {VISIBILITY}}}}}\n"
    assert run(made(text))[2]["found"][0]["state"] == "passes everywhere"


def test_refined_sampling_gathers_at_the_boundary(made: Make) -> None:
    runner, store, _ = run(made(BOTH + "design: {boundary: {points: 150}}\n"))
    points = [row["factors"] for row in store.rows(runner.names())]
    near = sum(abs(one[VISIBILITY] - 100.0 - 5.0 * one[PLACE]) < 25.0 for one in points)
    assert near / len(points) > 3 * 50.0 / 350.0, "three times as dense as uniform sampling"


def test_the_worst_case_is_found_and_its_scenario_written(made: Make) -> None:
    runner, _, outcome = run(made(BOTH + "design: {worst: {of: near, find: min, points: 300}}\n"))
    assert outcome["factors"][VISIBILITY] == pytest.approx(300.0, abs=20.0)
    assert outcome["factors"][PLACE] == pytest.approx(9.0, abs=0.6)
    assert Path(outcome["scenario"]).is_file()
    assert runner.progress.now <= 300


@pytest.mark.parametrize(("half", "reached"), [(0.1, True), (0.001, False)])
def test_monte_carlo_runs_until_the_interval_is_narrow_enough(made: Make, half: float, reached: bool) -> None:
    text = f"design: {{monte_carlo: {{precision: {{of: pass, half_width: {half}}}, most: 400}}}}\n"
    _, _, outcome = run(made(BOTH + text))
    assert outcome["reached"] is reached
    assert (outcome["high"] - outcome["low"] <= 2 * half) is reached
    assert outcome["low"] < (400 - 140) / 350 < outcome["high"]
    assert (outcome["points"] == 400) is not reached


def test_repeats_of_a_search_are_not_sharded(made: Make) -> None:
    with pytest.raises(EmulatorError, match="--shard"):
        run(made(BOTH + "design: {boundary: {points: 20}}\n"), shard=Shard(1, 2))


def test_sobol_indices_are_those_of_a_known_function(made: Make) -> None:
    campaign = made(BOTH.replace("[50, 400]", "[200, 400]") + "design: {saltelli: 256}\n")
    runner, store, _ = run(campaign)
    results, _ = gather(campaign, store.rows(runner.names()), store.root)
    found = {one.factor: one for one in indices(campaign, results, "near")}
    # var of ((v-300)/100)^2, v even over 200..400: 4/45; of (p-9)^2, p even over 4..12: 41.76
    share = 41.76 / (41.76 + 4.0 / 45.0)
    assert found[PLACE].first == pytest.approx(share, abs=0.05)
    assert found[PLACE].total == pytest.approx(share, abs=0.05)
    assert found[VISIBILITY].total == pytest.approx(1.0 - share, abs=0.02)


def test_table_junit_and_page_have_every_case(made: Make, tmp_path: Path) -> None:
    import pyarrow.parquet as parquet

    campaign = made(GRID + "repeats: 2\n")
    runner, store, _ = run(campaign)
    results, path = gather(campaign, store.rows(runner.names()), store.root)
    table = parquet.read_table(path)
    assert table.num_rows == 32
    assert {VISIBILITY, "verdict", "quantity: near", "seconds", "sha256"} <= set(table.column_names)
    write_junit(campaign, results, 3, tmp_path / "j.xml")
    suite = Tree.parse(tmp_path / "j.xml").getroot()[0]
    assert (suite.get("tests"), suite.get("errors")) == ("33", "1")
    assert len(suite.findall("testcase/failure")) == results.counts()["failed"]
    page = write_page(campaign, store, results, 0, None, 0).read_text(encoding="utf-8")
    links = {part.partition('"')[0] for part in page.split('href="pages/')[1:]}
    assert len(links) >= 16
    assert all((store.root / "pages" / one).is_file() for one in links)


def test_reports_of_recorded_cases_are_begun_beside_the_page_and_waited_for(made: Make) -> None:
    campaign = made(GRID)
    runner, store, _ = run(campaign)
    results, _ = gather(campaign, store.rows(runner.names()), store.root)
    for name in runner.names():
        store.recording(name).mkdir(parents=True)
    begun: list[Path] = []
    ended: list[Path] = []

    def begin(work: Callable[[Path], None], folder: Path) -> Callable[[], object]:
        begun.append(folder)
        return lambda: ended.append(folder)

    write_page(campaign, store, results, 0, None, 3, begin)
    assert len(set(begun)) == 3
    assert ended == begun


def test_a_process_does_something_else_and_tells_when_it_cannot(tmp_path: Path) -> None:
    engine = Processes(1, stand_in)
    try:
        ends = [engine.begin(work, tmp_path / "a") for work in (Path.mkdir, Path.mkdir, _die)]
        ends[0]()
        assert (tmp_path / "a").is_dir()
        with pytest.raises(FileExistsError):
            ends[1]()
        with pytest.raises(EmulatorError, match="its process ended with signal 9"):
            ends[2]()
    finally:
        engine.close()


def _die(path: Path) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


EARLY = """
import os
from emulator.campaigns import forking
forking.PRELOAD[:] = []
try:
    with forking.begun_early(True):
        number = forking._number()
        assert os.path.exists(f"/proc/{number}")
        raise KeyError
except KeyError:
    assert os.waitid(os.P_PID, number, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None, "it has ended"
with forking.begun_early(False):
    assert forking._number() == number
with forking.begun_early(True):
    process = forking.context().Process(target=len, args=("begun again",))
    process.start()
    process.join()
    assert (process.exitcode, forking._number() != number) == (0, True)
print("so it is")
"""


def test_what_was_begun_early_ends_with_an_error_and_is_begun_again() -> None:
    done = subprocess.run([sys.executable, "-c", EARLY], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("so it is\n", "")


def test_without_pyarrow_the_table_is_csv(made: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    campaign = made(GRID)
    runner, store, _ = run(campaign)
    _, path = gather(campaign, store.rows(runner.names()), store.root)
    assert path.name == "results.csv"
    assert len(path.read_text(encoding="utf-8").splitlines()) == 17


def test_an_index_cut_in_a_line_costs_nothing(made: Make) -> None:
    campaign = made(GRID)
    _, store, _ = run(campaign)
    for path in (store.root / "index").iterdir():
        path.write_bytes(path.read_bytes()[:-40])
    assert len(list(store.rows(campaign.names()))) == 16
    assert all(json.loads(line) for line in store.indexed())


def test_a_row_without_all_its_keys_is_none_and_its_case_is_run(made: Make) -> None:
    campaign = made(GRID)
    _, store, _ = run(campaign)
    name = sorted(campaign.names())[3]
    line = json.dumps({"name": name, "verdict": "passed"})
    for path in (store.root / "index").iterdir():
        rows = path.read_text(encoding="utf-8").splitlines()
        path.write_text("".join(f"{line if name in row else row}\n" for row in rows), encoding="utf-8")
    assert len(list(store.rows(campaign.names()))) == 16  # its own file has them
    for path in (store.root / "index").iterdir():
        path.unlink()
    store.place(name).write_text(line + "\n", encoding="utf-8")
    assert len(list(store.rows(campaign.names()))) == 15
    assert run(campaign)[0].progress.now == 1
    results, _ = gather(campaign, store.rows(campaign.names()), store.root)
    assert len(results) == 16
    assert results.number.tolist() == sorted(results.number.tolist())


@pytest.mark.parametrize("with_pyarrow", [True, False])
def test_two_that_end_at_the_same_time_write_the_same_table(
    made: Make, monkeypatch: pytest.MonkeyPatch, with_pyarrow: bool
) -> None:
    campaign = made(GRID)
    _, store, _ = run(campaign)
    if not with_pyarrow:
        monkeypatch.setitem(sys.modules, "pyarrow", None)

    def meanwhile() -> Any:
        yield from list(store.rows(campaign.names()))
        gather(campaign, store.rows(campaign.names()), store.root)

    results, path = gather(campaign, meanwhile(), store.root)
    assert len(results) == 16
    assert path.stat().st_size > 1000
    assert not list((store.root / "aside").iterdir())
