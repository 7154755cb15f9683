"""A dolfinx space cut into the parts of a decomposition, and forms assembled on each part.

A part is a facet-connected set of cells of one rank, so that the kernel of the elasticity form on
it consists of rigid motions; or the cells of one rank in a sub-box of a regular mesh
(`subdomains`). Each part has its own copies of its nodes. A form is assembled once over a space
whose nodes are these copies (`dolfinx_compat.torn_space`): the matrix is block diagonal with the
stiffness matrices of the parts before any condition, and loads are those of the parts.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix, create_matrix
from mpi4py import MPI
from scipy import sparse

from contact_app.forms.grid import Grid, pieces
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints


@dataclass(frozen=True, eq=False)
class Parts:
    """The cells of this rank in parts, and the copies of nodes that these have."""

    space: Any
    """The vector space whose nodes are copied."""
    torn: Any
    """The space over the copies."""
    of_cell: Ints  # (cells,)
    """Part of each cell this rank owns."""
    cells: Ints  # (cells, nodes per cell)
    """Copies of the nodes of each cell, in dolfinx's order."""
    starts: Ints  # (parts + 1,)
    """First copy of each part, and the number of copies."""
    blocks: Ints
    numbers: Ints
    """Node of each copy in the space, as this rank and as all ranks number it. Shape (copies,)."""
    points: Array  # (copies, 3)

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the mesh."""
        return self.space.mesh.comm

    @property
    def dimension(self) -> int:
        """Components of a node."""
        return int(self.space.dofmap.index_map_bs)

    @property
    def count(self) -> int:
        """Parts of this rank."""
        return len(self.starts) - 1

    @property
    def nodes(self) -> int:
        """Nodes on all ranks."""
        return int(self.space.dofmap.index_map.size_global)

    def copies(self, part: int) -> slice:
        """Copies of one part."""
        return slice(int(self.starts[part]), int(self.starts[part + 1]))

    def unknowns(self, part: int) -> slice:
        """Unknowns of one part among those of all copies."""
        d = self.dimension
        return slice(int(self.starts[part]) * d, int(self.starts[part + 1]) * d)

    def vertex_weights(self, part: int) -> sparse.csr_matrix | None:
        """Degree 2: the functions of degree 1 of the vertices of a part at its nodes, (n, n)."""
        if dolfinx_compat.lagrange_degree(self.space) != 2:
            return None
        kind = str(self.space.mesh.topology.cell_name())
        places = dolfinx_compat.lagrange_nodes(kind, 2)[0]
        functions = dolfinx_compat.lagrange_values(kind, 1, places)
        functions[np.abs(functions) < 1e-12] = 0.0
        nodes = self.cells[self.of_cell == part] - self.starts[part]
        cell, place = np.empty((2, int(self.starts[part + 1] - self.starts[part])), np.int64)
        cell[nodes] = np.arange(len(nodes))[:, None]
        place[nodes] = np.arange(nodes.shape[1])
        vertices = nodes[cell][:, : functions.shape[1]]
        rows = np.broadcast_to(np.arange(len(cell))[:, None], vertices.shape)
        entries = (rows.ravel(), vertices.ravel())
        weights = sparse.csr_matrix((functions[place].ravel(), entries), shape=(len(cell),) * 2)
        weights.eliminate_zeros()
        return weights

    def stiffness(self, form: Any) -> list[sparse.csr_matrix]:
        """K of each part, (n, n) with unknown ``node * dimension + component`` (collective)."""
        whole = assembled(self.torn, form)
        parts = [self.unknowns(part) for part in range(self.count)]
        return [whole[part, part].sorted_indices() for part in parts]

    def loads(self, form: Any) -> list[Array]:
        """f of each part, (n,) (collective)."""
        (test,) = form.arguments()
        compiled = dolfinx_compat.compile_form(
            ufl.replace(form, {test: ufl.TestFunction(self.torn)})
        )
        whole = fem.assemble_vector(compiled).array
        return [whole[self.unknowns(part)].copy() for part in range(self.count)]


def assembled(torn: Any, form: Any) -> sparse.csr_matrix:
    """Matrix of a bilinear form over a torn space, in the unknowns of this rank (collective)."""
    trial, test = ufl.TrialFunction(torn), ufl.TestFunction(torn)
    first, second = form.arguments()
    compiled = dolfinx_compat.compile_form(ufl.replace(form, {first: test, second: trial}))
    matrix = create_matrix(compiled, "baij")
    assemble_matrix(matrix, compiled)
    matrix.assemble()
    matrix.convert("aij")
    diagonal_block = matrix if torn.mesh.comm.size == 1 else matrix.getDiagonalBlock()
    pointers, columns, values = diagonal_block.getValuesCSR()
    whole = sparse.csr_matrix((values, columns, pointers), shape=diagonal_block.getSize())
    matrix.destroy()
    return whole


def parts_of(space: Any, grid: Grid | None = None) -> Parts:
    """Cut the cells of each rank into facet-connected parts (collective).

    Parameters
    ----------
    grid
        The cut of a regular mesh.
    """
    mesh, dofmap = space.mesh, space.dofmap
    every = dolfinx_compat.dof_nodes(space)
    of_cell = pieces(mesh) if grid is None else np.unique(grid.of_cell, return_inverse=True)[1]
    owned, ghosts = len(of_cell), len(every) - len(of_cell)
    count = int(of_cell.max(initial=-1)) + 1
    here = dofmap.index_map.size_local + dofmap.index_map.num_ghosts
    order = np.arange(here) if grid is None else grid.lattice
    span = int(order.max(initial=0)) + 1
    # cells of other ranks come last, in a part that no form is integrated over
    part = np.concatenate([of_cell, np.full(ghosts, count)])
    key, first, cells = np.unique(
        part[:, None] * span + order[every], return_index=True, return_inverse=True
    )
    cells = cells.reshape(every.shape)
    torn = dolfinx_compat.torn_space(space, cells, len(key))
    starts = np.searchsorted(key, np.arange(count + 1) * span)
    blocks = every.ravel()[first[: starts[-1]]].astype(np.int64)
    numbers = dofmap.index_map.local_to_global(blocks.astype(np.int32)).astype(np.int64)
    return Parts(
        space, torn, of_cell, cells[:owned].astype(np.int64), starts, blocks, numbers,
        space.tabulate_dof_coordinates()[blocks],
    )  # fmt: skip
