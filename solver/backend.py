"""The protocol of a backend: the active-set loop asks it to solve on a given active set.

A contact row is one direction at one contact point: its normal, or a direction of its tangential
frame. On a set the rows that are active hold with equality (closed in the normal, sticking in the
frame); the multipliers of all others are prescribed: zero where the point is open, the slip
traction where it slides. In space statuses may turn the frames, so that the first of the two
directions is that in which a point slides; in the second one the row has a compliance C,
B u - c = C λ. So a backend is independent of the contact law (`solver.contact.law`), and a contact
law is independent of the backend.
"""

from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from mpi4py import MPI
from scipy import sparse

from solver.qp.iterate import Watch
from solver.qp.mprgp import MPRGP
from solver.qp.result import Counts, Monitor, Reason
from solver.vectors import Array, Ints, Mask


@dataclass(frozen=True, eq=False)
class Turn:
    """Tangential frames of this rank's contact points in space, turned in their planes."""

    first: Ints
    second: Ints
    """The two tangential rows of each point. Shape (points,)."""
    cosine: Array
    sine: Array
    """Cosine and sine of the angle from the old first direction to the new first direction. Shape
    (points,)."""

    def turned(self, x: Array) -> Array:
        """Components (rows,) in the turned frames, from components in the original frames."""
        result, one, other = x.copy(), x[self.first], x[self.second]
        result[self.first] = self.cosine * one + self.sine * other
        result[self.second] = self.cosine * other - self.sine * one
        return result

    def matrix(self, rows: int) -> sparse.csr_matrix:
        """The matrix (rows, rows) by which rows of another matrix are turned."""
        diagonal, pairs = np.ones(rows), (self.first, self.second)
        diagonal[self.first] = diagonal[self.second] = self.cosine
        places = np.concatenate(pairs), np.concatenate(pairs[::-1])
        across = sparse.csr_matrix((np.concatenate([self.sine, -self.sine]), places), (rows, rows))
        return sparse.csr_matrix(sparse.diags(diagonal) + across)

    def back(self, x: Array) -> Array:
        """Components (rows,) in the original frames, from components in the turned frames."""
        return replace(self, sine=-self.sine).turned(x)


@dataclass(frozen=True, eq=False)
class Relaxation:
    """The last step of a fixed point over slip limits, this rank's points."""

    residual: Array  # (points,)
    """Limits of the last state minus the limits that were prescribed; zero where a point does not
    slide."""
    factor: float
    """Share of this change that was taken."""
    history: tuple[tuple[Array, Array], ...] = ()
    """Prescribed limits and residuals (points,) of the last states whose points all slid."""
    extrapolated: bool = False
    """Whether the limits are a combination of these."""
    spring: float = 0.0
    """Share of the friction forces that is a spring along the slip."""


@dataclass(frozen=True, eq=False)
class Statuses:
    """The status of each row while a backend solves; local parts."""

    active: Mask  # (rows,)
    """Contact rows that hold with equality."""
    tractions: Array | None = None  # (rows,)
    """Prescribed multipliers of the contact rows that are not active. For an active row with a
    compliance, the traction without a displacement of the row (see `compliance`). None where all
    are zero."""
    turn: Turn | None = None
    """Frames of the rows in all of these arrays; None on all ranks where no frame is turned."""
    compliance: Array | None = None  # (rows,)
    """C of the active rows in B u - c = C (λ - traction), zero for most; None on all ranks where C
    is zero for all rows."""
    springs: Mask | None = None  # (points,)
    """Sliding points of a friction law whose rows are active with a compliance, as springs; None
    for none. Backends do not need it."""
    relaxation: Relaxation | None = None
    """How the law came from the last state to these statuses; backends do not need it."""

    @property
    def holding(self) -> Mask:
        """Rows of the original frames whose jump B u - c is held at zero, (rows,)."""
        if self.compliance is None:
            return self.active
        return self.active & (self.compliance == 0.0)

    def changed(self, other: "Statuses") -> Mask:
        """Rows whose status, prescribed multiplier or frame differs."""
        differs = self.active != other.active
        if self.tractions is not None or other.tractions is not None:
            first, second = (0.0 if s.tractions is None else s.tractions for s in (self, other))
            meant = ~self.holding | ~other.holding
            differs = differs | (meant & np.not_equal(first, second))
        if self.turn is not None or other.turn is not None:
            differs = differs | (self._angles() != other._angles())
        return differs

    def _angles(self) -> Array:
        """The sine of the turn, plus two where its cosine is negative, (rows,)."""
        result = np.zeros(len(self.active))
        if self.turn is not None:
            result[self.turn.first] = self.turn.sine + 2.0 * (self.turn.cosine < 0.0)
        return result

    def fingerprint(self, comm: MPI.Intracomm) -> int:
        """A number that is equal for equal statuses only, but for coincidence (collective)."""
        tractions = b"" if self.tractions is None else self.tractions.tobytes()
        angles = b"" if self.turn is None else self._angles().tobytes()
        return hash(tuple(comm.allgather(hash((self.active.tobytes(), tractions, angles)))))


@dataclass(frozen=True, eq=False)
class SetState:
    """The approximate answer on a set; local parts. A backend adds the data that it needs."""

    multiplier: Array  # (rows,)
    """λ."""
    active: Mask  # (rows,)
    """Contact and tangential rows that hold with equality."""
    jumps: Array  # (rows,)
    """B u - c."""
    sizes: Array  # (rows,)
    """Reference of each row's jump: the displacement of the row's body. In contact rows it is
    divided by the row's length, so that jumps over references are relative distances."""
    strained: float
    """a(u, u), twice the energy of the strains."""

    @property
    def distance(self) -> Array:
        """Jumps, and penetrations of contact rows, over the displacement of the row's body."""
        return self.jumps / self.sizes

    @property
    def closing(self) -> Array:
        """The distances by which rows close."""
        return self.distance


S = TypeVar("S", bound=SetState)
Out = TypeVar("Out", bound=SetState, covariant=True)


class SetSolve(Protocol[Out]):
    """The problem on one set of statuses, solved to the residual that the caller asks for."""

    @property
    def statuses(self) -> Statuses:
        """Statuses of the rows on this set."""

    @property
    def residual(self) -> float:
        """2-norm of the residual over that of the right-hand side."""

    @property
    def at_round_off(self) -> bool:
        """Whether rounding errors keep the residual from becoming smaller."""

    @property
    def counts(self) -> Counts:
        """Operator applications and steps so far."""

    def solve(
        self, inner: MPRGP, residual: float, monitor: Monitor | None, watch: Watch | None = None
    ) -> Reason:
        """Iterate down to a relative residual; `inner` limits the iterations (collective)."""

    def state(self) -> Out:
        """The approximate answer of the present iterate (collective)."""

    def error(self, strained: float) -> float:
        """Estimate of the error in energy norm, relative to that of the strains (collective)."""


@dataclass(frozen=True, eq=False)
class ConstraintHierarchy:
    """Constraint hierarchy: the contact rows that may close, level by level."""

    every: Mask  # (rows,)
    """Mask of all contact rows."""
    coarse: tuple[Mask, ...] = ()  # masks (rows,)
    """Contact rows of this level and of coarse levels after it; empty on the finest level."""

    @property
    def allowed(self) -> Mask:
        """Contact rows of the level, (rows,)."""
        return self.every if self.finest else self.coarse[0]

    @property
    def finest(self) -> bool:
        """Whether all rows are allowed."""
        return not self.coarse

    def finer(self) -> "ConstraintHierarchy":
        """The hierarchy from the next level on."""
        return replace(self, coarse=self.coarse[1:])


class SharedPlace:
    """A place for the matrices of a backend that problems under other loads share.

    It is state of a run, no record: a solve takes the matrices out and leaves its own, so that
    matrices that do not fit are freed before new ones are made.
    """

    def __init__(self) -> None:
        self._content: object = None

    def take(self) -> object:
        """The matrices of the last solve, which are no longer here; None before the first one."""
        content, self._content = self._content, None
        return content

    def leave(self, content: object) -> None:
        """Put matrices in place of those of the last solve."""
        self._content = content


class Backend(Protocol[Out]):
    """A discrete contact problem and a way to solve it on given statuses."""

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""

    @property
    def contact_rows(self) -> Mask:
        """Mask of the contact rows among the local rows, (rows,)."""

    @property
    def c(self) -> Array:
        """Right-hand side of the rows, (rows,); the gap in contact rows."""

    def on_set(self, statuses: Statuses, multiplier: Array | None) -> SetSolve[Out]:
        """The problem of a set, beginning near a multiplier if one is given (collective).

        Raises
        ------
        ArithmeticError
            The active rows do not hold every body in place.
        """

    def estimated_contact(self) -> Mask:
        """Contact rows that close in a small model of the bodies, (rows,) (collective)."""

    def corrected_contact(self, multiplier: Array) -> Mask | None:
        """Contact rows that close near the last state in a small model, (rows,) (collective).

        None where the backend has no such model.

        Parameters
        ----------
        multiplier : (rows,)
            λ of that state.
        """

    def hierarchy(self, coarsened: bool) -> ConstraintHierarchy:
        """The constraint hierarchy (collective).

        Parameters
        ----------
        coarsened
            Whether thin bodies get coarser levels; else there is one level with all rows.
        """

    def release(self) -> None:
        """Free the memory of the last set before the next set is made (collective)."""

    def forget(self) -> None:
        """Drop the data that earlier sets left for later ones.

        After a failed set they may be inaccurate.
        """
