"""Killed at any byte and instant of its start-up, a driver started again gets its scans: desk families and CoLa.

What a killed host left on a line stays in the device: if that was half a request, the first attempt may be lost in it.
On TCP nothing of a dead connection may cost the next one anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.protocols.cola.reader import ask_a, ask_b
from tests.protocols.line_rig import MS, SECOND, LineRig
from tests.protocols.rplidar.rig import request

ATTEMPT_LIMIT_NS = 6 * SECOND
"A driver is started again within this time; the device has forgotten half a request then."


@dataclass(frozen=True)
class Case:
    """A driver and its device."""

    family: str
    model: str
    device: dict[str, Any]
    trace: list[tuple[bytes, bytes]]
    "Request, and what its reply contains; nothing: no reply."
    more: int
    "Bytes that follow the last one within 1.5 seconds."
    serial: bool = True
    wait_ns: int = 20 * MS


def scip(*commands: str) -> list[tuple[bytes, bytes]]:
    return [(one.encode() + b"\n", one.encode() + b"\n") for one in commands]


def cola(*asked: tuple[str, str]) -> list[tuple[bytes, bytes]]:
    answers = {"sRN": "sRA", "sWN": "sWA", "sMN": "sAN", "sEN": "sEA"}
    return [(ask_b(text, data), f"{answers[text[:3]]}{text[3:]}".encode()) for text, data in asked]


def conf(entry: int, more: bytes = b"") -> tuple[bytes, bytes]:
    return request(0x84, entry.to_bytes(4, "little") + more), b"\x20" + entry.to_bytes(4, "little")


FULL = "0000108001"
INFO, HEALTH, STOP = (request(0x50), b"\x14\0\0\0\x04"), (request(0x52), b"\x03\0\0\0\x06"), (request(0x25), b"")
SDK_A1 = [INFO, HEALTH, conf(1), STOP, INFO, INFO, conf(0x7C), STOP, INFO,
          *(conf(e, b"\x03\0") for e in (0x71, 0x74, 0x75, 0x7F)), conf(1),
          (request(0x82, b"\x03\0\0\0\0"), b"\x84\0\0\x40\x84")]  # fmt: skip
SDK_S2 = [INFO, HEALTH, (request(0xA8, b"\x58\x02"), b""), STOP, INFO, conf(0x7C), conf(0x79),
          (request(0x82, b"\x01\0\0\0\0"), b"\x54\0\0\x40\x85")]  # fmt: skip
EAI = [(b"\xa5\x00", b""), (b"\xa5\x65", b""), (b"\xa5\x92", b"\x03\0\0\0\x06"), (b"\xa5\x90", b"\x14\0\0\0\x04"),
       (b"\xa5\x00", b""), (b"\xa5\x65", b""), (b"\xa5\x60", b"\xa5\x5a\x05\0\0\x40\x81")]  # fmt: skip
URG_NODE = scip("QT", "PP", f"ME{FULL}000", "QT", "VV", "II", f"ME{FULL}000")
MRPT = scip("QT", "QT", "SCIP2.0", "BM", "HS0", "PP", "VV", f"MD{FULL}000")
XD = cola(
    ("sRN SCdevicestate", ""), ("sMN SetAccessMode", "03f4724744"), ("sWN EIHstCola", "01"),
    ("sWN LMDscandatacfg", "01000000000000000000010001"), ("sMN LMCstartmeas", ""), ("sMN Run", ""),
    ("sEN LMDscandata", "01"),
)  # fmt: skip
LINE_A = [(ask_a(asked), reply) for asked, reply in (
    ("sRN DeviceIdent", b"sRA DeviceIdent"), ("sMN SetAccessMode 03 F4724744", b"sAN SetAccessMode 1"),
    ("sRN STlms", b"sRA STlms 7"), ("sEN LMDscandata 1", b"sEA LMDscandata 1"))]  # fmt: skip
STILL = {"boot_s": 0.1, "spin_up_s": 0.2}
CASES = [
    Case("rplidar", "rplidar-a1m8", STILL, SDK_A1, 2500),
    Case("rplidar", "rplidar-s2m1", STILL, SDK_S2, 25_000),
    Case("ydlidar", "ydlidar-x4", STILL, EAI, 5000),
    Case("ydlidar", "ydlidar-t-mini", STILL, EAI, 5000),
    Case("scip", "hokuyo-utm-30lx", STILL, URG_NODE, 50_000, wait_ns=60 * MS),
    Case("scip", "hokuyo-ust-10lx", STILL, MRPT, 50_000, serial=False, wait_ns=60 * MS),
    Case("cola", "sick-lms111", {"ready_s": 0.5}, XD, 25_000, serial=False),
    Case("cola", "sick-tim571", {"ready_s": 0.5}, XD, 10_000, serial=False),
    Case("cola", "sick-lms111", {"ready_s": 0.5, "serial_baud": 115_200}, LINE_A, 5_000, wait_ns=200 * MS),
]


def attempt(rig: LineRig, case: Case) -> str:
    """A driver that is started now, from its first request to its scans; what it did not get."""
    host = rig.host()
    host.read()
    for asked, reply in case.trace:
        said = rig.ask(host, asked, case.wait_ns)
        if reply not in said:
            host.close(rig.now_ns)
            return f"{asked!r}: {said[:60]!r}; want {reply!r}"
    rig.run(1500 * MS, 20 * MS)
    size = len(host.read())
    host.close(rig.now_ns)
    return "" if size >= case.more else f"{size} bytes; want {case.more}"


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.model}-{'line' if case.serial else 'tcp'}")
@settings(max_examples=5, deadline=None)
@given(data=st.data())
def test_killed_anywhere_and_started_again_it_gets_its_scans(case: Case, data: st.DataObject) -> None:
    rig = LineRig(case.family, case.model, case.device, serial=case.serial)
    rig.run(data.draw(st.integers(0, 1500)) * MS, 10 * MS)
    asked = [one for one, _ in case.trace]
    whole = data.draw(st.integers(0, len(asked)))
    part = data.draw(st.integers(0, len(asked[whole]) - 1)) if whole < len(asked) else 0
    host = rig.host()
    for one in asked[:whole]:
        rig.ask(host, one, data.draw(st.integers(0, 60)) * MS)
    if part:
        host.write(asked[whole][:part], rig.now_ns)
    rig.run(data.draw(st.integers(0, 300)) * MS, 10 * MS)
    host.close(rig.now_ns)
    rig.run(max(data.draw(st.integers(0, 300)) * MS, 1600 * MS - rig.now_ns), 10 * MS)
    fault = attempt(rig, case)
    if part and case.serial and fault:
        rig.run(ATTEMPT_LIMIT_NS)
        fault = attempt(rig, case)
    assert not fault


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.model}-{'line' if case.serial else 'tcp'}")
def test_the_device_switched_off_under_a_running_driver_serves_the_next_one(case: Case) -> None:
    rig = LineRig(case.family, case.model, case.device, serial=case.serial)
    rig.run(2 * SECOND, 20 * MS)
    assert not attempt(rig, case)
    rig.session.power_on(rig.now_ns)
    rig.run(2 * SECOND, 20 * MS)
    assert not attempt(rig, case)
