"""The error of the mesh: estimated, bounded, and brought below a target by refinement.

Input is a solved scene (`solved_scene.SolvedScene`) with its certificate; the products are an
estimated or guaranteed error in energy norm, warnings about it, and solutions on finer meshes.
`estimate` recovers stresses and compares them with those of the elements (Zienkiewicz and Zhu,
1992), `guarantee` bounds the error by stresses in equilibrium (Prager and Synge, 1947), `refine`
repeats a solve on finer meshes until a target is met. `agreement`, `judge` and `trust` decide when
an estimate is accepted: two successive meshes have to agree on it. `hertz`, `faceted_curves`,
`contact_limits` and `entered_pairs` find contacts that the mesh does not resolve.
Theory: docs/theory/error_estimate.md.
"""

__all__ = [
    "contact_limits", "entered_pairs", "estimate", "faceted_curves", "guarantee", "hertz",
    "nodal_stress", "refine", "solved_scene", "trust",
]  # fmt: skip
