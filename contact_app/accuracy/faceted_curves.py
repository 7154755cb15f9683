"""Distance of the straight edges of a round body from the curve through its corners.

Nodes in the middle of such edges (degree 2, or after refinement) lie off the curve by the sagitta,
h θ/8 for edges of length h at an angle θ. The sagitta is negligible if displacements are much
larger. If they are smaller, only the corners touch (inside a hole only the middles), and the
solution is that of the polygon.

With `round: true` the gap is that of the smooth surface through the vertices. It has its own
distance from the curve, estimated by the change of its curvature from facet to facet.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.model.pairs import sides_of
from contact_app.results.fields import NodeFields
from contact_app.results.percent import percent
from contact_app.scene.bodies import Body
from contact_app.scene.finer_meshes import facets_on
from meshes import CellMesh
from meshes.arrays import Array, Ints
from meshes.contact_surface import Surface
from solver.contact.solution import Solution

SMOOTH = np.deg2rad(30.0)
"""Angle between facets above which their edge is not part of a round surface."""

LARGE_SAGITTA = 0.05
"""Sagitta relative to the largest displacement from which on the solution is that of the
polygon."""

FITTED = 0.05
"""Median gap relative to the sagitta below which facets coincide, as on matching meshes."""

FITTED_SMOOTH = 1.0
"""The same for smooth surfaces, relative to their own distance from the curve: the median gap of
cones that fit into each other was 0.05 to 0.53 of it on meshes of 16 to 28 facets around."""

SMOOTH_SURFACE = 0.01
"""Distance of a smooth surface through the nodes from cylinders and balls, over the sagitta of
facets. Rings with 8 and 12 facets on a quarter that overlap by 1/48, 1/16, 1/5 and 1/1.6 of their
sagitta have peaks of the smoothed pressure that are 61, 20, 6 and 2 % too large; with 16 and 24
facets half as much (`tests/contact_app/run/test_model_warnings.py` has the rings)."""

Watched = tuple[Array, Array]

FLAT = 1e-6
"""Angle below which facets lie in one plane."""

MATCHING = 0.05
"""Offset of opposite vertices along the surface, over the radius of a facet, up to which facets
match. The gap between them then varies by at most a tenth of the sagitta."""


class Distances(NamedTuple):
    """Largest distances from the round surface near a contact."""

    facets: float = 0.0
    """Distance of flat facets: the sagitta."""
    smooth: float = 0.0
    """Distance of the smooth surface through their vertices, an estimate; zero without `round:
    true`."""

    def or_larger(self, other: "Distances") -> "Distances":
        """The larger one of each."""
        return Distances(*map(max, self, other))


def sagittas(geometry: Geometry, nodes: NodeFields) -> list[float]:
    """Largest sagitta near each obstacle of a body with straight edges (collective).

    Zero for boxes, for bodies with curved edges, and for bodies of degree 1 without halved edges.
    """
    straight = {c.body for c in geometry.contacts if _straight(geometry.bodies[c.body])}
    if not straight:
        return [0.0] * len(geometry.contacts)
    has_gap = np.isfinite(nodes.gap)
    parts = geometry.comm.allgather((nodes.points[has_gap], nodes.gap[has_gap]))
    points, gaps = (np.concatenate(part) for part in zip(*parts, strict=True))
    return [
        _distances(geometry.bodies[c.body], c.boundary, (points, gaps), False).facets
        if c.body in straight
        else 0.0
        for c in geometry.contacts
    ]


def polygon_solved(geometry: Geometry, solution: Solution, nodes: NodeFields) -> str:
    """The reason why finer cells do not converge for round bodies that touch each other.

    Empty if they do converge. Halved edges stay on the original straight edges: the bodies remain
    polygons whose corners press into flat facets, however fine the cells. With `round: true` they
    lie on the curve (collective).
    """
    moved = solution.measures.deformations
    for pair, distances in zip(geometry.pairs, pair_distances(geometry, nodes), strict=True):
        largest, sagitta = max(moved[pair.body], moved[pair.other]), distances.facets
        if sagitta > LARGE_SAGITTA * largest > 0.0 and not pair.round:
            return (
                f"{pair.source}: finer cells stay on the flat facets of the mesh file, which lie "
                f"up to {sagitta:.2g} off the round surface, {percent(sagitta / largest)} of "
                "the largest displacement; give a mesh file of second order and degree: 2, or a "
                "finer one"
            )
    return ""


def median_gaps(model: Model) -> list[float]:
    """Median magnitude of the gap of each contact before anything moves (collective).

    It is the clearance or the interference of parts that fit into each other, and it is large for a
    ball on a plane.
    """
    contacts = (model.problem.contact, model.left_out)
    parts = model.comm.allgather([(rows.sources, np.abs(rows.gaps)) for rows in contacts])
    sources, gaps = (np.concatenate(part) for part in zip(*sum(parts, []), strict=True))
    return [
        float(np.median(gaps[sources == number])) if (sources == number).any() else np.inf
        for number in range(len(model.scene.touching))
    ]


def compared(sagitta: float, moved: float, gap: float, fitted: float = FITTED) -> str:
    """Text that names the length in comparison with which a sagitta is large; empty if it is small.

    Parameters
    ----------
    moved, gap
        Largest displacement of the bodies, and median gap of the contact.
    fitted
        Median gap over the sagitta below which the surfaces fit into each other, so that only the
        displacement counts.
    """
    if sagitta > LARGE_SAGITTA * moved > 0.0:
        return f"{percent(sagitta / moved)} of the largest displacement"
    if sagitta > LARGE_SAGITTA * gap and gap > fitted * sagitta:
        return f"{percent(sagitta / gap)} of the gap or overlap of {gap:.2g} in the mesh"
    return ""


def pair_distances(geometry: Geometry, nodes: NodeFields) -> list[Distances]:
    """Distances of straight facets that meet in each pair of bodies (collective).

    Both sides count at any degree: facets of one surface press into facets of the other. It is zero
    if the facets of both sides match, since flat facets that coincide have a constant gap.
    """
    bodies = geometry.bodies
    sides = [
        [(bodies[pair.body], pair.boundary), (bodies[pair.other], pair.other_boundary)]
        for pair in geometry.pairs
    ]
    sides = [[side for side in both if _has_straight_facets(side[0])] for both in sides]
    if not any(sides):
        return [Distances()] * len(sides)
    of_pairs = []
    contacts = nodes.contacts[len(geometry.contacts) :]
    for pair, both, contact in zip(geometry.pairs, sides, contacts, strict=True):
        at = contact.nodes - nodes.first
        with_gap = at[np.isfinite(nodes.gap[at])]
        parts = geometry.comm.allgather((nodes.points[with_gap], nodes.gap[with_gap]))
        points, gaps = (np.concatenate(part) for part in zip(*parts, strict=True))
        distances = Distances()
        for side in both:
            distances = distances.or_larger(_distances(*side, (points, gaps), pair.round))
        if distances.facets > 0.0:
            surfaces = sides_of(geometry, pair)
            if facets_match(*surfaces, points[gaps <= distances.facets]):
                distances = Distances()
        of_pairs.append(distances)
    return of_pairs


def facets_match(on: Surface, against: Surface, closing: Array) -> bool:
    """Whether vertices of both sides near contact lie opposite each other.

    Parameters
    ----------
    on, against
        The facets of both sides.
    closing : (n, 3)
        Places of contact.
    """
    return _vertices_match(on, against, closing) and _vertices_match(against, on, closing)


def _vertices_match(side: Surface, other: Surface, closing: Array) -> bool:
    """Whether vertices of one side near contact have vertices of the other one opposite."""
    if len(closing) == 0:
        return False
    facets, v = side.vertices.shape[:2]
    vertices, facet = side.vertices.reshape(-1, 3), np.repeat(np.arange(facets), v)
    reach = side.radii[facet]
    near = cKDTree(closing).query(vertices, distance_upper_bound=reach.max())[0] < reach
    vertices, facet = vertices[near], facet[near]
    others = np.unique(other.vertices.reshape(-1, 3), axis=0)
    jump = others[cKDTree(others).query(vertices)[1]] - vertices
    normal = side.normals[facet]
    along = jump - np.einsum("ij,ij->i", jump, normal)[:, None] * normal
    return bool((np.linalg.norm(along, axis=1) <= MATCHING * side.radii[facet]).all())


def _has_straight_facets(body: Body) -> bool:
    """Whether a body came from a file and its surface is made of flat facets."""
    return isinstance(body.mesh, CellMesh) and body.mesh.middles is None


def _straight(body: Body) -> bool:
    """Whether a body came from a file and has nodes on straight edges."""
    if not isinstance(body.mesh, CellMesh) or body.mesh.middles is not None:
        return False
    return body.degree == 2 or body.mesh.coarse is not None


def _distances(body: Body, boundary: str, watched: Watched, is_round: bool) -> Distances:
    """Distances near watched points whose gap does not exceed the sagitta.

    They are those of the coarse mesh: from its vertices alone the curve of `round: true` is known,
    too.
    """
    mesh = body.mesh
    assert isinstance(mesh, CellMesh)
    mesh = mesh.coarse or mesh
    points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.dimension)))
    rows = facets_on(mesh, body, boundary)
    facets, cells = mesh.topology.facets[rows], mesh.cells[mesh.topology.facet_cells[rows]]
    skin = Surface.of(mesh.dimension, facets, points[facets], points[cells].mean(axis=1))
    return largest_distances(skin, watched, is_round)


def largest_distances(skin: Surface, watched: Watched, is_round: bool) -> Distances:
    """Largest distances of straight facets near watched points whose gap does not exceed them.

    Parameters
    ----------
    watched : (n, 3), (n,)
        Points and their gaps.
    is_round
        Whether the distance of the smooth surface is needed, too.
    """
    points, gaps = watched
    first, second = _neighbours(skin.nodes[:, : skin.vertices.shape[1]], skin.dimension)
    if len(first) == 0 or len(gaps) == 0:
        return Distances()
    cosine = np.einsum("ij,ij->i", skin.normals[first], skin.normals[second])
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    centres = skin.centres
    length = np.linalg.norm(centres[first] - centres[second], axis=1)
    sagitta = np.where((angle > FLAT) & (angle < SMOOTH), 0.125 * length * angle, 0.0)
    closing = points[gaps <= sagitta.max()]
    if len(closing) == 0:
        return Distances()
    near = cKDTree(closing).query(0.5 * (centres[first] + centres[second]))[0] < length
    near &= sagitta > 0.0
    if not near.any():
        return Distances()
    largest = float(sagitta[near].max())
    if not is_round:
        return Distances(largest)
    changes = curvature_changes(skin.smooth(), first[near], second[near])
    return Distances(largest, max(SMOOTH_SURFACE * largest, float(changes.max())))


def curvature_changes(smooth: Surface, facets: Ints, neighbours: Ints) -> Array:
    """Change of the height of a smooth surface over facets by the curvature of neighbours, (n,).

    The curvature of cylinders and balls is constant. On other surfaces the parabolas of two facets
    differ by 0.5 to 4.7 times their largest distance from the surface (cones and tori with 12 to 32
    facets around, meshed by Gmsh; about twice on the structured cones of
    `tests/contact_app/accuracy/test_faceted_curves.py`). Each facet is turned into the plane of its
    neighbour.

    Parameters
    ----------
    facets, neighbours : (n,), (n,)
    """
    assert smooth.bulge is not None
    changes = np.zeros(len(facets))
    for one, other in ((facets, neighbours), (neighbours, facets)):
        corners = smooth.vertices[one] - smooth.vertices[one][:, :1]
        normal, turned = smooth.normals[one], smooth.normals[other]
        both = normal + turned
        share = np.einsum("fvi,fi->fv", corners, turned) / (
            1.0 + np.einsum("fi,fi->f", normal, turned)[:, None]
        )
        over = smooth.bulge_over(other, corners - share[..., None] * both[:, None])
        change = 0.25 * np.abs(over - smooth.bulge[one]).max(axis=(1, 2))
        changes = np.maximum(changes, change)
    return changes


def _neighbours(facets: Ints, dimension: int) -> tuple[Ints, Ints]:
    """Pairs of facets that share a node (in the plane) or an edge (in space)."""
    v = facets.shape[1]
    joints = facets[:, :, None]
    if dimension == 3:
        joints = np.sort(np.stack([facets, np.roll(facets, -1, axis=1)], axis=2), axis=2)
    joints = joints.reshape(len(facets) * v, -1)
    order = np.lexsort(joints.T)
    same = (joints[order][1:] == joints[order][:-1]).all(axis=1)
    owner = order // v
    return owner[:-1][same], owner[1:][same]
