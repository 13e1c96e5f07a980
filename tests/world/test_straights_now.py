"""All straight motions of a sweep, found at once, are those found one by one by somebody who knows this sweep alone."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from emulator.live.book import Book, Rules
from emulator.live.json_lines import update_of
from emulator.world.fed import Box, Fed, FedNow
from emulator.world.fed_straight import StraightsNow
from emulator.world.motion import Steady

STEP_S = 0.01
MOVES = ("even", "even", "rests", "turns", "jumps", "absent", "removed", "grows")
NAMES = ("ego", "car", "van", "guest")
REFERENCES = ("origin", "box_centre", "rear_axle", "ground")
BOX = Box((0.3, -0.1, 0.8), (2.0, 0.9, 0.7))
Step = tuple[tuple[str, ...], bool]
STEPS = st.lists(st.tuples(st.tuples(*(st.sampled_from(MOVES) for _ in NAMES)), st.booleans()), min_size=1, max_size=12)
"What each actor does, and whether there is a sweep then."
SWEEPS = (True, *[False] * 5, True)
BETWEEN_SWEEPS: list[list[Step]] = [
    [((move,) * len(NAMES), sweep) for move, sweep in zip(moves, SWEEPS, strict=True)]
    for moves in (
        ("absent", "even", "removed", *["absent"] * 4),
        ("even", "grows", *["even"] * 5),
        ("even", "turns", *["even"] * 5),
    )
]
"They come and go, become others, turn."


def motions_of(now: FedNow) -> list[Fed]:
    """Of actors of the file, with a mount on one of them; of both shapes that the guest may have."""
    even, turning = Steady((7.0, 0.0, 0.0), 20.0, velocity_m_s=(1.0, 0.0, 0.0)), Steady(yaw_rate_deg_s=3.0)
    return [
        Fed(now, "ego", even, None),
        Fed(now, "ego", even, BOX, mount="rear_axle"),
        Fed(now, "car", even, BOX),
        Fed(now, "van", turning, BOX),
        Fed(now, "live_000", None, BOX, shape="truck"),
        Fed(now, "live_000", None, BOX, shape="box"),
    ]


@settings(max_examples=100, deadline=None)
@given(STEPS, st.permutations(REFERENCES), st.sampled_from(("hold", "remove")))
@example(BETWEEN_SWEEPS[0], list(REFERENCES), "hold")
@example(BETWEEN_SWEEPS[1], list(REFERENCES), "hold")
@example(BETWEEN_SWEEPS[2], list(REFERENCES), "hold")
def test_all_at_once_are_what_each_is_alone(steps: list[Step], references: list[str], silent_then: str) -> None:
    """Whatever has been kept of the sweeps before: actors come, go, grow, turn, jump and fall silent."""
    book = Book(
        Rules(silent_after_s=2.5 * STEP_S, silent_then=silent_then),
        names=NAMES[:3],
        slots=("live_000",),
        shape_of=lambda one: "truck" if one.size_m is not None and one.size_m[0] > 4.0 else "box",
    )
    now = FedNow()
    kept = StraightsNow(motions_of(now))
    x_m, yaw_deg, length_m = dict.fromkeys(NAMES, 0.0), dict.fromkeys(NAMES, 30.0), dict.fromkeys(NAMES, 4.0)
    for k, (moves, sweeps) in enumerate(steps):
        actors: list[dict[str, object]] = []
        for name, reference, move in zip(NAMES, references, moves, strict=True):
            x_m[name] += {"even": 9.0 * STEP_S, "jumps": 50.0}.get(move, 0.0)
            yaw_deg[name] += 0.5 * (move == "turns")
            length_m[name] += 0.5 * (move == "grows")
            velocity = [9.0 if move == "even" else 0.0, 0.0, 0.0]
            sample = {"id": name, "at_m": [x_m[name], 0.0, 0.0], "yaw_deg": yaw_deg[name], "velocity_m_s": velocity}
            if move not in ("absent", "removed"):
                actors.append({**sample, "reference": reference, "size_m": [length_m[name], 1.8, 1.5]})
        removed = [name for name, move in zip(NAMES, moves, strict=True) if move == "removed"]
        book.take(update_of({"actors": actors, "removed": removed}), round(k * STEP_S * 1e9))
        if not sweeps:
            continue
        world = book.world((k - 1.3) * STEP_S, k * STEP_S)
        now.use(world)
        alone = FedNow()
        alone.use(world)
        wanted = {row: one.straight for row, one in enumerate(motions_of(alone)) if one.straight is not None}
        found = kept.found
        assert sorted(found.rows.tolist()) == sorted(wanted)
        for place, row in enumerate(found.rows.tolist()):
            for word in ("at_m", "velocity_m_s", "rotation", "since_s", "from_s", "until_s"):
                assert np.array_equal(getattr(found, word)[place], getattr(wanted[row], word)), (k, row, word)
