"""The directory of a campaign: one file a case, written aside and renamed when the case is done.

Belongs here: names that are done, rows of the done, the version that a directory was begun with. Not: what a row
says (case), tables for others (table).

    campaign.json            version and file of the campaign
    cases/ab/ab12....json    one row a case; its name is the case's
    recordings/ab/ab12.../   what was recorded of it
    index/WRITER.jsonl       the same rows once more, one file per process that wrote some: read in one pass
    aside/                   what is being written
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from emulator.errors import EmulatorError

Row = dict[str, Any]
HEAD = '{"name": "'
KEYS = frozenset(
    ("name", "verdict", "seed", "number", "repeat", "factors", "expect", "quantities", "seconds", "sha256", "fault",
     "recording_bytes")
)  # fmt: skip
"That a row has: without one of them it is none."
SUFFIX = ".json"
BROKEN = ("error", "crashed", "hung")
"Verdicts of cases that did not come to their end."


class Store:
    """One directory, shared with any number of other writers."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._made: set[str] = set()
        self._writer = f"{socket.gethostname()[:64]}-{os.getpid()}-{os.urandom(4).hex()}"

    def make(self) -> None:
        """Its folders; `EmulatorError` when they cannot be."""
        try:
            for name in ("cases", "aside", "index"):
                (self.root / name).mkdir(parents=True, exist_ok=True)
            probe = self.root / "aside" / f"{self._writer}.probe"
            probe.write_bytes(b"x")
            probe.unlink()
        except OSError as error:
            raise EmulatorError(f"--out: {self.root}: {error.strerror}; want a folder that can be written") from None

    def begin(self, version: str, file: str, digest: str) -> bool:
        """Note who begins here; whether the campaign is another than last time. Another version is refused."""
        known = self.manifest()
        if known is not None and known.get("version") != version:
            raise EmulatorError(
                f"{self.root}: begun with version {known.get('version')}, this is {version}, which may"
                " give other results; want that version, another --out, or --rerun to run all cases again"
            )
        if known is None or known.get("digest") != digest:
            self.put(self.root / "campaign.json", json.dumps({"version": version, "file": file, "digest": digest}))
        return known is not None and known.get("digest") != digest

    def forget_version(self) -> None:
        """Begin again; done cases stay, under names that no new case has."""
        with contextlib.suppress(FileNotFoundError):
            (self.root / "campaign.json").unlink()

    def manifest(self) -> Row | None:
        """Who began here; None: nobody."""
        try:
            found = json.loads((self.root / "campaign.json").read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise EmulatorError(f"{self.root / 'campaign.json'}: {error}; want the one that lidaremu wrote") from None
        return found if isinstance(found, dict) else {}

    def place(self, name: str) -> Path:
        """The file of a case."""
        return self.root / "cases" / name[:2] / f"{name}{SUFFIX}"

    def recording(self, name: str) -> Path:
        """The folder of its recording."""
        return self.root / "recordings" / name[:2] / name

    def aside(self, name: str) -> Path:
        """A folder or file that nobody else writes."""
        return self.root / "aside" / f"{name}-{self._writer}"

    def put(self, path: Path, text: str) -> None:
        """Write a file as a whole: aside, then renamed. Raises `OSError`."""
        aside = self.aside(path.name)
        try:
            with aside.open("x", encoding="utf-8") as file:
                file.write(text)
            os.replace(aside, path)
        except OSError:
            with contextlib.suppress(OSError):
                aside.unlink()
            raise

    def write(self, row: Row) -> None:
        """A case that is done; raises `OSError`, and then nothing of it is there."""
        name = row["name"]
        if name[:2] not in self._made:
            self.place(name).parent.mkdir(parents=True, exist_ok=True)
            self._made.add(name[:2])
        text = json.dumps(row)
        assert text.startswith(HEAD)
        self.put(self.place(name), text + "\n")
        with contextlib.suppress(OSError):  # a hint for readers; the case itself is there
            with (self.root / "index" / f"{self._writer}.jsonl").open("ab", buffering=0) as index:
                index.write(text.encode() + b"\n")

    def keep_recording(self, aside: Path, name: str) -> int:
        """Move a finished recording to its place; its bytes."""
        size = size_of(aside)
        place = self.recording(name)
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.rename(aside, place)
        except OSError:  # another writer was first
            shutil.rmtree(aside, ignore_errors=True)
        return size

    def names(self) -> set[str]:
        """Names of all cases that are done; a pass over folders, no file is opened."""
        found: set[str] = set()
        try:
            folders = os.listdir(self.root / "cases")
        except FileNotFoundError:
            return found
        for folder in folders:
            with contextlib.suppress(NotADirectoryError, FileNotFoundError):
                found.update(
                    one[:64]
                    for one in os.listdir(self.root / "cases" / folder)
                    if len(one) == 69 and one[64:] == SUFFIX
                )
        return found

    def indexed(self) -> Iterator[bytes]:
        """Whole lines of every writer's index, as they are; of the same case there may be several."""
        try:
            files = sorted(os.listdir(self.root / "index"))
        except FileNotFoundError:
            return
        for file in files:
            if file.endswith(".jsonl"):
                with (self.root / "index" / file).open("rb") as lines:
                    for line in lines:
                        if line.endswith(b"}\n") and line.startswith(HEAD.encode()):
                            yield line

    def rows(self, wanted: set[str]) -> Iterator[Row]:
        """The rows of those cases that are done, each once, in no order; files that are damaged are passed over."""
        left = self.names() & wanted  # of equal sets the texts are those of the second: the first's are let go
        at = len(HEAD)
        for line in self.indexed():
            name = line[at : at + 64].decode("ascii", "replace")
            if name in left:
                with contextlib.suppress(ValueError):
                    row = json.loads(line)
                    if row.keys() >= KEYS:
                        left.discard(name)
                        yield row
        for name in sorted(left):
            row = self.row(name)
            if row is not None:
                yield row

    def row(self, name: str) -> Row | None:
        """One case; None when it is not done, or its file is damaged."""
        try:
            found = json.loads(self.place(name).read_bytes())
        except (OSError, ValueError):
            return None
        return found if isinstance(found, dict) and found.get("name") == name and found.keys() >= KEYS else None

    def done(self, again: bool = False) -> set[str]:
        """Names that need not be run; `again`: without those that did not come to their end.

        A file that nobody's index has is read: after a power cut it may be empty.
        """
        found = self.names()
        left = set(found)
        at = len(HEAD)
        marks = tuple(f'"verdict": "{one}"'.encode() for one in BROKEN)
        last: dict[str, bool] = {}
        for line in self.indexed():
            name = line[at : at + 64].decode("ascii", "replace")
            if name in found:
                left.discard(name)
                if again:
                    broken = any(mark in line for mark in marks)
                    if broken or name in last:
                        last[name] = broken
        for name in left:
            row = self.row(name)
            if row is None:
                found.discard(name)
            else:
                last[name] = row["verdict"] in BROKEN
        return found - {name for name, broken in last.items() if broken} if again else found

    def recorded_bytes(self) -> int:
        """Bytes of all recordings."""
        return size_of(self.root / "recordings")

    def tidy(self) -> None:
        """Take away what processes of this machine that have ended left aside."""
        host = socket.gethostname()[:64]
        for path in (self.root / "aside").glob(f"*-{host}-*"):
            number = path.name.rpartition(f"-{host}-")[2].partition("-")[0]
            if number.isdecimal() and not Path(f"/proc/{number}").exists():
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    with contextlib.suppress(OSError):
                        path.unlink()


def size_of(folder: Path) -> int:
    """Bytes of all files below it."""
    total = 0
    waiting = [str(folder)]
    while waiting:
        with contextlib.suppress(FileNotFoundError, NotADirectoryError), os.scandir(waiting.pop()) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
                else:
                    with contextlib.suppress(FileNotFoundError):
                        total += entry.stat(follow_symlinks=False).st_size
    return total
