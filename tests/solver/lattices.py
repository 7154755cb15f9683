"""Lattices of springs above a floor: contact problems of plain arrays."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scipy import sparse

from solver.problem.parts import NodePlaces
from solver.tfeti.dual import DualProblem
from solver.tfeti.from_arrays import Held, Obstacle, Subdomain, problem_from_arrays
from solver.vectors import Array

COLUMNS, ROWS = 4, 3
"""Cells of a piece."""


def cell_stiffness() -> Array:
    """Stiffness of a unit square of springs along its edges and diagonals, (8, 8)."""
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], float)
    K = np.zeros((8, 8))
    for a in range(4):
        for b in range(a):
            along = corners[a] - corners[b]
            along /= np.linalg.norm(along)
            row = np.zeros(8)
            row[2 * a : 2 * a + 2], row[2 * b : 2 * b + 2] = along, -along
            K += np.outer(row, row)
    return K


def lattice(columns: int) -> tuple[Array, Array]:
    """Points and stiffness of a lattice of so many columns of cells."""
    j, i = np.meshgrid(np.arange(ROWS + 1), np.arange(columns + 1), indexing="ij")
    points = np.stack([i.ravel(), j.ravel()], axis=1).astype(float)
    K = np.zeros((2 * len(points), 2 * len(points)))
    for row in range(ROWS):
        for column in range(columns):
            first = row * (columns + 1) + column
            nodes = first + np.array([0, 1, columns + 1, columns + 2])
            dofs = (2 * nodes[:, None] + np.arange(2)).ravel()
            K[np.ix_(dofs, dofs)] += cell_stiffness()
    return points, K


def in_pieces(
    columns: int,
    pieces: int,
    down: Callable[[Array], Array],
    gaps: Array,
    held: tuple[bool, bool] = (True, True),
    factors: tuple[float, ...] = (1.0,),
) -> DualProblem:
    """A beam of equal lattices in a row, held on its left, above a floor.

    Parameters
    ----------
    columns
        Of cells of a piece.
    down
        Forces downwards at the points of a piece.
    gaps
        Of the last nodes of the bottom.
    factors
        Of the stiffness of pieces, in turns.
    """
    points, K = lattice(columns)
    width, made = pieces * columns + 1, []
    stiffness = [sparse.csr_matrix(factor * K) for factor in factors]
    for piece in range(pieces):
        moved = points + [piece * columns, 0]
        nodes = (moved[:, 1] * width + moved[:, 0]).astype(np.int64)
        load = np.stack([np.zeros(len(nodes)), -down(moved)], axis=1)
        made.append(Subdomain(stiffness[piece % len(factors)], load.ravel(), nodes, moved))
    left = width * np.arange(ROWS + 1)
    side = Held(left, np.tile(held, (ROWS + 1, 1)), np.zeros((ROWS + 1, 2)))
    bottom = np.arange(width - len(gaps), width)
    floor = Obstacle(bottom, np.tile([0.0, -1.0], (len(bottom), 1)), gaps)
    return problem_from_arrays(MPI.COMM_SELF, made, side, [floor])


def undecomposed(
    columns: int, down: Callable[[Array], Array], gaps: Array, held: tuple[bool, bool]
) -> DualProblem:
    """The beam of `in_pieces` in one piece, for methods that solve for displacements."""
    points = np.pad(lattice(columns)[0], ((0, 0), (0, 1)))
    places = NodePlaces(np.arange(len(points))[None], np.zeros((1, 3)), points)
    return replace(in_pieces(columns, 1, down, gaps, held), places=(places,))
