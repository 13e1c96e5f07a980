"""The folder of a recording: files that nobody had before, and whether they are still there.

Belongs here: making, writing, looking after and closing files. Not: what stands in them, nor when it is written.

Every file is made again (O_EXCL) in the folder as it was opened, never through a symbolic link: nothing that was there
is written over, and of two runs into one folder one is refused.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from pathlib import Path

from emulator.errors import EmulatorError

FLAGS = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
NFS_REMOVED = ".nfs"
"What NFS calls a file that was removed while somebody has it open."


class RecordingError(EmulatorError):
    """A recording that cannot be written or read."""


class RecordingLost(OSError):
    """Somebody has removed or cut files that are being written."""


def reason(error: BaseException) -> str:
    """What went wrong with a file, for people."""
    if isinstance(error, OSError):
        return error.strerror or str(error) or type(error).__name__
    return f"{type(error).__name__}: {error}".removesuffix(": ")


class RecordingFile:
    """One file, written to its last byte or with `OSError`."""

    def __init__(self, name: str, number: int) -> None:
        self.name = name
        self.number = number
        self._place = name
        "In its folder, or a whole path elsewhere."
        self.written = 0
        "Bytes that the system has taken."
        self.whole = 0
        "Bytes up to the end of the last piece that was written whole."

    def write(self, data: bytes) -> None:
        """Hand all of it to the system."""
        view = memoryview(data)
        while view:
            taken = os.write(self.number, view)
            self.written += taken
            view = view[taken:]
        self.whole = self.written

    def look(self) -> None:
        """`RecordingLost` when the file was removed or cut: the system would go on taking bytes that nobody finds."""
        found, path = os.fstat(self.number), _path_of(self.number)
        if not found.st_nlink or os.path.basename(path).startswith(NFS_REMOVED):
            raise RecordingLost(0, f"{self.name} was removed")
        if found.st_size < self.written:
            raise RecordingLost(0, f"{self.name} was cut: {found.st_size} of {self.written} bytes are there")

    def moved(self, folder: str) -> str:
        """Where the file is now, once it is no longer where it was reported to be last; `folder` is where its
        folder is."""
        path = _path_of(self.number)
        if not path or not folder or path == os.path.join(folder, self._place):
            return ""
        self._place = path.removeprefix(folder + os.sep)
        return path

    def measure(self) -> None:
        """Somebody else has written into it by its number: take its size from the system."""
        self.written = self.whole = os.fstat(self.number).st_size

    def close(self, sync: bool) -> None:
        """Close it; `OSError` when the system could not keep what it had taken. `sync`: wait until the disk has it."""
        number, self.number = self.number, -1
        try:
            if sync:
                os.fsync(number)
        finally:
            os.close(number)

    def abandon(self) -> None:
        """Close it after trouble, without the piece that was broken off."""
        number, self.number = self.number, -1
        with contextlib.suppress(OSError):
            if self.whole < self.written and os.fstat(number).st_size == self.written:
                os.ftruncate(number, self.whole)
        with contextlib.suppress(OSError):
            os.close(number)


class RecordingFolder:
    """A folder in which a recording begins."""

    def __init__(self, path: Path, first: str, planned: Iterable[str]) -> None:
        """Makes the folder, and in it the file `first`. `RecordingError` where one of `planned` is there already."""
        self.path = path
        self.files: list[RecordingFile] = []
        try:
            path.mkdir(parents=True, exist_ok=True)
            self._number = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as error:
            raise RecordingError(f"{path}: cannot record there: {reason(error)}") from None
        self._place = _path_of(self._number)
        try:
            there = {name.casefold(): name for name in os.listdir(self._number)}
            found = next((there[name.casefold()] for name in (first, *planned) if name.casefold() in there), None)
            if found is not None:
                raise RecordingError(_taken(path, found))
            self.first = self.create(first)
        except FileExistsError:
            os.close(self._number)
            raise RecordingError(_taken(path, first)) from None
        except RecordingError:
            os.close(self._number)
            raise
        except OSError as error:
            os.close(self._number)
            raise RecordingError(f"{path}: cannot record there: {reason(error)}") from None

    def create(self, name: str, append: bool = True) -> RecordingFile:
        """A new file; `FileExistsError` where anything of that name is, a symbolic link too.

        `append`: written from its beginning to its end; if somebody cuts it, its size will tell.
        """
        try:
            number = os.open(name, FLAGS | (os.O_APPEND if append else 0), 0o666, dir_fd=self._number)
        except FileNotFoundError:
            raise RecordingLost(0, "the folder was removed") from None
        except OSError as error:
            raise OSError(error.errno, f"{name}: {error.strerror}") from None
        self.files.append(RecordingFile(name, number))
        return self.files[-1]

    @property
    def written(self) -> int:
        """Bytes in all files."""
        return sum(file.written for file in self.files)

    def look(self) -> list[tuple[str, str]]:
        """What was moved, and where to, since it was looked at last; `OSError` when files are lost.

        All files are still being written, where they are now.
        """
        for file in self.files:
            file.look()
        found, place = [], _path_of(self._number)
        if place != self._place:
            self._place, self.path = place, Path(place)
            found.append(("the folder", place))
        found += [(file.name, path) for file in self.files if (path := file.moved(place))]
        return found

    def close(self, sync: bool) -> None:
        """Close every file; the first `OSError` of them."""
        trouble: OSError | None = None
        for file in self.files:
            try:
                file.close(sync)
            except OSError as error:
                trouble = trouble or OSError(error.errno, f"{file.name}: {reason(error)}")
        os.close(self._number)
        if trouble is not None:
            raise trouble

    def abandon(self) -> None:
        """Close every file after trouble."""
        for file in self.files:
            file.abandon()
        os.close(self._number)

    def undo(self) -> None:
        """Take away what was made here: the recording does not begin."""
        for file in self.files:
            with contextlib.suppress(OSError):
                os.unlink(file.name, dir_fd=self._number)
        self.abandon()


def _path_of(number: int) -> str:
    """Where an open file or folder is now, as the kernel has it."""
    with contextlib.suppress(OSError):
        return os.readlink(f"/proc/self/fd/{number}")
    return ""


def _taken(path: Path, name: str) -> str:
    return f"{path}: holds a recording already: {name}; want another folder, or an empty one"
