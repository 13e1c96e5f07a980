"""Replies of SCIP changed on their way: a wrong sum, another status, the count of scans to come; sums made right again.

Belongs here: places in a reply. Not: when something is changed.
"""

from __future__ import annotations

from protocols.framing import Framing
from protocols.scip.codec import encode_number, line_sum, summed
from protocols.session import Emission

UNKNOWN = b"\x01\x02"
"A command that no device knows."


class ScipFraming(Framing):
    """One reply per emission: echo, status, lines, an empty line."""

    def bad_check(self, one: Emission) -> bytes | None:
        """The last line with a sum has another one."""
        lines = one.payload.split(b"\n")
        if len(lines) < 4 or len(lines[-3]) < 2:
            return None
        last = lines[-3]
        lines[-3] = last[:-1] + bytes(((last[-1] - 0x30 ^ 1) + 0x30,))
        return b"\n".join(lines)

    def with_type(self, one: Emission, code: int) -> bytes | None:
        """Another status, as two hexadecimal digits."""
        echo, mark, rest = one.payload.partition(b"\n")
        _, status_mark, lines = rest.partition(b"\n")
        return echo + mark + summed(b"%02X" % (code & 0xFF)) + lines if status_mark else None

    def with_counter(self, one: Emission, change: int) -> bytes | None:
        """The time stamp of a scan, in ms."""
        lines = one.payload.split(b"\n")
        if one.reported is None or len(lines) < 4 or len(lines[2]) != 5:
            return None
        stamp = encode_number(one.reported.ticks + change, 4)
        lines[2] = stamp + line_sum(stamp)
        return b"\n".join(lines)

    def stale(self, old: Emission, fresh: Emission) -> bytes | None:
        if old.reported is None or fresh.reported is None or old.payload[:10] != fresh.payload[:10]:
            return None
        was, now = old.payload.split(b"\n"), fresh.payload.split(b"\n")
        return b"\n".join([*now[:3], *was[3:]])

    def to_be_refused(self, data: bytes) -> bytes | None:
        return UNKNOWN + data[2:]

    def is_whole(self, data: bytes) -> bool:
        return data.endswith((b"\n", b"\r"))
