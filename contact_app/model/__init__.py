"""From a scene to algebra: subdomains, boundaries, loads, stiffness, constraint rows.

Input is a `Scene`; the product is a `model.Model` with the dual problem of Total FETI (paper,
section 4.1). `geometry` has the bodies cut into subdomains, `outline` all that needs no matrices.
`assembly` holds the finite-element forms. `pairs` and `averaged_rows` write contact rows over
several nodes, and `candidates` chooses the nodes that can come into contact. `decomposition`
chooses the subdomains, and `symmetry` the part of a scene that is solved.
"""
