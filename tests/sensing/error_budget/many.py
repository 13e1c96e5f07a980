"""Full against pruned over random scenes: python -m tests.sensing.error_budget.many [SCENES]. Prints; never fails."""

from __future__ import annotations

import sys

from tests.sensing.error_budget.scenes import MODELS, Tally, full_against_pruned


def main() -> None:
    """Compare, and print a line for each model and one for all."""
    scenes = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    totals = {model: Tally() for model in MODELS}
    worst: list[tuple[int, int]] = []
    for seed in range(scenes):
        found = full_against_pruned(seed)
        totals[MODELS[seed % 3]] += found
        if found.differ:
            worst.append((found.differ, seed))
    for name, one in (*totals.items(), ("all", sum(totals.values(), Tally()))):
        sys.stdout.write(
            f"{name:16s} {one.beams:7d} beams, {one.differ:4d} differ ({one.share:.2%}); "
            f"{one.plain:6d} plain, {one.plain_differ} of them differ\n"
        )
    reported = ", ".join(f"{seed} ({count})" for count, seed in sorted(worst, reverse=True)[:10])
    sys.stdout.write(f"scenes with most differing beams: {reported or 'none'}\n")


if __name__ == "__main__":
    main()
