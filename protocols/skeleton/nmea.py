"""Sentences of a satellite receiver that a device hears.

Belongs here: their text. Not: when they come, and what a device makes of them (families).
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from protocols.checksums import xor8


def gprmc(utc_ns: int, latitude_deg: float, longitude_deg: float, valid: bool = True) -> bytes:
    """A $GPRMC sentence with CR LF for a time since 1970, of a receiver at rest."""
    when = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=utc_ns // 1000)
    places = []
    for degrees, width, signs in ((latitude_deg, 2, "NS"), (longitude_deg, 3, "EW")):
        minutes = round(abs(degrees) * 60.0 * 1e4)
        places.append(f"{minutes // 600_000:0{width}d}{minutes % 600_000 / 1e4:07.4f},{signs[degrees < 0.0]}")
    state = "A" if valid else "V"
    text = f"GPRMC,{when:%H%M%S}.00,{state},{','.join(places)},0.000,0.0,{when:%d%m%y},0.0,E,{'A' if valid else 'N'}"
    return f"${text}*{xor8(text.encode()):02X}\r\n".encode()
