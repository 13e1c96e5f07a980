"""A mutant is judged in a fork of a process that has run the tests before: nothing made by the sound code may survive.

Acts in mutation testing alone (`bash .ci/mutants`), by the variable that its tool sets.
"""

from __future__ import annotations

import os
import sys

import pytest


def pytest_sessionstart(session: pytest.Session) -> None:
    if "MUTANT_UNDER_TEST" not in os.environ:
        return
    for name in list(sys.modules):
        ours = name.split(".")[0] == "protocols" or name.startswith("tests.protocols.")
        if ours and not name.endswith("conftest"):
            del sys.modules[name]  # tables and layouts are made anew, by the mutant
