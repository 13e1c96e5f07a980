"""Files, factors and designs of campaigns: what is refused, where, and which points there are."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.campaigns.campaign import Shard, load
from emulator.campaigns.factors import Factor
from emulator.campaigns.naming import Job, cases_of
from emulator.errors import ScenarioError

HEAD = "scenario: flat_wall\nset: {duration_s: 0.2}\n"
VISIBILITY = "weather.fog.visibility_m"
MANY = "{range: [5, 70], steps: 90000}"
EXPECT = "expect: [{that: min(front.points) > 250}]\nquantities: {near: min(front.nearest_m)}\n"


def campaign(tmp_path: Path, text: str, head: str = HEAD):
    path = tmp_path / "c.yaml"
    path.write_text(head + text, encoding="utf-8")
    return load(path, tmp_path / "out")


@pytest.mark.parametrize(
    ("text", "line", "found"),
    [
        ("factors: {wether.fog: {values: [1]}}\ndesign: grid\n", 3, "wether"),
        (f"factors: {{{VISIBILITY}: {{values: [50, -3]}}}}\ndesign: grid\n", 3, "-3"),
        ("factors: {sensors.rear.mode: {values: [seed]}}\ndesign: grid\n", 3, "rear"),
        (f"factors: {{{VISIBILITY}: {{range: [50, 20]}}}}\ndesign: {{lhs: 8}}\n", 3, "lower bound first"),
        (f"factors: {{{VISIBILITY}: {{range: [50, 70]}}}}\ndesign: grid\n", 3, "want steps"),
        (f"factors: {{{VISIBILITY}: {{range: [50, 70], values: [3]}}}}\ndesign: grid\n", 3, "one of values, range"),
        (f"factors: {{{VISIBILITY}: {{range: [50, 70]}}}}\ndesign: {{sobol: 100}}\n", 4, "64 or 128"),
        (f"factors: {{{VISIBILITY}: {MANY}, seed: {MANY}}}\ndesign: grid\n", 4, "at most"),
        (f"factors: {{{VISIBILITY}: {{range: [50, 70]}}}}\ndesign: {{annealing: 3}}\n", 4, "annealing"),
        (f"factors: {{{VISIBILITY}: {{range: [50, 70]}}}}\ndesign: {{lhs: 0}}\n", 4, "> 0"),
        (f"factors: {{{VISIBILITY}: {{range: [50, 70]}}}}\ndesign: {{worst: {{of: far}}}}\n", 4, "far"),
        (f"factors: {{{VISIBILITY}: {{values: [50]}}}}\ndesign: {{boundary: {{of: {VISIBILITY}}}}}\n", 4, "range"),
        (f"factors: {{{VISIBILITY}: {{table: none.csv}}}}\ndesign: grid\n", 3, "none.csv"),
        (f"factors: {{{VISIBILITY}: {{distribution: {{law: normal, mean: 3}}}}}}\ndesign: {{lhs: 4}}\n", 3, "std"),
        (f"factors: {{{VISIBILITY}: {{values: [50]}}}}\ndesign: grid\nquantities: {{a: rear.points}}\n", 5, "rear"),
        (f"factors: {{{VISIBILITY}: {{values: [50]}}}}\ndesign: grid\nexpect: [{{that: a.b > 3}}]\n", 5, "'a'"),
        (f"factors: {{{VISIBILITY}: {{values: [50]}}}}\n", 0, "design"),
        ("design: grid\n", 0, "factor"),
    ],
)  # fmt: skip
def test_a_bad_campaign_is_refused_with_file_and_line(tmp_path: Path, text: str, line: int, found: str) -> None:
    with pytest.raises(ScenarioError) as error:
        campaign(tmp_path, text)
    assert found in str(error.value)
    assert f"c.yaml:{line}:" in str(error.value) or line == 0
    assert len(error.value.lines) < 4


FACTOR = f"factors: {{{VISIBILITY}: {{values: [50, 60]}}}}\n"
PLACE = "{'world[0].at_m[0]': {values: [5, 6]}, 'world.0.at_m': {values: [[5, 0, 1]]}}"


@pytest.mark.parametrize(
    ("text", "line", "found"),
    [
        (
            f"set: {{{VISIBILITY}: 40}}\n{FACTOR}",
            3,
            f"factors.{VISIBILITY}: replaces set.{VISIBILITY}; want one of them",
        ),
        (f"set: {{{VISIBILITY}: 40}}\nfactors: {{weather.fog: {{values: [null]}}}}\n", 3, "replaces set.weather"),
        ("set:\n  sensors[0].mode: seed\nfactors: {sensors.front.mode: {values: [seed]}}\n", 4, "sensors[0].mode"),
        (f"factors: {PLACE}\n", 2, "factors.world.0.at_m: replaces factors.world[0].at_m[0]"),
        (
            f"factors:\n  a: {{keys: [{VISIBILITY}], values: [5]}}\n  b: {{keys: [{VISIBILITY}], values: [6]}}\n",
            4,
            f"factors.b: {VISIBILITY} replaces factors.a",
        ),
        (f"set:\n  seed: 5\n{FACTOR}", 3, "set.seed: each case has a seed of its own; want seed beside scenario"),
        (f"set: {{expect: []}}\n{EXPECT}{FACTOR}", 3, "expect: replaces set.expect"),
    ],
)
def test_a_value_that_another_would_replace_is_refused(tmp_path: Path, text: str, line: int, found: str) -> None:
    with pytest.raises(ScenarioError) as error:
        campaign(tmp_path, text + "design: grid\n", "scenario: flat_wall\n")
    (reported,) = error.value.lines
    assert found in reported
    assert f"c.yaml:{line}:" in reported


def test_a_factor_may_change_a_part_of_what_is_set(tmp_path: Path) -> None:
    found = campaign(tmp_path, f"set: {{weather.fog: {{visibility_m: 40}}}}\n{FACTOR}design: grid\n", HEAD[:20])
    assert [case.point for case in found.cases()] == [((50,),), ((60,),)]


def test_a_scenario_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"nowhere\.yaml"):
        campaign(tmp_path, f"factors: {{{VISIBILITY}: {{values: [5]}}}}\ndesign: grid\n", "scenario: nowhere.yaml\n")


def test_a_grid_has_every_combination_once(tmp_path: Path) -> None:
    both = f"{VISIBILITY}: {{range: [10, 1000], steps: 3, scale: log}}, 'world[0].at_m[0]': {{values: [4, 8]}}"
    made = campaign(tmp_path, f"factors: {{{both}}}\ndesign: grid\nrepeats: 2\n")
    cases = list(made.cases())
    assert [case.point for case in cases[::2]] == [
        ((10.0,), (4,)), ((10.0,), (8,)), ((100.0,), (4,)), ((100.0,), (8,)), ((1000.0,), (4,)), ((1000.0,), (8,))
    ]  # fmt: skip
    assert len({case.name for case in cases}) == made.count == 12
    assert len({case.seed for case in cases}) == 12
    scenario = made.job.changed(cases[-1].point, cases[-1].seed)
    assert scenario.weather.fog.visibility_m == 1000.0
    assert scenario.world[0].at_m[0] == 8
    assert scenario.seed == cases[-1].seed


@pytest.mark.parametrize("design", ["{lhs: 64}", "{sobol: 64}", "{monte_carlo: {points: 64}}"])
def test_random_designs_keep_to_their_laws_and_are_the_same_again(tmp_path: Path, design: str) -> None:
    text = (
        f"factors:\n  {VISIBILITY}: {{range: [10, 1000], scale: log}}\n  'world[0].at_m[0]': {{distribution: "
        f"{{law: normal, mean: 8, std: 1, low: 6}}}}\n  seed: {{range: [1, 9], whole: true}}\ndesign: {design}\n"
    )
    first, again = campaign(tmp_path, text), campaign(tmp_path, text)
    assert list(first.cases()) == list(again.cases())
    points = np.array([[value for (value,) in case.point] for case in first.cases()])
    assert len(points) == 64
    assert points[:, 0].min() >= 10
    assert points[:, 0].max() <= 1000
    assert np.median(points[:, 0]) == pytest.approx(100.0, rel=0.6), "equal shares of each decade"
    assert points[:, 1].min() >= 6
    assert points[:, 1].mean() == pytest.approx(8.05, abs=0.4)
    assert set(points[:, 2]) <= set(range(1, 10))


def test_more_points_of_a_sobol_design_keep_the_first_ones_and_their_names(tmp_path: Path) -> None:
    text = f"factors: {{{VISIBILITY}: {{range: [10, 1000]}}}}\ndesign: {{sobol: N}}\n"
    few = [case.name for case in campaign(tmp_path, text.replace("N", "8")).cases()]
    many = [case.name for case in campaign(tmp_path, text.replace("N", "32")).cases()]
    assert many[:8] == few


def test_a_table_sets_several_keys_at_once_and_a_column_one(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"{VISIBILITY},sensors.front.device.unit\n50,cm\n60.5,mm\n", encoding="utf-8")
    made = campaign(tmp_path, "factors: {both: {table: t.csv}}\ndesign: grid\n")
    assert [case.columns(made.job) for case in made.cases()] == [
        {VISIBILITY: 50, "sensors.front.device.unit": "cm"},
        {VISIBILITY: 60.5, "sensors.front.device.unit": "mm"},
    ]
    one = campaign(tmp_path, f"factors: {{{VISIBILITY}: {{table: t.csv, column: {VISIBILITY}}}}}\ndesign: grid\n")
    assert [case.point for case in one.cases()] == [((50,),), ((60.5,),)]


def test_a_name_changes_with_all_that_a_run_depends_on_and_with_nothing_else(tmp_path: Path) -> None:
    text = f"factors: {{{VISIBILITY}: {{values: [50]}}}}\ndesign: grid\n" + EXPECT

    def name(text: str, head: str = HEAD) -> str:
        return next(campaign(tmp_path, text, head).cases()).name

    usual = name(text)
    assert name(text + "limits: {seconds: 7}\nrecord: none\n") == usual
    assert name(text.replace("[50]", "[50, 60]")) == usual
    others = [
        name(text, HEAD.replace("0.2", "0.3")), name(text.replace("50]", "51]")), name(text + "seed: 1\n"),
        name(text.replace("> 250", "> 251")), name(text.replace("nearest_m", "points")),
    ]  # fmt: skip
    assert len({usual, *others}) == 6


def test_shards_are_a_partition(tmp_path: Path) -> None:
    made = campaign(tmp_path, f"factors: {{{VISIBILITY}: {{range: [10, 1000]}}}}\ndesign: {{lhs: 300}}\n")
    names = made.names()
    parts = [{name for name in names if Shard(number, 3).has(name)} for number in (1, 2, 3)]
    assert set.union(*parts) == names
    assert sum(map(len, parts)) == 300
    assert min(map(len, parts)) > 60


FACTORS = (
    Factor("a.b", ("a.b",), (("a.b", 'c["d"].é'),), "x:1", (), 1e-9, 4e3),
    Factor("w", ("w",), (("w",),), "x:2", (), 0.0, 9.0, whole=True),
    Factor("l", ("l",), (("l",),), "x:3", tuple((one,) for one in (1, 1.0, True, None, 'a"é', [1, 2.5], 1e-7, -0.0))),
    Factor("t", ("p", "q"), (("p",), ("q",)), "x:4", (("day", 0.5), ("night", 1.0))),
)


@given(st.data())
def test_a_case_is_named_by_its_canonical_changes(data: st.DataObject) -> None:
    point = tuple(
        data.draw(st.sampled_from(one.levels))
        if one.levels
        else (one.clean(data.draw(st.floats(one.low, one.high, allow_subnormal=False))),)
        for one in FACTORS
    )
    job = SimpleNamespace(factors=FACTORS, repeats=1, seed=3, salted=False, digest="d")
    changes = [one for factor, values in zip(FACTORS, point, strict=True) for one in factor.changes(values)]
    text = json.dumps(changes, separators=(",", ":"))
    seed = int.from_bytes(hashlib.sha256(f"3|0||{text}".encode()).digest()[:4], "big")
    (found,) = cases_of(cast(Job, job), 0, [point])
    assert (found.seed, found.name) == (seed, hashlib.sha256(f"d\n{seed}\n{text}".encode()).hexdigest())
