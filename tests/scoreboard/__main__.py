"""`python -m tests.scoreboard PART...`: runs tests and studies, keeps their results, and writes docs/scoreboard.md.

Parts: faults, coverage, fuzz, soak, mutants; without any: the first four, shortly. What is not run keeps its result.
`keep soak.json fuzz.json ...` takes over what `lidaremu study ... --out` has written.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.scoreboard.page import PAGE, RESULTS, ROOT, page

TIMEOUT_S = 86_400.0


def faults(_: argparse.Namespace) -> dict[str, Any]:
    """Runs the tests of faults in a process that keeps count of what began, hit and ended in those that passed."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "faults.json"
        run(["-m", "pytest", "-q", "-p", "tests.scoreboard.ledger", "--fault-ledger", str(out), "tests/faults"])
        found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return found


def coverage(_: argparse.Namespace) -> dict[str, Any]:
    """Lines and branches of the conversations and the physics that tests reach."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "coverage.json"
        folders = ["tests/protocols", "tests/physics", "tests/faults", "tests/sensing", "tests/sensing/error_budget"]
        what = ["--cov=protocols", "--cov=emulator/physics", "--cov-branch", f"--cov-report=json:{out}"]
        run(["-m", "pytest", "-q", *folders, *what])
        files = json.loads(out.read_text(encoding="utf-8"))["files"]
    rows = {}
    for place in ("protocols", "emulator/physics"):
        kept = [one["summary"] for name, one in files.items() if name.startswith(place)]
        total = {key: sum(one[key] for one in kept) for key in KEYS}
        rows[place] = {
            "lines": total["num_statements"],
            "lines_percent": round(100.0 * total["covered_lines"] / total["num_statements"], 2),
            "branches": total["num_branches"],
            "branches_percent": round(100.0 * total["covered_branches"] / total["num_branches"], 2),
        }
    return rows


KEYS = ("num_statements", "covered_lines", "num_branches", "covered_branches")


def fuzz(asked: argparse.Namespace) -> dict[str, Any]:
    """The fuzzing study, so many seconds of CPU."""
    return study("fuzz", "--seconds", str(asked.fuzz_seconds))


def soak(asked: argparse.Namespace) -> dict[str, Any]:
    """The soaks of the study: virtual and real."""
    found = {"virtual": study("soak", "--hours", str(asked.soak_hours))}
    if asked.soak_real_s:
        found["real"] = study("soak", "--real", str(asked.soak_real_s))
    return found


def mutants(_: argparse.Namespace) -> dict[str, Any]:
    """Mutation testing of the codecs, in a copy that the tool makes."""
    subprocess.run(["bash", ".ci/mutants"], cwd=ROOT, check=True, timeout=TIMEOUT_S)
    found = json.loads((ROOT / "mutants" / "mutmut-cicd-stats.json").read_text(encoding="utf-8"))
    return {key: found[key] for key in ("killed", "survived", "no_tests", "timeout", "suspicious", "total")}


def study(name: str, *options: str) -> dict[str, Any]:
    """What a study wrote; one that did not hold is a result as well."""
    with tempfile.TemporaryDirectory() as folder:
        run(["-m", "emulator", "study", name, *options, "--out", folder], check=False)
        found: dict[str, Any] = json.loads((Path(folder) / f"{name}.json").read_text(encoding="utf-8"))
    return found


def run(arguments: list[str], check: bool = True) -> None:
    """Python with these arguments, from the project's folder."""
    subprocess.run([sys.executable, *arguments], cwd=ROOT, check=check, timeout=TIMEOUT_S)


PARTS = {"faults": faults, "coverage": coverage, "fuzz": fuzz, "soak": soak, "mutants": mutants}


def main() -> None:
    if sys.argv[1:2] == ["keep"]:
        for name in sys.argv[2:]:
            keep(json.loads(Path(name).read_text(encoding="utf-8")))
        return
    parser = argparse.ArgumentParser(prog="python -m tests.scoreboard", description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], metavar="PART")
    parser.add_argument("--fuzz-seconds", type=float, default=60.0)
    parser.add_argument("--soak-hours", type=float, default=0.05)
    parser.add_argument("--soak-real-s", type=float, default=0.0)
    asked = parser.parse_args()
    for name in asked.parts or ["faults", "coverage", "fuzz", "soak"]:
        write(name, PARTS[name](asked))


def keep(reported: dict[str, Any]) -> None:
    """Take over what a study wrote, but not where its links lay; the other kind of soak is kept."""
    for sensor in reported.get("sensors", {}).values():
        sensor.pop("links", None)
    write(reported["study"], {reported["kind"]: reported} if reported["study"] == "soak" else reported)


def write(name: str, found: dict[str, Any]) -> None:
    """One part into the results and the page; what another run has written meanwhile stays."""
    results = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    results[name] = results.get(name, {}) | found if name == "soak" else found
    text = json.dumps(results, indent=1, sort_keys=True) + "\n"
    RESULTS.write_text(text, encoding="utf-8")
    PAGE.write_text(page(json.loads(text)), encoding="utf-8")  # in the order that is kept


if __name__ == "__main__":
    main()
