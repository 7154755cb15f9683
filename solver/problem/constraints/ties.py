"""Redundant contact rows beside tied rows.

A contact row that is a combination of tied rows is decided by them: of the tied rows of one node,
as at the edge where a tied and a contact boundary of the same bodies meet, or of several nodes, as
at the corner of two bodies that are tied to a third one. If the contact row stayed, F would be
singular on active sets that contain it, and an interference would contradict the ties. A tied row
with a rigid body that may move decides nothing.
"""

import numpy as np
from mpi4py import MPI
from scipy import sparse
from scipy.sparse.linalg import splu

from solver.problem.constraints.conditions import ContactRows
from solver.problem.constraints.matrix import REDUNDANT
from solver.vectors import Array, Ints, Mask

SAME = 1e-10
"""Squared sine of the angle between a row and the tied rows that contain it."""

AT_ONCE = 100
"""Number of contact rows that are compared with tied rows of several nodes at once."""


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
    some = largest < 1.0 - SAME
    some[some] = _independent(of_contact[some], every, all_columns % tied.normals.shape[1])
    return np.asarray(some)


def _independent(rows: sparse.csr_matrix, tied: sparse.csr_matrix, component: Ints) -> Mask:
    """Mask (k,) of rows that are no combination of tied rows, all of unit length.

    Tied rows on which translations do nothing have no combination on which they do something.

    Parameters
    ----------
    component : (columns,)
    """
    touched = np.asarray(abs(tied).sum(axis=0)).ravel() > 0.0
    may_be = abs(rows) @ ~touched == 0.0
    sums = [abs(part @ (component[:, None] == np.arange(3))).max(axis=1) for part in (rows, tied)]
    if sums[1].max() ** 2 < SAME:
        may_be &= sums[0] ** 2 < SAME
    result = np.ones(len(may_be), bool)
    places = np.flatnonzero(may_be)
    if len(places):
        factor = splu((tied @ tied.T + REDUNDANT * sparse.identity(tied.shape[0])).tocsc())
        for few in np.array_split(places, len(places) // AT_ONCE + 1):
            cosines = (rows[few] @ tied.T).toarray().T
            result[few] = (cosines * factor.solve(cosines)).sum(axis=0) < 1.0 - SAME
    return result


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
