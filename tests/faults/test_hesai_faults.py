"""Faults of a Hesai's own: its control channel, its calibration file, its temperature, its grandmaster."""

from __future__ import annotations

from pathlib import Path

import pytest

from emulator.judging.trial import Trial
from emulator.scenario import scenario

TEXT = """\
schema: 1
seed: 1
duration_s: 3.0
world:
  - {plane: {size_m: [6, 60]}, at_m: [5, 0, 1], pitch_deg: -90, material: white_plaster}
sensors:
  - id: one
    model: hesai-xt32
    mount: {at_m: [0, 0, 1]}
    physics: {noise: false, rule: axis, sub_beams: 1}
    device: {boot_s: 0, spin_up_s: 0, range_deg: [0, 1], clock_source: ptp}
faults:
  - {on: one, at_s: 0.5, for_s: 0.5, do: DO}
"""


def trial(do: str) -> Trial:
    text = TEXT.replace("do: DO", do)
    return Trial(scenario.loads(text, Path("case.yaml")))


@pytest.mark.parametrize(
    ("do", "field", "within"),
    [("do: ptc_error, code: 7", "error_code", 7), ("do: calibration_file", "calibration", 1),
     ("do: calibration_file, served: damaged", "calibration", 2), ("do: overheating", "hot", True),
     ("do: calibration_served_wrong, elevation_deg: 0.25", "wrong_deg", 0.25)],
)  # fmt: skip
def test_faults_of_its_own_hold_until_they_end(do: str, field: str, within: object) -> None:
    made = trial(do)
    (instrument,) = made.instruments
    seen = []
    for until_s in (0.4, 0.8, 1.2):
        made.run.advance(round(until_s * 1e9))
        seen.append(getattr(instrument.session, field))
    assert seen == [type(within)(0), within, type(within)(0)]
    assert instrument.stats.scans_sent > 0, "the built-in host asked for packets"
    made.close()


def test_without_its_grandmaster_ptp_is_frozen_until_the_fault_ends() -> None:
    text = (
        TEXT.replace("do: DO", "do: no_ptp")
        .replace("at_s: 0.5", "at_s: 3.5")
        .replace("duration_s: 3.0", "duration_s: 9.0")
    )
    made = Trial(scenario.loads(text.replace("[0, 1]", "[200, 201]"), Path("case.yaml")))
    (instrument,) = made.instruments
    states = []
    for until_s in (3.4, 3.8, 4.5, 7.5):
        made.run.advance(round(until_s * 1e9))
        states.append(instrument.session.source.ptp_state(made.run.clock.now_ns()))  # type: ignore[attr-defined]
    assert states == [2, 3, 1, 2]
    made.close()
