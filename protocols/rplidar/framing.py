"""Replies of RPLIDARs changed on their way: wrong sums, another type, requests that no device knows.

Belongs here: places in a group. Not: those in a reply (the skeleton's), when something is changed.
"""

from __future__ import annotations

from protocols.session import Emission
from protocols.skeleton.descriptors import DescriptorFraming

CAPSULES, HQ_LABEL = ("82", "84", "85", "86"), "83"


class RplidarFraming(DescriptorFraming):
    """A descriptor with data, or groups of samples."""

    def bad_check(self, one: Emission) -> bytes | None:
        """Of a capsule its sum, of an HQ block its CRC; nodes and replies have none."""
        if one.sweep is None and one.scans:
            return None
        if one.label == HQ_LABEL:
            return one.payload[:-1] + bytes((one.payload[-1] ^ 0x01,))
        return bytes((one.payload[0] ^ 0x01,)) + one.payload[1:] if one.label in CAPSULES else None
