"""The preload shim for drivers that reach 500 kBd by TIOCSSERIAL: built when asked for, put into an environment.

What it does, and its limits, stand at the head of `preload_shim.c`. Statically linked drivers are out of its reach; a
pty with `?speed=custom_divisor` helps those that ignore the refused call.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from emulator.errors import EmulatorError
from emulator.process.private_folder import private_folder

SOURCES = tuple(Path(__file__).with_name(name) for name in ("preload_shim.c", "preload_can.c"))
HEADER = Path(__file__).with_name("preload_shim.h")
COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-shared", "-fPIC", "-O2", "-Wall", "-Wextra")
LIBRARIES = ("-ldl", "-lpthread")
BUILD_LIMIT_S = 120.0
SAID = "LIDAREMU__SHIM"
"Set by the first program under the shim; the source has it too."


def find_compiler(environment: Mapping[str, str]) -> str | None:
    """The C compiler: what CC names, else the first of `COMPILERS` on the path; None without one."""
    path = environment.get("PATH")
    names = (environment["CC"],) if environment.get("CC") else COMPILERS
    return next((found for name in names if (found := shutil.which(name, path=path))), None)


def cache_folder(environment: Mapping[str, str]) -> Path:
    """Where built shims are kept: `lidaremu` in the user's cache."""
    base = environment.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "lidaremu"


def build_shim(environment: Mapping[str, str] | None = None) -> Path:
    """The shim as a shared library, compiled unless this source was already by this compiler; raises EmulatorError."""
    environment = os.environ if environment is None else environment
    if platform.system() != "Linux":
        raise EmulatorError(f"the shim works on Linux only, this is {platform.system()}")
    compiler = find_compiler(environment)
    if compiler is None:
        looked = environment.get("CC") or ", ".join(COMPILERS)
        raise EmulatorError(f"the shim needs a C compiler, none found (looked for {looked}): install gcc or set CC")
    texts = [source.read_bytes() for source in (*SOURCES, HEADER)]
    key = hashlib.sha256(b"\0".join([*texts, compiler.encode(), platform.machine().encode()])).hexdigest()
    library = cache_folder(environment) / f"preload_shim-{key[:16]}.so"
    if any(letter in str(library) for letter in " :\t\n"):
        raise EmulatorError(f"{library.parent}: LD_PRELOAD takes no path with spaces or colons; set XDG_CACHE_HOME")
    try:
        private_folder(library.parent, "set XDG_CACHE_HOME")
        if not library.exists():
            _compile(compiler, library)
    except OSError as error:
        raise EmulatorError(f"cannot write {library}: {error.strerror}; set XDG_CACHE_HOME") from None
    return library


def _compile(compiler: str, library: Path) -> None:
    """Compile beside the place and move there, so that two builds at once do not meet."""
    number, name = tempfile.mkstemp(suffix=".so", dir=library.parent)
    os.close(number)
    command = [compiler, *FLAGS, "-o", name, *map(str, SOURCES), *LIBRARIES]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=BUILD_LIMIT_S, check=False)
        if done.returncode != 0:
            first = next(iter(done.stderr.strip().splitlines()), f"exit code {done.returncode}")
            raise EmulatorError(f"the shim does not compile with {compiler}: {first}")
        os.replace(name, library)
    except subprocess.TimeoutExpired:
        raise EmulatorError(f"the shim does not compile: {compiler} took more than {BUILD_LIMIT_S:.0f} s") from None
    finally:
        Path(name).unlink(missing_ok=True)


def shim_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """`environment` with the shim preloaded in front of what is preloaded already; raises EmulatorError."""
    present = environment.get("LD_PRELOAD", "")
    library = str(build_shim(environment))
    rest = {name: value for name, value in environment.items() if name != SAID}
    return {**rest, "LD_PRELOAD": f"{library}:{present}" if present else library}
