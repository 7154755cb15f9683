"""Active sets for undecomposed slender bodies, on columns of F that are computed as rows close.

In bending F is so ill-conditioned that hundreds of steps of iterative active-set methods undo each
other. Here each row that closes costs one operator application, F e, once. A dense factor solves
each active set exactly, and the levels of `constraint_hierarchy` keep the sets small until they are
nearly right. The method is that of primal-dual active sets (Hintermüller, Ito, Kunisch, 2002).
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from scipy import linalg

from solver.tfeti.constraints.hierarchy import constraint_hierarchy
from solver.tfeti.dual import DualProblem
from solver.vectors import Array, largest_magnitude

SETS = 60
"""Largest number of active sets."""

COLUMNS = 2000
"""Largest number of stored columns."""

SIGNIFICANT = 1e-9
"""Forces and distances, over the largest, above which a row changes its status."""

FIRST = 0.5
"""Rows whose penetration is above this share of the deepest penetration close first."""


def on_columns(problem: DualProblem) -> tuple[Array, int]:
    """Nearly exact multipliers (dual,), and the operator applications spent.

    For problems without floating subdomains. If no body is slender, the multipliers are zero and
    nothing is computed.
    """
    comm = problem.comm
    levels = constraint_hierarchy(problem, coarsened=True)
    result, applications = np.zeros(problem.size), 0
    if levels.finest:
        return result, applications
    first = comm.exscan(problem.size) or 0
    columns: dict[int, Array] = {}
    closed = np.zeros(problem.size, bool)
    deepest = FIRST
    for _ in range(SETS):
        rows = np.concatenate(comm.allgather(first + np.flatnonzero(closed)))
        missing = [row for row in rows if row not in columns]
        if len(columns) + len(missing) > COLUMNS:
            break
        for row in missing:
            unit, column = np.zeros(problem.size), np.empty(problem.size)
            if first <= row < first + problem.size:
                unit[row - first] = 1.0
            problem.F.apply(unit, column)
            columns[row] = column
        applications += len(missing)
        rows_of_F = np.array([columns[row] for row in rows]).reshape(len(rows), problem.size)
        matrix = np.empty((0, 0))
        if len(rows):
            matrix = np.concatenate(comm.allgather(rows_of_F[:, closed].T))
        target = np.concatenate(comm.allgather(problem.d[closed]))
        try:
            forces = linalg.solve(0.5 * (matrix + matrix.T), target, assume_a="pos")
        except linalg.LinAlgError:
            break
        result = np.zeros(problem.size)
        result[closed] = forces[np.searchsorted(rows, first + np.flatnonzero(closed))]
        distance = np.where(problem.inequality & ~closed, problem.d - forces @ rows_of_F, 0.0)
        distance /= problem.spread
        opens = closed & (result < -SIGNIFICANT * largest_magnitude(comm, result))
        worst = comm.allreduce(float(distance.max(initial=0.0)), op=MPI.MAX)
        crossed = distance > max(deepest * worst, SIGNIFICANT * largest_magnitude(comm, problem.d))
        while True:
            changed = opens | (crossed & levels.allowed)
            some = comm.allreduce(int(changed.sum()))
            if some or levels.finest:
                break
            levels = levels.finer()
        if not some:
            break
        closed, deepest = closed ^ changed, 0.0
    return np.maximum(result, 0.0), applications
