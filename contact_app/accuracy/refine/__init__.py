"""Refinement: the same scene on finer meshes until its error meets a target.

`refinement` is the loop over `levels`, `next_mesh` chooses how fine the next mesh is, `grading`
places the layers of boxes, `local_refinement` bisects cells of mesh files where the error is large,
and `warm_start` transfers the contact on one mesh to the next.
"""
