"""An ordinary host of a SICK LMS291: pyserial and the telegram listing, nothing of the emulator."""

from __future__ import annotations

import math

import serial

START_STREAM = b"\x20\x24"


def crc(data: bytes) -> int:
    """SICK's checksum of a telegram."""
    register = last = 0
    for byte in data:
        register = ((register << 1) & 0xFFFF) ^ (0x8005 if register & 0x8000 else 0) ^ (last << 8 | byte)
        last = byte
    return register


class LmsHost:
    """Asks for a stream and hands out its scans."""

    def __init__(self, port: str, field_deg: float, step_deg: float) -> None:
        """The device's permanent rate is 500 000 baud, its unit centimetres."""
        self.line = serial.Serial(port, 500_000, timeout=0)
        self.first, self.step = math.radians(-field_deg / 2), math.radians(step_deg)
        self.held = b""
        self.count = 0
        "Scans so far."

    def close(self) -> None:
        """Leave the port."""
        self.line.close()

    def start(self) -> None:
        """Ask for all scans; the reply comes before the first of them."""
        frame = b"\x02\x00" + len(START_STREAM).to_bytes(2, "little") + START_STREAM
        self.line.write(frame + crc(frame).to_bytes(2, "little"))

    def scans(self) -> list[list[tuple[float, float]]]:
        """What has come since the last call: of each scan x ahead and y to the left of every echo. [m]"""
        self.held += self.line.read(65_536)
        found = []
        while (begin := self.held.find(b"\x02\x80")) >= 0 and len(self.held) >= begin + 4:
            size = int.from_bytes(self.held[begin + 2 : begin + 4], "little")
            whole = self.held[begin : begin + size + 6]
            if size <= 820 and len(whole) < size + 6:
                break
            if size > 820 or crc(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
                self.held = self.held[begin + 1 :]
                continue
            self.held = self.held[begin + size + 6 :]
            if whole[4] == 0xB0:
                found.append(self.points(whole))
        self.count += len(found)
        return found

    def points(self, telegram: bytes) -> list[tuple[float, float]]:
        """Of one telegram; 13 bits of range, of which the top values are no range."""
        raw = [int.from_bytes(telegram[at : at + 2], "little") & 0x1FFF for at in range(7, len(telegram) - 3, 2)]
        polar = [(value / 100, self.first + index * self.step) for index, value in enumerate(raw) if value < 0x1FF7]
        return [(metres * math.cos(angle), metres * math.sin(angle)) for metres, angle in polar]
