"""Devices that refuse requests or logins for a while, in virtual time; and for whom these faults exist."""

from __future__ import annotations

from pathlib import Path

import pytest

from emulator.errors import ScenarioError
from emulator.faults.catalogue import fits, kinds
from emulator.judging.trial import Trial
from emulator.scenario import scenario

TEXT = """\
schema: 1
seed: 1
duration_s: 3.0
world:
  - {plane: {size_m: [6, 60]}, at_m: [5, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - {id: one, model: MODEL, mount: {at_m: [0, 0, 1]}, physics: {noise: false, rule: axis, sub_beams: 1}}
faults:
  - {on: one, do: DO, at_s: 0.0, for_s: 1.2}
"""


def trial(do: str, model: str = "sick-tim551") -> Trial:
    return Trial(scenario.loads(TEXT.replace("DO", do).replace("MODEL", model), Path("refusing.yaml")))


def test_a_busy_device_gives_no_scan_until_the_fault_ends_and_counts_what_it_refused() -> None:
    made = trial("device_busy")
    made.run.advance(1_150_000_000)
    (instrument,) = made.instruments
    assert instrument.stats.scans_sent == 0
    assert instrument.stats.input_dropped["device busy with earlier requests"] > 0
    made.run.advance(3_000_000_000 + 1_500_000_000)
    assert instrument.stats.scans_sent > 0
    made.close()


@pytest.mark.parametrize("do", ["device_busy", "refuse_login"])
def test_only_families_that_state_it_have_the_fault(do: str) -> None:
    assert fits(kinds()[do]) == "cola"
    with pytest.raises(ScenarioError, match="want a sensor of cola"):
        trial(do, "sick-lms291-s05")
