"""What every shipped scenario and the fifty examples send under the virtual clock, as SHA-256 of bytes and instants.

    python -m tests.benchmarks.digests [--jobs N]

Once with arrays and once with compiled loops. Two states of the code send the same bytes when what they print is the
same: `diff` tells. It runs the command alone, so that the same file serves code whose modules lie elsewhere.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def printed(arguments: list[str], compiled: str) -> list[str]:
    """Lines of the command."""
    environment = dict(os.environ) | {"LIDAREMU_COMPILED": compiled}
    command = [sys.executable, "-m", "emulator", *arguments]
    reported = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    return reported.stdout.splitlines()


def digests(jobs: int, compiled: str) -> list[str]:
    """A line for each scenario, and one for all."""
    names = [line.split()[0] for line in printed(["list", "scenarios"], compiled)]
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["test", *names, "--examples", folder, "--jobs", str(jobs), "--json"]
        rows = [json.loads(line) for line in printed(arguments, compiled)]
    form = "compiled" if compiled == "1" else "arrays"
    lines = [
        f"{form} {Path(row['scenario']).stem} {row['verdict']} {row.get('sha256', row.get('faults'))}" for row in rows
    ]
    total = hashlib.sha256("\n".join(lines).encode()).hexdigest()
    return [*lines, f"{form} all {len(rows)} {total}"]


def main() -> None:
    """Print them."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.digests", description=__doc__)
    parser.add_argument("--jobs", type=int, default=1)
    jobs = parser.parse_args().jobs
    for compiled in ("0", "1"):
        for line in digests(jobs, compiled):
            print(line, flush=True)


if __name__ == "__main__":
    main()
