"""Total FETI (Dostál, Horák and Kučera, 2006): the dual problem of a decomposition.

Subdomains that all float (`subdomain`) are joined by constraints (`constraints`) and a coarse
problem of their rigid motions (`coarse`). `dual` is F = B K⁺ Bᵀ with its right-hand sides,
`preconditioner` approximates its inverse, `recovery` returns displacements from multipliers,
`recycling` reuses search directions, `winkler` guesses the first active set, `feasible` makes
answers admissible for the certificate.
"""
