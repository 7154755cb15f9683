"""Rows that hold rigid motions which nothing else holds."""

from dataclasses import dataclass, field

from solver.vectors import Array, Ints


@dataclass(frozen=True, eq=False)
class SupportRows:
    """Extra rows of this rank."""

    copies: list[Ints] = field(default_factory=list)  # one (k,) array per row
    """Copies of nodes, by their number on this rank."""
    values: list[Array] = field(default_factory=list)  # one (k, dimension) array per row
    """Coefficients."""

    def add(self, copies: Ints, values: Array) -> None:
        """Add a row with its copies (k,) and coefficients (k, dimension)."""
        self.copies.append(copies)
        self.values.append(values)
