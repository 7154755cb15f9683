"""The kinds of rows of the constraints."""

from enum import IntEnum


class RowKind(IntEnum):
    """The kind of a row of B."""

    GLUING = 0
    DIRICHLET = 1
    CONTACT = 2
    SUPPORT = 3
    TANGENT = 4
    TIED = 5
    MEAN = 6
    """A rigid motion of a whole body in the mean, held on request."""
