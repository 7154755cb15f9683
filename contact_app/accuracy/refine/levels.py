"""The levels of a refinement: result and cost of each mesh."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.results.percent import percent


@dataclass(frozen=True)
class Level:
    """Result and cost of one mesh."""

    cells: int
    dofs: int
    """Size of the undecomposed mesh."""
    discretisation: float
    algebraic: float
    total: float
    """Relative errors in energy norm."""
    hessian_multiplications: int
    seconds: float
    """The cost: operator applications, and wall-clock time from the scene to its summary."""
    calibration: float
    """`discretisation` relative to the uncorrected estimate: below 1 if the energies of the levels
    lowered it, above 1 if they raised it."""
    warm: bool = False
    """Whether the solve began with the solution of the last level."""
    guaranteed: float | None = None
    """Bound of the error, if the scene requests one and it was found."""

    @property
    def error(self) -> float:
        """The error compared with the target: the bound if there is one, else the estimate."""
        return self.total if self.guaranteed is None else self.guaranteed

    @property
    def estimate(self) -> float:
        """The estimate from stresses alone, before its correction by energies."""
        return self.discretisation / self.calibration

    def as_dict(self) -> dict[str, Any]:
        """The level as in `summary.json`; null where a number is unknown."""
        entries = {key: value for key, value in asdict(self).items() if value is not None}
        return {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in entries.items()
        }

    def __str__(self) -> str:
        corrected = ""
        if self.calibration != 1.0:
            change = "lowered" if self.calibration < 1.0 else "raised"
            corrected = f" (estimate {percent(self.estimate)}, {change})"
        return (
            f"{self.dofs:,} degrees of freedom: error {percent(self.error)}{corrected}, "
            f"{self.hessian_multiplications} Hessian multiplications, {self.seconds:.1f} s"
            f"{', started from the last level' if self.warm else ''}"
        )


@dataclass(frozen=True, eq=False)
class Refined:
    """The finest solution and all levels; `missed` has the reason why the target is not met.

    Coarser meshes that were solved only to confirm an estimate come first in the list.
    """

    solved: SolvedScene
    levels: tuple[Level, ...]
    missed: str = ""


def comparable(levels: Sequence[Level]) -> list[float]:
    """Errors of levels, all raised by the factor of the last one so that they give a rate."""
    last = max(levels[-1].calibration, 1.0)
    return [level.error / max(level.calibration, 1.0) * last for level in levels]


def with_levels(summary: dict[str, Any], refined: Refined) -> dict[str, Any]:
    """`summary.json` with the target accuracy and the cost of each level."""
    target = refined.solved.model.scene.accuracy
    of_last = refined.solved.accuracy.as_dict()
    accuracy = {**summary["accuracy"], **of_last, "target": target, "met": not refined.missed}
    certificate = dict(summary["certificate"])
    if refined.missed:
        text = f"the accuracy {target:g} was not reached: {refined.missed}"
        certificate["warnings"] = [*certificate["warnings"], text]
    levels = [level.as_dict() for level in refined.levels]
    return {**summary, "certificate": certificate, "accuracy": accuracy, "levels": levels}


def level_of(solved: SolvedScene, calibration: float) -> Level:
    """The level of an answer whose estimate was corrected by a factor.

    The cost of a load history is that of all its increments.
    """
    mesh, accuracy = solved.summary["mesh"], solved.accuracy
    solves = solved.summary.get("steps") or [solved.summary]
    return Level(
        cells=mesh["cells"],
        dofs=mesh["dofs"],
        discretisation=accuracy.discretisation,
        algebraic=accuracy.algebraic,
        total=accuracy.total,
        hessian_multiplications=sum(one["solver"]["hessian_multiplications"] for one in solves),
        seconds=solved.summary["timings"]["total"],
        calibration=calibration,
        warm=solved.solution.warm and len(solves) == 1,
        guaranteed=solved.guaranteed.bound if solved.guaranteed is not None else None,
    )
