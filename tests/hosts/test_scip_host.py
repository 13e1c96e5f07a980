"""The hosts of SCIP: replies in any chunking, damage counted, a device in any state brought to send scans."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from emulator.hosts.scans import HostScan
from emulator.hosts.scip import Reply, ReplyReader, ScipHost, ScipScript, ScipView
from protocols.session import LinkKind
from tests.protocols.scip.rig import LINE, MS, SECOND, Rig


class End:
    """A host's end of a line to a rig: the time of the device passes while the host reads."""

    baud: int | None = None

    def __init__(self, rig: Rig) -> None:
        self.rig, self.closed = rig, False

    def set_baud(self, baud: int) -> None:
        self.baud = baud

    def write(self, data: bytes, at_ns: int = 0) -> int:
        self.rig.session.receive(data, self.rig.now_ns, LINE)
        return len(data)

    def read(self, timeout_s: float = 0.0) -> bytes:
        for _ in range(1 + round(timeout_s / 0.005)):
            self.rig.run(5 * MS)
            if data := self.rig.raw():
                return data
        return b""

    def close(self) -> None:
        self.closed = True


def first_scans(host: ScipHost, count: int) -> list[HostScan]:
    found: list[HostScan] = []
    for scan in host.scans(0.5):
        assert scan is not None
        found.append(scan)
        if len(found) == count:
            return found
    raise AssertionError("the host has ended")


@pytest.mark.parametrize("before", ["", "TM0", "ME0000108001000", "BM"])
@pytest.mark.parametrize("model", ["hokuyo-utm-30lx", "hokuyo-urg-04lx"])
def test_the_host_streams_whatever_the_device_did_before(before: str, model: str) -> None:
    rig = Rig(model)
    rig.put(before + "\n")
    rig.run(100 * MS)
    line: Any = End(rig)
    host = ScipHost(line, 115_200)
    assert host.title == f"SOKUIKI Sensor {model[7:].upper()}"
    scan = first_scans(host, 2)[1]
    size = 1081 if "utm" in model else 682
    np.testing.assert_allclose(scan.range_m, (1000 + 5 * np.arange(size)) / 1000.0)
    assert scan.azimuth_rad[0] == pytest.approx(np.radians(-135.0 if size == 1081 else -340 * 360 / 1024))
    assert (scan.intensity is None) == (size == 682)
    assert host.errors == 0
    host.close()
    rig.run(SECOND)
    assert line.closed
    assert rig.session.next_plan() is None


def test_the_host_leaves_scip_1_1_and_a_probe_does_not() -> None:
    rig = Rig("hokuyo-urg-04lx", {"protocol": "SCIP1.1"})
    line: Any = End(rig)
    assert ScipHost(line, None).title == "SCIP"
    assert rig.session.scip1
    assert ScipHost(line, 19_200).title == "SOKUIKI Sensor URG-04LX"
    assert not rig.session.scip1


def test_the_script_asks_again_after_a_restart() -> None:
    rig = Rig(kind=LinkKind.SERIAL)
    seen: list[int] = []
    line: Any = End(rig)
    script = ScipScript(line, lambda now_ns, scan: seen.append(now_ns))
    while rig.now_ns < 3 * SECOND:
        script.step(rig.now_ns)
    assert len(seen) > 80
    rig.session.power_on(rig.now_ns)
    again_ns, before = rig.now_ns, len(seen)
    while rig.now_ns < again_ns + 6 * SECOND:
        script.step(rig.now_ns)
    assert len(seen) - before > 80


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_replies_are_found_in_any_chunking_and_damage_is_counted(chunk: int) -> None:
    data = b"rest of one\n\nVV\n00P\nPROD:X;b\n\nQT\n00Q\n\nBM\n02R\n\nV\n0\n\n"
    reader, found = ReplyReader(), []
    for at in range(0, len(data), chunk):
        found += reader.feed(data[at : at + chunk])
    assert found == [Reply(b"VV", b"00", (b"PROD:X;b",)), Reply(b"BM", b"02", ()), Reply(b"V", b"0", ())]
    assert reader.errors == 2


@pytest.mark.parametrize("lines", [(), (b"AMIN:0;?",), (b"AMIN:x;?", b"AMAX:1;a")])
def test_parameters_that_are_missing_are_no_view(lines: tuple[bytes, ...]) -> None:
    assert ScipView.of(Reply(b"PP", b"00", lines)) is None
