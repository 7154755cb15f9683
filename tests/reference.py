"""An independent solution of a scene: one undecomposed system and a direct method.

The tests compare the application with this module, so it shares nothing with it but the
description of the scene: every body is meshed as a whole on one process, dolfinx assembles one
stiffness per body, held components are eliminated, and the quadratic programme

    min ½ uᵀ K u - fᵀ u   subject to   B u ≤ g,

a row of B being -nᵀ at one node or, between two bodies, one of `tests.mortar_reference`,

is solved in the primal variable by the proximal method of multipliers: the k-th step minimises

    ½ uᵀ K u - fᵀ u + ε/2 ‖u - u_k‖² + 1/(2δ) ‖max(0, B u - g + δ λ_k)‖²

and sets λ_{k+1} = max(0, λ_k + (B u - g)/δ) (R. T. Rockafellar, Augmented Lagrangians and
applications of the proximal point algorithm in convex programming, Math. Oper. Res. 1 (1976)).
A step is convex and piecewise quadratic, so the primal-dual active set (semismooth Newton)
method with an exact line search solves it from any start in a finite number of sparse direct
solves. ε makes floating bodies and free sliding harmless, δ makes repeated and dependent contact
rows harmless; both vanish from the limit, whose optimality conditions are checked at the end.
"""

from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import ufl
from dolfinx import fem, mesh
from dolfinx.cpp.io import perm_vtk
from dolfinx.fem.petsc import assemble_matrix, assemble_vector
from mpi4py import MPI
from petsc4py import PETSc
from scipy.spatial import cKDTree

from tests import mortar_reference

NEW_DOLFINX = hasattr(fem, "functionspace")

KKT_TOLERANCE = 1e-10
"""Largest relative residual of the optimality conditions that a reference may leave."""

STILL = 1e-3
"""Displacements over those that loads make at their nodes alone, below which these count."""


class ReferenceError(RuntimeError):
    """The reference found no solution it can vouch for."""


@dataclass(frozen=True)
class System:
    """The assembled, undecomposed problem."""

    dimension: int
    points: np.ndarray  # ndarray, shape (n, 3)
    """Nodes of all bodies, one body after the other."""
    body: np.ndarray  # ndarray, shape (n,)
    """Index of the body of each node."""
    stiffness: sp.csr_matrix  # csr_matrix, shape (n·dim, n·dim)
    """Block diagonal, unconstrained."""
    load: np.ndarray  # ndarray, shape (n·dim,)
    held: np.ndarray  # ndarray of bool, shape (n·dim,)
    """Components with a displacement condition."""
    prescribed: np.ndarray  # ndarray, shape (n·dim,)
    """Their values; zero elsewhere."""
    contact: sp.csr_matrix  # csr_matrix, shape (rows, n·dim)
    """Rows of the non-penetration conditions."""
    gap: np.ndarray
    contact_node: np.ndarray
    """Shape ndarray, shape (rows,)."""
    contact_source: np.ndarray  # ndarray, shape (rows,)
    """Index of the contact of each row: those with obstacles first, then pairs."""


@dataclass(frozen=True)
class Reference:
    """The reference solution of a scene."""

    system: System
    u: np.ndarray  # ndarray, shape (n, dim)
    """Displacement at ``system.points``."""
    energy: float
    """½ a(u, u) - l(u)."""
    multiplier: np.ndarray  # ndarray, shape (rows,)
    """Contact forces along the obstacle normals, ≥ 0."""
    contact_force: np.ndarray  # ndarray, shape (dim,)
    """Resultant on the bodies from the obstacles."""
    residual: float
    """Largest relative residual of the optimality conditions."""

    @property
    def points(self) -> np.ndarray:
        """Nodes, shape (n, 3)."""
        return self.system.points

    @property
    def active(self) -> int:
        """Rows with a positive multiplier."""
        scale = np.abs(self.multiplier).max(initial=0.0)
        return int(np.count_nonzero(self.multiplier > 1e-9 * scale)) if scale > 0 else 0

    def energy_error(self, u: np.ndarray) -> float:
        """Squared energy norm of a difference, ‖u - u_ref‖²_K = a(u - u_ref, u - u_ref).

        Parameters
        ----------
        u : ndarray, shape (n, dim)
            Displacement at the points of this reference, in its order.
        """
        difference = (np.asarray(u) - self.u).ravel()
        return float(difference @ (self.system.stiffness @ difference))


# --- assembly -------------------------------------------------------------------------------

_CELLS = {
    "hexahedron": mesh.CellType.hexahedron,
    "tetrahedron": mesh.CellType.tetrahedron,
    "quadrilateral": mesh.CellType.quadrilateral,
    "triangle": mesh.CellType.triangle,
}


_RULES = {"triangle": 4, "quadrilateral": 5, "tetrahedron": 5, "hexahedron": 7}
"""Degrees that integrate φ times the Jacobian of curved cells."""


def _box_mesh(box: Any) -> mesh.Mesh:
    lower, upper = [np.array(p, dtype=np.float64) for p in (box.lower, box.upper)]
    make = mesh.create_box if len(lower) == 3 else mesh.create_rectangle
    return make(MPI.COMM_SELF, [lower, upper], list(box.cells), _CELLS[box.cell])


def _cell_mesh(given: Any) -> mesh.Mesh:
    """The whole mesh of a body whose mesh came from a file; nodes as VTK has them."""
    dimension = given.points.shape[1]
    if NEW_DOLFINX:
        import basix.ufl

        element = basix.ufl.element("Lagrange", given.cell, given.degree, shape=(dimension,))
    else:
        element = ufl.VectorElement("Lagrange", given.cell, given.degree, dim=dimension)
    order = perm_vtk(_CELLS[given.cell], given.cells.shape[1])
    return mesh.create_mesh(MPI.COMM_SELF, given.cells[:, order], given.points, ufl.Mesh(element))


def _curved(body: Any) -> bool:
    """Whether the geometry of a body is of second order, too."""
    return body.degree == 2 and getattr(body.mesh, "middles", None) is not None


def _touches(points: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Whether each point is a node, of degree 1 or 2, of straight facets (n, corners, d)."""
    middles = 0.5 * (facets[:, :, None] + facets[:, None])  # of a corner and itself, too
    nodes = np.concatenate([middles.reshape(-1, facets.shape[2]), facets.mean(axis=1)])
    distance, _ = cKDTree(nodes).query(points[:, : facets.shape[2]])
    return distance < 1e-9 * np.ptp(nodes, axis=0).max()


def _vector_space(domain: mesh.Mesh, degree: int) -> fem.FunctionSpace:
    dimension = domain.geometry.dim
    if NEW_DOLFINX:
        return fem.functionspace(domain, ("Lagrange", degree, (dimension,)))
    return fem.VectorFunctionSpace(domain, ("Lagrange", degree), dim=dimension)


def _on(body: Any, name: str, points: np.ndarray) -> np.ndarray:
    """Whether each of points (n, 3) lies on a named boundary; box faces need no definition."""
    if name in body.boundaries:
        return np.asarray(body.boundaries[name](points), dtype=bool)
    if hasattr(body.mesh, "sides"):
        given = body.mesh.shape(2) if _curved(body) else body.mesh
        return _touches(points, given.points[given.topology.facets[body.mesh.sides[name]]])
    lower, upper = np.asarray(body.mesh.lower, float), np.asarray(body.mesh.upper, float)
    axis, side = "xyz".index(name[0]), (lower if name[1] == "-" else upper)
    return np.abs(points[:, axis] - side[axis]) < 1e-9 * np.abs(upper - lower).max()


def _assembled(form: Any) -> sp.csr_matrix:
    """The matrix of a form."""
    matrix = assemble_matrix(fem.form(form))
    matrix.assemble()
    indptr, indices, values = matrix.getValuesCSR()
    result = sp.csr_matrix((values, indices, indptr), shape=matrix.getSize())
    matrix.destroy()
    return result


class AssembledBody:
    """One body's nodes, stiffness and loads on its whole mesh."""

    def __init__(self, body: Any, dimension: int, plane: str | None) -> None:
        self.body = body
        from_file = hasattr(body.mesh, "points")
        curved = _curved(body)
        if from_file:
            self.domain = _cell_mesh(body.mesh.shape(2) if curved else body.mesh)
        else:
            self.domain = _box_mesh(body.mesh)
        self.space = _vector_space(self.domain, body.degree)
        self.dimension = dimension
        self.points = self.space.tabulate_dof_coordinates()
        facets_dimension = dimension - 1
        self.domain.topology.create_connectivity(facets_dimension, dimension)
        outer = np.sort(mesh.exterior_facet_indices(self.domain.topology))
        self.surface = np.unique(fem.locate_dofs_topological(self.space, facets_dimension, outer))

        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        shears, bulks = [], []
        for material in body.materials:
            shear = material.young / (2 * (1 + material.poisson))
            bulk = 2 * shear * material.poisson / (1 - 2 * material.poisson)
            shears.append(shear)
            bulks.append(2 * shear * bulk / (2 * shear + bulk) if plane == "stress" else bulk)
        tags = np.zeros(1, int)
        if from_file:
            tags = body.mesh.tags[np.asarray(self.domain.topology.original_cell_index)]
        constants = (fem.functionspace if NEW_DOLFINX else fem.FunctionSpace)(
            self.domain, ("DG", 0)
        )
        lame = [fem.Function(constants) for _ in range(2)]
        for function, values in zip(lame, (bulks, shears), strict=True):
            function.x.array[:] = np.array(values)[tags]

        def strain(w: Any) -> Any:
            return ufl.sym(ufl.grad(w))

        # with mean dilatation the pressure is a constant of each cell, eliminated from
        #   a(u, v) + ∫ p div v = l(v),  ∫ q (div u - p / λ) = 0
        mean = body.materials[0].mean_dilatation
        stress = (0.0 if mean else lame[0]) * ufl.div(u) * ufl.Identity(dimension) + 2 * lame[
            1
        ] * strain(u)
        # Two points a direction for degree 1, three for degree 2, as every code has it: exact on
        # boxes; on distorted cells the integrand is rational, and another rule would make another
        # discrete problem.
        rule = _RULES[body.mesh.cell] if curved else 2 * body.degree
        dx = ufl.dx(metadata={"quadrature_degree": rule})
        self.stiffness = _assembled(ufl.inner(stress, strain(v)) * dx)
        if mean:
            p, q = ufl.TrialFunction(constants), ufl.TestFunction(constants)
            D, M = _assembled(ufl.div(v) * p * dx), _assembled(p * q / lame[0] * dx)
            self.stiffness = sp.csr_matrix(self.stiffness + D @ sp.diags(1.0 / M.diagonal()) @ D.T)
        self.load = np.zeros(self.points.shape[0] * dimension)
        # (3 λ + 2 μ) α, with λ as it is in space: in plane stress times 2 μ / (λ + 2 μ)
        self.thermal = []
        for material in body.materials:
            beta = material.young * material.expansion / (1 - 2 * material.poisson)
            if plane == "stress":
                beta *= (1 - 2 * material.poisson) / (1 - material.poisson)
            self.thermal.append(beta)
        self.tags = tags

    def add_heat(self, rise: Any) -> None:
        """Add the load of a temperature, interpolated finely; not with mean dilatation."""
        make = fem.functionspace if NEW_DOLFINX else fem.FunctionSpace
        space = make(self.domain, ("Lagrange", self.body.degree + 2))
        constants = make(self.domain, ("DG", 0))
        temperature, beta = fem.Function(space), fem.Function(constants)
        temperature.interpolate(lambda x: rise(x.T))
        beta.x.array[:] = np.array(self.thermal)[self.tags]
        form = beta * temperature * ufl.div(ufl.TestFunction(self.space))
        vector = assemble_vector(fem.form(form * ufl.dx(metadata={"quadrature_degree": 8})))
        self.load += vector.array
        vector.destroy()

    def add_load(
        self, boundary: str | None, force: Any = None, traction: Any = None, pressure: float = 0.0
    ) -> None:
        """Add a body force (per volume) or a traction and pressure on the facets of a boundary."""
        facets = np.zeros(0, dtype=np.int32)
        if boundary is not None:
            facets = mesh.locate_entities_boundary(
                self.domain, self.dimension - 1, lambda x: _on(self.body, boundary, x.T)
            )
            if facets.size == 0:
                raise ReferenceError(f"no facet of {self.body.name} lies on {boundary}")
        facets = np.sort(facets).astype(np.int32)
        tags = mesh.meshtags(self.domain, self.dimension - 1, facets, np.ones_like(facets))
        surface = ufl.Measure("ds", domain=self.domain, subdomain_data=tags)(1)

        def constant(value: Any) -> fem.Constant:
            zero = np.zeros(self.dimension)
            return fem.Constant(self.domain, np.asarray(zero if value is None else value, float))

        v = ufl.TestFunction(self.space)
        normal = ufl.FacetNormal(self.domain)
        minus_pressure = fem.Constant(self.domain, PETSc.ScalarType(-pressure))
        form = ufl.inner(constant(force), v) * ufl.dx
        form += ufl.inner(constant(traction) + minus_pressure * normal, v) * surface
        vector = assemble_vector(fem.form(form))
        self.load += vector.array
        vector.destroy()

    def facets_on(self, boundary: str, first: int) -> list[mortar_reference.Facet]:
        """Facets of the surface on a named boundary, nodes counted from `first`."""
        d = self.dimension
        outer = np.sort(mesh.exterior_facet_indices(self.domain.topology))
        inside = self.points[:, :d].mean(axis=0)
        facets = []
        for entity in outer:
            entities = np.array([entity], dtype=np.int32)
            nodes = fem.locate_dofs_topological(self.space, d - 1, entities)
            if _on(self.body, boundary, self.points[nodes]).all():
                facets.append(mortar_reference.facet(nodes, self.points[nodes, :d], inside))
        return [replace(f, nodes=tuple(n + first for n in f.nodes)) for f in facets]

    def mean_rows(self, boundary: str) -> tuple[sp.csr_matrix, np.ndarray]:
        """∫ ψ_j φ_k ds of hat functions ψ and the displacement's φ on a boundary, by dolfinx.

        Returns the matrix with a row for each vertex on it, divided by ∫ ψ_j ds, and the nodes at
        these vertices.
        """
        make = fem.functionspace if NEW_DOLFINX else fem.FunctionSpace
        hats, quadratic = (make(self.domain, ("Lagrange", p)) for p in (1, 2))
        facets = mesh.locate_entities_boundary(
            self.domain, 2, lambda x: _on(self.body, boundary, x.T)
        )
        facets = np.sort(facets).astype(np.int32)
        tags = mesh.meshtags(self.domain, 2, facets, np.ones_like(facets))
        degree = {"quadrature_degree": 12}  # exact but for curved faces, whose area has a root
        ds = ufl.Measure("ds", domain=self.domain, subdomain_data=tags, metadata=degree)(1)
        psi, phi = ufl.TestFunction(hats), ufl.TrialFunction(quadratic)
        matrix = _assembled(psi * phi * ds)
        area = np.asarray(matrix.sum(axis=1)).ravel()
        rows = np.flatnonzero(area > 1e-12 * area.max())
        mean = sp.diags(1.0 / area[rows]) @ matrix[rows]
        here = cKDTree(self.points)
        _, of_dof = here.query(quadratic.tabulate_dof_coordinates())
        _, vertex = here.query(hats.tabulate_dof_coordinates()[rows])
        order = np.empty(len(of_dof), int)
        order[of_dof] = np.arange(len(of_dof))
        return sp.csr_matrix(mean.tocsr()[:, order]), vertex

    def edge_rows(
        self, boundary: str, vertices: np.ndarray, gap: np.ndarray
    ) -> dict[int, dict[int, float]]:
        """Weights of nodes about vertices from which all facets rise steeply from an obstacle.

        A third is at the vertex, the rest amid its edges that hardly rise, by their lengths.
        """
        facets_of: dict[int, list[list[int]]] = {int(v): [] for v in vertices}
        for facet in self.facets_on(boundary, 0):
            for vertex in facet.nodes:
                if vertex in facets_of:
                    facets_of[vertex].append(list(facet.nodes))
        result = {}
        for vertex, facets in facets_of.items():
            rises, amid = [], {}
            for nodes in facets:
                corners = [n for n in nodes if n in facets_of]
                others = [n for n in corners if n != vertex]
                a, b, c = self.points[[vertex, *others]]
                area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a)))
                amid_edges = [n for n in nodes if n not in corners]
                to_edge = [self.points[others[k]] + a for k in (0, 1)]
                near = [
                    min(amid_edges, key=lambda n, e=e: np.linalg.norm(2.0 * self.points[n] - e))
                    for e in to_edge
                ]
                (opposite,) = set(amid_edges) - set(near)
                mean = 0.1 * gap[vertex] - 0.05 * gap[others].sum()
                mean += 0.4 * gap[near].sum() + 0.2 * gap[opposite]
                rises.append((mean - gap[vertex]) / np.sqrt(area))
                for n in near:
                    away = float(np.linalg.norm(self.points[n] - a))
                    if gap[n] - gap[vertex] <= 0.1 * away:
                        amid[n] = away
            if min(rises) > 0.1:
                share = 2.0 / 3.0 if amid else 0.0
                result[vertex] = {n: share * x / sum(amid.values()) for n, x in amid.items()}
                result[vertex][vertex] = 1.0 - share
        return result

    def nodes_on(self, boundary: str) -> np.ndarray:
        """Surface nodes on a named boundary."""
        nodes = self.surface[_on(self.body, boundary, self.points[self.surface])]
        if nodes.size == 0:
            raise ReferenceError(f"no surface node of {self.body.name} lies on {boundary}")
        return nodes


def assemble(scene: Any) -> System:
    """Assemble the undecomposed problem of a scene."""
    dimension = scene.dimension
    bodies = [AssembledBody(body, dimension, scene.plane) for body in scene.bodies]
    for item in scene.tractions:
        bodies[item.body].add_load(item.boundary, traction=item.vector)
    for item in scene.pressures:
        bodies[item.body].add_load(item.boundary, pressure=item.value)
    for item in scene.forces:
        bodies[item.body].add_load(None, force=item.vector)
    for item in scene.temperatures:
        bodies[item.body].add_heat(item.rise)

    first_node = np.concatenate(([0], np.cumsum([b.points.shape[0] for b in bodies])))
    dofs = first_node[-1] * dimension
    held, prescribed = np.zeros(dofs, dtype=bool), np.zeros(dofs)
    for item in scene.displacements:
        nodes = first_node[item.body] + bodies[item.body].nodes_on(item.boundary)
        for component, value in enumerate(item.values):
            if value is None:
                continue
            index = nodes * dimension + component
            if np.any(held[index] & (prescribed[index] != value)):
                raise ReferenceError(f"{item.source} contradicts an earlier condition")
            held[index], prescribed[index] = True, value

    rows, gaps, contact_nodes = [], [], []
    for item in scene.contacts:
        body = bodies[item.body]
        if body.body.degree == 2 and body.body.mesh.cell == "tetrahedron":
            mean, local = body.mean_rows(item.boundary)
            gap, normal = item.obstacle.gap_and_normal(body.points)
            mean = mean.tolil()
            for vertex, weights in body.edge_rows(item.boundary, local, gap).items():
                row = int(np.flatnonzero(local == vertex)[0])
                mean[row] = 0.0
                mean[row, list(weights)] = list(weights.values())
            mean = mean.tocsr()
            gap = gap - item.interference
            blocks = sp.csr_matrix(  # -n at each node, as a block of one row
                (
                    -normal[:, :dimension].ravel(),
                    np.arange(len(body.points) * dimension),
                    dimension * np.arange(len(body.points) + 1),
                )
            )
            start = first_node[item.body] * dimension
            before = sp.csr_matrix((len(local), start))
            after = sp.csr_matrix((len(local), dofs - start - blocks.shape[1]))
            rows.append(sp.hstack([before, mean @ blocks, after], format="csr"))
            gaps.append(mean @ gap)
            contact_nodes.append(first_node[item.body] + local)
            continue
        local = bodies[item.body].nodes_on(item.boundary)
        gap, normal = item.obstacle.gap_and_normal(bodies[item.body].points[local])
        gap = gap - item.interference
        nodes = first_node[item.body] + local
        count = np.arange(nodes.size).repeat(dimension)
        columns = (nodes[:, None] * dimension + np.arange(dimension)).ravel()
        values = -np.asarray(normal)[:, :dimension].ravel()
        rows.append(sp.csr_matrix((values, (count, columns)), shape=(nodes.size, dofs)))
        gaps.append(gap)
        contact_nodes.append(nodes)

    for item in scene.pairs:
        found, gap, _ = mortar_reference.mortar_rows(
            bodies[item.body].facets_on(item.boundary, first_node[item.body]),
            bodies[item.other].facets_on(item.other_boundary, first_node[item.other]),
        )
        matrix = sp.lil_matrix((len(found), dofs))
        for row, node in enumerate(found):
            for there, vector in found[node].items():
                matrix[row, there * dimension + np.arange(dimension)] = vector
        rows.append(matrix.tocsr())
        gaps.append(np.array([gap[node] for node in found]) - item.interference)
        contact_nodes.append(np.array(list(found)))

    return System(
        dimension=dimension,
        points=np.concatenate([b.points for b in bodies]),
        body=np.repeat(np.arange(len(bodies)), np.diff(first_node)),
        stiffness=sp.block_diag([b.stiffness for b in bodies], format="csr"),
        load=np.concatenate([b.load for b in bodies]),
        held=held,
        prescribed=prescribed,
        contact=sp.vstack(rows, format="csr") if rows else sp.csr_matrix((0, dofs)),
        gap=np.concatenate(gaps) if gaps else np.zeros(0),
        contact_node=np.concatenate(contact_nodes) if rows else np.zeros(0, dtype=int),
        contact_source=np.repeat(np.arange(len(gaps)), [len(g) for g in gaps]),
    )


# --- the quadratic programme -------------------------------------------------------------------


def _step_length(slope: float, curvature: float, excess: np.ndarray, rate: np.ndarray) -> float:
    """Minimiser t ≥ 0 of a convex piecewise quadratic along a descent direction.

    Its derivative is slope + curvature·t + Σ rate_i·max(0, excess_i + t·rate_i) with the parts
    of the rows that are scaled by 1/δ already. It is increasing and linear between the places
    where rows come in or drop out: bisect these, then solve in the piece that holds its root.
    """

    def derivative(t: float) -> float:
        return slope + curvature * t + float(rate @ np.maximum(0.0, excess + t * rate))

    changes = -excess[rate != 0.0] / rate[rate != 0.0]
    ends = np.concatenate([[0.0], np.sort(changes[changes > 0.0]), [np.inf]])
    first = bisect_left(ends, 0.0, 1, len(ends) - 1, key=derivative)
    begin, inside = ends[first - 1], 0.5 * (ends[first - 1] + min(ends[first], 1e300))
    active = rate[excess + inside * rate > 0.0]
    length = begin - derivative(begin) / (curvature + float(active @ active))
    if not length < 1e30:
        raise ReferenceError("the energy is unbounded below: no equilibrium")
    return max(float(length), 0.0)


def minimise(
    stiffness: sp.spmatrix,
    load: np.ndarray,
    rows: sp.spmatrix,
    gap: np.ndarray,
    extent: float,
    tolerance: float = KKT_TOLERANCE,
) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Solve min ½ uᵀ K u - fᵀ u subject to B u ≤ g.

    Parameters
    ----------
    stiffness : sparse, shape (n, n)
        Symmetric positive semidefinite.
    load : ndarray, shape (n,)
    rows : sparse, shape (m, n)
    gap : ndarray, shape (m,)
    extent : float
        Size of the bodies: gaps are known to round-off of this.

    Returns
    -------
    u, multiplier : ndarray
    residual : float
        Largest relative residual of the optimality conditions.
    newton_steps : int

    Raises
    ------
    ReferenceError
        When the optimality conditions cannot be met to the tolerance, for example
        because the problem has no solution.
    """
    K, B = sp.csc_matrix(stiffness), sp.csr_matrix(rows)
    n, m = K.shape[0], B.shape[0]
    if n == 0:
        if np.any(gap < -1e-12 * extent):
            raise ReferenceError("a held node penetrates an obstacle")
        return np.zeros(0), np.zeros(m), 0.0, 0
    # A row without a free component is a plain statement about prescribed values.
    norm = np.sqrt(np.asarray(B.multiply(B).sum(axis=1)).ravel())
    fixed = norm < 1e-12
    if np.any(gap[fixed] < -1e-12 * extent):
        raise ReferenceError("a held node penetrates an obstacle")
    gap = np.where(fixed, np.maximum(gap, 0.0), gap)

    # In units in which every diagonal entry and every row is one, so that neither a soft body
    # beside a stiff one nor a short row is lost in ε and δ.
    given = K, load, B, gap
    unit = 1.0 / np.sqrt(_diagonal(K))
    B = B @ sp.diags(unit)
    size = np.sqrt(np.asarray(B.multiply(B).sum(axis=1)).ravel())
    size[fixed] = 1.0
    K = sp.csc_matrix(sp.diags(unit) @ K @ sp.diags(unit))
    B, gap, load = sp.csr_matrix(sp.diags(1.0 / size) @ B), gap / size, unit * load

    epsilon, delta = 1e-7, 1e-3
    K_epsilon = sp.csc_matrix(K + epsilon * sp.identity(n))
    u, multiplier = np.zeros(n), np.zeros(m)
    factors: dict[bytes, Any] = {}
    steps = 0

    def newton_target(active: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Minimiser of the step's function if exactly these rows were active."""
        key = np.packbits(active).tobytes()
        if key not in factors:
            B_a = B[active]
            system = sp.bmat([[K_epsilon, B_a.T], [B_a, -delta * sp.identity(B_a.shape[0])]])
            factors.clear()
            factors[key] = (sp.csc_matrix(system), spla.splu(sp.csc_matrix(system)))
        system, factor = factors[key]
        target = factor.solve(right)
        for _ in range(2):  # the regularisation is small: refine
            target += factor.solve(right - system @ target)
        return target[:n]

    best, best_residual = (u, multiplier), np.inf
    stagnation = 0
    for _ in range(300):
        center, shifted_gap = u, gap - delta * multiplier
        for _ in range(200):
            excess = B @ u - shifted_gap
            active = excess > 0
            right = np.concatenate([load + epsilon * center, shifted_gap[active]])
            direction = newton_target(active, right) - u
            steps += 1
            gradient = K_epsilon @ u - load - epsilon * center
            rate = B @ direction
            full = B @ (u + direction) - shifted_gap > 0
            if np.array_equal(full, active):
                u = u + direction
                break
            u = u + direction * _step_length(
                float(gradient @ direction),
                float(direction @ (K_epsilon @ direction)),
                excess / np.sqrt(delta),
                rate / np.sqrt(delta),
            )
        multiplier = np.maximum(0.0, (B @ u - shifted_gap) / delta)
        residual = optimality(*given, unit * u, multiplier / size)
        if residual < 0.5 * best_residual:
            stagnation = 0
        else:
            stagnation += 1
        if residual < best_residual:
            best, best_residual = (unit * u, multiplier / size), residual
        if best_residual < 1e-14 or (stagnation >= 5 and best_residual < tolerance):
            break
    if not best_residual <= tolerance:
        raise ReferenceError(
            f"optimality conditions hold to {best_residual:.1e} only: no equilibrium, or a defect"
        )
    return best[0], best[1], best_residual, steps


def _diagonal(K: sp.spmatrix) -> np.ndarray:
    """The diagonal, its largest entry where it is zero: unknowns that no stiffness resists."""
    found = K.diagonal()
    return np.where(found > 0.0, found, found.max(initial=1e-300))


def optimality(
    K: sp.spmatrix,
    load: np.ndarray,
    B: sp.spmatrix,
    gap: np.ndarray,
    u: np.ndarray,
    multiplier: np.ndarray,
) -> float:
    """Largest relative residual of the optimality conditions of the quadratic programme.

    Forces are relative to the largest nodal force (a load, an internal or a contact force),
    lengths to the largest displacement or gap that is met, works to their product. Where loads act
    on what obstacles hold, nothing moves: lengths are at least a thousandth of what the loads
    would do to their nodes alone.
    """
    internal, reaction = K @ u, B.T @ multiplier
    force = max(np.abs(v).max(initial=0.0) for v in (load, internal, reaction))
    slack = gap - B @ u
    closed = np.abs(gap[multiplier > 0]).max(initial=0.0)
    alone = np.abs(np.where(K.diagonal() > 0.0, load, 0.0) / _diagonal(K)).max(initial=0.0)
    length = max(np.abs(u).max(initial=0.0), closed, STILL * alone)
    if force == 0.0 and length == 0.0:
        return float(np.any(slack < 0))
    force, length = max(force, 1e-300), max(length, 1e-300)
    return float(
        max(
            np.abs(internal - load + reaction).max(initial=0.0) / force,
            np.maximum(0.0, -slack).max(initial=0.0) / length,
            np.abs(multiplier * slack).max(initial=0.0) / (force * length),
            np.maximum(0.0, -multiplier).max(initial=0.0) / force,
        )
    )


def solve(scene: Any, tolerance: float = KKT_TOLERANCE) -> Reference:
    """Solve a scene by the active-set method of this module, to a tolerance of `minimise`."""
    system = assemble(scene)
    free = ~system.held
    K = system.stiffness
    u = system.prescribed.copy()
    load = (system.load - K @ u)[free]
    gap = system.gap - system.contact @ u
    extent = float(np.ptp(system.points, axis=0).max())
    u[free], multiplier, residual, _ = minimise(
        K[free][:, free], load, system.contact[:, free], gap, extent, tolerance
    )
    return Reference(
        system=system,
        u=u.reshape(-1, system.dimension),
        energy=float(0.5 * u @ (K @ u) - system.load @ u),
        multiplier=multiplier,
        contact_force=-(system.contact.T @ multiplier).reshape(-1, system.dimension).sum(axis=0),
        residual=residual,
    )
