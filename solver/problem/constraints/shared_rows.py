"""The rows of B over nodes that other ranks may own: contact, tangential, tied and mean rows."""

from dataclasses import dataclass

from solver.contact.row_kinds import RowKind
from solver.problem.constraints.conditions import ContactRows
from solver.problem.constraints.friction import FrictionRows

SHARED = RowKind.CONTACT, RowKind.TANGENT, RowKind.TIED, RowKind.MEAN
"""Kinds of rows over nodes that other ranks may own, in the order of `SharedRows`."""


@dataclass(frozen=True, eq=False)
class SharedRows:
    """Rows over nodes of any ranks, each kind sorted by node."""

    contact: ContactRows
    friction: FrictionRows
    """Tangential rows, sorted by contact within a node."""
    tied: ContactRows
    """Rows of tied boundaries; they hold with equality."""
    means: ContactRows
    """Held rigid motions of bodies in the mean."""

    @classmethod
    def of(
        cls,
        contact: ContactRows,
        friction: FrictionRows | None = None,
        tied: ContactRows | None = None,
        means: ContactRows | None = None,
    ) -> "SharedRows":
        """Shared rows with the given kinds; the other kinds are empty."""
        none = contact.none()
        friction = friction or FrictionRows.none(contact)
        return cls(contact, friction, tied or none, means or none)

    @property
    def by_kind(self) -> dict[RowKind, ContactRows]:
        """The rows by their kind in B."""
        rows = self.contact, self.friction.rows, self.tied, self.means
        return dict(zip(SHARED, rows, strict=True))
