"""Slenderness from which on a body counts as thin."""

THIN = 12.0
"""Longest over shortest extent of a body from which on its contact may peel off row by row, and its
bending, which smoothed aggregation cannot resolve, takes a hundred iterations on a set."""
