"""Total FETI (Dostál, Horák and Kučera, 2006): the dual problem of a decomposition.

Input is a contact problem (`solver.problem`), or plain arrays in `from_arrays`; the product is a
`DualProblem` in the multipliers λ of the rows of B,

    min ½ λᵀ F λ - λᵀ d  subject to  λ_I ≥ 0 and G λ = e,  F = B K⁺ Bᵀ,  G = Rᵀ Bᵀ,

and from its solution displacements with their certificate. Subdomains that all float (`subdomain`)
are joined by constraints (`constraints`) and a coarse problem of their rigid motions (`coarse`).
`dual` is F with its right-hand sides, `preconditioner` approximates its inverse, `recovery` returns
displacements from multipliers, `recycling` reuses search directions, `winkler` computes the initial
active set, and `methods` are the algorithms that solve the dual problem. Theory:
docs/theory/tfeti.md.
"""

from solver.tfeti.dual import DualProblem
from solver.tfeti.from_arrays import Held, Obstacle, Subdomain, problem_from_arrays

__all__ = [
    "DualProblem", "Held", "Obstacle", "Subdomain", "build", "constraints", "derived", "dual",
    "friction_share", "methods", "problem_from_arrays", "projected", "subdomain",
]  # fmt: skip
