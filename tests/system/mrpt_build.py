"""MRPT's drivers as judges: built once for all files and processes of the tests, and kept in the environment of Python.

Belongs here: the build; `python -m tests.system.mrpt_build` does it before the tests, which have to end in their time.
cmake makes anew what has changed: sources of ours, or MRPT's headers.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent / "mrpt"


def built(otherwise: Path) -> Path:
    """Folder of the programs; within `otherwise` where the environment cannot be written to."""
    if shutil.which("cmake") is None:
        missing("cmake is not installed")
    name = f"lidaremu-mrpt-{hashlib.sha256(str(SOURCE).encode()).hexdigest()[:12]}"
    folder = (Path(sys.prefix) if os.access(sys.prefix, os.W_OK) else otherwise) / name
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        words = ["cmake", "-S", str(SOURCE), "-B", str(folder)]
        if subprocess.run(words, capture_output=True, text=True, check=False).returncode:
            missing("libmrpt-hwdrivers-dev is not installed (apt-get install libmrpt-hwdrivers-dev cmake g++)")
        subprocess.run(["cmake", "--build", str(folder), "--parallel", "2"], capture_output=True, check=True)
    return folder


def missing(reason: str) -> None:
    """In CI the absence of the judge is a failure."""
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)


if __name__ == "__main__":
    with contextlib.suppress(pytest.skip.Exception):
        built(Path(tempfile.gettempdir()))
