"""Refinement: the same scene on finer meshes until its error meets a target.

`refinement` is the loop over `levels`, `next_mesh` says how fine the next mesh is, `grading` places
the layers of boxes, `local_refinement` bisects the cells of files where the error is, `warm_start`
brings the answer on one mesh to the next.
"""
