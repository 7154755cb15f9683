"""The history of the active-set loop, and the tuned numbers by which it is judged."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Self


@dataclass(frozen=True)
class Turnover:
    """Contact rows that change with a set, on all ranks."""

    joined: int
    left: int
    """Rows that join the next set, and that leave this set."""
    closed: int
    """Active rows of this set."""

    @property
    def peeled(self) -> int:
        """Rows that leave; zero if any joins."""
        return 0 if self.joined else self.left


@dataclass(frozen=True)
class SetHistory:
    """The sets of a loop."""

    turnovers: tuple[Turnover, ...] = ()
    """Changes of contact rows from set to set."""
    on_all_rows: tuple[Turnover, ...] = ()
    """The changes on the finest level of the constraint hierarchy."""
    strained: tuple[float, ...] = ()
    """a(u, u) of each set."""

    def after(self, turnover: Turnover, finest: bool, strained: float) -> "SetHistory":
        """The history with one set more."""
        on_all_rows = (*self.on_all_rows, turnover) if finest else self.on_all_rows
        return SetHistory((*self.turnovers, turnover), on_all_rows, (*self.strained, strained))


class Failure(Enum):
    """Why sets did not settle."""

    AHEAD = "points were released ahead of a state"
    UNSETTLED = "with friction each set has other contact"
    PEELS = "with friction contact peels off row by row"
    VANISHED = "forces that only cause each other fell to zero"
    OTHER = "other reasons"


@dataclass(frozen=True)
class ActiveSetOptions:
    """The tuned numbers of the active-set loop, each with the reason for its value."""

    most_sets: int = 60
    """Largest number of active sets. Where contact peels off row by row, each set costs a handful
    of operator applications."""
    first_reduction: float = 0.3
    next_reduction: float = 0.1
    """Reduction of the residual before the first evaluation of the KKT residuals on a set and
    between later ones."""
    sets_before_levels: int = 8
    """Number of sets on all contact rows after which the loop begins anew on the coarsest level of
    the constraint hierarchy. Most contact of thin bodies settles in fewer sets: a disc pressed on a
    plane (`configs/cylinder.yaml`) takes 67 operator applications, and 149 on levels. With friction
    there are no levels, since points outside of a level would carry no friction."""
    steady: float = 0.5
    """The loop begins on levels earlier if rows leave in two sets in a row and no row joins, the
    second time at least by this ratio to the number of the first time. Where Newton's method
    converges, the numbers fall faster."""
    few: int = 2
    """Number of rows that leave at any edge of contact, whether it peels off or not."""
    coarse_reduction: float = 0.1
    """`first_reduction` on the coarser levels of the constraint hierarchy: the next level has to
    undo wrong decisions of a coarser one."""
    evaluations: int = 3
    """Evaluations on a set before it is solved to the end."""
    significant: float = 0.1
    """Relative forces and distances from which on a row changes its status, over the estimate of
    the error."""
    negligible: float = 0.0
    """Tensile multipliers, over the largest multiplier, that do not release a row. Where nothing
    but a row without a force stops a body from turning, the load, not quite balanced as drawn,
    pulls it open and the free body closes it again, set after set."""
    largest_error: float = math.inf
    """Estimate of the error in energy norm, over the energy norm of the answer, above which the
    answer on a set does not change the set."""
    first_share: float = 0.02
    """The contacts that close within this share of the load after the first contact closes join an
    empty set."""
    margin: float = 0.7
    """Share of the largest admissible jump below which an answer is given to the stopping test."""
    tighten: float = 0.3
    """Factor on the residual after a rejected answer."""
    deeper: float = 0.1
    """Factor on `first_reduction` each time the loop returns to an earlier set."""
    patience: int = 0
    """Number of sets after which `first_reduction` is multiplied by `tighten`: with friction no two
    sets are equal, so the loop cannot detect a decision made too early by a repeated set. Zero for
    never."""
    careful: float = 0.1
    """After as many sets more, repeatedly, factor on `first_reduction` and on `largest_error`, for
    thin bodies that friction alone holds. Scenes that settle sooner would only pay for it."""
    peeled: float = 0.1
    """Share of the active rows that leave in two sets in a row, from which on the contact is said
    to peel off."""
    settling: int = 8
    unsettled: float = 0.25
    """With friction the loop begins anew from the contact without friction if at least this many
    sets did not settle, each of the last three changed this share of the closed rows, and as many
    joined in these three together. Friction forces of a wrong contact are wrong, too. In thirteen
    scenes of `contact_app.studies.friction_cost` the share is below 0.25 from the sixth set on."""
    insists: bool = True
    """Whether the loop goes on where each set has other contact, or where no contact without
    friction is found from which it could begin anew. Multigrid goes on with the augmented
    Lagrangian instead, since sets of further runs do not settle, either."""
    vanishing: float = 0.1
    """With friction all contact is opened once a(u, u) fell below this factor of its value in each
    of three sets in a row, if no body needs contact. Where bodies touch and no load presses them,
    contact and friction forces of a set cause each other. They fell to a fifth in each set, and
    twenty sets later, at rounding errors, the answer was not certified."""
    stuck_again: float = 0.1
    """Tangential rows that stick after a set without sticking points, over the rows of the sliding
    points in that set. If they are so many after two such sets, the points of the next such set
    yield. A split ring (`test_split_ring.py`) has 0.1 to 0.7 and does not settle without; hub and
    bracket with friction take more operator applications if points yield sooner."""
    sliding: int = 20
    """Number of sets in a row without a point that sticks, after which friction is said not to hold
    a body. A belt around a drum has at most seven at 0.99 of its largest load, and slides on at its
    largest load."""
    jumping: int = 8
    """Without friction, number of sets in a row with rows that join, each with at least as many
    changed rows as an earlier one with such rows, after which the sets are said not to settle. The
    first set, begun from coarse levels, may lose few rows only: a tray whose contact grows in all
    further sets took 122 and 127 operator applications on two and three ranks, and 61 on one."""
    may_peel: bool = True
    """Whether sets go on where contact peels off and there is no constraint hierarchy. Where a
    factor is affordable, multigrid goes on otherwise: by factors on the constraint hierarchy for
    thin bodies, by the augmented Lagrangian for others."""
    peeling: int = 4
    """Number of sets in a row from each of which many rows leave and which no row joins, after
    which contact peels off in this sense. With two a bar in a vee and a cup on a ball
    (`meshes/samples/make_trials.py`) take half as many operator applications again."""
    dropped: float = 0.1
    many: int = 10
    """Share of the active rows, and number of rows, that leave with one set, from which on the
    backend may correct the next set (`Backend.corrected_contact`): alone the sets would lose a few
    rows each."""
    early_release: bool = True
    """Whether a law may release points before the state of a set shows that they slide
    (`solver.contact.slip_front`), and points with a gap slide in the first set. Where such
    sets fail, Total FETI runs the loop once more without."""

    def with_friction(self) -> Self:
        """The options with friction.

        With a patience of six scenes of `contact_app.studies.friction_cost` take 5 % more operator
        applications. Errors are limited since sliding rows with small limits have large
        compliances, so that a small residual leaves a large error.
        """
        return replace(self, patience=12, largest_error=0.3)

    def peels(self, sets: Sequence[Turnover]) -> bool:
        """Whether contact peels off in the last two sets."""
        if len(sets) < 2:
            return False
        before, last = sets[-2].peeled, sets[-1].peeled
        return 0 < self.steady * before <= last and last > self.few

    def peels_on(self, sets: Sequence[Turnover]) -> bool:
        """Whether contact has peeled off in so many sets that more of the kind would follow."""
        last = sets[-self.peeling :]
        return self.peels(sets) and len(last) == self.peeling and self.all_peel(last)

    def loses_rows(self, sets: Sequence[Turnover]) -> bool:
        """Whether contact peels off in the last sets, if only by a row each."""
        last = sets[-self.peeling :]
        return self.peels(sets) or (len(last) == self.peeling and all(t.peeled for t in last))

    def all_peel(self, sets: Sequence[Turnover]) -> bool:
        """Whether many rows left in each set, and no row joined."""
        return all(t.peeled > self.peeled * t.closed for t in sets)

    def drops(self, last: Turnover) -> bool:
        """Whether many rows leave the last set, more than join."""
        return last.left > last.joined and last.left >= max(self.many, self.dropped * last.closed)

    def vanish(self, strained: Sequence[float]) -> bool:
        """Whether the energies a(u, u) of the last sets, the last one last, fall towards zero."""
        last = strained[-4:]
        falls = zip(last, last[1:], strict=False)
        return len(last) == 4 and all(after < self.vanishing * before for before, after in falls)

    def jumps(self, sets: Sequence[Turnover]) -> bool:
        """Whether the number of changed rows does not fall, and rows join in each set."""
        earlier = [t.joined + t.left for t in sets[: -self.jumping] if t.joined]
        last = [t.joined + t.left for t in sets[-self.jumping :] if t.joined]
        return bool(earlier) and len(last) == self.jumping and min(last) >= min(earlier)

    def is_unsettled(self, sets: Sequence[Turnover]) -> bool:
        """Whether contact does not settle: many rows change in each set, and many join."""
        if not 0 < self.settling <= len(sets):
            return False
        last = sets[-3:]
        joined, closed = sum(t.joined for t in last), sum(t.closed for t in last)
        return joined >= self.unsettled * closed and all(
            t.joined + t.left >= self.unsettled * (t.closed + t.joined) for t in last
        )
