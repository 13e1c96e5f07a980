"""The built-in host for Hesai, and the faults of its own, in virtual time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from emulator.hosts.hesai import TurnReader, described
from emulator.judging.trial import Trial
from emulator.scenario import scenario
from protocols.hesai.models import MODELS
from protocols.hesai.session import frame
from tests.protocols.hesai.rig import Rig, clouds

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


@pytest.mark.parametrize("name", sorted(MODELS))
def test_the_reader_turns_packets_of_every_model_in_any_chunking_into_scans_of_the_wall(name: str) -> None:
    rig = Rig(name)
    data = b"HTTP/1.1 200 OK\r\n\r\n" + b"".join(one.payload for one in clouds(rig.run(0.32)))
    reader = TurnReader()
    scans = [scan for at in range(0, len(data), 777) for scan in reader.feed(data[at : at + 777])]
    assert reader.errors == 0
    assert reader.title == f"Hesai {MODELS[name].title}"
    assert len(scans) >= 1
    scan = scans[-1]
    assert scan.range_m == pytest.approx(10.0, abs=0.005)
    assert scan.cloud is not None
    assert len(scan.cloud.range_m) == len(scan.range_m) * MODELS[name].lasers
    spans = np.degrees(np.ptp(scan.azimuth_rad))
    assert spans == pytest.approx(125.0 if name == "hesai-at128" else 360.0, abs=6.0)
    assert np.degrees(scan.cloud.elevation_rad).max() == pytest.approx(max(MODELS[name].elevation_deg), abs=1e-6)


def test_rubbish_between_packets_is_counted_and_passed_over() -> None:
    packets = [one.payload for one in clouds(Rig().run(0.25))]
    reader = TurnReader()
    data = b"".join(packets[:5]) + b"\xee\xffrubbish" * 40 + b"".join(packets[5:])
    assert list(reader.feed(data))
    assert reader.errors > 0


def test_a_capture_is_described_in_words() -> None:
    packet = clouds(Rig().run(0.1))[3].payload
    fields = {one.name: one.value for one in described(None, packet, "datagram", 0, True)}  # type: ignore[arg-type]
    assert fields["model"] == "PandarXT-32"
    assert fields["sequence"] == "4"
    fields = {one.name: one.value for one in described(None, frame(0x17, b"\x02\x58"), "stream", 0, False)}  # type: ignore[arg-type]
    assert fields["command"] == "17 set spin rate"


def trial(do: str) -> Trial:
    text = TEXT.replace("do: DO", do)
    return Trial(scenario.loads(text, Path("case.yaml")))


@pytest.mark.parametrize(
    ("do", "field", "within"),
    [("do: ptc_error, code: 7", "error_code", 7), ("do: calibration_file", "calibration", 1),
     ("do: calibration_file, served: damaged", "calibration", 2), ("do: overheating", "hot", True)],
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
