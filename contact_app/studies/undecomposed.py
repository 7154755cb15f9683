"""A scene as one undecomposed system in PETSc, as a FEniCSx user would assemble it.

dolfinx distributes the mesh, the stiffness is assembled once with the same quadrature as the
subdomains' (exact on undistorted boxes), held unknowns become rows of a scaled identity, and a
contact row -nᵀu ≤ g becomes a bound on one unknown: where n is no coordinate direction, the frame
of its node is rotated by a Householder reflection H (H e_k = ± n), A' = Qᵀ A Q, u = Q u'. At a node
with several rows these replace rows of the unit matrix, N, and its block of Q is N⁻¹: the bounds
are then on N u. Only as many rows as are independent become bounds, the nearest ones first, and the
others are checked: PETSc's bound-constrained solvers can solve any scene of one body in which
these stay open.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from dolfinx.fem.petsc import assemble_matrix, assemble_vector
from mpi4py import MPI
from petsc4py import PETSc
from scipy.spatial import cKDTree

from contact_app.model.assembly import quadrature_degree
from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.scene.bodies import Body, Box
from contact_app.scene.conditions import TotalLoad
from contact_app.scene.scene import Scene
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints, Mask
from meshes.subdomains import vtk_order
from meshes.unstructured import CellMesh
from solver.rigid_motions import rigid_motions


class UnsuitableError(ValueError):
    """The scene is no bound-constrained problem of one body; the message says why."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Contact rows n·u ≤ g at nodes of this rank."""

    nodes: Ints  # (rows,)
    directions: Array  # (rows, dimension)
    """n, of length one, without held components."""
    gaps: Array
    areas: Array
    """g, and the share of the boundary's area. Shape (rows,)."""

    @classmethod
    def joined(cls, parts: "list[_Rows]", d: int) -> "_Rows":
        """The rows of all contacts."""
        none = cls(np.zeros(0, np.int64), np.zeros((0, d)), np.zeros(0), np.zeros(0))
        fields = ("nodes", "directions", "gaps", "areas")
        return cls(*(np.concatenate([getattr(p, f) for p in (none, *parts)]) for f in fields))

    def some(self, chosen: Mask) -> "_Rows":
        """The rows of a mask."""
        return _Rows(
            self.nodes[chosen], self.directions[chosen], self.gaps[chosen], self.areas[chosen]
        )


@dataclass(frozen=True, eq=False)
class WholeSystem:
    """min ½ xᵀ A x - bᵀ x + constant subject to lower ≤ x ≤ upper, distributed."""

    matrix: PETSc.Mat
    load: PETSc.Vec
    lower: PETSc.Vec
    upper: PETSc.Vec
    turn: PETSc.Mat | None
    """Q, u = Q x; None where no frame is turned."""
    constant: float
    """Energy of the prescribed displacements."""
    dimension: int
    points: Array  # (nodes, 3)
    """Nodes of this rank."""
    contact: Ints
    """Unknowns (local) with a bound."""
    area: Array  # (bounds,)
    """Share of the contact boundary's area of each of them; solvers do not use it."""
    checked: _Rows
    """The contact rows that are no bounds."""
    mesh: Any
    """dolfinx's mesh; the matrix uses its communicator."""

    @property
    def dofs(self) -> int:
        """Unknowns, held ones included."""
        return int(self.load.getSize())

    def energy(self, x: PETSc.Vec) -> float:
        """½ a(u, u) - l(u) (collective)."""
        return 0.5 * x.dot(self.matrix * x) - x.dot(self.load) + self.constant

    def penetration(self, x: PETSc.Vec) -> float:
        """Largest violation of a row, relative to the largest displacement (collective)."""
        violation = np.maximum(x.array - self.upper.array, self.lower.array - x.array)
        moved = self.displacement(x)[self.checked.nodes]
        excess = np.einsum("ni,ni->n", self.checked.directions, moved) - self.checked.gaps
        here = max(violation.max(initial=0.0), excess.max(initial=0.0))
        worst = self.load.comm.tompi4py().allreduce(here, op=MPI.MAX)
        return float(worst) / (x.norm(PETSc.NormType.NORM_INFINITY) or 1.0)

    def displacement(self, x: PETSc.Vec) -> Array:
        """u at this rank's nodes, (nodes, dimension) (collective)."""
        u = x if self.turn is None else self.turn * x
        return u.array.reshape(-1, self.dimension).copy()

    def force(self, x: PETSc.Vec) -> Array:
        """Magnitudes of contact forces, added at this rank's nodes, (nodes,) (collective)."""
        result = np.zeros(len(self.points))
        force = (self.load - self.matrix * x).array[self.contact]
        np.add.at(result, self.contact // self.dimension, np.abs(force))
        return result

    @property
    def areas(self) -> Array:
        """Area of the contact boundary at this rank's nodes, (nodes,)."""
        result = np.zeros(len(self.points))
        result[self.contact // self.dimension] = self.area
        return result


def assemble(
    scene: Scene, comm: MPI.Intracomm = MPI.COMM_WORLD, nodal: bool = False
) -> WholeSystem:
    """Mesh a scene of one body and assemble it undecomposed (collective).

    Parameters
    ----------
    nodal
        Bound the gaps at nodes also where this application bounds averages around vertices.

    Raises
    ------
    UnsuitableError
        More than one body, a temperature, or contact rows that are no bounds.
    """
    if len(scene.bodies) != 1:
        raise UnsuitableError(f"it has {len(scene.bodies)} bodies")
    body, d = scene.bodies[0], scene.dimension
    if scene.temperatures:
        raise UnsuitableError("it has a temperature")
    if body.mean_dilatation:
        raise UnsuitableError("its change of volume is a mean over cells")
    if scene.contacts and has_averaged_rows(body) and not nodal:
        raise UnsuitableError(
            "its contact rows are averages around vertices, no bounds on unknowns"
        )
    mesh = _mesh(body, comm)
    space = dolfinx_compat.vector_space(mesh, body.degree, d)
    matrix = assemble_matrix(dolfinx_compat.compile_form(_stiffness(scene, body, mesh, space)))
    matrix.assemble()
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    owned = space.dofmap.index_map.size_local
    points = space.tabulate_dof_coordinates()[:owned]
    load = _vector(comm, owned, d)
    load.array[:] = _load(scene, body, mesh, space)[: owned * d]
    surface = _surface(space)
    surface = surface[surface < owned]

    held = np.zeros((owned, d), bool)
    prescribed = np.zeros((owned, d))
    for condition in scene.displacements:
        nodes = surface[_on(body, condition.boundary, points[surface])]
        for component, value in enumerate(condition.values):
            if value is not None:
                held[nodes, component] = True
                prescribed[nodes, component] = value

    lower, upper = _vector(comm, owned, d), _vector(comm, owned, d)
    lower.set(PETSc.NINFINITY)
    upper.set(PETSc.INFINITY)
    bounds = lower.array.reshape(-1, d), upper.array.reshape(-1, d)
    rows = _contact_rows(scene, mesh, space, points, surface, held, prescribed)
    components, frames = _bounds(rows, owned, *bounds)
    bounding = components >= 0
    contact = rows.nodes[bounding] * d + components[bounding]
    constant = _eliminate(matrix, load, held, prescribed)
    turn = _turn(comm, frames)
    if turn is not None:
        matrix, turned = matrix.ptap(turn), load.duplicate()
        turn.multTranspose(load, turned)
        load = turned
        matrix.setBlockSize(d)
        matrix.setOption(PETSc.Mat.Option.SPD, True)
    matrix.setNearNullSpace(_near_null_space(points, d, load, frames))
    return WholeSystem(
        matrix, load, lower, upper, turn, constant, d, points, contact, rows.areas[bounding],
        rows.some(~bounding), mesh,
    )  # fmt: skip


def _mesh(body: Body, comm: MPI.Intracomm) -> Any:
    box = body.mesh
    if isinstance(box, CellMesh):
        shape = box.shape(2 if _curved(body) else 1)
        order = np.argsort(vtk_order(shape.cell, shape.degree))
        cells, points = (
            np.array_split(rows, comm.size)[comm.rank] for rows in (shape.cells, shape.points)
        )
        return dolfinx_compat.create_mesh(cells[:, order], points, box.cell, shape.degree, comm)
    assert isinstance(box, Box)
    corners = [np.array(box.lower), np.array(box.upper)]
    make = dmesh.create_box if len(box.cells) == 3 else dmesh.create_rectangle
    return make(comm, corners, list(box.cells), getattr(dmesh.CellType, box.cell))


def _curved(body: Body) -> bool:
    """Whether the mesh of a body, at its degree, has curved edges."""
    mesh = body.mesh
    return body.degree == 2 and isinstance(mesh, CellMesh) and mesh.middles is not None


def _stiffness(scene: Scene, body: Body, mesh: Any, space: Any) -> Any:
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    lam, mu = _moduli(scene, body, mesh)
    rule = quadrature_degree(body.mesh.cell, body.degree, _curved(body))
    strain = ufl.sym(ufl.grad(u))
    stress = lam * ufl.tr(strain) * ufl.Identity(scene.dimension) + 2.0 * mu * strain
    dx = ufl.dx(domain=mesh, metadata={"quadrature_degree": rule})
    return ufl.inner(stress, ufl.sym(ufl.grad(v))) * dx


def _moduli(scene: Scene, body: Body, mesh: Any) -> list[Any]:
    """λ and μ: constants, or functions that are constant on each cell."""
    moduli = np.array([material.lame(scene.plane) for material in body.materials])
    if len(moduli) == 1:
        return [fem.Constant(mesh, PETSc.ScalarType(m)) for m in moduli[0]]
    if not isinstance(body.mesh, CellMesh):
        raise UnsuitableError("it has several materials and no mesh file")
    count = mesh.topology.index_map(mesh.topology.dim).size_local
    tags = body.mesh.tags_at(dolfinx_compat.original_cells(mesh)[:count])
    values = []
    for modulus in moduli.T:
        function = fem.Function(dolfinx_compat.cellwise_scalars(mesh))
        function.x.array[:count] = modulus[tags]
        function.x.scatter_forward()
        values.append(function)
    return values


def _load(scene: Scene, body: Body, mesh: Any, space: Any) -> Array:
    """Load vector of the nodes of this rank: the sum of a vector for each load (collective)."""
    v, normal = ufl.TestFunction(space), ufl.FacetNormal(mesh)

    def constant(value: Any) -> Any:
        return fem.Constant(mesh, np.asarray(value, dtype=PETSc.ScalarType))

    forms = [ufl.inner(constant(np.zeros(scene.dimension)), v) * ufl.dx(domain=mesh)]
    forms += [ufl.inner(constant(f.vector), v) * ufl.dx(domain=mesh) for f in scene.forces]
    for traction in scene.tractions:
        forms.append(
            ufl.inner(constant(traction.vector), v) * _facets(body, mesh, traction.boundary)
        )
    for pressure in scene.pressures:
        push = -constant(pressure.value) * ufl.inner(normal, v)
        forms.append(push * _facets(body, mesh, pressure.boundary))
    for total in scene.total_loads:
        ds = _facets(body, mesh, total.boundary)
        forms.append(ufl.inner(_traction_of(total, mesh, ds), v) * ds)
    return np.sum([_assembled(form) for form in forms], axis=0)


def _traction_of(total: TotalLoad, mesh: Any, ds: Any) -> Any:
    """The traction, linear in position, that adds up to a force and a moment (collective).

    Its formula is in `contact_app.model.total_loads`.
    """
    d = mesh.geometry.dim
    place = ufl.SpatialCoordinate(mesh)

    def constant(value: Any) -> Any:
        return fem.Constant(mesh, np.asarray(value, dtype=PETSc.ScalarType))

    def integral(value: Any) -> float:
        form = dolfinx_compat.compile_form(constant(1.0) * value * ds)
        return float(np.real(mesh.comm.allreduce(fem.assemble_scalar(form))))

    area = integral(1.0)
    uniform = np.array(total.force) / area
    if not any(total.moment) and total.at is None:
        return constant(uniform)
    centre = np.zeros(3)
    centre[:d] = [integral(place[i]) / area for i in range(d)]
    away = [place[i] - constant(centre[i]) for i in range(d)]
    second = np.zeros((3, 3))
    second[:d, :d] = [[integral(a * b) for a in away] for b in away]
    force = np.array([*total.force, *(0.0,) * (3 - d)])
    arm = np.zeros(3) if total.at is None else np.array(total.at) - centre
    moment = np.array(total.moment) + np.cross(arm, force)
    turn = np.linalg.lstsq(np.trace(second) * np.eye(3) - second, moment, rcond=None)[0]
    turned = ufl.cross(constant(turn), ufl.as_vector([*away, *([0.0] * (3 - d))]))
    return constant(uniform) + ufl.as_vector([turned[i] for i in range(d)])


def _facets(body: Body, mesh: Any, boundary: str) -> Any:
    """Measure on the surface facets all of whose vertices are on a boundary."""
    dimension = mesh.topology.dim - 1
    facets = dmesh.locate_entities_boundary(
        mesh, dimension, lambda x: _on(body, boundary, np.ascontiguousarray(x.T))
    )
    tags = dolfinx_compat.meshtags(mesh, dimension, facets, 1)
    return ufl.Measure("ds", domain=mesh, subdomain_data=tags)(1)


def _on(body: Body, boundary: str, points: Array) -> Mask:
    """Whether each of points (n, 3) lies on a boundary."""
    if boundary in body.boundaries:
        return np.asarray(body.boundaries[boundary](points), bool)
    box = body.mesh
    extent = max(b - a for a, b in zip(box.lower, box.upper, strict=True))
    if isinstance(box, CellMesh):
        shape = box.shape(body.degree)
        nodes = np.unique(shape.topology.facets[shape.sides[boundary]])
        away, _ = cKDTree(shape.points[nodes]).query(points[:, : shape.dimension])
        return np.asarray(away < 1e-9 * extent)
    axis = "xyz".index(boundary[0])
    side = (box.lower if boundary[1] == "-" else box.upper)[axis]
    return np.abs(points[:, axis] - side) < 1e-9 * extent


def _surface(space: Any) -> Ints:
    """Nodes (local) on the surface."""
    mesh = space.mesh
    dimension = mesh.topology.dim
    mesh.topology.create_connectivity(dimension - 1, dimension)
    facets = dmesh.exterior_facet_indices(mesh.topology)
    return np.unique(fem.locate_dofs_topological(space, dimension - 1, facets)).astype(np.int64)


def _vector(comm: MPI.Intracomm, owned: int, d: int) -> PETSc.Vec:
    return PETSc.Vec().createMPI((owned * d, PETSc.DETERMINE), bsize=d, comm=comm)


def _assembled(form: Any) -> Array:
    vector = assemble_vector(dolfinx_compat.compile_form(form))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    values = vector.array.copy()
    vector.destroy()
    return values


def _contact_rows(
    scene: Scene, mesh: Any, space: Any, points: Array, surface: Ints, held: Mask, prescribed: Array
) -> _Rows:
    """The contact rows of all nodes of this rank (collective)."""
    d, body, parts = scene.dimension, scene.bodies[0], list[_Rows]()
    for contact in scene.contacts:
        nodes = surface[_on(body, contact.boundary, points[surface])]
        gap, normal = contact.gap_and_normal(points[nodes])
        row = -normal[:, :d]
        gap = gap - np.einsum("ni,ni->n", row, np.where(held[nodes], prescribed[nodes], 0.0))
        row = np.where(held[nodes], 0.0, row)
        length = np.linalg.norm(row, axis=1)
        free = length > 1e-9
        first = ufl.as_vector([1.0] + [0.0] * (d - 1))
        form = ufl.inner(first, ufl.TestFunction(space)) * _facets(body, mesh, contact.boundary)
        area = _assembled(form)[::d][nodes]
        nodes, row, gap, area, length = (v[free] for v in (nodes, row, gap, area, length))
        parts.append(_Rows(nodes, row / length[:, None], gap / length, area))
    return _Rows.joined(parts, d)


INDEPENDENT = 0.1
"""Least length of a bound outside of the span of nearer bounds of its node."""


def _bounds(rows: _Rows, owned: int, lower: Array, upper: Array) -> tuple[Ints, Array]:
    """Write the bounds.

    Returns
    -------
    components : (rows,)
        Bounded component of the node in its frame; -1 for rows that are no bound.
    frames : (owned, d, d)
        N of each node.
    """
    d = rows.directions.shape[1]
    frames = np.tile(np.eye(d), (owned, 1, 1))
    components = np.full(len(rows.nodes), -1)
    count = np.bincount(rows.nodes, minlength=owned)
    for r in np.argsort(rows.gaps, kind="stable"):
        node, n, gap = rows.nodes[r], rows.directions[r], rows.gaps[r]
        if count[node] == 1:
            k = int(np.abs(n).argmax())
            sign = np.sign(n[k])
            frames[node] = _reflection(sign * n, k)
        else:
            used = components[(rows.nodes == node) & (components >= 0)]
            taken = np.linalg.qr(frames[node][used].T)[0]
            if np.linalg.norm(n - taken @ (taken.T @ n)) < INDEPENDENT:
                continue
            # the component of n in the present frame that no nearer row has
            share = np.abs(np.linalg.solve(frames[node].T, n))
            share[used] = 0.0
            k, sign = int(share.argmax()), 1.0
            frames[node, k] = n
        components[r] = k
        (upper if sign > 0.0 else lower)[node, k] = sign * gap
    return components, frames


def _reflection(n: Array, k: int) -> Array:
    """The Householder reflection that takes e_k to n, of length one, (d, d)."""
    v = -n
    v[k] += 1.0
    square = float(v @ v)
    return np.eye(len(n)) - np.outer(v, v) * (2.0 / square if square > 1e-28 else 0.0)


def _eliminate(matrix: PETSc.Mat, load: PETSc.Vec, held: Mask, prescribed: Array) -> float:
    """Make held unknowns rows of a scaled identity; return the energy of their displacement."""
    comm = load.comm.tompi4py()
    diagonal = matrix.getDiagonal()
    scale = diagonal.sum() / diagonal.getSize()
    original = load.duplicate()
    original.array[:] = np.where(held, prescribed, 0.0).ravel()
    constant = 0.0
    if comm.allreduce(float(np.abs(original.array).sum())):
        constant = 0.5 * original.dot(matrix * original) - original.dot(load)
        constant += 0.5 * scale * original.dot(original)
    rows = np.flatnonzero(held.ravel()) + load.getOwnershipRange()[0]
    matrix.zeroRowsColumns(rows.astype(PETSc.IntType), diag=scale, x=original, b=load)
    return float(constant)


def _turn(comm: MPI.Intracomm, frames: Array) -> PETSc.Mat | None:
    """Q, whose blocks are the inverses of the frames N; None where no frame is turned."""
    owned, d = frames.shape[:2]
    if not comm.allreduce(int((frames != np.eye(d)).any())):
        return None
    first = comm.exscan(owned) or 0
    columns = (first + np.arange(owned))[:, None, None] * d + np.arange(d)
    indices = np.broadcast_to(columns, (owned, d, d)).ravel().astype(PETSc.IntType)
    indptr = (np.arange(owned * d + 1) * d).astype(PETSc.IntType)
    size = (owned * d, PETSc.DETERMINE)
    blocks = np.linalg.inv(frames)
    matrix = PETSc.Mat().createAIJ(
        (size, size), bsize=d, csr=(indptr, indices, blocks.ravel()), comm=comm
    )
    matrix.assemble()
    return matrix


def _near_null_space(points: Array, d: int, like: PETSc.Vec, frames: Array) -> PETSc.NullSpace:
    """The rigid motions, orthonormal, in the turned frames."""
    comm = like.comm.tompi4py()
    centre = comm.allreduce(points.sum(axis=0)) / comm.allreduce(len(points))
    length = float(comm.allreduce(np.abs(points - centre).max(initial=0.0), op=MPI.MAX)) or 1.0
    motions = rigid_motions(points, d, centre, length).reshape(len(points) * d, -1)
    basis: list[PETSc.Vec] = []
    for motion in motions.T:
        vector = like.duplicate()
        vector.array[:] = np.einsum("nij,nj->ni", frames, motion.reshape(-1, d)).ravel()
        for earlier in basis:
            vector.axpy(-earlier.dot(vector), earlier)
        vector.normalize()
        basis.append(vector)
    return PETSc.NullSpace().create(vectors=basis, comm=comm)
