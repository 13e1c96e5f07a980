"""The page is what the kept results make, and the results hold what is promised."""

from __future__ import annotations

import json
from typing import Any

import pytest

from emulator.endurance.fuzz import PARSERS
from emulator.faults.catalogue import kinds
from tests.scoreboard import __main__ as maker
from tests.scoreboard.page import PAGE, RESULTS, page


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def test_the_page_is_made_from_the_results(results: dict[str, Any]) -> None:
    assert PAGE.read_text(encoding="utf-8") == page(results)


def test_every_fault_was_tried_seen_and_recovered_from(results: dict[str, Any]) -> None:
    rows = results["faults"]["faults"]
    assert rows.keys() == kinds().keys()
    assert results["faults"]["failed"] == 0
    assert [name for name, row in rows.items() if not (row["begin"] and row["hit"] and row["end"])] == []


def test_fuzzing_of_every_parser_found_nothing_that_is_left(results: dict[str, Any]) -> None:
    rows = {row["parser"]: row for row in results["fuzz"]["parsers"]}
    assert rows.keys() == {parser.name for parser in PARSERS}
    assert {name: row["faults"] for name, row in rows.items() if row["faults"]} == {}
    assert sum(row["cpu_s"] for row in rows.values()) >= 60.0


@pytest.mark.parametrize(("kind", "seconds"), [("virtual", 86_400.0), ("real", 600.0)])
def test_the_soaks_were_long_and_held(results: dict[str, Any], kind: str, seconds: float) -> None:
    soaked = results["soak"][kind]
    assert soaked["held"]
    assert soaked["faults"] == []
    assert soaked["simulated_s"] >= seconds
    assert all(row["unaccounted"] == 0 and row["sent"] > 0 for row in soaked["sensors"].values())


@pytest.mark.parametrize("place", ["protocols", "emulator/physics"])
def test_nearly_every_branch_is_reached(results: dict[str, Any], place: str) -> None:
    assert results["coverage"][place]["branches_percent"] >= 95.0


def test_mutants_are_caught(results: dict[str, Any]) -> None:
    found = results["mutants"]
    caught = found["killed"] + found["timeout"]
    assert caught >= 0.85 * (caught + found["survived"] + found["no_tests"])


def test_a_soak_is_kept_beside_the_other_kind(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(maker, "RESULTS", tmp_path / "board.json")
    monkeypatch.setattr(maker, "PAGE", tmp_path / "board.md")
    sensors = {"a": {"asked": 3, "sent": 2, "dropped": {"late": 1}, "unaccounted": 0}}
    reported = {"study": "soak", "simulated_s": 5.0, "wall_s": 1.0, "held": True, "faults": [], "sensors": sensors,
            "hosts": {}, "memory": {"rss_mb_rise_second_half": 0.5, "descriptors_peak": 9}}  # fmt: skip
    for kind in ("real", "virtual"):
        maker.keep(reported | {"kind": kind})
    assert json.loads((tmp_path / "board.json").read_text())["soak"].keys() == {"real", "virtual"}
    rows = [line for line in (tmp_path / "board.md").read_text().splitlines() if line.startswith("| 5 s")]
    assert rows == [f"| 5 s, {kind} | 1 | 3 | 2 | 1 | 0 | 0 | +0.5 | 9 | held |" for kind in ("real", "virtual")]
