"""Candidates for contact: where contacts share a node, one of nearly parallel rows is enough.

Every node of a contact boundary has a candidate row. If rows at a node have directions less than
1e-2 apart, only the nearest becomes a contact row: nearly parallel rows make F nearly singular (an
obstacle given twice, once slightly rotated, takes hundreds of times as many steps). Bodies that
only contact holds have all rows.

The rows that are left out are tested in the answer. If it penetrates some, the scene is solved
again with these rows (`run.solve_scene`).
"""

from typing import Literal

import numpy as np

from meshes.arrays import Array, Mask
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows, pairs_at_nodes

NEARLY_PARALLEL = 1e-2
"""Distance of two unit directions at a node below which only the nearer row remains."""

Needed = Literal["all", "distinct"] | Mask
"""Choice of candidate rows: all, `distinct` ones, or a mask of this rank's candidates."""


def distinct(rows: ContactRows, held: Mask) -> Mask:
    """Mask (rows,) of candidate rows that no nearer row nearly repeats.

    Parameters
    ----------
    held : (contacts,)
        Whether the conditions stop every rigid motion of the bodies of each contact; the others
        have all rows.
    """
    needed = np.ones(len(rows.nodes), bool)
    single = ~rows.wide & held[rows.sources] & ~rows.on_rigid
    direction, entries = np.zeros_like(rows.normals), rows.entries
    chosen = single[entries.row]
    direction[entries.row[chosen], entries.component[chosen]] = entries.value[chosen]
    norm = np.linalg.norm(direction, axis=1)
    norm[norm == 0.0] = 1.0
    direction, gap = direction / norm[:, None], rows.gaps / norm
    for i, j in pairs_at_nodes(rows.nodes):
        same = np.linalg.norm(direction[i] - direction[j], axis=1) < NEARLY_PARALLEL
        same &= single[i] & single[j] & needed[i] & needed[j]
        needed[np.where(gap[i] <= gap[j], j, i)[same]] = False
    return needed


def slack_of(rows: ContactRows, exchange: NodeExchange, displacement: Array) -> Array:
    """Remaining gap along each row, (rows,) (collective).

    Parameters
    ----------
    exchange
        Exchange of all nodes with their owners.
    displacement : (nodes, dimension)
        Displacement at the nodes that this rank owns.
    """
    entries = rows.entries
    query = exchange.among(entries.node)
    u = query.from_owners(displacement[query.nodes - query.first])
    moved = entries.value * u[np.arange(len(entries.node)), entries.component]
    return rows.gaps - np.bincount(entries.row, moved, minlength=len(rows.nodes))
