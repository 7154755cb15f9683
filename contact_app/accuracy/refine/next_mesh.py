"""Choice of the next mesh of a refinement, and the scene on it.

The error falls as a power of the cell size, e ~ s^-p, where the first mesh is refined by the factor
s along each edge. The rate p is at first the best rate of the degree, and then the rate between the
last two levels.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from contact_app.accuracy.refine.grading import axis_evenness, graded
from contact_app.scene.bodies import Body, Box
from contact_app.scene.scene import Decomposition
from meshes.arrays import Array
from meshes.graded import graded_box


@dataclass(frozen=True)
class MeshSteps:
    """Limits of the steps from one mesh to the next."""

    farthest: float = 2.0
    """Largest refinement factor from one mesh to the next, along an edge."""
    slowest: float = 0.4
    fastest: Mapping[int, float] = field(default_factory=lambda: {1: 1.0, 2: 1.5})
    """Smallest rate, and largest rate by degree, that are accepted."""
    graded: Mapping[int, float] = field(default_factory=lambda: {1: 1.0, 2: 2.0})
    """Largest accepted rate on graded cells."""
    patient: float = 1.5
    """Largest refinement factor between graded meshes of degree 2, whose grid lines follow the
    error."""
    undecomposed_nodes: Mapping[int, float] = field(default_factory=lambda: {2: 500_000, 3: 80_000})
    """Nodes by dimension up to which graded bodies are not cut into subdomains."""
    least: float = 1.04
    """Smallest refinement factor between graded meshes whose grid lines hardly move any more."""
    settled: float = 0.85
    """Predicted relative error after new grid lines from which on grid lines hardly move."""
    first_exponent: float = 0.75
    smallest_exponent: float = 0.3
    """Exponent of the evenness in the predicted relative error after new grid lines: at first, and
    the smallest later, when the exponent observed with the last grid lines is used."""


STEPS = MeshSteps()


Grids = list[list[Array]]
"""Coordinates of grid lines, by body and axis."""


def rate_of(factors: list[float], errors: list[float], degree: int = 1) -> float:
    """Rate p of e ~ s^-p from the last two meshes, within limits; the best for one mesh."""
    fastest = STEPS.fastest[degree]
    if len(factors) < 2:
        return fastest
    if errors[-1] >= errors[-2] or factors[-1] <= factors[-2]:
        return STEPS.slowest
    rate = math.log(errors[-2] / errors[-1]) / math.log(factors[-1] / factors[-2])
    return min(max(rate, STEPS.slowest), fastest)


def next_factor(
    factors: list[float], errors: list[float], target: float, integer: bool = False, degree: int = 1
) -> float:
    """Refinement factor of the next mesh along an edge, relative to the first mesh.

    Parameters
    ----------
    factors, errors
        Refinement factors and errors of the meshes so far; the last error is above the target.
    integer
        Whether the factor has to be a whole number.
    degree
        Of the cells.

    Examples
    --------
    >>> round(next_factor([1.0, 2.0], [0.08, 0.04], 0.025), 3)
    3.2
    >>> next_factor([1.0], [0.5], 0.01)
    2.0
    """
    rate = rate_of(factors, errors, degree)
    step = (errors[-1] / target) ** (1.0 / rate)
    factor = factors[-1] * min(step, STEPS.farthest)
    return float(math.ceil(factor - 1e-9)) if integer else factor


def graded_step(error: float, left: float, target: float, degree: int) -> float:
    """Factor on the number of layers for the next graded mesh.

    Parameters
    ----------
    error
        Error of the last mesh, above the target.
    left
        Predicted factor on the error by new grid lines alone.

    Examples
    --------
    >>> graded_step(0.19, 0.5, 0.1, 2), graded_step(0.19, 0.5, 0.01, 2)  # new lines will do
    (1.0, 1.5)
    >>> round(graded_step(0.02, 1.0, 0.01, 2), 3)
    1.414
    """
    step = (error * left / target) ** (1.0 / STEPS.graded[degree])
    least = STEPS.least if left > STEPS.settled else 1.0
    return min(max(step, least), STEPS.patient if degree == 2 else STEPS.farthest)


def evenness_exponent(before: float, even: float, step: float, after: float, degree: int) -> float:
    """Observed exponent of the evenness in the error, without the effect of more layers.

    Examples
    --------
    >>> [evenness_exponent(0.2, 0.25, 1.0, after, 2) for after in (0.1, 0.05, 0.3)]
    [0.5, 1.0, 0.3]
    """
    left = max(after / before * step ** STEPS.graded[degree], even)
    return max(math.log(left) / math.log(even), STEPS.smallest_exponent)


def has_free_degree(bodies: Sequence[Body]) -> bool:
    """Whether the degree is left to the refinement."""
    averaged = any(body.mean_dilatation for body in bodies)
    return not averaged and not any(body.degree_given for body in bodies)


def quadratic(bodies: Sequence[Body]) -> tuple[Body, ...]:
    """The bodies with degree 2."""
    return tuple(replace(body, degree=2) for body in bodies)


def has_even_cells(bodies: Sequence[Body]) -> bool:
    """Whether all boxes have an even number of cells along every edge: half of it has its nodes."""
    return all(n % 2 == 0 for body in bodies if isinstance(body.mesh, Box) for n in body.mesh.cells)


def refined(bodies: Sequence[Body], factor: float) -> tuple[Body, ...]:
    """The boxes with the cells along every edge multiplied by a factor."""
    finer = []
    for body in bodies:
        assert isinstance(body.mesh, Box)
        cells = tuple(math.ceil(factor * n - 1e-9) for n in body.mesh.cells)
        finer.append(replace(body, mesh=replace(body.mesh, cells=cells)))
    return tuple(finer)


def equal_lines(bodies: Sequence[Body]) -> Grids:
    """Grid coordinates of boxes of equal cells, by body and axis."""
    grids = []
    for body in bodies:
        assert isinstance(body.mesh, Box)
        box = body.mesh
        corners = zip(box.lower, box.upper, box.cells, strict=True)
        grids.append([np.linspace(a, b, n + 1) for a, b, n in corners])
    return grids


def regraded(
    bodies: Sequence[Body], squares: Grids, grids: Grids, factor: float, keeps_lines: bool
) -> tuple[float, Grids]:
    """New grids, refined by a factor relative to the first mesh, from η² of the present layers.

    The number of cells follows from the factor, rounded up to whole layers. The factor that results
    from this rounding is returned as well.

    Parameters
    ----------
    keeps_lines
        Whether the grid lines of the first mesh stay.
    """
    starts = equal_lines(bodies)
    result, made = [], factor
    for body, lines, errors, start in zip(bodies, grids, squares, starts, strict=True):
        cells = [len(line) - 1 for line in start]
        layers = whole_layers(factor, cells, [axis_evenness(part) for part in errors])
        made = max(made, (math.prod(layers) / math.prod(cells)) ** (1.0 / len(cells)))
        result.append(
            [
                graded(old, part, count, line if keeps_lines else line[[0, -1]], body.degree)
                for old, part, count, line in zip(lines, errors, layers, start, strict=True)
            ]
        )
    return made, result


def whole_layers(factor: float, cells: Sequence[int], even: Sequence[float]) -> list[int]:
    """Layers along each axis for a mean factor; axes with less even errors get more.

    Examples
    --------
    >>> whole_layers(1.05, [8, 8], [0.9, 0.8])  # 70.6 cells at least
    [8, 9]
    >>> whole_layers(1.1, [8, 8], [0.9, 0.8]), whole_layers(2.0, [3, 5], [1.0, 1.0])
    ([9, 9], [6, 10])
    """
    layers = [max(math.floor(factor * n + 1e-9), 1) for n in cells]
    least = factor ** len(cells) * math.prod(cells) * (1.0 - 1e-9)
    for axis in sorted(range(len(cells)), key=lambda a: round(even[a], 6)):
        if math.prod(layers) < least:
            layers[axis] = max(math.ceil(factor * cells[axis] - 1e-9), 1)
    return layers


def layers_for_one(grids: Grids, starts: Grids) -> float:
    """Largest mean refinement factor along an axis over all bodies, relative to the first mesh."""
    cells = ([math.prod(len(x) - 1 for x in axes) for axes in each] for each in (grids, starts))
    return max(
        (now / start) ** (1.0 / len(axes)) for now, start, axes in zip(*cells, grids, strict=True)
    )


def on_lines(
    bodies: Sequence[Body], parts: Decomposition, grids: Grids, ranks: int
) -> tuple[tuple[Body, ...], Decomposition]:
    """Graded boxes on grid lines, and their decomposition.

    Flat cells in irregular subdomains converge slowly, so small bodies are not decomposed.
    """
    graded = tuple(
        replace(body, mesh=graded_box(body.mesh.cell, axes))
        for body, axes in zip(bodies, grids, strict=True)
    )
    if isinstance(parts.subdomains, int):
        return graded, parts
    most = STEPS.undecomposed_nodes[graded[0].mesh.dimension]
    small = ranks == 1 and sum(body.nodes for body in graded) <= most
    return graded, Decomposition(len(graded) if small else None)
