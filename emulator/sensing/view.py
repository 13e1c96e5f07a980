"""Everything that comes back in one sweep, before the receiver.

Belongs here: the record that the steps before the receiver fill and those behind it read. Not: the steps (measure).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from emulator.physics.subechoes import Kept, SubEchoes
from emulator.sensing.air import AirNow
from emulator.sensing.bright import Tails
from emulator.sensing.paths import Seen, Surfaces
from emulator.sensing.rays import Rays


@dataclass(frozen=True, eq=False)
class View:
    """One sweep before the receiver: for the receiver, and for studies of accuracy."""

    rays: Rays
    seen: Seen
    "Surfaces alone."
    found: SubEchoes
    "Surfaces, particles and uneven media. See `kept`."
    air: AirNow
    surfaces: Surfaces
    cast: int
    "First rays cast: those of all bundles, where none was saved."
    plain: NDArray[np.bool_] | None = None
    "(n,) beams of which one plane is seen, or nothing, and that had no bundle; None: not asked for."
    kept: Kept | None = None
    "Sub-echoes of beams that have what they had before; `found` holds those of the others alone."
    tails: Tails | None = None
    "Beams near bright edges; None: nothing is so bright."

    @cached_property
    def echoes(self) -> SubEchoes:
        """Those of all beams."""
        return self.found if self.kept is None else self.kept.whole(self.found)
