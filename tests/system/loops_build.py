"""The compiled loops: built once for all processes of the tests, by whoever comes first; the others wait for it.

Belongs here: that; `python -m tests.system.loops_build` does it beside the first tests.
"""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from emulator.compiled import build, switch

BODY = "from emulator.compiled import switch; switch.kernels()"


def built() -> None:
    """Or there is nothing to build."""
    folder = Path(sys.prefix if os.access(sys.prefix, os.W_OK) else tempfile.gettempdir())
    with (folder / f"lidaremu-loops-{os.getuid()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if build.wanted():
            subprocess.run([sys.executable, "-c", BODY], env=os.environ | {switch.SWITCH: "1"}, check=True)


if __name__ == "__main__":
    built()
