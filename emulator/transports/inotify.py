"""Descriptors that become readable when somebody opens or closes a file, or a folder changes: inotify through libc.

They tell that something happened, not what: equal events that nobody has read yet are merged by the kernel, so opens
and closes cannot be counted with them.
"""

from __future__ import annotations

import contextlib
import ctypes
import os

IN_CLOSE_WRITE, IN_CLOSE_NOWRITE, IN_OPEN = 0x08, 0x10, 0x20
IN_MOVED_FROM, IN_MOVED_TO, IN_CREATE, IN_DELETE, IN_DELETE_SELF, IN_MOVE_SELF = 0x40, 0x80, 0x100, 0x200, 0x400, 0x800
IN_ONLYDIR, IN_ONESHOT = 0x0100_0000, 0x8000_0000
NAMES = IN_MOVED_FROM | IN_MOVED_TO | IN_CREATE | IN_DELETE | IN_DELETE_SELF | IN_MOVE_SELF


class _Watch:
    """One inotify instance."""

    def __init__(self) -> None:
        """Raises OSError where the kernel has no inotify or no instance left."""
        library = ctypes.CDLL(None, use_errno=True)
        if not hasattr(library, "inotify_init1"):
            raise OSError("no inotify on this system")
        self._add = library.inotify_add_watch
        self._add.argtypes = [ctypes.c_int, ctypes.c_char_p, ctypes.c_uint32]
        self._fd = library.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "inotify_init1")

    def fileno(self) -> int:
        return int(self._fd)

    def _follow(self, path: str, events: int) -> int:
        """0, or why the path cannot be watched."""
        return ctypes.get_errno() if self._add(self._fd, os.fsencode(path), events) < 0 else 0

    def drain(self) -> None:
        """Forget what has happened so far."""
        with contextlib.suppress(BlockingIOError):
            while os.read(self._fd, 65_536):
                pass

    def close(self) -> None:
        """Let go of the descriptor; may be called twice."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class OpenWatch(_Watch):
    """Readable after an open or a close of `path`, until `drain`."""

    def __init__(self, path: str) -> None:
        """Raises OSError where the kernel has no inotify or no instance left."""
        super().__init__()
        error = self._follow(path, IN_OPEN | IN_CLOSE_WRITE | IN_CLOSE_NOWRITE)
        if error:
            self.close()
            raise OSError(error, "inotify_add_watch", path)


class FolderWatch(_Watch):
    """Readable after a name in a folder came, went or changed: once, until that folder is armed again."""

    def arm(self, folder: str) -> None:
        """Tell of the next change; one that cannot be watched (it is gone) is looked at by whoever asked, in time."""
        self._follow(folder, NAMES | IN_ONLYDIR | IN_ONESHOT)
