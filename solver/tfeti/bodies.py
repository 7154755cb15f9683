"""The body of each interface unknown and of each row of B."""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from solver.contact.bodies import Bodies, run_begins
from solver.problem.constraints.matrix import ConstraintMatrix
from solver.vectors import Ints


def bodies_of(
    comm: MPI.Intracomm,
    B: ConstraintMatrix,
    groups: Ints,
    members: Sequence[Ints],
    widths: Sequence[int],
    rigid: Sequence[bool],
) -> Bodies:
    """Find the bodies of interface unknowns and rows (collective).

    Parameters
    ----------
    groups : (bodies,)
        Group of each body.
    members : one (members,) array for each class
        Body of each subdomain.
    widths
        Interface unknowns of a subdomain of each class.
    rigid
        Whether the subdomains of each class are rigid bodies.
    """
    parts = [np.repeat(body, width) for body, width in zip(members, widths, strict=True)]
    columns = np.concatenate([np.empty(0, np.int64), *parts])
    rows = np.zeros((B.rows, 2), np.int64)
    if len(groups) > 1:
        starts, body = _runs(comm, columns, B.first)
        of_entry = body[np.searchsorted(starts, B.local.indices, side="right") - 1]
        filled = np.flatnonzero(np.diff(B.local.indptr))
        if len(filled):
            begins = B.local.indptr[filled]
            rows[filled, 0] = np.minimum.reduceat(of_entry, begins)
            rows[filled, 1] = np.maximum.reduceat(of_entry, begins)
    stiff = np.zeros(len(groups), bool)
    for body, without in zip(members, rigid, strict=True):
        stiff[body] |= without
    comm.Allreduce(MPI.IN_PLACE, stiff, op=MPI.LOR)
    return Bodies(groups, tuple(members), columns, rows, stiff)


def _runs(comm: MPI.Intracomm, columns: Ints, first: int) -> tuple[Ints, Ints]:
    """First columns (over all ranks) of the runs of columns of one body, and the body of each."""
    begins = run_begins(columns)
    gathered = comm.allgather((begins + first, columns[begins]))
    starts, bodies = (np.concatenate(parts) for parts in zip(*gathered, strict=True))
    return starts, bodies
