"""Nodal fields of a solution by PETSc's solvers, for a chart.

They are in the order of the mesh's own nodes and come with its cells. On second-order tetrahedra,
nodal contact forces of a constant pressure are zero at vertices. The pressure at vertex j is
therefore

    p_j = Σ_i ψ_j(x_i) f_i / Σ_i ψ_j(x_i) A_i,

ψ_j the hat function of the vertex, f_i the force and A_i the area of node i. Both sums are
integrals with ψ_j, for ψ_j = Σ_i ψ_j(x_i) φ_i.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.spatial import cKDTree

from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.scene.scene import Scene
from contact_app.studies.reference import Fields
from contact_app.studies.undecomposed import WholeSystem
from meshes.arrays import Array
from meshes.quadratic import VERTICES, node_vertices
from meshes.unstructured import CellMesh


def fields_of_peer(scene: Scene, system: WholeSystem, x: PETSc.Vec) -> Fields | None:
    """Fields at all nodes on rank 0, None on the others (collective)."""
    watched = np.zeros(len(system.points), bool)
    watched[system.contact // system.dimension] = True
    local = (system.points, system.displacement(x), system.force(x), system.areas, watched)
    gathered = MPI.COMM_WORLD.gather(local)
    if gathered is None:
        return None
    points, displacement, force, area, watched = (
        np.concatenate(part) for part in zip(*gathered, strict=True)
    )
    (body,) = scene.bodies
    mesh = body.mesh if isinstance(body.mesh, CellMesh) else body.mesh.shape(1).cell_mesh()
    shape = mesh.shape(body.degree)
    missing = ((0, 0), (0, 3 - shape.dimension))
    order = cKDTree(points).query(np.pad(shape.points, missing))[1]
    points, displacement, force, area, watched = (
        values[order] for values in (points, displacement, force, area, watched)
    )
    if has_averaged_rows(body):
        force, area = (about_vertices(shape, values) for values in (force, area))
        watched &= area > 0.0
    some = area > 0.0
    return Fields(
        points=points,
        displacement=displacement,
        pressure=np.where(some, force / np.where(some, area, 1.0), 0.0),
        watched=watched,
        first_node=np.array([0, len(points)]),
        degree=np.array([body.degree]),
        cell=np.array([body.mesh.cell]),
        cells=[shape.cells],
        tags=[shape.tags],
    )


def about_vertices(mesh: CellMesh, values: Array) -> Array:
    """Σ_i ψ_j(x_i) v_i at the vertices j of a second-order mesh, zero at its other nodes."""
    corners = VERTICES[mesh.cell]
    result = np.zeros(len(values))
    vertices = np.unique(mesh.cells[:, :corners])
    result[vertices] = values[vertices]
    middles, first = np.unique(mesh.cells[:, corners:], return_index=True)
    row, place = np.divmod(first, mesh.cells.shape[1] - corners)
    ends = np.array(node_vertices(mesh.cell)[corners:])[place]
    for end in ends.T:
        np.add.at(result, mesh.cells[row, end], 0.5 * values[middles])
    return result
