"""The connected components of a graph."""

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from meshes.arrays import Ints


def connected(ends: Sequence[Ints] | Ints, count: int) -> Ints:
    """Number of the connected component of each vertex of a graph, (count,).

    Parameters
    ----------
    ends : (2, links)
        The two vertices that each link connects.
    """
    one, other = ends
    if len(one) == 0:
        return np.arange(count)
    graph = sparse.coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)
