"""The undecomposed problem: subdomains put together at the nodes that they share.

    min ½ uᵀ K u - fᵀ u  subject to  C u ≤ c on contact rows, C u = c on tied rows.

Tangential rows of points with friction are among them, too. Rows that hold a rigid motion hold with
equality. There are no gluing rows. Held unknowns have their prescribed displacement, and their rows
and columns of K are those of a scaled identity. C consists of the remaining rows of B with their
scaling, so that B and C have the same multipliers. Unknowns of rigid bodies have no stiffness
(`solver.primal.rigid_bodies`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from solver.backend import Turn
from solver.contact.row_kinds import RowKind
from solver.distributed import lent, local_rows, petsc_rows
from solver.primal.merged_nodes import MergedNodes
from solver.primal.products import chosen_rows, multiply_transposed, set_diagonal
from solver.problem.decomposed import DecomposedProblem
from solver.rigid_motions import rigid_motions
from solver.vectors import Array, Ints, Mask, largest_magnitude


@dataclass(frozen=True, eq=False)
class MergedSystem:
    """The undecomposed problem; local parts throughout."""

    problem: DecomposedProblem
    nodes: MergedNodes
    K: PETSc.Mat
    """Stiffness with the held unknowns taken out."""
    C: PETSc.Mat
    """All rows but those of gluing and held unknowns, (rows, unknowns)."""
    c: Array  # (rows,)
    """Right-hand side of these."""
    rows: Ints  # (rows,)
    """Numbers of these rows in B."""
    load: Array  # (unknowns,)
    """f - K u_held, and K u_held on held unknowns."""
    held: Mask  # (unknowns,)
    """Mask of the held unknowns."""
    stiffless: Mask  # (unknowns,)
    """Mask of the unknowns of rigid bodies without held ones. They come last."""
    rigid: Array  # (unknowns, motions)
    """The rigid motions of all bodies, each about its middle."""
    body: Ints  # (unknowns,)
    places: Ints  # (interface,)
    """Place of each interface unknown among the unknowns of this rank's distinct nodes."""
    scatter: PETSc.Scatter
    angles: Array  # (rows,)
    """Angle by which the frame of a tangential row is turned in its plane; zero for other rows."""
    support: PETSc.Mat  # (held, unknowns)
    """The rows of K of held unknowns, before these are eliminated."""

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""
        return self.problem.comm

    @property
    def size(self) -> int:
        """Unknowns of this rank."""
        return len(self.load)

    @cached_property
    def diagonal(self) -> Array:
        """Diagonal of K, with its largest entry on unknowns of rigid bodies."""
        diagonal = np.asarray(self.K.getDiagonal().getArray())
        top = self.comm.allreduce(float(diagonal.max(initial=0.0)), op=MPI.MAX)
        return np.where(self.stiffless, top, diagonal)

    @cached_property
    def flexibility(self) -> Array:
        """One over the diagonal of K; zero on unknowns of rigid bodies, (unknowns,)."""
        return np.where(self.stiffless, 0.0, 1.0 / self.diagonal)

    @cached_property
    def has_rigid_bodies(self) -> bool:
        """Whether any rank has unknowns of rigid bodies (collective at the first call)."""
        return bool(self.comm.allreduce(int(self.stiffless.any())))

    @cached_property
    def _of_bodies(self) -> list[Ints]:
        """The unknowns of each body."""
        order = np.argsort(self.body, kind="stable")
        ends = np.searchsorted(self.body[order], np.arange(1, self.problem.bodies.count))
        return np.split(order, ends)

    def largest_in_bodies(self, u: Array) -> Array:
        """Largest magnitude of u (unknowns,) in each body on this rank, (bodies,)."""
        return np.array([np.abs(u[of_body]).max(initial=0.0) for of_body in self._of_bodies])

    @property
    def at_rest(self) -> Array:
        """The displacements of held unknowns, zero elsewhere, (unknowns,)."""
        return np.where(self.held, self.load / self.diagonal, 0.0)

    @cached_property
    def _of_held(self) -> tuple[Array, float]:
        """K_fh u_h (unknowns,), and u_hᵀ K_hh u_h on this rank, of held displacements (collective).

        Both are zero where these are.
        """
        if not self.comm.allreduce(int(self.at_rest.any())):
            return np.zeros(self.size), 0.0
        moves = self.on_subdomains(self.at_rest)
        forces = [c.stiffness @ u for c, u in zip(self.problem.classes, moves, strict=True)]
        work = sum(float(np.vdot(u, f)) for u, f in zip(moves, forces, strict=True))
        return np.where(self.held, 0.0, self.summed(forces)), work

    def strained(self, u: Array, left: Array) -> float:
        """a(u, u) = u_f (f - r) + 2 u_f K_fh u_h + u_h K_hh u_h (collective).

        f is the load without K_fh u_h, and r = f - K u is given.
        """
        coupling, work = self._of_held
        work += float(np.sum(np.where(self.held, 0.0, u * (self.load - left))))
        work += 2.0 * float(u @ coupling)
        return max(float(self.comm.allreduce(work)), 0.0)

    @cached_property
    def means(self) -> Mask:
        """Rows that hold a rigid motion in the mean over many nodes, (rows,)."""
        return self.problem.means[self.rows]

    @cached_property
    def equality(self) -> Mask:
        """Rows that always hold with equality, (rows,)."""
        return ~self.problem.conditional[self.rows]

    @cached_property
    def normal(self) -> Mask:
        """Contact rows, (rows,)."""
        return self.problem.inequality[self.rows]

    def under(self, problem: DecomposedProblem) -> "MergedSystem":
        """The system under the loads, held values and gaps of an equal problem (collective)."""
        loaded = replace(self, problem=problem, c=problem.c[self.rows])
        _, values = _held(problem, self.nodes, self.scatter, self.places, self.size)
        return replace(loaded, load=_load(loaded, values))

    def turned(self, turn: Turn) -> "MergedSystem":
        """The problem in turned tangential frames."""
        place = np.full(self.problem.size, -1, np.int64)
        place[self.rows] = np.arange(len(self.rows))
        of_rows = replace(turn, first=place[turn.first], second=place[turn.second])
        local = sparse.csr_matrix(of_rows.matrix(len(self.rows)) @ local_rows(self.C))
        local.sort_indices()
        angles = np.zeros(len(self.rows))
        angles[of_rows.first] = np.arctan2(turn.sine, turn.cosine)
        angles[of_rows.second] = -angles[of_rows.first]
        C = petsc_rows(self.comm, local, self.size)
        return replace(self, C=C, c=of_rows.turned(self.c), angles=angles)

    def on_all_rows(self, values: Array) -> Array:
        """Values of contact and tied rows (rows,) among those of all rows, (dual,)."""
        result = np.zeros(self.problem.size)
        result[self.rows] = values
        return result

    def summed(self, parts: Sequence[Array]) -> Array:
        """Vectors (n, members) of each class summed over all copies, (unknowns,) (collective)."""
        d = self.problem.dimension
        here = np.zeros(len(self.nodes.numbers) * d)
        for values, at in zip(parts, self.nodes.copies, strict=True):
            here += _summed(values, at, self.nodes, d)
        return _to_owners(self.comm, self.scatter, here, self.size)

    def from_subdomains(self, parts: Sequence[Array]) -> Array:
        """Mean over the copies of displacements (n, members) of each class, (unknowns,).

        Held unknowns have their displacement under the loads of this problem (collective).
        """
        copies = self.summed([np.ones_like(values) for values in parts])
        return np.where(self.held, self.at_rest, self.summed(parts) / copies)

    def at_copies(self, values: Array) -> Array:
        """Values of owned unknowns at this rank's distinct nodes (collective)."""
        total = len(self.nodes.numbers) * self.problem.dimension
        return _to_copies(self.comm, self.scatter, values, total)

    def on_subdomains(self, u: Array) -> list[Array]:
        """Displacements of all copies, (n, members) of each class (collective)."""
        d = self.problem.dimension
        here = self.at_copies(u)
        return [np.asfortranarray(here[self.nodes.unknowns(at, d)].T) for at in self.nodes.copies]


def merge(problem: DecomposedProblem) -> MergedSystem:
    """Put the subdomains of an unfactored problem together (collective)."""
    comm, d = problem.comm, problem.dimension
    nodes = MergedNodes(problem)
    size = nodes.count * d
    numbers = nodes.unknowns(nodes.numbers, d)
    scatter = _scatter(comm, numbers, size)
    places = _interface_places(problem, nodes)
    K = _stiffness(problem, nodes)
    held, values = _held(problem, nodes, scatter, places, size)
    body = np.repeat(nodes.at_owners(nodes.body[nodes.first_here]), d)
    rigid = _rigid(problem, nodes)
    stiffless = problem.bodies.rigid[body] & ~held
    support = chosen_rows(K, np.flatnonzero(held))
    _eliminate(comm, K, held | stiffless)
    set_diagonal(K, stiffless, 0.0)
    K.setOption(PETSc.Mat.Option.SPD, True)
    kinds = problem.kinds
    bound = RowKind.GLUING, RowKind.DIRICHLET
    rows = np.flatnonzero(~np.isin(kinds, bound))
    C = _renamed(comm, problem.B.local[rows], numbers[places], size)
    system = MergedSystem(
        problem, nodes, K, C, problem.c[rows], rows, np.zeros(size), held, stiffless, rigid, body,
        places, scatter, np.zeros(len(rows)), support,
    )  # fmt: skip
    return replace(system, load=_load(system, values))


def _load(system: MergedSystem, values: Array) -> Array:
    """f - K u_held, and K u_held on held unknowns, for their displacements (collective)."""
    problem, held = system.problem, system.held
    load = system.summed(problem.forces)
    lifted = multiply_transposed(system.support, values[held])
    free = load - np.where(system.stiffless, 0.0, lifted)
    return np.where(held, system.diagonal * values, free)


def _scatter(comm: MPI.Intracomm, numbers: Ints, size: int) -> PETSc.Scatter:
    """Scatter from owned unknowns to the unknowns of this rank's distinct nodes."""
    owned = PETSc.Vec().createMPI((size, PETSc.DETERMINE), comm=comm)
    local = PETSc.Vec().createSeq(len(numbers))
    places = PETSc.IS().createGeneral(numbers.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    return PETSc.Scatter().create(owned, places, local, None)


def _to_copies(comm: MPI.Intracomm, scatter: PETSc.Scatter, values: Array, size: int) -> Array:
    """Values of owned unknowns on this rank's distinct nodes, (size,)."""
    out = np.empty(size)
    local = PETSc.Vec().createWithArray(out, comm=PETSc.COMM_SELF)
    with lent(comm, np.ascontiguousarray(values)) as (owned,):
        scatter.scatter(owned, local, mode=PETSc.ScatterMode.FORWARD)
    local.destroy()
    return out


def _to_owners(comm: MPI.Intracomm, scatter: PETSc.Scatter, values: Array, size: int) -> Array:
    """Sums over all ranks of values on their distinct nodes, at the owners, (size,)."""
    out = np.zeros(size)
    local = PETSc.Vec().createWithArray(np.ascontiguousarray(values), comm=PETSc.COMM_SELF)
    with lent(comm, out) as (owned,):
        scatter.scatter(
            local, owned, addv=PETSc.InsertMode.ADD_VALUES, mode=PETSc.ScatterMode.REVERSE
        )
    local.destroy()
    return out


def _summed(values: Array, copies: Ints, nodes: MergedNodes, d: int) -> Array:
    """Values (n, members) of a class summed at this rank's distinct nodes."""
    places = nodes.unknowns(copies, d)
    total = len(nodes.numbers) * d
    return np.bincount(places.ravel(), values.T.ravel(), total).astype(np.float64)


def _stiffness(problem: DecomposedProblem, nodes: MergedNodes) -> PETSc.Mat:
    """K of all unknowns (collective).

    PETSc adds the rows of ranks that share nodes. Others come to their owners as they are, in half
    the time.
    """
    comm, d = problem.comm, problem.dimension
    local = _local_stiffness(problem, nodes, len(nodes.numbers) * d)
    local.sort_indices()
    size = (nodes.count * d, PETSc.DETERMINE)
    if not nodes.shared:
        total, first = comm.allreduce(nodes.count * d), d * nodes.numbers[:1].sum()
        shifted = (local.data, local.indices + first, local.indptr)
        rows = nodes.at_owners(sparse.csr_matrix(shifted, (local.shape[0], total)), d)
        K = PETSc.Mat().createAIJ((size, size), csr=_of_petsc(rows), comm=comm)
        K.setBlockSize(d)
        return K
    owned = PETSc.Mat().createAIJ(local.shape, csr=_of_petsc(local), comm=PETSc.COMM_SELF)
    where = PETSc.LGMap().create(nodes.numbers.astype(PETSc.IntType), bsize=d, comm=comm)
    torn = PETSc.Mat().createIS((size, size), lgmapr=where, lgmapc=where, comm=comm)
    torn.setBlockSize(d)
    torn.setISLocalMat(owned)
    torn.assemble()
    K = torn.convert("aij", PETSc.Mat())
    K.setBlockSize(d)
    torn.destroy()
    return K


def _of_petsc(local: sparse.csr_matrix) -> tuple[Ints, Ints, Array]:
    """The arrays of a matrix in PETSc's types."""
    begins, places = (part.astype(PETSc.IntType) for part in (local.indptr, local.indices))
    return begins, places, local.data


def _local_stiffness(
    problem: DecomposedProblem, nodes: MergedNodes, total: int
) -> sparse.csr_matrix:
    """The sum of this rank's stiffness matrices on its distinct nodes."""
    d, blocks, places = problem.dimension, [], []
    for cls, at in zip(problem.classes, nodes.copies, strict=True):
        for member in at:
            stiffness = cls.stiffness  # that of a rigid body is zero: its diagonal is set later
            blocks.append(sparse.identity(cls.unknowns, format="csr") if cls.rigid else stiffness)
            places.append(nodes.unknowns(member, d))
    where = np.concatenate([np.zeros(0, np.int64), *places])
    if len(where) == total > 0:  # subdomains share no nodes
        return _on_diagonal(blocks)
    joined = sparse.block_diag(blocks, format="csr")
    pick = sparse.csr_matrix(
        (np.ones(len(where)), where, np.arange(len(where) + 1)), shape=(len(where), total)
    )
    return sparse.csr_matrix(pick.T @ joined @ pick)


def _on_diagonal(blocks: Sequence[sparse.csr_matrix]) -> sparse.csr_matrix:
    """The blocks on the diagonal of one matrix, in a fraction of the time of SciPy's function."""
    if len(blocks) == 1:
        return blocks[0]
    sizes = [block.shape[0] for block in blocks]
    first = np.cumsum([0, *sizes])
    places = np.concatenate(
        [np.int32(start) + block.indices for start, block in zip(first, blocks, strict=False)]
    )
    values = np.concatenate([block.data for block in blocks])
    begins = np.cumsum([0, *np.concatenate([np.diff(block.indptr) for block in blocks])])
    return sparse.csr_matrix((values, places, begins), shape=(first[-1], first[-1]))


def _interface_places(problem: DecomposedProblem, nodes: MergedNodes) -> Ints:
    """Places of the interface unknowns among the unknowns of distinct nodes, (interface,)."""
    places = [
        nodes.unknowns(at, problem.dimension)[:, cls.interface].ravel()
        for cls, at in zip(problem.classes, nodes.copies, strict=True)
    ]
    return np.concatenate([np.zeros(0, np.int64), *places])


def _renamed(comm: MPI.Intracomm, rows: sparse.csr_matrix, columns: Ints, size: int) -> PETSc.Mat:
    """Rows of B on the merged unknowns, by renumbering of columns (collective).

    PETSc's product on two ranks takes a second on a part of 50,000 unknowns.
    """
    every = np.concatenate(comm.allgather(columns))
    local = sparse.csr_matrix(
        (rows.data, every[rows.indices], rows.indptr), (rows.shape[0], comm.allreduce(size))
    )
    local.sum_duplicates()
    return petsc_rows(comm, local, size)


def _held(
    problem: DecomposedProblem,
    nodes: MergedNodes,
    scatter: PETSc.Scatter,
    places: Ints,
    size: int,
) -> tuple[Mask, Array]:
    """Mask of the owned held unknowns, and their displacements, (size,) each (collective)."""
    comm, d = problem.comm, problem.dimension
    times, sums = np.zeros((2, len(nodes.numbers) * d))
    for cls, lift, at in zip(problem.classes, problem.lifting, nodes.copies, strict=True):
        mask = np.ones(cls.unknowns)
        mask[cls.free] = 0.0
        times += _summed(np.repeat(mask[:, None], cls.members, axis=1), at, nodes, d)
        sums += _summed(mask[:, None] * lift, at, nodes, d)
    counts, values = (_to_owners(comm, scatter, v, size) for v in (times, sums))
    fixed = problem.kinds == RowKind.DIRICHLET
    for total, of_rows in ((counts, np.ones(problem.size)), (values, problem.c)):
        interface = problem.constraint_forces(np.where(fixed, of_rows, 0.0))
        here = np.bincount(places, interface, len(nodes.numbers) * d).astype(np.float64)
        total += _to_owners(comm, scatter, here, size)
    held = counts > 0.5
    return held, np.divide(values, counts, out=np.zeros(size), where=held)


def _rigid(problem: DecomposedProblem, nodes: MergedNodes) -> Array:
    """Rigid motions of all points about the middle of each body, (unknowns, k) (collective)."""
    comm, d = problem.comm, problem.dimension
    points, of = (nodes.at_owners(of[nodes.first_here]) for of in (nodes.points, nodes.body))
    sums = np.zeros((problem.bodies.count, 4))
    np.add.at(sums, of, np.column_stack([points, np.ones(len(points))]))
    sums = comm.allreduce(sums)
    centres = sums[:, :3] / np.maximum(sums[:, 3:], 1.0)
    about = points - centres[of]
    length = largest_magnitude(comm, about) or 1.0
    motions = rigid_motions(about, d, np.zeros(3), length).reshape(len(points) * d, -1)
    for body in np.unique(of[problem.bodies.rigid[of]]):  # its unknowns are its motions
        unknowns = np.flatnonzero(np.repeat(of == body, d))
        motions[unknowns] = np.eye(len(unknowns), motions.shape[1])
    return motions


def _eliminate(comm: MPI.Intracomm, K: PETSc.Mat, held: Mask) -> None:
    """Leave the largest diagonal entry alone in the rows and columns of unknowns (collective)."""
    stiff = float(np.abs(K.getDiagonal().getArray()).max(initial=0.0))
    first = K.getOwnershipRange()[0]
    rows = (first + np.flatnonzero(held)).astype(PETSc.IntType)
    K.zeroRowsColumns(rows, diag=comm.allreduce(stiff, op=MPI.MAX))


def bodies_alone(system: MergedSystem, values: Array) -> Array:
    """Sums of values (unknowns,) by body, (bodies,) (collective)."""
    count = system.problem.bodies.count
    return np.asarray(system.comm.allreduce(np.bincount(system.body, values, count)))
