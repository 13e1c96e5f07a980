"""ACME X2, an invented scanner on a serial line: the device's side of its lines of text. A whole family in one module.

Belongs here: what goes over the wire and when. Not: what the device sees (acme-x2.yaml, and the emulator).

    host    START            device  OK START, then ten times a second  S 17 800 800 0 812 ... *5A
    host    STOP             device  OK STOP
    host    ID               device  OK ID ACME X2 0001
    host    anything else    device  ERR

Lines end with LF. A scan is its number, 91 ranges in centimetres from right to left (0: no echo), and the XOR of all
bytes before the `*` in two hexadecimal digits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from protocols.checksums import xor8
from protocols.scan import Floats, Scan
from protocols.session import LinkKind
from protocols.skeleton.family import SimpleFamily
from protocols.skeleton.keys import DeviceKeys
from protocols.skeleton.receiving import LineSplitter
from protocols.skeleton.requests import Command, Refused, Request, RequestSession, coverage
from protocols.skeleton.sweeps import Sweep, Telegram

BAUD = 115_200
BEAMS = 91
AZIMUTH_RAD = np.radians(np.arange(BEAMS) - 45.0)
PERIOD_NS = Fraction(100_000_000)
SWEEP_NS = 50_000_000
"The mirror looks forward in one half of each turn; a scan leaves at its end."
SWEEP = Sweep(
    azimuth_rad=AZIMUTH_RAD,
    elevation_rad=np.zeros(BEAMS),
    fire_offset_s=np.arange(BEAMS) * (1e-9 * SWEEP_NS / BEAMS),
    duration_s=1e-9 * SWEEP_NS,
    max_range_m=655.35,
)
BOOT_NS = 500_000_000
LONGEST_LINE = 64
SOURCE = "this page"


def encode_scan(number: int, range_m: Floats) -> bytes:
    """One line; range_m (n,) in metres, NaN where there is no echo. Farther than 655.35 m is no echo either."""
    centimetres = np.nan_to_num(np.round(100.0 * range_m), nan=0.0)
    words = np.where(centimetres <= 65_535, centimetres, 0).astype(int)
    body = f"S {number} {' '.join(map(str, words))} ".encode()
    return body + f"*{xor8(body):02X}\n".encode()


def decode_scan(line: bytes) -> tuple[int, Floats] | None:
    """Number and ranges in metres, NaN where there is no echo; None: damaged, or no scan."""
    body, star, check = line.strip().rpartition(b"*")
    words = body.split()
    if not star or check != f"{xor8(body):02X}".encode() or len(words) != BEAMS + 2 or words[0] != b"S":
        return None
    ranges = np.array([float(word) for word in words[2:]]) / 100.0
    return int(words[1]), np.where(ranges > 0.0, ranges, np.nan)


class AcmeSession(RequestSession):
    """One ACME X2."""

    LINE_SPEED = BAUD

    def __init__(self, serial_number: str) -> None:
        super().__init__(BOOT_NS, PERIOD_NS)
        self._serial_number = serial_number

    # scans

    def _sweep(self, number: int) -> Sweep:
        return SWEEP

    def _telegrams(self, scan: Scan) -> list[Telegram]:
        return [Telegram(SWEEP_NS, encode_scan(scan.plan.sweep, scan.range_m[:, 0]), "S")]

    # requests

    def _splitter(self, kind: LinkKind | None) -> LineSplitter:
        return LineSplitter(LONGEST_LINE)

    def _parse(self, request: bytes) -> tuple[bytes, bytes]:
        return request.strip(), b""

    def _reply(self, request: Request, payload: bytes) -> bytes:
        return b"OK " + request.code + payload + b"\n"

    def _refusal(self, request: Request, refused: Refused) -> bytes:
        return b"ERR\n"

    def _begin(self, request: Request) -> bytes:
        self._subscribe(request.now_ns, None)  # it has one port: every link
        return b""

    def _end(self, request: Request) -> bytes:
        self._unsubscribe(request.now_ns, None)
        return b""

    def _identify(self, request: Request) -> bytes:
        return f" ACME X2 {self._serial_number}".encode()

    COMMANDS: ClassVar[Mapping[bytes, Command]] = {
        b"START": Command("stream scans", _begin, SOURCE),
        b"STOP": Command("stop the stream", _end, SOURCE),
        b"ID": Command("name and serial number", _identify, SOURCE),
    }


def new_session(keys: DeviceKeys) -> AcmeSession:
    """Of a scenario's `device:` table."""
    return AcmeSession(keys.text("serial_number", "sent behind ID", "0001", 32))


class AcmeFamily(SimpleFamily):
    """With hosts of its own."""

    def host(self, line: Any, baud: int) -> Any:
        """For `lidaremu look`: a host on an open line."""
        from acme_host import AcmeHost

        return AcmeHost(line)

    def script(self, line: Any, on_scan: Callable[[int, Any], None]) -> Any:
        """For `lidaremu test`: a host in virtual time."""
        from acme_host import AcmeScript

        return AcmeScript(line, on_scan)


FAMILY = AcmeFamily("acme", tcp_is_line=True, build=new_session, rows=coverage(AcmeSession.COMMANDS))
