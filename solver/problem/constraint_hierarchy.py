"""Constraint hierarchy: levels from few to all contact rows, for contact that peels off.

Where contact peels off from one end, each active set moves the edge of contact by about the
thickness of the body; for a slender body this is a row or two. With every eighth row only, a few
sets find the edge to within eight rows, and each finer level has to move it by one or two rows:
nested iteration (A. Brandt, C. W. Cryer, *Multigrid algorithms for the solution of linear
complementarity problems arising from free boundary problems*, 1983), on contact rows alone. Each
level decides again on the rows that the level before found closed.

Rows that are closer to each other than the body is thick need no levels, so that only slender
bodies have any. A body with n nodes, k of them on contact rows, is about n/k nodes thick. Rows at
single nodes are as far apart as the nodes. For cells of degree 2, rows in the mean about vertices
are fewer than k and accordingly farther apart.
"""

import numpy as np
from mpi4py import MPI

from solver.backend import ConstraintHierarchy
from solver.problem.decomposed import DecomposedProblem
from solver.vectors import Ints, Mask

FEWEST = 8
"""Rows of the coarsest level, for each contact."""

MOST = 0.7
"""Share of all rows above which a level is left out because it would hardly be coarser."""

HALVINGS = 20
"""Largest number of levels: cells down to a millionth of the extent of the contacts."""


def constraint_hierarchy(problem: DecomposedProblem, coarsened: bool) -> ConstraintHierarchy:
    """The hierarchy of a problem from its coarsest level on, or the finest (collective)."""
    return ConstraintHierarchy(problem.inequality, tuple(_levels(problem)) if coarsened else ())


def _thickness(problem: DecomposedProblem, rows: Ints) -> float:
    """Thickness of the bodies in distances between their contact rows (collective)."""
    comm, d = problem.comm, problem.dimension
    if d == 1:  # without other nodes the thickness is one
        return 1.0
    node_of, count = np.empty(problem.B.columns, np.int64), 0
    for cls, part in zip(problem.classes, problem.slices, strict=True):
        nodes = cls.unknowns // d
        members = count + nodes * np.arange(cls.members)
        node_of[part] = (members[:, None] + cls.interface // d).ravel()
        count += nodes * cls.members
    B = problem.B
    columns = np.concatenate(comm.allgather(np.unique(B.local[rows].indices)))  # of all ranks
    local = columns[(columns >= B.first) & (columns < B.first + B.columns)] - B.first
    touched = len(np.unique(node_of[local]))
    count, touched, total = comm.allreduce(np.array([count, touched, len(rows)]))
    spacing = (touched / max(total, 1)) ** (1.0 / (d - 1))
    return float(count / max(touched, 1) / max(spacing, 1.0))


def _levels(problem: DecomposedProblem) -> list[Mask]:
    """Masks (dual,), coarsest first: in each cell of a grid the row next to its centre."""
    comm, contact = problem.comm, problem.contact
    rows = np.flatnonzero(problem.inequality)
    total = comm.allreduce(len(rows))
    lower = np.full(3, np.inf)
    upper = -lower
    if len(rows):
        lower, upper = contact.points.min(axis=0), contact.points.max(axis=0)
    comm.Allreduce(MPI.IN_PLACE, lower, op=MPI.MIN)
    comm.Allreduce(MPI.IN_PLACE, upper, op=MPI.MAX)
    extent = float((upper - lower).max())
    thickness = _thickness(problem, rows)
    contacts = 1 + comm.allreduce(int(contact.sources.max(initial=-1)), op=MPI.MAX)
    result: list[Mask] = []
    mask = np.zeros(problem.size, bool)
    for halvings in range(HALVINGS):
        if not extent > 0.0:
            break
        place = (contact.points - lower) * (2**halvings / extent)
        cells = np.floor(place)
        order = np.argsort(np.abs(place - cells - 0.5).max(axis=1), kind="stable")
        keys = np.column_stack([contact.sources, cells])[order]
        _, chosen = np.unique(keys, axis=0, return_index=True)
        mask = mask.copy()
        mask[rows[order[chosen]]] = True
        count = comm.allreduce(int(mask.sum()))
        if count > MOST * total:
            break
        if count >= FEWEST * contacts:
            result.append(mask)
        else:
            mask = np.zeros(problem.size, bool)
    sizes = [comm.allreduce(int(m.sum())) * thickness ** (problem.dimension - 1) for m in result]
    return result if sizes and sizes[0] < total else []
