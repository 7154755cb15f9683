"""The contact problem solved for displacements, in the unknowns of undecomposed bodies.

Input and product are those of the dual methods: a `solver.problem.decomposed.DecomposedProblem`,
here one without factors, and multipliers with displacements and their certificate.

`by_active_sets` solves to a certified answer, `backend` is conjugate gradients with algebraic
multigrid (smoothed aggregation; Vaněk, Mandel and Brezina, 1996) on an active set: `merged` puts
the subdomains together, `products` multiplies by its matrices, `projector` keeps the active rows
closed, `hierarchy` has the levels, `vertices` the one of degree 1 below degree 2, `cycle` truncates
their coarse spaces (Gräser and Kornhuber, 2009), `rigid_space` corrects rigid motions of bodies
that only contact holds (A-DEF2 of Tang et al., 2009), `factor` replaces the cycle for thin bodies,
`first_set` finds the first set on coarse levels, `augmented` continues with an augmented Lagrangian
where sets do not settle, `coupled` with Newton's method for Coulomb friction, `recovery` computes
all multipliers.
Theory: docs/theory/primal_multigrid.md.
"""

__all__ = ["by_active_sets", "factor"]
