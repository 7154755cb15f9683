"""The natural coarse space: G = Rᵀ Bᵀ, its factor and the projectors Q and P = I - Q.

Gλ = e says that every floating subdomain is in equilibrium under its load and the multipliers.
With positive weights W of the rows,

    Q = W Gᵀ (G W Gᵀ)⁻¹ G

projects onto the range of W Gᵀ, P = I - Q onto the kernel of G (C. Farhat, K. Pierson, M. Lesoinne,
*The second generation FETI methods and their application to the parallel solution of large-scale
linear and geometrically non-linear structural analysis problems*, 2000).

W = I makes Q symmetric. As an equality constraint of the dual problem it then serves as the matrix
C: with C = Cᵀ = C² the rows are orthonormal, the penalty product Cᵀ C x is one projection, and
‖C x‖ measures ‖G x‖ in a norm that does not depend on the scaling of R. Conjugate gradients on an
active set need no symmetric projector: there `cross_points` chooses W so that G W Gᵀ has blocks
between subdomains with a common face alone, a third of the blocks of G Gᵀ.
"""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from weakref import finalize

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from solver.distributed import petsc_rows
from solver.exchange import NodeExchange
from solver.factors import compute_factor
from solver.problem.constraints.matrix import ConstraintMatrix
from solver.tfeti.coarse.gram import Blocks, KernelRows
from solver.tfeti.constraints.options import TotalFetiOptions
from solver.vectors import Array, Mask, largest_magnitude, on_arrays

VANISHING = 1e-13
"""Largest entry of a block of G W Gᵀ, over that of the matrix, up to which the block is zero."""

IDEMPOTENT = 1e-8
"""Relative difference of Q Q and Q above which a coarse problem counts as singular."""

RESISTED = 1e-8
"""Resistance of the rows to the rigid motion that they resist least, over that to any motion, up to
which a coarse problem counts as singular: its square is a rounding error of G Gᵀ."""


class CoarseProblem:
    """G, the factor of G Gᵀ and the projectors; vectors are local parts of distributed ones.

    G is applied as Rᵀ times Bᵀ; a sparse matrix G, with twelve entries a row, would take several
    times longer. The factor is computed at its first use.

    Parameters
    ----------
    B : (dual, interface)
        Constraint matrix on interface unknowns.
    kernels : one (members, (m, k) array) pair for each class
        Kernel on the m interface unknowns of the class. B has m columns for each member, one after
        the other.
    inequality : (dual,)
        Contact and tangential rows, whose weights `weighted` may change.
    metric : (dual,)
        W of the problems that `weighted` makes, one on contact rows; in this one W = I.
    """

    def __init__(
        self,
        B: ConstraintMatrix,
        kernels: Sequence[tuple[int, Array]],
        inequality: Mask,
        metric: Array,
        options: TotalFetiOptions | None = None,
    ) -> None:
        self.options = options = options or TotalFetiOptions()
        self.comm = B.comm
        self.B = B
        self.size = B.rows
        self.kernels = sum(members * R.shape[1] for members, R in kernels)
        self.metric = metric
        self._kernels = kernels
        self._layout = _Layout(self.comm, self.kernels, options.gathered)
        self._inequality = inequality
        rows = KernelRows(B, kernels, options.chunk)
        self._contact = list(rows.row_groups(np.flatnonzero(inequality)))
        self._weighed = self._gram(rows, metric)
        self._oblique = False
        self._own_factor: CoarseFactor | None = None  # of G W Gᵀ; else that of G Gᵀ
        self._spare: list[CoarseFactor] = []
        self._product = _Restriction(B, kernels, self._layout, metric)
        self._coarse = np.empty(self._layout.rows)
        self._solution = np.empty(self._layout.rows)

    def _gram(self, rows: KernelRows, metric: Array) -> "_Gram":
        """G W Gᵀ without its contact rows, which are added from `_contact` (collective)."""
        single = np.flatnonzero(~self._inequality)
        groups = rows.row_groups(single, np.sqrt(metric))
        others = self._layout.collected(Blocks.of(groups, rows.motions))
        others = others.without(VANISHING * largest_magnitude(self.comm, others.values))
        places = Blocks.of(self._contact, rows.motions, np.zeros(self.size))
        others = Blocks.join([others, self._layout.collected(places)]).summed()
        return _Gram(others, self._layout.places(others))

    @property
    def factor(self) -> "CoarseFactor":
        """The factor of G W Gᵀ, computed at the first call."""
        if self._own_factor is not None:
            return self._own_factor
        return self._symmetric

    @cached_property
    def _symmetric(self) -> "CoarseFactor":
        """The factor of G Gᵀ."""
        one = np.ones(self.size)
        rows = KernelRows(self.B, self._kernels, self.options.chunk)
        return self._factored(self._gram(rows, one), one)

    @property
    def entries(self) -> int:
        """Stored entries of G W Gᵀ, over all ranks."""
        return self.factor.entries

    def weighted(self, weights: Array) -> "CoarseProblem":
        """The coarse problem of the rows of B times weights, with W the metric.

        Its factor is stored in that of an earlier coarse problem that is no longer in use.

        Parameters
        ----------
        weights : (dual,)
            Weights; one except on contact rows.

        Raises
        ------
        ArithmeticError
            Its G W Gᵀ is singular: all rows with a weight vanish on some rigid motion.
        """
        result = copy(self)
        result._oblique, result._product = True, self._product.weighted(weights)
        factor = self._spare.pop() if self._spare else None
        factor = self._factored(self._weighed, weights**2, factor)
        result._own_factor = factor
        if self._layout.of_factor.size == 1:  # ranks may drop their references at different times
            finalize(result, self._spare.append, factor)
        return result

    def turned(self, B: ConstraintMatrix) -> "CoarseProblem":
        """The coarse problem of B with turned tangential frames: rows that `weighted` may weigh."""
        result = copy(self)
        result.B = B
        rows = KernelRows(B, self._kernels, self.options.chunk)
        result._contact = list(rows.row_groups(np.flatnonzero(self._inequality)))
        result._product = _Restriction(B, self._kernels, self._layout, self.metric)
        return result

    def _factored(
        self, gram: "_Gram", weights: Array, factor: "CoarseFactor | None" = None
    ) -> "CoarseFactor":
        """The factor for some weights of contact rows; it replaces one of the same pattern."""
        contact = Blocks.of(self._contact, gram.others.motions, weights)
        values = gram.others.plus(self._layout.collected(contact)).values
        factor = factor or CoarseFactor(self._layout, gram.places)
        factor.take(values.ravel())
        return factor

    def solve(self, rhs: Array, out: Array) -> None:
        """(G W Gᵀ)⁻¹ times a coarse vector."""
        self.factor.solve(self._layout.spread(rhs), self._solution)
        out[:] = self._solution[self._layout.of_rank]

    def restrict(self, dual: Array, out: Array) -> None:
        """G times a dual vector."""
        self._product.restrict(dual, self._coarse, metric=False)
        out[:] = self._coarse[self._layout.of_rank]

    def extend(self, coarse: Array, out: Array) -> None:
        """Gᵀ times a coarse vector."""
        self._product.extend(self._layout.spread(coarse), out, metric=False)

    def least_multiplier(self, coarse: Array, out: Array) -> None:
        """W Gᵀ (G W Gᵀ)⁻¹ times a coarse vector e: the smallest multipliers with G λ = e."""
        self.factor.solve(self._layout.spread(coarse), self._solution)
        self._product.extend(self._solution, out, self._oblique)

    def coefficients(self, dual: Array) -> Array:
        """(G W Gᵀ)⁻¹ G W times a dual vector: the α whose Gᵀ α is closest to it."""
        return self._solved(dual, self._oblique)[self._layout.of_rank].copy()

    def apply(self, x: Array, out: Array) -> None:
        """Q x."""
        self._product.extend(self._solved(x, False), out, self._oblique)

    def apply_transpose(self, x: Array, out: Array) -> None:
        """Qᵀ x."""
        self._product.extend(self._solved(x, self._oblique), out, metric=False)

    def project(self, x: Array, out: Array) -> None:
        """P x = x - Q x; `out` may be `x`."""
        motions = self._solved(x, False)
        if out is not x:
            np.copyto(out, x)
        self._product.remove(motions, out, self._oblique)

    def project_transpose(self, x: Array, out: Array) -> None:
        """Pᵀ x = x - Qᵀ x; `out` may be `x`."""
        motions = self._solved(x, self._oblique)
        if out is not x:
            np.copyto(out, x)
        self._product.remove(motions, out, metric=False)

    def is_regular(self, probe: Array) -> bool:
        """Whether G W Gᵀ is regular, which its factor may not show (collective).

        Then Q is a projection, and the rows resist every motion by more than rounding errors.

        Parameters
        ----------
        probe : (dual,)
            Vector to which Q is applied twice.
        """
        projected, again = np.empty_like(probe), np.empty_like(probe)
        self.apply(probe, projected)
        self.apply(projected, again)
        size, error = (largest_magnitude(self.comm, v) for v in (projected, again - projected))
        return error <= IDEMPOTENT * size and self._least_resistance() > RESISTED

    def _least_resistance(self) -> float:
        """Norm of Gᵀ z for the motion z that is resisted least, over that for any motion.

        One step of the inverse iteration for G W Gᵀ turns any vector towards z (collective).
        """
        any_motion = np.cos(np.arange(1.0, self.kernels + 1.0))
        least, rows = np.empty_like(any_motion), np.empty(self.size)
        self.solve(any_motion, least)
        resistance = []
        for motion in (any_motion, least):
            self.extend(motion, rows)
            forces, size = self.comm.allreduce(np.array([rows @ rows, motion @ motion]))
            resistance.append(math.sqrt(forces / size) if size > 0.0 else 1.0)
        return resistance[1] / (resistance[0] or 1.0)

    def _solved(self, dual: Array, metric: bool) -> Array:
        """(G W Gᵀ)⁻¹ times G (or G W) times a dual vector; the next call overwrites the result."""
        self._product.restrict(dual, self._coarse, metric)
        self.factor.solve(self._coarse, self._solution)
        return self._solution


@dataclass(frozen=True, eq=False)
class _Gram:
    """G W Gᵀ with zeros for contact rows, and the places of the entries of a matrix."""

    others: Blocks
    places: sparse.csr_matrix


class _Layout:
    """Distribution of G Gᵀ: whole on every rank up to `gathered` unknowns, otherwise by rows.

    Parameters
    ----------
    kernels
        Coarse unknowns of this rank.
    """

    def __init__(self, comm: MPI.Intracomm, kernels: int, gathered: int) -> None:
        self.comm, self.counts = comm, comm.allgather(kernels)
        self.starts = np.cumsum([0, *self.counts])
        self.total = int(self.starts[-1])
        first, last = (int(n) for n in self.starts[comm.rank :][:2])
        self.gathered = 1 < comm.size and self.total <= gathered
        self.of_factor = MPI.COMM_SELF if self.gathered else comm
        self._first, self.rows = (0, self.total) if self.gathered else (first, kernels)
        self.of_rank = slice(first, last) if self.gathered else slice(0, kernels)

    def spread(self, local: Array) -> Array:
        """The vector in this layout, from this rank's part (collective)."""
        if not self.gathered:
            return local
        result = np.empty(self.total)
        self.comm.Allgatherv(local, (result, self.counts))
        return result

    def collected(self, blocks: Blocks) -> Blocks:
        """The sum over all ranks of the rows that this rank needs (collective)."""
        blocks = blocks.summed()
        if self.comm.size == 1:
            return blocks
        if self.gathered:
            return Blocks.join(self.comm.allgather(blocks)).summed()
        exchange = NodeExchange(self.comm, blocks.starts[:, 0], self.total, self.starts)
        return blocks.to_owners(exchange).summed()

    def places(self, blocks: Blocks) -> sparse.csr_matrix:
        """Places of the entries of the matrix among the values of the brought blocks."""
        return blocks.places(self._first, self.rows, self.total)


class CoarseFactor:
    """The factor of G Gᵀ.

    Parameters
    ----------
    places
        Rows of the matrix on this rank, as `layout` distributes them: entry k of the sparse matrix
        is ``values[places[k]]`` of the given values.
    """

    def __init__(self, layout: _Layout, places: sparse.csr_matrix) -> None:
        self._layout = layout
        self._places = places.data
        self._local = sparse.csr_matrix(
            (np.empty(places.nnz), places.indices, places.indptr), shape=places.shape
        )
        self._matrix = PETSc.Mat()
        # the caller reports a singular G Gᵀ; CHOLMOD would write to the terminal, too
        PETSc.Options().setValue("mat_cholmod_print", 0)
        self._pc = PETSc.PC().create(layout.of_factor)
        self._pc.setType("cholesky")
        self._pc.setFactorSolverType("cholmod" if layout.of_factor.size == 1 else "mumps")
        self._source, self._target = (
            PETSc.Vec().createWithArray(np.empty(layout.rows), comm=layout.of_factor)
            for _ in range(2)
        )

    @property
    def entries(self) -> int:
        """Stored entries, over all ranks."""
        return int(self._matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"])

    def take(self, values: Array) -> None:
        """Factorise with these values; the symbolic factorisation is computed the first time only.

        A distributed factor can be computed only once.

        Raises
        ------
        ArithmeticError
            The matrix is singular.
        """
        np.take(values, self._places, out=self._local.data)
        if not self._matrix:
            self._matrix = petsc_rows(self._layout.of_factor, self._local, self._layout.rows)
            self._matrix.setOption(PETSc.Mat.Option.SPD, True)
        else:  # the PETSc matrix uses the memory of these arrays
            self._matrix.assemble()
        try:
            compute_factor(self._pc, self._matrix)
        except ArithmeticError as error:
            raise ArithmeticError(
                "the coarse problem G Gᵀ is singular: no constraint resists some rigid motion"
            ) from error

    def solve(self, rhs: Array, out: Array) -> None:
        """(G Gᵀ)⁻¹ times a coarse vector, both distributed as in the layout."""
        on_arrays(self._pc.apply, self._source, rhs, self._target, out)


class _Restriction:
    """G = Rᵀ Bᵀ, or with the metric G W, as a product of two factors.

    One product with Bᵀ, then one product with the small dense kernel of each class. Coarse vectors
    are whole or this rank's part, as the layout says.
    """

    def __init__(
        self,
        B: ConstraintMatrix,
        kernels: Sequence[tuple[int, Array]],
        layout: _Layout,
        metric: Array,
    ) -> None:
        self._B, self._layout, self._metric = B, layout, metric
        self._weights = np.ones(B.rows), metric
        self._classes = _kernel_parts(kernels)
        self._interface = np.empty(B.columns)
        self._coarse = np.empty(layout.counts[layout.comm.rank])
        self._dual = np.empty(B.rows)

    def weighted(self, weights: Array) -> "_Restriction":
        """The restriction for the rows of B times weights; these are one except on contact rows."""
        result = copy(self)
        result._weights = weights, weights * self._metric
        return result

    def restrict(self, dual: Array, out: Array, metric: bool) -> None:
        """G, or G W, times a dual vector (collective)."""
        np.multiply(self._weights[metric], dual, out=self._dual)
        self._B.apply_transpose(self._dual, self._interface)
        for interface, coarse, members, R in self._classes:
            forces = self._interface[interface].reshape(members, -1)
            # wide results are multiplied faster than narrow ones
            self._coarse[coarse].reshape(members, -1)[:] = (R.T @ forces.T).T
        out[:] = self._layout.spread(self._coarse)

    def extend(self, coarse: Array, out: Array, metric: bool) -> None:
        """Gᵀ, or W Gᵀ, times a coarse vector (collective)."""
        local = coarse[self._layout.of_rank]
        for interface, part, members, R in self._classes:
            motions = self._interface[interface].reshape(members, -1)
            np.matmul(local[part].reshape(members, -1), R.T, out=motions)
        self._B.apply(self._interface, out)
        out *= self._weights[metric]

    def remove(self, coarse: Array, x: Array, metric: bool) -> None:
        """Subtract Gᵀ, or W Gᵀ, times a coarse vector from x (collective)."""
        self.extend(coarse, self._dual, metric)
        x -= self._dual


def _kernel_parts(kernels: Sequence[tuple[int, Array]]) -> list[tuple[slice, slice, int, Array]]:
    """Places in interface and coarse vectors, members and kernel of each class."""
    parts = []
    interface = coarse = 0
    for members, R in kernels:
        ends = interface + members * R.shape[0], coarse + members * R.shape[1]
        parts.append((slice(interface, ends[0]), slice(coarse, ends[1]), members, R))
        interface, coarse = ends
    return parts
