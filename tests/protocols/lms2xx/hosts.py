"""The hosts of the world, reduced to what they say, what they need and how long they wait for it.

Order of telegrams, time-outs and demands are those of the drivers' sources (named in each docstring); traces captured
of sicktoolbox, MRPT, Player, ARIA, CARMEN and Robotics Library agree. A host that does not get what it needs in time
raises `HostFailure`, as the driver gives up.
"""

from __future__ import annotations

from dataclasses import dataclass

from protocols.lms2xx.telegrams import MeasuredValues, Telegram, read_values, request
from tests.protocols.lms2xx.rig import Rig

RATES = {9600: "42", 19200: "41", 38400: "40", 500_000: "48"}
PASSWORD = "20 00 53 49 43 4B 5F 4C 4D 53"
CONTOURS = "00 0A 0A 50 64 00 0A 0A 50 64 00 0A 0A 50 64"
BLOCK = "00 00 46 00 00 {d} {e} 00 00 02 02 00 00 " + CONTOURS + " 00 00 00 00 02 00"


class HostFailure(AssertionError):
    """The driver has given up."""


@dataclass
class Host:
    """What all drivers share: write a payload, wait for a reply."""

    rig: Rig

    def require(self, held: object, what: str) -> None:
        if not held:
            raise HostFailure(f"{type(self).__name__} at {self.rig.now_ns / 1e9:.3f} s: {what}")

    def transact(self, text: str, reply: int, timeout_s: float, tries: int = 1) -> Telegram:
        """Send until the reply with that command has come; everything else is skipped."""
        for _ in range(tries):
            self.rig.flush_input()
            self.rig.ask(text)
            telegram = self.rig.await_reply(reply, timeout_s)
            if telegram is not None:
                return telegram
        raise HostFailure(f"{type(self).__name__}: no {reply:02X} to {text} within {tries} x {timeout_s} s")

    def acknowledged(self, text: str, timeout_s: float, pause_s: float = 0.0) -> bool:
        """Flush, send, and demand that the very next byte is ACK; times from the last byte sent."""
        self.rig.flush_input()
        self.rig.run(self.rig.ask(text))
        self.rig.wait(pause_s)
        return self.rig.read(1, timeout_s) == b"\x06"

    def scans(self, count: int, reply: int, timeout_s: float) -> list[MeasuredValues]:
        """The next telegrams of measured values."""
        found = []
        for _ in range(count):
            telegram = self.rig.await_reply(reply, timeout_s)
            self.require(telegram is not None, f"no {reply:02X} within {timeout_s} s")
            assert telegram is not None
            values = read_values(telegram)
            self.require(values is not None, f"{reply:02X} of a wrong length")
            assert values is not None
            found.append(values)
        return found


class Sicktoolbox(Host):
    """ros-drivers/sicktoolbox SickLMS2xx.cc: awaits the reply, never the ACK; address 80 only."""

    def connect(self, baud: int = 38400) -> None:
        if not self._set_rate(baud):
            for probe in (19200, 38400, 500_000):
                self.rig.set_speed(probe)
                try:
                    self.transact("32", 0xB2, 1.0, 3)
                except HostFailure:
                    continue
                break
            else:
                raise HostFailure("sicktoolbox: no device at any rate")
            if probe != baud:
                self.require(self._set_rate(baud), "rate change after probing")
        self.require(self.transact("20 25", 0xA0, 3.0, 3).data[0] == 0, "A0 00")
        self.type_text = self.transact("3A", 0xBA, 1.0, 3).data[:-1]
        self.status = self.transact("31", 0xB1, 1.0, 3).data
        self.block = self.transact("74", 0xF4, 1.0, 3).data[:-1]
        self.require(len(self.block) in (32, 34), "configuration of 32 or 34 bytes")

    def _set_rate(self, baud: int) -> bool:
        try:
            self.transact(f"20 {RATES[baud]}", 0xA0, 1.0, 3)
        except HostFailure:
            return False
        self.rig.set_speed(baud)
        self.rig.wait(0.25)
        return True

    def stream(self, text: str, reply: int, count: int, timeout_s: float = 1.0) -> list[MeasuredValues]:
        self.require(self.transact(text, 0xA0, 3.0, 3).data[0] == 0, "A0 00")
        return self.scans(count, reply, timeout_s)

    def set_variant(self, field_deg: int, step_cdeg: int) -> None:
        self.transact("20 25", 0xA0, 3.0, 3)
        words = field_deg.to_bytes(2, "little") + step_cdeg.to_bytes(2, "little")
        self.require(self.transact("3B " + words.hex(" "), 0xBB, 1.0, 3).data[0] == 1, "BB 01")

    def write_block(self, block: bytes) -> None:
        self.require(self.transact(PASSWORD, 0xA0, 3.0, 3).data[0] == 0, "installation mode")
        self.require(self.transact("77 " + block.hex(" "), 0xF7, 15.0).data[0] == 1, "F7 01")
        self.transact("20 25", 0xA0, 3.0, 3)
        self.transact("31", 0xB1, 1.0, 3)
        self.block = block

    def reset(self, baud: int = 38400) -> None:
        self.transact("10", 0x91, 60.0)
        self.rig.set_speed(9600)
        self.require(self.rig.await_reply(0x90, 30.0) is not None, "90 within 30 s of 91")
        self.connect(baud)

    def leave(self) -> None:
        self.transact("20 25", 0xA0, 3.0, 3)
        self.transact("20 42", 0xA0, 1.0, 3)
        self.rig.set_speed(9600)


class Mrpt(Host):
    """MRPT CSickLaserSerial.cpp: ACK within 50 ms after a pause of 15 ms, replies within 500 ms."""

    def connect(self, baud: int, unit: str = "cm", variant: str = "3B B4 00 32 00") -> None:
        for rate in dict.fromkeys((baud, 9600, 38400, 500_000)):
            self.rig.set_speed(rate)
            if self._probe():
                break
        else:
            raise HostFailure("MRPT: no device at any rate it tries")
        if rate != baud:
            self._command(f"20 {RATES[baud]}")
            telegram = self._reply()
            self.require(telegram.command == 0xA0 and telegram.data == b"\x00\x10", "A0 00 with status exactly 10")
            self.rig.set_speed(baud)
            self.rig.wait(0.5)
            self.require(self._status(), "status at the new rate")
        self._block(lambda: self._configure("00 00" if unit == "cm" else "06 01"))
        self._block(lambda: self._start(variant))

    def _block(self, attempt: object) -> None:
        failure: HostFailure | None = None
        for _ in range(4):
            try:
                attempt()  # type: ignore[operator]
            except HostFailure as again:
                failure = again
            else:
                return
        assert failure is not None
        raise failure

    def _probe(self) -> bool:
        for _ in range(3):
            if self.acknowledged("20 25", 0.05, 0.015):
                break
        self.rig.wait(0.1)
        self.rig.flush_input()
        return self._status()

    def _status(self) -> bool:
        for _ in range(4):
            for _ in range(3):
                if not self.acknowledged("31", 0.05, 0.015):
                    continue
                telegram = self.rig.read_telegram(0.5)
                if telegram is not None and telegram.command == 0xB1:
                    return True
        return False

    def _command(self, text: str) -> None:
        self.require(any(self.acknowledged(text, 0.05, 0.015) for _ in range(3)), f"ACK of {text} within 65 ms")

    def _reply(self, timeout_s: float = 0.5) -> Telegram:
        telegram = self.rig.read_telegram(timeout_s)
        self.require(telegram is not None, f"a frame within {timeout_s} s")
        assert telegram is not None
        return telegram

    def _configure(self, mode_and_unit: str) -> None:
        self._command(PASSWORD)
        self.require(self._reply().data[0] == 0, "installation mode")
        self._command("74")
        self.require(self._reply().command == 0xF4, "F4")
        d, e = mode_and_unit.split()
        self._command("77 " + BLOCK.format(d=d, e=e))
        telegram = self._reply(0.6)
        self.require(telegram.command == 0xF7 and telegram.data[0] == 1, "F7 01 within 600 ms")
        self._command("20 25")
        self.require(self._reply().data[0] == 0, "A0 00")

    def _start(self, variant: str) -> None:
        self._command(variant)
        self._reply()
        self._command("20 24")
        self._reply()


class Player(Host):
    """playerproject/player sicklms200.cc: three tries; writes seven bytes of configuration, four of them as read."""

    def connect(self, rate: int = 38400, config: str = "00 01 01", variant: tuple[int, int] = (180, 50)) -> None:
        for probe in (9600, 38400, 500_000):
            self.rig.set_speed(probe)
            try:
                self.transact("20 25", 0xA0, 1.0, 3)
            except HostFailure:
                continue
            break
        else:
            raise HostFailure("Player: no device at any rate it tries")
        if probe != rate:
            self.rig.wait(1.0)
            self.transact(f"20 {RATES[rate]}", 0xA0, 5.0)
            self.rig.set_speed(rate)
            self.rig.wait(1.0)
        text = self.transact("3A", 0xBA, 2.0, 3).data
        password = b"SICK_" + text[:3]
        self.transact("20 00 " + password.hex(" "), 0xA0, 0.25, 3)
        status = self.transact("31", 0xB1, 5.0, 3).data
        wanted = variant[0].to_bytes(2, "little") + variant[1].to_bytes(2, "little")
        if status[106:110] != wanted:
            self.require(self.transact("3B " + wanted.hex(" "), 0xBB, 2.0, 3).data[0] != 0, "BB not 00")
        block = self.transact("74", 0xF4, 5.0, 3).data
        if block[4:7] != bytes.fromhex(config):
            self.transact("77 " + (block[:4] + bytes.fromhex(config)).hex(" "), 0xF7, 10.0, 3)

    def stream(self, count: int, first: int | None = None, last: int | None = None) -> list[MeasuredValues]:
        if first is None or last is None:
            self.transact("20 24", 0xA0, 2.0, 3)
            return self.scans(count, 0xB0, 2.0)
        words = first.to_bytes(2, "little") + last.to_bytes(2, "little")
        self.transact("20 27 " + words.hex(" "), 0xA0, 2.0, 3)
        return self.scans(count, 0xB7, 2.0)


class Aria(Host):
    """ArLMS2xx.cpp (classic): ACK ignored, no tries counted; a B0 in a wait makes it stop the device and repeat."""

    def connect(self, baud: int = 38400, unit: str = "01", mode: str = "01", variant: str = "3B B4 00 64 00") -> None:
        self.rig.ask(f"20 {RATES[baud]}")
        self.rig.wait(0.02)
        self.rig.set_speed(baud)
        self.rig.wait(0.3)
        self._step(variant, 0xBB, 10.0, b"\x01")
        self.rig.wait(0.2)
        self._step(PASSWORD, 0xA0, 10.0, b"\x00")
        self.rig.wait(0.2)
        self._step(f"77 00 00 46 00 00 {mode} {unit} 00 00 02 02 00" + " 00" * 20, 0xF7, 14.0, b"\x01")
        self.rig.wait(0.2)
        self._step("20 24", 0xA0, 1.0, b"\x00")

    def _step(self, text: str, reply: int, timeout_s: float, result: bytes) -> None:
        self.rig.ask(text)
        end_ns = self.rig.now_ns + round(timeout_s * 1e9)
        while (telegram := self.rig.read_telegram((end_ns - self.rig.now_ns) / 1e9)) is not None:
            if telegram.command == 0xB0:
                self.rig.ask("20 25")
                self.rig.ask(text)
            elif telegram.command == reply:
                self.require(telegram.data.startswith(result), f"{text} refused")
                return
        raise HostFailure(f"ARIA: no {reply:02X} within {timeout_s} s")

    def leave(self) -> None:
        self.rig.ask("20 25")
        self.rig.wait(1.0)
        self.rig.ask("20 42")
        self.rig.wait(0.1)


class Carmen(Host):
    """carmen laser-new sick_laser.c: 250 ms a read, ACK as first byte, requests in a row around the rate change."""

    def connect(self, baud: int = 38400, variant: str = "3B B4 00 32 00") -> None:
        self.acknowledged("20 25", 0.25)
        self.acknowledged("20 25", 0.25)
        self.rig.flush_input()
        self.rig.write(request(bytes.fromhex("20" + RATES[baud])) + request(b"\x31") + request(b"\x20\x25"))
        self.require(self._find(baud), "ACK at some rate")
        block = self._reply_to("74", 0xF4).data[:32]
        self._reply_to(PASSWORD, 0xA0)
        wanted = block[:5] + b"\x01\x00" + block[7:]
        self.require(self._reply_to("77 " + wanted.hex(" "), 0xF7).data[0] == 1, "F7 01")
        self.rig.wait(1.0)
        self._reply_to(variant, 0xBB)
        self.rig.wait(1.0)
        self._reply_to("20 25", 0xA0)

    def _find(self, baud: int) -> bool:
        for rate in (9600, 19200, 38400, 500_000):
            self.rig.set_speed(rate)
            for _ in range(8):
                if self.acknowledged("20 25", 0.25):
                    self.rig.wait(0.25)
                    return rate == baud
                self.rig.wait(0.25)
        return False

    def _reply_to(self, text: str, reply: int) -> Telegram:
        self.require(self.acknowledged(text, 0.25), f"ACK of {text} as first byte")
        telegram = self.rig.read_telegram(0.25)
        self.require(telegram is not None and telegram.command == reply, f"{reply:02X} within 250 ms")
        assert telegram is not None
        return telegram

    def stream(self, count: int, text: str = "20 24", reply: int = 0xB0) -> list[MeasuredValues]:
        self.require(self.acknowledged(text, 0.25), "ACK of the stream")
        return self.scans(count, reply, 1.0)


class RoboticsLibrary(Host):
    """roboticslibrary/rl SickLms200.cpp: ACK within 60 ms, exact lengths (32-byte block), needs 9600 at the start."""

    def connect(self, baud: int = 38400, variant: str = "3B B4 00 32 00") -> None:
        for rate in (500_000, 38400, 19200, 9600):
            self.rig.set_speed(rate)
            if self.acknowledged("20 42", 0.06):
                self._frame(0xA0, 3)
                break
        else:
            raise HostFailure("RL: no ACK at any rate")
        self.status = self._request("31", 0xB1, 154)
        self._request(f"20 {RATES[baud]}", 0xA0, 3)
        self.rig.set_speed(baud)
        self._request(PASSWORD, 0xA0, 3)
        block = self._request("74", 0xF4, 34)[:32]
        self._request("77 " + (block[:6] + b"\x01" + block[7:] + b"\xaa").hex(" "), 0xF7, 35)
        self._request("20 25", 0xA0, 3)
        self._request(variant, 0xBB, 7)

    def _request(self, text: str, reply: int, length: int) -> bytes:
        self.require(self.acknowledged(text, 0.06), f"ACK of {text} within 60 ms")
        return self._frame(reply, length)

    def _frame(self, reply: int, length: int) -> bytes:
        telegram = self.rig.await_reply(reply, 60.0)
        self.require(telegram is not None, f"{reply:02X}")
        assert telegram is not None
        self.require(1 + len(telegram.data) == length, f"{reply:02X} of exactly {length} bytes")
        self.require(telegram.data[-1] & 0xC7 == 0, "severity 0, neither implausible nor pollution")
        return telegram.data

    def poll(self, count: int) -> list[MeasuredValues]:
        found = []
        for _ in range(count):
            self.require(self.acknowledged("30 01", 0.06), "ACK of 30 01 within 60 ms")
            found += self.scans(1, 0xB0, 5.0)
        return found

    def leave(self) -> None:
        self._request("20 25", 0xA0, 3)
        self._request("20 42", 0xA0, 3)


class GearBox(Host):
    """gbxsickacfr driver.cpp: 92, severity 3 or 4 and pollution are errors; echo of the block must be equal."""

    def connect(self, baud: int = 38400) -> None:
        for rate in (baud, 9600, 19200, 38400, 500_000):
            self.rig.set_speed(rate)
            try:
                self.transact("31", 0xB1, 1.0, 2)
            except HostFailure:
                continue
            break
        else:
            raise HostFailure("GearBox: no device")
        self._checked("20 25", 0xA0)
        if rate != baud:
            self._checked(f"20 {RATES[baud]}", 0xA0)
            self.rig.set_speed(baud)
        self._checked("32", 0xB2)
        self._checked("35 00 00", 0xB5)
        self._checked("31", 0xB1)
        block = self._checked("74", 0xF4)[:-1]
        wanted = block[:2] + b"\x70" + block[3:5] + b"\x01\x01" + block[7:]
        if wanted != block:
            self._checked(PASSWORD, 0xA0)
            echo = self._checked("77 " + wanted.hex(" "), 0xF7, 15.0)
            self.require(echo[1:-1] == wanted, "F7 with the block as written")
        self._checked("3B B4 00 32 00", 0xBB)
        self._checked("20 24", 0xA0)

    def _checked(self, text: str, reply: int, timeout_s: float = 1.0) -> bytes:
        data = self.transact(text, reply, timeout_s, 2).data
        self.require(data[-1] & 7 not in (3, 4) and not data[-1] & 0x80, "no error in the status byte")
        return data


class Dgc(Host):
    """Stanford DGC driver of an S14: exact lengths, C4 stream."""

    def connect(self, baud: int = 500_000) -> None:
        for rate in (9600, 19200, 38400, 500_000):
            self.rig.set_speed(rate)
            try:
                self.transact("3A", 0xBA, 1.0)
            except HostFailure:
                continue
            break
        self.transact(f"20 {RATES[baud]}", 0xA0, 3.0)
        self.rig.set_speed(baud)
        self.transact(PASSWORD, 0xA0, 3.0)
        block = self.transact("74", 0xF4, 1.0).data[:-1]
        self.transact("77 " + block.hex(" "), 0xF7, 15.0)
        self.require(len(self.transact("31", 0xB1, 1.0).data) == 153, "B1 of exactly 154 bytes")

    def stream(self, count: int) -> list[MeasuredValues]:
        self.transact("20 50 01 00 B5 00", 0xA0, 3.0)
        return self.scans(count, 0xC4, 1.0)


class Mit(Host):
    """MIT sick.c: probing by 31 and 3A, 250 ms and four repeats, mode changes 3.5 s; needs the real-time index."""

    def connect(self, intensities: bool = False) -> None:
        for rate in (9600, 19200, 38400, 500_000):
            self.rig.set_speed(rate)
            try:
                self.transact("31", 0xB1, 0.25, 5)
                self.transact("3A", 0xBA, 0.25, 5)
            except HostFailure:
                continue
            break
        else:
            raise HostFailure("MIT: no device")
        self.require(self.transact("20 25", 0xA0, 0.25, 5).data[0] == 0, "A0 00")
        self.require(self.transact("3B 64 00 19 00", 0xBB, 0.25, 5).data[0] == 1, "BB 01")
        self.transact("74", 0xF4, 0.25, 5)
        self.require(self.transact(PASSWORD, 0xA0, 3.5, 5).data[0] == 0, "installation mode")
        mode = "0E" if intensities else "01"
        block = f"00 00 46 03 03 {mode} 00 00 00 02 42 02 00 {CONTOURS} 00 00 00 00 02 00"
        self.require(self.transact("77 " + block, 0xF7, 3.5, 5).data[0] == 1, "F7 01")
        self.require(self.transact("20 25", 0xA0, 3.5, 5).data[0] == 0, "A0 00")
        self.transact("74", 0xF4, 0.25, 5)

    def stream(self, text: str, reply: int, count: int) -> list[MeasuredValues]:
        self.require(self.transact(text, 0xA0, 0.25, 5).data[0] == 0, "A0 00")
        return self.scans(count, reply, 1.0)


class Rack(Host):
    """RACK ladar_sick_lms200: ACK within 60 ms, A0 byte for byte, mode changes of 1 to 3 s."""

    def connect(self) -> None:
        for text in ("20 25", PASSWORD, "20 40"):
            self.require(self.acknowledged(text, 0.06), f"ACK of {text} within 60 ms")
            self.require(self.rig.read(9, 3.0) == bytes.fromhex("02 80 03 00 A0 00 10 16 0A"), "A0 as printed")
        self.rig.set_speed(38400)


class Epfl(Host):
    """EPFL sicklms200.c: the ACK comes first, then the header of the reply; 32-byte writes."""

    def connect(self) -> None:
        for text, reply in (("20 25", 0xA0), (PASSWORD, 0xA0), ("77 " + BLOCK.format(d="00", e="01")[:95], 0xF7)):
            self.rig.flush_input()
            self.rig.ask(text)
            start = self.rig.read(6, 1.0)
            self.require(start[:3] == b"\x06\x02\x80" and start[5] == reply, "ACK, then the header")
            self.rig.read(int.from_bytes(start[3:5], "little") + 1, 1.0)


class Manorajesh(Host):
    """manorajesh/sick-lidar lms200.py, used with a real LMS200: ACK 300 ms, A0 3.5 s, F7 10 s with an equal echo."""

    def connect(self) -> None:
        for rate in (9600, 38400, 19200):
            self.rig.set_speed(rate)
            if self.acknowledged("20 25", 0.3) and self.rig.await_reply(0xA0, 3.5):
                break
        else:
            raise HostFailure("manorajesh: no device")
        self.transact("20 40", 0xA0, 3.5)
        self.rig.set_speed(38400)
        self.type_text = self.transact("3A", 0xBA, 1.0).data[:-1]
        block = self.transact("74", 0xF4, 1.0).data[:-1]
        wanted = block[:5] + b"\x0f\x01" + block[7:]
        self.transact(PASSWORD, 0xA0, 3.5)
        echo = self.transact("77 " + wanted.hex(" "), 0xF7, 10.0).data
        self.require(echo[:-1] == b"\x01" + wanted, "F7 with the block as written")
        self.transact("20 25", 0xA0, 3.5)
        self.transact("3B B4 00 64 00", 0xBB, 3.5)


class Orca(Host):
    """Orca / old CARMEN sick.c: probes with 30 05 B4, ACK as first byte within 6 ms, any reply of plausible length."""

    def probe(self) -> int:
        self.require(self.acknowledged("30 05 B4", 0.006), "ACK within 6 ms")
        telegram = self.rig.read_telegram(2.0)
        self.require(telegram is not None, "a reply")
        assert telegram is not None
        return telegram.command
