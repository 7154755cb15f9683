"""The coarse problem: G = Rᵀ Bᵀ, the factor of G W Gᵀ and the projectors built from it.

G λ = e says that the forces on each subdomain are in equilibrium (Kružík et al., 2020, section
4.1). Input are the constraint matrix B, the kernels R of the subdomains and positive weights W of
the rows; the product is a `coarse_problem.CoarseProblem` with the projectors
Q = W Gᵀ (G W Gᵀ)⁻¹ G and P = I - Q (Farhat, Pierson and Lesoinne, 2000). `gram` assembles G W Gᵀ
from groups of rows of Gᵀ with the same subdomains, and `coarse_problem` holds the factor and the
projectors.
"""
