"""The contact problem solved for displacements, in the unknowns of undecomposed bodies.

Input and product are those of the dual methods: a `DualProblem`, here one without factors, and
multipliers with displacements. `by_active_sets` solves to a certified answer, `backend` is
conjugate gradients with algebraic multigrid on an active set: `merged` puts the subdomains
together, `products` multiplies by its matrices, `projector` holds the active rows, `hierarchy` has
the levels, `vertices` the one of degree 1 below degree 2, `cycle` truncates their coarse spaces,
`rigid_space` corrects rigid motions of bodies that only contact holds, `factor` replaces the cycle
for thin bodies, `first_set` finds the first set on coarse levels, `augmented` goes on where sets do
not settle, `recovery` computes all multipliers.
"""
