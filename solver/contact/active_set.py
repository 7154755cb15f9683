"""Faces of the dual problem: contact rows taken as equalities or left out, the rest solved by CG.

On a face nothing is left to bounds or augmented Lagrangians: rows that touch join the coarse
problem, open ones leave it, and conjugate gradients run without a restart. The solution of the
right face is the solution. `follow` looks for it by primal-dual active sets, solved no further than
a decision needs: rows that pull by more than the face's error open, and with them their mirror
image across the edge where they end (`solver.tfeti.constraints.contact_edge`); rows that are
crossed by more than it close (Hintermüller, Ito, Kunisch, *The primal-dual active set strategy as a
semismooth Newton method*, 2002), and only a face that asks for no change is solved to the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from solver import MPRGP, BoxQP, Counts, Reason
from solver.errors import QPError
from solver.qp.iterate import Iterate, Watch
from solver.qp.result import Monitor
from solver.tfeti.constraints.contact_edge import mirrored
from solver.tfeti.constraints.hierarchy import RowLevels
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible import largest_magnitude
from solver.tfeti.preconditioner import FacePreconditioner
from solver.tfeti.recovery import add_motions
from solver.tfeti.recycling import DeflatedPreconditioner, Directions, RecordedOperator, Recycled

FIRST_LOOK, NEXT_LOOK = 0.3, 0.1
"""Reduction of the residual before the first look at a face and between later ones."""

EAGER_LOOK = 0.5
"""The same between looks that may end a solve before it is settled what touches."""

THINNED_LOOK = 0.1
"""The same where some of the rows stand for all: what a level decides the next has to undo."""

LOOKS = 3
"""Looks at a face before it is solved to the end."""

SIGNIFICANT = 0.1
"""Forces and distances that change a face, relatively, over the estimate of its error."""

FIRST = 0.02
"""Share of the load, from where it first closes a contact on, whose contacts the first face has."""

ROUNDED = 2.0 * float(np.finfo(np.float64).eps)
"""Rounding errors of F λ over ‖F‖ ‖λ‖."""

MARGIN, TIGHTEN = 0.7, 0.3
"""Share of the largest jump allowed at which an answer is shown; factor on the residual where it
was not accepted."""

DEEPER = 0.1
"""Factor on the first look's residual each time the active sets come back to one they had."""

STALLED = 2
"""Steps on a face, over its unknowns, after which rounding holds conjugate gradients up, which end
within one of them in exact arithmetic: its rows hardly keep some body in place or hardly differ."""

PEELED = 0.1
"""Share of the touching rows that open, face after face, where contact peels off."""

FACES = 60
"""Faces tried: where contact peels off row by row each is a handful of products."""

OUTSIDE = 10.0
"""Residual that conjugate gradients leave, over the part of the right-hand side that rounding
puts outside the range of P, which no step can remove."""

SHORT = 4
"""Steps on a face up to which that part is not worth the projection that finds it."""

IDEMPOTENT = 1e-8
"""Relative difference of QQ and Q above which a coarse problem counts as singular."""


@dataclass(frozen=True, eq=False)
class State:
    """A multiplier in equilibrium, and the displacements that go with it.

    Attributes
    ----------
    multiplier : (dual,)
        λ.
    motions : (kernels,)
        α, which lets the jumps on the face be smallest.
    touching : (dual,)
        Contact rows of the face.
    jumps : (dual,)
        B u - c.
    lengths : (dual,)
        What each row's jump is relative to: the displacement of its body on the interface.
    displacements : (interface,)
        u.
    strained
        a(u, u), twice the energy of the strains.
    """

    multiplier: NDArray[np.float64]
    motions: NDArray[np.float64]
    touching: NDArray[np.bool_]
    jumps: NDArray[np.float64]
    lengths: NDArray[np.float64]
    displacements: NDArray[np.float64]
    strained: float

    def distance(self, problem: DualProblem) -> NDArray[np.float64]:
        """Jumps, and the penetration of contact rows; over the body's displacement."""
        return self.jumps / (problem.spread * self.lengths)

    def worst(self, problem: DualProblem) -> float:
        """Largest jump or penetration, over the displacement of its body."""
        one_sided = problem.inequality & ~self.touching
        distance = self.distance(problem)
        return largest_magnitude(
            problem.comm, np.where(one_sided, np.maximum(distance, 0.0), distance)
        )

    def homogenised(self, problem: DualProblem) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x = λ - λ̃ and t = Cᵀ μ = Q (F λ - d) - Gᵀ α, for SMALBE to go on from."""
        coarse = problem.coarse
        assert coarse is not None
        force, kernel_part = np.empty(problem.size), np.empty(problem.size)
        coarse.extend(self.motions, kernel_part)
        coarse.apply(kernel_part - self.jumps, force)
        return self.multiplier - problem.offset, force - kernel_part


@dataclass(frozen=True, eq=False)
class Outcome:
    """How faces ended.

    Attributes
    ----------
    reason
        `ACCEPTED`, why the solver ended, or None where another face is asked for.
    state
        The last one looked at.
    following : (dual,)
        The contact rows that touch from there on.
    """

    reason: Reason | None
    state: State | None
    following: NDArray[np.bool_]
    counts: Counts


Accept = Callable[[State], bool]
"""The caller's own test of a face's solution; the same on all ranks."""

Lacks = Callable[[State], float]
"""Factor by which the error of a state has to fall before it is worth a test; one or less where it
is worth one as it stands."""


@dataclass(frozen=True)
class Keep:
    """Saves the state of a face at steps where one is wanted.

    Attributes
    ----------
    due
        Whether a state is wanted at this step; the same on all ranks.
    save
        Told of the state and of the work up to it.
    before
        Work of faces before this one.
    """

    due: Callable[[], bool]
    save: Callable[[State, Counts], None]
    before: Counts = field(default_factory=Counts)

    def watch(self, face: Face) -> Watch:
        """What sees the iterates of a face."""

        def saw(it: Iterate) -> None:
            if self.due():
                self.save(face.state(), self.before + face.counts)

        return saw


Guess = Callable[[], NDArray[np.bool_]]
"""Contact rows that touch, (dual,) (collective)."""


class Face:
    """Conjugate gradients with some contact rows closed and the others open.

    Parameters
    ----------
    touching : (dual,)
        Contact rows that hold with equality.
    multiplier : (dual,)
        Where to begin: the nearest multiplier in equilibrium; at the smallest one unless given.
    directions
        Of earlier faces, which serve again; those of this one join them.
    levels
        Which open rows may close; a face that asks for no change goes on to the next level.
    beyond
        Whether rows open in the mirror image of what pulls, too.

    Raises
    ------
    ArithmeticError
        The touching rows do not keep every body in place.
    """

    def __init__(
        self,
        problem: DualProblem,
        touching: NDArray[np.bool_],
        multiplier: NDArray[np.float64] | None = None,
        directions: Directions | None = None,
        levels: RowLevels | None = None,
        beyond: bool = True,
    ) -> None:
        self.problem, self.touching = problem, touching
        self._beyond = beyond
        self._levels = levels or RowLevels(problem, thinned=False)
        directions = directions or Directions(problem)
        recycled = Recycled(directions, touching)
        self.glued = problem.face(touching, multiplier)
        assert self.glued.coarse is not None
        if not recycled.empty:
            self.glued.move_offset(*recycled.best(self.glued.rhs))
        if not problem.held_without_contact:
            self._check_coarse_problem()
        # no penalty here: steps that leave the range of P would meet no curvature, and none does
        own = FacePreconditioner(self.glued, math.inf)
        operator = RecordedOperator(self.glued, directions)
        preconditioner = DeflatedPreconditioner(own, recycled, operator)
        self._iterate = it = Iterate(BoxQP(operator, self.glued.rhs), preconditioner=preconditioner)
        it.largest = directions.largest  # rounding errors are those of F, not of what is left of it
        it.measure_b()
        it.begin()
        it.counts.hessian += 1  # of the right-hand side
        self._weight = it.reduction.norm(self.glued.offset)
        self._most, self._stalls = STALLED * problem.comm.allreduce(problem.size), False
        self._before = it.reduction.collectives

    def _check_coarse_problem(self) -> None:
        """Q is a projection unless G Gᵀ of the face is singular, which a factor need not see."""
        problem, coarse = self.problem, self.glued.coarse
        assert coarse is not None
        once, twice = np.empty(problem.size), np.empty(problem.size)
        coarse.apply(np.where(self.problem.inequality & ~self.touching, 0.0, problem.d), once)
        coarse.apply(once, twice)
        size = largest_magnitude(problem.comm, once)
        if not largest_magnitude(problem.comm, twice - once) <= IDEMPOTENT * size:
            raise ArithmeticError("the coarse problem of a face is singular")

    @property
    def residual(self) -> float:
        """Of conjugate gradients, relative to the right-hand side."""
        it = self._iterate
        return it.projected_gradient_norm / (it.b_norm or 1.0)

    def error(self, strained: float) -> float:
        """Estimate of the error of the multipliers in energy norm, over that of the strains.

        The preconditioner M stands for F⁻¹ in rᵀ F⁻¹ r, the square of the error.
        """
        it = self._iterate
        square = self.problem.comm.allreduce(float(it.z @ it.free))
        return math.sqrt(max(square, 0.0) / strained) if strained > 0.0 else 1.0

    @property
    def at_round_off(self) -> bool:
        """Whether no step can make the residual smaller."""
        it = self._iterate
        return it.at_round_off() or it.projected_gradient_norm <= self._smallest or self._stalls

    @property
    def _smallest(self) -> float:
        """Residual that round-off leaves: of the right-hand side, and of what it was made of."""
        it = self._iterate
        floor = max(self.glued.round_off, ROUNDED * it.largest * self._weight)
        return floor if it.counts.cg <= SHORT else max(floor, OUTSIDE * self._outside)

    @cached_property
    def _outside(self) -> float:
        """Norm of the right-hand side outside the range of P (collective)."""
        assert self.glued.coarse is not None
        outside = np.empty(self.problem.size)
        self.glued.coarse.apply_transpose(self.glued.rhs, outside)
        return self._iterate.reduction.norm(outside)

    @property
    def counts(self) -> Counts:
        """Work so far."""
        it = self._iterate
        return replace(it.counts, collectives=it.reduction.collectives - self._before)

    def solve(
        self, inner: MPRGP, aim: float, monitor: Monitor | None, keep: Keep | None = None
    ) -> Reason:
        """Go on to a relative residual, directions kept; `inner` limits all iterations of it."""
        self._iterate.watch = None if keep is None else keep.watch(self)

        def stop(it: Iterate) -> Reason | None:
            tolerance = max(aim * it.b_norm, self._smallest)
            if it.projected_gradient_norm <= tolerance and it.drift > 0.5 * tolerance:
                it.evaluate()  # recurrences lost what the tolerance asks for
            if it.projected_gradient_norm <= tolerance:
                return Reason.CONVERGED
            self._stalls = it.counts.cg >= self._most
            return Reason.ROUND_OFF if self._stalls else None

        try:
            return inner.minimise(self._iterate, stop, monitor)
        finally:
            self._iterate.watch = None  # it knows the face, which would keep itself alive

    def state(self) -> State:
        """What the iterate means for the whole problem (collective).

        Takes no product: the directions' displacements were kept.
        """
        problem, it = self.problem, self._iterate
        assert self.glued.coarse is not None
        assert problem.coarse is not None
        multiplier = self.glued.offset + it.x
        assert it.image is not None
        u = self.glued.displacements_of_offset - it.image
        strained = problem.strain_energy(multiplier, u)
        jumps = problem.residual(u)  # d - F λ
        alpha = -self.glued.coarse.coefficients(jumps)
        kernel_part = np.empty(problem.size)
        problem.coarse.extend(alpha, kernel_part)
        jumps += kernel_part
        add_motions(problem, alpha, u)
        lengths = problem.bodies.of_rows(problem.lengths(u))
        return State(multiplier, alpha, self.touching, jumps, lengths, u, strained)

    def look(self) -> tuple[State, NDArray[np.bool_]]:
        """The state, and the contact rows that touch next (collective)."""
        problem, state = self.problem, self.state()
        multiplier, jumps = state.multiplier, state.jumps
        distance = state.distance(problem)
        error = SIGNIFICANT * self.error(state.strained)
        strongest = largest_magnitude(problem.comm, multiplier[self.touching])
        stays = multiplier > -error * strongest
        if self._beyond:
            stays &= ~mirrored(problem, self.touching, self.touching & ~stays)
        for _ in range(2):
            crossed = self._levels.allowed & (distance > error)
            if not problem.comm.allreduce(int(self.touching.sum())):
                crossed &= self._reached_first(jumps, crossed)
            following = problem.inequality & np.where(self.touching, stays, crossed)
            changes = problem.comm.allreduce(int((following != self.touching).sum()))
            if changes or self._levels.finest:
                break
            self._levels.refine()
        return state, following

    def _reached_first(
        self, jumps: NDArray[np.float64], crossed: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Crossed rows that a growing load closes first; with them closed others may stay open.

        Parameters
        ----------
        jumps : (dual,)
            B u - c of the full load without contact; B u grows with the load.
        """
        gaps = np.maximum(self.problem.c, 0.0)
        moved = np.where(crossed, jumps + self.problem.c, 1.0)
        share = np.where(crossed, gaps / np.where(moved > 0.0, moved, 1.0), np.inf)
        first = self.problem.comm.allreduce(float(share.min(initial=np.inf)), op=MPI.MIN)
        return np.asarray(share <= first + FIRST * (1.0 - first))


def decide(
    face: Face,
    inner: MPRGP,
    lacks: Lacks,
    accept: Accept,
    monitor: Monitor | None,
    keep: Keep | None = None,
    first_look: float = FIRST_LOOK,
    eager: bool = False,
) -> Outcome:
    """Solve a face until it asks for another, or its answer is accepted.

    Parameters
    ----------
    lacks
        Asked again after each answer that is not accepted.
    first_look
        Reduction of the residual before the first look.
    eager
        Whether an answer will do although the face asks for another.
    """
    aim, looks = first_look * face.residual, 0
    while True:
        ended = face.solve(inner, aim, monitor, keep)
        state, following = face.look()
        if not (ended.converged or ended is Reason.ROUND_OFF):
            return Outcome(ended, state, following, face.counts)
        changes = face.problem.comm.allreduce(int((following != face.touching).sum()))
        lack = lacks(state) if eager or not changes else math.inf
        if lack <= 1.0 or (not changes and face.at_round_off):
            if accept(state):
                return Outcome(Reason.ACCEPTED, state, following, face.counts)
            if not changes and face.at_round_off:
                return Outcome(Reason.ROUND_OFF, state, following, face.counts)
            lack = max(lacks(state), MARGIN / TIGHTEN)
        if changes:
            return Outcome(None, state, following, face.counts)
        looks += 1
        needed = MARGIN * face.residual / max(lack, 1.0)
        if eager:
            aim = max(needed, EAGER_LOOK * face.residual)
        else:
            aim = needed if looks >= LOOKS else max(needed, NEXT_LOOK * face.residual)


def follow(
    problem: DualProblem,
    inner: MPRGP,
    multiplier: NDArray[np.float64] | None,
    touching: NDArray[np.bool_],
    lacks: Lacks,
    accept: Accept,
    monitor: Monitor | None,
    keep: Keep | None = None,
    eager: bool = False,
    fewer: Guess | None = None,
) -> Outcome:
    """Active sets from the contact rows that touch, until an answer is accepted.

    Parameters
    ----------
    multiplier : (dual,)
        Where the first face begins; as for `Face`.
    lacks, eager
        As in `decide`.
    fewer
        Another guess of what touches, asked where rows open face after face from the first on: of
        bodies that lie flat and lift off for the most part, faces alone peel row after row.

    Returns
    -------
    The last outcome, with the work of all faces; its reason is None where they did not settle.
    """
    counts = Counts()
    seen: set[int] = set()
    beyond = True
    found = Outcome(None, None, touching, counts)
    directions = Directions(problem)
    levels = RowLevels(problem, thinned=problem.held_without_contact and multiplier is None)
    touching = touching & levels.allowed
    first_look = FIRST_LOOK if levels.finest else THINNED_LOOK
    for number in range(FACES):
        fingerprint = hash(tuple(problem.comm.allgather(hash(touching.tobytes()))))
        if fingerprint in seen:  # decided too early, or the sets do not settle
            first_look *= DEEPER
            beyond = False
            seen.clear()
        seen.add(fingerprint)
        try:
            face = Face(problem, touching, multiplier, directions, levels, beyond)
        except ArithmeticError:  # a body is kept by rows that have opened
            break
        left = replace(inner, max_iterations=inner.max_iterations - counts.inner)
        try:
            found = decide(
                face, left, lacks, accept, monitor,
                keep and replace(keep, before=counts), first_look, eager,
            )  # fmt: skip
        except QPError:  # the rows that touch keep a body so badly that rounding lets it go
            counts = counts + face.counts
            found = Outcome(None, None, touching, counts)
            break
        counts = counts + found.counts
        # its B and coarse problem, before the next has its own: petsc4py leaves them for later
        del face
        PETSc.garbage_cleanup(problem.comm)
        if found.reason is not None or found.state is None:
            break
        following = found.following
        if fewer is not None and not _peels(problem.comm, touching, following):
            fewer = None
        if fewer is not None and number == 1:  # the second face in a row peels
            following, fewer = following & fewer(), None
        multiplier, touching = found.state.multiplier, following
    return replace(found, counts=counts)


def _peels(comm: MPI.Intracomm, touching: NDArray[np.bool_], following: NDArray[np.bool_]) -> bool:
    """Whether contact rows open in number and none closes (collective)."""
    closed, opened, before = comm.allreduce(
        np.array([(following & ~touching).sum(), (touching & ~following).sum(), touching.sum()])
    )
    return not closed and bool(opened > PEELED * before)
