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

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from meshes.contact_surface import Surface, frames
from meshes.facet_overlaps import Overlaps
from meshes.facing import overlaps
from meshes.mortar import NEGLIGIBLE, WEAK, MeanGaps, Multipliers, distribute


@dataclass(frozen=True, eq=False)
class MeanJumps:
    """Rows Σ value · u[node, component] = 0 of each component of the jump.

    Attributes
    ----------
    rows : d records
        Records as `MeanGaps`; the force on the `on` body for a multiplier of one is minus the unit
        vector.
    gap, size
        Largest mean distance of the sides, and the size of a facet at this place.
    nodes, held : (n,), (n, d)
        Nodes of the `on` side, ascending, and their components that are held on both sides.
    """

    rows: tuple[MeanGaps, ...]
    gap: float
    size: float
    nodes: NDArray[np.int64]
    held: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Decided:
    """The displacements that are known before two surfaces are tied.

    Attributes
    ----------
    nodes, held : (k,), (k, d)
        Held nodes, ascending, and their components.
    tied_before : (l,)
        Nodes with multipliers of another tie.
    """

    nodes: NDArray[np.int64]
    held: NDArray[np.bool_]
    tied_before: NDArray[np.int64]

    def of(self, nodes: NDArray[np.int64]) -> NDArray[np.bool_]:
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
    found = overlaps(on, against, tilted=True, comm=comm)
    made = _Ties.of(on, against, found)
    here, other_places = decided.of(made.nodes), decided.of(made.others)
    outer = abs(made.jump[:, len(made.nodes) :])
    tied_before = np.isin(made.nodes, decided.tied_before)
    distance = np.abs(found.distance)
    worst = int(np.argmax(distance))
    held = here & (outer @ other_places > 0.0)
    yielding = tied_before[:, None] | held if gives else np.zeros_like(held)
    rows = tuple(made.component(i, yielding[:, i]) for i in range(on.dimension))
    size = float(on.radii[found.i[worst]])
    return MeanJumps(rows, float(distance[worst]), size, made.nodes, held)


@dataclass(frozen=True, eq=False)
class _Ties:
    """Sums over all facets, before functions are distributed to neighbours.

    Attributes
    ----------
    on, psi
        The side of the multipliers, and their functions on its facets.
    nodes, others : (n,), (m,)
        Nodes of both sides.
    corners : (facets, v)
        Number of each vertex among the nodes.
    jump : (n, n + m)
        ∫ ψ_j N of both sides; negative for the other side.
    tilt : (n, n · d · d)
        ∫ ψ_j n^⊥ by node, component of the displacement and component of the result.
    places : (n + m, 3)
    """

    on: Surface
    psi: Multipliers
    nodes: NDArray[np.int64]
    others: NDArray[np.int64]
    corners: NDArray[np.int64]
    jump: sparse.csr_matrix
    tilt: sparse.csr_matrix
    places: NDArray[np.float64]

    @classmethod
    def of(cls, on: Surface, against: Surface, found: Overlaps) -> _Ties:
        """Add up the overlaps of facets."""
        d, v = on.dimension, on.vertices.shape[1]
        psi = Multipliers.of(on, found)
        nodes, local = np.unique(on.nodes, return_inverse=True)
        others, other_places = np.unique(against.nodes, return_inverse=True)
        local, other_places = (
            local.reshape(on.nodes.shape),
            other_places.reshape(against.nodes.shape),
        )
        count, corners = len(nodes), local[:, :v]
        functions, touched = psi.functions[found.i], np.unique(found.i)
        shared = functions @ found.shared
        places = np.zeros((count + len(others), 3))
        places[local.ravel()] = on.points.reshape(-1, 3)
        places[count + other_places.ravel()] = against.points.reshape(-1, 3)
        here = _scattered(corners[touched], local[touched], psi.own[touched], (count, count))
        shape = (count, len(others))
        jump = [here, _scattered(corners[found.i], other_places[found.j], -shared, shape)]
        tilt = sparse.csr_matrix((count, count * d * d))
        if found.tilt.any():
            turned = np.einsum("pjk,pkal->pjal", functions, found.tilt)
            axes = frames(on)[found.i][..., :d]
            turned = np.einsum("pjal,pai,pc->pjlci", turned, axes[:, :-1], axes[:, -1])
            column = local[found.i][..., None] * d * d + np.arange(d * d)
            column = column.reshape(len(column), -1)
            turned = turned.reshape(*turned.shape[:2], -1)
            tilt = _scattered(corners[found.i], column, turned, tilt.shape)
        jump = sparse.hstack(jump, format="csr")
        return cls(on, psi, nodes, others, corners, jump, tilt, places)

    def component(self, i: int, yielding: NDArray[np.bool_]) -> MeanGaps:
        """The rows of one component.

        Rows of yielding nodes (n,) are distributed to their neighbours.
        """
        d, v, count = self.on.dimension, self.corners.shape[1], len(self.nodes)
        weight = self.psi.weight
        total = np.bincount(self.corners.ravel(), weight.ravel(), minlength=count)
        share = np.repeat(self.psi.sizes / v, v)
        share = np.bincount(self.corners.ravel(), share, minlength=count)
        given = distribute(self.corners, weight, total, yielding | (total < WEAK * share))
        total = given @ total
        strong = np.flatnonzero(given.diagonal() > 0.0)
        scale = sparse.diags(1.0 / total[strong]) @ given[strong]
        jump, tilt = ((scale @ m).tocoo() for m in (self.jump, self.tilt))
        of_component = tilt.col % d == i  # of the result
        row = np.concatenate([jump.row, tilt.row[of_component]])
        column = np.concatenate([jump.col * d + i, tilt.col[of_component] // d])
        value = np.concatenate([jump.data, -tilt.data[of_component]])
        summed = sparse.csr_matrix(
            (value, (row, column)), shape=(len(strong), len(self.places) * d)
        )
        summed.data[np.abs(summed.data) < NEGLIGIBLE] = 0.0
        summed.eliminate_zeros()
        summed.sort_indices()
        entries = summed.tocoo()
        at, component = entries.col // d, entries.col % d
        own = at < count
        force = -entries.data[own, None] * np.eye(3)[component[own]]
        arm = self.places[at[own]] - self.places[strong[entries.row[own]]]
        moments = np.zeros((len(strong), 3))
        np.add.at(moments, entries.row[own], np.cross(arm, force))
        return MeanGaps(
            nodes=self.nodes[strong],
            points=self.places[strong],
            areas=total[strong],
            gaps=np.zeros(len(strong)),
            normals=np.tile(-np.eye(d)[i], (len(strong), 1)),
            moments=moments,
            row=entries.row.astype(np.int64),
            node=np.concatenate([self.nodes, self.others])[at],
            component=component.astype(np.int64),
            value=entries.data,
            entry_points=self.places[at],
        )


def _scattered(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    blocks: NDArray[np.float64],
    shape: tuple[int, int],
) -> sparse.csr_matrix:
    """Sum of blocks (n, v, w) at rows (n, v) and columns (n, w)."""
    row = np.broadcast_to(rows[:, :, None], blocks.shape)
    column = np.broadcast_to(columns[:, None, :], blocks.shape)
    return sparse.csr_matrix((blocks.ravel(), (row.ravel(), column.ravel())), shape=shape)
