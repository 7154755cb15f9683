"""Redundant contact rows beside tied rows.

A contact row that is a combination of the tied rows of one node is decided by them, as at the edge
where a tied and a contact boundary of the same bodies meet. If the contact row stayed, F would be
singular on active sets that contain it. A tied row with a rigid body that may move decides nothing.
"""

import numpy as np
from mpi4py import MPI
from scipy import sparse

from solver.tfeti.constraints.conditions import ContactRows
from solver.vectors import Array, Ints, Mask

SAME = 1e-10
"""Squared sine of the angle between a row and the tied rows of a node that contain it."""


def undecided(comm: MPI.Intracomm, contact: ContactRows, tied: ContactRows) -> Mask:
    """Mask (contact rows,) of rows that the tied rows of a node do not determine (collective).

    Surfaces are small beside bodies: every rank compares its contact rows with all tied rows.
    """
    tied = tied.of(~tied.on_rigid)
    gathered = comm.allgather((_columns(tied), tied.entries.row, tied.entries.value, tied.nodes))
    counts = np.cumsum([0, *(len(part[3]) for part in gathered)])
    columns, values = (np.concatenate([part[k] for part in gathered]) for k in (0, 2))
    rows = np.concatenate([part[1] + n for part, n in zip(gathered, counts, strict=False)])
    nodes = np.concatenate([part[3] for part in gathered])
    met = np.zeros(len(nodes), bool)
    met[rows[np.isin(columns, _columns(contact))]] = True  # a few, along the edge of a tie
    if not met.any():
        return np.ones(len(contact.nodes), bool)
    of_met = met[rows]
    columns, rows, values = columns[of_met], (np.cumsum(met) - 1)[rows[of_met]], values[of_met]
    nodes = nodes[met]
    all_columns = np.unique(np.concatenate([columns, _columns(contact)]))
    every = _unit(columns, rows, values, len(nodes), all_columns)
    of_contact = _unit(_columns(contact), contact.entries.row, contact.entries.value,
                len(contact.nodes), all_columns)  # fmt: skip
    cosine = (of_contact @ every.T).tocoo()
    at_node, number = np.unique(nodes, return_inverse=True)
    share = sparse.csr_matrix(
        (cosine.data**2, (cosine.row, number.reshape(-1)[cosine.col])),
        shape=(len(contact.nodes), len(at_node)),
    )
    largest = np.asarray(share.max(axis=1).todense()).ravel()
    return np.asarray(largest < 1.0 - SAME)


def _columns(rows: ContactRows) -> Ints:
    return rows.entries.node * rows.normals.shape[1] + rows.entries.component


def _unit(
    columns: Ints, rows: Ints, values: Array, count: int, all_columns: Ints
) -> sparse.csr_matrix:
    """Rows of unit length over the known columns."""
    place = np.searchsorted(all_columns, columns)
    matrix = sparse.csr_matrix((values, (rows, place)), shape=(count, len(all_columns)))
    length = np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel())
    length[length == 0.0] = 1.0  # of rigid bodies alone
    return sparse.diags(1.0 / length) @ matrix
