"""The contact pressure without what the facets of the mesh make of it.

Where straight facets stand for a round surface, their corners press more than their middles, and
the largest pressure tells of the mesh. The mean over a little more than a facet is right. With the
weights w = (1 - |x - y|²/r²)² within r about a node x, r being `REACH` times the longest edge of
the facets there, on either side of the contact, the means

    (M p)(x) = Σ_y w(x, y) a(y) p(y) / Σ_y w(x, y) a(y),    a(y) the area of a node,

flatten a peak of p by a multiple of r²p''; the mean of what they took away is given back,
p_s = M p + M(p - M p) (twicing, J. W. Tukey, *Exploratory Data Analysis*, 1977, chapter 16). What
is below zero is cut off, and the whole scaled so that its integral is that of p. Constant pressures
are exact.

It is right to about 5 % where at least six facets lie across the contact and the gap is that of the
round surfaces (`round` of a contact between bodies, or a round obstacle); to 7 % from four facets
on (`contact_app.studies.smoothed_peaks`). It is too low where three facets or fewer carry the
contact, and at corners and ends, where the pressure itself is singular.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from contact_app.model.boundaries import facets_of
from contact_app.model.model import Model
from contact_app.model.pairs import gather_surface
from contact_app.scene.conditions import BodyContact, Tie
from meshes.contact_surface import Surface

Array = NDArray[np.float64]

REACH = 1.5
"""Radius of the mean over the longest edge there. In Hertz's ball (hertz_sphere.yaml) the peak is
0.3 % too low, where single nodes are 6.7 % too high (`contact_app.studies.smoothed_peaks`)."""


def smoothed_pressure(
    model: Model, number: int, nodes: NDArray[np.int64], pressure: Array, shares: Array
) -> Array:
    """The smoothed pressure of a contact of a scene at its nodes that this rank owns, (n,).

    Collective.

    Parameters
    ----------
    number
        As `Scene.touching` counts.
    pressure, shares : (n,), (n,)
        At these nodes, and the integrals of their shape functions.
    """
    touching = model.scene.touching[number]
    sides = [_side(model, touching.body, touching.boundary)]
    if isinstance(touching, BodyContact):
        sides.append(_side(model, touching.other, touching.other_boundary))
    return smoothed_on(model.comm, sides, (nodes, pressure, shares), model.partition.nodes)


def smoothed_on(
    comm: MPI.Intracomm,
    sides: Sequence[Surface | None],
    known: tuple[NDArray[np.int64], Array, Array],
    total: int,
) -> Array:
    """The smoothed pressure of a contact at its nodes that this rank owns, (n,) (collective).

    Parameters
    ----------
    sides
        The facets that press, of all ranks, and those of the other body where there is one.
    known : (n,), (n,), (n,)
        Nodes, pressure, and the integrals of shape functions.
    total
        Nodes of the mesh; k · total and more is the number of a mirror image.
    """
    nodes, pressure, shares = known
    loaded = pressure > 0.0
    parts = comm.allgather((nodes[loaded], pressure[loaded]))
    at, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    if sides[0] is None or len(at) == 0:
        return np.zeros(len(nodes))
    numbers, points, areas, radii = _at_nodes(sides[0], sides[1:])
    place = _places(at, numbers % total)
    p = np.where(place >= 0, values[place], 0.0)
    near = np.flatnonzero(cKDTree(points[p > 0.0]).query(points)[0] <= 2.0 * radii)
    found = np.zeros(len(numbers))
    found[near] = np.maximum(_twiced(points[near], radii[near], areas[near], p[near]), 0.0)
    result = np.zeros(len(nodes))
    mine = _places(numbers, nodes)
    result[mine >= 0] = found[mine[mine >= 0]]
    before, after = comm.allreduce(np.array([shares @ pressure, shares @ result]))
    return result * (before / after) if after > 0.0 else pressure


def smoothed_tractions(model: Model, tie: Tie, nodes: NDArray[np.int64], tractions: Array) -> Array:
    """The same means of the tractions of a tied boundary, (n, 3) (collective).

    A scene with tied boundaries is not cut at planes of symmetry, so there are no images.

    Parameters
    ----------
    nodes, tractions : (n,), (n, 3)
        Nodes with a traction that this rank owns.
    """
    side = _side(model, tie.body, tie.boundary)
    parts = model.comm.allgather((nodes, tractions))
    at, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    if side is None or len(at) == 0:
        return tractions
    numbers, points, areas, radii = _at_nodes(side, [_side(model, tie.other, tie.other_boundary)])
    place = _places(at, numbers)
    some = place >= 0
    found = np.zeros((len(numbers), 3))
    found[some] = _twiced(points[some], radii[some], areas[some], values[place[some]])
    return np.asarray(found[_places(numbers, nodes)])


def _places(numbers: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.int64]:
    """Positions of the wanted numbers in another list; -1 for missing numbers."""
    order = np.argsort(numbers)
    place = np.minimum(np.searchsorted(numbers[order], wanted), len(numbers) - 1)
    return np.where(numbers[order][place] == wanted, order[place], -1)


def _side(model: Model, body: int, boundary: str) -> Surface | None:
    chosen = facets_of(model.scene.bodies, model.partition, body, boundary)
    return gather_surface(model.scene, model.partition, chosen)


def _longest_edges(surface: Surface) -> Array:
    """Longest distance of neighbouring nodes on the edges of each facet, (facets,)."""
    v = surface.vertices.shape[1]
    edges = surface.vertices - np.roll(surface.vertices, 1, axis=1)
    pieces = 1 if surface.nodes.shape[1] == v else 2
    return np.asarray(np.linalg.norm(edges, axis=2).max(axis=1) / pieces)


def _at_nodes(
    surface: Surface, others: Sequence[Surface | None]
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Numbers, points and areas of the nodes of a side, by number, and the radii of their means."""
    numbers, place = np.unique(surface.nodes, return_inverse=True)
    place = place.reshape(surface.nodes.shape)
    points, areas = np.zeros((len(numbers), 3)), np.zeros(len(numbers))
    points[place] = surface.points
    longest, lengths = _longest_edges(surface), np.zeros(len(numbers))
    size = longest ** (surface.dimension - 1)
    np.add.at(areas, place, size[:, None])
    np.maximum.at(lengths, place, longest[:, None])
    for other in filter(None, others):
        nearest = cKDTree(other.centres).query(points)[1]
        lengths = np.maximum(lengths, _longest_edges(other)[nearest])
    return numbers, points, areas, REACH * lengths


def _twiced(points: Array, radii: Array, areas: Array, p: Array) -> Array:
    """M p + M(p - M p)."""
    tree = cKDTree(points)
    found = tree.query_ball_point(points, radii)
    count = np.fromiter(map(len, found), np.int64, len(found))
    row, column = np.repeat(np.arange(len(points)), count), np.concatenate(found).astype(np.int64)
    square = ((points[row] - points[column]) ** 2).sum(axis=1)
    weight = np.maximum(1.0 - square / radii[row] ** 2, 0.0) ** 2 * areas[column]
    weight /= np.bincount(row, weight, len(points))[row]
    means = sparse.csr_matrix((weight, (row, column)), shape=(len(points),) * 2)
    once = means @ p
    return np.asarray(once + means @ (p - once))
