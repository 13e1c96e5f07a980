"""CoLa binary, by which SOPAS sets up LD-LRS devices: frames, login, and who the device is.

The supplement (SICK 9106698, p. 18-21) has SOPAS speak it at 115 200 baud and on 192.168.1.10, and log in as authorised
client with the password `client`. It prints no port and no variable: frames are taken on every serial and TCP link
beside the user protocol, and whatever is not listed here is answered by CoLa's own error words. Frame, login and error
words are those of SICK's public telegram listings of later scanners. [I]
"""

from __future__ import annotations

from collections.abc import Callable

from protocols.ld import usp

STX = b"\x02\x02\x02\x02"
HEADER_BYTES = 8
MAX_BYTES = 4096

AUTHORISED_CLIENT = 3
CLIENT = bytes.fromhex("F4724744")
"What `client` becomes on the wire."

ACCESS_DENIED, UNKNOWN_METHOD, UNKNOWN_VARIABLE, INVALID_DATA, UNKNOWN_COMMAND = 1, 2, 3, 5, 13


def xor_of(payload: bytes) -> int:
    """Checksum of a frame: XOR of its payload."""
    value = 0
    for byte in payload:
        value ^= byte
    return value


def encode_frame(payload: bytes) -> bytes:
    """A telegram with four STX, length and checksum."""
    return STX + len(payload).to_bytes(4, "big") + payload + bytes((xor_of(payload),))


class ColaSplitter:
    """Takes CoLa frames out of a stream; all other bytes go on. Holds at most one frame.

    Within a frame of the user protocol nothing is looked for: it may hold STX, and end with it.
    """

    def __init__(self) -> None:
        self._held = b""
        self._passing = 0
        "Bytes to come of a frame of the user protocol."

    def __bool__(self) -> bool:
        """Whether something is held."""
        return bool(self._held) or self._passing > 0

    def feed(self, data: bytes) -> tuple[bytes, list[bytes]]:
        """Bytes for others, and payloads of whole frames with a right checksum."""
        self._held += data
        others, found = b"", []
        while self._held:
            if self._passing:
                others, gone = others + self._held[: self._passing], len(self._held[: self._passing])
                self._held, self._passing = self._held[gone:], self._passing - gone
                continue
            if usp.HEADER.startswith(self._held[:4]) and len(self._held) > 1:
                if len(self._held) < HEADER_BYTES:
                    break
                size = int.from_bytes(self._held[4:HEADER_BYTES], "big")
                self._passing = size + usp.OVERHEAD if size <= usp.MAX_REQUEST_BYTES else len(usp.HEADER)
                continue
            at = self._held.find(STX[:1])
            if at:
                cut = len(self._held) if at < 0 else at
                others, self._held = others + self._held[:cut], self._held[cut:]
                continue
            if not self._held.startswith(STX[: len(self._held)]):
                others, self._held = others + self._held[:1], self._held[1:]
                continue
            if len(self._held) < HEADER_BYTES:
                break
            end = HEADER_BYTES + int.from_bytes(self._held[4:HEADER_BYTES], "big")
            if end - HEADER_BYTES <= MAX_BYTES and len(self._held) <= end:
                break
            payload = self._held[HEADER_BYTES:end]
            if end - HEADER_BYTES > MAX_BYTES or xor_of(payload) != self._held[end]:
                others, self._held = others + self._held[:1], self._held[1:]
                continue
            found.append(payload)
            self._held = self._held[end + 1 :]
        return others, found

    def expire(self) -> bytes:
        """Give up what is held: it is for others."""
        held, self._held, self._passing = self._held, b"", 0
        return held


def _text(value: str) -> bytes:
    return len(value).to_bytes(2, "big") + value.encode("ascii")


def answer(payload: bytes, identity: Callable[[str], str]) -> tuple[bytes, bool]:
    """The reply to a telegram, and whether it was understood; `identity` gives the device's texts by name."""
    kind, _, rest = payload.partition(b" ")
    name, _, data = rest.partition(b" ")
    if kind == b"sRN" and name == b"DeviceIdent":
        reported = _text(identity("sensor_name")) + _text(identity("firmware_version"))
        return b"sRA DeviceIdent " + reported, True
    if kind == b"sMN" and name == b"SetAccessMode":
        if len(data) != 1 + len(CLIENT):
            return _error(INVALID_DATA), False
        right = data[0] == AUTHORISED_CLIENT and data[1:] == CLIENT
        return b"sAN SetAccessMode " + bytes((right,)), right
    if kind == b"sMN" and name == b"Run":
        return b"sAN Run \x01", True
    codes = {b"sRN": UNKNOWN_VARIABLE, b"sWN": UNKNOWN_VARIABLE, b"sEN": UNKNOWN_VARIABLE, b"sMN": UNKNOWN_METHOD}
    return _error(codes.get(kind, UNKNOWN_COMMAND)), False


def _error(code: int) -> bytes:
    return b"sFA" + code.to_bytes(2, "big")
