"""The built-in host for Hesai, in virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.hosts.hesai import TurnReader, described
from protocols.hesai.models import MODELS
from protocols.hesai.session import frame
from tests.protocols.hesai.rig import Rig, clouds


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
    assert np.degrees(scan.cloud.elevation_rad).max() == pytest.approx(
        max(MODELS[name].elevation_deg), abs=0.2 if name == "hesai-at128" else 1e-6
    )


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
