"""Folders of predictable names that this user alone may write to: sockets of daemons, libraries that are preloaded.

Belongs here: making one, and refusing what somebody else may have planted in its place. Not: temporary folders, whose
names nobody can know (`tempfile`).
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from emulator.errors import EmulatorError


def private_folder(folder: Path, otherwise: str, error: type[EmulatorError] = EmulatorError) -> Path:
    """The folder, made where it is missing; `error` unless it is this user's, of mode 0700, and nobody can replace it.

    A link in its place is never followed, whoever made it. `otherwise`: what the user may do instead.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        wrong = _wrong(folder)
    except FileExistsError:
        wrong = _wrong(folder)
    except OSError as cause:
        raise error(f"{folder}: cannot be made: {cause.strerror}; {otherwise}") from None
    if wrong:
        raise error(f"{folder}: {wrong}; want a folder of this user alone, mode 0700: remove it, or {otherwise}")
    return folder


def _wrong(folder: Path) -> str:
    """What is wrong with it; empty: nothing."""
    found, user = os.lstat(folder), os.getuid()
    if stat.S_ISLNK(found.st_mode):
        return f"a link to {os.readlink(folder)}"
    if not stat.S_ISDIR(found.st_mode):
        return "a file"
    if found.st_uid != user:
        return f"a folder of user {found.st_uid}"
    if found.st_mode & 0o077:
        return f"mode {stat.S_IMODE(found.st_mode):04o}"
    above = os.stat(folder.parent)
    others = above.st_uid not in (user, 0) or above.st_mode & 0o002
    if others and not above.st_mode & stat.S_ISVTX:  # a sticky folder lets nobody move what is another's
        return f"in {folder.parent} (user {above.st_uid}, mode {stat.S_IMODE(above.st_mode):04o}) others can replace it"
    return ""
