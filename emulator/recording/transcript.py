"""One number for a run: SHA-256 of all wire bytes with their virtual send times.

Each sensor has a digest of its own, so that it does not matter in which order sensors were served.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence

from emulator.instrument.observer import Observer, Payload


class Transcript(Observer):
    """Digest of what went over the links."""

    def __init__(self, sensors: Sequence[str]) -> None:
        self._digests = {sensor: hashlib.sha256(sensor.encode()) for sensor in sensors}
        self.payloads = 0
        self.bytes = 0

    def payload(self, payload: Payload) -> None:
        self.payloads += 1
        self.bytes += len(payload.data)
        head = struct.pack(
            "<?qqqqq", payload.sent, payload.link, payload.peer, payload.start_ns, payload.end_ns, len(payload.data)
        )
        self._digests[payload.sensor].update(head + payload.data)

    def sha256(self) -> str:
        """Of everything so far, as hexadecimal digits."""
        return hashlib.sha256(b"".join(digest.digest() for digest in self._digests.values())).hexdigest()
