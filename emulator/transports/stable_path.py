"""A symbolic link under a name of the user's choice that belongs to one running process.

Beside `front` lies `.front.lidaremu`, locked (flock) while its owner lives; the kernel lets go of the lock however the
owner ends, so after `kill -9` the next start takes both over. Only what is plainly ours is replaced: a link into
/dev/pts that leads nowhere, or one whose owner left its lock file behind. A file, a folder, a link of somebody else is
never touched.
"""

from __future__ import annotations

import contextlib
import fcntl
import os

from emulator.errors import LinkError

TERMINALS = "/dev/pts/"


class StablePath:
    """`path` leads to `target` from now until `remove`."""

    def __init__(self, path: str, target: str) -> None:
        self.path = os.path.abspath(path)
        self._target = target
        self._owner = os.getpid()
        folder, name = os.path.split(self.path)
        self._lock_path = os.path.join(folder, f".{name}.lidaremu")
        left_behind = os.path.lexists(self._lock_path)
        self._lock_fd = self._lock()
        try:
            self._make(left_behind)
        except BaseException:
            self._unlock()
            raise

    def _lock(self) -> int:
        while True:
            fd = self._open_lock()
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                owner = os.read(fd, 20).decode("ascii", "replace").strip()
                os.close(fd)
                raise LinkError(f"{self.path}: in use by a running emulator (process {owner or 'unknown'})") from None
            except OSError as error:
                os.close(fd)
                raise LinkError(f"{self._lock_path}: cannot be locked: {error.strerror}") from None
            if self._is_lock_file(fd):
                os.ftruncate(fd, 0)
                os.write(fd, f"{self._owner}\n".encode())
                return fd
            os.close(fd)  # its owner removed it between our opening and our locking

    def _open_lock(self) -> int:
        try:
            return os.open(self._lock_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        except FileNotFoundError:
            folder = os.path.dirname(self.path)
            raise LinkError(f"{self.path}: folder {folder} does not exist; make it or choose another") from None
        except OSError as error:
            raise LinkError(f"{self.path}: cannot make {self._lock_path}: {error.strerror}") from None

    def _is_lock_file(self, fd: int) -> bool:
        try:
            return os.path.samestat(os.stat(self._lock_path), os.fstat(fd))
        except FileNotFoundError:
            return False

    def _make(self, left_behind: bool) -> None:
        try:
            if os.path.lexists(self.path):
                self._refuse_unless_stale(left_behind)
                new = f"{self.path}.{self._owner}.new"
                with contextlib.suppress(FileNotFoundError):
                    os.unlink(new)
                os.symlink(self._target, new)
                os.replace(new, self.path)
            else:
                os.symlink(self._target, self.path)
        except LinkError:
            raise
        except OSError as error:
            raise LinkError(f"{self.path}: cannot make the link: {error.strerror}") from None

    def _refuse_unless_stale(self, left_behind: bool) -> None:
        if not os.path.islink(self.path):
            kind = "a folder" if os.path.isdir(self.path) else "a file"
            raise LinkError(f"{self.path}: {kind} of that name exists; move it or choose another path")
        old = os.readlink(self.path)
        if not old.startswith(TERMINALS) or (os.path.exists(old) and not left_behind):
            raise LinkError(f"{self.path}: a link to {old} that is not ours exists; remove it or choose another path")

    def remove(self) -> None:
        """Remove link and lock, when they are still ours; nothing in a forked child. May be called twice."""
        if self._lock_fd < 0:
            return
        if os.getpid() == self._owner:
            with contextlib.suppress(OSError):
                if os.readlink(self.path) == self._target:
                    os.unlink(self.path)
            with contextlib.suppress(OSError):
                if self._is_lock_file(self._lock_fd):
                    os.unlink(self._lock_path)
        self._unlock(keep_file=True)

    def _unlock(self, keep_file: bool = False) -> None:
        if not keep_file:
            with contextlib.suppress(OSError):
                os.unlink(self._lock_path)
        os.close(self._lock_fd)
        self._lock_fd = -1
