"""Test for overlaps of the cells of a body: each point may be covered once only.

Let every cell have positive volume, and let neighbours lie on opposite sides of the facets they
share (`meshes.orientation`). Let N(x) be the number of cells that contain x. Across an inner facet
one cell ends where the other one begins, so N changes only across facets of the surface, by one for
each: it falls along the outward normal. Far away N = 0. So N is the winding number w of the surface
(the degree of the map from the cells glued along their facets to space; Milnor, Topology from the
Differentiable Viewpoint, 1965, section 5, and Floater, One-to-one piecewise linear mappings over
triangulations, Math. Comp. 72, 2003, for the plane), whatever happens inside the body:

    N(x) = w(x) = Σ over the facets a ray from x upwards meets of sign(n · up).

The cells overlap if and only if N >= 2 somewhere. Such places are bounded by facets of the surface,
and on the inner side of one of these facets N >= 2. Along the inner side of a facet that no other
facet cuts, N is constant. So two tests together decide:

1. *No two facets of the surface cross* (`meshes.crossing`; between the four sides of a proper
   crossing N takes the values k, k + 1, k + 1 and k + 2, so a crossing is an overlap). This finds,
   for example, a spiral that runs into itself.
2. *N = 1 just inside every facet*: at its middle, and beside its nodes, which finds
   overlaps also where crossings are degenerate (edges through edges, facets in one plane), and
   cells within others where no facets cross: a sheet that winds twice about nodes inside, with one
   boundary around the other, has N = 2 within the inner one. Where w >= 2, a cell besides its own
   has to be found in which the point lies before it counts. Between facets that share a node, and
   neither touch nor nearly touch others there, N is the same; so one facet of each such piece of
   the surface is tested, and all others that are in doubt.

Bodies that touch do not overlap: both tests begin at a depth of `TOUCH` of the size of a facet (the
least of its heights and of the height of its cell over it; the test 2 at that share of the way to
the centre of the cell). So slits of any width, also closed ones, and walls of any thickness pass.

The tests miss overlaps that are less deep than `TOUCH`. Where facets are curved (or quadrilaterals
are not plane), they may also miss overlaps thinner than the distance between the surface and its
simplices. `meshes.chords` bounds this distance (5 % of the size of the facet unless it is very
strongly curved); test 2 still finds such overlaps at its points. Cells count as unfolded if their
Jacobian is positive at the points that `meshes.repair` tests.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from meshes.arrays import Array, Ints, Mask
from meshes.chords import chords, reference_vertices
from meshes.connected import connected
from meshes.crossing import (
    Boxes,
    ClosedSurface,
    points_in_boxes,
    segment_crossings,
    triangle_crossings,
    winding,
)
from meshes.quadratic import CENTRED, VERTICES
from meshes.subdomains import vtk_places, vtk_shapes
from meshes.unstructured import FACETS, MeshError, Topology, first_of

TOUCH = 1e-3
"""Depth over the size of a facet below which parts of a body count as touching only."""

WITHIN = 1e-9
"""Distance in reference coordinates at which a point still lies in a cell."""

ROOM = 0.25
"""Distance from the box of its nodes to which a curved cell may reach, over its size."""

CELLS_AT_ONCE = 1000
"""Number of points for which other cells are searched at once."""

ADVICE = (
    "; a body fills each place once: mend the shape there, or give what overlaps as bodies of "
    "their own (cells chosen by `group`), which may overlap"
)


@dataclass(frozen=True, eq=False)
class CheckedBody:
    """The data of a mesh for the tests; see `refuse_overlaps`."""

    points: Array
    cells: Ints
    cell: str
    topology: Topology
    middles: Array | None
    number: Ints

    @property
    def degree(self) -> int:
        """Degree of the edges."""
        return 1 if self.middles is None else 2

    def nodes(self, rows: Ints) -> Array:
        """Coordinates of the nodes of cells in VTK order, (rows, nodes, d)."""
        corners = self.points[self.cells[rows]]
        if self.middles is None:
            return corners
        return np.concatenate([corners, self.middles[rows]], axis=1)


def refuse_overlaps(
    points: Array,
    cells: Ints,
    cell: str,
    topology: Topology,
    middles: Array | None,
    number: Ints,
    comm: MPI.Intracomm = MPI.COMM_SELF,
) -> Mask:
    """Refuse a body that covers some place twice (collective).

    Parameters
    ----------
    points : (nodes, d)
    cells : (cells, vertices)
        Cells of positive volume, with neighbours on opposite sides of their facets.
    middles : (cells, further nodes, d)
        The nodes of second order where edges are curved.
    number : (cells,)
        Of each cell in the file, from 0.
    comm
        Ranks that have the same mesh and share the tests.

    Returns
    -------
    Mask (facets,) of facets of the surface that may touch others, of which they are no neighbours.

    Raises
    ------
    MeshError
        The message gives the number of overlapping cells, the first two of them, and what to do.
    """
    body = CheckedBody(points, cells, cell, topology, middles, number)
    parts = chords(points, cells, cell, topology, middles)
    surface = ClosedSurface(
        parts.places, parts.simplices, TOUCH * parts.size[parts.facet], parts.deviation[parts.facet]
    )
    if points.shape[1] == 2:
        crossed, doubtful = segment_crossings(surface), np.ones(len(parts.simplices), bool)
    else:
        crossed, doubtful = triangle_crossings(surface, comm)
    pairs = topology.facet_cells[parts.facet[crossed]]
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    if len(pairs):
        facets = "edges" if points.shape[1] == 2 else "faces"
        raise MeshError(
            _message(body, pairs, f"s whose {facets} on the surface of the body cross those of "
                     "others: the body overlaps itself", "crossed by") + ADVICE
        )  # fmt: skip
    may_touch = np.zeros(len(topology.facets), bool)
    may_touch[parts.facet[doubtful]] = True
    rest = np.flatnonzero(~may_touch[parts.facet])
    some = parts.facet[rest[_one_of_each(surface.simplices[rest], len(parts.places))]]
    tested = np.concatenate([np.flatnonzero(may_touch), some])
    if len(_covered(body, surface, tested, comm)):
        pairs = _covered(body, surface, np.arange(len(may_touch)), comm)
        raise MeshError(_message(body, pairs, "s that lie in other cells", "in") + ADVICE)
    return may_touch


def _one_of_each(simplices: Ints, nodes: int) -> Ints:
    """The first simplex (simplices, d) of each piece that is connected through nodes."""
    links = np.concatenate([simplices[:, :2], simplices[:, -2:]])
    return np.unique(connected(links.T, nodes)[simplices[:, 0]], return_index=True)[1]


def _message(body: CheckedBody, pairs: Ints, fault: str, relation: str) -> str:
    """Message with the number of cells in pairs (pairs, 2), and the first pair."""
    pairs = pairs[np.lexsort(np.sort(body.number[pairs], axis=1).T[::-1])]
    a, b = pairs[0][np.argsort(body.number[pairs[0]])]
    bad = np.zeros(len(body.cells), bool)
    bad[pairs] = True
    others = bad.copy()
    others[a] = False
    start = np.zeros(len(bad), bool)
    start[a] = True
    message = first_of(body.points, body.cells, start, body.cell + fault, body.number)
    message = message.replace("has 1 ", f"has {int(bad.sum())} ", 1)
    return f"{message}, {relation} cell {body.number[b] + 1} of the file"


def _covered(body: CheckedBody, surface: ClosedSurface, tested: Ints, comm: MPI.Intracomm) -> Ints:
    """Pairs of cells (collective).

    One behind a tested facet, and another that contains a point just inside the first.
    """
    x, body_of = _just_inside(body, tested)
    rows = np.flatnonzero(winding(x, surface, comm) > 1)
    for start in range(0, len(rows), CELLS_AT_ONCE):
        part = rows[start : start + CELLS_AT_ONCE]
        point, other = containing(body, x[part])
        pairs = np.stack([body_of[part[point]], other], axis=1)
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        if len(pairs):
            return pairs
    return np.zeros((0, 2), np.int64)


def _just_inside(body: CheckedBody, tested: Ints) -> tuple[Array, Ints]:
    """Points just inside the middles of facets, and one beside each node; with their cells."""
    facets, owner = body.topology.facets[tested], body.topology.facet_cells[tested]
    corners = facets.shape[1]
    local = body.topology.facet_numbers[tested]
    vertices = reference_vertices(body.cell)
    inside = TOUCH * vertices.mean(axis=0)
    first = np.unique(facets, return_index=True)[1]  # the first facet that has a node
    points, cells = [], []
    for f, table in enumerate(FACETS[body.cell]):
        corner = vertices[list(table)]
        groups = [(np.flatnonzero(local == f), corner.mean(axis=0))]
        has = first[local[first // corners] == f]
        groups += [(has[has % corners == k] // corners, corner[k]) for k in range(corners)]
        for rows, place in groups:
            at = (1.0 - TOUCH) * place + inside
            shapes = vtk_shapes(body.cell, body.degree, at[None])[0][0]
            points.append(np.einsum("k,cki->ci", shapes, body.nodes(owner[rows])))
            cells.append(owner[rows])
    return np.concatenate(points), np.concatenate(cells)


def containing(body: CheckedBody, x: Array) -> tuple[Ints, Ints]:
    """Pairs (row of x (points, d), cell that contains the point)."""
    nodes = body.nodes(np.arange(len(body.cells)))
    lower, upper = nodes.min(axis=1), nodes.max(axis=1)
    if body.middles is not None:
        room = ROOM * (upper - lower).max(axis=1, keepdims=True)
        lower, upper = lower - room, upper + room
    points, cells = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for i, c in points_in_boxes(x, Boxes(lower, upper)):
        within = _lies_in(body, nodes[c], x[i])
        points.append(i[within])
        cells.append(c[within])
    return np.concatenate(points), np.concatenate(cells)


def _lies_in(body: CheckedBody, nodes: Array, x: Array) -> Mask:
    """Mask (pairs,) of points (pairs, d) inside cells with nodes (pairs, nodes, d)."""
    if len(x) == 0:
        return np.zeros(0, bool)
    try:
        places = vtk_places(body.cell, body.degree, nodes, x)
    except np.linalg.LinAlgError:  # a step of Newton's method met a singular Jacobian
        if len(x) == 1:
            return np.zeros(1, bool)
        half = len(x) // 2
        return np.concatenate(
            [_lies_in(body, nodes[:half], x[:half]), _lies_in(body, nodes[half:], x[half:])]
        )
    inside = np.isfinite(places).all(axis=1) & (places >= -WITHIN).all(axis=1)
    if body.cell in CENTRED:
        inside &= (places <= 1.0 + WITHIN).all(axis=1)
    else:
        inside &= places.sum(axis=1) <= 1.0 + WITHIN
    exact = body.cell not in CENTRED and body.middles is None
    if inside.any() and not exact:  # has Newton's method converged?
        rows = np.flatnonzero(inside)
        shapes = vtk_shapes(body.cell, body.degree, places[rows])[0]
        away = np.linalg.norm(np.einsum("nk,nki->ni", shapes, nodes[rows]) - x[rows], axis=1)
        size = np.ptp(nodes[rows][:, : VERTICES[body.cell]], axis=1).max(axis=1)
        inside[rows] = away <= WITHIN * size
    return inside
