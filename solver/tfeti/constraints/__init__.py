"""The rows of B: gluing, held nodes and contact, and the copies of nodes that they join.

Input are conditions at nodes (`solver.problem.constraints`), the product are the rows of B with
their kinds (Dostál, Horák and Kučera, 2006): B u = c for gluing, held and tied rows, B u ≤ c for
contact. `rows` writes B, and `cross_points` glues nodes of many subdomains.
"""

__all__ = ["options", "rows", "supports"]
