"""Copies of the nodes on the surfaces of subdomains, which constraints connect."""

import numpy as np

from meshes import Partition
from meshes.arrays import Ints


class SurfaceCopies:
    """Copies of surface nodes of this rank's subdomains, one after another."""

    def __init__(self, partition: Partition) -> None:
        self.local: list[Ints] = []
        cache: dict[int, Ints] = {}
        for s in partition.subdomains:
            key = id(s.reference)
            if key not in cache:
                cache[key] = np.unique(s.reference.facets).astype(np.int64)
            self.local.append(cache[key])
        self.starts = np.cumsum([0, *(len(n) for n in self.local)])
        parts = [s.nodes[local] for s, local in zip(partition.subdomains, self.local, strict=True)]
        self.nodes: Ints = np.concatenate(parts)
        numbers = np.array([s.number for s in partition.subdomains], np.int64)
        self.subdomains = np.repeat(numbers, np.diff(self.starts))

    def copies(self, subdomain: int) -> slice:
        """Copies of one subdomain (local number)."""
        return slice(int(self.starts[subdomain]), int(self.starts[subdomain + 1]))
