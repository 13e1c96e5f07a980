"""Whether the sweeps of one sensor of a fed world are measured in slices of time, and when each slice is begun.

Belongs here: the choice, from what measuring took lately. Not: the estimate itself (lead), what is asked for when
(feeding).

A sweep that is measured whole makes all its beams wait for one beginning, of which the last ones are extrapolated the
farthest. In slices each part of the beams has a beginning of its own, near its instants; but bodies and faces near
beams are found for each slice, so that together they take longer. They are worth it where beams wait much less and one
process has the time.
"""

from __future__ import annotations

import numpy as np

from emulator.measuring.parts import slice_of
from emulator.physics.arrays import Floats, Ints
from emulator.runtime.lead import MARGIN_NS, QUICK, Lead
from protocols.scan import ScanPlan

SLICES = 2
"With four the shortest slice would take 0.45 of the sweep: more than a process has time for where slices help."
SHARE = 0.68
"""Of the processor time of a whole sweep that one of two slices of an LMS291 takes in `street`: 0.64 to 0.69. Where it
is more, slices are left again."""
BUSY, MOST_BUSY = 0.82, 0.9
"Share of the scan time that all slices together may take: to begin with slices, and to stay with them."
GAIN_NS = 500_000
"Beams wait less by that in the mean, and by `LESS`, or slices are not begun with."
LESS = 0.8
KNOWN_AFTER = 20
"Sweeps after which it is known what they take."
FIRST_REST, LONGEST_REST = 40, 10_240
"Sweeps measured whole after slices took too long, until they are tried again; twice as many each time, up to so many."
HELD = 200
"Sweeps in slices after which the next rest is the first one again: the machine was held up for a while."


class Slicing:
    """Of one sensor."""

    def __init__(self) -> None:
        self.lead = Lead()
        "Of whole sweeps, or of the last slice of each: as they are measured now."
        self.in_slices = 0
        "Sweeps that have come in slices."
        self.of = 1
        "Slices, as they are measured now."
        self._mean_ns = 0.0
        "What they take; unlike that of the lead, a machine that is held up moves it at once."
        self._sweeps = 0
        "Measured as they are now."
        self._until, self._rest = KNOWN_AFTER, FIRST_REST
        self._cut: tuple[Floats, list[Ints], list[int]] | None = None

    def add(self, took_ns: float, of: int) -> None:
        """A sweep has come so long after it, or the last of its slices, was to be asked for."""
        self.in_slices += of > 1
        if of != self.of:  # it was asked for before the change
            return
        self.lead.add(took_ns)
        self._mean_ns += QUICK * (took_ns - self._mean_ns)
        self._sweeps += 1

    def beams(self, plan: ScanPlan, number: int) -> Ints:
        """Indexes of the beams of one slice."""
        return self._cut_of(plan)[0][number]

    def last_ns(self, plan: ScanPlan, number: int) -> int:
        """When the last beam of one slice fires."""
        return plan.start_ns + self._cut_of(plan)[1][number]

    def _cut_of(self, plan: ScanPlan) -> tuple[list[Ints], list[int]]:
        if self._cut is None or self._cut[0] is not plan.fire_offset_s:
            beams = [slice_of(plan, number, SLICES) for number in range(SLICES)]
            last_ns = [round(1e9 * float(plan.fire_offset_s[at].max())) for at in beams]
            self._cut = plan.fire_offset_s, beams, last_ns
        return self._cut[1:]

    def before_end_ns(self, number: int, of: int) -> int:
        """So long before the sweep can be sent that slice is begun: the ones behind it take as long as it, on average.

        Where an earlier one takes longer, the last one waits for it, and that is part of what the last one took.
        """
        return self.lead.ns + round((of - 1 - number) * self.lead.mean_ns)

    def choose(self, plan: ScanPlan, may: bool) -> int:
        """In how many slices that sweep is measured. `may`: it can be."""
        if self.of == 1:
            if may and self._sweeps >= self._until and self._is_worth_it(plan):
                self._change(SLICES, SHARE)
        elif not may or self.of * self._mean_ns > MOST_BUSY * 1e9 * plan.duration_s:
            self._rest = FIRST_REST if self._sweeps >= HELD else min(2 * self._rest, LONGEST_REST)
            self._until = self._rest
            self._change(1, 1.0 / SHARE)
        return self.of

    def _is_worth_it(self, plan: ScanPlan) -> bool:
        ends_ns = 1e9 * (plan.duration_s - plan.fire_offset_s)
        whole_ns, slice_ns = float(self.lead.ns), SHARE * self.lead.mean_ns
        if SLICES * slice_ns > BUSY * 1e9 * plan.duration_s:
            return False
        last_ns = MARGIN_NS + SHARE * (whole_ns - MARGIN_NS)
        waits, less = float(np.maximum(0.0, whole_ns - ends_ns).mean()), 0.0
        for number in range(SLICES):
            begin_ns = last_ns + (SLICES - 1 - number) * slice_ns
            less += float(np.maximum(0.0, begin_ns - ends_ns[self.beams(plan, number)]).sum())
        less /= len(plan)
        return less < LESS * waits and less < waits - GAIN_NS

    def _change(self, of: int, share: float) -> None:
        self.of, self._sweeps = of, 0
        self.lead = self.lead.times(share)
        self._mean_ns = self.lead.mean_ns
