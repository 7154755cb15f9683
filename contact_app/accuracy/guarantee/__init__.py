"""A guaranteed bound on the error of the mesh, by stresses in equilibrium (Prager and Synge, 1947).

It serves boxes under loads that its stress fields can balance. `box_surface` holds the tractions,
`equilibrated` the stresses, `grid_stress` and `separable` their arithmetic on grids, `guarantee`
the bound and what makes it impossible.
"""
