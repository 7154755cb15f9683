"""From a scene to algebra: subdomains, boundaries, loads, stiffness, constraint rows.

Input is a `Scene`; the product is a `model.Model` with the dual problem of Total FETI (Kružík et
al., 2020, section 4.1): min ½ uᵀ K u - fᵀ u subject to B u = c and B u ≤ c on contact rows.
`geometry` has the bodies cut into subdomains, `outline` all that needs no matrices. `assembly`
holds the finite-element forms. `pairs` and `averaged_rows` write contact rows over several nodes
(mortar rows, `meshes.mortar`), and `candidates` chooses the nodes that can come into contact.
`friction`, `ties`, `rigid` and `supports` write the other rows, `loads` and `heat` the load
vectors. `decomposition` chooses the subdomains, `method` the solver, `equilibrium` tests the loads,
and `symmetry` finds the part of a scene that is solved.
"""

__all__ = [
    "assembly", "averaged_rows", "boundaries", "candidates", "decomposition", "equal_cells",
    "equilibrium", "facets", "geometry", "loaded_area", "loads", "method", "model", "normal_forces",
    "obstacle_hints", "outline", "pairs", "planes", "rigid", "sections", "symmetry",
    "tangential_rows", "ties",
]  # fmt: skip
