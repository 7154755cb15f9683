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

It is right where the contact is several facets wide and the gap is that of the round surfaces
(`round` of a contact between bodies, or a round obstacle). It is too low where three facets or
fewer carry the contact, and at corners, where the pressure itself is singular.
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
from contact_app.scene.conditions import BodyContact
from meshes.contact_surface import Surface

Array = NDArray[np.float64]

REACH = 1.5
"""Radius of the mean over the longest edge there. In a shrink fit of tetrahedra (hub_on_shaft.yaml
with degree 1 and `round`) the peak is 202 with 1.25, 149 with 1.5 and 128 with 2; degree 2 has 149.
In Hertz's ball (hertz_sphere.yaml) it is 0.4 % too low with 1.5, where single nodes are 6.7 % too
high."""


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
    numbers, points, areas, lengths = _at_nodes(sides[0])
    for other in filter(None, sides[1:]):
        nearest = cKDTree(other.centres).query(points)[1]
        lengths = np.maximum(lengths, _longest_edges(other)[nearest])
    original = numbers % total
    order = np.argsort(at)
    place = np.minimum(np.searchsorted(at[order], original), len(at) - 1)
    p = np.where(at[order][place] == original, values[order][place], 0.0)
    radii = REACH * lengths
    near = np.flatnonzero(cKDTree(points[p > 0.0]).query(points)[0] <= 2.0 * radii)
    found = np.zeros(len(numbers))
    found[near] = _twiced(points[near], radii[near], areas[near], p[near])
    result = np.zeros(len(nodes))
    mine = np.searchsorted(numbers, nodes)
    mine = np.minimum(mine, len(numbers) - 1)
    of_side = numbers[mine] == nodes
    result[of_side] = found[mine[of_side]]
    before, after = comm.allreduce(np.array([shares @ pressure, shares @ result]))
    return result * (before / after) if after > 0.0 else pressure


def _side(model: Model, body: int, boundary: str) -> Surface | None:
    chosen = facets_of(model.scene.bodies, model.partition, body, boundary)
    return gather_surface(model.scene, model.partition, chosen)


def _longest_edges(surface: Surface) -> Array:
    """Longest distance of neighbouring nodes on the edges of each facet, (facets,)."""
    v = surface.vertices.shape[1]
    edges = surface.vertices - np.roll(surface.vertices, 1, axis=1)
    pieces = 1 if surface.nodes.shape[1] == v else 2
    return np.asarray(np.linalg.norm(edges, axis=2).max(axis=1) / pieces)


def _at_nodes(surface: Surface) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Numbers, points, areas and longest edges of the facets about each node, by number."""
    numbers, place = np.unique(surface.nodes, return_inverse=True)
    place = place.reshape(surface.nodes.shape)
    points, areas = np.zeros((len(numbers), 3)), np.zeros(len(numbers))
    points[place] = surface.points
    longest, lengths = _longest_edges(surface), np.zeros(len(numbers))
    size = longest ** (surface.dimension - 1)
    np.add.at(areas, place, size[:, None])
    np.maximum.at(lengths, place, longest[:, None])
    return numbers, points, areas, lengths


def _twiced(points: Array, radii: Array, areas: Array, p: Array) -> Array:
    """M p + M(p - M p), nowhere below zero."""
    tree = cKDTree(points)
    found = tree.query_ball_point(points, radii)
    count = np.fromiter(map(len, found), np.int64, len(found))
    row, column = np.repeat(np.arange(len(points)), count), np.concatenate(found).astype(np.int64)
    square = ((points[row] - points[column]) ** 2).sum(axis=1)
    weight = np.maximum(1.0 - square / radii[row] ** 2, 0.0) ** 2 * areas[column]
    weight /= np.bincount(row, weight, len(points))[row]
    means = sparse.csr_matrix((weight, (row, column)), shape=(len(points),) * 2)
    once = means @ p
    return np.asarray(np.maximum(once + means @ (p - once), 0.0))
