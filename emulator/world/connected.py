"""Connected pieces of what is linked in pairs: faces that share an edge, faces that share a corner.

Belongs here: the search, and the choice of how. Not: what is linked with what.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FEW = 4096
"Nodes. scipy's graphs take longer to import than all the rest of a small scene; of more nodes they are faster."


def pieces_of(
    count: int, one: NDArray[np.integer], other: NDArray[np.integer], few: int = FEW
) -> tuple[int, NDArray[np.integer]]:
    """How many pieces `count` nodes make, of which `one` and `other` are linked, and the piece of each node.

    Pieces are numbered by their first nodes.
    """
    if count > few:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        links = coo_array((np.ones(len(one), dtype=np.int8), (one, other)), shape=(count, count))
        pieces, piece = connected_components(links, directed=False)
        return int(pieces), piece
    first = np.arange(count)  # of each node a node of the same piece, in the end the piece's first
    while True:
        least = np.minimum(first[one], first[other])
        found = first.copy()
        for ends in (one, other):
            np.minimum.at(found, ends, least)
            np.minimum.at(found, first[ends], least)
        found = found[found]
        if np.array_equal(found, first):
            break
        first = found
    firsts, piece = np.unique(first, return_inverse=True)
    return len(firsts), piece
