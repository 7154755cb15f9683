"""The iterate of an active-set iteration, and the operations that move it.

Every method makes one pass over the vectors and at most one collective sum. A CG step of MPRGP is
:meth:`Iterate.probe`, :meth:`Iterate.advance`, :meth:`Iterate.conjugate`: one Hessian
multiplication, three passes, two collectives. All vectors are allocated when the iterate is made.
"""

import math
from collections.abc import Callable
from time import perf_counter

import numpy as np
from scipy.linalg.blas import daxpy

from solver.errors import IndefiniteError, NotFiniteError, UnboundedError
from solver.qp.block import Block
from solver.qp.convex_set import Scratch
from solver.qp.operators import Operator, estimate_norm
from solver.qp.preconditioner import Preconditioner
from solver.qp.result import Counts, Monitor, Step
from solver.qp.separable_qp import SeparableQP
from solver.vectors import Mask, Vector, blocks

#: Curvature pᵀAp/(‖A‖ pᵀp) at or below which a direction is taken to be in the kernel of A.
ZERO_CURVATURE = 1e-14
#: Curvature pᵀAp/(‖A‖ pᵀp) below which the Hessian counts as indefinite.
NEGATIVE_CURVATURE = -1e-12

#: Called with the iterate after each step; has to copy the arrays that it stores.
Watch = Callable[["Iterate"], None]


class Iterate:
    """Point x, gradient g = Ax - b and its splitting, direction p and product Ap.

    Attributes
    ----------
    free_square, chopped_square, reduced_free : float
        ‖g^f‖², ‖g^c‖² and g^rᵀg^f over all ranks; without a step length g^r is g^f.
    largest : float
        Largest ‖Ap‖/‖p‖ seen: a lower bound of ‖A‖.
    alpha : float
        Step length of the reduced gradient: the one that an expansion used last.
    drift : float
        Rounding errors that recurrences may have added to g since it was last evaluated.
    image : ndarray or None
        For an operator with an ``image``: the image of x, updated by the same recurrence as g.
    curved : bool
        Whether a straight step along the boundary of the feasible set may leave the set.
    spectral_step : float
        Inverse of the curvature along the last projected gradient step; zero before the first.
    watch : callable of Iterate or None
        Called with the iterate after each step.
    """

    def __init__(
        self,
        qp: SeparableQP,
        x0: object = None,
        *,
        norm: float | None = None,
        preconditioner: Preconditioner | None = None,
    ) -> None:
        self.qp = qp
        self.operator = qp.operator
        self.reduction = qp.reduction
        n = qp.size
        self.preconditioner = preconditioner
        self.x = qp.start(x0)
        self.g, self.p, self.Ap = np.zeros(n), np.zeros(n), np.zeros(n)
        feasible = None if qp.feasible.is_everything else qp.feasible
        self._bounded = feasible is not None
        # without constraints the free gradient is the gradient, and the chopped gradient is zero
        self.free = np.zeros(n) if self._bounded else self.g
        self.chopped = np.zeros(n)
        self.is_free: Mask = np.ones(n, dtype=bool)
        self.z = self.free if self.preconditioner is None else np.zeros(n)
        vectors = {
            "x": self.x, "g": self.g, "p": self.p, "Ap": self.Ap, "b": qp.b,
            "free": self.free, "chopped": self.chopped, "is_free": self.is_free, "z": self.z,
        }  # fmt: skip
        self._rows = list(blocks(n) if feasible is None else feasible.blocks(n))
        scratch = Scratch(max(rows.stop - rows.start for rows in self._rows))
        self.blocks = [Block(rows, vectors, feasible, scratch) for rows in self._rows]
        self.curved = feasible is not None and feasible.curved
        self.spectral_step = 0.0
        self.counts = Counts()
        self.iterations = 0
        self.history: list[Step] = []
        self.outer = 0
        self.equality_residual = 0.0
        self.free_square = self.chopped_square = self.reduced_free = self.x_square = 0.0
        self.free_product = 0.0  # zᵀAp, numerator of the conjugation
        self.active = 0
        self.slope = self.curvature = 0.0  # gᵀp, pᵀAp
        self.largest = 0.0
        self.product_norm = 0.0  # ‖Ap‖
        self.drift = 0.0
        self.alpha = 0.0
        self.b_norm = 0.0
        self.image: np.ndarray | None = None
        self._image_p: np.ndarray | None = None
        self._previous_image: np.ndarray | None = None
        self.watch: Watch | None = None
        self._norm = norm
        self._previous_numbers = (0.0, 0.0, 0.0)
        self._marked: tuple[Vector, Vector] | None = None
        self._began = perf_counter()

    # ------------------------------------------------------------------ scalars

    @property
    def projected_gradient_norm(self) -> float:
        """‖g^P‖; free and chopped gradient are orthogonal."""
        return math.sqrt(self.free_square + self.chopped_square)

    @property
    def norm(self) -> float:
        """‖A‖: given, or by the power method; raised where a step showed a larger value."""
        if self._norm is None:
            self._norm, multiplications = estimate_norm(self.operator)
            self.counts.norm_estimation += multiplications
        if self.largest > 1.01 * self._norm:
            self._norm = self.largest
        return self._norm or 1.0  # a zero Hessian: the half step alone moves to the bounds

    @property
    def largest_known(self) -> float:
        """‖A‖ where it is known, else the largest ‖Ap‖/‖p‖ seen: no multiplication is spent."""
        return max(self.largest, self._norm or 0.0)

    # ------------------------------------------------------------------ passes

    def replace_operator(self, operator: Operator, norm: float | None) -> None:
        """Go on with another Hessian, of another norm; the caller adapts the gradient."""
        self.operator = operator
        self._norm = norm

    def evaluate(self) -> None:
        """Compute g = Ax - b by a multiplication, split it and restart p at the free gradient."""
        self.operator.apply(self.x, self.g)
        image = self._image_of_last()
        self.image = None if image is None else image.copy()
        self.counts.hessian += 1
        self.drift = 0.0
        self.restart(subtract_b=True)

    def begin(self) -> None:
        """Set the gradient -b of x = 0, which takes no multiplication, and the first directions."""
        self.g.fill(0.0)
        image = self._image_of_last()
        self.image = None if image is None else np.zeros_like(image)
        self.restart(subtract_b=True)

    def restart(self, *, subtract_b: bool = False) -> None:
        """Split the gradient g as it stands and restart the directions."""
        sums = np.zeros(5)
        for block in self.blocks:
            if subtract_b:
                np.subtract(block.g, block.b, out=block.g)
            block.split()
            np.copyto(block.p, block.free)
            self._add_squares(sums, block)
        self._take(sums)
        self._precondition(restart=True)

    def probe(self) -> tuple[float, float]:
        """Product Ap; lengths α_cg of the minimum along -p and α_f to the bound.

        A direction without curvature has α_cg = ∞.

        Raises
        ------
        IndefiniteError, UnboundedError, NotFiniteError
        """
        self.operator.apply(self.p, self.Ap)
        self._image_p = self._image_of_last()
        self.counts.hessian += 1
        slope = curvature = pp = ApAp = 0.0
        steepest = 0.0
        for block in self.blocks:
            slope += float(np.dot(block.g, block.p))
            curvature += float(np.dot(block.p, block.Ap))
            pp += float(np.dot(block.p, block.p))
            ApAp += float(np.dot(block.Ap, block.Ap))
            steepest = max(steepest, block.inverse_longest_step())
        (slope, curvature, pp, ApAp), least = self.reduction.sums_and_minimum(
            (slope, curvature, pp, ApAp), -steepest
        )
        longest = -1.0 / least if least < 0.0 else math.inf
        if not math.isfinite(slope + curvature + ApAp):
            self._raise_not_finite(self.Ap)
        self.slope, self.curvature = slope, curvature
        self.product_norm = math.sqrt(ApAp)
        self.largest = max(self.largest, math.sqrt(ApAp / pp) if pp > 0.0 else 0.0)
        relative = curvature / (self.largest * pp) if self.largest * pp > 0.0 else 0.0
        if relative < NEGATIVE_CURVATURE:
            component = self.reduction.argmax(np.abs(self.p))
            raise IndefiniteError(
                "the Hessian is indefinite: the curvature p'Ap/(|A| p'p) is "
                f"{relative:.3g} along a direction p that is largest in component {component}"
            )
        if relative <= ZERO_CURVATURE:
            return math.inf, longest
        return slope / curvature, longest

    def advance(self, alpha: float, *, restart: bool = False, snap: bool = False) -> None:
        """Move to x - αp, with g - αAp by recurrence and split; optionally restart p.

        With ``snap``, components that the step brought to within rounding of a bound are put
        on it, as the half step to the bound needs.
        """
        self._drift(alpha)
        self._step_image(alpha)
        sums = np.zeros(5)
        free_product = 0.0
        for block in self.blocks:
            if snap:
                block.step_to_boundary(alpha)
            else:
                block.step(alpha)
            np.multiply(block.Ap, alpha, out=block.t)
            np.subtract(block.g, block.t, out=block.g)
            block.split()
            if restart:
                np.copyto(block.p, block.free)
            else:
                free_product += float(np.dot(block.Ap, block.free))
            self._add_squares(sums, block)
        (self.free_product,) = self._take(sums, free_product)
        self._precondition(restart)

    def conjugate(self) -> None:
        """p = z - βp with β = zᵀAp / pᵀAp, A-orthogonal to the last p; z = g^f if plain."""
        beta = self.free_product / self.curvature
        for block in self.blocks:
            np.multiply(block.p, beta, out=block.p)
            np.subtract(block.z, block.p, out=block.p)

    def aim_chopped(self) -> None:
        """p = g^c."""
        np.copyto(self.p, self.chopped)

    def aim_projected(self, alpha: float) -> None:
        """p = x - P(x - αg): x - tp is feasible for 0 ≤ t ≤ 1."""
        for block in self.blocks:
            np.copyto(block.p, block.g)
            block.project_into(alpha, out=block.trial)
            np.subtract(block.x, block.trial, out=block.p)

    def project_step(self, alpha: float, direction: Vector) -> None:
        """x = P(x - α direction): on the bounds exactly; g is not updated."""
        for block, rows in zip(self.blocks, self._rows, strict=True):
            np.multiply(direction[rows], alpha, out=block.t)
            np.subtract(block.x, block.t, out=block.x)
            block.project()

    def reduced_gradient(self, out: Vector) -> None:
        """g^r for the last step length, into out."""
        for block, rows in zip(self.blocks, self._rows, strict=True):
            block.reduced(self.alpha, out[rows])

    def half_step_and_aim(self, alpha_f: float, target: float) -> tuple[float, float]:
        """Take the half step; aim p from there at the projection of the step of length target.

        Leaves p = x½ - P(x - target p) and returns gᵀp and g^rᵀg^f there, g^r for the length
        1/``largest``.
        """
        self._drift(alpha_f)
        self._step_image(alpha_f)
        sums = np.zeros(5)
        slope = standard = 0.0
        for block in self.blocks:
            block.project_into(target, out=block.trial)
            block.step_to_boundary(alpha_f)
            np.multiply(block.Ap, alpha_f, out=block.t)
            np.subtract(block.g, block.t, out=block.g)
            block.split()
            np.subtract(block.x, block.trial, out=block.p)
            slope += float(np.dot(block.g, block.p))
            block.reduced(1.0 / self.largest, out=block.s)
            standard += float(np.dot(block.s, block.free))
            self._add_squares(sums, block)
        slope, standard = self._take(sums, slope, standard)
        return slope, standard

    def aim_reduced(self, alpha: float) -> None:
        """p = α g^r: the standard expansion as a direction that may be followed to its end."""
        for block in self.blocks:
            block.reduced(alpha, out=block.p)
            np.multiply(block.p, alpha, out=block.p)

    def aim_reduced_beside(self, alpha: float) -> tuple[float, float]:
        """p = α g^r; the old p and Ap are stored for :meth:`take_back`. Return gᵀp and pᵀAp_before.

        They are stored in the arrays of g^c and g^f, which the next step computes anew.
        """
        self._previous_numbers = self.slope, self.curvature, self.product_norm
        self._previous_image = None if self._image_p is None else self._image_p.copy()
        slope = mixed = 0.0
        for block in self.blocks:
            np.copyto(block.chopped, block.p)
            block.reduced(alpha, out=block.p)
            np.multiply(block.p, alpha, out=block.p)
            np.copyto(block.free, block.Ap)
            slope += float(np.dot(block.g, block.p))
            mixed += float(np.dot(block.Ap, block.p))
        slope, mixed = self.reduction.sums(slope, mixed)
        return slope, mixed

    def take_back(self) -> None:
        """Restore p and Ap from before :meth:`aim_reduced_beside`."""
        self.slope, self.curvature, self.product_norm = self._previous_numbers
        self._image_p = self._previous_image
        np.copyto(self.p, self.chopped)
        np.copyto(self.Ap, self.free)

    # ------------------------------------------------------------------ bookkeeping

    def record(self, step: str, monitor: Monitor | None) -> bool:
        """Append to the history and call the monitor; return whether it asks to stop on any rank.

        The watch, which may save the iterate, is called after the monitor.
        """
        event = Step(
            self.outer,
            self.iterations,
            step,
            self.projected_gradient_norm,
            self.equality_residual,
            self.active,
            perf_counter() - self._began,
        )
        self.history.append(event)
        stop = False
        if monitor is not None:
            stop = self.reduction.sums(float(bool(monitor(event))))[0] > 0.0
        if self.watch is not None:
            self.watch(self)
        return stop

    @property
    def round_off(self) -> float:
        """Size of the rounding errors in a gradient Ax - b."""
        scale = self.largest * math.sqrt(self.x_square) + self.b_norm
        return 2.0 * float(np.finfo(np.float64).eps) * scale

    def _drift(self, alpha: float) -> None:
        """Account for the rounding errors of g - αAp."""
        size = abs(alpha) * self.product_norm + self.projected_gradient_norm
        self.drift += float(np.finfo(np.float64).eps) * size

    def _image_of_last(self) -> np.ndarray | None:
        """The image of the operator's last vector; the next application overwrites it."""
        image = getattr(self.operator, "image", None)
        assert image is None or isinstance(image, np.ndarray)
        return image

    def _step_image(self, alpha: float) -> None:
        """The image of x - αp."""
        # BLAS refuses a rank without interface
        if self.image is not None and self._image_p is not None and self.image.size:
            daxpy(self._image_p.ravel(), self.image.ravel(), a=-alpha)  # in place

    def settle(self) -> None:
        """Put active components on the boundary of the feasible set exactly."""
        for block in self.blocks:
            block.settle()

    def at_round_off(self) -> bool:
        """Whether the projected gradient is at the level of rounding errors."""
        return self.projected_gradient_norm <= self.round_off

    def measure_b(self) -> None:
        """Compute ‖b‖ anew."""
        self.b_norm = self.reduction.norm(self.qp.b)

    def mark(self) -> None:
        """Remember the present iterate, for :meth:`diverges`."""
        self._marked = (self.x.copy(), self.g.copy())

    def diverges(self) -> bool:
        """Whether x has moved far since `mark`, with falling cost and almost no curvature."""
        if self._marked is None:
            return False
        x, g = self._marked
        d = self.x - x
        square, x_square, curvature, slope = self.reduction.sums(
            float(np.dot(d, d)),
            float(np.dot(x, x)),
            float(np.dot(d, self.g - g)),
            float(np.dot(d, self.g + g)),
        )
        return slope < 0.0 and square > 0.1 * x_square and curvature < 1e-6 * self.largest * square

    def raise_unbounded(self) -> None:
        """Raise the error that names the largest component of -p."""
        component = self.reduction.argmax(np.abs(self.p))
        raise UnboundedError(
            "the cost is unbounded below: it falls without limit along a direction without "
            f"curvature that no bound stops, largest in component {component}",
            component,
        )

    def _take(self, sums: np.ndarray, *others: float) -> list[float]:
        """Reduce the squares of the splitting, and other sums of the same pass."""
        free, chopped, reduced, x_square, active, *others_total = self.reduction.sums(
            *sums, *others
        )
        self.free_square, self.chopped_square = free, chopped
        self.reduced_free, self.x_square = reduced, x_square
        self.active = int(active)
        if not math.isfinite(free + chopped):
            self._raise_not_finite(self.g)
        return others_total

    def _raise_not_finite(self, product: Vector) -> None:
        component = self.reduction.first(~np.isfinite(product))
        raise NotFiniteError(
            f"a Hessian multiplication is not finite: component {component} (in step "
            f"{self.iterations}); is the matrix free of NaN, or did the solve overflow?"
        )

    def _precondition(self, restart: bool) -> None:
        if self.preconditioner is None:
            return
        self.preconditioner.apply(self.free, self.is_free, self.z)
        product = 0.0
        for block in self.blocks:
            if self._bounded:
                np.logical_not(block.is_free, out=block.mask)
                np.copyto(block.z, 0.0, where=block.mask)
            if restart:
                np.copyto(block.p, block.z)
            else:
                product += float(np.dot(block.Ap, block.z))
        if not restart:
            self.free_product = self.reduction.sums(product)[0]

    def _add_squares(self, sums: np.ndarray, block: Block) -> None:
        """Add a block's ‖g^f‖², ‖g^c‖², g^rᵀg^f, ‖x‖² and number of active components."""
        free = float(np.dot(block.free, block.free))
        sums[0] += free
        sums[3] += np.dot(block.x, block.x)
        if not self._bounded:
            sums[2] += free
            return
        sums[1] += np.dot(block.chopped, block.chopped)
        if self.alpha > 0.0:
            block.reduced(self.alpha, out=block.s)
            sums[2] += np.dot(block.s, block.free)
        else:
            sums[2] += free
        sums[4] += block.x.size - np.count_nonzero(block.is_free)
