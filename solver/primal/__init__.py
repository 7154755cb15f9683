"""The contact problem solved for displacements, in the unknowns of all subdomains at once.

Its one method today is the safe one that goes on where the dual methods end at rounding errors:
augmented Lagrangians, semismooth Newton steps and sparse factors (`newton`). Input and product are
those of the dual methods, a `DualProblem` and multipliers with displacements.
"""
