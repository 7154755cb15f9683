"""Acceptance of an estimate: two successive meshes of a run have to agree on it.

If answers on all meshes are admissible in the continuum, the energies J(u_h) decrease to that of
the true answer u, and ‖u - u_h‖² = 2 (J(u_h) - J(u)) (an upper bound where the active set still
changes). J(u) is unknown, but for two meshes l (coarse) and m (fine) it cancels:

    ‖u - u_l‖² - ‖u - u_m‖² = 2 (J(u_l) - J(u_m)).

In particular twice the fall of the energy is a lower bound of the squared error of the coarse
mesh. It is compared with the difference of the estimates, η_l² - η_m². If the quotient

    q = 2 (J(u_l) - J(u_m)) / (η_l² - η_m²)

is at most about one, the estimates explain the decrease of the error, and the finer one is
accepted. If it is larger, the coarse estimate was too small by this factor, and the finer one is
raised by the same factor. This corrects estimates that are a fixed part of the error, as for nearly
incompressible cells, in bending and on graded cells. Above `Limits.disagree` the estimate is
rejected: on such meshes estimates do not yet follow the error (locking, few cells across, contact
at a single node), and another mesh is needed.

The squared errors of compared levels differ by the factor `Limits.ratio`, since differences of
nearly equal errors are meaningless. First-order and second-order cells lock differently, so a
quotient of the two raises nothing: there the coarse estimate has to be right. On round obstacles,
with mean dilatation and between bodies, energies may lie below the true one and rise. Their change
is still of the order of the squared error and is compared with narrower limits; a rise counts for
more than a fall (`quotient`).

In a load history with friction slips count from the displacements of the last increment, which are
others on each mesh. Their errors change the energy by the first order, so that squares of errors
cannot be compared with it. There two meshes agree if

    |J(u_l) - J(u_m)| ≤ (η_l + η_m) √a(u_m, u_m).
"""

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Limits:
    """The limits within which two levels agree."""

    ratio: float
    """Squared error of the coarser level over that of the finer, from which on they are
    compared."""
    disagree: float
    """Quotient from which on estimates do not follow the error."""
    inherited: bool = False
    """Whether errors of earlier increments change the energy by the first order."""


FALLING = Limits(ratio=1.7, disagree=4.0)
"""Limits if energies decrease to the true one.

An estimate that was raised fourfold was half of the error; of about 300 claims of random plane
scenes with levels that differed by 2.25 none was above 1.1.
"""

EITHER_WAY = Limits(ratio=2.25, disagree=2.0)
"""Limits if energies may rise.

A disc on 5 by 5 cells, whose estimate was a quarter of its error, had a quotient of 2.6 against 2
by 2 cells."""

INHERITED = Limits(ratio=1.7, disagree=1.0, inherited=True)
"""Limits of load histories with friction."""

OTHER_KIND = 1.3
"""Largest quotient of levels of different degree that agree."""

DOUBLE = 2.0
"""Factor on the quotient of two levels that disagree, for the largest possible error."""

CLEAR = 0.125
"""Share of the target below which a first mesh with enough cells is accepted alone."""

CELLS = 4
"""Number of cells along every edge that is enough for this."""

EXACT = 1e-5
"""Relative error that counts as round-off: such a mesh needs no confirmation."""


@dataclass(frozen=True)
class Measured:
    """The error of one mesh by its estimate and its energy."""

    degree: int
    """Degree of the displacement."""
    energy: float
    """J(u_h)."""
    square: float
    """η², the square of the estimated error in the same units."""
    strains: float = 0.0
    """a(u_h, u_h)."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on an estimate."""

    raised: float
    """Factor on η², 1 or more."""
    doubt: str = ""
    """The reason why the estimate is not accepted yet; empty if it is accepted."""
    suspected: float = math.inf
    """Largest possible factor on η² in case of doubt; a target that even this estimate meets is
    met."""

    @property
    def agreed(self) -> bool:
        """Whether the raised estimate is accepted."""
        return not self.doubt

    def confirms(self, error: float, target: float) -> bool:
        """Whether a target counts as met by an error that includes the raise."""
        if self.doubt:
            return error * math.sqrt(self.suspected) <= target
        return error <= target


@dataclass
class Agreement:
    """The levels of a run, with a verdict on the estimate of the last one."""

    limits: Limits = FALLING
    """`FALLING`, `EITHER_WAY` or `INHERITED`."""
    _levels: list[Measured] = field(default_factory=list)

    def __len__(self) -> int:
        """Number of levels so far."""
        return len(self._levels)

    def add(self, level: Measured) -> Verdict:
        """The verdict on a level's estimate by the levels before it.

        Examples
        --------
        >>> run = Agreement()  # errors of 4, 2 and 1; squares that are half of what they should be
        >>> run.add(Measured(2, 8.0, 8.0)).doubt
        'no other mesh confirms its estimate'
        >>> run.add(Measured(2, 2.0, 2.0)).raised, run.add(Measured(2, 0.5, 0.5)).raised
        (2.0, 2.0)
        """
        before = self._levels[::-1]
        self._levels.append(level)
        return compared(level, before, self.limits)

    def forget(self) -> None:
        """Leave out the last level, which is not comparable with others."""
        self._levels.pop()

    def add_coarser(self, coarse: Measured) -> Verdict:
        """Insert a coarser mesh before the last level, and return the verdict on that level."""
        self._levels.insert(-1, coarse)
        return compared(self._levels[-1], [coarse], self.limits)


def compared(level: Measured, before: list[Measured], limits: Limits = FALLING) -> Verdict:
    """The verdict on the estimate of a level by other levels, the last first."""
    if not before:
        return Verdict(1.0, "no other mesh confirms its estimate")
    if max(level.square, 2.0 * abs(before[0].energy - level.energy)) <= EXACT**2 * abs(
        level.energy
    ):
        return Verdict(1.0)  # exact to round-off on both meshes
    if limits.inherited:
        return _compared_at_first_order(level, before, limits)
    same = [other for other in before if other.degree == level.degree]
    for other in same:
        if differ_enough(other, level, limits):
            q = quotient(other, level)
            if q > limits.disagree:
                return Verdict(1.0, _disagreement(other, level), DOUBLE * raised(other, level))
            return Verdict(raised(other, level))
    if same:
        return Verdict(1.0, "the meshes so far differ too little to confirm its estimate")
    if not differ_enough(before[0], level, limits):
        return Verdict(1.0, "the meshes so far differ too little to confirm its estimate")
    if quotient(before[0], level) > OTHER_KIND:
        return Verdict(1.0, _disagreement(before[0], level))
    return Verdict(1.0)


def _compared_at_first_order(level: Measured, before: list[Measured], limits: Limits) -> Verdict:
    """The verdict on the estimate of a level of a history by other levels, the last first."""
    for other in before:
        if differ_enough(other, level, limits):
            change = abs(other.energy - level.energy)
            estimated = math.sqrt(other.square) + math.sqrt(level.square)
            if change <= limits.disagree * estimated * math.sqrt(level.strains):
                return Verdict(1.0)
            return Verdict(1.0, _FIRST_ORDER)
    return Verdict(1.0, "the meshes so far differ too little to confirm its estimate")


_FIRST_ORDER = (
    "the last two meshes do not agree on it: their energies differ by more than the estimates "
    "account for"
)


def differ_enough(coarse: Measured, fine: Measured, limits: Limits) -> bool:
    """Whether the squared errors of two levels differ enough for a comparison.

    By their estimates, or by the energy between them where the coarse one's is too small.
    """
    fall = 2.0 * abs(coarse.energy - fine.energy)
    return max(coarse.square, fall + fine.square) >= limits.ratio * fine.square


def quotient(coarse: Measured, fine: Measured) -> float:
    """|q| of two levels; infinite where the energy changes though the estimate does not fall."""
    change = 2.0 * abs(coarse.energy - fine.energy)
    difference = coarse.square - fine.square
    if difference <= 0.0:
        return float("inf") if change > 0.0 else 1.0
    return change / difference


def raised(coarse: Measured, fine: Measured) -> float:
    """Factor by which the squared estimate of the finer level is raised, 1 or more.

    If the energy rises, the coarser mesh penetrated an obstacle between nodes. The rise is then
    added to the decrease of the energy that the estimates predict.
    """
    rises = coarse.energy < fine.energy
    return max(quotient(coarse, fine) + (1.0 if rises else 0.0), 1.0)


def _disagreement(coarse: Measured, fine: Measured) -> str:
    """The reason why two levels do not agree."""
    change = (2.0 * abs(coarse.energy - fine.energy)) ** 0.5
    estimated = max(coarse.square - fine.square, 0.0) ** 0.5
    more = f"{change / estimated:.2g} times what" if estimated > 0.0 else "while"
    ending = "their estimates account for" if estimated > 0.0 else "their estimates do not fall"
    return (
        "the last two meshes do not agree on it: between them the energy norm of the error "
        f"changes by {more} {ending}"
    )


def needs_no_confirmation(estimate: float, target: float, fewest: int) -> bool:
    """Whether a first mesh needs no confirmation: exact to round-off, or far below the target.

    Parameters
    ----------
    estimate, target
        Relative errors.
    fewest
        Cells along the edge with the fewest.
    """
    return estimate <= EXACT or (fewest >= CELLS and estimate <= CLEAR * target)
