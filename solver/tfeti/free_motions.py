"""Displacements without the rigid motions that nothing resists.

A ball between races may turn about itself. Its rotation is irrelevant, and relative to a large
rotation any penetration is small. So the reference of lengths is the displacement without these
motions: of a group of bodies with free motions L z and rigid motions M_b at the nodes of body b,

    min_z Σ_b |u_b - M_b L_b z|²  over all nodes,   i.e.  (Σ L_bᵀ M_bᵀ M_b L_b) z = Σ L_bᵀ M_bᵀ u_b,

and u_b - M_b L_b z is the remaining displacement. A node counts once for each subdomain that has
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.tfeti.subdomain.kernels import rigid_motions

Array = NDArray[np.float64]

RESOLVED = 1e-12
"""Eigenvalue of the normal equations, over the largest, below which a motion moves no node."""


@dataclass(frozen=True, eq=False)
class LooseBodies:
    """Rigid motions that nothing resists, or only the facets of round surfaces.

    Attributes
    ----------
    along : one (motions, k) array per body
        L_b; k is equal for all bodies of a group, and 0 without free motions.
    centres, lengths : (bodies, 3), (bodies,)
        Centre and length in the definition of each body's rigid motions.
    """

    along: Sequence[Array]
    centres: Array
    lengths: Array

    @property
    def any(self) -> bool:
        """Whether some body has such motions."""
        return any(along.shape[1] > 0 for along in self.along)


@dataclass(frozen=True, eq=False)
class FreeMotions:
    """Loose bodies with the nodes of their subdomains on this rank.

    Attributes
    ----------
    groups : (bodies,)
        Group of each body.
    points : one (nodes, 3) array per class
    translations : one (members, 3) array per class
        Translation of each member from the points of its class.
    members : one (members,) array per class
        Body of each subdomain.
    """

    comm: MPI.Intracomm
    dimension: int
    groups: NDArray[np.int64]
    loose: LooseBodies
    points: Sequence[Array]
    translations: Sequence[Array]
    members: Sequence[NDArray[np.int64]]

    def of(self, displacements: Sequence[Array]) -> list[Array]:
        """The free part of displacements, as rigid motions (motions,) of each body (collective).

        Parameters
        ----------
        displacements : one (n, members) array per class
        """
        every = self.loose.along
        count = [along.shape[1] for along in every]
        grams = [np.zeros((k, k)) for k in count]
        seen = [np.zeros(k) for k in count]
        for number, u in enumerate(displacements):
            for member, body in enumerate(self.members[number]):
                if count[body]:
                    fields = self._motions(number, member) @ every[body]
                    grams[body] += fields.T @ fields
                    seen[body] += fields.T @ u[:, member]
        result = [np.zeros(along.shape[0]) for along in every]
        for group in np.unique(self.groups):
            bodies = np.flatnonzero(self.groups == group)
            if count[bodies[0]]:
                gram = self.comm.allreduce(np.sum([grams[b] for b in bodies], axis=0))
                right = self.comm.allreduce(np.sum([seen[b] for b in bodies], axis=0))
                size = np.linalg.pinv(gram, rcond=RESOLVED, hermitian=True) @ right
                for b in bodies:
                    result[b] = every[b] @ size
        return result

    def field(self, number: int, member: int, motion: Array) -> Array:
        """Displacements (n,) of one member of a class under a rigid motion of its body."""
        return np.asarray(self._motions(number, member) @ motion)

    def _motions(self, number: int, member: int) -> Array:
        """M_b at the nodes of one member, (n, motions)."""
        body = int(self.members[number][member])
        points = self.points[number] + self.translations[number][member]
        frame = self.loose.centres[body], float(self.loose.lengths[body])
        motions = rigid_motions(points, self.dimension, *frame)
        return motions.reshape(-1, motions.shape[2])
