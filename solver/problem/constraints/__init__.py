"""Conditions at nodes, and the constraint matrix B of their rows.

`conditions` are held nodes and contact rows, `merge` joins equal conditions into one row, `ties`
finds tied rows that others decide, `friction` has the tangential rows, `shared_rows` all rows over
nodes of several ranks, and `matrix` is B with its products on all ranks.
"""

__all__ = ["conditions", "friction", "matrix", "merge", "shared_rows", "ties"]
