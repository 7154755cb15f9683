"""Pictures of the files of a run, drawn by matplotlib.

Input is the directory of a run; the products are PNG files. `stored` reads ``solution.xdmf``, and
`picture` chooses the pictures. `plane_picture` and `space_picture` draw bodies (in space by the
depth buffer of `raster`, or by VTK in a process that `vtk_images` starts), `contact_picture` draws
the pressure along a contact boundary, and `friction_picture` the sticking and slipping parts.
"""

__all__ = ["picture"]
