"""Stiffness, loads and stress of a reference subdomain, assembled by dolfinx.

Everything is assembled on the mesh of a congruence class and returned as plain arrays in the
order of the mesh's nodes: unknown ``node * dimension + component``. Linear elasticity, small
strain; moduli are those of `scene.material`.

Two points per direction integrate the stiffness of first-order cells exactly on undistorted boxes,
and three points that of second-order quadrilaterals and hexahedra. A rule of the same degree is
exact for triangles and tetrahedra with straight edges. The default rule of the form compiler takes
up to four times longer for the same matrix. In cells with curved edges the stiffness is not a
polynomial; the rule there is exact for loads and constant stresses, so that a patch test is passed.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix, create_matrix
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from contact_app.model.equal_cells import has_equal_cells, stiffness_of_equal_cells
from contact_app.model.facets import moments, normal_moments
from contact_app.scene.material import CellMaterials, Material
from meshes import Reference, dolfinx_compat
from meshes.arrays import Array, Ints
from meshes.subdomains import vtk_order, vtk_shapes

CURVED = {"triangle": 4, "quadrilateral": 5, "tetrahedron": 5, "hexahedron": 7}
"""Degree of the shape functions of second order times the Jacobian of curved cells."""


def quadrature_degree(cell: str, degree: int, curved: bool = False) -> int:
    """Degree of the rule that is exact for the stiffness of cells with straight edges.

    In curved cells it is exact for ∫ φ dx and ∫ ∇φ dx.
    """
    if curved:
        return CURVED[cell]
    return 2 * degree if cell in ("quadrilateral", "hexahedron") else degree


class Element:
    """Finite-element forms on one reference.

    Parameters
    ----------
    reference
        Mesh of the congruence class.
    dimension
        2 or 3.
    cells : (cells,)
        Cells that carry forces per volume; all by default.
    """

    def __init__(
        self, reference: Reference, dimension: int, cells: NDArray[np.int32] | None = None
    ) -> None:
        self.reference = reference
        self.dimension = dimension
        self.mesh = reference.mesh
        self._cells = cells
        self._rule = quadrature_degree(reference.cell, reference.degree, reference.curved)

    @cached_property
    def space(self) -> Any:
        """Displacements."""
        return dolfinx_compat.vector_space(self.mesh, self.reference.degree, self.dimension)

    @cached_property
    def _dx(self) -> Any:
        dx = ufl.dx(domain=self.mesh, metadata={"quadrature_degree": self._rule})
        if self._cells is None:
            return dx
        tags = dolfinx_compat.meshtags(self.mesh, self.dimension, self._cells, 1)
        return dx(1, subdomain_data=tags)

    @cached_property
    def unknowns(self) -> Ints:
        """dolfinx's number of each unknown of the module's order, (nodes · dimension,)."""
        reference = self.reference
        order = list(vtk_order(reference.cell, reference.degree))
        blocks = dolfinx_compat.dof_nodes(self.space)[:, order]
        block_of_node = np.empty(len(reference.points), np.int64)
        block_of_node[reference.cells.ravel()] = blocks.ravel()
        return (block_of_node[:, None] * self.dimension + np.arange(self.dimension)).ravel()

    def stiffness(self, materials: tuple[Material, ...], plane: str | None) -> sparse.csr_matrix:
        """K, (unknowns, unknowns); materials by the tags of the cells.

        With mean dilatation, ∫ λ div u div v is λ |T| times the means of div u and div v over each
        cell T, the B-bar method for isotropic materials (T. J. R. Hughes, *Generalization of
        selective integration procedures to anisotropic and nonlinear media*, IJNME 15, 1980).
        """
        if len(materials) == 1 and self._cells is None and has_equal_cells(self.reference):
            moduli = self._moduli(materials[0], plane)
            K = stiffness_of_equal_cells(self.reference, self.dimension, moduli, self._rule)
        else:
            K = self._integrated(materials, plane)
        if materials[0].mean_dilatation:
            lam = self.of_cells(materials, plane).lame[0]
            dilatation = self._dilatation()
            K = (K + dilatation.T @ sparse.diags(lam * self.cell_volumes()) @ dilatation).tocsr()
        K.sort_indices()
        return K

    def _integrated(self, materials: tuple[Material, ...], plane: str | None) -> sparse.csr_matrix:
        """The stiffness without mean dilatation, by a compiled form."""
        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        form = ufl.inner(self._stress(u, materials, plane), ufl.sym(ufl.grad(v))) * self._dx
        compiled = dolfinx_compat.compile_form(form)
        matrix = create_matrix(
            compiled, "baij"
        )  # inserting whole blocks of a node is three times faster
        assemble_matrix(matrix, compiled)
        matrix.assemble()
        matrix.convert("aij")
        K, order = _scipy(matrix), self.unknowns
        if not np.array_equal(order, np.arange(len(order))):
            K = K[order][:, order].tocsr()
        return K

    def thermal_load(
        self,
        materials: tuple[Material, ...],
        plane: str | None,
        temperature: Callable[[Array], Array],
    ) -> Array:
        """Load ∫ β T div v, (unknowns,), of a temperature at points (n, 3) of the reference.

        T is interpolated two degrees above the displacement, so that energies of different meshes
        differ by their own errors, not by that of T. With mean dilatation the load is 3 λ α |T|
        times the means of temperature and div v.
        """
        scalars = dolfinx_compat.scalar_space(self.mesh, self.reference.degree + 2)
        rise, v = fem.Function(scalars), ufl.TestFunction(self.space)
        rise.x.array[:] = temperature(scalars.tabulate_dof_coordinates())
        shape, volume = self.of_cells(materials, plane).thermal_stress
        averaged = materials[0].mean_dilatation
        beta = self._cellwise(shape if averaged else shape + volume)
        rule = {"quadrature_degree": 2 * self.reference.degree + 2 + 2 * self.reference.curved}
        dx = ufl.dx(domain=self.mesh, metadata=rule)
        load = self._load(beta * rise * ufl.div(v) * dx)
        if averaged:
            cells = dolfinx_compat.cellwise_scalars(self.mesh)
            integral = self._assembled(rise * ufl.TestFunction(cells) * dx)
            load += self._dilatation().T @ (
                volume * integral[dolfinx_compat.dof_nodes(cells).ravel()]
            )
        return load

    def _dilatation(self) -> sparse.csr_matrix:
        """Cell means of div u from unknowns, (cells, unknowns)."""
        means, d = self.gradient_operator(), self.dimension
        return sum(means[i * d + i :: d * d] for i in range(d))

    def of_cells(self, materials: tuple[Material, ...], plane: str | None) -> CellMaterials:
        """The materials of the cells, by their tags."""
        return CellMaterials(materials, self.reference.tags, plane)

    def body_force(self, force: Array) -> Array:
        """Load of a force per volume, (unknowns,)."""
        return self._load(ufl.inner(self._constant(force), ufl.TestFunction(self.space)) * self._dx)

    def traction(self, rows: NDArray[np.int32], traction: Array) -> Array:
        """Load of a force per area on facets (rows of ``reference.facets``), (unknowns,)."""
        shares = moments(self.reference.points[self.reference.facets[rows]], self.dimension)
        return self._on_facets(rows, shares.sum(axis=1).T[..., None] * traction)

    def linear_traction(self, rows: NDArray[np.int32], values: Array) -> Array:
        """Load of a force per area given at the nodes, (nodes, dimension); (unknowns,)."""
        return self.linear_tractions(rows, values[..., None])[:, 0]

    def linear_tractions(self, rows: NDArray[np.int32], values: Array) -> Array:
        """Loads of several forces per area at the nodes, (nodes, dimension, k); (unknowns, k)."""
        traction = fem.Function(self.space)
        form = dolfinx_compat.compile_form(
            ufl.inner(traction, ufl.TestFunction(self.space)) * self._ds(rows)
        )
        loads = np.empty((len(self.unknowns), values.shape[2]))
        for k in range(values.shape[2]):
            traction.x.array[self.unknowns] = values[..., k].ravel()
            loads[:, k] = fem.assemble_vector(form).array[self.unknowns]
        return loads

    def pressure(self, rows: NDArray[np.int32], pressure: float) -> Array:
        """Load of a pressure against the outward normal of facets, (unknowns,)."""
        reference = self.reference
        x, behind = reference.points[reference.facets[rows]], reference.middles_behind[rows]
        return self._on_facets(rows, -pressure * normal_moments(x, behind, self.dimension))

    def _on_facets(self, rows: NDArray[np.int32], forces: Array) -> Array:
        """Load of forces at the nodes of facets, (nodes, facets, dimension); (unknowns,)."""
        nodes = self.reference.facets[rows].T
        unknowns = nodes[..., None] * self.dimension + np.arange(self.dimension)
        size = len(self.reference.points) * self.dimension
        return np.bincount(unknowns.ravel(), forces.ravel(), size).astype(np.float64)

    def cell_volumes(self) -> Array:
        """Volume (area in the plane) of each cell."""
        return self._means[1]

    @property
    def mean_slopes(self) -> Array:
        """Cell means of the derivatives of shape functions, (cells, nodes, dimension)."""
        return self._means[0]

    @property
    def mean_values(self) -> Array:
        """Cell means of shape functions, (cells, nodes)."""
        return self._means[2]

    def mean_operator(self) -> sparse.csr_matrix:
        """Cell means from values at nodes, (cells, nodes)."""
        values, nodes = self.mean_values, self.reference.cells
        starts = np.arange(len(nodes) + 1) * nodes.shape[1]
        shape = (len(nodes), len(self.reference.points))
        return sparse.csr_matrix((values.ravel(), nodes.ravel(), starts), shape=shape)

    def gradient_operator(self) -> sparse.csr_matrix:
        """Cell means of ∂u_i/∂x_j from unknowns, (cells · dimension², unknowns), j fastest."""
        d, slopes = self.dimension, self.mean_slopes
        cells, nodes, _ = slopes.shape
        unknown = self.reference.cells[:, None] * d + np.arange(d)[:, None]
        shape = (cells, d, d, nodes)
        columns = np.broadcast_to(unknown[:, :, None], shape)
        values = np.broadcast_to(np.swapaxes(slopes, 1, 2)[:, None], shape)
        starts = np.arange(cells * d * d + 1) * nodes
        return sparse.csr_matrix(
            (values.ravel(), columns.ravel(), starts), shape=(cells * d * d, len(self.unknowns))
        )

    @cached_property
    def _means(self) -> tuple[Array, Array, Array]:
        """`mean_slopes`, volumes and `mean_values`.

        Integrated by the rule of the stiffness, which is exact for ∫ ∇φ dx.
        """
        reference, d = self.reference, self.dimension
        cell, curved = reference.cell, reference.curved
        rule = quadrature_degree(cell, reference.degree, curved)
        points, weights = dolfinx_compat.quadrature(cell, rule)
        (values, slopes_on_reference), (_, mapping) = (
            vtk_shapes(cell, degree, points) for degree in (reference.degree, 2 if curved else 1)
        )
        corners = reference.points[reference.cells[:, : mapping.shape[2]], :d]
        jacobian = np.einsum("cni,qkn->cqik", corners, mapping)
        volume = weights * np.abs(np.linalg.det(jacobian))
        volumes = volume.sum(axis=1)
        inverse = np.linalg.inv(jacobian) * (volume / volumes[:, None])[..., None, None]
        slopes = np.einsum("cqkj,qkn->cnj", inverse, slopes_on_reference, optimize=True)
        return slopes, volumes, (volume / volumes[:, None]) @ values

    def _stress(self, u: Any, materials: tuple[Material, ...], plane: str | None) -> Any:
        """σ(u); without λ tr(ε) where this term uses means over cells."""
        if len(materials) == 1:
            moduli = self._moduli(materials[0], plane)
            lam, mu = (fem.Constant(self.mesh, PETSc.ScalarType(m)) for m in moduli)
        else:
            full = 0.0 if materials[0].mean_dilatation else 1.0
            values = self.of_cells(materials, plane).lame * [[full], [1.0]]
            lam, mu = map(self._cellwise, values)
        strain = ufl.sym(ufl.grad(u))
        return lam * ufl.tr(strain) * ufl.Identity(self.dimension) + 2.0 * mu * strain

    @staticmethod
    def _moduli(material: Material, plane: str | None) -> tuple[float, float]:
        """λ and μ; λ is zero where its term uses means over cells."""
        lam, mu = material.lame(plane)
        return (0.0 if material.mean_dilatation else lam), mu

    def _cellwise(self, values: Array) -> Any:
        """A function with one value in each cell."""
        space = dolfinx_compat.cellwise_scalars(self.mesh)
        function = fem.Function(space)
        function.x.array[dolfinx_compat.dof_nodes(space).ravel()] = values
        return function

    def _constant(self, vector: Array) -> Any:
        return fem.Constant(self.mesh, np.asarray(vector, dtype=PETSc.ScalarType))

    def _ds(self, rows: NDArray[np.int32]) -> Any:
        entities = self.reference.facet_entities[rows]
        tags = dolfinx_compat.meshtags(self.mesh, self.dimension - 1, entities, 1)
        return ufl.Measure("ds", domain=self.mesh, subdomain_data=tags)(1)

    def _load(self, form: Any) -> Array:
        return self._assembled(form)[self.unknowns]

    @staticmethod
    def _assembled(form: Any) -> Array:
        return fem.assemble_vector(dolfinx_compat.compile_form(form)).array.copy()


def _scipy(matrix: PETSc.Mat) -> sparse.csr_matrix:
    """Copy of an assembled PETSc matrix, which is destroyed."""
    indptr, indices, values = matrix.getValuesCSR()
    result = sparse.csr_matrix((values, indices, indptr), shape=matrix.getSize())
    matrix.destroy()
    return result
