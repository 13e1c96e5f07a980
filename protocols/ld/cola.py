"""CoLa binary, by which SOPAS sets up LD-LRS devices: frames, login, and who the device is.

The supplement (SICK 9106698, p. 18-21) has SOPAS speak it at 115 200 baud and on 192.168.1.10, and log in as authorised
client with the password `client`. It prints no port and no variable: frames are taken on every serial and TCP link
beside the user protocol, and whatever is not listed here is answered by CoLa's own error words. Frame, login and error
words are those of SICK's public telegram listings of later scanners. [I]
"""

from __future__ import annotations

from collections.abc import Callable

from protocols.checksums import xor8
from protocols.ld import usp
from protocols.skeleton.cola_frames import HEAD_BYTES, START, UNKNOWN, refused
from protocols.skeleton.cola_values import BINARY, Code, Rejected, decode, encode, short_hash

MAX_BYTES = 4096
PASSWORD = "client"
"Of the authorised client, level 3."
AUTHORISED_CLIENT = 3


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
                if len(self._held) < HEAD_BYTES:
                    break
                size = int.from_bytes(self._held[4:HEAD_BYTES], "big")
                self._passing = size + usp.OVERHEAD if size <= usp.MAX_REQUEST_BYTES else len(usp.HEADER)
                continue
            at = self._held.find(START[:1])
            if at:
                cut = len(self._held) if at < 0 else at
                others, self._held = others + self._held[:cut], self._held[cut:]
                continue
            if not self._held.startswith(START[: len(self._held)]):
                others, self._held = others + self._held[:1], self._held[1:]
                continue
            if len(self._held) < HEAD_BYTES:
                break
            end = HEAD_BYTES + int.from_bytes(self._held[4:HEAD_BYTES], "big")
            if end - HEAD_BYTES <= MAX_BYTES and len(self._held) <= end:
                break
            payload = self._held[HEAD_BYTES:end]
            if end - HEAD_BYTES > MAX_BYTES or xor8(payload) != self._held[end]:
                others, self._held = others + self._held[:1], self._held[1:]
                continue
            found.append(payload)
            self._held = self._held[end + 1 :]
        return others, found

    def expire(self) -> bytes:
        """Give up what is held: it is for others."""
        held, self._held, self._passing = self._held, b"", 0
        return held


def answer(payload: bytes, identity: Callable[[str], str]) -> tuple[bytes, bool]:
    """The reply to a telegram, and whether it was understood; `identity` gives the device's texts by name."""
    kind, _, rest = payload.partition(b" ")
    name, _, data = rest.partition(b" ")
    if kind == b"sRN" and name == b"DeviceIdent":
        who = [identity("sensor_name"), identity("firmware_version")]
        return b"sRA DeviceIdent " + encode("str str", BINARY, who), True
    if kind == b"sMN" and name == b"SetAccessMode":
        try:
            right = decode("u8 u32", BINARY, data) == [AUTHORISED_CLIENT, short_hash(PASSWORD)]
        except Rejected:
            return refused(BINARY, Code.INVALID_DATA), False
        return b"sAN SetAccessMode " + bytes((right,)), right
    if kind == b"sMN" and name == b"Run":
        return b"sAN Run \x01", True
    return refused(BINARY, UNKNOWN.get(kind, Code.COMMAND_UNKNOWN)), False
