"""A descriptor that becomes readable when somebody opens or closes a file: Linux inotify through the C library.

It tells that something happened, not what: equal events that nobody has read yet are merged by the kernel, so opens and
closes cannot be counted with it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os

IN_CLOSE_WRITE, IN_CLOSE_NOWRITE, IN_OPEN = 0x08, 0x10, 0x20


class OpenWatch:
    """Readable after an open or a close of `path`, until `drain`."""

    def __init__(self, path: str) -> None:
        """Raises OSError where the kernel has no inotify or no instance left."""
        library = ctypes.CDLL(None, use_errno=True)
        if not hasattr(library, "inotify_init1"):
            raise OSError("no inotify on this system")
        self._fd = library.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "inotify_init1")
        events = IN_OPEN | IN_CLOSE_WRITE | IN_CLOSE_NOWRITE
        if library.inotify_add_watch(self._fd, os.fsencode(path), events) < 0:
            error = ctypes.get_errno()
            os.close(self._fd)
            raise OSError(error, "inotify_add_watch", path)

    def fileno(self) -> int:
        return int(self._fd)

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
