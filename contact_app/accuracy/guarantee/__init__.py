"""A guaranteed bound on the mesh error from stresses in equilibrium (Prager and Synge, 1947).

A stress σ in equilibrium with the loads and with admissible contact forces gives the bound: the
energy of the difference of σ and the stress of the answer, and the work of the contact forces of σ
on the gaps. It includes the error of the solver. Input is a model with its solution; the product is
a `guarantee.Guarantee`: the bound, or the reason why none exists. The bound covers boxes under
loads that the stress fields can balance. `box_surface` holds the tractions, `equilibrated` computes
the stresses, `grid_stress` and `separable` hold their arithmetic on grids, and `guarantee` computes
the bound. Theory: docs/theory/error_estimate.md.
"""

__all__ = ["box_surface", "guarantee"]
