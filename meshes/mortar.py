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
row of a node whose area is hardly covered is distributed to its neighbours, or to theirs if they
are as hardly covered. The value p_j of a node
beyond the edge of the other surface is an extrapolation, and results have a mean in its place
(`contact_app.results.contact_side`).
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from meshes.arrays import Array, Ints, Mask
from meshes.contact_surface import Surface
from meshes.facet_overlaps import Overlaps, smallest
from meshes.facing import SurfacesApartError, overlaps

COVERED = 1.0 - 1e-6
"""Covered share of a facet from which on it counts as covered completely."""

WEAK = 0.01
"""Covered share of a node's area below which its row is distributed to its neighbours.

Such rows are nearly equal to those of their neighbours, and their multipliers are nearly
undetermined. Most other rows must stay, since a small body may stand on the nodes of one facet.
"""

BEYOND = 0.05, 0.15
"""The same share for nodes beyond the edge of the other surface, next to facets that it covers
completely, on facets of degree 1 and 2.

A facet beyond the edge hardly bends about it, and a row over a narrow strip of the facet holds the
edge nearly pointwise: under a block on a plate of twice as many cells its pressure was three times
that of the scene with exchanged sides (degree 2: 2.3 times). Larger shares leave too few rows near
the edge: of 0.2 at degree 1, peaks are 10 to 15 % lower."""

POINTED = 0.1
"""Mean gap of a facet beyond that of its vertex, over the root of its area, from which on the facet
rises steeply: facets inclined by 20° or more. On an obstacle of radius R it is 0.25 h/R."""

NEGLIGIBLE = 1e-13
"""Entries of a row (which is of order one) that count as round-off."""


@dataclass(frozen=True, eq=False)
class BothSides:
    """The nodes of two surfaces, those of the `on` side first."""

    nodes: Ints
    places: Array
    """Nodes and coordinates of both sides. Shapes (n + m,), (n + m, 3)."""
    count: int
    """Number n of nodes of the `on` side."""
    on: Ints
    against: Ints
    """The facets of each side by the places of their nodes in `nodes`. Shape (facets, nodes per
    facet)."""
    corners: Ints  # (facets, v)
    """The vertices of the `on` facets."""

    @classmethod
    def of(cls, on: Surface, against: Surface) -> "BothSides":
        """Number the nodes of two surfaces."""
        nodes, local = np.unique(on.nodes, return_inverse=True)
        others, other = np.unique(against.nodes, return_inverse=True)
        count = len(nodes)
        places = np.zeros((count + len(others), 3))
        places[local.ravel()] = on.points.reshape(-1, 3)
        places[count + other.ravel()] = against.points.reshape(-1, 3)
        local_on = local.reshape(on.nodes.shape)
        return cls(
            np.concatenate([nodes, others]), places, count, local_on,
            count + other.reshape(against.nodes.shape), local_on[:, : on.vertices.shape[1]],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class MeanGaps:
    """Rows Σ value · u[node, component] ≤ gap, one for each multiplier."""

    nodes: Ints
    points: Array
    """The `on` node of each row, and its coordinates. Shapes (rows,), (rows, 3)."""
    areas: Array  # (rows,)
    """W_j, an area: multiplier (force) = mean pressure times W_j."""
    gaps: Array  # (rows,)
    """Mean gap, a length; negative where the bodies overlap."""
    normals: Array  # (rows, dimension)
    """Mean normal out of the other body: force on the `on` body for a multiplier of one."""
    moments: Array  # (rows, 3)
    """Moment of that force about the row's node."""
    row: Ints
    node: Ints
    component: Ints
    value: Array
    """The rows, sorted; values on `on` nodes add up to a mean of n. Shape (entries,)."""
    entry_points: Array  # (entries, 3)
    """Coordinates of the nodes."""

    @classmethod
    def of(
        cls, sides: BothSides, matrix: sparse.csr_matrix, chosen: Ints, areas: Array, gaps: Array
    ) -> "MeanGaps":
        """Rows from a matrix (rows, (n + m) · dimension).

        Parameters
        ----------
        chosen : (rows,)
            The `on` node of each row.
        areas, gaps : (rows,)
        """
        matrix.data[np.abs(matrix.data) < NEGLIGIBLE] = 0.0
        matrix.eliminate_zeros()
        matrix.sort_indices()
        entries, d = matrix.tocoo(), matrix.shape[1] // len(sides.nodes)
        row, component = entries.row.astype(np.int64), entries.col.astype(np.int64) % d
        at, value = entries.col // d, entries.data
        is_on = at < sides.count
        normals, moments = np.zeros((len(chosen), d)), np.zeros((len(chosen), 3))
        np.add.at(normals, (row[is_on], component[is_on]), -value[is_on])
        force = -value[is_on, None] * np.eye(3)[component[is_on]]
        arm = sides.places[at[is_on]] - sides.places[chosen[row[is_on]]]
        np.add.at(moments, row[is_on], np.cross(arm, force))
        return cls(
            nodes=sides.nodes[chosen], points=sides.places[chosen], areas=areas, gaps=gaps,
            normals=normals, moments=moments, row=row, node=sides.nodes[at], component=component,
            value=value, entry_points=sides.places[at],
        )  # fmt: skip


def mean_gaps(on: Surface, against: Surface, comm: MPI.Intracomm = MPI.COMM_SELF) -> MeanGaps:
    """The mortar rows of two surfaces (collective).

    Weak rows are distributed to neighbours.

    Parameters
    ----------
    comm
        Ranks that have both surfaces and share the work.

    Raises
    ------
    SurfacesApartError
        The sides face the same way, or no facet of one projects onto one of the other.
    """
    pairs = overlaps(on, against, comm=comm)
    psi, sides = Multipliers.of(on, pairs), BothSides.of(on, against)
    d, i = on.dimension, pairs.i
    functions, touched, normals = psi.functions[i], np.unique(i), on.normals[:, :d]
    gap = np.einsum("pjk,pk->pj", functions, pairs.gap)
    gaps = np.bincount(sides.corners[i].ravel(), gap.ravel(), minlength=sides.count)

    def along(blocks: Array, facets: Ints) -> Array:
        """Blocks (k, v, w) times the normals of `on` facets, (k, v, w, d)."""
        return np.asarray(blocks[..., None] * normals[facets, None, None])

    matrix = jumps(
        sides, pairs, touched, along(psi.mass[touched], touched), along(functions @ pairs.shared, i)
    )
    total, weak = psi.total(sides)
    shares = _distributed(sides.corners, psi.weight, total, weak | psi.narrow(sides))
    strong = np.flatnonzero(shares.diagonal() > 0.0)
    total, gaps, shares = (shares @ total)[strong], (shares @ gaps)[strong], shares[strong]
    rows = (sparse.diags(1.0 / total) @ (shares @ matrix)).tocsr()
    return MeanGaps.of(sides, rows, strong, total, gaps / total)


@dataclass(frozen=True, eq=False)
class Multipliers:
    """The functions ψ_j of the multipliers on each `on` facet."""

    functions: Array  # (facets, v, v)
    """C of ψ = C φ."""
    mass: Array  # (facets, v, n)
    """∫ ψ_k N_l."""
    weight: Array  # (facets, v)
    """∫ ψ_k."""
    sizes: Array  # (facets,)
    """Areas."""
    covered: Mask  # (facets,)
    """Mask of the facets that the other side covers completely."""

    @classmethod
    def of(cls, on: Surface, pairs: Overlaps) -> "Multipliers":
        """Dual functions on covered facets of first order, linear shape functions on others.

        Raises
        ------
        SurfacesApartError
            A facet meets two layers of the other side.
        """
        if pairs.on_several_layers(on).any():
            raise SurfacesApartError(
                "a facet of the first side meets two layers of the second; name a smaller part of "
                "it"
            )
        mass, weight, gap, area = (
            _on_facets(pairs, len(on.nodes), values)
            for values in (pairs.mass, pairs.weight, pairs.gap, pairs.area)
        )
        v, sizes = on.vertices.shape[1], on.areas
        covered = area >= COVERED * sizes
        functions = np.tile(np.eye(v), (len(mass), 1, 1))
        if mass.shape[2] == v:
            functions[covered] = weight[covered, :, None] * np.linalg.inv(mass[covered])
            mass[covered] = weight[covered, :, None] * np.eye(v)
        elif on.dimension == 3:
            functions[covered] = _dual_of_second_order(mass[covered], weight[covered])
            rise = gap - np.einsum("fjk,fk->fj", functions, gap)
            rise /= np.where(weight > 0.0, weight, 1.0) * np.sqrt(sizes)[:, None]
            pointed = _pointed(on.nodes[:, :v], covered, rise)
            functions = np.where(pointed[..., None], functions, np.eye(v))
            mass = functions @ mass
        return cls(functions, mass, weight, sizes, covered)

    def total(self, sides: BothSides) -> tuple[Array, Mask]:
        """∫ ψ_j over all facets, and the mask of weak nodes, (n,) each."""
        weight, area = self._areas(sides)
        return weight, weight < WEAK * area

    def narrow(self, sides: BothSides) -> Mask:
        """Mask (n,) of nodes beyond the edge of the other surface, which covers a narrow strip."""
        weight, area = self._areas(sides)
        inside, bordering = np.zeros((2, sides.count), bool)
        inside[sides.corners[self.covered]] = True
        partial = (self.weight > 0.0).any(axis=1) & inside[sides.corners].any(axis=1)
        bordering[sides.corners[partial]] = True
        beyond = BEYOND[int(self.mass.shape[2] > self.weight.shape[1])]
        return np.asarray(bordering & ~inside & (weight < beyond * area))

    def _areas(self, sides: BothSides) -> tuple[Array, Array]:
        """∫ ψ_j over all facets, and the area about each node, covered or not, (n,) each."""
        v = self.weight.shape[1]
        weight, area = (
            np.bincount(sides.corners.ravel(), values.ravel(), sides.count).astype(np.float64)
            for values in (self.weight, np.repeat(self.sizes / v, v))
        )
        return weight, area


def _on_facets(pairs: Overlaps, facets: int, values: Array) -> Array:
    """Sums of values (pairs, …) over the overlaps of each `on` facet, (facets, …)."""
    sums = np.zeros((facets, *values.shape[1:]))
    starts = np.flatnonzero(np.diff(pairs.i, prepend=-1))  # sorted: ranks share facets in order
    sums[pairs.i[starts]] = np.add.reduceat(values, starts)
    return sums


def _dual_of_second_order(mass: Array, weight: Array) -> Array:
    """C (facets, v, v) of functions dual to the linear ones, on facets of second order."""
    v = weight.shape[1]
    corners = np.eye(v)
    middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
    linear = np.concatenate([corners, middles, np.full((1, v), 1.0 / v)])[: mass.shape[2]]
    return np.asarray(weight[..., None] * np.linalg.inv(mass @ linear))


def _pointed(vertices: Ints, covered: Mask, rise: Array) -> Mask:
    """Mask (facets, v) of vertices from which all covered facets rise steeply.

    Parameters
    ----------
    rise : (facets, v)
        Mean gap beyond that of the vertex, over the root of the area.
    """
    nodes, local = np.unique(vertices, return_inverse=True)
    local = local.reshape(vertices.shape)
    least = smallest(local[covered].ravel(), rise[covered].ravel(), len(nodes))
    return np.asarray(((least > POINTED) & (least < np.inf))[local])


def jumps(
    sides: BothSides, pairs: Overlaps, touched: Ints, mass: Array, shared: Array
) -> sparse.csr_matrix:
    """∫ ψ_j N of both sides, negative for the other side, (n, (n + m) · k).

    Parameters
    ----------
    touched : (facets,)
        The `on` facets with overlaps.
    mass, shared : (facets, v, w, k), (pairs, v, w', k)
        The integrals on each of these facets and on each overlap.
    """
    k = mass.shape[3]
    width = len(sides.nodes) * k
    blocks = (
        (sides.corners[touched], sides.on[touched], mass),
        (sides.corners[pairs.i], sides.against[pairs.j], -shared),
    )
    first, second = (
        scattered(
            rows, (columns[..., None] * k + np.arange(k)).reshape(len(columns), -1),
            values.reshape(*values.shape[:2], -1), (sides.count, width),
        )
        for rows, columns, values in blocks
    )  # fmt: skip
    return (first + second).tocsr()


def scattered(
    rows: Ints, columns: Ints, blocks: Array, shape: tuple[int, int]
) -> sparse.csr_matrix:
    """Sum of blocks (n, v, w) at rows (n, v) and columns (n, w).

    A product of two matrices whose entries are in order takes a third of the time of their sort.
    """
    (n, v, w), lines = blocks.shape, np.arange(rows.size + 1)
    entries = np.repeat(columns, v, axis=0).ravel()
    every = sparse.csr_matrix((blocks.ravel(), entries, w * lines), shape=(n * v, shape[1]))
    picks = sparse.csc_matrix((np.ones(n * v), rows.ravel(), lines), shape=(shape[0], n * v))
    return sparse.csr_matrix(picks.tocsr() @ every)


def _distributed(local: Ints, weight: Array, total: NDArray, weak: Mask) -> sparse.csr_matrix:
    """Matrix of `distribute`, also for weak nodes all of whose neighbours are weak themselves.

    The corner of a block may cover a small part of one facet, all of whose vertices lie beyond its
    edges: a row of this part alone holds the corner nearly pointwise.
    """
    shares = distribute(local, weight, total, weak)
    isolated = weak & (shares.diagonal() > 0.0)
    return (shares @ distribute(local, weight, total, isolated)).tocsr()


def distribute(local: Ints, weight: Array, total: NDArray, weak: Mask) -> sparse.csr_matrix:
    """Matrix that adds the rows of weak nodes to those of their neighbours, (nodes, nodes).

    The row of a weak node is distributed to the nodes of the same facets, in proportion to their
    weight there. A node with weak neighbours only keeps its row.
    """
    count, v = len(total), local.shape[1]
    some = total > 0.0
    weak = some & weak
    if not weak.any():
        return sparse.diags(some.astype(float), format="csr")
    a = np.repeat(local[:, :, None], v, axis=2).ravel()
    b = np.repeat(local[:, None, :], v, axis=1).ravel()
    w = np.repeat(weight[:, None, :], v, axis=1).ravel()
    link = weak[a] & some[b] & ~weak[b] & (w > 0.0)
    transfer = sparse.csr_matrix((w[link], (b[link], a[link])), shape=(count, count))
    received = np.asarray(transfer.sum(axis=0)).ravel()
    remaining = some & ~(weak & (received > 0.0))
    scale = np.divide(1.0, received, out=np.zeros(count), where=received > 0.0)
    return (transfer @ sparse.diags(scale) + sparse.diags(remaining.astype(float))).tocsr()
