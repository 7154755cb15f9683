"""Quadratic programs with bounds and equalities: the algorithms of Kružík et al. (2020).

min ½ xᵀ A x - bᵀ x subject to l ≤ x ≤ u is solved by `mprgp` with the expansions of `expansion`
(paper, section 3; Dostál, *Optimal Quadratic Programming Algorithms*, 2009, chapter 5), with
equalities C x = c by `smalbe` (SMALBE-M) around it. Input is a `box_qp.BoxQP`, or a
`separable_qp.SeparableQP` over any separable convex set, such as the discs of friction (`discs`);
the product is a `result.Result` with the solution, the reason why the solver stopped, counts and
history. `operators` adapts the admissible types of A, `equalities` the constraints, and
`preconditioner` is the protocol of an approximate inverse. `reference` is MPRGP in plain NumPy,
against which tests compare the fast one step by step.
"""

__all__ = [
    "box", "box_qp", "convex_set", "discs", "equalities", "examples", "expansion", "iterate",
    "mprgp", "operators", "outer_state", "preconditioner", "result", "separable_qp", "smalbe",
]  # fmt: skip
