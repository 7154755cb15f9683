"""Pictures of the files of a run, drawn by matplotlib.

`stored` reads ``solution.xdmf``, `picture` chooses what is drawn, `plane_picture` and
`space_picture` draw bodies, these by the depth buffer of `raster`, `contact_picture` draws the
pressure along a contact boundary, `friction_picture` where it sticks and slips.
"""
