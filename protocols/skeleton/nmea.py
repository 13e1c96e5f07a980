"""Sentences of a satellite receiver that a device hears.

Belongs here: their text. Not: when they come, and what a device makes of them (families).
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from functools import lru_cache

from protocols.checksums import xor8


@lru_cache(maxsize=4)
def gprmc(utc_ns: int, latitude_deg: float, longitude_deg: float, valid: bool = True) -> bytes:
    """A $GPRMC sentence with CR LF for a time since 1970, of a receiver at rest."""
    when, state = _moment(utc_ns), "A" if valid else "V"
    place = _place(latitude_deg, longitude_deg)
    return _sentence(f"GPRMC,{when:%H%M%S}.00,{state},{place},0.000,0.0,{when:%d%m%y},0.0,E,{'A' if valid else 'N'}")


@lru_cache(maxsize=4)
def gpgga(utc_ns: int, latitude_deg: float, longitude_deg: float, valid: bool = True) -> bytes:
    """A $GPGGA sentence with CR LF likewise, of a receiver 10 m above the sea that hears eight satellites."""
    place = _place(latitude_deg, longitude_deg)
    return _sentence(f"GPGGA,{_moment(utc_ns):%H%M%S}.00,{place},{'1,08' if valid else '0,00'},1.0,10.0,M,0.0,M,,")


def _moment(utc_ns: int) -> datetime:
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=utc_ns // 1000)


def _place(latitude_deg: float, longitude_deg: float) -> str:
    places = []
    for degrees, width, signs in ((latitude_deg, 2, "NS"), (longitude_deg, 3, "EW")):
        minutes = round(abs(degrees) * 60.0 * 1e4)
        places.append(f"{minutes // 600_000:0{width}d}{minutes % 600_000 / 1e4:07.4f},{signs[degrees < 0.0]}")
    return ",".join(places)


def _sentence(text: str) -> bytes:
    return f"${text}*{xor8(text.encode()):02X}\r\n".encode()
