"""The geometry of a scene: its bodies cut into subdomains, their boundaries and what may touch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.boundaries import boundary_facets, surface_facets
from contact_app.model.planes import on_planes
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import BodyContact, Contact, RigidTie, Tie
from contact_app.scene.rigid import RigidBodies
from contact_app.scene.scene import Mirror, Scene
from meshes import Partition
from meshes.contact_surface import Surface


@dataclass(frozen=True, eq=False)
class Geometry:
    """The bodies of a scene, the elastic ones cut into subdomains."""

    bodies: tuple[Body, ...]
    rigid: RigidBodies
    """Elastic bodies, and rigid ones."""
    contacts: tuple[Contact, ...]
    pairs: tuple[BodyContact, ...]
    """Contacts with obstacles and rigid bodies, and pairs of elastic bodies that may touch."""
    ties: tuple[Tie | RigidTie, ...]
    """Tied pairs, then boundaries tied to rigid bodies."""
    mirrors: tuple[Mirror, ...]
    """Planes of symmetry at which the scene was cut."""
    partition: Partition
    source: Path
    """The file of the scene."""
    at: Callable[[str], str]
    """File, line and key of a condition or contact, to begin a message with."""

    @classmethod
    def of(cls, scene: Scene, partition: Partition) -> "Geometry":
        """The geometry of a scene whose bodies were cut."""
        return cls(
            scene.bodies, scene.rigid, scene.contacts, scene.pairs, scene.all_ties, scene.mirrors,
            partition, scene.source, scene.at,
        )  # fmt: skip

    @property
    def touching(self) -> tuple[Contact | BodyContact, ...]:
        """All contacts in the order of the sources of contact rows."""
        return (*self.contacts, *self.pairs)

    @property
    def body_names(self) -> list[str]:
        """Names of the bodies in the order of the solver: elastic ones, then moving rigid ones."""
        rigid = [self.rigid.bodies[k].name for k in self.rigid.moving]
        return [*(body.name for body in self.bodies), *rigid]

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.partition.dimension

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""
        return self.partition.comm

    @property
    def length(self) -> float:
        """A length of the scene: the largest extent of an elastic body."""
        extents = [np.ptp([b.mesh.lower, b.mesh.upper], axis=0) for b in self.bodies]
        return max(float(extent.max()) for extent in extents)

    @cached_property
    def facets_of(self) -> Callable[[int, str], list[NDArray[np.int32]]]:
        """Rows of the reference's facets of each subdomain of this rank on a boundary of a body.

        Found once for each boundary.
        """
        return cache(self._facets_of)

    @cached_property
    def boundary_surface(self) -> Callable[[int, str], Surface | None]:
        """The surface of a boundary of a body, as `surface_of` has it (collective).

        Made once for each boundary: contact rows, results and warnings ask for the same ones.
        """
        return cache(lambda body, boundary: self.surface_of(self.facets_of(body, boundary)))

    def _facets_of(self, body: int, boundary: str) -> list[NDArray[np.int32]]:
        """Find the facets by the condition of the boundary, or by its name in the mesh."""
        none = np.zeros(0, np.int32)
        subdomains, of_body = self.partition.subdomains, self.bodies[body]
        if boundary not in of_body.boundaries:
            return [
                boundary_facets(s, of_body, boundary) if s.body == body else none
                for s in subdomains
            ]
        # the condition is evaluated once, on the facets of all subdomains
        surfaces = [surface_facets(s, of_body) if s.body == body else none for s in subdomains]
        points = [
            s.points()[s.reference.facets[rows]]
            for s, rows in zip(subdomains, surfaces, strict=True)
            if len(rows)
        ]
        if not points:
            return surfaces
        every = np.concatenate(points)
        inside = of_body.boundaries[boundary](every.reshape(-1, 3))
        on = inside.reshape(every.shape[:2]).all(axis=1)
        parts = np.split(on, np.cumsum([len(rows) for rows in surfaces])[:-1])
        return [rows[part] for rows, part in zip(surfaces, parts, strict=True)]

    def surface_of(self, facets: Sequence[NDArray[np.int32]]) -> Surface | None:
        """Facets of the whole scene, mirror images too, on all ranks; None if there are none.

        Collective.

        Parameters
        ----------
        facets
            Rows of the reference's facets of each subdomain of this rank.
        """
        parts, partition = [], self.partition
        for s, rows in zip(partition.subdomains, facets, strict=True):
            if len(rows):
                on = s.reference.facets[rows]
                behind = s.reference.middles_behind[rows] + s.translation
                parts.append((s.nodes[on], s.points()[on], behind))
        gathered = [part for rank in partition.comm.allgather(parts) for part in rank]
        if not gathered:
            return None
        nodes, points, inside = (np.concatenate(part) for part in zip(*gathered, strict=True))
        for k, mirror in enumerate(self.mirrors):
            off_planes = ~on_planes(self.bodies, self.mirrors, points)[k]
            nodes = np.concatenate([nodes, nodes + off_planes * (partition.nodes << k)])
            points, inside = (np.concatenate([x, mirror.image(x)]) for x in (points, inside))
        return Surface.of(partition.dimension, nodes, points, inside)
