"""The error of the mesh: estimated, bounded, and brought below a target by refinement.

`estimate` recovers stresses and compares them with those of the elements (Zienkiewicz and Zhu),
`guarantee` bounds the error by stresses in equilibrium (Prager and Synge), `refine` repeats a solve
on finer meshes until a target is met. `agreement`, `judge` and `trust` decide when an estimate is
accepted: two successive meshes have to agree on it.
"""
