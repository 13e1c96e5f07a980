"""What a case is called: SHA-256 of the scenario as run, its seed and the version of this program.

Belongs here: digests, the version, seeds of cases. Not: which cases there are (designs), where they lie (store).
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import emulator
from emulator.campaigns.factors import Factor, Point, Values, shown
from emulator.config import overrides as keys_of
from emulator.config.yaml_lines import Source
from emulator.scenario import scenario as scenarios
from emulator.scenario.scenario import Scenario

APART = ("commands", "endurance", "looking", "run_report", "studies", "view")
"Rooms of emulator/ that no result depends on."
SUFFIXES = (".py", ".yaml", ".dbc", ".glb", ".gltf", ".bin", ".obj", ".stl", ".ply")

OF_DRIVER = "driver."
"Quantities of a driver's own: `driver.NAME`."

canonical = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode


@cache
def version() -> str:
    """Of this program: its number, a digest of the sources that results depend on, whether loops are compiled."""
    root = Path(emulator.__file__).resolve().parent.parent
    digest = hashlib.sha256()
    for folder in ("emulator", "protocols", "scenarios"):
        for path in sorted((root / folder).rglob("*")):
            place = path.relative_to(root)
            if path.suffix in SUFFIXES and not (place.parts[0] == "emulator" and place.parts[1] in APART):
                digest.update(f"{place.as_posix()}\0".encode() + path.read_bytes())
    compiled = "+fast" if importlib.util.find_spec("numba") else ""
    return f"{emulator.__version__}+{digest.hexdigest()[:12]}{compiled}"


@dataclass(frozen=True)
class Job:
    """What all cases of a campaign have in common; goes to every process that runs some."""

    source: Source
    "Of the scenario, with what the campaign sets in every case."
    factors: tuple[Factor, ...]
    seed: int
    repeats: int
    salted: bool
    quantities: tuple[tuple[str, str], ...]
    driver: tuple[str, ...]
    record: str
    seconds: float
    out: Path
    version: str
    digest: str = ""
    "Of all that a case's bytes depend on but its own values and seed."

    def changed(self, point: Point, seed: int) -> Scenario:
        """The scenario of a case, judged; raises `ScenarioError`."""
        values: list[tuple[str, Any, str]] = [("seed", seed, f"seed {seed}")]
        for factor, found in zip(self.factors, point, strict=True):
            values += [(key, value, f"{factor.label}: {reported(value)}") for key, value in factor.changes(found)]
        return scenarios.from_source(keys_of.placed(self.source, values))


def reported(value: Any) -> str:
    """A value in a message."""
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."


class Case(NamedTuple):
    """One run."""

    name: str
    seed: int
    point: Point
    number: int
    "Of its point."
    repeat: int

    def columns(self, job: Job) -> dict[str, Any]:
        """Its factors' values, as the results have them."""
        return shown(job.factors, self.point)


def digest_of(job: Job) -> str:
    """The part of a name that all cases share."""
    texts = [*_texts(job.source.data), *_texts([list(values) for one in job.factors for values in one.levels])]
    files: dict[str, str] = {}
    for text in sorted(set(texts)):
        if 0 < len(text) < 1024 and "\0" not in text and not text.startswith("builtin:"):
            place = text.partition(":")[2] or text
            for found in (job.source.path.parent / text, job.source.path.parent / place):
                if found.is_file():
                    files[text] = hashlib.sha256(found.read_bytes()).hexdigest()
    whole = {
        "version": job.version,
        "scenario": job.source.data,
        "files": files,
        "quantities": dict(job.quantities),
        "driver": list(job.driver),
    }
    return hashlib.sha256(canonical(whole).encode()).hexdigest()


def _texts(data: Any) -> Iterator[str]:
    waiting = [data]
    while waiting:
        one = waiting.pop()
        if isinstance(one, str):
            yield one
        elif isinstance(one, Mapping):
            waiting += one.values()
        elif isinstance(one, list | tuple):
            waiting += one


def _text_of(factor: Factor) -> Callable[[Values], str]:
    """A factor's changes as `canonical` writes them, in a third of its time: a plan may have a million points."""
    keys = [[f"[{canonical(key)}," for key in several] for several in factor.keys]
    if factor.continuous and len(keys) == 1 and len(keys[0]) == 1:
        head = keys[0][0]
        return lambda values: f"{head}{values[0]!r}]"

    def text(values: Values) -> str:
        return ",".join(
            f"{head}{written}]" for heads, written in zip(keys, map(canonical, values), strict=True) for head in heads
        )

    return cache(text) if factor.levels and all(map(_hashable, factor.levels)) else text


def _hashable(values: Values) -> bool:
    return all(type(one) in (str, float) for one in values)


def cases_of(job: Job, first: int, points: Sequence[Point]) -> Iterator[Case]:
    """The cases of points that follow each other in a design, the first having that number."""
    texts = [_text_of(factor) for factor in job.factors]
    for number, point in enumerate(points, first):
        changes = f"[{','.join([text(values) for text, values in zip(texts, point, strict=True)])}]"
        salt = number if job.salted else ""
        for repeat in range(job.repeats):
            seed_text = f"{job.seed}|{repeat}|{salt}|{changes}"
            seed = int.from_bytes(hashlib.sha256(seed_text.encode()).digest()[:4], "big")
            name = hashlib.sha256(f"{job.digest}\n{seed}\n{changes}".encode()).hexdigest()
            yield Case(name, seed, point, number, repeat)
