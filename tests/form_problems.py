"""Problems of forms that several tests solve, and their solution without the application.

Run as a program, `python -m tests.form_problems`, it prints the answers to some of them, which are
the same on any number of ranks.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import dolfinx
import numpy as np
import scipy.sparse as sp
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix
from mpi4py import MPI

from contact_app import Contact, ContactProblem, Cylinder, Plane, SignedDistance, Sphere
from tests import reference

NEW = hasattr(fem, "functionspace")

CELLS = {
    "quadrilateral": dolfinx.mesh.CellType.quadrilateral,
    "triangle": dolfinx.mesh.CellType.triangle,
    "hexahedron": dolfinx.mesh.CellType.hexahedron,
    "tetrahedron": dolfinx.mesh.CellType.tetrahedron,
}


def box(cell: str, cells: tuple[int, ...], upper: tuple[float, ...], comm: Any) -> Any:
    """A box from the origin to a corner."""
    corners = [np.zeros(len(cells)), np.array(upper, float)]
    if len(cells) == 2:
        return dolfinx.mesh.create_rectangle(comm, corners, list(cells), CELLS[cell])
    return dolfinx.mesh.create_box(comm, corners, list(cells), CELLS[cell])


def vector_space(mesh: Any, degree: int, family: str = "Lagrange") -> Any:
    d = mesh.geometry.dim
    if NEW:
        return fem.functionspace(mesh, (family, degree, (d,)))
    return fem.VectorFunctionSpace(mesh, (family, degree))


def scalar_space(mesh: Any, degree: int) -> Any:
    make = fem.functionspace if NEW else fem.FunctionSpace
    return make(mesh, ("Lagrange", degree))


def facet_tags(mesh: Any, where: dict[int, Callable[[np.ndarray], np.ndarray]]) -> Any:
    """Tags of facets of the surface whose vertices meet a condition."""
    d = mesh.topology.dim
    found = {
        tag: dolfinx.mesh.locate_entities_boundary(mesh, d - 1, condition)
        for tag, condition in where.items()
    }
    facets = np.concatenate(list(found.values()))
    values = np.concatenate([np.full(len(f), tag, np.int32) for tag, f in found.items()])
    order = np.argsort(facets, kind="stable")
    return dolfinx.mesh.meshtags(mesh, d - 1, facets[order], values[order])


def strain(u: Any) -> Any:
    return ufl.sym(ufl.grad(u))


def isotropic(u: Any, young: float, poisson: float) -> Any:
    """Stress in 3D, or in plane strain."""
    lam = young * poisson / (1 + poisson) / (1 - 2 * poisson)
    mu = young / 2 / (1 + poisson)
    d = len(u)
    return lam * ufl.tr(strain(u)) * ufl.Identity(d) + 2 * mu * strain(u)


def elastic(space: Any, young: float, poisson: float = 0.3, force: Any = None) -> tuple[Any, Any]:
    """Forms a and L of an isotropic body under a force per volume, none unless given."""
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    force = np.zeros(space.mesh.geometry.dim) if force is None else np.array(force, float)
    a = ufl.inner(isotropic(u, young, poisson), strain(v)) * ufl.dx
    return a, ufl.inner(fem.Constant(space.mesh, force), v) * ufl.dx


def orthotropic(u: Any) -> Any:
    """Stress of a body that is ten times as stiff along x as across, and soft in shear."""
    e, d = strain(u), len(u)
    C = np.diag([10.0, 2.0, 1.0][:d]) + 0.3 * (np.ones((d, d)) - np.eye(d))
    normal = [sum(C[i, j] * e[j, j] for j in range(d)) for i in range(d)]
    G = [[0.0, 0.4, 0.9], [0.4, 0.0, 0.2], [0.9, 0.2, 0.0]]
    rows = [[normal[i] if i == j else 2 * G[i][j] * e[i, j] for j in range(d)] for i in range(d)]
    return ufl.as_tensor(rows)


def held(space: Any, where: Callable[[np.ndarray], np.ndarray], component: int | None = None,
         value: float = 0.0) -> Any:  # fmt: skip
    """A Dirichlet condition on all components, or on one."""
    mesh = space.mesh
    facets = dolfinx.mesh.locate_entities_boundary(mesh, mesh.topology.dim - 1, where)
    if component is None:
        dofs = fem.locate_dofs_topological(space, mesh.topology.dim - 1, facets)
        return fem.dirichletbc(np.full(mesh.geometry.dim, value), dofs, space)
    sub = space.sub(component)
    dofs = fem.locate_dofs_topological(sub, mesh.topology.dim - 1, facets)
    return fem.dirichletbc(value, dofs, sub)


@dataclass(frozen=True, eq=False)
class Forms:
    """A problem as a user of dolfinx has it."""

    space: Any
    a: Any
    L: Any
    bcs: list[Any]
    contacts: list[Contact]

    def problem(self, **options: Any) -> ContactProblem:
        return ContactProblem(
            self.a, self.L, self.bcs, self.contacts, **{"tolerance": 1e-10, **options}
        )


def left(x: np.ndarray) -> np.ndarray:
    return np.isclose(x[0], 0.0)


def right(x: np.ndarray) -> np.ndarray:
    return np.isclose(x[0], 1.0)


def bottom(x: np.ndarray) -> np.ndarray:
    return np.isclose(x[1], 0.0)


def block(
    cell: str, degree: int, comm: Any = MPI.COMM_WORLD, kind: str = "orthotropic",
    cells: int = 4, layers: int = 3,
) -> Forms:  # fmt: skip
    """A block held on the left, pulled down beside a floor that is tilted, round or far.

    Parameters
    ----------
    kind
        ``orthotropic``; ``springs``, on springs alone; ``heat``, by thermal strains;
        ``sphere`` or ``distance``, pressed on a ball, as a sphere or a signed distance, ``bore``
        or ``distance in a bore``, into one;
        ``prescribed``, by Dirichlet conditions of components with values.
    cells, layers
        Along x and y.
    """
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    mesh = box(cell, (cells, layers, 2)[:d], (1.0, 0.6, 0.5)[:d], comm)
    V = vector_space(mesh, degree)
    tags = facet_tags(mesh, {3: bottom, 4: left})
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": 2 * degree})
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    a = ufl.inner(orthotropic(u), strain(v)) * dx
    L = ufl.inner(fem.Constant(mesh, np.array([0.1, -0.5, 0.05][:d])), v) * dx
    bcs = [held(V, left)]
    floor: Any = Plane(point=(0.0, -0.05, 0.0)[:d], normal=(0.1, 1.0, 0.05)[:d])
    if kind == "springs":
        bcs = []
        a += 0.7 * ufl.inner(u, v) * ds(4)
    if kind == "heat":
        alpha = fem.Function(scalar_space(mesh, 1))
        alpha.interpolate(lambda x: 0.2 * x[1])
        L += alpha * ufl.inner(orthotropic(v), ufl.Identity(d)) * dx
    if kind == "prescribed":
        bcs = [held(V, left, i) for i in range(d)] + [held(V, right, 1, -0.2)]
    center, radius = np.array((0.8, -0.55, 0.25)[:d]), 0.5
    if kind == "sphere":
        floor = Sphere(center=tuple(center), radius=radius)
    if kind == "distance":
        floor = SignedDistance(lambda x: np.linalg.norm(x - center, axis=1) - radius)
    middle, wide = np.array((0.5, 1.9, 0.25)), 2.0
    if kind == "bore":
        floor = Cylinder(point=tuple(middle), axis=(0, 0, 3), radius=wide, hollow=True)
    if kind == "distance in a bore":

        def away(x: np.ndarray) -> np.ndarray:
            return (x - middle) * [1, 1, 0]

        floor = SignedDistance(
            lambda x: wide - np.linalg.norm(away(x), axis=1),
            lambda x: -away(x) / np.linalg.norm(away(x), axis=1)[:, None],
        )
    return Forms(V, a, L, bcs, [Contact(tags, 3, floor)])


def two_blocks(cell: str, degree: int, comm: Any = MPI.COMM_WORLD) -> Forms:
    """A stiff block on a soft one that is wider, on one mesh whose nodes do not meet."""
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    mesh = stacked(cell, comm)
    V = vector_space(mesh, degree)
    up = d - 1
    tags = facet_tags(mesh, {
        1: lambda x: np.isclose(x[up], 1.0) & (x[0] > 0.14) & (x[0] < 0.86),
        2: lambda x: np.isclose(x[up], 0.99),
        3: lambda x: np.isclose(x[up], 2.0),
    })  # fmt: skip
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    x = ufl.SpatialCoordinate(mesh)
    young = ufl.conditional(ufl.lt(x[up], 0.995), 1.0, 5.0)
    dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": 2 * degree})
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    a = ufl.inner(young * isotropic(u, 1.0, 0.3), strain(v)) * dx
    push = np.zeros(d)
    push[up] = -0.05
    L = ufl.inner(fem.Constant(mesh, push), v) * ds(3)
    bcs = [held(V, lambda x: np.isclose(x[up], 0.0))]
    return Forms(V, a, L, bcs, [Contact(tags, 1, against=2)])


def stacked(cell: str, comm: Any) -> Any:
    """Two boxes above each other in one mesh, 0.01 apart, cells of different sizes."""
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    lower = box(cell, (4, 3, 3)[:d], (1.0, 1.0, 0.99) if d == 3 else (1.0, 0.99), MPI.COMM_SELF)
    upper = box(cell, (3, 2, 2)[:d], (0.7, 0.6, 1.0) if d == 3 else (0.7, 1.0), MPI.COMM_SELF)
    shift = np.array([0.15, 0.2, 1.0] if d == 3 else [0.15, 1.0])
    points = [lower.geometry.x[:, :d], upper.geometry.x[:, :d] + shift]
    from meshes import dolfinx_compat

    cells = [dolfinx_compat.cell_nodes(lower), dolfinx_compat.cell_nodes(upper) + len(points[0])]
    joined, coordinates = np.concatenate(cells).astype(np.int64), np.concatenate(points)
    if comm.rank:
        joined, coordinates = joined[:0], coordinates[:0]
    return dolfinx_compat.create_mesh(joined, np.ascontiguousarray(coordinates), cell, comm=comm)


def rough(forms: Forms) -> Forms:
    """The same with friction at its contacts."""
    contacts = [replace(contact, friction={"coulomb": 0.3}) for contact in forms.contacts]
    return replace(forms, contacts=contacts)


def solved_alone(forms: Forms) -> tuple[np.ndarray, float]:
    """Displacement (nodes, d) and energy of a problem with an obstacle, by `tests.reference`.

    On one process, with contact at nodes.
    """
    V, (contact,) = forms.space, forms.contacts
    d = V.mesh.geometry.dim
    matrix = assemble_matrix(fem.form(forms.a))
    matrix.assemble()
    pointers, columns, values = matrix.getValuesCSR()
    K = sp.csr_matrix((values, columns, pointers))
    load = fem.assemble_vector(fem.form(forms.L)).array.copy()
    u, fixed = np.zeros(len(load)), np.zeros(len(load), bool)
    for condition in forms.bcs:
        dofs = condition.dof_indices()[0]
        fixed[dofs] = True
        if NEW:
            condition.set(u)
        else:
            fem.set_bc(u, [condition])
    facets = contact.facet_tags.find(contact.tag)
    nodes = fem.locate_dofs_topological(V, d - 1, facets)
    x = V.tabulate_dof_coordinates()[nodes]
    gap, normal = contact.gap_and_normal(x, d, 1.0)
    rows = np.repeat(np.arange(len(nodes)), d)
    columns = (nodes[:, None] * d + np.arange(d)).ravel()
    B = sp.csr_matrix((-normal[:, :d].ravel(), (rows, columns)), shape=(len(nodes), len(load)))
    free = ~fixed
    u[free], *_ = reference.minimise(
        K[free][:, free], (load - K @ u)[free], B[:, free], gap - B @ u, 1.0, 1e-9
    )
    return u.reshape(-1, d), float(0.5 * u @ (K @ u) - load @ u)


PROBLEMS: dict[str, Callable[[], Forms]] = {
    "orthotropic": lambda: block("hexahedron", 1),
    "quadratic": lambda: block("tetrahedron", 2),
    "plane": lambda: block("triangle", 2, cells=5),
    "springs": lambda: block("tetrahedron", 1, kind="springs"),
    "grid": lambda: block("quadrilateral", 1, cells=40, layers=24),
    "grid on springs": lambda: block("quadrilateral", 1, kind="springs", cells=40, layers=24),
    "pair": lambda: two_blocks("hexahedron", 1),
    "quadratic pair": lambda: two_blocks("triangle", 2),
    "rough": lambda: rough(block("hexahedron", 1)),
    "rough quadratic": lambda: rough(block("tetrahedron", 2)),
    "rough pair": lambda: rough(two_blocks("hexahedron", 1)),
}
"""Problems that are solved on several ranks."""


def answer(name: str) -> dict[str, Any]:
    """Numbers of an answer that are equal on all numbers of ranks (collective)."""
    problem = PROBLEMS[name]().problem()
    uh = problem.solve()
    comm = uh.function_space.mesh.comm
    owned = uh.function_space.dofmap.index_map.size_local
    d = uh.function_space.dofmap.index_map_bs
    x = uh.function_space.tabulate_dof_coordinates()[:owned]
    u = uh.x.array.reshape(-1, d)[:owned]
    parts = problem.contact_pressure.function_space.dofmap.index_map.size_local
    pressure, gap = problem.contact_pressure.x.array[:parts], problem.gap.x.array[:parts]
    sums = [
        (u * np.sin(3.0 * x[:, :d])).sum(), (u**2).sum(), pressure.sum(), (pressure**2).sum(),
        np.nansum(gap), np.isnan(gap).sum(),
    ]  # fmt: skip
    contact = problem.summary["contacts"][0]
    return {
        "sums": list(comm.allreduce(np.array(sums, float))),
        "energy": problem.summary["solution"]["energy"],
        "force": contact["force"],
        "area": contact["area"],
        "reactions": [f for r in problem.summary["reactions"] for f in r["force"]],
        "nodes": list(contact["nodes"].values()),
        "passed": problem.certificate.passed,
        "contact warnings": [w for w in problem.certificate.warnings if w.startswith("contacts[")],
        "subdomains": problem.summary["decomposition"]["subdomains"],
        "applications": problem.summary["solver"]["hessian_multiplications"],
    }


def tell_answers() -> None:
    """Print all answers on the first rank."""
    answers = {name: answer(name) for name in PROBLEMS}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(answers))
