"""How long before it must be sent a sweep of a fed world is asked for: what measuring took lately, and how evenly.

Belongs here: the estimate of one sensor. Not: when what is asked for (feeding).

A quick mean says what the next sweep takes; beside it stands room for `SPREADS` times what sweeps were off that mean,
or for the most that one was over it lately. So a machine that measures evenly begins late, and one that does not begins
early enough: a constant share of the longest is too much for the first and too little for the second.
"""

from __future__ import annotations

import math

MARGIN_NS = 1_000_000
"Beside what measuring takes: what the sender needs for the telegram of a scan that has come."
FIRST_NS = 60_000_000
"What measuring is taken to take before it is known."
FIRST_SPREAD = 0.1
"Of the first sweep; that of others is not known yet."
QUICK, SLOW = 1.0 / 8.0, 1.0 / 64.0
"Share of the newest sweep in the mean, and in the mean square of what is off it."
SPREADS = 3.5
"Root mean squares over the mean. Of 6000 sweeps none is late whose times are spread by 2 to 8 %, 6 of 15 %."
MOST_SPREADS = 4.0
"Root mean squares: what is off by more moves the mean and the square by as much alone, so that a stall is forgotten."
FORGET = 0.98
"Of the most over the mean after each sweep: half of a stall is forgotten after 34."


class Lead:
    """Of one sensor."""

    def __init__(self) -> None:
        self._mean_ns: float | None = None
        self._square = 0.0
        self._most_ns = 0.0
        "Over the mean, lately."
        self._first_ns: float | None = None
        "The first one, which fills tables, until it is known whether the next one takes as long."

    def add(self, took_ns: float) -> None:
        """One sweep has been measured, so long after it was to be asked for."""
        first_ns, self._first_ns = self._first_ns, took_ns if self._mean_ns is None else None
        if self._mean_ns is None or (first_ns is not None and took_ns < first_ns / 2.0):
            self._mean_ns, self._square = took_ns, (FIRST_SPREAD * took_ns) ** 2
            self._most_ns = 0.0 if first_ns is None else FORGET * (first_ns - took_ns)
            return
        off_ns = took_ns - self._mean_ns
        room_ns = MOST_SPREADS * math.sqrt(self._square)
        near_ns = max(-room_ns, min(room_ns, off_ns))
        self._mean_ns += QUICK * near_ns
        self._square += SLOW * (near_ns * near_ns - self._square)
        self._most_ns = max(off_ns, FORGET * self._most_ns)

    @property
    def mean_ns(self) -> float:
        """What one takes; 0: not known."""
        return 0.0 if self._mean_ns is None else self._mean_ns

    def times(self, share: float) -> Lead:
        """The same of what is taken to take such a share of it: with room as of a first one, until it is known."""
        found = Lead()
        if self._mean_ns is not None:
            found._mean_ns, found._square = share * self._mean_ns, share * share * self._square
            found._most_ns = share * max(self._most_ns, SPREADS * FIRST_SPREAD * self._mean_ns)
        return found

    @property
    def ns(self) -> int:
        """So long before it must be sent the next one is asked for."""
        if self._mean_ns is None:
            return FIRST_NS + MARGIN_NS
        return MARGIN_NS + round(self._mean_ns + max(SPREADS * math.sqrt(self._square), self._most_ns))
