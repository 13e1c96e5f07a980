"""Whatever well-formed arguments a host writes: one answer to each request, and every scan can be read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from protocols.cola.commands import EVENTS, METHODS, VARIABLES
from protocols.cola.models import MODELS
from protocols.skeleton.cola_values import INTEGERS, encode, layout
from tests.protocols.cola.reader import ask_b, frames, read
from tests.protocols.cola.rig import MS, ONE, SECOND, TWO, Rig, scan_of

EDGES = (0, 1, 2, 3, 5, 1667, 2500, 5000, 900_000, -450_000)
"""Numbers that mean something to some variable, beside the ends of each type."""


def pick(rng: np.random.Generator, from_: Sequence[Any]) -> Any:
    return from_[int(rng.integers(len(from_)))]


def drawn(rng: np.random.Generator, nodes: tuple[Any, ...]) -> list[Any]:
    """Values of a layout."""
    values: list[Any] = []
    for node in nodes:
        if isinstance(node, tuple):
            values.append([drawn(rng, node) for _ in range(pick(rng, (0, 1, 1, 1, 2, 4)))])
        elif node == "f32":
            values.append(pick(rng, (0.0, 1.0, 2.0, -1.5, 3.1, 1e-3, 1e30)))
        elif node == "*":
            values.append(rng.bytes(pick(rng, (0, 1, 32, 33))))
        elif node == "str":
            values.append(pick(rng, ("", "a", "abc d")))
        elif node in INTEGERS:
            bits = 8 * INTEGERS[node]
            low, high = (0, (1 << bits) - 1) if node[0] == "u" else (-(1 << bits - 1), (1 << bits - 1) - 1)
            values.append(min(max(pick(rng, (low, high, int(rng.integers(low, high + 1)), *EDGES)), low), high))
        else:
            values.append("FEVL"[: int(node[1:])])
    return values


def request(rng: np.random.Generator, rig: Rig) -> tuple[str, bytes]:
    """Type and name, and arguments in CoLa-B."""
    kind = pick(rng, ("sRN", "sWN", "sWN", "sWN", "sMN", "sEN"))
    if kind == "sEN":
        return f"sEN {pick(rng, sorted(EVENTS))}", pick(rng, (b"\0", b"\1"))
    if kind == "sMN":
        name = pick(rng, sorted(set(METHODS) - {"mSCreboot"}))
        text = METHODS[name].arguments
    else:
        name = pick(rng, list(VARIABLES)[:45])
        text = VARIABLES[name].layout_of(rig.session.settings.model) if kind == "sWN" else ""
    return f"{kind} {name}", encode(text, b"B", drawn(rng, layout(text)))


@pytest.mark.parametrize("seed", range(40))
def test_any_arguments_have_one_answer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    echoes = pick(rng, (0.3, 5.0, np.nan)), pick(rng, (7.0, np.nan)), np.nan
    rig = Rig(
        pick(rng, sorted(MODELS)), world=lambda plan: scan_of(plan, *echoes), access=pick(rng, ("open", "strict")),
        fog_filter=rng.random() < 0.3,
    )  # fmt: skip
    for _ in range(40):
        to, (said, data) = pick(rng, (ONE, TWO)), request(rng, rig)
        rig.put(ask_b(said, data), to)
        rig.run(5 * MS)
        answers = [one for one in rig.sent if one.address == to and b"sSN " not in one.payload[:12] and one.payload]
        assert len(answers) == 1, (said, data)
        rig.run(pick(rng, (0, 20 * MS, 300 * MS)))
        for one in rig.sent:
            for dialect, payload in frames(one.payload):
                if payload[4:].startswith(b"LMDscandata ") and payload[:3] == b"sSN":
                    read(dialect, payload)
        rig.sent.clear()
    rig.session.power_on(rig.now_ns)
    rig.run(11 * SECOND)
    assert rig.session.is_up
