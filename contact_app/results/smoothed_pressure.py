"""The contact pressure without the oscillations that the facets of the mesh cause.

Where straight facets stand for a round surface, their corners press more than their middles, and
the largest pressure depends on the mesh. The square of the smoothed pressure at a node x is the
value at x of a quadratic function that is fitted to the squared pressures of the nodes y about x.
Squares are fitted, since Hertz's pressure is the root of a quadratic function in contacts of any
shape,

    p² = p0² (1 - x²/a² - y²/b²),

so that a few nodes on one side of a node determine the peak, and the steep fall at the edge, too.
Constant and linear pressures are also such roots. The weights of the fit are

    w = (1 - |x - y|²/r²)² a(y),     w / (p(y)² + 2 m)²,     m = Σ w p² / Σ w,

with the area a(y) of a node, and r, which is `REACH` times the longest edge of the facets there, on
either side of the contact. The second factor keeps the pressure at a singular edge out of the fits
about other nodes. Where pressures alternate between nodes, the squares are too large. So the roots
s are multiplied by the quotient of the means of p and s with the weights w, and at last the whole
is scaled so that its integral is that of p.

The function is a quadratic inside the contact alone. Closed nodes count in full, open nodes if
closed ones surround them: up to `AMID` the mean place of the closed nodes about them, in r, and not
from `BEYOND` on. Beyond the contact the smoothed pressure is zero. Nodes beyond the edge of the
other body have no weight, and nodes of facets that it covers in part have the covered share of
their area. At a plane of symmetry the mirror images of nodes take part, also where a body ends at a
plane whose normal displacement is zero.

Compared were roots without the second factor or without the quotient, quadratics fitted to p
itself, and linear functions fitted to p with the mean of the rest added again (twicing, J. W.
Tukey, *Exploratory Data Analysis*, 1977, chapter 16). In Hertz's contacts with four facets across,
on all kinds of cells, twicing has 1.6 times the error in the mean square and peaks up to 31 % too
high, quadratics fitted to p peaks up to 16 % too high. Without the second factor the pressure next
to the edge of a flat punch is up to three times as wrong.

The peak is as right as the mesh allows from about four facets across the contact on, if the gap is
that of the round surfaces (`round` of a contact between bodies, or a round obstacle). With fewer,
the discrete answer itself is off, and no smoothing mends it
(`contact_app.accuracy.hertz`). At sharp edges, such as the ends of a bore
on a longer pin, the pressure of the theory is infinite, and the smoothed peak grows with the mesh
as that of nodes does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.model.boundaries import boundary_nodes
from contact_app.model.geometry import Geometry
from contact_app.model.planes import ON_PLANE
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import BodyContact, Contact, DisplacementCondition, RigidTie, Tie
from meshes.arrays import Array, Ints
from meshes.contact_surface import Surface
from meshes.pseudo_inverses import pseudo_inverses

REACH = 2.25
"""Radius about a node over the longest edge there. With 2 the peaks of a ball in its grooves with
two facets across are up to 24 % too high, with 2.5 those of Hertz's contacts with four facets are
up to 6 % too low."""

AMID, BEYOND = 0.2, 0.4
"""Distance, in radii, of an open node from the mean place of closed nodes about it up to which it
counts as a node of the contact, and from which on it lies beyond. It is 0.46 for the first open
node beside a straight edge. Peaks change by 1 % with 0.1 or 0.3 in place of 0.2."""

AT_PLANE = 0.1
"""Weight of the node at a plane of symmetry with triangles of degree 1. There the triangles and
their images alternate in direction, and the force of the node is wrong by some h/2a, a half the
width of the contact. Peaks of half models with four facets and more are up to 8 % too high with it,
and up to 12 % without."""

CURVATURE = 1e-3
"""Added to the mean squares of the quadratic terms, which are some 0.03 with many nodes about: few
nodes determine a linear function rather than a quadratic one."""

NOUGHT = 1e-60
"""Square of a pressure, over that of the largest, below which it counts as zero."""

THIN = 0.05
"""Variance of the places of nodes in a direction, over the largest, below which the direction leads
out of the surface. One-sided neighbourhoods, at the ends, have a quarter of the variance of others.
"""


def smoothed_pressure(
    geometry: Geometry,
    number: int,
    planes: Sequence[tuple[int, float]],
    nodes: Ints,
    samples: tuple[Array, Array, Array],
) -> Array:
    """The smoothed pressure of a contact of a scene at its nodes that this rank owns, (n,).

    Collective.

    Parameters
    ----------
    number
        As `Geometry.touching` counts.
    planes
        As `symmetry_planes` finds them.
    samples : (n,), (n,), (n,)
        Pressure at these nodes, integrals of their shape functions, and covered shares.
    """
    touching, surface = geometry.touching[number], geometry.boundary_surface
    sides = [surface(touching.body, touching.boundary)]
    if isinstance(touching, BodyContact):
        sides.append(surface(touching.other, touching.other_boundary))
    at_nodes = isinstance(touching, Contact) and not has_averaged_rows(
        geometry.bodies[touching.body]
    )
    total = geometry.partition.nodes
    stiff = any(_has_stiff_corners(geometry.bodies[k]) for k in _bodies(touching))
    weighted = [(*plane, AT_PLANE if stiff else 1.0) for plane in planes]
    return smoothed_on(geometry.comm, sides, (nodes, *samples), total, at_nodes, weighted)


def symmetry_planes(
    geometry: Geometry, displacements: Sequence[DisplacementCondition], number: int
) -> list[tuple[int, float]]:
    """Axis and place of the planes along which the bodies of a contact slide (collective).

    Parameters
    ----------
    number
        As `Geometry.touching` counts.
    """
    bodies = _bodies(geometry.touching[number])
    return sorted(set.intersection(*(_planes(geometry, displacements, k) for k in bodies)))


def _bodies(touching: Contact | BodyContact) -> list[int]:
    return [touching.body, *([touching.other] if isinstance(touching, BodyContact) else [])]


def _has_stiff_corners(body: Body) -> bool:
    return body.mesh.cell == "triangle" and body.degree == 1


def smoothed_on(
    comm: MPI.Intracomm,
    sides: Sequence[Surface | None],
    samples: tuple[Ints, Array, Array, Array],
    total: int,
    at_nodes: bool = True,
    planes: Sequence[tuple[int, float, float]] = (),
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
    planes
        Axis and place of planes of symmetry of the contact, and the weight of the nodes on them;
        those at which it does not end count for nothing.
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
    near = cKDTree(points[p > 0.0]).query(points)[0] <= radii
    near = np.flatnonzero(near & (weight > 0.0))
    smoothed = np.zeros(len(numbers))
    whole = _with_images(planes, points[near], radii[near], (areas * weight)[near], p[near])
    smoothed[near] = _smoothed(*whole)[: len(near)]
    result = np.zeros(len(nodes))
    of_node = _places(numbers, nodes)
    result[of_node >= 0] = smoothed[of_node[of_node >= 0]]
    areas_of_nodes = shares * covered
    before, after = comm.allreduce(np.stack([pressure, result]) @ areas_of_nodes)
    return result * (before / after) if after > 0.0 else pressure


def smoothed_tractions(
    geometry: Geometry, tie: Tie | RigidTie, nodes: Ints, tractions: Array
) -> Array:
    """Quadratics fitted to the tractions of a tied boundary, (n, 3) (collective).

    A scene with tied boundaries is not cut at planes of symmetry, so there are no images.

    Parameters
    ----------
    nodes, tractions : (n,), (n, 3)
        Nodes with a traction that this rank owns.
    """
    surface = geometry.boundary_surface
    side = surface(tie.body, tie.boundary)
    parts = geometry.comm.allgather((nodes, tractions))
    at, values = (np.concatenate(part) for part in zip(*parts, strict=True))
    if side is None or len(at) == 0:
        return tractions
    others = [surface(tie.other, tie.other_boundary)] if isinstance(tie, Tie) else []
    numbers, points, areas, radii = _at_nodes(side, others, at_nodes=True)
    place = _places(at, numbers)
    some = place >= 0
    fitted = np.zeros((len(numbers), 3))
    near = _Neighbours.of(points[some], radii[some], areas[some])
    fitted[some] = near.fit(values[place[some]])
    return np.asarray(fitted[_places(numbers, nodes)])


def _places(numbers: Ints, wanted: Ints) -> Ints:
    """Positions of the wanted numbers in another list; -1 for missing numbers."""
    order = np.argsort(numbers)
    place = np.minimum(np.searchsorted(numbers[order], wanted), len(numbers) - 1)
    return np.where(numbers[order][place] == wanted, order[place], -1)


def _planes(
    geometry: Geometry, displacements: Sequence[DisplacementCondition], body: int
) -> set[tuple[int, float]]:
    """Axis and place of planes along which a body slides by its displacement conditions.

    Collective.
    """
    planes, size = set(), geometry.length
    for condition in displacements:
        held = [axis for axis, value in enumerate(condition.values) if value is not None]
        if condition.body != body or len(held) != 1 or condition.values[held[0]] != 0.0:
            continue
        places = [
            s.points()[boundary_nodes(s, geometry.bodies[body], condition.boundary), held[0]]
            for s in geometry.partition.subdomains
            if s.body == body
        ]
        gathered = np.concatenate(geometry.comm.allgather(np.concatenate([np.zeros(0), *places])))
        if len(gathered) and np.ptp(gathered) <= ON_PLANE * size:
            planes.add((held[0], round(float(gathered[0]) / size, 9) * size))
    return planes


def _with_images(
    planes: Sequence[tuple[int, float, float]], points: Array, radii: Array, areas: Array, p: Array
) -> tuple[Array, Array, Array, Array]:
    """Points, radii, areas and pressures, followed by those of mirror images at the planes."""
    for axis, place, weight in planes:
        off = points[:, axis] - place
        on = np.abs(off) <= 1e-6 * radii
        if not ((off > 0.0) | on).all() and not ((off < 0.0) | on).all():
            continue  # the contact goes on beyond the plane
        near, images = ~on & (np.abs(off) <= 2.0 * radii), points.copy()
        images[:, axis] -= 2.0 * off
        points = np.concatenate([points, images[near]])
        areas = np.concatenate([np.where(on, 2.0 * weight, 1.0) * areas, areas[near]])
        radii, p = (np.concatenate([v, v[near]]) for v in (radii, p))
    return points, radii, areas, p


def _longest_edges(surface: Surface, at_nodes: bool) -> Array:
    """Longest distance of neighbouring points with a pressure on the edges of each facet."""
    v = surface.vertices.shape[1]
    edges = surface.vertices - np.roll(surface.vertices, 1, axis=1)
    pieces = 2 if at_nodes and surface.nodes.shape[1] > v else 1
    return np.asarray(np.linalg.norm(edges, axis=2).max(axis=1) / pieces)


def _at_nodes(
    surface: Surface, others: Sequence[Surface | None], at_nodes: bool
) -> tuple[Ints, Array, Array, Array]:
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


def _smoothed(points: Array, radii: Array, areas: Array, p: Array) -> Array:
    """Roots of the quadratics that fit squared pressures p (n,); 0 beyond the contact."""
    near = _Neighbours.of(points, radii, areas)
    scale = np.ldexp(1.0, np.frexp(p.max(initial=0.0))[1])  # fourth powers of tiny ones are zero
    p = p / scale
    closed = near.of_weights(near.weight * (p[near.column] > 0.0))
    share = np.clip((BEYOND - np.linalg.norm(closed.middle, axis=1)) / (BEYOND - AMID), 0.0, 1.0)
    share = np.where(p > 0.0, 1.0, np.where(closed.total > 0.0, share, 0.0))
    near = near.of_weights(near.weight * share[near.column])
    square = p[near.column] ** 2
    size = square + 2.0 * near.means(square)[near.row]
    weight = near.weight / np.where(size > NOUGHT, size, 1.0) ** 2
    squares = near.of_weights(weight).fit(p**2)
    root = np.where(share > 0.0, np.sqrt(np.maximum(squares, 0.0)), 0.0)
    mean, right = (near.means(v[near.column]) for v in (root, p))
    smooth = root * np.divide(right, mean, out=np.zeros(len(p)), where=mean > 0.0)
    return np.asarray(smooth * scale)


@dataclass(frozen=True, eq=False)
class _Neighbours:
    """The nodes within the radius about each of n nodes, with weights."""

    row: Ints
    column: Ints
    """The node x of an entry, and its neighbour y. Shapes (entries,), (entries,)."""
    away: Array  # (entries, 3)
    """(y - x)/r."""
    weight: Array  # (entries,)
    total: Array  # (n,)
    """Sums of the weights."""

    @classmethod
    def of(cls, points: Array, radii: Array, areas: Array) -> "_Neighbours":
        """The neighbours of points (n, 3) with radii (n,) and areas (n,)."""
        near = cKDTree(points).query_ball_point(points, radii)
        count = np.fromiter(map(len, near), np.int64, len(near))
        row = np.repeat(np.arange(len(points)), count)
        column = np.fromiter(chain.from_iterable(near), np.int64, count.sum())
        away = (points[column] - points[row]) / radii[row, None]
        weight = np.maximum(1.0 - (away**2).sum(axis=1), 0.0) ** 2 * areas[column]
        return cls(row, column, away, weight, np.asarray(np.bincount(row, weight), float))

    def of_weights(self, weight: Array) -> "_Neighbours":
        """The same with other weights (entries,)."""
        return replace(self, weight=weight, total=np.asarray(np.bincount(self.row, weight), float))

    def means(self, values: Array) -> Array:
        """Weighted means of values (entries,) about the nodes, (n,); 0 without weights."""
        sums = np.bincount(self.row, self.weight * values)
        return np.divide(sums, self.total, out=np.zeros(len(sums)), where=self.total > 0.0)

    @property
    def middle(self) -> Array:
        """Mean place of the neighbours, seen from the node, in radii, (n, 3)."""
        return np.stack([self.means(part) for part in self.away.T], axis=1)

    def fit(self, values: Array) -> Array:
        """Values at the nodes of quadratics on the surface that fit values, (n,) or (n, c)."""
        terms = self._quadratic_terms()
        squares = np.empty((len(self.total), len(terms), len(terms)))
        for i, first in enumerate(terms):
            for j, second in enumerate(terms[: i + 1]):
                squares[:, i, j] = squares[:, j, i] = self.means(first * second)
        squares[:, 3:, 3:] += CURVATURE * np.eye(3)
        inverse = pseudo_inverses(squares, 1e-8)[:, 0]
        factors = np.einsum("et,te->e", inverse[self.row], terms)
        columns = [self.means(factors * part[self.column]) for part in np.atleast_2d(values.T)]
        return np.asarray(np.stack(columns, axis=-1).reshape(values.shape))

    def _quadratic_terms(self) -> Array:
        """1, s, t, s², st, t² at the neighbours, (6, entries), s and t along the surface.

        The surface of a body in the plane, or a row of nodes, has one direction; s is 0 then.
        """
        middle = self.middle
        off, spread = self.away - middle[self.row], np.empty((len(middle), 3, 3))
        for i in range(3):
            for j in range(i + 1):
                spread[:, i, j] = spread[:, j, i] = self.means(off[:, i] * off[:, j])
        variances, axes = np.linalg.eigh(spread)
        axes = np.where((variances > THIN * variances[:, -1:])[:, None], axes, 0.0)
        s, t = np.einsum("ei,eik->ke", self.away, axes[self.row][..., 1:])
        return np.stack([np.ones(len(s)), s, t, s * s, s * t, t * t])
