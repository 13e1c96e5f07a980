"""What holds for all tests of studies: figures of few dots, references of fewer rays and times of fewer beams in whole
reports, and what several tests ask of the same numbers is computed once."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import pytest

from emulator.studies import (
    accuracy_leaving,
    accuracy_narrow,
    accuracy_rules,
    accuracy_targets,
    drawing,
    further,
    measured,
    mie,
    ranges,
)

SHARED = ((further, "all_facts"), (measured, "facts"), (mie.Droplets, "optics"), (ranges, "table_2"))
"Functions of values alone."


@pytest.fixture(scope="session", autouse=True)
def _coarse() -> Iterator[None]:
    """Before anything that tests of a file share is made."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drawing, "DPI", 30)
        patch.setattr(accuracy_rules, "REFERENCE", 1 << 16)
        patch.setattr(accuracy_targets, "REFERENCE", {**accuracy_targets.REFERENCE, "sub_beams": 1 << 13})
        patch.setattr(accuracy_leaving, "REFERENCE_SUB_BEAMS", 1 << 10)
        patch.setattr(accuracy_narrow, "TIMED", 1)
        for module, name in SHARED:
            patch.setattr(module, name, cache(getattr(module, name)))
        yield
