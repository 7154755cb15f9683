"""Tied surfaces of meshes that need not match: the mean jump of the displacement is zero.

    ∫ ψ_j (u_on - u_against - g n^⊥) = 0   in each component,

with the multipliers ψ_j of mortar contact (`mortar`), which transmit constant tractions exactly.
x_on and x_against are points that face each other along the normal n of the `on` facet, and g is
their distance. If g is not zero, as between curved surfaces whose facets do not match, a rigid
rotation moves the two points differently. The term with n^⊥ corrects this: along each tangent t of
the facet

    t · n^⊥ = ∂(n · u_on)/∂t,

which, for a rigid rotation, is minus the change of n along t. So the rows vanish on rigid motions
of both bodies for any gap, and forces and moments balance to round-off: the sides are joined as by
bars along the normals of the `on` side.

If nodes of both sides are held, or a node belongs to another tie as well, its function ψ_j is
distributed to its neighbours. The displacement is prescribed there already, and one more multiplier
would constrain the other side too much (B. Wohlmuth, *Discretization methods and iterative solvers
based on domain decomposition*, 2001, section 1.2, on cross points). The functions still add up to
one.
"""

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from scipy import sparse

from meshes.arrays import Array, Ints, Mask
from meshes.contact_surface import Surface
from meshes.facet_overlaps import Overlaps
from meshes.facing import overlaps
from meshes.mortar import BothSides, MeanGaps, Multipliers, distribute, jumps, scattered


@dataclass(frozen=True, eq=False)
class MeanJumps:
    """Rows Σ value · u[node, component] = 0 of each component of the jump."""

    rows: tuple[MeanGaps, ...]
    """Records as `MeanGaps`; the force on the `on` body for a multiplier of one is minus the unit
    vector."""
    gap: float
    size: float
    """Largest mean distance of the sides, and the size of a facet at this place."""
    nodes: Ints
    held: Mask
    """Nodes of the `on` side, ascending, and their components that are held on both sides. Shapes
    (n,), (n, d)."""


@dataclass(frozen=True, eq=False)
class Decided:
    """The displacements that are known before two surfaces are tied."""

    nodes: Ints
    held: Mask
    """Held nodes, ascending, and their components. Shapes (k,), (k, d)."""
    tied_before: Ints  # (l,)
    """Nodes with multipliers of another tie."""

    def of(self, nodes: Ints) -> Mask:
        """Mask (n, d) of the held components of some nodes."""
        result = np.zeros((len(nodes), self.held.shape[1]), bool)
        if len(self.nodes):
            at = np.minimum(np.searchsorted(self.nodes, nodes), len(self.nodes) - 1)
            result = self.held[at] & (self.nodes[at] == nodes)[:, None]
        return result


def mean_jumps(
    on: Surface,
    against: Surface,
    decided: Decided,
    comm: MPI.Intracomm = MPI.COMM_SELF,
    *,
    gives: bool = True,
) -> MeanJumps:
    """The mortar rows of two tied surfaces (collective).

    Parameters
    ----------
    comm
        Ranks that have both surfaces and share the work.
    gives
        Whether functions of nodes with known displacements are distributed to neighbours; otherwise
        each node has its own rows.

    Raises
    ------
    SurfacesApartError
        The sides face the same way, or no facet of one projects onto one of the other.
    """
    pairs = overlaps(on, against, tilted=True, comm=comm)
    made = _Ties.of(on, against, pairs)
    sides = made.sides
    decided_on, decided_against = np.split(decided.of(sides.nodes), [sides.count])
    nodes, outer = sides.nodes[: sides.count], abs(made.jump[:, sides.count :])
    tied_before = np.isin(nodes, decided.tied_before)
    distance = np.abs(pairs.distance)
    worst = int(np.argmax(distance))
    held = decided_on & (outer @ decided_against > 0.0)
    yielding = tied_before[:, None] | held if gives else np.zeros_like(held)
    # not by np.unique along an axis: it sorts records of n fields
    different = {nodes.tobytes(): nodes for nodes in yielding.T}
    distributed = {key: made.distributed(nodes) for key, nodes in different.items()}
    components = {key: made.components(on.dimension, sums) for key, sums in distributed.items()}
    rows = tuple(components[yielding[:, i].tobytes()][i] for i in range(on.dimension))
    size = float(on.radii[pairs.i[worst]])
    return MeanJumps(rows, float(distance[worst]), size, nodes, held)


@dataclass(frozen=True, eq=False)
class _Ties:
    """Sums over all facets, before functions are distributed to neighbours."""

    sides: BothSides
    psi: Multipliers
    """The nodes of both sides, and the functions of the multipliers on the `on` facets."""
    jump: sparse.csr_matrix  # (n, n + m)
    """∫ ψ_j N of both sides; negative for the other side."""
    tilt: sparse.csr_matrix  # (n, n · d · d)
    """∫ ψ_j n^⊥ by node, component of the displacement and component of the result."""

    @classmethod
    def of(cls, on: Surface, against: Surface, pairs: Overlaps) -> "_Ties":
        """Add up the overlaps of facets."""
        d, psi, sides = on.dimension, Multipliers.of(on, pairs), BothSides.of(on, against)
        functions, touched = psi.functions[pairs.i], np.unique(pairs.i)
        shared = functions @ pairs.shared
        jump = jumps(sides, pairs, touched, psi.mass[touched][..., None], shared[..., None])
        tilt = sparse.csr_matrix((sides.count, sides.count * d * d))
        if pairs.tilt.any():
            turned = np.einsum("pjk,pkal->pjal", functions, pairs.tilt)
            axes = on.frames[pairs.i][..., :d]
            turned = np.einsum("pjal,pai,pc->pjlci", turned, axes[:, :-1], axes[:, -1])
            column = sides.on[pairs.i][..., None] * d * d + np.arange(d * d)
            column = column.reshape(len(column), -1)
            turned = turned.reshape(*turned.shape[:2], -1)
            tilt = scattered(sides.corners[pairs.i], column, turned, tilt.shape)
        return cls(sides, psi, jump, tilt)

    def distributed(self, yielding: Mask) -> "_Distributed":
        """The sums in which rows of yielding nodes (n,) are distributed to their neighbours."""
        total, weak = self.psi.total(self.sides)
        shares = distribute(self.sides.corners, self.psi.weight, total, yielding | weak)
        strong = np.flatnonzero(shares.diagonal() > 0.0)
        total, shares = (shares @ total)[strong], shares[strong]
        scale = sparse.diags(1.0 / total) @ shares
        return _Distributed(strong, total, (scale @ self.jump).tocoo(), (scale @ self.tilt).tocoo())

    def components(self, d: int, sums: "_Distributed") -> list[MeanGaps]:
        """The rows of each component of the jump; they differ in their axis where nothing tilts."""
        if sums.tilt.nnz:
            return [self.component(i, d, sums) for i in range(d)]
        sides, first = self.sides, self.component(0, d, sums)
        on = sums.jump.tocsc()[:, : sides.count]
        lengths = np.asarray(on.sum(axis=1))
        arms = on @ sides.places[: sides.count] - lengths * sides.places[sums.strong]
        return [
            replace(
                first, component=np.full_like(first.component, i), moments=-np.cross(arms, axis),
                normals=np.tile(-axis[:d], (len(sums.strong), 1)),
            )
            for i, axis in enumerate(np.eye(3)[:d])
        ]  # fmt: skip

    def component(self, i: int, d: int, sums: "_Distributed") -> MeanGaps:
        """The rows of component i of the jump in d components."""
        sides, strong, jump, tilt = self.sides, sums.strong, sums.jump, sums.tilt
        of_component = tilt.col % d == i  # of the result
        row = np.concatenate([jump.row, tilt.row[of_component]])
        column = np.concatenate([jump.col * d + i, tilt.col[of_component] // d])
        value = np.concatenate([jump.data, -tilt.data[of_component]])
        shape = len(strong), len(sides.nodes) * d
        matrix = sparse.csr_matrix((value, (row, column)), shape=shape)
        rows = MeanGaps.of(sides, matrix, strong, sums.total, np.zeros(len(strong)))
        return replace(rows, normals=np.tile(-np.eye(d)[i], (len(strong), 1)))


@dataclass(frozen=True, eq=False)
class _Distributed:
    """Sums over facets in which functions are distributed to neighbours, divided by ∫ ψ_j."""

    strong: Ints
    total: Array
    """Places of the `on` nodes that keep a row, and ∫ ψ_j. Shape (rows,)."""
    jump: sparse.coo_matrix
    tilt: sparse.coo_matrix
    """Shapes (rows, n + m), (rows, n · d · d)."""
