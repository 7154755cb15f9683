"""The largest pressure by Hertz's theory, for contacts whose facets are too coarse to show it.

The gap of the undeformed bodies about the middle of the contact forces is fitted by a quadratic,

    g ≈ c + b·x + A s² + B t²,     A ≤ B,

with s and t along the surface. For a force F and 1/E* = Σ (1 - ν²)/E, the half axes a ≥ b of the
ellipse, k = b/a and the elliptic integrals K and E of m = 1 - k² satisfy

    A/B = (K - E)/(E/k² - K),     B = p0 b (E/k² - K)/(E* m a²),     F = 2π a b p0/3,

and a line contact with the force q per length p0 = √(2 q E* B/π) (K. L. Johnson, *Contact
Mechanics*, 1985, sections 4.1 and 4.2). The force and the curvatures are right on coarse meshes,
too, where the pressure is not.

So the largest smoothed pressure of a contact with few facets across is p0. A field at nodes that
keeps the force cannot have it: with two facets across (a = h) and a node under the middle of a
ball, all others have no pressure, and the force 2π a² p0/3 makes it 2.09 p0; with the middle of a
square facet there, four nodes have p0/√2, and the force makes it 0.52 p0.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from contact_app.accuracy.contact_limits import (
    LIMITS,
    PressedFacets,
    middle_and_moments,
    pressed_facets,
)
from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.results.fields import NodeFields
from contact_app.scene.conditions import BodyContact
from meshes.arrays import Array
from meshes.quadratic import FACETS
from solver.tfeti.dual import DualProblem
from solver.vectors import largest_magnitude

HalfSpaces = Callable[[Array, Array], tuple[float, float] | None]

REACH = 3.0
"""Radius about the middle of the contact within which gaps are fitted, over a facet's longest edge.
It has some 25 nodes of quadrilaterals for the six coefficients."""

SLENDER, ROUND = 0.03, 1e-6
"""Ratio of the axes of an ellipse up to which the contact is taken for that of a roller, and its
difference from one up to which it is taken for that of a ball."""

LARGER = 1.5
"""Half length of the contact, less a facet, over Hertz's, or the other way round, from which on it
is no contact of his kind: an edge or a flat face has no curvature, and his would be larger."""

MISFIT = 0.02
"""Largest root of the mean squared misfit over the range of the gaps. Flat facets of round surfaces
have a larger one, and their curvature is not that of the surface."""

FREE = 1.25
"""Least distance of the middle of a contact from the end of its boundary, over half its length, and
least thickness of the bodies over its smaller width. The peak of layers is 18 % higher with a half
of it, and 7 % with 4/5; that at an edge of a block 11 % higher with 4/5."""

EDGE = 1e-6
"""Distance from the edge of a facet, in its size, at which a line still meets it."""

LARGE_ERROR = 0.2
"""Error to expect of the largest smoothed pressure from which on Hertz's replaces it."""


@dataclass(frozen=True)
class CoarsePressure:
    """A contact with few facets across its narrow side."""

    warning: str
    """A sentence without the name of the contact."""

    peak: float | None
    """Hertz's largest pressure where it replaces that of the smoothed field; None elsewhere."""


def coarse_pressures(
    model: Model, nodes: NodeFields, pressed: Sequence[bool]
) -> list[CoarsePressure | None]:
    """Contacts of a scene with few facets across; None for the others (collective).

    Parameters
    ----------
    pressed
        Whether each contact carries a force.
    """
    every = list[CoarsePressure | None]()
    for i, facets in enumerate(pressed_facets(model, nodes)):
        contact = nodes.contacts[i]
        at = nodes.points[contact.nodes - nodes.first], contact.forces, contact.smoothed
        half_spaces = partial(_half_spaces, model.geometry, model.scene.plane, i)
        of_contact = model.problem, i, at, facets, half_spaces
        every.append(coarse_pressure(*of_contact) if pressed[i] else None)
    return every


def _half_spaces(
    geometry: Geometry, plane: str | None, number: int, middle: Array, normal: Array
) -> tuple[float, float] | None:
    """E* of the bodies of a contact, and the least of their thicknesses behind its middle (3,).

    None if one has several materials (collective). The normal has shape (d,).
    """
    touching = geometry.touching[number]
    bodies = [touching.body, *([touching.other] if isinstance(touching, BodyContact) else [])]
    materials = [set(geometry.bodies[b].materials) for b in bodies]
    if any(len(of_body) > 1 for of_body in materials):
        return None
    across = 0.0 if plane == "stress" else 1.0
    surfaces = [
        [
            s.points()[s.reference.facets[s.exterior]]
            for s in geometry.partition.subdomains
            if s.body == b
        ]
        for b in bodies
    ]
    thickness = min(thickness_at(geometry.comm, facets, middle, normal) for facets in surfaces)
    modulus = 1.0 / sum((1.0 - across * m.poisson**2) / m.young for (m,) in materials)
    return modulus, thickness


def thickness_at(
    comm: MPI.Intracomm, surface: Sequence[Array], middle: Array, normal: Array
) -> float:
    """Distance through a body along a line that enters it near a point of its surface (collective).

    It follows walls of any direction, also of a tube. Infinite if the line misses the body.

    Parameters
    ----------
    surface : each (facets, nodes, 3)
        Facets of this rank.
    normal : (d,)
        Direction of the line; its sign does not matter.
    """
    d, parts = len(normal), [np.zeros(0)]
    along = np.linalg.svd(normal[None])[2][1:]
    for points in surface:
        if not points.size:
            continue
        vertices = FACETS[d, points.shape[1]].vertices
        away = points[:, :vertices, :d] - middle[:d]
        size = EDGE * np.ptp(away, axis=1).max()
        simplices = np.concatenate([away[:, i : i + d] for i in range(vertices - d + 1)])
        off = simplices @ along.T
        simplices = simplices[
            (off.min(axis=1) <= size).all(axis=1) & (off.max(axis=1) >= -size).all(axis=1)
        ]
        system = np.append(simplices @ along.T, np.ones((len(simplices), d, 1)), axis=2)
        across = np.abs(np.linalg.det(system)) > size ** (d - 1)
        right = np.broadcast_to(np.append(np.zeros(d - 1), 1.0)[:, None], (across.sum(), d, 1))
        shares = np.linalg.solve(system[across].transpose(0, 2, 1), right)[..., 0]
        places = (shares * (simplices[across] @ normal)).sum(axis=1)
        parts.append(places[shares.min(axis=1, initial=1.0) >= -EDGE])
    at = np.sort(np.concatenate(comm.allgather(np.concatenate(parts))))
    if not len(at):
        return np.inf
    distances = np.abs(at - at[np.abs(at).argmin()])
    return float(distances[distances > EDGE * np.ptp(at)].min(initial=np.inf))


def coarse_pressure(
    problem: DualProblem,
    number: int,
    contact: tuple[Array, Array, Array],
    facets: PressedFacets,
    half_spaces: HalfSpaces,
) -> CoarsePressure | None:
    """The largest pressure of a contact that varies within facets; None if it has enough of them.

    With three facets and more Hertz's replaces the smoothed one if they differ by no more than the
    error to expect (collective).

    Parameters
    ----------
    contact : (n, 3), (n, 3), (n,)
        Places of the nodes of the boundary, forces, and the smoothed pressure.
    half_spaces
        Function of the middle and the normal of a contact that returns E* of the bodies and the
        least of their thicknesses there; None if one is of several materials (collective).
    """
    comm, d = problem.comm, problem.dimension
    across, narrow = facets.across(comm, d), facets.across_narrow_side(comm, d)
    if narrow >= LIMITS.enough_facets:
        return None
    error, smoothed = expected_error(narrow), largest_magnitude(comm, contact[2])
    hertz = hertz_peak(problem, number, contact, facets, half_spaces)
    few, agrees = narrow < LIMITS.fewest_facets, False
    if hertz is not None:
        agrees = error > LARGE_ERROR and abs(smoothed - hertz) <= error * hertz
    peak = hertz if few or agrees else None
    name = "max_smoothed_pressure" if peak is None else "the smoothed field"
    if few:
        place = f"only about {max(across, 1.0):.0f} across carry the contact"
        if across >= LIMITS.fewest_facets:
            length = max(facets.along_axes(comm))
            place = f"about {narrow:.1f} facets lie across the narrow side of the contact and "
            place += f"{length:.0f} along it"
        text = f"the pressure varies within single facets: {place}; the largest pressure depends "
        text += f"on the mesh, and {name} may be wrong by half or more, too"
    else:
        text = f"the pressure varies as that of Hertz's contact with only about {narrow:.1f} facets"
        text += f" across: {name} may be {100.0 * error:.0f} % off, more where the pressure is "
        text += "singular, and the pressure of single nodes more"
    if hertz is not None:
        text += "; for bodies large beside the contact Hertz's theory gives "
        text += f"{hertz:.4g}" if peak is None else f"max_smoothed_pressure, {hertz:.4g}"
    return CoarsePressure(f"{text}; use smaller cells there", peak)


def expected_error(across: float) -> float:
    """Relative error to expect of the largest smoothed pressure, by facets across the contact."""
    return LIMITS.peak_error * (LIMITS.fewest_facets / across) ** LIMITS.order


def hertz_peak(
    problem: DualProblem,
    number: int,
    contact: tuple[Array, Array, Array],
    facets: PressedFacets,
    half_spaces: HalfSpaces,
) -> float | None:
    """Hertz's largest pressure of a contact with a force; parameters as of `coarse_pressure`.

    None where the contact is not of his kind: of other size than the theory says, with a gap that
    is no quadratic, near the end of its boundary, or at bodies that are thin or of several
    materials (collective).
    """
    comm, d, rows, (places, forces, _) = problem.comm, problem.dimension, problem.contact, contact
    if largest_magnitude(comm, forces) ** 2 == 0.0:  # as are the squares of such forces
        return None
    loaded = facets.corners[(facets.pressure > 0.0).any(axis=1)]
    edges = np.linalg.norm(loaded - np.roll(loaded, 1, axis=1), axis=2)
    size = comm.allreduce(float(edges.max(initial=0.0)), op=MPI.MAX)
    planes = facets.planes_at_end(comm)
    resultant = comm.allreduce(forces.sum(axis=0))
    resultant[[axis for axis, _ in planes]] = 0.0
    force = float(np.linalg.norm(resultant)) * 2 ** len(planes)
    amounts = np.linalg.norm(forces, axis=1)
    middle, moment = middle_and_moments(comm, places, amounts, planes)
    away = np.linalg.norm(rows.points - middle, axis=1)
    near = away < (1.0 - LIMITS.reaches) * REACH * size  # on both sides or none
    near &= rows.sources == number
    parts = comm.allgather((rows.points[near] - middle, rows.gaps[near], rows.normals[near]))
    points, gaps, normals = (np.concatenate(part) for part in zip(*parts, strict=True))
    away = places - middle
    for axis, _ in planes:
        away = np.concatenate([away, away * _mirror(axis)])
        beyond = np.abs(points[:, axis]) > LIMITS.reaches * size
        points = np.concatenate([points, points[beyond] * _mirror(axis)])
        gaps = np.concatenate([gaps, gaps[beyond]])
        normals[~beyond, axis] = 0.0
        normals = np.concatenate([normals, normals[beyond] * _mirror(axis)[:d]])
    total = normals.sum(axis=0)
    if np.linalg.norm(total) <= LIMITS.reaches * len(normals):
        return None
    normal, *tangents = np.linalg.svd(total[None])[2]
    along = np.array(tangents)
    points, gaps = _between(points, gaps, normals, normal)
    bends, axes = _curvatures(points[:, :d] @ along.T / (REACH * size), gaps)
    if not bends[0] > 0.0:  # nor if it is no number
        return None
    lengths = np.sqrt(np.maximum(np.linalg.eigvalsh(along @ moment[:d, :d] @ along.T), 0.0))
    off = away[:, :d] @ (axes.T @ along).T
    ends = np.stack([off.max(axis=0, initial=0.0), -off.min(axis=0, initial=0.0)])
    room = np.min(np.max(comm.allgather(ends), axis=0), axis=0)
    spaces = half_spaces(middle, normal)
    if spaces is None:
        return None
    room = np.append(room, 0.5 * spaces[1])
    return peak_of(force, spaces[0], bends / (REACH * size) ** 2, lengths, size, room)


def _between(points: Array, gaps: Array, normals: Array, normal: Array) -> tuple[Array, Array]:
    """Middles of the lines from nodes to the other surface, and gaps along the mean normal.

    A gap is the length of this line. Under a ball the mean of it and of its part along the normal
    is that of the paraboloid, but for the fourth power of the distance over the radius R: a contact
    of one facet of R/4 has a peak 1.8 instead of 10 % too low, and of R/8 0.1 instead of 3 %.
    """
    d = normals.shape[1]
    middles = points.copy()
    middles[:, :d] -= 0.5 * gaps[:, None] * normals
    return middles, 0.5 * gaps * (1.0 + np.abs(normals @ normal))


def _mirror(axis: int) -> Array:
    return np.where(np.arange(3) == axis, -1.0, 1.0)


def _curvatures(points: Array, gaps: Array) -> tuple[Array, Array]:
    """Coefficients of s² and t², descending, of the gaps at points (n, d - 1) in the unit disc.

    NaN where the gap is no quadratic, or has too few points. The columns of a matrix
    (d - 1, d - 1) are the axes.
    """
    columns = points.T
    squares = [a * b for i, a in enumerate(columns) for b in columns[i:]]
    terms = np.stack([np.ones(len(gaps)), *columns, *squares], axis=1)
    weight = 1.0 - (points**2).sum(axis=1)
    fitted, _, rank, _ = np.linalg.lstsq(terms * weight[:, None], gaps * weight, rcond=None)
    off = (terms @ fitted - gaps) * weight
    if rank < terms.shape[1] or off @ off > len(off) * (MISFIT * np.ptp(gaps)) ** 2:
        return np.full(len(columns), np.nan), np.eye(len(columns))
    if len(columns) == 1:
        return fitted[-1:], np.eye(1)
    aa, ab, bb = fitted[-3:]
    bends, axes = np.linalg.eigh([[aa, ab / 2.0], [ab / 2.0, bb]])
    return bends[::-1], axes[:, ::-1]


def peak_of(
    force: float, modulus: float, bends: Array, lengths: Array, size: float, room: Array
) -> float | None:
    """Hertz's pressure; None for a contact of other size, and where it lacks room.

    Parameters
    ----------
    bends : (d - 1,)
        Coefficients of the gap, descending.
    lengths : (d - 1,)
        Roots of the second moments of the pressure over its force, ascending: half lengths over √5
        of an ellipsoid, over 2 of a half ellipse on a line, over √3 of a constant.
    size
        Of the facets, which is the error of lengths.
    room : (d,)
        Distances of its middle from the end of the boundary along both axes, and half the thickness
        of the bodies.
    """
    low, high = bends[-1] / bends[0], bends[0]
    if len(bends) == 2 and low > _quotient(SLENDER):
        k = 1.0 - ROUND
        if low < _quotient(k):
            k = brentq(lambda k: np.log(_quotient(k) / low), SLENDER, k)
        a = (1.5 * force * _integrals(k)[1] / (np.pi * modulus * high * (1.0 - k * k))) ** (1 / 3)
        peak, half, factor = 1.5 * force / (np.pi * k * a**2), a * np.array([k, 1.0]), 5.0**0.5
    else:
        length = np.sqrt(12.0) * lengths[-1] if len(bends) == 2 else 1.0
        if low < -_quotient(SLENDER) or (len(bends) == 2 and length < 2.0 * size):
            return None
        peak = np.sqrt(2.0 * force / length * modulus * high / np.pi)
        half, factor = np.array([peak / (modulus * high), np.inf][: len(bends)]), 2.0
    observed, finite = factor * lengths, np.isfinite(half)
    close = observed < LARGER * half + size
    close[finite] &= half[finite] < LARGER * observed[finite] + size
    close[finite] &= (FREE * half <= room[:-1])[finite] & (FREE * half[0] <= room[-1])
    return float(peak) if close.all() else None


def _quotient(k: float) -> float:
    """A/B of an ellipse with the half axes a and k a."""
    upper, lower = _integrals(k)
    return upper / lower


def _integrals(k: float) -> tuple[float, float]:
    """K - E and E/k² - K."""
    first, second = ellipk(1.0 - k * k), ellipe(1.0 - k * k)
    return float(first - second), float(second / k**2 - first)
