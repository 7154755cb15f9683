"""An answer on the surface of its bodies alone: what a scene too large to write whole leaves.

Where a mesh has tens of millions of nodes its surface has half a million. Displacement and contact
pressure are evaluated there and written with the facets of the surface; nothing is ever formed at
all nodes. Copies of a node in neighbouring subdomains are written as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
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

FACETS = {
    ("hexahedron", 1): ("quad", "quadrilateral"),
    ("hexahedron", 2): ("quad9", "quadrilateral"),
    ("tetrahedron", 1): ("triangle", "triangle"),
    ("tetrahedron", 2): ("triangle6", "triangle"),
    ("quadrilateral", 1): ("line", None),
    ("quadrilateral", 2): ("line3", None),
    ("triangle", 1): ("line", None),
    ("triangle", 2): ("line3", None),
}
"""Facet of each cell by degree: as meshio names it, and as dolfinx does whose nodes are ordered."""


@dataclass(frozen=True, eq=False)
class SurfaceFields:
    """Fields at this rank's copies of surface nodes.

    Attributes
    ----------
    points : (n, 3)
    facets : {name: (facets, vertices)}
        Local numbers of the points of each facet, by meshio's name of the facet.
    displacement : (n, dimension)
    contact_pressure : (n,)
        Of the contact boundaries, as `pressure` evaluates it.
    largest_displacement, mean_displacement
        Over all nodes of the scene, inner ones included.
    contact_force : (3,)
        Resultant of the obstacles on the bodies, over all ranks.
    """

    points: NDArray[np.float64]
    facets: dict[str, NDArray[np.int64]]
    displacement: NDArray[np.float64]
    contact_pressure: NDArray[np.float64]
    largest_displacement: float
    mean_displacement: float
    contact_force: NDArray[np.float64]


def surface_fields(model: Model, solution: Solution) -> SurfaceFields:
    """Evaluate an answer on the surface (collective)."""
    comm, d = model.comm, model.scene.dimension
    surface = SurfaceNodes.of(model)
    facets: dict[str, list[NDArray[np.int64]]] = {}
    start = 0
    for s, nodes in zip(model.partition.subdomains, surface.local, strict=True):
        name, kind = FACETS[s.reference.cell, s.reference.degree]
        on_surface = s.reference.facets[s.exterior]
        if kind:
            on_surface = on_surface[:, list(vtk_order(kind, s.reference.degree))]
        facets.setdefault(name, []).append(start + np.searchsorted(nodes, on_surface))
        start += len(nodes)
    subdomains = model.partition.subdomains
    u = [
        solution.displacements[cls][:, column].reshape(-1, d)[nodes]
        for (cls, column), nodes in zip(model.place, surface.local, strict=True)
    ]
    largest, mean = _magnitudes(model, solution)
    forces = contact_forces(model, solution, surface)
    obstacles = len(model.scene.contacts)
    return SurfaceFields(
        points=np.concatenate(
            [s.points()[nodes] for s, nodes in zip(subdomains, surface.local, strict=True)]
        ),
        facets={name: np.concatenate(parts) for name, parts in facets.items()},
        displacement=np.concatenate(u),
        contact_pressure=surface.copies(forces.pressure),
        largest_displacement=largest,
        mean_displacement=mean,
        contact_force=comm.allreduce(forces.resultants[:obstacles].sum(axis=0)),
    )


def _magnitudes(model: Model, solution: Solution) -> tuple[float, float]:
    """Largest |u|, and its mean over the nodes of the undecomposed mesh."""
    comm, d = model.comm, model.scene.dimension
    surfaces = [np.unique(s.reference.facets) for s in model.partition.subdomains]
    numbers = [s.nodes[at] for s, at in zip(model.partition.subdomains, surfaces, strict=True)]
    exchange = NodeExchange(comm, np.concatenate(numbers), model.partition.nodes)
    _, place, copies = np.unique(exchange.nodes, return_inverse=True, return_counts=True)
    surplus = exchange.from_owners(1.0 - 1.0 / copies[place.reshape(-1)])
    largest, total, start = 0.0, 0.0, 0
    for (cls, column), at in zip(model.place, surfaces, strict=True):
        size = np.linalg.norm(solution.displacements[cls][:, column].reshape(-1, d), axis=1)
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
    points = np.concatenate([p.points for p in parts])
    displacement = np.zeros(points.shape)
    joined = np.concatenate([p.displacement for p in parts])
    displacement[:, : joined.shape[1]] = joined
    starts = np.cumsum([0, *(len(p.points) for p in parts)])
    names = dict.fromkeys(name for p in parts for name in p.facets)
    cells = [
        (name, np.concatenate([s + p.facets[name] for s, p in zip(starts, parts, strict=False)
                               if name in p.facets]))
        for name in names
    ]  # fmt: skip
    pressure = np.concatenate([p.contact_pressure for p in parts])
    meshio.write_points_cells(
        path, points, cells, {"displacement": displacement, "contact_pressure": pressure}
    )


def write_all_nodes(model: Model, solution: Solution, path: Path) -> None:
    """Write the displacement of all nodes of a regularly split box, which needs no mesh.

    Each subdomain is a regular grid given by its origin and spacing, so that the file holds one
    displacement a node copy, in single precision, and no coordinates or connectivity. ParaView
    merges the grids. One rank after another writes its part.

    Raises
    ------
    ValueError
        A subdomain is no box of hexahedra.
    """
    h5 = path.with_suffix(".h5")
    grids: list[str] = []
    for rank in range(model.comm.size):
        if rank == model.comm.rank:
            with h5py.File(h5, "w" if rank == 0 else "a") as file:
                for local, s in enumerate(model.partition.subdomains):
                    if s.reference.cell != "hexahedron":
                        raise ValueError("only boxes of hexahedra are written without a mesh")
                    grids.append(_write_block(file, h5.name, model, solution, local))
        model.comm.barrier()
    gathered: list[list[str]] | None = model.comm.gather(grids)
    if gathered is not None:
        body = "\n".join(grid for part in gathered for grid in part)
        path.write_text(
            '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>\n'
            f'<Grid Name="bodies" GridType="Collection" CollectionType="Spatial">\n{body}\n'
            "</Grid>\n</Domain></Xdmf>\n",
            encoding="utf-8",
        )


def _write_block(file: Any, name: str, model: Model, solution: Solution, local: int) -> str:
    """One subdomain's displacement, x fastest; its entry in the XDMF file."""
    s = model.partition.subdomains[local]
    x = s.reference.points
    axes = [np.unique(np.round(x[:, i], 12)) for i in range(3)]
    shape = tuple(len(a) for a in reversed(axes))
    if np.prod(shape) != len(x):
        raise ValueError("only boxes of hexahedra are written without a mesh")
    order = np.lexsort((np.round(x[:, 0], 12), np.round(x[:, 1], 12), np.round(x[:, 2], 12)))
    cls, column = model.place[local]
    u = solution.displacements[cls][:, column].reshape(-1, 3)[order].astype(np.float32)
    key = f"displacement/{s.number}"
    file.create_dataset(key, data=u.reshape(*shape, 3))
    size = " ".join(map(str, shape))
    origin = " ".join(f"{v:.12g}" for v in reversed(x.min(axis=0) + s.translation))
    spacing = " ".join(f"{(a[-1] - a[0]) / (len(a) - 1):.12g}" for a in reversed(axes))
    return (
        f'<Grid Name="subdomain {s.number}"><Topology TopologyType="3DCoRectMesh" '
        f'Dimensions="{size}"/><Geometry GeometryType="ORIGIN_DXDYDZ">'
        f'<DataItem Dimensions="3" Format="XML">{origin}</DataItem>'
        f'<DataItem Dimensions="3" Format="XML">{spacing}</DataItem></Geometry>'
        f'<Attribute Name="displacement" AttributeType="Vector" Center="Node">'
        f'<DataItem Dimensions="{size} 3" NumberType="Float" Precision="4" Format="HDF">'
        f"{name}:/{key}</DataItem></Attribute></Grid>"
    )
