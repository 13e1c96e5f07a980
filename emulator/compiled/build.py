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
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata
from pathlib import Path

NICENESS = 10
"Of the compiling process: whoever sends and measures comes first."
SAID = 300
"Characters of its last words."
BODY = "from emulator.compiled import build, switch; build.body(switch.kernels)"


def note_path() -> Path:
    """Where the note of this version of the loops lies, for this numba and this processor."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "lidaremu" / f"loops-{_key()}.json"


def _key() -> str:
    """Of all that compiled loops depend on."""
    parts = [sys.version, platform.machine(), _processor()]
    parts += [os.environ.get(name, "") for name in ("NUMBA_CPU_NAME", "NUMBA_CACHE_DIR")]
    for library in ("numba", "llvmlite", "numpy"):
        with suppress(metadata.PackageNotFoundError):
            parts.append(f"{library} {metadata.version(library)}")
    for path in sorted(Path(__file__).parent.glob("*.py")):
        parts.append(f"{path} {path.stat().st_mtime_ns} {path.stat().st_size}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]


def _processor() -> str:
    """What the processor calls itself and can do, where the system says so."""
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
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)  # `private_folder` wants it so for libraries there
        aside = path.with_suffix(f".{os.getpid()}")
        aside.write_text(json.dumps({"files": found}), encoding="utf-8")
        aside.replace(path)


class Builder:
    """A process that compiles all loops; its end is seen by `poll`. It ends with us, however we end.

    `OSError` where the machine has no process to give.
    """

    def __init__(self) -> None:
        path = os.pathsep.join(os.path.abspath(one) for one in sys.path)
        environment = {**os.environ, "LIDAREMU_COMPILED": "1", "PYTHONPATH": path}
        self._said = tempfile.TemporaryFile()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", BODY],
            env=environment,
            stdin=subprocess.PIPE,  # its end is ours
            stdout=subprocess.DEVNULL,
            stderr=self._said,
        )

    def poll(self) -> bool | None:
        """None while it works; then whether it has come to its end in order."""
        code = self._process.poll()
        return None if code is None else code == 0

    def why(self) -> str:
        """How it has ended and the last that it said, in one line."""
        code = self._process.returncode
        how = "is still running" if code is None else f"signal {-code}" if code < 0 else f"exit code {code}"
        self._said.seek(0)
        last = self._said.read().decode(errors="replace").strip().rpartition("\n")[2]
        return f"{how}: {last[:SAID]}" if last and code is not None and code > 0 else how

    def close(self) -> None:
        """End it; what it has compiled so far is kept."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._said.close()


def body(kernels: Callable[[], object]) -> None:
    """What the process does; it ends when its standard input does."""
    with suppress(OSError):
        os.nice(NICENESS)
    threading.Thread(target=_end_with_input, daemon=True).start()
    if kernels() is None:
        sys.exit(1)


def _end_with_input() -> None:
    while os.read(0, 1024):
        pass
    os._exit(1)
