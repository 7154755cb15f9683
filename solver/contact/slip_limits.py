"""Coulomb's slip limits as the fixed point s = μ λ_n(s) of problems with given limits.

λ_n(s) are the contact forces of the problem whose friction has the limits s. The plain iteration
multiplies its error by about -μ over the slope of the load path and can oscillate. It is
accelerated (D. G. Anderson, *Iterative procedures for nonlinear integral equations*, J. ACM 12,
1965; H. F. Walker, P. Ni, *Anderson acceleration for fixed-point iterations*, SIAM J. Numer. Anal.
49, 2011): the next limits are the combination of the last ones whose residuals s - μ λ_n(s) are
least. Where the residual grows, the earlier limits are dropped and the next step is half a plain
step, for the augmented Lagrangian also all later ones.
"""

import numpy as np
from mpi4py import MPI

from solver.contact.friction_points import FrictionPoints
from solver.vectors import Array

SMALLEST = 1e-10
"""Share of the largest squared difference of residuals below which a difference is left out."""


History = tuple[tuple[Array, Array], ...]
"""Limits and their residuals, (points,) each, the last ones last."""


def combined(comm: MPI.Intracomm, history: History, share: float = 1.0) -> Array:
    """The combination of limits with the least residual, and a step by it (collective).

    s + r minus the combination of differences that makes the last residual r least.

    Parameters
    ----------
    share
        Of the residual that the step takes.
    """
    values, residual = history[-1]
    if len(history) == 1:
        return np.asarray(values + share * residual)
    differences = np.array([residual - r for _, r in history[:-1]])
    steps = np.array([values - s for s, _ in history[:-1]])
    gram = comm.allreduce(differences @ differences.T)
    right = comm.allreduce(differences @ residual)
    size, vectors = np.linalg.eigh(gram)
    independent = size > SMALLEST * max(size.max(), np.finfo(float).tiny)
    weights = vectors[:, independent] @ ((vectors[:, independent].T @ right) / size[independent])
    return np.asarray(values + share * residual - weights @ (steps + share * differences))


class SlipLimits:
    """Slip limits of the problem with given limits, and their iteration.

    Parameters
    ----------
    lasting
        Whether steps stay halved once the residual grew. SMALBE-M, whose contact forces are less
        accurate, takes 930 operator applications on a cube with μ = 1 so, and 275 otherwise.
    memory, grown
        Number of earlier limits in the combination; residual over the last one, above which the
        step is halved.

    Attributes
    ----------
    values : (points,)
        Slip limits s, forces.
    """

    def __init__(
        self,
        points: FrictionPoints,
        comm: MPI.Intracomm,
        multiplier: Array,
        lasting: bool = False,
        memory: int = 5,
        grown: float = 1.5,
    ) -> None:
        self._points, self._comm, self._memory, self._grown = points, comm, memory, grown
        self.values = points.slip_limits(multiplier)
        self._history: History = ()
        self._last: Array | None = None
        self._size, self._share, self._lasting = np.inf, 1.0, lasting

    @property
    def depend_on_forces(self) -> bool:
        """Whether any limit depends on contact forces: Coulomb's law (collective)."""
        return bool(self._comm.allreduce(int((self._points.coefficients > 0.0).any())))

    def settles(self, multiplier: Array, share: float) -> bool:
        """Whether μ λ_n has changed by less than a share of |s - μ λ_n| since the last call."""
        limits = self._points.slip_limits(multiplier)
        moved = np.inf if self._last is None else self._norm(limits - self._last)
        self._last = limits
        return moved <= share * self._norm(limits - self.values)

    def advance(self, multiplier: Array) -> None:
        """Move to the next limits, given the contact forces under the present ones (collective)."""
        limits = self._points.slip_limits(multiplier)
        residual = limits - self.values
        size = self._norm(residual)
        grown, self._size, self._last = size > self._grown * self._size, size, None
        if grown:
            self._history = ()
            self._share *= 0.5 if self._lasting else 1.0
        self._history = (*self._history, (self.values, residual))[-self._memory - 1 :]
        share = min(self._share, 0.5) if grown else self._share
        mixed = combined(self._comm, self._history, share)
        self.values = np.maximum(mixed, self._points.limits)

    def _norm(self, values: Array) -> float:
        return float(np.sqrt(self._comm.allreduce(float(values @ values))))
