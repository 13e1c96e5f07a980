"""Whether loops are compiled already, and a process that compiles them beside a run. Nothing here imports numba.

Belongs here: the note that is left once all loops have been compiled for this machine. It is a hint: where it is wrong,
loops are compiled when they are imported, as ever.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata
from pathlib import Path

NICENESS = 10
"Of the compiling process: whoever sends and measures comes first."
BODY = "from emulator.compiled import build, switch; build.body(switch.kernels)"


def note_path() -> Path:
    """Where the note of this version of the loops lies, for this numba and this processor."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "lidaremu" / f"loops-{_key()}.json"


def _key() -> str:
    """Of all that compiled loops depend on."""
    parts = [sys.version, platform.machine(), _processor(), os.environ.get("NUMBA_CPU_NAME", "")]
    for library in ("numba", "llvmlite", "numpy"):
        with suppress(metadata.PackageNotFoundError):
            parts.append(f"{library} {metadata.version(library)}")
    for path in sorted(Path(__file__).parent.glob("*.py")):
        parts.append(f"{path} {path.stat().st_mtime_ns} {path.stat().st_size}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]


def _processor() -> str:
    """What the processor calls itself and can do, where the system tells."""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return "\n".join(dict.fromkeys(one for one in lines if one.startswith(("model name", "flags", "Features"))))
    return platform.processor()


def built() -> bool:
    """Whether all loops lie compiled on this machine's disk."""
    try:
        known = json.loads(note_path().read_text(encoding="utf-8"))
        return bool(known["files"]) and all(Path(one).exists() for one in known["files"])
    except (OSError, ValueError, LookupError, TypeError):
        return False


def wanted() -> bool:
    """Whether there is something to compile: numba is there, and its result is not."""
    return importlib.util.find_spec("numba") is not None and not built()


def note_built(folders: set[str]) -> None:
    """Leave the note: all loops lie in these folders."""
    found = sorted(str(index) for folder in folders for index in Path(folder).glob("*.nbi"))
    path = note_path()
    with suppress(OSError):  # no folder that may be written to: the loops are not kept either
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = path.with_suffix(f".{os.getpid()}")
        aside.write_text(json.dumps({"files": found}), encoding="utf-8")
        aside.replace(path)


class Builder:
    """A process that compiles all loops; its end is seen by `poll`."""

    def __init__(self) -> None:
        environment = {**os.environ, "LIDAREMU_COMPILED": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-c", BODY],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def poll(self) -> bool | None:
        """None while it works; then whether all loops are compiled."""
        code = self._process.poll()
        return None if code is None else code == 0 and built()

    def close(self) -> None:
        """End it; what it has compiled so far is kept."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()


def body(kernels: Callable[[], object]) -> None:
    """What the process does."""
    with suppress(OSError):
        os.nice(NICENESS)

    if kernels() is None:
        sys.exit(1)
