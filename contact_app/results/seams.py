"""Choice of multipliers with the smoothest pressure where rows of several contacts share a node.

Where two contacts of a body with others share a line of nodes, each has a row at every node of it:
the gap in the mean over its own facets. Against a coarser mesh these rows may be linearly
dependent, and then the forces f of the rows are not unique. The nodal forces Aᵀ f (A the rows), and
with them all resultants, are unique; any Δ with Aᵀ Δ = 0 may be added to f. The chosen Δ makes the
pressures f_i / W_i nearest to the mean pressure q of all rows of the node,

    min Σ (f_i + Δ_i - q W_i)² / W_i   over Aᵀ Δ = 0.

With y = W^(-1/2) Δ and τ = W^(-1/2) (q W - f) that is the residual y of the least squares problem
min |τ - W^(1/2) A z|: zero where the rows are independent. The step ends where a force would become
tensile.
"""

import numpy as np
from mpi4py import MPI
from scipy import sparse
from scipy.sparse.linalg import lsmr

from contact_app.model.candidates import NEARLY_PARALLEL
from meshes.arrays import Array, Ints, Mask
from meshes.connected import connected
from solver.problem.constraints.conditions import ContactRows, pairs_at_nodes

ACCURACY = 1e-13
"""Relative accuracy of the least squares problem."""

STEPS = 10_000
"""Iterations it may take."""


def smooth_forces(comm: MPI.Intracomm, rows: ContactRows, force: Array, closed: Mask) -> Array:
    """Forces of contact rows with the same nodal forces and the smoothest pressure (collective).

    Parameters
    ----------
    rows
        Of this rank.
    force : (rows,)
    closed : (rows,)
        Mask of closed rows, with or without a force.

    Returns
    -------
    (rows,)
    """
    group = _seams(rows, closed)
    chosen = np.flatnonzero(group >= 0)
    if not comm.allreduce(len(chosen)):
        return force
    area, place = rows.areas[chosen], group[chosen]
    mean = np.bincount(place, force[chosen]) / np.bincount(place, area)
    keep = np.zeros(len(force), bool)
    keep[chosen] = True
    entries = rows.entries.of_rows(keep)
    column = entries.node * rows.normals.shape[1] + entries.component
    # seams are lines on surfaces: every rank solves for all of them
    parts = comm.allgather((entries.row, column, entries.value, force[chosen], area, mean[place]))
    starts = np.cumsum([0, *(len(part[3]) for part in parts)])
    row = np.concatenate([part[0] + start for part, start in zip(parts, starts, strict=False)])
    columns, values, f, w, q = (
        np.concatenate(field) for field in list(zip(*parts, strict=True))[1:]
    )
    distinct, columns = np.unique(columns, return_inverse=True)
    matrix = sparse.csr_matrix((values, (row, columns.reshape(-1))), shape=(len(f), len(distinct)))
    root = np.sqrt(w)
    scaled = (sparse.diags(root) @ matrix).tocsr()
    target = (q * w - f) / root
    correction = lsmr(scaled, target, atol=ACCURACY, btol=ACCURACY, conlim=0.0, maxiter=STEPS)[0]
    change = root * (target - scaled @ correction)
    pulls = change < 0.0
    step = min(1.0, float((f[pulls] / -change[pulls]).min(initial=np.inf)))
    result = force.copy()
    local = slice(int(starts[comm.rank]), int(starts[comm.rank + 1]))
    result[chosen] = np.maximum(f + step * change, 0.0)[local]
    return result


def _seams(rows: ContactRows, closed: Mask) -> Ints:
    """Number of the group of closed means of several contacts at a node; -1 for none, (rows,)."""
    label = np.full(len(rows.nodes), -1, np.int64)
    means = np.flatnonzero(closed & ~np.isnan(rows.areas))
    links = [np.zeros((0, 2), np.int64)]
    for i, j in pairs_at_nodes(rows.nodes[means]):
        difference = np.linalg.norm(rows.normals[means[i]] - rows.normals[means[j]], axis=1)
        near = difference < NEARLY_PARALLEL
        links.append(np.stack([i[near], j[near]], axis=1))
    ends = np.concatenate(links)
    group = connected(ends.T, len(means))
    several = np.bincount(group) > 1
    label[means] = np.where(several, np.cumsum(several) - 1, -1)[group]
    return label
