"""The resultants of each contact of a scene, and its pressure at the written nodes.

The force on the body of `on` is the sum of the nodal forces f_k, its moment about a point c

    M = Σ (x_k - c) × f_k + m_k,

where m_k is the moment about the node of a row that is a mean about it; c is the centroid of the
boundary, ∫ x ds / ∫ ds. In the plane the moment is its one component.

If the scene was cut at planes of symmetry, all results are of the whole. Each contact of the whole
consists of mirror images of solved contacts: of itself, or of its partner on the other side. A
force is reflected as a vector, a moment as an axial vector, and nodes on a plane count once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.model.equilibrium import body_frame
from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.model.planes import on_planes
from contact_app.results.fields import NodeFields
from contact_app.results.mirror import FullMesh, Image, full_mesh
from contact_app.results.pressure import NodesInContact
from contact_app.results.resultants import Resultant, joined, summed
from solver.vectors import Array, Ints, Mask, largest_magnitude


@dataclass(frozen=True, eq=False)
class _Contact:
    """One contact of the solved part, over all ranks; `whole` is the force on the body of `on`."""

    whole: Resultant
    area: float
    """Area of the boundary that belongs to nodes in contact."""
    max_pressure: float
    max_smoothed: float


def contact_records(
    model: Model, nodes: NodeFields, peaks: Sequence[float | None]
) -> list[dict[str, Any]]:
    """The list `contacts` of ``summary.json``, in the order of the scene file (collective).

    Parameters
    ----------
    peaks
        The largest smoothed pressures of contacts where they are not those at nodes.
    """
    contacts = ContactsOfWhole(model, nodes, full_mesh(model.geometry, nodes))
    of_solved_part = _resultants(model.geometry, nodes, peaks)
    records = []
    for number, (name, counts) in enumerate(
        zip(model.scene.contact_names, contacts.counts(), strict=True)
    ):
        pieces = [
            (image, of_solved_part[origin])
            for image in contacts.images
            for origin in contacts.origins(image, number)
        ]
        resultants = [piece.whole.image(image) for image, piece in pieces]
        records.append({
            "on": name.on, "with": name.against, **joined(resultants, model.scene.dimension),
            "area": float(sum(piece.area for _, piece in pieces)),
            "max_pressure": max(piece.max_pressure for _, piece in pieces),
            "max_smoothed_pressure": max(piece.max_smoothed for _, piece in pieces),
            "nodes": counts,
        })  # fmt: skip
    return records


def _resultants(
    geometry: Geometry, nodes: NodeFields, peaks: Sequence[float | None]
) -> list[_Contact]:
    """Sums over the nodes of each contact of the solved part (collective)."""
    comm, resultants = geometry.comm, []
    for touching, contact, peak in zip(geometry.touching, nodes.contacts, peaks, strict=True):
        on = np.ones(len(contact.nodes), bool)
        centre = body_frame(geometry.bodies[touching.body])[0]  # near: sums lose no digits
        arm = nodes.points[contact.nodes - nodes.first] - centre
        whole = summed(comm, arm, on, contact.forces, contact.shares, contact.moments)
        largest = largest_magnitude(comm, contact.pressure)
        smoothed = largest_magnitude(comm, contact.smoothed) if peak is None else peak
        area = comm.allreduce(float(contact.areas.sum()))
        whole = replace(whole, point=centre + whole.point)
        resultants.append(_Contact(whole, area, largest, smoothed))
    return resultants


class ContactsOfWhole:
    """The contacts of the scene file at the nodes that this rank owns, and at their mirror images.

    Contacts are numbered as in the file, from 0.

    Parameters
    ----------
    nodes
        Fields of the solved part.
    whole
        Mirror images of the solved part.
    """

    def __init__(self, model: Model, nodes: NodeFields, whole: FullMesh) -> None:
        self.images = whole.images
        self._comm, self._scene, self._nodes = model.comm, model.scene, nodes
        self._on = on_planes(model.scene.bodies, model.scene.mirrors, nodes.points)
        self._place: dict[str, list[int]] = {}
        for i, contact in enumerate(model.scene.touching):
            self._place.setdefault(contact.source, []).append(i)

    def origins(self, image: Image, number: int) -> list[int]:
        """The solved contacts whose mirror images in an image belong to this contact.

        Several for a rigid body of several obstacles, none if the contact has no part in the image.
        """
        origin = image.origin(self._scene.contact_names[number].source)
        return [] if origin is None else self._place.get(origin, [])

    def counts(self) -> list[dict[str, int]]:
        """Numbers of nodes of each contact by status.

        Nodes of several images count once (collective).
        """
        counts = np.zeros((len(self._scene.contact_names), 3), np.int64)
        for number in range(len(counts)):
            seen: list[Image] = []
            for image in self.images:
                if not self.origins(image, number):
                    continue
                at, status = self._carriers(image, number)
                new = np.ones(len(at), bool)
                for earlier in seen:
                    new &= ~self._coincide(image, earlier, at)
                counts[number] += np.bincount(status[new], minlength=3)
                seen.append(image)
        return [
            {"open": int(left), "stick": int(stick), "slip": int(slip)}
            for left, stick, slip in self._comm.allreduce(counts)
        ]

    def _carriers(self, image: Image, number: int) -> tuple[Ints, Ints]:
        """Nodes of a contact in an image that may carry force, and their status, 0 to 2."""
        at, status = np.zeros(0, np.int64), np.zeros(0, np.int64)
        for origin in self.origins(image, number):
            contact = self._nodes.contacts[origin]
            at = np.concatenate([at, (contact.nodes - self._nodes.first)[contact.carriers]])
            status = np.concatenate([status, contact.status[contact.carriers]])
        nodes, place = np.unique(at, return_inverse=True)
        worst = np.zeros(len(nodes), np.int64)
        np.maximum.at(worst, place.reshape(-1), status)
        return nodes, worst

    def pressure(self, image: Image, number: int) -> Array:
        """Pressure of a contact at the images of the nodes, (nodes,); 0 away from it."""
        return self._field(image, number, lambda contact: contact.pressure)

    def overlapping(self) -> list[int]:
        """Contacts that share a node with another one (collective)."""
        names = range(len(self._scene.contact_names))
        shared = np.zeros(len(names), bool)
        for image in self.images:
            count = np.sum([self._on_boundary(image, number) for number in names], axis=0)
            several = (count > 1.0) & image.new
            for number in names:
                shared[number] |= bool((self._on_boundary(image, number)[several] > 0.0).any())
        self._comm.Allreduce(MPI.IN_PLACE, shared, op=MPI.LOR)
        return [int(number) for number in np.flatnonzero(shared)]

    def _on_boundary(self, image: Image, number: int) -> Array:
        """1 at the images of nodes on the boundary of a contact, (nodes,)."""
        return self._field(image, number, lambda contact: np.ones(len(contact.nodes)))

    def _field(self, image: Image, number: int, values: Callable[[NodesInContact], Array]) -> Array:
        """Values of a contact at the images of the nodes, (nodes,).

        A node on a plane also has the values of the image about that plane.
        """
        result = np.zeros(len(self._nodes.points))
        for other in self.images:
            for origin in self.origins(other, number):
                contact = self._nodes.contacts[origin]
                at = contact.nodes - self._nodes.first
                same = self._coincide(image, other, at)
                result[at[same]] = np.maximum(result[at[same]], values(contact)[same])
        return result

    def _coincide(self, image: Image, other: Image, at: Ints) -> Mask:
        """Mask of the nodes (n,) that have the same place in both images."""
        others = [
            k
            for k, mirror in enumerate(self._scene.mirrors)
            if (mirror in image.mirrors) != (mirror in other.mirrors)
        ]
        return np.asarray(self._on[others][:, at].all(axis=0))
