"""A job script for Slurm: one array task a shard, each an ordinary `lidaremu campaign --shard`.

Belongs here: the script. Not: handing it in: `sbatch` is the user's.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path


def script(file: Path, out: Path, tasks: int, cores: int, words: Sequence[str]) -> str:
    """The text of `campaign.sbatch`; `words`: further words of the command that every task gets."""
    command = [
        sys.executable, "-m", "emulator", "campaign", str(file.absolute()), "--out", str(out.absolute()),
        "--jobs", str(cores), "--no-report", *words,
    ]  # fmt: skip
    return f"""#!/bin/bash
# Written by lidaremu campaign --slurm {tasks}; hand it in with: sbatch campaign.sbatch
# A task that is cut short, or handed in again, does what is left. Afterwards: lidaremu campaign FILE --out DIR --report
#SBATCH --job-name={_plain(file.stem)}
#SBATCH --array=1-{tasks}
#SBATCH --cpus-per-task={cores}
#SBATCH --output=slurm-%A_%a.log
#SBATCH --requeue
set -eu
exec {shlex.join(command)} --shard "$SLURM_ARRAY_TASK_ID/{tasks}"
"""


def _plain(name: str) -> str:
    return "".join(letter if letter.isascii() and (letter.isalnum() or letter in "-_") else "_" for letter in name)
