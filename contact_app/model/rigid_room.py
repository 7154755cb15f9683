"""Whether held nodes leave a rigid body a place.

Displacement conditions fix their nodes. The contact rows of a rigid body with them
are inequalities A q ≤ g on its free motions q. If no q satisfies all, the problem has no feasible
point: a plane prescribed to enter a held face, for example, which may turn but not draw back. The
linear programme

    min t   subject to   A q - t ≤ g,   t ≥ 0

finds the least penetration t that remains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from contact_app.errors import NoEquilibriumError
from contact_app.scene.scene import Scene

Array = NDArray[np.float64]

ENTERS = 1e-9
"""Penetration over the length of the scene that counts as a rounding error, as of held nodes that
are pushed into an obstacle (`solver.tfeti.constraints.merge`)."""


@dataclass(frozen=True, eq=False)
class HeldNodes:
    """Contact rows of moving rigid bodies with held nodes alone.

    Attributes
    ----------
    body, sources : (rows,)
        Number of the moving rigid body, and of the contact.
    vectors : (rows, motions)
        A: the rows on the motions of the body, rotations times the length of the scene.
    gaps : (rows,)
        g, in units of length.
    """

    body: NDArray[np.int64]
    sources: NDArray[np.int64]
    vectors: Array
    gaps: Array

    @classmethod
    def joined(cls, parts: Sequence[HeldNodes]) -> HeldNodes:
        """The rows of all ranks."""
        names = ("body", "sources", "vectors", "gaps")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def refuse_no_room(scene: Scene, held: HeldNodes, length: float) -> None:
    """Refuse a scene whose held nodes leave a rigid body no place.

    Raises
    ------
    NoEquilibriumError
        Held nodes enter a rigid body wherever its free motions take it.
    """
    for nth in np.unique(held.body[held.gaps < 0.0]):
        of_body = np.flatnonzero(held.body == nth)
        rows, gaps = held.vectors[of_body], held.gaps[of_body] / length
        motions = rows.shape[1]
        found = linprog(
            np.append(np.zeros(motions), 1.0), A_ub=np.column_stack([rows, -np.ones(len(rows))]),
            b_ub=gaps, bounds=[(None, None)] * motions + [(0.0, None)], method="highs",
        )  # fmt: skip
        if found.status != 0 or found.fun <= ENTERS:
            continue
        pressed = np.abs(found.ineqlin.marginals)
        sources = np.unique(held.sources[of_body][pressed > 1e-6 * pressed.max()])
        name = scene.rigid_bodies[scene.moving[int(nth)]].name
        where = " and ".join(scene.touching[k].source for k in sources)
        raise NoEquilibriumError(
            f"{scene.source}: the displacement conditions leave the rigid body {name} no room: "
            f"wherever its free components take it, held nodes of {where} enter it by "
            f"{found.fun * length:.6g} or more: no displacement satisfies all"
        )
