"""The solution on the surface of a box of hexahedra, for scenes too large to write as a whole.

A mesh with tens of millions of nodes has a surface with half a million. Displacement and contact
pressure are evaluated there and written with the facets of the surface; no array has an entry for
every node of the mesh. Copies of a node in neighbouring subdomains are all written.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.model import Model
from contact_app.results.pressure import contact_forces
from contact_app.results.surface_nodes import SurfaceNodes
from meshes.subdomains import vtk_order
from solver.contact.solution import Solution
from solver.tfeti.constraints.exchange import NodeExchange

VTK_QUADRILATERAL = list(vtk_order("quadrilateral", 1))


@dataclass(frozen=True, eq=False)
class SurfaceFields:
    """Fields at this rank's copies of surface nodes.

    Attributes
    ----------
    points : (n, 3)
    facets : (facets, 4)
        Local numbers of the points of each facet, in VTK's order.
    displacement : (n, 3)
    contact_pressure : (n,)
        Pressure on the contact boundaries, as `pressure` evaluates it.
    largest_displacement, mean_displacement
        Over all nodes of the scene, inner ones included.
    contact_force : (3,)
        Resultant of the obstacles on the bodies, over all ranks.
    """

    points: NDArray[np.float64]
    facets: NDArray[np.int64]
    displacement: NDArray[np.float64]
    contact_pressure: NDArray[np.float64]
    largest_displacement: float
    mean_displacement: float
    contact_force: NDArray[np.float64]


def surface_fields(model: Model, solution: Solution) -> SurfaceFields:
    """Evaluate an answer on the surface (collective)."""
    comm, subdomains = model.comm, model.partition.subdomains
    surface = SurfaceNodes.of(model)
    facets = [
        start + np.searchsorted(nodes, s.reference.facets[s.exterior][:, VTK_QUADRILATERAL])
        for start, s, nodes in zip(surface.starts, subdomains, surface.local, strict=False)
    ]
    u = [
        solution.displacements[cls][:, column].reshape(-1, 3)[nodes]
        for (cls, column), nodes in zip(model.place, surface.local, strict=True)
    ]
    largest, mean = _magnitudes(model, solution)
    forces = contact_forces(model, solution, surface)
    obstacles = len(model.scene.contacts)
    return SurfaceFields(
        points=np.concatenate(
            [s.points()[nodes] for s, nodes in zip(subdomains, surface.local, strict=True)]
        ),
        facets=np.concatenate(facets),
        displacement=np.concatenate(u),
        contact_pressure=surface.copies(forces.pressure),
        largest_displacement=largest,
        mean_displacement=mean,
        contact_force=comm.allreduce(forces.resultants[:obstacles].sum(axis=0)),
    )


def _magnitudes(model: Model, solution: Solution) -> tuple[float, float]:
    """Largest |u|, and its mean over the nodes of the undecomposed mesh."""
    comm = model.comm
    surfaces = [np.unique(s.reference.facets) for s in model.partition.subdomains]
    numbers = [s.nodes[at] for s, at in zip(model.partition.subdomains, surfaces, strict=True)]
    exchange = NodeExchange(comm, np.concatenate(numbers), model.partition.nodes)
    _, place, copies = np.unique(exchange.nodes, return_inverse=True, return_counts=True)
    surplus = exchange.from_owners(1.0 - 1.0 / copies[place.reshape(-1)])
    largest, total, start = 0.0, 0.0, 0
    for (cls, column), at in zip(model.place, surfaces, strict=True):
        size = np.linalg.norm(solution.displacements[cls][:, column].reshape(-1, 3), axis=1)
        largest = max(largest, float(size.max()))
        total += float(size.sum() - size[at] @ surplus[start : start + len(at)])
        start += len(at)
    largest = comm.allreduce(largest, op=MPI.MAX)
    return largest, comm.allreduce(total) / model.partition.nodes


def write_surface(fields: SurfaceFields, path: Path, comm: MPI.Intracomm) -> None:
    """Write the surface as XDMF with its HDF5 file (collective; the surface meets on rank 0)."""
    parts = comm.gather(fields)
    if parts is None:
        return
    starts = np.cumsum([0, *(len(p.points) for p in parts)])
    facets = [start + p.facets for start, p in zip(starts, parts, strict=False)]
    points, displacement, pressure = (
        np.concatenate([getattr(p, name) for p in parts])
        for name in ("points", "displacement", "contact_pressure")
    )
    meshio.write_points_cells(
        path, points, [("quad", np.concatenate(facets))],
        {"displacement": displacement, "contact_pressure": pressure},
    )  # fmt: skip
