"""The levels of a refinement: what each mesh gave and what it cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from contact_app.accuracy.solved_scene import SolvedScene


@dataclass(frozen=True)
class Level:
    """Result and cost of one mesh.

    Attributes
    ----------
    cells, dofs
        Size of the undecomposed mesh.
    discretisation, algebraic, total
        Relative errors in energy norm.
    hessian_multiplications, seconds
        The price: operator applications, and wall-clock time from the scene to its summary.
    calibration
        What the energies of the levels so far made of the estimate: `discretisation` over it, below
        1 where they lowered it, above 1 where they raised it.
    warm
        Whether it began with the answer of the last.
    guaranteed
        Bound of the error, where one was asked for and found.
    """

    cells: int
    dofs: int
    discretisation: float
    algebraic: float
    total: float
    hessian_multiplications: int
    seconds: float
    calibration: float
    warm: bool = False
    guaranteed: float | None = None

    @property
    def error(self) -> float:
        """The error that is compared with the target: the bound if there is one."""
        return self.total if self.guaranteed is None else self.guaranteed

    @property
    def estimate(self) -> float:
        """The estimate by stresses alone, before energies lowered it."""
        return self.discretisation / self.calibration

    def as_dict(self) -> dict[str, Any]:
        """As `summary.json` holds it: null where nothing can be said."""
        found = {key: value for key, value in asdict(self).items() if value is not None}
        return {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in found.items()
        }

    def __str__(self) -> str:
        corrected = ""
        if self.calibration != 1.0:
            how = "lowered" if self.calibration < 1.0 else "raised"
            corrected = f" (estimate {100 * self.estimate:.2g} %, {how})"
        return (
            f"{self.dofs:,} degrees of freedom: error {100 * self.error:.2g} %{corrected}, "
            f"{self.hessian_multiplications} Hessian multiplications, {self.seconds:.1f} s"
            f"{', begun with the last' if self.warm else ''}"
        )


@dataclass(frozen=True, eq=False)
class Refined:
    """The finest answer and the levels that led to it; `missed` says why it is not enough.

    Coarser meshes that were solved only to confirm an estimate come first.
    """

    solved: SolvedScene
    levels: tuple[Level, ...]
    missed: str = ""


def comparable(levels: Sequence[Level]) -> list[float]:
    """Errors of levels, all raised as the last one is: what two of them tell is a rate."""
    last = max(levels[-1].calibration, 1.0)
    return [level.error / max(level.calibration, 1.0) * last for level in levels]


def with_levels(summary: dict[str, Any], refined: Refined) -> dict[str, Any]:
    """`summary.json` with the accuracy asked for and the price of each level."""
    target = refined.solved.model.scene.accuracy
    found = refined.solved.accuracy.as_dict()
    accuracy = {**summary["accuracy"], **found, "target": target, "met": not refined.missed}
    certificate = dict(summary["certificate"])
    if refined.missed:
        text = f"the accuracy {target:g} was not reached: {refined.missed}"
        certificate["warnings"] = [*certificate["warnings"], text]
    levels = [level.as_dict() for level in refined.levels]
    return {**summary, "certificate": certificate, "accuracy": accuracy, "levels": levels}


def level_of(solved: SolvedScene, calibration: float) -> Level:
    """The level of an answer whose estimate was corrected by a factor."""
    mesh, accuracy = solved.summary["mesh"], solved.accuracy
    return Level(
        cells=mesh["cells"],
        dofs=mesh["dofs"],
        discretisation=accuracy.discretisation,
        algebraic=accuracy.algebraic,
        total=accuracy.total,
        hessian_multiplications=solved.summary["solver"]["hessian_multiplications"],
        seconds=solved.summary["timings"]["total"],
        calibration=calibration,
        warm=solved.solution.warm,
        guaranteed=solved.guaranteed.bound if solved.guaranteed is not None else None,
    )
