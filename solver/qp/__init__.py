"""Quadratic programs with bounds and equalities: the algorithms of Kružík et al. (2020).

min ½ xᵀ A x - bᵀ x subject to l ≤ x ≤ u is solved by `mprgp` with the expansions of `expansion`
(paper, section 3), with equalities C x = c by `smalbe` (SMALBE-M) around it. `box_qp` is the
problem, `operators` adapts the admissible types of A, and `result` is the outcome of a solve.
"""
