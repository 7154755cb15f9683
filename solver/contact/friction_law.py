"""Coulomb's and Tresca's law of friction for the active-set loop.

A point sticks, with its tangential rows in the active set, or slides, with a prescribed slip
traction of size s in the direction d of its slip. For Coulomb's law s = μ λ_n of the last state;
for Tresca's law s is given. So every set is a symmetric problem. After a set is solved,

* a sticking point whose force exceeds its limit slides in the direction of that force;
* a sliding point that slips against d sticks;
* for other sliding points limit and direction follow the state: the new d is the direction of
  s d + ρ w with the slip w. In space λ_t = s w / |w| is not linear in w; a set uses its derivative:
  λ_t = s d along d, and λ_t = (s / |w|) w across d, a compliance |w| / s of the row across.

A node may be in several contacts. If it sticks in one contact, it could not move along that surface
to close the gap of another contact; without a gap the friction force would be undetermined. So a
point that sticks while its node is closed in another contact has the slip w = C (λ_t - λ_t'), λ_t'
its force before and C a small compliance: the proximal point method (R. T. Rockafellar, Math. Oper.
Res. 1, 1976). It comes to rest where w = 0, or its force grows until it slides.

Points open and close by Signorini's law. The rules are the semismooth Newton method for
Tresca friction (G. Stadler, *Path-following and augmented Lagrangian methods for contact problems
in linear elasticity*, 2007, in the plane), with a fixed point over slip limits. Tractions that
change by less than the error of the state are left as they are, in space only while nothing else
changes: once a set changes, all directions follow the state. Directions that lag behind let points
with small limits slip against their force. Points behind the front that the force beyond its limits
would overload slide at once (`solver.contact.slip_front`).
Where points lock, a part of their friction is a spring (`solver.contact.slip_springs`).
"""

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from solver.backend import Relaxation, SetState, Statuses, Turn
from solver.contact.active_set_options import ActiveSetOptions, Failure, SetHistory
from solver.contact.friction_points import AT_LIMIT, FrictionPoints
from solver.contact.law import ContactLaw, StateError
from solver.contact.slip_front import SlipFront
from solver.contact.slip_limits import History, combined
from solver.contact.slip_springs import with_springs
from solver.vectors import Array, Mask

FAINT = float(np.finfo(np.float64).tiny)
"""Compliance of a sliding point that has no slip yet.

It distinguishes its rows from sticking rows.
"""


@dataclass(frozen=True)
class FrictionOptions:
    """The tuned numbers of the law."""

    turn: float = 1.5
    """ρ is this factor times the largest slip limit over the largest slip. Larger factors overshoot
    where the slips are no larger than those that the tractions themselves cause."""
    yields: float = 0.3
    """Largest ρ of a point over its stiffness. In small increments directions that were right
    turned farther in each set: `boxes_pushed` of `contact_app.studies.friction_cost` takes four
    times the operator applications without."""
    round_off: float = 1e-13
    """Changes of tractions that count as zero, over the largest multiplier."""
    soft: float = 1.5
    least_slip: float = 0.5
    """If no point sticks, compliance of a sliding point over its slip, which is at least this share
    of the largest slip, per force."""
    sticking_compliance: float = 0.03
    """Compliance of a point that sticks while its node is closed in another contact, over that of
    the node: slips fall to about this share in each set."""
    turns_about: float = 0.5
    """Share of the last change of the limits that the next change has to undo before changes of
    limits are relaxed, as those of a cone in a cone turn about by 0.7. Scenes whose limits settle
    need no relaxation."""
    least_share: float = 0.1
    """Smallest share of a change that is taken. Limits of a slender wedge turn about by 5."""
    aligned: float = 0.7
    """Least cosine of the angle between two changes of the limits on one set, from which on limits
    are extrapolated."""
    memory: int = 5
    """Number of earlier limits from which they are extrapolated."""
    same: float = 0.75
    many: int = 8
    """Points that slide in two sets in a row, over those that slide in one of them, and their
    number, from which on they may lock: few points lock by chance."""
    spring: float = 0.6
    least_spring: float = 0.1
    """Share of the friction of locked points that is a spring, as in a tapered hole, and share
    below which none is."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Friction(ContactLaw):
    """Signorini's conditions along normals, Coulomb's or Tresca's law in tangential rows."""

    name: str = "friction"
    settles: bool = False
    may_vanish: bool = False
    """Whether all bodies are held without contact, so that the forces may vanish."""
    points: FrictionPoints
    """This rank's contact points with friction."""
    comm: MPI.Intracomm
    """Communicator of all ranks."""
    stiffness: Array  # (points,)
    """Force per slip of each point alone."""
    shared_compliance: Array | None = None  # (k,)
    """Compliance of each tangential row where its node is closed in another contact; None on all
    ranks where no node is in several."""
    has_gap: Mask | None = None  # (points,)
    """Points that have a gap before any load; None for none."""
    front: SlipFront | None = None
    """Finds the points to release ahead of the set that would show that they slide; None for no
    such points."""
    locks: bool = False
    """Whether points that lock have springs. In Total FETI conjugate gradients converge slowly with
    them."""
    options: FrictionOptions = FrictionOptions()

    def failure(
        self, options: ActiveSetOptions, history: SetHistory, first: bool
    ) -> Failure | None:
        """Forces that vanish though a body needs them, and contact that peels off or changes."""
        if options.vanish(history.strained) and not self.may_vanish:
            return Failure.VANISHED
        first = first and options.settling > 0
        if first and not options.may_peel and options.loses_rows(history.turnovers):
            return Failure.PEELS
        return Failure.UNSETTLED if first and options.is_unsettled(history.turnovers) else None

    def locking(self) -> "Friction":
        """The law with `locks`."""
        return replace(self, locks=True)

    def with_limits(self, limits: Array) -> "Friction":
        """Tresca's law with these limits."""
        none = np.zeros_like(limits)
        points = replace(self.points, coefficients=none, limits=limits)
        return replace(self, points=points, front=None)

    def initial(
        self, active: Mask, multiplier: Array | None, ahead: bool, jumps: Array | None = None
    ) -> Statuses:
        """Points in contact stick, and open points with a given limit; if `ahead`, not across gaps.

        Open points that stick carry what contact would carry: on the first sets of a pin in a lug
        all contact opened. Given multipliers of a similar problem, only points below their limit
        stick.
        """
        points = self.points
        closed = active[points.normals[points.first]]
        touching = closed | (points.limits > 0.0)
        sticks, forces = touching, np.zeros(len(points.rows))
        if ahead and self.has_gap is not None:
            sticks = touching & (closed | ~self.has_gap)
        if multiplier is not None:
            forces = points.forces(multiplier)
            size, limit = points.sizes(forces), points.slip_limits(multiplier)
            sticks = touching & (size < (1.0 - AT_LIMIT) * limit)
            slides = (size > 0.0) & touching & ~sticks
            share = np.divide(limit, size, out=1.0 * sticks, where=slides)
            forces = share[points.point] * forces
        slip_compliance = np.zeros(len(points.first))
        if jumps is not None:
            length, limit = points.sizes(points.slips(jumps)), points.sizes(forces)
            slip_compliance = np.divide(length, limit, out=slip_compliance, where=limit > 0.0)
        return self._statuses(active, sticks, forces, slip_compliance)

    def consistent(self, statuses: Statuses) -> Statuses:
        """The statuses without friction at points that are open and have no given slip limit."""
        points = self.points
        normals = self._without_tangents(statuses.active)
        touching = normals[points.normals[points.first]] | (points.limits > 0.0)
        sticks = self._sticking(statuses) & touching
        forces = np.where(touching[points.point], self._prescribed(statuses), 0.0)
        return self._statuses(normals, sticks, forces, np.zeros(len(points.first)))

    def yielding(self, statuses: Statuses, jumps: Array) -> Statuses:
        """Sliding points with springs that resist a change of their slip (collective).

        If no point sticks, friction of given size and direction lets the body go. With springs of
        the compliance C the friction is s d + (w - w') / C, w' the slip before. Points that then
        slip against d stick in the next set. So a belt around a drum finds the point from which it
        slides to both ends. Statuses with springs remain as they are.
        """
        if statuses.springs is not None:
            return statuses
        points = self.points
        before, prescribed = points.slips(jumps), self._prescribed(statuses)
        length, limit = points.sizes(before), points.sizes(prescribed)
        sliding = ~statuses.active[points.rows[points.first]] & (limit > 0.0)
        longest = self.comm.allreduce(float(length.max(initial=0.0)), op=MPI.MAX)
        length = self.options.soft * np.maximum(length, self.options.least_slip * longest)
        stiffness = np.divide(limit, length, out=np.zeros(len(limit)), where=length > 0.0)
        stretched = sliding & (stiffness > 0.0)
        springs = stretched[points.point]
        rows, stiffness = points.rows[springs], stiffness[points.point][springs]
        active, tractions = statuses.active.copy(), np.zeros(len(statuses.active))
        compliance = np.zeros(len(active))
        if statuses.compliance is not None:
            compliance[statuses.active] = statuses.compliance[statuses.active]
        active[rows] = True
        tractions[points.rows] = prescribed / points.spread
        tractions[rows] -= stiffness * before[springs] / points.spread[springs]
        compliance[rows] = points.spread[springs] ** 2 / stiffness
        return Statuses(active, tractions, None, compliance, stretched)

    def following(
        self, normals: Mask, state: SetState, error: StateError, before: Statuses, ahead: bool
    ) -> tuple[Statuses, Mask]:
        """The points that stick from now on, and the tractions of sliding points (collective)."""
        points, multiplier = self.points, state.multiplier
        springs, stuck = self._springs(before), self._sticking(before)
        forces, slips = points.forces(multiplier), points.slips(state.jumps)
        size, length = points.sizes(forces), points.sizes(slips)
        relaxation = self._after_overshoot(multiplier, before, stuck | springs)
        overshot = np.zeros(len(stuck), bool) if relaxation is None else relaxation.residual != 0.0
        normals = normals.copy()
        normals[points.normals[points.first[overshot]]] = True
        touching = normals[points.normals[points.first]]
        limit = self._limits(multiplier, touching, relaxation, before)
        spread = points.spread[points.first]
        slack = error.force * spread

        direction = self._units(forces)
        slid = np.where(springs[points.point], self._units(self._prescribed(before)), direction)
        sticks_again = self._slips_back(state, error, slid, size > 0.0)
        sticks = (limit > 0.0) & np.where(stuck, size <= limit + slack, sticks_again)
        sticks &= ~overshot
        early = np.zeros(len(sticks), bool)
        if ahead and self.front is not None:
            early, shed = self.front.sliding(forces, limit + slack, stuck & (limit > 0.0))
            direction = np.where(early[points.point], self._units(shed), direction)
            sticks &= ~early
        locked = before.relaxation is not None and before.relaxation.spring > 0.0
        slides = (limit > 0.0) & ~stuck & ~sticks & (locked | ~springs)
        if relaxation is None:
            carried = np.where(springs, size, points.sizes(self._prescribed(before)))
            limit, relaxation = self._relaxed(limit, slides, carried, before)
        prescribed = direction * limit[points.point]
        turning = np.where(stuck | overshot, 0.0, self._rho(limit, length, stuck))
        prescribed = self._at_limits(prescribed + turning[points.point] * slips, limit)
        prescribed = np.where(sticks[points.point], forces, prescribed)
        changes = points.sizes(prescribed - self._prescribed(before))
        least = self.options.round_off * error.strongest * spread
        unchanged = (stuck == sticks) & (changes <= np.maximum(slack, least))
        if self._changes_set(~unchanged, touching, before):
            unchanged[points.planar] = False
        slip_compliance = np.divide(
            length, limit, out=np.zeros(len(limit)), where=(limit > 0.0) & ~stuck
        )
        after = self._statuses(normals, sticks, prescribed, slip_compliance)
        guessed = np.zeros(len(normals), bool)
        guessed[points.rows[points.first]] = early
        after = self._with_former_tractions(after, before, unchanged)
        if relaxation.spring > 0.0:
            compliance = slip_compliance / relaxation.spring
            after = with_springs(points, after, slides & touching, compliance, relaxation.spring)
        return replace(after, relaxation=relaxation), guessed

    def _springs(self, statuses: Statuses) -> Mask:
        """Sliding points with springs, (points,)."""
        if statuses.springs is None:
            return np.zeros(len(self.points.first), bool)
        return statuses.springs

    def _sticking(self, statuses: Statuses) -> Mask:
        """Points that stick, (points,)."""
        return statuses.active[self.points.rows[self.points.first]] & ~self._springs(statuses)

    def _limits(
        self, multiplier: Array, touching: Mask, relaxation: Relaxation | None, before: Statuses
    ) -> Array:
        """Slip limits of a state, (points,); relaxed ones at points that overshot."""
        points = self.points
        limit = points.coefficients * np.where(touching, points.pressing(multiplier), 0.0)
        limit = limit + points.limits
        if relaxation is None:
            return limit
        reached = points.sizes(self._prescribed(before)) + relaxation.factor * relaxation.residual
        return np.where(relaxation.residual != 0.0, np.maximum(reached, points.limits), limit)

    def _slips_back(
        self, state: SetState, error: StateError, direction: Array, has_force: Mask
    ) -> Mask:
        """Points that slip against their friction force, or, without a force, do not slip."""
        points, relative = self.points, state.distance[self.points.rows]
        back = points.dots(relative, direction)
        return np.where(has_force, back < -error.distance, points.sizes(relative) <= error.distance)

    def _relaxed(
        self, limit: Array, slides: Mask, carried: Array, before: Statuses
    ) -> tuple[Array, Relaxation]:
        """Limits (points,) between the forces of the state and its limits (collective).

        Where the change of the limits turns about from set to set, the next one is a share of it
        that Aitken's formula gives from the last two (B. M. Irons, R. C. Tuck, *A version of the
        Aitken accelerator for computer iteration*, Int. J. Numer. Methods Eng. 1, 1969), and at
        least twice the last share once they do not. Where they fall and keep their direction, the
        limits are extrapolated by Anderson's method as long as the same points slide. Where they
        turn about and grow, points lock: a share of their friction becomes a spring, which is
        halved once changes keep their direction.

        Parameters
        ----------
        carried : (points,)
            Friction forces of the state.
        """
        options, last = self.options, before.relaxation
        follows = slides & (carried > 0.0) & (self.points.coefficients > 0.0)
        residual, factor = np.where(follows, limit - carried, 0.0), 1.0
        history = self._history(carried, residual, before)
        if last is None:
            return limit, Relaxation(residual, 1.0, history)
        spring = last.spring
        oo, no, nn = self._products(last.residual, residual)
        turns = no < -options.turns_about * oo
        if turns and nn > oo and spring < options.spring and self._locks(before, residual):
            return limit, Relaxation(residual, 1.0, spring=options.spring)
        aligned = no > options.aligned * (oo * nn) ** 0.5
        if aligned and last.factor == 1.0:
            spring = 0.5 * spring if spring > options.least_spring else 0.0
        falls = nn < oo and (aligned or last.extrapolated)
        if len(history) > 1 and last.factor == 1.0 and falls:
            best = np.maximum(combined(self.comm, history), self.points.limits)
            relaxation = Relaxation(residual, 1.0, history, extrapolated=True, spring=spring)
            return np.where(follows, best, limit), relaxation
        change = oo - 2.0 * no + nn
        if change > 0.0 and (turns or last.factor < 1.0):
            least = options.least_share if turns else 2.0 * last.factor
            factor = min(max(last.factor * (oo - no) / change, least), 1.0)
        relaxed = np.where(follows, carried + factor * residual, limit)
        return relaxed, Relaxation(residual, factor, history, spring=spring)

    def _history(self, prescribed: Array, residual: Array, before: Statuses) -> History:
        """Limits and residuals up to these, while the same points slide (collective)."""
        last = before.relaxation
        if last is None:
            return ((prescribed, residual),)
        differ = int(((last.residual != 0.0) != (residual != 0.0)).sum())
        earlier = () if self.comm.allreduce(differ) else last.history
        return (*earlier, (prescribed, residual))[-self.options.memory - 1 :]

    def _after_overshoot(
        self, multiplier: Array, before: Statuses, holds: Mask
    ) -> Relaxation | None:
        """The change of limits if it turns about and grows; else None (collective).

        Limits that are too large push a self-locking wedge out of its seat: it slips back, and its
        normal forces are tensile. Its points stay closed and slide on while the limits are relaxed,
        and tensile forces count in Aitken's formula. Where points stick, others that should open
        would slide on.

        Parameters
        ----------
        holds : (points,)
            Points that stick or have springs.
        """
        points, last = self.points, before.relaxation
        if last is None:
            return None
        prescribed = points.sizes(self._prescribed(before))
        closed = before.active[points.normals[points.first]]
        follows = closed & ~holds & (prescribed > 0.0) & (points.coefficients > 0.0)
        change = points.coefficients * points.normal_forces(multiplier) - prescribed
        residual = np.where(follows, change, 0.0)
        oo, no, nn = self._products(last.residual, residual)
        stick = self.comm.allreduce(int(self._sticking(before).sum()))
        if nn <= oo or no >= -self.options.turns_about * oo or stick:
            return None
        factor = last.factor * (oo - no) / (oo - 2.0 * no + nn)
        spring = self.options.spring if self._locks(before, residual) else last.spring
        return Relaxation(residual, factor, spring=spring)

    def _locks(self, before: Statuses, new: Array) -> bool:
        """Whether points lock if changes of limits (points,) turn about and grow (collective).

        Where points stick, or others slide in each set, the changes say nothing on a spring.
        """
        assert before.relaxation is not None
        old, stuck = before.relaxation.residual != 0.0, self._sticking(before)
        counts = [mask.sum() for mask in (old & (new != 0.0), old | (new != 0.0), stuck)]
        same, points, stick = self.comm.allreduce(np.array(counts))
        enough = same >= max(self.options.same * points, self.options.many)
        return self.locks and bool(enough and not stick)

    def _products(self, old: Array, new: Array) -> tuple[float, float, float]:
        """Products old·old, new·old, new·new of entries that are not zero (collective)."""
        both = (new != 0.0) & (old != 0.0)
        new, old = new[both], old[both]
        oo, no, nn = self.comm.allreduce(np.array([old @ old, new @ old, new @ new]))
        return float(oo), float(no), float(nn)

    def _changes_set(self, points: Mask, touching: Mask, before: Statuses) -> bool:
        """Whether the set changes at points, or in which points are closed (collective)."""
        closed = before.active[self.points.normals[self.points.first]]
        return bool(self.comm.allreduce(int((points | (touching != closed)).sum())))

    def _units(self, forces: Array) -> Array:
        """Directions of forces (k,), zero of none."""
        size = self.points.sizes(forces)[self.points.point]
        return np.divide(forces, size, out=np.zeros(len(forces)), where=size > 0.0)

    def _at_limits(self, forces: Array, limit: Array) -> Array:
        """Forces (k,) in the directions of given forces, as large as their limits (points,)."""
        size = self.points.sizes(forces)
        share = np.divide(limit, size, out=np.zeros(len(limit)), where=size > 0.0)
        return share[self.points.point] * forces

    def _rho(self, limit: Array, length: Array, stuck: Mask) -> Array:
        """ρ (points,), the force per slip that turns slip directions (collective)."""
        sliding = ~stuck & (limit > 0.0)
        references = np.array([limit[sliding].max(initial=0.0), length[sliding].max(initial=0.0)])
        largest = np.max(self.comm.allgather(references), axis=0)
        rho = self.options.turn * largest[0] / largest[1] if largest[1] > 0.0 else 0.0
        return np.asarray(np.minimum(rho, self.options.yields * self.stiffness))

    def _without_tangents(self, active: Mask) -> Mask:
        normals = active.copy()
        normals[self.points.rows] = False
        return normals

    def _prescribed(self, statuses: Statuses) -> Array:
        """Friction forces that statuses prescribe, (k,)."""
        if statuses.tractions is None:
            return np.zeros(len(self.points.rows))
        turn, tractions = statuses.turn, statuses.tractions
        return self.points.forces(tractions if turn is None else turn.back(tractions))

    def _statuses(
        self, normals: Mask, sticks: Mask, forces: Array, slip_compliance: Array
    ) -> Statuses:
        """Statuses of all rows (collective).

        Parameters
        ----------
        sticks : (points,)
        forces : (k,)
            Friction forces of points that slide.
        slip_compliance : (points,)
            |w| / |λ_t| of points that slide.
        """
        points = self.points
        active, tractions = self._without_tangents(normals), np.zeros(len(normals))
        active[points.rows] = sticks[points.point]
        least = self._least_compliance(active)
        held = sticks[points.point] & (least == 0.0)
        tractions[points.rows] = np.where(held, 0.0, forces / points.spread)
        compliance = np.zeros(len(normals))
        compliance[points.rows] = np.where(sticks[points.point], least, 0.0)
        planar = points.planar
        first = points.rows[points.first[planar]]
        second = points.rows[points.first[planar] + 1]
        size = np.hypot(tractions[first], tractions[second])
        turns = (size > 0.0) & ~sticks[planar]
        if not self.comm.allreduce(int(turns.sum())):
            some = self.shared_compliance is not None
            return Statuses(active, tractions, None, compliance if some else None)
        cosine, sine = (
            np.divide(tractions[rows], size, out=np.full(len(size), otherwise), where=turns)
            for rows, otherwise in ((first, 1.0), (second, 0.0))
        )
        tractions[first[turns]] = size[turns]
        tractions[second[turns]] = 0.0
        active[second[turns]] = True
        spread = points.spread[points.first[planar]]
        across = np.maximum(least[points.first[planar] + 1], FAINT)
        compliance[second[turns]] = np.maximum(slip_compliance[planar] * spread**2, across)[turns]
        return Statuses(active, tractions, Turn(first, second, cosine, sine), compliance)

    def _least_compliance(self, active: Mask) -> Array:
        """Compliance that active tangential rows have at least.

        Above zero where nodes are closed twice.
        """
        points = self.points
        if self.shared_compliance is None:
            return np.zeros(len(points.rows))
        elsewhere = np.bincount(points.shared, active[points.other_rows], len(points.first)) > 0.0
        return np.where(elsewhere[points.point], self.shared_compliance, 0.0)

    def _with_former_tractions(
        self, after: Statuses, before: Statuses, unchanged: Mask
    ) -> Statuses:
        """The statuses `after`, with the tractions of `before` at some sliding points (points,)."""
        points = self.points
        if before.tractions is None or after.tractions is None or not unchanged.any():
            return after
        rows = points.rows[unchanged[points.point]]
        tractions = after.tractions.copy()
        tractions[rows] = before.tractions[rows]
        after = replace(after, tractions=tractions)
        if after.turn is None or before.turn is None:
            return after
        unchanged_planar = unchanged[points.planar]
        cosine, sine = (
            np.where(unchanged_planar, getattr(before.turn, name), getattr(after.turn, name))
            for name in ("cosine", "sine")
        )
        return replace(after, turn=replace(after.turn, cosine=cosine, sine=sine))
