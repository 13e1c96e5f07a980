"""The place of a control socket in the file system: which one, who listens there, and whether it is still ours.

Belongs here: names and files. Not: who connects and what is answered (control).
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import stat
import tempfile
from pathlib import Path

from emulator.errors import LinkError
from emulator.process.private_folder import private_folder

MOST_WAITING = 256
"Who wants to connect and has not been looked at yet."


def folder_place() -> Path:
    """Where sockets lie when nobody says otherwise."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "lidaremu" if runtime else Path(tempfile.gettempdir()) / f"lidaremu-{os.getuid()}"


def default_folder() -> Path:
    """The same, made: of this user, and readable by nobody else; `LinkError` where that cannot be."""
    return private_folder(folder_place(), "set XDG_RUNTIME_DIR, or --control PATH", LinkError)


def new_path() -> Path:
    """Of this process's socket in the default folder; what killed processes of this user have left there goes."""
    folder = default_folder()
    for old in folder.glob("*.sock"):
        if old.stem.isdecimal() and not _runs(int(old.stem)):
            with contextlib.suppress(OSError):
                if not answers(old):  # of another container it may be alive all the same
                    old.unlink()
    return folder / f"{os.getpid()}.sock"


def running() -> list[Path]:
    """Sockets of this user's daemons that answer."""
    found = []
    for path in sorted(default_folder().glob("*.sock")):
        with contextlib.suppress(OSError):
            if answers(path):
                found.append(path)
    return found


def _runs(pid: int) -> bool:
    """Whether there is such a process; one that cannot be asked for counts as running."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def answers(path: Path) -> bool:
    """Whether somebody listens there."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            return False
        except BlockingIOError:  # as many wait as may
            return True
        return True


class Doorway:
    """A listening socket at a path, of its owner alone; only a dead socket in its place is ever replaced."""

    def __init__(self, path: Path) -> None:
        """`LinkError` when something else is there, or somebody listens."""
        self.path = path
        self.listener, self._file = self._listen()

    def _listen(self) -> tuple[socket.socket, os.stat_result]:
        """Made aside: who finds the path finds somebody who listens."""
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        aside = self.path.with_name(f".{os.urandom(3).hex()}")
        try:
            self._make_room()
            with contextlib.suppress(OSError):
                os.fchmod(listener.fileno(), 0o600)  # Linux makes the file with this mode
            listener.bind(str(aside))
            try:
                aside.chmod(0o600)
                found = os.lstat(aside)
                listener.listen(MOST_WAITING)
                listener.setblocking(False)
                os.link(aside, self.path, follow_symlinks=False)
            finally:
                aside.unlink(missing_ok=True)
        except OSError as error:
            listener.close()
            if isinstance(error, LinkError):
                raise
            reason = os.strerror(errno.EADDRINUSE) if isinstance(error, FileExistsError) else error.strerror or error
            raise LinkError(f"{self.path}: cannot listen for control: {reason}") from None
        return listener, found

    def _make_room(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISSOCK(os.lstat(self.path).st_mode):
                what = "a link" if self.path.is_symlink() else "a folder" if self.path.is_dir() else "a file"
                raise LinkError(f"{self.path}: {what} of that name exists; want a free path, or a stale socket")
            if not answers(self.path):
                self.path.unlink()

    def stands(self) -> bool:
        """Whether the path still leads to this listener."""
        try:
            return os.path.samestat(os.lstat(self.path), self._file)
        except OSError:
            return False

    def restore(self) -> socket.socket:
        """Listen there again; the listener from before, to be closed. `LinkError` as at first."""
        if self.path.parent == folder_place():
            default_folder()
        old = self.listener
        self.listener, self._file = self._listen()
        return old

    def close(self) -> None:
        """Listen no more; remove the file, if it is still ours."""
        if self.stands():
            with contextlib.suppress(OSError):
                self.path.unlink()
        self.listener.close()
