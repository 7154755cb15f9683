"""Stiffness of the sub-boxes of a regular mesh, from that of one cell.

An integral over all cells that depends on no place, no tag and no coefficient has the same matrix
K_e in each cell of a regular mesh. Sub-boxes with equally many cells along each axis then have one
stiffness, K = Σ_e A_eᵀ K_e A_e over the cells, and one assembly serves them all.
"""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI
from scipy import sparse
from ufl.algorithms.analysis import extract_type

from contact_app.forms.grid import Grid
from contact_app.forms.parts import Parts, assembled
from contact_app.model.equal_cells import sum_of_copies
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints


def split_form(form: Any, mesh: Any) -> tuple[Any, Any]:
    """A form as the sum of integrals that are the same in each cell, and of others.

    Either may be a form without integrals. Constants may have any value.
    """
    straight = dolfinx_compat.cell_nodes(mesh).shape[1] == 2**mesh.topology.dim
    same: list[Any] = []
    others: list[Any] = []
    for integral in form.integrals():
        (same if straight and _is_uniform(integral) else others).append(integral)
    return ufl.Form(same), ufl.Form(others)


def _is_uniform(integral: Any) -> bool:
    return (
        integral.integral_type() == "cell"
        and integral.subdomain_id() in ("everywhere", ("everywhere",))
        and not any(
            extract_type(integral.integrand(), kind)
            for kind in (ufl.Coefficient, ufl.classes.GeometricQuantity)
        )
    )


def in_cylindrical_coordinates(form: Any) -> bool:
    """Whether an integral in the plane has coordinates and arguments that are not differentiated.

    So has the circumferential strain u / r. A bed whose stiffness varies in a plane has both, too.
    """
    return len(form.arguments()[0]) == 2 and any(
        integral.integral_type() == "cell"
        and extract_type(integral.integrand(), ufl.classes.SpatialCoordinate)
        and _has_plain_argument(integral.integrand())
        for integral in form.integrals()
    )


def _has_plain_argument(expression: Any) -> bool:
    if isinstance(expression, ufl.classes.Derivative):
        return False
    if isinstance(expression, ufl.classes.Argument):
        return True
    return any(_has_plain_argument(part) for part in expression.ufl_operands)


def cell_stiffness(parts: Parts, grid: Grid, form: Any, body: int) -> Array:
    """K_e of one cell of a body, (n, n), with nodes in the order of the lattice (collective).

    It is the same on all ranks to the last bit.
    """
    space, mesh, comm = parts.space, parts.space.mesh, parts.comm
    nodes = dolfinx_compat.dof_nodes(space)
    cell = np.flatnonzero(grid.bodies[grid.of_cell] == body)[:1].astype(np.int32)
    some = len(cell) > 0
    order = np.argsort(np.argsort(grid.lattice[nodes[cell]], axis=1), axis=1)
    # all cells have the nodes of this one, over which alone the form is integrated
    blocks = np.broadcast_to(order[0] if some else np.zeros(nodes.shape[1], int), nodes.shape)
    torn = dolfinx_compat.torn_space(space, blocks, nodes.shape[1])
    tags = dolfinx_compat.meshtags(mesh, mesh.topology.dim, cell, 1)
    first = ufl.Form(
        [integral.reconstruct(subdomain_id=1, subdomain_data=tags) for integral in form.integrals()]
    )
    K = assembled(torn, first).toarray()
    root = comm.allreduce(comm.rank if some else comm.size, op=MPI.MIN)
    return np.asarray(comm.bcast(K if comm.rank == root else None, root=root))


@dataclass(frozen=True, eq=False)
class EqualCells:
    """A form on a grid of cells that have the same matrix in each body."""

    matrices: list[Array]
    """K_e of each body."""
    others: Any
    """Integrals that are not in these matrices."""
    nodes: Ints  # (cells, n)
    """Nodes of the space in the order of the matrices, of the cells that this rank owns."""
    body: Ints  # (cells,)

    @classmethod
    def of(cls, parts: Parts, grid: Grid | None, form: Any) -> "EqualCells | None":
        """None without a grid, or if no integral is the same in each cell (collective)."""
        if grid is None:
            return None
        same, others = split_form(form, parts.space.mesh)
        if same.empty():
            return None
        matrices = [cell_stiffness(parts, grid, same, k) for k in range(grid.bodies.max() + 1)]
        nodes = dolfinx_compat.dof_nodes(parts.space)[: len(grid.of_cell)]
        order = np.argsort(grid.lattice[nodes], axis=1)
        ordered = np.take_along_axis(nodes, order, axis=1).astype(np.int64)
        return cls(matrices, others, ordered, grid.bodies[grid.of_cell])

    @property
    def complete(self) -> bool:
        """Whether the matrices have all integrals over cells."""
        return all(part.integral_type() != "cell" for part in self.others.integrals())

    def energies(self, w: Array) -> Array:
        """Energies (cells,) of displacements of the cells' nodes, (cells, n, d)."""
        rows, result = w.reshape(len(w), -1), np.empty(len(w))
        for body, K in enumerate(self.matrices):
            some = self.body == body
            result[some] = np.einsum("ci,ci->c", rows[some] @ K, rows[some])
        return result


def box_stiffness(K: Array, cells: tuple[int, ...], degree: int) -> sparse.csr_matrix:
    """K of a box of some cells along each axis, of which each has the matrix given.

    Nodes are in the order of the lattice, x fastest.
    """
    d = len(cells)
    strides = np.cumprod([1, *(degree * n + 1 for n in cells[:-1])])
    place = np.array([node[::-1] for node in product(range(degree + 1), repeat=d)]) @ strides
    first = degree * np.array([cell[::-1] for cell in product(*map(range, cells[::-1]))]) @ strides
    # entries that are zero stay: sub-boxes with and without springs have equal patterns
    nodes = int(np.prod([degree * n + 1 for n in cells]))
    return sum_of_copies(K, first[:, None] + place, nodes)


def added(K: sparse.csr_matrix, other: sparse.csr_matrix) -> sparse.csr_matrix:
    """The sum of two matrices, with the entries that are zero in it; K itself plus nothing."""
    if not other.data.any():
        return K
    pairs = [matrix.tocoo() for matrix in (K, other)]
    entries = tuple(
        np.concatenate([getattr(matrix, name) for matrix in pairs]) for name in ("row", "col")
    )
    values = np.concatenate([matrix.data for matrix in pairs])
    return sparse.csr_matrix((values, entries), shape=K.shape).sorted_indices()
