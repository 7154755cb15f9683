"""Contact pressure, and tractions of ties, on facets that the other body covers in part.

Such a facet has the pressure p = Σ p_j φ_j in its covered part alone (`meshes.mortar`), and the
value p_j = λ_j / W_j of a node beyond the edge of the other body is an extrapolation: where a
twentieth of the facet is covered, twenty times the rise of the pressure towards the edge. The
pressure of such a node is therefore the mean about it over the covered part,

    q_k = ∫ p φ_k / ∫ φ_k = Σ_j S_jk λ_j / Σ_j S_jk W_j,    S_jk = ∫ ψ_j φ_k / W_j,

in which S follows from the contact rows, whose entries at `on` nodes are S_jk n. The numerator is
the force of the contact on the node, so that the means have the force of the contact. Where all
facets of a node are covered, the ψ_j are dual and q_j = p_j. Under a block on a plate whose facets
are 0.8 to 2 times as long, the largest extrapolation was up to 20 times the largest pressure of the
scene with exchanged sides, the largest mean is 0.6 to 1.4 times it.

On facets of degree 2 the φ_k are the linear functions of vertices. As the ψ_j are not dual there,
means flatten the pressure, and only vertices with a narrow covered strip have them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contact_app.model.facets import hats_at_nodes
from solver.tfeti.constraints.conditions import ContactRows
from solver.tfeti.constraints.exchange import NodeExchange

Array = NDArray[np.float64]

STRIP = 0.12
"""Covered share of the area about a vertex of degree 2 up to which it has the mean. A corner of a
body at a vertex, whose facets are covered completely or not at all, covers more."""


@dataclass(frozen=True, eq=False)
class OnSide:
    """The facets of the `on` side of a contact, and their nodes at the owners.

    Attributes
    ----------
    degree, dimension
    facets : (f, nodes per facet) each
        Copies of the nodes of this rank's facets, vertices first.
    owned : (n,)
        Ascending numbers of the nodes that this rank owns.
    shares : (n,)
        Integrals of the shape functions over the facets.
    exchange
        Of nodes with their owners.
    sums, copies
        From the copies of nodes (copies,) to their owners (n,), and back.
    """

    degree: int
    dimension: int
    facets: Sequence[NDArray[np.int64]]
    owned: NDArray[np.int64]
    shares: Array
    exchange: NodeExchange
    sums: Callable[[Array], Array]
    copies: Callable[[Array], Array]

    def with_means(self, rows: ContactRows, columns: Array, quotients: Array) -> Array:
        """Forces over areas with means in place of extrapolations, (n, c) (collective).

        Parameters
        ----------
        rows : k rows
            The mortar rows of the contact.
        columns : (k, 1 + c)
            Areas W_j, and c components of forces.
        quotients : (n, c)
            Forces over areas at the nodes of rows; those without a force remain.
        """
        sums, areas = self._at_nodes(rows, columns), self.shares
        sums[self._facets_of_node == 0.0] = 0.0
        partial = sums[:, 0] > 0.0
        if self.degree == 2:
            sums = np.stack([self._at_vertices(column) for column in sums.T], axis=1)
            partial &= sums[:, 0] < STRIP * self._at_vertices(areas)
        result = quotients.copy()
        result[partial] = sums[partial, 1:] / sums[partial, :1]
        return np.where(quotients != 0.0, result, 0.0)

    def share_of(self, areas: Array) -> Array:
        """Covered area about each vertex over the whole area about it, (n,) (collective)."""
        whole = self._at_vertices(self.shares) if self.degree == 2 else self.shares
        share = np.divide(areas, whole, out=np.zeros(len(areas)), where=whole > 0.0)
        return np.minimum(share, 1.0)

    @cached_property
    def _facets_of_node(self) -> Array:
        """Number of facets of each node, (n,)."""
        count = np.zeros(len(self.copies(self.shares)))
        for nodes in self.facets:
            np.add.at(count, nodes, 1.0)
        return self.sums(count)

    def _at_nodes(self, rows: ContactRows, columns: Array) -> Array:
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
        sums = np.zeros((len(self.owned), columns.shape[1]))
        np.add.at(sums, np.searchsorted(self.owned, query.nodes), arrived)
        return sums

    def _at_vertices(self, values: Array) -> Array:
        """Σ_k φ_j(x_k) v_k over the nodes k of each facet, φ_j linear, (n,)."""
        copies = self.copies(values / np.maximum(self._facets_of_node, 1.0))
        total = np.zeros(len(copies))
        for nodes in self.facets:
            hats = hats_at_nodes(self.dimension, nodes.shape[1])
            np.add.at(total, nodes[:, : len(hats)], copies[nodes] @ hats.T)
        return self.sums(total)
