"""Subdomains: stiffness K, kernel R, generalised inverse K⁺.

Input are the stiffness matrices of subdomains and the coordinates of their nodes
(`classes.ClassData`); the product is one `classes.FactoredClass` for all congruent subdomains,
which share one factor. K⁺ is that of a regularisation at fixing nodes (Brzobohatý et al., 2011;
`generalised_inverse`), and K K⁺ K = K holds exactly. `kernels` are the rigid motions, from geometry
alone. `reflections` splits the inverse of a mirror symmetric subdomain into smaller blocks
(Bossavit, 1986), `similar` finds stiffnesses that are multiples of each other, `rigid` has rigid
bodies as subdomains, and `costs` predicts seconds and bytes.
"""

__all__ = ["classes", "costs", "kernels", "rigid"]
