"""`lidaremu test`: scenarios judged in virtual time, several at once, reported as lines, JSON or JUnit XML."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from emulator.commands.common import (
    CANNOT_RUN,
    FAILED,
    LONGEST_S,
    OK,
    Finite,
    bar,
    load_scenario,
    part_of,
    scenario_options,
)
from emulator.errors import EmulatorError
from emulator.output.lines import say
from emulator.output.sanitizing import visible

if TYPE_CHECKING:
    from emulator.judging.trial import Verdict

Progress = Callable[[float], None]
CODES = {"passed": OK, "failed": FAILED, "error": CANNOT_RUN}


@dataclass(frozen=True)
class Result:
    """One scenario's outcome."""

    scenario: str
    verdict: str
    "passed | failed | error"
    real_s: float
    found: Verdict | None = None
    fault: str = ""
    "Why it could not run."

    @property
    def recording_ended(self) -> bool:
        """Whether it was to be recorded to its end, and was not."""
        return self.found is not None and (self.found.recording or {}).get("state") == "ended"

    def as_json(self) -> dict[str, Any]:
        """One line of `--json`."""
        row: dict[str, Any] = {"scenario": self.scenario, "verdict": self.verdict, "real_s": round(self.real_s, 3)}
        if self.found is None:
            return row | {"faults": self.fault.split("\n")}
        return row | {
            "sha256": self.found.sha256,
            "duration_s": self.found.duration_s,
            "expect": [item.as_json() for item in self.found.judgements],
            "sensors": list(self.found.sensors),
            "warnings": list(self.found.warnings),
            "recording": self.found.recording,
            "incidents": list(self.found.incidents),
        }


@click.command()
@click.argument("scenarios", nargs=-1, metavar="SCENARIO...")
@scenario_options
@click.option(
    "--examples",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Write fifty small scenarios with known answers into DIR, and run them.",
)
@click.option(
    "--jobs", type=click.IntRange(min=1), help="Number of scenarios that run at the same time (default: cores)."
)
@click.option(
    "--workers",
    type=click.IntRange(min=0),
    default=0,
    help="Measuring processes per scenario (0: in the same process).",
)
@click.option(
    "--duration", type=Finite(0.0, LONGEST_S, min_open=True), metavar="S", help="Replace `duration_s` of the scenarios."
)
@click.option(
    "--record",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Record each scenario in a folder below DIR.",
)
@click.option(
    "--junitxml", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE", help="Write a JUnit XML report."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object per scenario.")
def test(
    scenarios: Sequence[str],
    overrides: Sequence[str],
    seed: int | None,
    links: Sequence[str],
    examples: Path | None,
    jobs: int | None,
    workers: int,
    duration: float | None,
    record: Path | None,
    junitxml: Path | None,
    as_json: bool,
) -> int:
    """Run scenarios in virtual time with built-in hosts, no hardware, and judge what they `expect`.

    A SCENARIO is a path, a built-in name, or a folder: every .yaml file in it.
    """
    if duration is not None:
        overrides = (*overrides, f"duration_s={duration}")
    names = list(_files(scenarios))
    if examples is not None:
        names += _examples(examples)
    if not names:
        raise click.UsageError("no scenario; want SCENARIO... or --examples DIR")
    one = partial(_outcome, overrides=overrides, seed=seed, links=links, workers=workers)
    folders = _folders(names, record)
    results = []
    with bar("test") as progress:
        for result in _all(names, folders, one, jobs or len(os.sched_getaffinity(0)), progress):
            results.append(result)
            progress(len(results) / len(names))
            if as_json:
                say(json.dumps(result.as_json()))
            else:
                _tell(result)
    if junitxml is not None:
        _write_junit(results, junitxml)
    if not as_json:
        counts = {verdict: sum(result.verdict == verdict for result in results) for verdict in CODES}
        counts["recording ended early"] = sum(result.recording_ended for result in results)
        say(", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count))
    code = max((CODES[result.verdict] for result in results), default=OK)
    return code or min((one.found.exit_code for one in results if one.found and one.found.exit_code), default=OK)


def _files(scenarios: Sequence[str]) -> Iterator[str]:
    for name in scenarios:
        folder = Path(name)
        if not folder.is_dir():
            yield name
            continue
        found = sorted(path for path in folder.rglob("*") if path.suffix in (".yaml", ".yml"))
        if not found:
            raise click.BadParameter(f"{name}: no .yaml file in this folder", param_hint="SCENARIO")
        yield from map(str, found)


def _folders(names: Sequence[str], record: Path | None) -> list[Path | None]:
    """Where each scenario is recorded: named after its file, numbered where files of two folders have one name."""
    from emulator.recording.names import distinct

    if record is None:
        return [None] * len(names)
    return [record / name for name in distinct([Path(name).stem for name in names])]


def _examples(folder: Path) -> list[str]:
    from emulator.judging.examples import write

    try:
        return list(map(str, write(folder)))
    except OSError as error:
        raise EmulatorError(f"{folder}: cannot write: {error.strerror}") from None


def _outcome(
    name: str,
    folder: Path | None,
    overrides: Sequence[str],
    seed: int | None,
    links: Sequence[str],
    workers: int,
    progress: Progress | None = None,
) -> Result:
    from emulator.judging.trial import run_trial
    from emulator.process.clock import SystemClock

    clock = SystemClock()
    try:
        found = run_trial(load_scenario(name, overrides, seed, links), workers, name, folder, progress)
    except EmulatorError as error:
        return Result(name, "error", clock.now_ns() * 1e-9, fault="\n".join(map(visible, error.lines)))
    return Result(name, "passed" if found.held else "failed", clock.now_ns() * 1e-9, found)


def _all(
    names: Sequence[str], folders: Sequence[Path | None], one: partial[Result], jobs: int, progress: Progress
) -> Iterator[Result]:
    """Every outcome, in the order of the names; `progress` is informed of what goes on within one."""
    if min(jobs, len(names)) <= 1:
        for number, (name, folder) in enumerate(zip(names, folders, strict=True)):
            yield one(name, folder, progress=part_of(progress, number, len(names)))
        return
    import multiprocessing

    import emulator.casting.raycast
    import emulator.judging.trial  # noqa: F401  # loaded once here, and there after the fork

    with ProcessPoolExecutor(min(jobs, len(names)), multiprocessing.get_context("fork")) as pool:
        waiting: list[Future[Result]] = [pool.submit(one, *both) for both in zip(names, folders, strict=True)]
        for name, future in zip(names, waiting, strict=True):
            try:
                yield future.result()
            except BrokenProcessPool:
                yield Result(name, "error", 0.0, fault=f"{name}: its process, or another of the pool, was terminated")


def _tell(result: Result) -> None:
    if result.found is None:
        say(f"{result.scenario}: cannot run")
        for line in result.fault.split("\n"):
            say(f"  {line}")
        return
    found = result.found
    counted = sum(item.held is found.held for item in found.judgements)
    say(
        f"{result.scenario}: {result.verdict}: {counted} of {len(found.judgements)} expectations,"
        f" {found.duration_s:g} s in {result.real_s:.2f} s, sha256 {found.sha256[:16]}"
    )
    for text in found.warnings:
        say(f"  warning: {text}")
    for row in found.incidents:
        say(f"  {row['on']}: {row['kind']}: {row['text']}")
    for sensor in found.sensors:
        if "objects" in sensor:
            all_ = sensor["objects"]["total"]
            figures = [f"{key} {all_[key]}" for key in ("precision", "recall", "position_m", "size_m", "speed_m_s")]
            say(f"  {sensor['id']}: {sensor['objects']['lists']} object lists: {', '.join(figures)}")
    for item in found.judgements:
        if not item.held:
            say(f"  {item.name}: {item.reported}")


def _write_junit(results: Sequence[Result], path: Path) -> None:
    """The report that CI servers read: a case an expectation, its class the scenario."""
    import xml.etree.ElementTree as Tree

    root = Tree.Element("testsuites", name="lidaremu")
    for result in results:
        judged = () if result.found is None else result.found.judgements
        suite = Tree.SubElement(
            root,
            "testsuite",
            name=_clean(result.scenario),
            tests=str(max(1, len(judged))),
            failures=str(sum(not item.held for item in judged)),
            errors=str(int(result.found is None)),
            skipped="0",
            time=f"{result.real_s:.3f}",
        )
        if result.found is not None:
            properties = Tree.SubElement(suite, "properties")
            Tree.SubElement(properties, "property", name="sha256", value=result.found.sha256)
            for text in result.found.warnings:
                Tree.SubElement(properties, "property", name="warning", value=_clean(text))
        share_s = result.real_s / max(1, len(judged))
        for name in [item.name for item in judged] or ["runs"]:
            case = Tree.SubElement(suite, "testcase", classname=_clean(result.scenario), name=_clean(name))
            case.set("time", f"{share_s:.3f}")
        cases = suite.findall("testcase")
        for case, item in zip(cases, judged, strict=False):
            if not item.held:
                Tree.SubElement(case, "failure", message=_clean(item.reported))
        if result.recording_ended and result.found is not None and result.found.recording is not None:
            suite.set("tests", str(len(cases) + 1))
            suite.set("errors", "1")
            reported = {"classname": _clean(result.scenario), "name": "is recorded to its end", "time": "0.000"}
            case = Tree.SubElement(suite, "testcase", reported)
            Tree.SubElement(case, "error", message=_clean(f"recording ended: {result.found.recording['why']}"))
        if result.found is not None and result.found.warnings:
            lines = [f"warning: {text}" for text in result.found.warnings]
            Tree.SubElement(suite, "system-err").text = _clean("\n".join(lines))
        if result.found is None:
            error = Tree.SubElement(cases[0], "error", message=_clean(result.fault.partition("\n")[0]))
            error.text = _clean(result.fault)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        Tree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise EmulatorError(f"{path}: cannot write: {error.strerror}") from None


def _clean(text: str) -> str:
    """Without characters that XML cannot hold."""
    return re.sub("[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "?", text)
