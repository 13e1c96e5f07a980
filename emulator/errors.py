"""Errors of the emulator half, each with the exit code of the command line.

EmulatorError
  ScenarioError(ValueError)      file:line: key: found; allowed         exit code 2
  SpecError(ValueError)          the same for a sensor spec             exit code 2
  SceneError(ValueError)         mesh missing, empty, not finite        exit code 2
  LinkError(OSError)             cannot open, or lost                   exit code 3
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Self


class EmulatorError(Exception):
    """A fault that the user can mend; its text says where, what was found and what is allowed."""

    exit_code = 2
    _lines: tuple[str, ...] = ()

    @classmethod
    def of(cls, lines: Iterable[str]) -> Self:
        """Several faults, a line each; an end of a line within one is somebody else's."""
        reported = tuple(lines)
        error = cls("\n".join(reported))
        error._lines = reported
        return error

    @property
    def lines(self) -> tuple[str, ...]:
        """Its faults."""
        return self._lines or (str(self),)


class ScenarioError(EmulatorError, ValueError):
    """A fault of a scenario file."""


class SpecError(EmulatorError, ValueError):
    """A fault of a sensor spec file."""


class SceneError(EmulatorError, ValueError):
    """A mesh that is missing, empty or not finite."""


class LinkError(EmulatorError, OSError):
    """A link that cannot be opened, or that was lost."""

    exit_code = 3
