"""Fields of an answer: at the nodes of the undecomposed mesh, and in its cells.

The owner of a node averages the displacements of its copies, which differ by jumps below the
tolerance only. Contact quantities are computed by the owner.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.model.candidates import slack_of
from contact_app.model.model import Model
from contact_app.results.friction import of_most_pressed
from contact_app.results.pressure import NodesInContact, contact_forces, node_gaps
from contact_app.results.surface_nodes import SurfaceNodes
from contact_app.scene.material import von_mises
from meshes.arrays import Array, Ints
from solver.contact.solution import Solution

FRICTION_FIELDS = ("friction_traction", "slip", "contact_status")
"""Fields at nodes that only scenes with friction have."""

POINT_FIELDS = (
    "displacement",
    "contact_pressure",
    "smoothed_contact_pressure",
    "gap",
    *FRICTION_FIELDS,
)
"""Fields at nodes that can be requested."""

NODAL_FIELDS = ("nodal_stress", "nodal_von_mises")
"""Fields recovered from the stresses in cells; in files their names may have a suffix."""

CELL_FIELDS = ("stress", "von_mises", "body", "material")
"""Fields in cells that can be requested."""


@dataclass(frozen=True, eq=False)
class NodeFields:
    """Fields at the nodes that this rank owns, from node `first` on."""

    first: int
    points: Array  # (nodes, 3)
    displacement: Array  # (nodes, dimension)
    contact_pressure: Array  # (nodes,)
    """The largest over the contacts of a node, as `pressure` evaluates them; 0 elsewhere."""
    smoothed_contact_pressure: Array  # (nodes,)
    """The same of `smoothed_pressure`."""
    contacts: tuple[NodesInContact, ...]
    """Each contact at its nodes, in the order of `Scene.touching`."""
    gap: Array  # (nodes,)
    """Remaining distance to the nearest obstacle along its normal, between bodies its average about
    a node of `on`; NaN without a contact row."""
    friction_traction: Array
    slip: Array
    """Friction force per area on the body of `on`, and its slip along the other side; where
    contacts overlap, those of the contact with the largest pressure. Shape (nodes, dimension)."""
    contact_status: Array  # (nodes,)
    """0 open, 1 stick, 2 slip."""
    contact_force: Array  # (3,)
    """Resultant of the obstacles on the bodies, of this rank's nodes."""
    pair_forces: Array  # (pairs, 3)
    """Force of the `against` body of each pair on the other, of this rank's nodes."""
    without_area: int
    """Number of nodes in contact that lie on no facet of the contact boundary."""
    slack: Array  # (rows,)
    """Remaining distance along the omitted candidate rows of this rank."""
    surface: SurfaceNodes
    """The nodes of the bodies' surfaces."""


def node_fields(model: Model, solution: Solution) -> NodeFields:
    """Average copies and evaluate contact at the owned nodes."""
    d, exchange = model.scene.dimension, model.node_exchange
    copies = [solution.displacements[cls][:, column].reshape(-1, d) for cls, column in model.place]
    displacement = exchange.to_owners(np.concatenate(copies))
    points = exchange.to_owners(np.concatenate([s.points() for s in model.partition.subdomains]))
    size = exchange.last - exchange.first
    place = exchange.nodes - exchange.first
    count = np.bincount(place, minlength=size)
    mean = np.stack(
        [np.bincount(place, displacement[:, i], minlength=size) / count for i in range(d)], axis=1
    )
    located = np.zeros((size, 3))
    located[place] = points

    surface = SurfaceNodes.of(model.partition)
    forces = contact_forces(model, solution, surface)
    pressure, smoothed = np.zeros((2, size))
    pressure[forces.nodes - exchange.first] = forces.pressure
    smoothed[forces.nodes - exchange.first] = forces.smoothed
    gap = np.full(size, np.nan)
    far = slack_of(model.left_out, exchange, mean)
    gap[forces.nodes - exchange.first] = node_gaps(model, solution, surface, far)
    obstacles, resultants = len(model.scene.contacts), forces.resultants
    return NodeFields(
        first=exchange.first,
        points=located,
        displacement=mean,
        contact_pressure=pressure,
        smoothed_contact_pressure=smoothed,
        contacts=forces.contacts,
        gap=gap,
        **_friction(forces.contacts, exchange.first, size, d),
        contact_force=resultants[:obstacles].sum(axis=0),
        pair_forces=resultants[obstacles:],
        without_area=forces.without_area,
        slack=far,
        surface=surface,
    )


def _friction(
    contacts: Sequence[NodesInContact], first: int, size: int, d: int
) -> dict[str, Array]:
    """The fields of friction at nodes from `first` on."""
    pieces = [(c.nodes - first, c.pressure, c.traction, c.slips, c.status) for c in contacts]
    traction, slip, status = of_most_pressed(pieces, size, d)
    return {"friction_traction": traction, "slip": slip, "contact_status": status.astype(float)}


@dataclass(frozen=True, eq=False)
class CellFields:
    """Fields in this rank's cells, in the order of its subdomains, from cell `first` on."""

    first: int
    cells: list[Ints]  # list of (cells, vertices)
    """Nodes of each subdomain's cells in VTK order."""
    stress: Array  # (cells, 6)
    """xx, yy, zz, xy, yz, xz."""
    von_mises: Array  # (cells,)
    energy_of_means: Array  # (bodies,)
    """Σ |T| σ̄ : ε̄ over this rank's cells T of each body, of the cell means σ̄ and ε̄; the rest of
    a(u, u) lies in strains that vary within cells."""
    largest_strain: float
    largest_rotation: float
    """Largest strain component, and largest rotation in radians, of any cell of this rank."""


def cell_fields(model: Model, solution: Solution) -> CellFields:
    """Cell means of stress, strain and rotation."""
    d, scene = model.scene.dimension, model.scene
    by_class, energies = [], []
    largest = np.zeros(2)
    for element, materials, u, heat in zip(
        model.elements,
        model.materials,
        model.elastic(solution.displacements),
        model.temperatures,
        strict=True,
    ):
        gradient = (element.gradient_operator() @ u).T.reshape(u.shape[1], -1, d, d)
        transposed = np.swapaxes(gradient, -1, -2)
        strain, rotation = 0.5 * (gradient + transposed), 0.5 * (gradient - transposed)
        largest = np.maximum(largest, [np.abs(strain).max(), np.abs(rotation).max()])
        material = element.of_cells(materials, scene.plane)
        warmth = None if heat is None else (element.mean_operator() @ heat).T
        by_class.append(material.stress(gradient, warmth))
        energies.append(material.energy_density(strain) @ element.cell_volumes())
    stresses = [by_class[cls][column] for cls, column in model.place]
    joined = np.concatenate(stresses) if stresses else np.zeros((0, 6))
    starts = model.partition.cell_starts
    energy = np.zeros(len(scene.bodies))
    for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        energy[s.body] += energies[cls][column]
    return CellFields(
        first=int(starts[0]) if len(starts) else 0,
        cells=[s.nodes[s.reference.cells] for s in model.partition.subdomains],
        stress=joined,
        von_mises=von_mises(joined),
        energy_of_means=energy,
        largest_strain=float(largest[0]),
        largest_rotation=float(largest[1]),
    )


def slabs(comm: MPI.Intracomm, start: int, *arrays: Any) -> Any:
    """Yield each rank's (start, arrays) on rank 0, one rank at a time; nothing elsewhere."""
    if comm.rank == 0:
        yield start, arrays
        for rank in range(1, comm.size):
            yield comm.recv(source=rank)
    else:
        comm.send((start, arrays), dest=0)
