"""Access to a CoLa device: user levels, and the login by challenge.

Belongs here: arithmetic on passwords. Not: which level a command needs (commands).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

LEVELS = ("Run", "Operator", "Maintenance", "AuthorizedClient", "Service")
"By number; the names are those that the login by challenge hashes."
RUN, OPERATOR, MAINTENANCE, AUTHORISED, SERVICE = range(5)

PASSWORDS: Mapping[int, str] = {MAINTENANCE: "main", AUTHORISED: "client", SERVICE: "servicelevel"}
"As delivered (drivers' sources, hashes recomputed)."


def long_hash(level: int, password: str, salt: bytes = b"") -> bytes:
    """SHA-256 that a device with the login by challenge keeps; `salt` of version 2, empty in version 1."""
    text = f"{LEVELS[level]}:SICK Sensor:{password}".encode("latin-1")
    return hashlib.sha256(text + (b":" + salt if salt else b"")).digest()


def response(kept: bytes, challenge: bytes) -> bytes:
    """What a host must answer a challenge with."""
    return hashlib.sha256(kept + challenge).digest()


def challenge_of(serial: str, number: int, now_ns: int) -> bytes:
    """Sixteen bytes that come once: devices draw them, this one derives them so that runs are repeatable."""
    return hashlib.sha256(f"{serial}:{number}:{now_ns}".encode()).digest()[:16]
