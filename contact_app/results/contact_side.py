"""The facets of one side of a contact: pressures and tractions from the forces of contact rows.

The meaning of a multiplier depends on the rows. Between bodies, and for second-order tetrahedra at
obstacles, multipliers are mean pressures about a vertex times an area: p_j = λ_j / W_j. Multipliers
of rows at nodes are nodal forces f_k = ∫ p φ_k, and the pressure is the force over the node's share
of the boundary, q_k = f_k / ∫ φ_k.

For degree 2 this is not enough. Corners and middles have different shape functions, and if the
boundary is a polygon or the material nearly incompressible, q alternates between them about the
right mean on any mesh. `alternation` removes this part; the values are then as accurate as those of
degree 1 on as many nodes.

Near ν = 0.5 the alternation is a large part of the pressure, opens nodes that should be in contact,
and cannot be distinguished from the edge of the contact. Then the pressure is linear on each facet,
with the values at the vertices

    P q = Σ_k ψ_j(x_k) f_k / ∫ ψ_j,     ψ_j the linear shape function of vertex j:

the mean of the pressure about the vertex, in which alternations cancel. It flattens a smooth peak
by h²p''/12; the mean of the removed part is added again, p = P q + P(q - P q) (twicing, J. W.
Tukey, *Exploratory Data Analysis*, 1977, chapter 16), which leaves errors of fourth order.

Negative values of p are set to zero and the rest is scaled so that ∫ p is the force.
Constant pressures are exact, linear ones are inside the boundary. Beside a jump means about
vertices overshoot by at most 3 % of it; at the end of the boundary the last of them is off by a
ninth of the change over the last facet.

Between bodies, a facet that the other body covers in part has the pressure p = Σ p_j φ_j in its
covered part alone (`meshes.mortar`), and the value p_j = λ_j / W_j of a node beyond the edge of the
other body is an extrapolation: where a twentieth of the facet is covered, twenty times the rise of
the pressure towards the edge. The pressure of such a node is therefore the mean about it over the
covered part,

    q_k = ∫ p φ_k / ∫ φ_k = Σ_j S_jk λ_j / Σ_j S_jk W_j,    S_jk = ∫ ψ_j φ_k / W_j,

in which S follows from the contact rows, whose entries at `on` nodes are S_jk n. The numerator is
the force of the contact on the node, so that the means have the force of the contact. Where all
facets of a node are covered, the ψ_j are dual and q_j = p_j. Under a block on a plate whose facets
are 0.8 to 2 times as long, the largest extrapolation was up to 20 times the largest pressure of the
scene with exchanged sides, the largest mean is 0.6 to 1.4 times it.

On facets of degree 2 the φ_k are the linear functions of vertices. As the ψ_j are not dual there,
means flatten the pressure, and only vertices with a narrow covered strip have them, where the other
body covers no facet about them completely.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from contact_app.model.facets import between_vertices, hats_at_nodes
from contact_app.results.alternation import Lines, alternation
from meshes.arrays import Array, Ints, Mask
from meshes.mortar import COVERED
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows

STRIP = {2: 0.27, 3: 0.2}
"""Covered share of the area about a vertex of degree 2 up to which it has the mean where the other
side covers no facet about it completely, by dimension. In space the largest pressures of plates
under blocks at random places are 0.7 to 1.4 times those with exchanged sides; with 0.12 up to twice
as large, with 0.3 a fifth too small in the median. In the plane they are 0.7 to 1.3 times with
0.25, and up to 1.7 times with 0.12."""

STRONG = 0.05
"""Alternation over pressure, both in the mean, from which on averages about vertices are used."""


@dataclass(frozen=True, eq=False)
class ContactSide:
    """The facets of the `on` side of a contact, and their nodes at the owners.

    Methods are collective.
    """

    degree: int
    dimension: int
    facets: Sequence[tuple[Ints, Array]]  # (f, nodes per facet), (f, nodes per facet) each
    """Copies of the nodes of this rank's facets, vertices first, and ∫ φ_k over each facet."""
    points: Array  # (copies, 3)
    owned: Ints  # (n,)
    """Ascending numbers of the nodes that this rank owns."""
    exchange: NodeExchange
    """Exchange of nodes with their owners."""
    sums: Callable[[Array], Array]
    copies: Callable[[Array], Array]
    """From the copies of nodes (copies,) to their owners (n,), and back."""

    @cached_property
    def shares(self) -> Array:
        """∫ φ_k over the facets, (n,)."""
        total = np.zeros(len(self.points))
        for nodes, share in self.facets:
            np.add.at(total, nodes, share)
        return self.sums(total)

    @cached_property
    def areas(self) -> Array:
        """∫ ψ_j of the hat functions of vertices, (n,)."""
        return self._about(np.ones(len(self.points)))

    @cached_property
    def facets_of_node(self) -> Array:
        """Number of facets of each node, (n,)."""
        count = np.zeros(len(self.points))
        for nodes, _ in self.facets:
            np.add.at(count, nodes, 1.0)
        return self.sums(count)

    def pressures(
        self,
        rows: ContactRows,
        areas: Array,
        forces: Array,
        at_nodes: bool,
        between: bool,
        folded: Mask | None = None,
    ) -> tuple[Array, Array, Array]:
        """Pressure (n,), friction traction (n, 3) and covered share of nodes, (n,).

        Parameters
        ----------
        rows : k rows
            The rows of the contact.
        areas : (k,)
        forces : (k, 1 + 3)
            Normal forces, and vectors of friction.
        at_nodes
            Whether the contact law is enforced at all nodes, not in the mean about vertices.
        between
            Whether the other side is a body, which may cover facets in part.
        folded
            Copies on planes of symmetry, as `alternation` takes them.
        """
        wide = areas > 0.0
        quotients = np.zeros((len(self.owned), forces.shape[1]))
        quotients[np.searchsorted(self.owned, rows.nodes[wide])] = forces[wide] / areas[wide, None]
        quotients[:, 0] = np.maximum(quotients[:, 0], 0.0)
        covered = np.ones(len(self.owned))
        if between:
            at_owned = np.zeros(len(self.owned))
            at_owned[np.searchsorted(self.owned, rows.nodes)] = areas
            sums = self.at_nodes(rows, np.column_stack([areas, forces]))
            quotients = self.with_means(sums, quotients)
            covered = self.share_of(at_owned)
        if self.degree == 2 and at_nodes:
            quotients[:, 0] = self._recovered(quotients[:, 0], folded)
        elif self.degree == 2:
            if between:
                covered = np.where(self.areas > 0.0, covered, self._share_at_nodes(rows, areas))
            quotients = np.stack([self.at_all_nodes(part) for part in quotients.T], axis=1)
        return quotients[:, 0], quotients[:, 1:], covered

    def with_means(self, sums: Array, quotients: Array) -> Array:
        """Forces over areas with means in place of extrapolations, (n, c).

        Parameters
        ----------
        sums : (n, 1 + c)
            Areas W_j, and c components of forces, `at_nodes`.
        quotients : (n, c)
            Forces over areas at the nodes of rows; those without a force remain.
        """
        most = np.full(len(self.owned), np.inf)
        sums = np.where(self.facets_of_node[:, None] == 0.0, 0.0, sums)
        if self.degree == 2:
            most = STRIP[self.dimension] * self._at_vertices(self.shares)
            most[self._beside_covered_facets(sums[:, 0])] = 0.0
            sums = np.stack([self._at_vertices(column) for column in sums.T], axis=1)
        partial = (sums[:, 0] > 0.0) & (sums[:, 0] < most)
        result = quotients.copy()
        result[partial] = sums[partial, 1:] / sums[partial, :1]
        return np.where(quotients != 0.0, result, 0.0)

    def _beside_covered_facets(self, covered: Array) -> Mask:
        """Mask (n,) of the vertices of facets whose middles the other side may cover completely.

        Parameters
        ----------
        covered : (n,)
            Integrals of the φ_k over the covered parts of facets.
        """
        copies, marks = self.copies(covered), np.zeros(len(self.points))
        for nodes, share in self.facets:
            v = len(hats_at_nodes(self.dimension, nodes.shape[1]))
            whole = (copies[nodes[:, v:]] >= COVERED * share[:, v:]).all(axis=1)
            marks[nodes[whole, :v]] = 1.0
        return self.sums(marks) > 0.0

    def share_of(self, areas: Array) -> Array:
        """Covered area about each vertex over the whole area about it, (n,)."""
        whole = self._at_vertices(self.shares) if self.degree == 2 else self.shares
        share = np.divide(areas, whole, out=np.zeros(len(areas)), where=whole > 0.0)
        return np.minimum(share, 1.0)

    def _share_at_nodes(self, rows: ContactRows, areas: Array) -> Array:
        """Integral of each φ_k over the covered part of facets over that over all of them, (n,)."""
        part = self.at_nodes(rows, areas[:, None])[:, 0]
        share = np.divide(part, self.shares, out=np.zeros(len(part)), where=self.shares > 0.0)
        return np.clip(share, 0.0, 1.0)

    def at_all_nodes(self, values: Array) -> Array:
        """Values (n,) at vertices, interpolated to the middles."""
        on = np.zeros(len(self.points))
        for nodes, _ in self.facets:
            on[nodes] = 1.0
        summed = self.sums(np.where(on > 0.0, self._extended(values), 0.0))
        count = self.sums(on)
        return np.divide(summed, count, out=values.copy(), where=count > 0.0)

    def _recovered(self, pressure: Array, folded: Mask | None) -> Array:
        """The pressure at all nodes from forces over shares (n,), without alternation."""
        q = self.copies(pressure)
        lines = Lines.of([nodes for nodes, _ in self.facets], self.points)
        off = alternation(lines, q, lambda values: self.copies(self.sums(values)), folded)
        part = self.sums(off) / np.maximum(self.sums(np.ones(len(q))), 1.0)
        recovered = np.maximum(pressure - part, 0.0)
        every = np.stack([pressure, np.abs(part), recovered]) @ self.shares
        force, alternating, left = self.exchange.comm.allreduce(every)
        if alternating > STRONG * force:
            return self.at_all_nodes(self._smoothed(pressure))
        return recovered * (force / left if left > 0.0 else 1.0)

    def _smoothed(self, pressure: Array) -> Array:
        """Means about vertices of the pressure from forces over shares (n,)."""
        copies = self.copies(pressure)
        mean = self._about_vertices(copies)
        change = self._about_vertices(copies - self._extended(mean))
        lowered, raised = np.minimum(change, 0.0), np.maximum(change, 0.0)
        cut = np.maximum(lowered, -mean)
        sums = self.exchange.comm.allreduce(np.stack([lowered, cut]) @ self.areas)
        return mean + cut + raised * (sums[1] / sums[0] if sums[0] < 0.0 else 1.0)

    def _about_vertices(self, copies: Array) -> Array:
        """P: averages about the vertices of values at copies, (n,); 0 elsewhere."""
        some = self.areas > 0.0
        return np.divide(self._about(copies), self.areas, out=np.zeros(len(some)), where=some)

    def _about(self, copies: Array) -> Array:
        """Σ_k ψ_j(x_k) v_k ∫ φ_k of values at copies, at the vertices j, (n,)."""
        total = np.zeros(len(copies))
        for nodes, share in self.facets:
            hats = hats_at_nodes(self.dimension, nodes.shape[1])
            np.add.at(total, nodes[:, : len(hats)], (share * copies[nodes]) @ hats.T)
        return self.sums(total)

    def _extended(self, values: Array) -> Array:
        """Values (n,) at vertices, interpolated to the middles, at this rank's copies."""
        copies = self.copies(values)
        for nodes, _ in self.facets:
            between_vertices(nodes, copies)
        return copies

    def at_nodes(self, rows: ContactRows, columns: Array) -> Array:
        """Σ_j S_jk v_j at the owned nodes k, (n, columns); of no meaning at other bodies' nodes."""
        parts = (rows.entries, rows.held, rows.replaced)
        row, node, component, value = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("row", "node", "component", "value")
        )
        normals = rows.normals / np.einsum("ri,ri->r", rows.normals, rows.normals)[:, None]
        share = -value * normals[row, component]
        query = self.exchange.among(node)
        arrived = query.to_owners(share[:, None] * columns[row])
        place = np.searchsorted(self.owned, query.nodes)
        sums = [np.bincount(place, column, len(self.owned)) for column in arrived.T]
        return np.stack(sums, axis=1)

    def _at_vertices(self, values: Array) -> Array:
        """Σ_k φ_j(x_k) v_k over the nodes k of each facet, φ_j linear, (n,)."""
        copies = self.copies(values / np.maximum(self.facets_of_node, 1.0))
        total = np.zeros(len(copies))
        for nodes, _ in self.facets:
            hats = hats_at_nodes(self.dimension, nodes.shape[1])
            np.add.at(total, nodes[:, : len(hats)], copies[nodes] @ hats.T)
        return self.sums(total)
