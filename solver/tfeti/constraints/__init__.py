"""The rows of B: gluing, held nodes and contact, and products with them on all ranks.

Input are conditions at nodes of the subdomains, the product is the matrix B with the kind of each
row (Dostál, Horák and Kučera, 2006): B u = c for gluing, held and tied rows, B u ≤ c for contact.
`conditions` are the conditions at nodes, `merge` joins equal conditions into one row, `rows` writes
B, `friction` the tangential rows, `cross_points` glues nodes of many subdomains, and `matrix` is B
itself.
"""

__all__ = ["conditions", "friction", "matrix", "merge", "options", "rows", "supports", "ties"]
