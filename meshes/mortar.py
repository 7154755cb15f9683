"""Mortar contact of two meshed surfaces: weighted averages of the gap on non-matching meshes.

The pressure between two bodies is a field on the side that carries the multipliers (the contact's
`on`), p = Σ p_j ψ_j with one value per node. The bodies do not penetrate in the average over each
ψ_j:

    ∫ ψ_j n·(u_on - u_against) ≤ ∫ ψ_j g,    g = n·(x_against - x_on),

with n the outward normal of the `on` side and x_against the point of the other side on the line
along n. Divided by W_j = ∫ ψ_j that is a mean gap, and its multiplier p_j W_j a force.

Projection. Every `on` facet is treated as flat: n is constant on it and the facets of the other
side are projected along n onto its plane, where the two are intersected (segments in 2D, convex
polygons cut into triangles in 3D) and integrated by Gauss points that are exact for triangles and
parallelograms (M. A. Puso, A 3D mortar method for solid mechanics, IJNME 59 (2004)). For round
surfaces with straight edges the integrals are over polyhedra, whose distance from the smooth
surfaces is of second order in the size of facets. On facets of second order with curved edges, the
points of both facets that project to each Gauss point are used, which is of fourth order. The jump
x_against - x_on has the direction of n, so that rows vanish on every common rigid motion of both
bodies: forces and moments balance to round-off.

Multipliers. On facets that the other side covers completely, the ψ_j are dual to the shape
functions, ∫ ψ_j φ_k = δ_jk ∫ φ_k (B. Wohlmuth, A mortar finite element method using dual spaces for
the Lagrange multiplier, SINUM 38 (2000)): a row has one `on` node, and matching meshes reduce to
node pairs. On facets that are covered in part, dual functions grow without bound, so the ψ_j are
the shape functions themselves. The same holds on facets of second order, where multipliers are at
the vertices and displacements at all nodes. These ψ_j add up to one, so a constant pressure is
transmitted exactly. About a vertex of an edge that points at the other body, all facets of second
order rise from it, and the mean gap with the shape function is positive although the vertex
touches: there ψ_j is dual, too, with which the mean of a linear gap is its value at the vertex. The
row of a node whose area is hardly covered is distributed to its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from meshes.contact_surface import Surface
from meshes.facet_overlaps import Overlaps, facet_areas, smallest
from meshes.facing import SurfacesApartError, overlaps

COVERED = 1.0 - 1e-6
"""Covered share of a facet from which on it counts as covered completely."""

WEAK = 0.01
"""Covered share of a node's area below which its row is distributed to its neighbours.

Such rows are nearly equal to those of their neighbours, and their multipliers are nearly
undetermined. All other rows must stay, since a small body may stand on the nodes of one facet.
"""

POINTED = 0.1
"""Mean gap of a facet beyond that of its vertex, over the root of its area, from which on the facet
rises steeply: facets inclined by 20° or more. On an obstacle of radius R it is 0.25 h/R."""

NEGLIGIBLE = 1e-13
"""Entries of a row (which is of order one) that count as round-off."""


@dataclass(frozen=True, eq=False)
class MeanGaps:
    """Rows Σ value · u[node, component] ≤ gap, one for each multiplier.

    Attributes
    ----------
    nodes, points : (rows,), (rows, 3)
        The `on` node of each row, and its coordinates.
    areas : (rows,)
        W_j, an area: multiplier (force) = mean pressure times W_j.
    gaps : (rows,)
        Mean gap, a length; negative where the bodies overlap.
    normals : (rows, dimension)
        Mean normal out of the other body: force on the `on` body for a multiplier of one.
    moments : (rows, 3)
        Moment of that force about the row's node.
    row, node, component, value : (entries,)
        The rows, sorted; values on `on` nodes add up to a mean of n.
    entry_points : (entries, 3)
        Coordinates of the nodes.
    """

    nodes: NDArray[np.int64]
    points: NDArray[np.float64]
    areas: NDArray[np.float64]
    gaps: NDArray[np.float64]
    normals: NDArray[np.float64]
    moments: NDArray[np.float64]
    row: NDArray[np.int64]
    node: NDArray[np.int64]
    component: NDArray[np.int64]
    value: NDArray[np.float64]
    entry_points: NDArray[np.float64]


def mean_gaps(on: Surface, against: Surface, comm: MPI.Intracomm = MPI.COMM_SELF) -> MeanGaps:
    """The mortar rows of two surfaces (collective).

    Parameters
    ----------
    comm
        Ranks that have both surfaces and share the work.

    Raises
    ------
    SurfacesApartError
        The sides face the same way, or no facet of one projects onto one of the other.
    """
    return _rows(on, against, overlaps(on, against, comm=comm))


@dataclass(frozen=True, eq=False)
class Multipliers:
    """The functions ψ_j of the multipliers on each `on` facet.

    Attributes
    ----------
    functions : (facets, v, v)
        C of ψ = C φ.
    own : (facets, v, n)
        ∫ ψ_k N_l.
    weight : (facets, v)
        ∫ ψ_k.
    sizes : (facets,)
        Areas.
    """

    functions: NDArray[np.float64]
    own: NDArray[np.float64]
    weight: NDArray[np.float64]
    sizes: NDArray[np.float64]

    @classmethod
    def of(cls, on: Surface, found: Overlaps) -> Multipliers:
        """Dual functions on covered facets of first order, linear shape functions on others.

        Raises
        ------
        SurfacesApartError
            A facet meets two layers of the other side.
        """
        facets, v, sizes = len(on.nodes), on.vertices.shape[1], facet_areas(on)

        def on_facets(values: NDArray[np.float64]) -> NDArray[np.float64]:
            total = np.zeros((facets, *values.shape[1:]))
            np.add.at(total, found.i, values)
            return total

        own, weight = on_facets(found.own), on_facets(found.weight)
        covered = on_facets(found.area) >= COVERED * sizes
        if found.on_several_layers(on).any():
            raise SurfacesApartError(
                "a facet of the first side meets two layers of the second; name a smaller part of "
                "it"
            )
        functions = np.tile(np.eye(v), (facets, 1, 1))
        if own.shape[2] == v:
            functions[covered] = weight[covered, :, None] * np.linalg.inv(own[covered])
            own[covered] = weight[covered, :, None] * np.eye(v)
        elif on.dimension == 3:
            dual = functions.copy()
            corners = np.eye(v)
            middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
            hats = np.concatenate([corners, middles, np.full((1, v), 1.0 / v)])
            mass = own[covered] @ hats[: own.shape[2]]
            dual[covered] = weight[covered, :, None] * np.linalg.inv(mass)
            gap = on_facets(found.gap)
            rise = gap - np.einsum("fjk,fk->fj", dual, gap)
            rise /= np.where(weight > 0.0, weight, 1.0) * np.sqrt(sizes)[:, None]
            local = np.unique(on.nodes[:, :v], return_inverse=True)[1].reshape(-1, v)
            least = smallest(local[covered].ravel(), rise[covered].ravel(), local.max() + 1)
            pointed = (least > POINTED) & (least < np.inf)
            functions = np.where(pointed[local][..., None], dual, functions)
            own = functions @ own
        return cls(functions, own, weight, sizes)


def _rows(on: Surface, against: Surface, found: Overlaps) -> MeanGaps:
    """Rows of the multiplier functions, summed over facets.

    Weak rows are distributed to neighbours.
    """
    d = on.dimension
    nodes, local = np.unique(on.nodes, return_inverse=True)
    others, other_local = np.unique(against.nodes, return_inverse=True)
    local, other_local = local.reshape(on.nodes.shape), other_local.reshape(against.nodes.shape)
    v = on.vertices.shape[1]
    psi = Multipliers.of(on, found)
    own, weight, sizes, functions = psi.own, psi.weight, psi.sizes, psi.functions
    shared = functions[found.i] @ found.shared
    gap = np.einsum("pjk,pk->pj", functions[found.i], found.gap)

    count, corners = len(nodes), local[:, :v]
    total = np.bincount(corners.ravel(), weight.ravel(), minlength=count)
    gaps = np.bincount(corners[found.i].ravel(), gap.ravel(), minlength=count)
    touched = np.unique(found.i)
    normals = on.normals[:, :d]
    here = _scatter(corners[touched], local[touched], own[touched], normals[touched], count, count)
    other_side = _scatter(
        corners[found.i], other_local[found.j], -shared, normals[found.i], count, len(others)
    )
    matrix = sparse.hstack([here, other_side], format="csr")

    share = np.bincount(corners.ravel(), np.repeat(sizes / v, v), minlength=count)
    given = distribute(corners, weight, total, total < WEAK * share)
    total, gaps, matrix = given @ total, given @ gaps, (given @ matrix).tocsr()
    strong = np.flatnonzero(given.diagonal() > 0.0)

    place = np.zeros((count, 3))
    place[local.ravel()] = on.points.reshape(-1, 3)
    other_place = np.zeros((len(others), 3))
    other_place[other_local.ravel()] = against.points.reshape(-1, 3)
    scaled = (sparse.diags(1.0 / total[strong]) @ matrix[strong]).tocsr()
    scaled.data[np.abs(scaled.data) < NEGLIGIBLE] = 0.0
    scaled.eliminate_zeros()
    scaled.sort_indices()
    entries = scaled.tocoo()
    at, component = entries.col // d, entries.col % d
    all_nodes, all_points = np.concatenate([nodes, others]), np.concatenate([place, other_place])
    mean, turned = np.zeros((len(strong), d)), np.zeros((len(strong), 3))
    on_first = at < count
    np.add.at(mean, (entries.row[on_first], component[on_first]), entries.data[on_first])
    force = -entries.data[on_first, None] * np.eye(3)[component[on_first]]
    arm = place[at[on_first]] - place[strong[entries.row[on_first]]]
    np.add.at(turned, entries.row[on_first], np.cross(arm, force))
    return MeanGaps(
        nodes=nodes[strong],
        points=place[strong],
        areas=total[strong],
        gaps=gaps[strong] / total[strong],
        normals=-mean,
        moments=turned,
        row=entries.row.astype(np.int64),
        node=all_nodes[at],
        component=component.astype(np.int64),
        value=entries.data,
        entry_points=all_points[at],
    )


def _scatter(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    blocks: NDArray[np.float64],
    normals: NDArray[np.float64],
    height: int,
    width: int,
) -> sparse.csr_matrix:
    """Sum of blocks (n, v, w) times normals (n, d) at rows (n, v) and nodes (n, w)."""
    d = normals.shape[1]
    values = blocks[..., None] * normals[:, None, None, :]
    row = np.broadcast_to(rows[:, :, None, None], values.shape)
    column = np.broadcast_to(
        columns[:, None, :, None] * d + np.arange(d)[None, None, None, :], values.shape
    )
    shape = (height, width * d)
    return sparse.csr_matrix((values.ravel(), (row.ravel(), column.ravel())), shape=shape)


def distribute(
    local: NDArray[np.int64],
    weight: NDArray[np.float64],
    total: NDArray,
    weak: NDArray[np.bool_],
) -> sparse.csr_matrix:
    """Matrix that adds the rows of weak nodes to those of their neighbours, (nodes, nodes).

    The row of a weak node is distributed to the nodes of the same facets, in proportion to their
    weight there. A node with weak neighbours only keeps its row.
    """
    count, v = len(total), local.shape[1]
    some = total > 0.0
    weak = some & weak
    a = np.repeat(local[:, :, None], v, axis=2).ravel()
    b = np.repeat(local[:, None, :], v, axis=1).ravel()
    w = np.repeat(weight[:, None, :], v, axis=1).ravel()
    link = weak[a] & some[b] & ~weak[b] & (w > 0.0)
    transfer = sparse.csr_matrix((w[link], (b[link], a[link])), shape=(count, count))
    received = np.asarray(transfer.sum(axis=0)).ravel()
    remaining = some & ~(weak & (received > 0.0))
    scale = np.divide(1.0, received, out=np.zeros(count), where=received > 0.0)
    return (transfer @ sparse.diags(scale) + sparse.diags(remaining.astype(float))).tocsr()
