"""Pictures of the files of a run, in the plane with matplotlib and in space with VTK.

`stored` reads ``solution.xdmf``, `picture` chooses what is drawn, `contact_picture` draws the
pressure along a contact boundary, `friction_picture` where it sticks and slips.
"""
