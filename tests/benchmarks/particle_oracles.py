"""All cases of drops and flakes of the outside computations, theirs beside ours; prints, fails nothing.

    python -m tests.benchmarks.particle_oracles [KIND] [SWEEPS]

KIND: of the cases, as particles_sum; without it all. SWEEPS: of 360 beams each (22). Sigma is the statistical error of
both; `off` is the difference in sigma. Single particles (particles_alone) are integrals: no statistical error.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

from tests.sensing import particle_cases as cases
from tests.sensing.particle_cases import Case, Row

KINDS: dict[str, Callable[[Case, int], list[Row]]] = {
    "particles_alone": lambda case, _: cases.alone(case),
    "particles_sum": cases.summed,
    "particles_noise": lambda case, sweeps: cases.lifted(case, sweeps, 3000),
    "pair": lambda case, sweeps: [*cases.neighbours(case, sweeps), *cases.both_answer(case, sweeps)],
    "time": lambda case, sweeps: [
        row for late_s in case["expected"]["correlation_after_s"] for row in cases.later(case, late_s, 2 * sweeps)
    ],
    "time_detection": cases.both_answer,
    "transmission_cone": cases.shadows,
}


def main(kinds: list[str], sweeps: int) -> None:
    """Print a line for each number of each case."""
    sys.stdout.write("| case | number | oracle | ours | sigma | off |\n|---|---|---|---|---|---|\n")
    for case in cases.CASES:
        if case["kind"] not in kinds:
            continue
        for row in KINDS[case["kind"]](case, sweeps):
            off = (row.ours - row.oracle) / row.sigma if row.sigma > 0.0 else math.nan
            figures = f"{row.oracle:.5g} | {row.ours:.5g} | {row.sigma:.2g} | {off:+.1f}"
            sys.stdout.write(f"| {case['name']} | {row.what} | {figures} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    asked = [one for one in sys.argv[1:] if not one.isdecimal()]
    main(asked or list(KINDS), next((int(one) for one in sys.argv[1:] if one.isdecimal()), 22))
