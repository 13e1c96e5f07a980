"""Connected pieces: by hand, and the few as the many."""

from __future__ import annotations

import numpy as np
import pytest

from emulator.world.connected import pieces_of
from tests import layering


def test_pieces_are_numbered_by_their_first_nodes() -> None:
    count, piece = pieces_of(6, np.array([5, 3]), np.array([1, 4]))
    assert count == 4
    assert piece.tolist() == [0, 1, 2, 3, 3, 1]


@pytest.mark.parametrize("few", [0, 4096])
def test_a_chain_is_one_piece_and_without_links_each_is_its_own(few: int) -> None:
    nodes = np.random.default_rng(1).permutation(999)
    count, piece = pieces_of(999, nodes[:-1], nodes[1:], few)
    assert (count, piece.max()) == (1, 0)
    nothing = np.zeros(0, np.int64)
    count, piece = pieces_of(4, nothing, nothing, few)
    assert (count, piece.tolist()) == (4, [0, 1, 2, 3])


@pytest.mark.parametrize("links", [0, 3, 40, 90, 400])
def test_few_are_searched_with_the_same_result_as_many(links: int) -> None:
    rng = np.random.default_rng(links)
    for count in (1, 7, 100):
        one, other = rng.integers(0, count, (2, links))
        (found, piece), (wanted, right) = pieces_of(count, one, other), pieces_of(count, one, other, few=0)
        assert found == wanted
        assert piece.tolist() == right.tolist()


def test_graphs_of_scipy_are_not_imported_at_every_start() -> None:
    """Where scans are grouped into objects they are: there they are always wanted."""
    slow = {
        name
        for name, path in layering.modules().items()
        for module, _, _, head in layering.statements(path)
        if head and module.startswith(("scipy.sparse", "scipy.spatial"))
    }
    assert slow == {"emulator.objects.segments"}
