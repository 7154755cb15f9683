"""Pictures of the files of a run, drawn by matplotlib.

`stored` reads ``solution.xdmf``, and `picture` chooses the pictures. `plane_picture` and
`space_picture` draw bodies (in space by the depth buffer of `raster`), `contact_picture` draws the
pressure along a contact boundary, and `friction_picture` the sticking and slipping parts.
"""
