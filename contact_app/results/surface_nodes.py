"""The nodes of the bodies' surfaces, and integrals of shape functions over facets there.

Every rank has copies of the nodes on the surfaces of its subdomains; the copies of a node meet at
its owner, where sums over facets of several subdomains become those of the undecomposed mesh.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contact_app.model.facets import hats_at_nodes, moments
from meshes import Partition, Subdomain
from meshes.arrays import Array, Ints
from solver.exchange import NodeExchange


@dataclass(frozen=True, eq=False)
class SurfaceNodes:
    """Copies of the nodes on the bodies' surfaces in this rank's subdomains, and their owners."""

    local: list[Ints]  # list of (copies of a subdomain,)
    """Ascending local nodes of each subdomain on the surface of its body."""
    exchange: NodeExchange
    """Meeting place of the copies, one subdomain after another."""
    owned: Ints  # (owned,)
    """Ascending numbers of the surface nodes this rank owns."""
    place: Ints  # (arrived,)
    """Row in `owned` of each copy that arrives."""

    @classmethod
    def of(cls, partition: Partition) -> "SurfaceNodes":
        """Find them (collective)."""
        subdomains = partition.subdomains
        local = [np.unique(s.reference.facets[s.exterior]).astype(np.int64) for s in subdomains]
        numbers = [s.nodes[nodes] for s, nodes in zip(subdomains, local, strict=True)]
        exchange = NodeExchange(partition.comm, np.concatenate(numbers), partition.nodes)
        owned, place = np.unique(exchange.nodes, return_inverse=True)
        return cls(local, exchange, owned, place.reshape(-1))

    @property
    def starts(self) -> Ints:
        """Number of the first copy of each subdomain, and of all copies, (subdomains + 1,)."""
        return np.cumsum([0, *map(len, self.local)])

    def sums(self, copies: Array) -> Array:
        """Sum values (copies,) at the owners, (owned,) (collective)."""
        arrived = self.exchange.to_owners(copies)
        return np.bincount(self.place, arrived, len(self.owned)).astype(np.float64)

    def copies(self, values: Array) -> Array:
        """Bring values (owned,) to the copies (collective)."""
        return self.exchange.from_owners(values[self.place])

    def shares(
        self, partition: Partition, chosen: Sequence[NDArray[np.int32]], hats: bool = False
    ) -> Array:
        """∫ φ_k over chosen facets, (owned,) (collective).

        Parameters
        ----------
        chosen
            As in `facet_shares`.
        hats
            Whether the integrals are those of the hat functions of vertices.
        """
        sums = np.zeros(self.starts[-1])
        for _, _, nodes, share in facet_shares(partition, self, chosen):
            if hats:
                share = share @ hats_at_nodes(partition.dimension, nodes.shape[1]).T
                nodes = nodes[:, : share.shape[1]]
            np.add.at(sums, nodes, share)
        return self.sums(sums)


def facet_shares(
    partition: Partition, surface: SurfaceNodes, chosen: Sequence[NDArray[np.int32]]
) -> Iterator[tuple[Subdomain, NDArray[np.int32], Ints, Array]]:
    """Nodes of some facets and the integrals of their shape functions, subdomain by subdomain.

    Congruent subdomains share the integrals.

    Parameters
    ----------
    chosen
        Rows of the reference's facets of each subdomain of this rank, as `Geometry.facets_of` has
        them.

    Yields
    ------
    Subdomain, its chosen facets, their copies (facets, nodes) among those of `surface`, and ∫ φ_k
    over each (facets, nodes).
    """
    cache: dict[tuple[int, bytes], Array] = {}
    starts = surface.starts
    for local, (s, rows) in enumerate(zip(partition.subdomains, chosen, strict=True)):
        if len(rows) == 0:
            continue
        facets = s.reference.facets[rows]
        key = (id(s.reference), rows.tobytes())
        if key not in cache:
            x = s.reference.points[facets]
            cache[key] = moments(x, partition.dimension).sum(axis=1)
        yield s, rows, starts[local] + np.searchsorted(surface.local[local], facets), cache[key]
