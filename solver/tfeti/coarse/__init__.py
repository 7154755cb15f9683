"""The coarse problem: G = Rᵀ Bᵀ, the factor of G W Gᵀ and the projectors made of it.

`gram` assembles G W Gᵀ from the rows of G, `row_patterns` does so for many subdomains whose rows
are alike, `coarse_problem` factors it and projects (paper, section 4.1).
"""
