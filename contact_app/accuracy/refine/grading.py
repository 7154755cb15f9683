"""Graded grid lines of a box along each axis, from the error of the last mesh.

Along an axis the error of a layer of cells, η_i², is about C h_i³ with C the density of the error
for cells of unit length. For a given number of layers the sum is smallest if all layers have the
same error. The new grid lines therefore cut the integral of (η_i²)^(1/3) over the old layers into
equal parts. A layer is at most `RATIO` times as thick as its neighbour and `THICKEST` times the
mean.

For degree 2 the density is of fifth order in h. Grading, however, serves singularities, and next to
these the order is no higher than for degree 1. The same rule is used, and layers may grow faster.
"""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from meshes.arrays import Array

RATIO, THICKEST = {1: 1.5, 2: 2.0}, 8.0


def layer_errors(solved: SolvedScene, grids: Sequence[Sequence[Array]]) -> list[list[Array]]:
    """η² of each layer of cells, by body and axis (collective).

    Parameters
    ----------
    grids
        Grid coordinates of each body along each axis.
    """
    model = solved.model
    sums = [[np.zeros(len(grid) - 1) for grid in axes] for axes in grids]
    squares = solved.estimator.cell_squares(solved.solution)
    for local, s in enumerate(model.partition.subdomains):
        cls, column = model.place[local]
        centres = s.points()[s.reference.cells].mean(axis=1)
        for axis, grid in enumerate(grids[s.body]):
            sums[s.body][axis] += np.histogram(
                centres[:, axis], bins=grid, weights=squares[cls][:, column]
            )[0]
    return [[model.comm.allreduce(part, op=MPI.SUM) for part in axes] for axes in sums]


def evenness(squares: Sequence[Sequence[Array]]) -> float:
    """Smallest error that new grid lines alone could reach, relative to the present one: at most 1.

    It follows from the law above, along the one axis of each body that gains most.

    Parameters
    ----------
    squares
        η² of each layer, by body and axis.
    """
    total = sum(float(axes[0].sum()) for axes in squares)
    left = 0.0
    for axes in squares:
        left += min(_least(s) for s in axes)
    return float(np.sqrt(left / total)) if total > 0.0 else 1.0


def axis_evenness(squares: Array) -> float:
    """Smallest error of the layers of one axis, relative to the present one."""
    total = float(squares.sum())
    return float(np.sqrt(_least(squares) / total)) if total > 0.0 else 1.0


def _least(squares: Array) -> float:
    """Smallest η² that the same number of layers could reach."""
    return float(np.cbrt(squares).sum() ** 3 / len(squares) ** 2)


def graded(grid: Array, squares: Array, layers: int, fixed: Array, degree: int = 1) -> Array:
    """New grid coordinates.

    Parameters
    ----------
    grid : (n + 1,)
        Coordinates now.
    squares : (n,)
        η² of each layer.
    layers
        Number of new layers, at least the number of intervals between fixed coordinates.
    fixed
        Coordinates that stay grid lines, including both ends.
    degree
        Of the displacement.
    """
    thickness = np.diff(grid)
    length = grid[-1] - grid[0]
    weights = np.cbrt(squares)
    if weights.sum() == 0.0:
        weights = thickness.copy()
    density = weights / thickness
    density = np.maximum(density, density @ thickness / length / THICKEST)
    # a sweep to the end and back, so that thickness grows by no more than the ratio
    for order in (range(1, len(density)), range(len(density) - 2, -1, -1)):
        for i in order:
            before = i - 1 if order.step > 0 else i + 1
            density[i] = max(density[i], density[before] / RATIO[degree])
    amount = np.concatenate([[0.0], np.cumsum(density * thickness)])
    ends = np.interp(fixed, grid, amount)
    counts = np.maximum(np.rint(layers * np.diff(ends) / amount[-1]), 1).astype(int)
    parts = [
        np.interp(np.linspace(a, b, n + 1), amount, grid)[:-1]
        for a, b, n in zip(ends[:-1], ends[1:], counts, strict=True)
    ]
    result = np.concatenate([*parts, grid[-1:]])
    starts = np.concatenate([[0], np.cumsum(counts)])
    result[starts] = fixed
    return result
