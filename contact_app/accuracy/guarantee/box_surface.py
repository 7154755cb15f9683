"""Conditions of a scene on the faces of a box, facet by facet of its grid.

Stresses in equilibrium (`equilibrated`) live on the grid of a box. For each facet they need the
held components, the load and the gap to an obstacle. A boundary of the scene consists of the facets
with all nodes on it. This module also refuses scenes that cannot have a guarantee: scenes whose
gaps or data inside a facet do not follow from the values at its nodes.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.accuracy.guarantee.equilibrated import (
    AdmissibleStresses,
    FaceData,
    NoAdmissibleStressError,
)
from contact_app.errors import ConfigurationError
from contact_app.machine.memory import available_bytes
from contact_app.model.boundaries import boundary_facets, boundary_nodes
from contact_app.scene.bodies import Body, BodyMesh, Box
from contact_app.scene.conditions import Contact
from contact_app.scene.obstacles import Plane
from contact_app.scene.scene import Scene
from meshes import Partition, Subdomain
from meshes.arrays import Array, Ints, Mask

Place = tuple[Ints, ...]

ON_PLANE = 1e-9
"""Distance from a face of a body, relative to its size, within which points lie on the face."""

BYTES_PER_CELL = 1e4
"""Memory for the search of stresses per cell of the grid, measured at 20³ and 32³ cells; the plane
needs less."""

PARALLEL = 1e-14
"""Largest difference between an obstacle's normal and the normal of the face."""


@dataclass(frozen=True, eq=False)
class FacetsOnFace:
    """Facets of a subdomain's mesh on one face of a box."""

    face: int
    """Number of the face: x-, x+, y-, …"""
    rows: NDArray[np.int32]  # (facets,)
    """Rows of the reference's facets."""
    place: Place  # one (facets,) array an axis across
    """Positions of the facets on the grid of the face."""
    share: float
    """Area of each facet relative to its facet of the grid."""


class BoxSurface:
    """The grid of a body that is a box, and the known data on its faces (collective).

    Attributes
    ----------
    axes
        Grid coordinates along each axis.
    faces
        x-, x+, y-, …
    compliance : (components, components)
        C⁻¹.
    stresses
        The stresses in equilibrium with the loads.

    Raises
    ------
    NoAdmissibleStressError
        The space of stresses cannot represent such a scene.
    """

    def __init__(self, scene: Scene, partition: Partition, number: int) -> None:
        self.scene, self.number, self.comm = scene, number, partition.comm
        self.dimension = d = scene.dimension
        self.body: Body = scene.bodies[number]
        if self.body.degree != 1:
            raise NoAdmissibleStressError(
                f"{self.body.name} has degree 2, whose gaps at nodes do not keep it off an "
                "obstacle between them"
            )
        if self.body.mean_dilatation:
            raise NoAdmissibleStressError(
                f"{self.body.name} has mean_dilatation, whose energy is not that of its "
                "displacement"
            )
        self.axes = grid_lines(self.body)
        self.cells = tuple(len(x) - 1 for x in self.axes)
        self._size = float(max(x[-1] - x[0] for x in self.axes))
        self._subdomains = [s for s in partition.subdomains if s.body == number]
        shapes = [tuple(np.delete(self.cells, axis)) for axis in range(d) for _ in range(2)]
        self.faces = [FaceData.free(shape, d) for shape in shapes]
        self._hold()
        self._load()
        for contact in scene.contacts:
            if contact.body == number:
                self._oppose(contact)
        self.compliance = self.body.materials[0].compliance(scene.plane, d)
        force = np.zeros(d)
        for load in scene.forces:
            if load.body == number:
                force += load.vector
        self.stresses = AdmissibleStresses(self.axes, self.compliance, self.faces, force)

    def _hold(self) -> None:
        for condition in self.scene.displacements:
            if condition.body != self.number:
                continue
            inside = self._facets(condition.boundary, condition.source, with_nodes=True)
            for facets, face in zip(inside, self.faces, strict=True):
                for component, value in enumerate(condition.values):
                    if value is not None:
                        face.held[facets, component] = True
                        face.displacement[facets, component] = value

    def _load(self) -> None:
        """Add the tractions and pressures of the scene to the faces; refuse total forces."""
        for load in self.scene.total_loads:
            if load.body == self.number:
                raise NoAdmissibleStressError(
                    f"{load.source} is a total force or moment; give a traction"
                )
        for traction in self.scene.tractions:
            if traction.body == self.number:
                inside = self._facets(traction.boundary, traction.source)
                for facets, face in zip(inside, self.faces, strict=True):
                    face.traction[facets] += traction.vector
        for pressure in self.scene.pressures:
            if pressure.body == self.number:
                inside = self._facets(pressure.boundary, pressure.source)
                for number, (facets, face) in enumerate(zip(inside, self.faces, strict=True)):
                    axis, sign, _ = self.side(number)
                    face.traction[facets, axis] -= sign * pressure.value

    def _oppose(self, contact: Contact) -> None:
        """Note the gap of a contact on its faces; refuse obstacles not parallel to them."""
        inside = self._facets(contact.boundary, contact.source, with_nodes=True)
        for number, (facets, face) in enumerate(zip(inside, self.faces, strict=True)):
            if not facets.any():
                continue
            axis, sign, plane = self.side(number)
            point, outward = np.zeros((1, 3)), np.zeros(3)
            point[0, axis], outward[axis] = plane, sign
            gap, normal = contact.gap_and_normal(point)
            flat = isinstance(contact.obstacle, Plane)
            if not flat or np.abs(normal[0] + outward).max() > PARALLEL:
                raise NoAdmissibleStressError(
                    f"the obstacle of {contact.source} is not a plane parallel to the face it "
                    "meets: its gap at nodes is not that between them"
                )
            nearest = np.where(face.contact, np.minimum(face.gap, gap[0]), gap[0])
            face.gap[facets] = nearest[facets]
            face.contact[facets] = True

    def side(self, face: int) -> tuple[int, float, float]:
        """Axis of a face, sign of its outward normal and place along the axis."""
        axis, end = divmod(face, 2)
        return axis, (1.0 if end else -1.0), float(self.axes[axis][-1 if end else 0])

    def pressed(self, face: int) -> Mask:
        """Facets of a face on which an obstacle may push."""
        data = self.faces[face]
        return np.asarray(data.contact & ~data.held[..., face // 2])

    def cells_at(self, points: Array) -> Ints:
        """Cells of the grid in which points (n, d) lie, (n, d)."""
        return np.stack([_between(x, points[:, k]) for k, x in enumerate(self.axes)], axis=1)

    def facets_on_faces(self, s: Subdomain, rows: NDArray[np.int32]) -> Iterator[FacetsOnFace]:
        """Some facets of a subdomain of this body, sorted by the face they are on."""
        d = self.dimension
        centres = s.points()[s.reference.facets[rows]][..., :d].mean(axis=1)
        share = 0.5 if s.reference.cell == "tetrahedron" else 1.0
        for face in range(2 * d):
            axis, _, plane = self.side(face)
            on_face = np.abs(centres[:, axis] - plane) <= ON_PLANE * self._size
            if on_face.any():
                across = [k for k in range(d) if k != axis]
                place = tuple(_between(self.axes[k], centres[on_face, k]) for k in across)
                yield FacetsOnFace(face, rows[on_face], place, share)

    def _facets(self, boundary: str, source: str, with_nodes: bool = False) -> list[Mask]:
        """Facets of the grid on a boundary, face by face; every node has to be one of theirs.

        Raises
        ------
        NoAdmissibleStressError
            The boundary has parts of facets, or nodes that belong to no facet.
        """
        shares = [np.zeros(face.contact.shape) for face in self.faces]
        nodes = [np.zeros((0, self.dimension))]
        for s in self._subdomains:
            for facets in self.facets_on_faces(s, boundary_facets(s, self.body, boundary)):
                np.add.at(shares[facets.face], facets.place, facets.share)
            if with_nodes:
                points = s.points()[boundary_nodes(s, self.body, boundary)]
                nodes.append(points[:, : self.dimension])
        shares = [np.asarray(self.comm.allreduce(share)) for share in shares]
        inside = [share > 0.75 for share in shares]
        divided = any(((share > 0.25) & (share < 0.75)).any() for share in shares)
        if self.comm.allreduce(self._isolated(inside, np.concatenate(nodes))) or divided:
            raise NoAdmissibleStressError(
                f"the boundary of {source} is not made of whole facets of the grid: it has nodes "
                "beside them, or halves of them"
            )
        return inside

    def _isolated(self, inside: list[Mask], points: Array) -> int:
        """Number of points that are no corner of the facets."""
        belongs = np.zeros(len(points), bool)
        places = [_nearest(x, points[:, k]) for k, x in enumerate(self.axes)]
        for number, facets in enumerate(inside):
            axis, end = divmod(number, 2)
            corner = np.zeros([n + 1 for n in facets.shape], bool)
            for shift in np.ndindex(*(2,) * facets.ndim):
                part = tuple(slice(b, b + n) for b, n in zip(shift, facets.shape, strict=True))
                corner[part] |= facets
            across = tuple(place for k, place in enumerate(places) if k != axis)
            on_plane = places[axis] == (self.cells[axis] if end else 0)
            belongs |= on_plane & corner[across]
        return int((~belongs).sum())


def refuse_unguaranteed(scene: Scene, partition: Partition, memory: float | None = None) -> None:
    """Refuse a scene that requests a guaranteed bound and cannot have one (collective).

    Parameters
    ----------
    memory
        Bytes that a rank may use; the available memory of the machine unless given.

    Raises
    ------
    ConfigurationError
        The message gives the reason.
    """
    if not scene.guaranteed:
        return
    try:
        if scene.temperatures:
            raise NoAdmissibleStressError(
                f"{scene.temperatures[0].source} heats a body, and the error of the temperature on "
                "the mesh is not bounded"
            )
        if scene.ties:
            raise NoAdmissibleStressError(
                f"{scene.ties[0].source} is tied, and couples displacements in the mean only"
            )
        if scene.pairs:
            raise NoAdmissibleStressError(
                f"{scene.pairs[0].source} is a contact between bodies, whose gap condition "
                "holds in the mean only"
            )
        held = [body.name for body in scene.bodies if body.hold]
        if held:
            raise NoAdmissibleStressError(f"`hold` keeps {held[0]} in place in the mean only")
        needed = stress_bytes(scene.bodies)
        available = partition.comm.allreduce(memory or available_bytes(), op=MPI.MIN)
        if needed > available:
            raise NoAdmissibleStressError(
                f"its stresses take about {needed / 1e9:.3g} GB on one rank, and "
                f"{available / 1e9:.3g} GB are available"
            )
        for body in range(len(scene.bodies)):
            BoxSurface(scene, partition, body)
    except NoAdmissibleStressError as error:
        raise ConfigurationError(
            f"{scene.at('certificate.guaranteed')}: no error can be guaranteed: {error}; leave it "
            "out: the error of the mesh is estimated without it, too"
        ) from error


def stress_bytes(bodies: Sequence[Body]) -> float:
    """Memory that the stresses of the largest body take on one rank.

    Raises
    ------
    NoAdmissibleStressError
        A body is not a box.
    """
    cells = [math.prod(len(x) - 1 for x in grid_lines(body)) for body in bodies]
    return BYTES_PER_CELL * max(cells)


def grid_lines(body: Body) -> list[Array]:
    """Grid coordinates of a box of equal or graded cells.

    Raises
    ------
    NoAdmissibleStressError
        The mesh is not that of a box.
    """
    mesh: BodyMesh = body.mesh
    if isinstance(mesh, Box):
        corners = zip(mesh.lower, mesh.upper, mesh.cells, strict=True)
        return [np.linspace(a, b, n + 1) for a, b, n in corners]
    if not mesh.boundaries or not set(mesh.boundaries) <= {"x-", "x+", "y-", "y+", "z-", "z+"}:
        raise NoAdmissibleStressError(f"{body.name} comes from a file, and only boxes have a grid")
    points: Array = mesh.points  # type: ignore[attr-defined]
    lines = [np.unique(x) for x in points.T[: mesh.dimension]]
    if math.prod(map(len, lines)) != mesh.nodes:
        raise NoAdmissibleStressError(f"{body.name} is no box of a grid")
    return lines


def _between(lines: Array, x: Array) -> Ints:
    """Numbers of the cells, between grid lines, in which points lie."""
    return np.clip(np.searchsorted(lines, x) - 1, 0, len(lines) - 2)


def _nearest(lines: Array, x: Array) -> Ints:
    """Nearest grid lines."""
    return np.asarray(np.searchsorted(0.5 * (lines[1:] + lines[:-1]), x))
