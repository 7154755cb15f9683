"""A guaranteed bound on the mesh error from stresses in equilibrium (Prager and Synge, 1947).

It covers boxes under loads that the stress fields can balance. `box_surface` holds the tractions,
`equilibrated` computes the stresses, `grid_stress` and `separable` hold their arithmetic on grids,
and `guarantee` computes the bound or the reason why none exists.
"""
