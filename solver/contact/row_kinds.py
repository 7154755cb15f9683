"""What the rows of the constraints stand for."""

from __future__ import annotations

from enum import IntEnum


class RowKind(IntEnum):
    """What a row of B stands for."""

    GLUING = 0
    DIRICHLET = 1
    CONTACT = 2
    SUPPORT = 3
    TANGENT = 4
    TIED = 5
    MEAN = 6
    """A rigid motion of a whole body in the mean, held on request."""
