"""Subdomains: stiffness, kernel, generalised inverse.

Congruent subdomains share one factorisation (`classes`, `generalised_inverse`), mirror images of
one as well (`reflections`). `kernels` are the rigid motions, `costs` predicts seconds and bytes.
"""
