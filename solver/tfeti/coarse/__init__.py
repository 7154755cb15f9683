"""The coarse problem: G = Rᵀ Bᵀ, the factor of G W Gᵀ and the projectors built from it.

`gram` assembles G W Gᵀ from the rows of G, and `coarse_problem` holds the factor and the projectors
(paper, section 4.1).
"""
