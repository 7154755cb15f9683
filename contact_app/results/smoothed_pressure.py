"""The contact pressure without the oscillations that the facets of the mesh cause.

Where straight facets stand for a round surface, their corners press more than their middles, and
the largest pressure depends on the mesh. The mean over a little more than a facet is right. The
weights are w = (1 - |x - y|²/r²)² a(y) within r about a node x, where a(y) is the area of a node
and r is `REACH` times the longest edge of the facets there, on either side of the contact. Let M p
be the weighted mean of p and L p the value at x of the linear function that fits p best with these
weights. Inside the boundary both are nearly the same; at its ends, where nodes lie on one side
alone, L follows a pressure that rises towards the end. Both flatten a peak of p by a multiple of
r²p''; the mean of what L took away is given back,

    p_s = L p + M(p - L p)

(twicing, J. W. Tukey, *Exploratory Data Analysis*, 1977, chapter 16). Values below zero are cut
off, and the whole is scaled so that its integral is that of p. Constant pressures are exact, also
where the other body ends within the boundary: nodes beyond its edge have no weight, and those of
facets that it covers in part have the covered share of their area.
Twicing with L alone amplifies noise at the ends: the peak of a hub on a shaft was up to 20 % too
high. Adding the part that the means remove from Hertz's ellipsoid of the same force and second
moments did not help: the peak of a ball in its grooves was up to 31 % too high, where it is up to
22 % too low.

The peak is as right as the mesh allows from about six facets across the contact on, if the gap is
that of the round surfaces (`round` of a contact between bodies, or a round obstacle). With fewer,
the discrete answer itself is off, and no smoothing mends it
(`contact_app.accuracy.contact_limits.expected_error`). At sharp edges, such as the ends of a bore
on a longer pin, the pressure of the theory is infinite, and the smoothed peak grows with the mesh
as that of nodes does: a warning says so (`contact_app.accuracy.sharp_edges`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.model.model import Model
from contact_app.scene.conditions import BodyContact, Contact, RigidTie, Tie
from meshes.contact_surface import Surface

Array = NDArray[np.float64]

REACH = 1.5
"""Radius of the mean over the longest edge there. In Hertz's ball (hertz_sphere.yaml) the peak is
0.3 % too low, where single nodes are 6.7 % too high."""

THIN = 0.05
"""Variance of the places of nodes in a direction, over the largest, below which the direction leads
out of the surface. One-sided neighbourhoods, at the ends, have a quarter of the variance of others.
"""


def smoothed_pressure(
    model: Model,
    number: int,
    nodes: NDArray[np.int64],
    samples: tuple[Array, Array, Array],
) -> Array:
    """The smoothed pressure of a contact of a scene at its nodes that this rank owns, (n,).

    Collective.

    Parameters
    ----------
    number
        As `Scene.touching` counts.
    samples : (n,), (n,), (n,)
        Pressure at these nodes, integrals of their shape functions, and covered shares.
    """
    touching = model.scene.touching[number]
    sides = [_side(model, touching.body, touching.boundary)]
    if isinstance(touching, BodyContact):
        sides.append(_side(model, touching.other, touching.other_boundary))
    at_nodes = isinstance(touching, Contact) and not has_averaged_rows(
        model.scene.bodies[touching.body]
    )
    return smoothed_on(model.comm, sides, (nodes, *samples), model.partition.nodes, at_nodes)


def smoothed_on(
    comm: MPI.Intracomm,
    sides: Sequence[Surface | None],
    samples: tuple[NDArray[np.int64], Array, Array, Array],
    total: int,
    at_nodes: bool = True,
) -> Array:
    """The smoothed pressure of a contact at its nodes that this rank owns, (n,) (collective).

    Parameters
    ----------
    sides
        The facets that press, of all ranks, and those of the other body where there is one.
    samples : (n,), (n,), (n,), (n,)
        Nodes, pressure, the integrals of shape functions, and the share of the area about each node
        that the other body covers: one at obstacles.
    total
        Nodes of the mesh; k · total and more is the number of a mirror image.
    at_nodes
        Whether every node has a pressure of its own; otherwise only vertices have, and the pressure
        is linear between them.
    """
    nodes, pressure, shares, covered = samples
    some = covered > 0.0
    parts = comm.allgather((nodes[some], pressure[some], covered[some]))
    at, values, weights = (np.concatenate(part) for part in zip(*parts, strict=True))
    if sides[0] is None or not (values > 0.0).any():
        return np.zeros(len(nodes))
    numbers, points, areas, radii = _at_nodes(sides[0], sides[1:], at_nodes)
    place = _places(at, numbers % total)
    p, weight = (np.where(place >= 0, v[place], 0.0) for v in (values, weights))
    near = cKDTree(points[p > 0.0]).query(points)[0] <= 2.0 * radii
    near = np.flatnonzero(near & (weight > 0.0))
    means = np.zeros(len(numbers))
    weighted = (areas * weight)[near]
    means[near] = np.maximum(_twiced(points[near], radii[near], weighted, p[near]), 0.0)
    result = np.zeros(len(nodes))
    of_node = _places(numbers, nodes)
    result[of_node >= 0] = means[of_node[of_node >= 0]]
    areas_of_nodes = shares * covered
    before, after = comm.allreduce(np.stack([pressure, result]) @ areas_of_nodes)
    return result * (before / after) if after > 0.0 else pressure


def smoothed_tractions(
    model: Model, tie: Tie | RigidTie, nodes: NDArray[np.int64], tractions: Array
) -> Array:
    """Tractions of a tied boundary, smoothed as pressures are, (n, 3) (collective).

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
    others = [_side(model, tie.other, tie.other_boundary)] if isinstance(tie, Tie) else []
    numbers, points, areas, radii = _at_nodes(side, others, at_nodes=True)
    place = _places(at, numbers)
    some = place >= 0
    means = np.zeros((len(numbers), 3))
    means[some] = _twiced(points[some], radii[some], areas[some], values[place[some]])
    return np.asarray(means[_places(numbers, nodes)])


def _places(numbers: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.int64]:
    """Positions of the wanted numbers in another list; -1 for missing numbers."""
    order = np.argsort(numbers)
    place = np.minimum(np.searchsorted(numbers[order], wanted), len(numbers) - 1)
    return np.where(numbers[order][place] == wanted, order[place], -1)


def _side(model: Model, body: int, boundary: str) -> Surface | None:
    chosen = model.geometry.facets_of(body, boundary)
    return model.geometry.surface_of(chosen)


def _longest_edges(surface: Surface, at_nodes: bool) -> Array:
    """Longest distance of neighbouring points with a pressure on the edges of each facet."""
    v = surface.vertices.shape[1]
    edges = surface.vertices - np.roll(surface.vertices, 1, axis=1)
    pieces = 2 if at_nodes and surface.nodes.shape[1] > v else 1
    return np.asarray(np.linalg.norm(edges, axis=2).max(axis=1) / pieces)


def _at_nodes(
    surface: Surface, others: Sequence[Surface | None], at_nodes: bool
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Numbers, points and areas of the nodes of a side, by number, and the radii of their means."""
    numbers, place = np.unique(surface.nodes, return_inverse=True)
    place = place.reshape(surface.nodes.shape)
    points, areas = np.zeros((len(numbers), 3)), np.zeros(len(numbers))
    points[place] = surface.points
    longest, lengths = _longest_edges(surface, at_nodes), np.zeros(len(numbers))
    size = longest ** (surface.dimension - 1)
    np.add.at(areas, place, size[:, None])
    np.maximum.at(lengths, place, longest[:, None])
    for other in filter(None, others):
        nearest = cKDTree(other.centres).query(points)[1]
        lengths = np.maximum(lengths, _longest_edges(other, at_nodes)[nearest])
    return numbers, points, areas, REACH * lengths


def _twiced(points: Array, radii: Array, areas: Array, p: Array) -> Array:
    """L p + M(p - L p)."""
    tree = cKDTree(points)
    near = tree.query_ball_point(points, radii)
    count = np.fromiter(map(len, near), np.int64, len(near))
    row, column = np.repeat(np.arange(len(points)), count), np.concatenate(near).astype(np.int64)
    away = (points[column] - points[row]) / radii[row, None]
    weight = np.maximum(1.0 - (away**2).sum(axis=1), 0.0) ** 2 * areas[column]
    weight /= np.bincount(row, weight, len(points))[row]
    shape = (len(points),) * 2
    means = sparse.csr_matrix((weight, (row, column)), shape=shape)
    fits = sparse.csr_matrix((weight * _linear(row, weight, away), (row, column)), shape=shape)
    once = fits @ p
    return np.asarray(once + means @ (p - once))


def _linear(row: NDArray[np.int64], weight: Array, away: Array) -> Array:
    """Factors on the weights of a mean that make it the value of a linear fit, (entries,).

    With the mean m and the covariance S of the places y - x about a node, the fit has the value
    Σ w (1 - mᵀ S⁻¹ (y - x - m)) p(y) at x. Across a surface S is nearly zero and its inverse is
    left out.

    Parameters
    ----------
    row : (entries,)
        The node x of each entry.
    away : (entries, 3)
        y - x.
    """
    nodes = int(row.max()) + 1
    middle = np.stack([np.bincount(row, weight * part, nodes) for part in away.T], axis=1)
    off = away - middle[row]
    spread = np.empty((nodes, 3, 3))
    for i in range(3):
        for j in range(3):
            spread[:, i, j] = np.bincount(row, weight * off[:, i] * off[:, j], nodes)
    slopes = np.linalg.pinv(spread, rcond=THIN, hermitian=True) @ middle[..., None]
    return np.asarray(1.0 - np.einsum("ei,ei->e", slopes[row, :, 0], off))
