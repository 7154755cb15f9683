"""Whether contact leaves rigid bodies a place.

Displacement conditions fix their nodes. The contact rows of rigid bodies with them
are inequalities A q ≤ g on the free motions q of rigid bodies, as are those of nodes that are tied
to rigid bodies. Tied nodes that are held give equalities E q = e. If no q satisfies all, the
problem has no feasible point: a plane prescribed to enter a held face, for example, which may turn
but not draw back. The linear programme

    min t   subject to   A q - t ≤ g,   E q = e,   t ≥ 0

finds the least penetration t that remains.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from meshes.arrays import Array, Ints

ENTERS = 1e-9
"""Penetration over the length of the scene that counts as a rounding error, as of held nodes that
are pushed into an obstacle (`solver.problem.constraints.merge`)."""


@dataclass(frozen=True, eq=False)
class HeldNodes:
    """Rows on the motions of moving rigid bodies alone."""

    body: Ints
    sources: Ints
    """Number of a moving rigid body of the row, and of the contact or tie. Shape (rows,)."""
    vectors: Array  # (rows, bodies · motions)
    """A: the rows on the motions of all of them, rotations times the length of the scene."""
    gaps: Array  # (rows,)
    """g, in units of length."""

    @classmethod
    def joined(cls, parts: "Sequence[HeldNodes]") -> "HeldNodes":
        """The rows of all ranks."""
        names = ("body", "sources", "vectors", "gaps")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True, eq=False)
class NoRoom:
    """Contact rows that leave rigid bodies no place."""

    bodies: Ints
    sources: Ints
    """Numbers of the moving rigid bodies and of the contacts."""
    depth: float
    """The least penetration that remains."""

    def message(self, names: Sequence[str], sources: Sequence[str]) -> str:
        """The sentence of an error, with the names of the bodies and the contacts."""
        return (
            f"the displacement conditions leave the rigid body {' and '.join(names)} no room: "
            "wherever its free components take it, held or tied nodes of "
            f"{' and '.join(sources)} enter by {self.depth:.6g} or more: no displacement satisfies "
            "all"
        )


def no_room(held: HeldNodes, length: float, equal: HeldNodes | None = None) -> NoRoom | None:
    """The rows that leave rigid bodies no place, wherever their free motions take them, if any.

    Parameters
    ----------
    equal
        Rows that hold with equality.
    """
    if not (held.gaps < 0.0).any() and equal is None:
        return None
    rows, motions = len(held.gaps), held.vectors.shape[1]
    equalities = {}
    if equal is not None and len(equal.gaps):
        equalities["A_eq"] = np.column_stack([equal.vectors, np.zeros(len(equal.gaps))])
        equalities["b_eq"] = equal.gaps / length
    solution = linprog(
        np.append(np.zeros(motions), 1.0), A_ub=np.column_stack([held.vectors, -np.ones(rows)]),
        b_ub=held.gaps / length, bounds=[(None, None)] * motions + [(0.0, None)],
        method="highs", **equalities,
    )  # fmt: skip
    if solution.status != 0 or solution.fun <= ENTERS:
        return None
    pressed = np.abs(solution.ineqlin.marginals)
    some = pressed > 1e-6 * pressed.max()
    return NoRoom(
        np.unique(held.body[some]), np.unique(held.sources[some]), float(solution.fun * length)
    )
