"""Refinement: the same scene on finer meshes until its error meets a target.

Input is a scene with an accuracy and a function that solves it on one mesh; the product is the
solution on the last mesh with the error and cost of all meshes (`refinement.solve_to_accuracy`).
The error falls as a power of the cell size, e ~ s^-p: the rate p of the last two meshes predicts
the next one. `refinement` is the loop over `levels`, `next_mesh` chooses how fine the next mesh is,
`grading` places the layers of boxes, `local_refinement` bisects cells of mesh files where the error
is large (`meshes.bisect`), and `warm_start` transfers the contact on one mesh to the next.
Theory: docs/theory/refinement.md.
"""

__all__ = ["grading", "levels", "next_mesh", "refinement", "warm_start"]
