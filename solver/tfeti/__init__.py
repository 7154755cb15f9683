"""Total FETI (Dostál, Horák and Kučera, 2006): the dual problem of a decomposition.

Input are subdomains with stiffness, loads and conditions at nodes (`system`, or plain arrays in
`from_arrays`); the product is a `DualProblem` in the multipliers λ of the rows of B,

    min ½ λᵀ F λ - λᵀ d  subject to  λ_I ≥ 0 and G λ = e,  F = B K⁺ Bᵀ,  G = Rᵀ Bᵀ,

and from its solution displacements with their certificate. Subdomains that all float (`subdomain`)
are joined by constraints (`constraints`) and a coarse problem of their rigid motions (`coarse`).
`dual` is F with its right-hand sides, `preconditioner` approximates its inverse, `recovery` returns
displacements from multipliers, `recycling` reuses search directions, `winkler` computes the initial
active set, and `methods` are the algorithms that solve the dual problem. `certify` computes the
certificate from the `sizes` of each body and the `duality_gap` to the admissible displacement that
`feasible` finds. Theory: docs/theory/tfeti.md.
"""

from solver.tfeti.dual import DualProblem
from solver.tfeti.from_arrays import Held, Obstacle, Subdomain, problem_from_arrays

__all__ = [
    "DualProblem", "Held", "Obstacle", "Subdomain", "build", "certify", "constraint_hierarchy",
    "constraints", "contact_law", "decomposed", "derived", "dual", "duality_gap", "free_motions",
    "friction_share", "least_motion", "methods", "problem_from_arrays", "projected", "sizes",
    "subdomain", "system",
]  # fmt: skip
