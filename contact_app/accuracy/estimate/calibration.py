"""The correction of a run's estimates by the energies of its meshes.

Where every admissible displacement of a mesh is admissible in the continuum, and the estimate is
the same multiple of the error on two meshes, the quotient q of `contact_app.accuracy.agreement` is
the share of η² that is squared error. Compared meshes have the same kinds of cells and of grid
lines (`kind`), and errors that differ so much that changes of this multiple matter little.

Energies only lower an estimate here: at most to the largest of the quotients, times a factor for
their uncertainty, since estimates improve on finer meshes. Nothing is lowered if energies do not
decrease, or by more than any estimate is known to exceed its error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from contact_app.scene.bodies import Body, Box
from contact_app.scene.conditions import BodyContact, Contact
from contact_app.scene.obstacles import Plane

APART = 2.25
"""η² of one mesh over that of the other from which on their energies are compared."""

UNCERTAIN = 1.2
"""Factor on the quotients, for the change of the multiple between two such meshes."""

LEAST = 0.5
"""Least plausible quotient: estimates are at most 1.4 times the error on resolved meshes."""


def conforms(bodies: Sequence[Body], touching: Sequence[Contact | BodyContact]) -> bool:
    """Whether meshes have energies above the true one: no penetration between nodes.

    Boxes have the same shape on all meshes, flat obstacles touch no deeper between nodes than at
    them; mean dilatation has another energy, and bodies that touch each other do so on the average.
    With Coulomb friction the answer minimises no energy, and that of Tresca's takes |w| at nodes.
    """
    boxes = all(isinstance(body.mesh, Box) for body in bodies)
    averaged = any(body.mean_dilatation for body in bodies)
    flat = all(isinstance(c, Contact) and isinstance(c.obstacle, Plane) for c in touching)
    rough = any(c.law.acts for c in touching)
    return boxes and flat and not (averaged or rough)


@dataclass
class Calibration:
    """The levels of a run, and factors on the squares of their estimates."""

    _levels: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    _quotients: dict[str, list[float]] = field(default_factory=dict)

    def share(self, kind: str, energy: float, square: float) -> float:
        """Share of η² of the next level that is squared error; 1 if energies do not determine it.

        Parameters
        ----------
        kind
            Levels of one kind are compared: of the same degree, of equal or of graded cells.
        energy, square
            J(u_h) and η², both in units of energy.

        Examples
        --------
        >>> levels = Calibration()  # errors of 4, 2, 1 and squares that are 1.6 times as large
        >>> [round(levels.share("", 0.5 * e**2, 1.6 * e**2), 4) for e in (4.0, 2.0, 1.0)]
        [1.0, 0.75, 0.75]
        """
        before = self._levels.setdefault(kind, [])
        quotients = self._quotients.setdefault(kind, [])
        comparable = [(e, s) for e, s in before if s >= APART * square]
        before.append((energy, square))
        if comparable:
            other, larger = comparable[-1]
            quotient = 2.0 * (other - energy) / (larger - square)
            if quotient >= LEAST or quotient <= 0.0:
                quotients.append(quotient if quotient > 0.0 else 1.0)
        if not quotients:
            return 1.0
        return min(UNCERTAIN * max(quotients), 1.0)
