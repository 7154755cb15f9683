"""The options of the solver that a user may choose."""

from dataclasses import dataclass
from typing import Literal

Method = Literal["auto", "active-set", "smalbe", "primal"]
"""Name of the algorithm that solves the problem (`solver.driver`)."""


@dataclass(frozen=True)
class SolverOptions:
    """Options of the solver, as the configuration documents them.

    `tightest` is the smallest automatic tolerance; it applies where the mesh is (nearly) exact.
    """

    method: Method = "auto"
    tolerance: float | Literal["auto"] = 1e-6
    tightest: float = 1e-4
    expansion: str = "projcg-safe"
    alpha_u: float = 1.9
    gamma: float = 1.0
    max_iterations: int = 10_000

    @property
    def least_tolerance(self) -> float:
        """The tolerance, or the smallest that an automatic one may become."""
        return self.tightest if self.tolerance == "auto" else float(self.tolerance)
