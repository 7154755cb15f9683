"""The results of an answer: fields, contact pressures, forces and areas, files and pictures.

Input is a solved `Model` with its `Solution`. `fields` computes values at nodes and cells.
`division` divides the nodal forces of the contact rows among the contacts, `pressure` computes the
pressure of each contact from them, `contacts` sums them, and `summary` has all records of
``summary.json``. `mirror` completes a scene that was cut at planes of symmetry. `xdmf`, `report`
and `history` write the files, and `plot` draws pictures.
"""

__all__ = [
    "carried", "contact_side", "division", "envelope", "fields", "free_motions", "friction",
    "history", "mirror", "output", "overcome_friction", "percent", "plot", "pressure", "reactions",
    "repeated_sentences", "report", "result_size", "resultants", "rigid", "series", "shared_forces",
    "sliding", "smoothed_pressure", "summary", "surface_nodes", "tilted_pairs", "undetermined",
]  # fmt: skip
