"""The problem of the first set on one level: each contact row a one-sided spring.

    min ½ xᵀ A x - bᵀ x + ½ Σ s_i max(0, (Q x - c)_i)² + ½ Σ w s_i (Q x - c)_i²

is solved by Newton's method with an exact line search, which ends after finitely many steps
(D. Sun, J. Han, 1997). The last sum pulls open rows near and so places bodies that nothing else
holds. With friction, tangential rows have springs that yield at the slip limit; a step takes their
stiffness at the present slip. A slender body that lifts off is more compliant than these springs,
so that proximal steps follow: fainter springs, which hold each open row where the step before left
it. Three kinds of levels differ in how they solve for a step: by a sparse factor, by a dense one on
every rank, or by a few conjugate gradients with a V-cycle.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.linalg.blas import dsyrk

from solver.distributed import lent
from solver.factors import factored
from solver.primal.block_rows import BlockRows
from solver.primal.blocks import petsc_blocks, rows_in_blocks
from solver.primal.cycle import Cycle, CycleWithSprings
from solver.primal.factor import diagonal_below, spring_matrix, squared, with_springs
from solver.primal.friction_springs import FrictionSprings
from solver.primal.hierarchy import Hierarchy
from solver.primal.line_search import minimum_along
from solver.primal.products import multiply, multiply_transposed
from solver.vectors import Array, Mask


@dataclass(frozen=True)
class FirstSetOptions:
    """The tuned numbers of the first set."""

    faint: float = 1e-4
    """w. With a hundredth contact zones move visibly; below 1e-6 bodies that only these springs
    hold move so far that no digits are left."""
    proximal: float = 1e-7
    """w of the proximal steps. Without them most of a slender body starts closed and lifts off row
    after row: the ribbed panel of 128,112 unknowns takes 119 operator applications in 17 sets
    instead of 57 in 9."""
    softer: float = 0.1
    carried: float = 1e-3
    proximal_steps: int = 5
    """Factor on w in each further proximal step on levels with a dense factor, force of these
    springs over that of contact at which the steps end, and most of them. A corrugated sheet of
    degree 2 (51,132 unknowns) that lies on three nodes took 556 operator applications with steps of
    equal w that ended where the set stayed the same: the springs still carried it. It takes 330."""
    exact_steps: int = 60
    steps: int = 8
    """Most Newton steps on the coarsest level, which a factor solves, and on finer ones: three
    steps, each with a reduction of 0.3, left contact there that had not settled. With eight and 0.1
    the ribbed panel takes 113 applications instead of 129, with 118,800 unknowns 116 instead of
    169; the pin in a lug 45 instead of 51, the flange 79 instead of 87, the pillow block 36 instead
    of 40, all in less time; the eye on a pin takes 45 instead of 42."""
    reduction: float = 0.1
    iterations: int = 25
    """Residual reduction, and largest number of iterations, of the conjugate gradients in one
    Newton step."""
    settled: float = 0.05
    """Springs that a step changes, over those that press, at which a level is settled. Without it,
    or with 0.02, flange, eye on a pin and the panel of 118,800 unknowns take 1 to 11 % more
    seconds."""
    follows: float = 0.05
    """Change of the spring of a tangential row, relative to the stiffer one, from which on it
    counts as changed. With 0.05, 0.1 and 0.2 the hub of `contact_app.studies.friction_cost` with
    Tresca friction takes 61, 76 and 75 operator applications, the pillow block 44, 39, 49."""
    sticking: float = 0.05
    """Stiffness of the springs of sticking points over that of K against their rows. The levels of
    two bodies do not fit together, so that stiffer springs let points slide in the first set that
    stick: with 0.05, 0.1 and 1 the flange takes 103, 119 and 143 applications, the bracket 48, 50
    and 43."""
    shift: float = 1e-9
    small: float = 1e-2
    """Relative addition to the diagonal, for motions that no row and no support stops; an entry
    counts as this share of the largest of the level at least, since aggregates with held or too few
    nodes have unknowns without any stiffness."""
    largest: int = 900
    """Unknowns up to which a level is solved by a factor, a dense one. On a bracket of hexahedra
    (66,843 unknowns) one of 2,100 takes a quarter of the whole solve; from the level below, of 474
    unknowns, on the first set costs little, and the sets take no more iterations. A ribbed panel of
    128,112 unknowns takes 6.4 s with 1,500 and 4.7 s with 900, on two ranks."""
    full: float = 0.12
    """Share of entries that are not zero, from which rows on such a level are multiplied as a full
    matrix: on the flange, where they are a fifth, in a third of the time."""


@dataclass(frozen=True, eq=False)
class Rows:
    """The contact and tied rows of a problem."""

    comm: MPI.Intracomm
    c: Array  # (rows,)
    """Right-hand side."""
    normal: Mask
    equality: Mask
    """Masks of the contact rows, and of the rows that hold with equality. Shape (rows,)."""
    stiffness: Array  # (rows,)
    """Stiffness of the springs."""
    friction: FrictionSprings
    """Points with friction."""

    def everywhere(self) -> "Rows":
        """All rows, on a rank of its own (collective)."""
        c, normal, equality, stiffness = (
            np.concatenate(self.comm.allgather(part))
            for part in (self.c, self.normal, self.equality, self.stiffness)
        )
        friction = self.friction.everywhere(self.comm, len(self.c))
        return Rows(MPI.COMM_SELF, c, normal, equality, stiffness, friction)

    def weights(self, jump: Array, faint: float) -> Array:
        """Stiffness of each spring at C u - c, (rows,); `faint` is that of open rows over s."""
        stiff = (self.normal & (jump >= 0.0)) | self.equality
        weights = self.stiffness * np.where(stiff, 1.0, faint)
        rows = self.friction.rows
        yielding = self.friction.stiffness(jump, self.stiffness * jump)
        weights[rows] = np.maximum(weights[rows], yielding)
        return np.asarray(weights)


class Level(ABC):
    """Newton's method on one level; a subclass multiplies by A and Q and solves for a step.

    Parameters
    ----------
    load
        b.
    diagonal
        Diagonal of A.
    """

    def __init__(self, rows: Rows, load: Array, diagonal: Array, options: FirstSetOptions) -> None:
        self.rows, self.load, self.options, self.comm = rows, load, options, rows.comm
        self.shift = self._addition(diagonal)

    def _addition(self, diagonal: Array) -> Array:
        """Small addition to a diagonal, by which its matrix has an inverse (collective)."""
        most = self.comm.allreduce(float(diagonal.max(initial=0.0)), op=MPI.MAX)
        return np.asarray(self.options.shift * np.maximum(diagonal, self.options.small * most))

    @abstractmethod
    def stiffness(self, x: Array) -> Array:
        """A x."""

    @abstractmethod
    def images(self, x: Array) -> Array:
        """Q x, (rows,)."""

    @abstractmethod
    def forces(self, multiplier: Array) -> Array:
        """Qᵀ λ of multipliers (rows,)."""

    @abstractmethod
    def newton_step(self, weights: Array, residual: Array) -> Array:
        """A solution with the Hessian whose springs have these stiffnesses (rows,).

        Raises
        ------
        ArithmeticError
            The Hessian has no factor.
        """

    def multiplier(self, x: Array) -> Array:
        """Forces of the springs of contact and friction, as multipliers (rows,)."""
        jump = self.images(x) - self.rows.c
        return self.rows.weights(jump, 0.0) * jump

    def pressed(self, x: Array) -> Mask:
        """Rows whose spring presses, (rows,)."""
        return np.asarray(self.rows.normal & (self.images(x) > self.rows.c))

    def without_faint_springs(self, x: Array) -> Array:
        """The minimum without them, from that with them, by proximal steps (collective)."""
        options, faint, most = self.options, self.options.proximal, 0.0
        for _ in range(options.proximal_steps):
            before = self.images(x)
            x = self.proximal_step(x, options.exact_steps, 0.0, faint)
            pulls = faint * self.rows.stiffness * (self.images(x) - before)
            sums = np.abs(pulls[self.rows.normal]).sum(), np.abs(self.multiplier(x)).sum()
            carried, pressing = self.comm.allreduce(np.array(sums))
            most = max(most, carried)
            if carried <= options.carried * max(pressing, most):
                break
            faint *= options.softer
        return x

    def proximal_step(
        self, x: Array, steps: int, settled: float, faint: float | None = None
    ) -> Array:
        """The minimum with springs that hold open rows where x has them (collective)."""
        faint = faint or self.options.proximal
        jump = self.images(x) - self.rows.c
        pulls = np.where(self.rows.equality, 0.0, faint * self.rows.stiffness * jump)
        return self._newton(x, self.load + self.forces(pulls), steps, faint, settled)

    def minimise(self, x: Array, steps: int) -> Array:
        """The minimum, or the result of the given number of steps (collective)."""
        return self._newton(x, self.load, steps, self.options.faint, self.options.settled)

    def _newton(self, x: Array, load: Array, steps: int, faint: float, settled: float) -> Array:
        """Newton steps under a load, until few springs change in a step (collective)."""
        jump = self.images(x) - self.rows.c
        Ax = self.stiffness(x)
        for _ in range(steps):
            weights = self.rows.weights(jump, faint)
            gradient = Ax - load + self.shift * x
            step = self.newton_step(weights, -gradient - self.forces(weights * jump))
            image, product = self.images(step), self.stiffness(step)
            along = float(step @ gradient), float(step @ (product + self.shift * step))
            length = self._length(jump, image, along, weights, faint)
            x, jump, Ax = x + length * step, jump + length * image, Ax + length * product
            if self._settled(weights, self.rows.weights(jump, faint), length, settled):
                break
        return x

    def _settled(self, before: Array, after: Array, length: float, share: float) -> bool:
        """Whether a step of some length changed few springs, or none with its full length.

        Few are this share of the springs that press (collective).
        """
        changes = np.abs(before - after) > self.options.follows * np.maximum(before, after)
        count = changes.sum(), (after >= self.rows.stiffness).sum()
        changed, stiff = self.comm.allreduce(np.array(count))
        if changed:
            return bool(changed <= share * stiff)
        return self.rows.friction.acts or abs(length - 1.0) < 1e-3

    def _length(
        self, jump: Array, image: Array, along: tuple[float, float], weights: Array, faint: float
    ) -> float:
        """The minimum along a step (collective).

        The springs of friction keep their stiffness: their energy bounds that of springs that yield
        (D. R. Hunter, K. Lange, *A tutorial on MM algorithms*, Am. Stat. 58, 2004).

        Parameters
        ----------
        along
            Slope and curvature along the step without springs, of this rank.
        weights : (rows,)
            Stiffness of each spring at the beginning of the step.
        """
        pulling = ~self.rows.normal | self.rows.equality
        always = np.where(pulling, weights, faint * self.rows.stiffness)  # press and pull
        springs = np.array([(always * image) @ jump, (always * image) @ image])
        slope, curvature = np.array(along) + springs
        normal = self.rows.normal
        push, q = (1.0 - faint) * self.rows.stiffness[normal], image[normal]

        def rest(t: float) -> tuple[float, float]:
            """Slope and curvature without the springs of contact."""
            return slope + curvature * t, curvature

        return minimum_along(self.comm, rest, push * jump[normal], push * q, q)


class SharedLevel(Level):
    """A level whose unknowns the ranks share; a sparse factor solves for each step."""

    def __init__(
        self, rows: Rows, A: PETSc.Mat, Q: BlockRows, load: Array, options: FirstSetOptions
    ) -> None:
        self.A, self.Q = A, Q
        super().__init__(rows, load, np.asarray(A.getDiagonal().getArray()), options)

    def stiffness(self, x: Array) -> Array:
        """A x."""
        return multiply(self.A, x)

    def images(self, x: Array) -> Array:
        """Q x, (rows,)."""
        return multiply(self.Q.matrix, x)

    def forces(self, multiplier: Array) -> Array:
        """Qᵀ λ of multipliers (rows,)."""
        return multiply_transposed(self.Q.matrix, multiplier)

    def newton_step(self, weights: Array, residual: Array) -> Array:
        """Newton step by a sparse factor of the Hessian."""
        pc = factored(with_springs(self.A, self.Q, weights, self.shift))
        out = np.empty_like(residual)
        with lent(self.comm, residual, out) as (x, y):
            pc.apply(x, y)
        pc.destroy()
        return out


class CycleLevel(SharedLevel):
    """A level whose steps a few conjugate gradients find, with a cycle from there down.

    The cycle is made once, with the springs of the first step on every level. Without springs on
    the levels below, two bodies that only contact holds take 101 cycles on a bolted flange instead
    of 14, and a pillow block 17 instead of 7.

    Parameters
    ----------
    hierarchy
        This level and those below.
    Q
        C on each of these.
    cycle
        A cycle to use; None to make one.

    Attributes
    ----------
    made
        The cycle that was made, from the first Newton step on.
    """

    def __init__(
        self, rows: Rows, hierarchy: Hierarchy, Q: Sequence[BlockRows], load: Array,
        options: FirstSetOptions, cycle: Cycle | None = None,
    ) -> None:  # fmt: skip
        super().__init__(rows, hierarchy.operators[0], Q[0], load, options)
        self._hierarchy, self._below, self._cycle = hierarchy, Q, cycle
        self.made: CycleWithSprings | None = None

    def newton_step(self, weights: Array, residual: Array) -> Array:
        """A few conjugate gradients from zero; in the norm of the preconditioner (collective)."""
        comm, cycle = self.comm, self._cycle_with_springs(weights)
        x, left, z = np.zeros_like(residual), residual.copy(), np.empty_like(residual)
        cycle.apply(left, z)
        direction, square = z.copy(), comm.allreduce(float(left @ z))
        least = self.options.reduction**2 * square
        if not square > 0.0:
            return x
        for _ in range(self.options.iterations):
            product = self.stiffness(direction) + self.shift * direction
            product += self.forces(weights * self.images(direction))
            curvature = comm.allreduce(float(direction @ product))
            if not curvature > 0.0:
                break
            length = square / curvature
            x += length * direction
            left -= length * product
            cycle.apply(left, z)
            before, square = square, comm.allreduce(float(left @ z))
            if square <= least:
                break
            direction = z + square / before * direction
        return x

    def _cycle_with_springs(self, weights: Array) -> Cycle:
        """The cycle, made with the springs of the first call (collective).

        Faint springs, which most rows have, are only the diagonal of their Galerkin products.
        """
        if self._cycle is None:
            levels = self._hierarchy
            stiff = np.where(weights > self.options.faint * self.rows.stiffness, weights, 0.0)
            springs = spring_matrix(self.Q, stiff)
            faint = multiply_transposed(squared(self.Q.matrix), weights - stiff)
            added = springs.plus_diagonal(self.shift + faint)
            operators = [rows_in_blocks(self.A).plus(added)]
            for A, P in zip(levels.operators[1:], levels.prolongations, strict=True):
                springs, faint = springs.galerkin(BlockRows.of(P)), diagonal_below(P, faint)
                shift = self._addition(A.getDiagonal().getArray())
                operators.append(rows_in_blocks(A).plus(springs.plus_diagonal(shift + faint)))
            matrices = [*map(petsc_blocks, operators)]
            self._cycle = Cycle(matrices, levels.prolongations, levels.options)
            self.made = CycleWithSprings(self._cycle, operators, stiff, self._below)
        return self._cycle


class DenseLevel(Level):
    """A small level on this rank alone, with a dense factor for each step.

    The Hessian of a coarse level is nearly full: on 1,080 unknowns of a pair CHOLMOD takes 53 ms,
    this 21. From step to step only the rows whose springs change are added or taken out.
    """

    def __init__(
        self, rows: Rows, A: sparse.csr_matrix, Q: sparse.csr_matrix, load: Array,
        options: FirstSetOptions,
    ) -> None:  # fmt: skip
        self._A, self._Q, self._Qt = A, Q, Q.T.tocsr()
        super().__init__(rows, load, A.diagonal(), options)
        self._hessian = A.toarray(order="F") + np.diag(self.shift)
        self._weights_of_hessian = np.zeros(len(rows.c))

    @classmethod
    def gathered(cls, level: SharedLevel) -> "DenseLevel":
        """A distributed level, gathered on every rank (collective)."""
        comm = level.comm
        A, Q = (
            sparse.csr_matrix(sparse.vstack(comm.allgather(rows.local.tocsr())))
            for rows in (rows_in_blocks(level.A), level.Q)
        )
        load = np.concatenate(comm.allgather(level.load))
        return cls(level.rows.everywhere(), A, Q, load, level.options)

    def stiffness(self, x: Array) -> Array:
        """A x."""
        return np.asarray(self._A @ x)

    def images(self, x: Array) -> Array:
        """Q x, (rows,)."""
        return np.asarray(self._Q @ x)

    def forces(self, multiplier: Array) -> Array:
        """Qᵀ λ of multipliers (rows,)."""
        return np.asarray(self._Qt @ multiplier)

    def newton_step(self, weights: Array, residual: Array) -> Array:
        """Newton step by a dense factor of the Hessian."""
        changes = weights - self._weights_of_hessian
        for sign in (1.0, -1.0):
            some = np.flatnonzero(sign * changes > 0.0)
            self._add(sparse.diags(np.sqrt(sign * changes[some])) @ self._Q[some], sign)
        self._weights_of_hessian = weights
        try:
            factor = cho_factor(self._hessian, lower=True)
        except LinAlgError as error:
            raise ArithmeticError("the Hessian of a coarse level has no Cholesky factor") from error
        return np.asarray(cho_solve(factor, residual))

    def _add(self, rows: sparse.csr_matrix, sign: float) -> None:
        """Add sign · rowsᵀ rows to the lower half of the Hessian."""
        if rows.nnz > self.options.full * np.prod(rows.shape, dtype=float):
            full = rows.toarray()
            self._hessian = dsyrk(sign, full.T, 1.0, self._hessian, lower=1, overwrite_c=1)
        else:
            self._hessian += sign * (rows.T @ rows).toarray()
