"""Subdomains: stiffness, kernel, generalised inverse.

Congruent subdomains share one factorisation (`classes`, `generalised_inverse`), and so do mirror
images (`reflections`). `kernels` are the rigid motions, `costs` predicts seconds and bytes.
"""
