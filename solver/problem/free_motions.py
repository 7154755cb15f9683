"""Displacements without rigid motions that no row, or no row with a force, resists.

A ball between races may turn about itself. Its rotation is irrelevant, and relative to a large
rotation any penetration is small. So the reference of lengths is the displacement without these
motions: of a group of bodies with free motions L z and rigid motions M_b at the nodes of body b,

    min_z Σ_b |u_b - M_b L_b z|²  over all nodes,   i.e.  (Σ L_bᵀ M_bᵀ M_b L_b) z = Σ L_bᵀ M_bᵀ u_b,

and u_b - M_b L_b z is the remaining displacement. A node counts once: its copies in several
subdomains have equal shares.

A block that rests on a plane with play before a wall may slide, too, until it meets the wall. Of an
answer, such motions are those that held and tied rows leave and on which all rows with a force
vanish: N_p L z = 0. No load does work on them and they strain nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from solver.contact.equilibrium import held_motions, spanned
from solver.rigid_motions import MOTIONS, rigid_motions
from solver.vectors import Array, Ints

RESOLVED = 1e-12
"""Eigenvalue of the normal equations, over the largest, below which a motion moves no node."""


@dataclass(frozen=True, eq=False)
class LooseBodies:
    """Rigid motions that nothing resists, or only the facets of round surfaces."""

    along: Sequence[Array]  # one (motions, k) array per body
    """L_b; k is equal for all bodies of a group, and 0 without free motions."""
    allowed: Sequence[Array]  # one (motions, k) array per body
    """Rigid motions of each body that held and tied rows leave free."""
    centres: Array
    lengths: Array
    """Centre and length in the definition of each body's rigid motions. Shapes (bodies, 3),
    (bodies,)."""

    @property
    def any(self) -> bool:
        """Whether contact holds some body, or nothing."""
        return any(some.shape[1] > 0 for some in (*self.along, *self.allowed))


@dataclass(frozen=True, eq=False)
class FreeMotions:
    """Loose bodies, or bodies that contact holds, with the nodes of their subdomains here."""

    comm: MPI.Intracomm
    dimension: int
    groups: Ints  # (bodies,)
    """Group of each body."""
    loose: LooseBodies
    points: Sequence[Array]  # one (nodes, 3) array per class
    translations: Sequence[Array]  # one (members, 3) array per class
    """Translation of each member from the points of its class."""
    members: Sequence[Ints]  # one (members,) array per class
    """Body of each subdomain."""
    shares: Sequence[Array]  # one (members, nodes) array per class
    """One over the number of copies of each node."""
    rigid: Sequence[bool]  # (classes,)
    """Whether the unknowns of a class are the motions of a rigid body."""

    def of(
        self, displacements: Sequence[Array], along: Sequence[Array] | None = None
    ) -> list[Array]:
        """The free part of displacements, as rigid motions (motions,) of each body (collective).

        Rigid bodies do not count.

        Parameters
        ----------
        displacements : one (n, members) array per class
        along : one (motions, k) array per body
            The motions that are free; those of the loose bodies unless given.
        """
        every = self.loose.along if along is None else along
        grams, components, _ = self._sums(displacements, every)
        result = [np.zeros(along.shape[0]) for along in every]
        for group in np.unique(self.groups):
            bodies = np.flatnonzero(self.groups == group)
            if every[bodies[0]].shape[1]:
                gram = self.comm.allreduce(np.sum([grams[b] for b in bodies], axis=0))
                right = self.comm.allreduce(np.sum([components[b] for b in bodies], axis=0))
                size = np.linalg.pinv(gram, rcond=RESOLVED, hermitian=True) @ right
                for b in bodies:
                    result[b] = every[b] @ size
        return result

    def mean_squares(
        self, displacements: Sequence[Array], along: Sequence[Array], group: int
    ) -> tuple[Array, Array]:
        """Normal equations of the motions of a group in the mean square (collective).

        Σ V_bᵀ M_bᵀ M_b V_b / n_b and Σ V_bᵀ M_bᵀ u_b / n_b, (k, k) and (k,), over the bodies b of
        the group, with their n_b nodes. A rigid body counts by its displacement and its rotation
        times a length of the scene.

        Parameters
        ----------
        displacements : one (n, members) array per class
        along : one (motions, k) array per body
            V_b; k is equal for all bodies of the group.
        """
        grams, components, nodes = self._sums(displacements, along, rigid=True)
        bodies = np.flatnonzero(self.groups == group)
        nodes = self.comm.allreduce(nodes)
        sums = [np.column_stack([grams[b], components[b]]) / max(nodes[b], 1.0) for b in bodies]
        both = self.comm.allreduce(np.sum(sums, axis=0))
        return both[:, :-1], both[:, -1]

    def _sums(
        self, displacements: Sequence[Array], along: Sequence[Array], rigid: bool = False
    ) -> tuple[list[Array], list[Array], Array]:
        """This rank's parts of V_bᵀ M_bᵀ M_b V_b, V_bᵀ M_bᵀ u_b and n_b of each body.

        Parameters
        ----------
        rigid
            Whether rigid bodies count.
        """
        count = [some.shape[1] for some in along]
        grams = [np.zeros((k, k)) for k in count]
        components = [np.zeros(k) for k in count]
        nodes = np.zeros(len(count))
        for number, u in enumerate(displacements):
            if self.rigid[number] and not rigid:
                continue
            for member, body in enumerate(self.members[number]):
                if count[body]:
                    fields = self._motions(number, member) @ along[body]
                    share = self.shares[number][member]
                    weighted = fields * np.repeat(share, self.dimension)[:, None]
                    grams[body] += weighted.T @ fields
                    components[body] += weighted.T @ u[:, member]
                    nodes[body] += 1 if self.rigid[number] else share.sum()
        return grams, components, nodes

    def allowed_motions(self, group: int, interfaces: Sequence[Ints]) -> Array:
        """The allowed motions of a group on the interface of this rank, (interface, k).

        Parameters
        ----------
        interfaces
            Interface unknowns of each class.
        """
        bodies = np.flatnonzero(self.groups == group)
        count = self.loose.allowed[bodies[0]].shape[1]
        parts = [np.zeros((0, count))]
        for number, unknowns in enumerate(interfaces):
            for member, body in enumerate(self.members[number]):
                moved = np.zeros((len(unknowns), count))
                if count and self.groups[body] == group:
                    moved = self._motions(number, member)[unknowns] @ self.loose.allowed[body]
                parts.append(moved)
        return np.concatenate(parts)

    def unresisted(self, group: int, images: Array) -> list[Array]:
        """The motions of a group on which rows vanish, and its loose motions.

        (motions, k) for each body of the group (collective).

        Parameters
        ----------
        images : (rows, k)
            Some rows of this rank, applied to the allowed motions of the group.
        """
        bodies = np.flatnonzero(self.groups == group)
        allowed, loose = (
            np.concatenate([some[b] for b in bodies])
            for some in (self.loose.allowed, self.loose.along)
        )
        left = allowed @ held_motions(self.comm, images)
        both = spanned(np.hstack([left, loose]))
        return list(both.reshape(len(bodies), len(both) // len(bodies), both.shape[1]))

    def field(self, number: int, member: int, motion: Array) -> Array:
        """Displacements (n,) of one member of a class under a rigid motion of its body."""
        return np.asarray(self._motions(number, member) @ motion)

    def _motions(self, number: int, member: int) -> Array:
        """M_b at the nodes of one member, (n, motions)."""
        if self.rigid[number]:
            return np.eye(2 * self.dimension, MOTIONS[self.dimension])
        body = int(self.members[number][member])
        points = self.points[number] + self.translations[number][member]
        frame = self.loose.centres[body], float(self.loose.lengths[body])
        motions = rigid_motions(points, self.dimension, *frame)
        return motions.reshape(-1, motions.shape[2])
