"""A symbolic link under a name of the user's choice that belongs to one running process.

Beside `front` lies `.front.lidaremu`, locked (flock) while its owner lives; the kernel lets go of the lock however the
owner ends, so after `kill -9` the next start takes both over. Only what is plainly ours is replaced: a link into
/dev/pts that leads nowhere, or one whose owner left its lock file behind. A file, a folder, a link of somebody else is
never touched.

While its owner runs, `tend` puts back a link that was removed, or in whose place stands one that leads nowhere; what
else stands there is reported and left alone until it goes. Only who holds the lock writes the link, so two running
daemons
never take it from each other; who is robbed again and again waits longer each time.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat

from emulator.errors import LinkError
from emulator.transports.link import LinkIncident

TERMINALS = "/dev/pts/"
SECOND_NS = 1_000_000_000
LONGEST_NS = 60 * SECOND_NS
QUIET_NS = 2 * LONGEST_NS
"A link that has stood for so long is restored at once when it goes."
FREE = 8
"So often it is restored at once within that time; then after 1 s, 2 s, 4 s, up to `LONGEST_NS`."
RESTORED, TAKEN, GONE = "link restored", "link path taken", "link path gone"
"Kinds of incidents."


class StablePath:
    """`path` leads to `target` from now until `remove`."""

    def __init__(self, path: str, target: str) -> None:
        self.path = os.path.abspath(path)
        self._target = target
        self._owner = os.getpid()
        self._heir = False
        "The lock was taken again from somebody who is dead: a link into /dev/pts is his."
        self._away = ""
        "What was reported of the link while it is not there: `TAKEN` or `GONE`."
        self._restored_ns = -QUIET_NS
        self._restored = 0
        "How often it was restored with less than `QUIET_NS` between."
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
            found = os.fstat(fd)
            if not stat.S_ISREG(found.st_mode) or found.st_uid != os.getuid():
                os.close(fd)
                raise LinkError(f"{self._lock_path}: not a file of this user; want no file, or the lock of an emulator")
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
                self._link(replace=True)
            else:
                self._link(replace=False)
        except LinkError:
            raise
        except OSError as error:
            raise LinkError(f"{self.path}: cannot make the link: {error.strerror}") from None

    def _link(self, replace: bool) -> None:
        if not replace:
            os.symlink(self._target, self.path)
            return
        new = f"{self.path}.{self._owner}.new"
        with contextlib.suppress(FileNotFoundError):
            os.unlink(new)
        os.symlink(self._target, new)
        os.replace(new, self.path)

    def _refuse_unless_stale(self, left_behind: bool) -> None:
        if not os.path.islink(self.path):
            kind = "a folder" if os.path.isdir(self.path) else "a file"
            raise LinkError(f"{self.path}: {kind} of that name exists; move it or choose another path")
        old = os.readlink(self.path)
        if not old.startswith(TERMINALS) or (os.path.exists(old) and not left_behind):
            raise LinkError(f"{self.path}: a link to {old} not made by lidaremu exists; remove it or use another path")

    def tend(self, now_ns: int) -> list[LinkIncident]:
        """Look whether the link still leads here, put it back where that is allowed; incidents since then."""
        if self._lock_fd < 0 or os.getpid() != self._owner:
            return []
        stands, locked = self._leads_here(), self._is_lock_file(self._lock_fd)
        if stands and locked:
            return self._back("points here again") if self._away else []
        if stands:  # the lock is nobody's business but ours: it is taken again in silence, now or with the next look
            with contextlib.suppress(LinkError):
                self._lock_again()
            return []
        folder = os.path.dirname(self.path)
        if not os.path.isdir(folder):
            return self._stay(GONE, f"{self.path}: folder {folder} is gone; the link is restored when it exists again")
        try:
            if not locked:
                left_behind = os.path.lexists(self._lock_path)
                self._lock_again()
                self._heir = left_behind
            what, alive = self._what_stands()
            if alive:
                return self._stay(TAKEN, f"{self.path}: {what} exists there; left alone, restored when it is gone")
            pause_ns = 0 if self._restored < FREE else min(LONGEST_NS, SECOND_NS << min(self._restored - FREE, 10))
            if now_ns < self._restored_ns + pause_ns:
                return []
            self._link(replace=bool(what))
        except LinkError as error:
            other = "in use by a running emulator" in str(error)
            return self._stay(TAKEN if other else GONE, f"{error}; restored when that changes")
        except OSError as error:
            return self._stay(GONE, f"{self.path}: cannot be restored: {error.strerror}; retrying")
        self._restored = 1 if now_ns - self._restored_ns > QUIET_NS else self._restored + 1
        self._restored_ns, self._heir = now_ns, False
        return self._back(f"{what} was there; restored" if what else "was removed; restored")

    def _back(self, how: str) -> list[LinkIncident]:
        self._away = ""
        return [LinkIncident(RESTORED, f"{self.path}: {how}")]

    def _stay(self, kind: str, text: str) -> list[LinkIncident]:
        reported, self._away = self._away, kind
        return [] if reported == kind else [LinkIncident(kind, text)]

    def _leads_here(self) -> bool:
        try:
            return os.readlink(self.path) == self._target
        except OSError:
            return False

    def _lock_again(self) -> None:
        old, self._lock_fd = self._lock_fd, self._lock()
        os.close(old)

    def _what_stands(self) -> tuple[str, bool]:
        """What is in the link's place, empty for nothing, and whether it is somebody's: not a link to nowhere."""
        if os.path.islink(self.path):
            target = os.readlink(self.path)
            return f"a link to {target}", os.path.exists(self.path) and not (
                self._heir and target.startswith(TERMINALS)
            )
        if not os.path.lexists(self.path):
            return "", False
        return "a folder" if os.path.isdir(self.path) else "a file", True

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
