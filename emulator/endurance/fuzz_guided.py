"""Fuzzing led by coverage, with atheris (libFuzzer for Python); the extra `fuzz`, Linux on x86-64.

    python -m emulator.endurance.fuzz_guided PARSER SECONDS SEED FOLDER

It runs as a process of its own: libFuzzer does not come back. It ends at the first fault.
"""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from emulator.errors import EmulatorError

if TYPE_CHECKING:
    from emulator.endurance.fuzz import Outcome, Parser

EXECUTED = re.compile(r"stat::number_of_executed_units:\s+(\d+)")
PEAK = re.compile(r"stat::peak_rss_mb:\s+(\d+)")
MOST_MB, SLOW_S = 3072, 10
WAIT_S = 60.0
"Beyond the time to fuzz: start, and the instrumentation of what is imported."


def guided(parser: Parser, seconds: float, seed: int) -> Outcome:
    """What libFuzzer finds in so many seconds. Raises `EmulatorError` where atheris is not installed."""
    from emulator.endurance.fuzz import Fault, Outcome

    if importlib.util.find_spec("atheris") is None:
        raise EmulatorError("atheris is not installed; want pip install 'lidaremu[fuzz]'")
    with tempfile.TemporaryDirectory(prefix="lidaremu-fuzz-") as name:
        folder = Path(name)
        (folder / "corpus").mkdir()
        for number, data in enumerate(parser.seeds()):
            (folder / "corpus" / str(number)).write_bytes(data)
        words = "".join(f'"{_escaped(word)}"\n' for word in parser.words)
        (folder / "words").write_text(words, encoding="ascii")
        command = [sys.executable, "-m", __name__, parser.name, str(max(1, round(seconds))), str(seed), name]
        done = subprocess.run(command, capture_output=True, timeout=seconds + WAIT_S, check=False)
        text = done.stderr.decode("utf-8", "replace")
        outcome = Outcome(parser.name, seconds=seconds)
        outcome.cases = sum(map(int, EXECUTED.findall(text)))
        outcome.peak_mb = max(map(float, PEAK.findall(text)), default=0.0)
        for path in sorted((folder / "faults").glob("*")):
            kind = path.name.partition("-")[0]
            outcome.faults.append(Fault(parser.name, path.read_bytes(), kind, text[-4000:]))
        if done.returncode and not outcome.faults:
            raise EmulatorError(f"atheris did not run: {text.strip()[-300:]}")
        return outcome


def _escaped(word: bytes) -> str:
    return "".join(f"\\x{byte:02x}" for byte in word)


def main(argv: Sequence[str]) -> None:
    """Fuzz one parser until the time is over, or a fault is found."""
    import atheris

    name, seconds, seed, folder = argv
    with atheris.instrument_imports(include=["emulator", "protocols"]):
        from emulator.endurance.fuzz import PARSERS
    parser = next(one for one in PARSERS if one.name == name)
    with atheris.instrument_imports(include=["emulator", "protocols"]):
        run = parser.make()
    place = Path(folder)
    (place / "faults").mkdir()
    options = [f"-max_total_time={seconds}", f"-seed={seed}", f"-artifact_prefix={place}/faults/", f"-timeout={SLOW_S}"]
    options += [f"-rss_limit_mb={MOST_MB}", "-max_len=65536", "-print_final_stats=1", f"-dict={place}/words"]
    if not parser.words:
        options.pop()
    atheris.Setup(["fuzz", *options, f"{place}/corpus"], run)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1:])
