"""Total FETI (Dostál, Horák and Kučera, 2006): the dual problem of a decomposition.

Subdomains that all float (`subdomain`) are joined by constraints (`constraints`) and a coarse
problem of their rigid motions (`coarse`). `dual` is F = B K⁺ Bᵀ with its right-hand sides,
`preconditioner` approximates its inverse, `recovery` returns displacements from multipliers,
`recycling` reuses search directions, `winkler` computes the initial active set, and `methods` are
the algorithms that solve the dual problem. `certify` computes the certificate from the `sizes` of
each body and the `duality_gap` to the admissible displacement that `feasible` finds.
"""

from solver.tfeti.dual import DualProblem
from solver.tfeti.from_arrays import Held, Obstacle, Subdomain, problem_from_arrays

__all__ = ["DualProblem", "Held", "Obstacle", "Subdomain", "problem_from_arrays"]
