"""Load histories of `contact-app verify`, and the mesh of one of them.

* Rod: displacement u of the end when the force is back at zero and when it pushes, and the work
dissipated by friction in a cycle, with s the slip limit per area, b the width and A the section:
  u(F → 0) = F²/(4 E A s b), u(-F) = -F²/(2 E A s b), loss 2 F³/(3 E A s b).
* Cattaneo and Mindlin: an incompressible block, in which normal and tangential tractions do not
couple, is pressed against a rigid cylinder and pushed tangentially: nodes within c = a √(1 - Q/(μ
P)) stick.
  Unloaded from Q* to Q, those within b = a √(1 - (Q* - Q)/(2 μ P)) stick (R. D. Mindlin, H.
  Deresiewicz, 1953; K. L. Johnson, *Contact Mechanics*, 1985, section 7.3). P, Q and a are taken
  from the solution, a from a line fitted to p² over x².

Tractions are compared with q = μ p0 (√(1 - x²/a²) - (c/a) √(1 - x²/c²)) at all nodes, as a root
mean square relative to μ p0. Only their even part is compared, since pressing a block of finite
size causes small odd tractions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from contact_app.run.increments import SolvedIncrement
from contact_app.studies.hertz import Quantity
from contact_app.studies.perturbed import write_mesh
from meshes.arrays import Array
from meshes.graded import graded_box


def rod_cycle(increments: Sequence[SolvedIncrement]) -> list[Quantity]:
    """A rod that is pulled, released, pushed and pulled again."""
    force, height, young, limit = 10.0, 0.5, 1000.0, 0.2
    ends = [increment for increment in increments if increment.place.share == 1]
    moved = [_end(increment) for increment in ends]
    scale = force**2 / (young * height * limit)
    lost = ends[3].dissipated - ends[0].dissipated
    return [
        Quantity("u at F = 0", moved[1], scale / 4.0),
        Quantity("u at -F", moved[2], -scale / 2.0),
        Quantity("loss of a cycle", lost, 2.0 * force * scale / 3.0),
    ]


def _end(increment: SolvedIncrement) -> float:
    """Mean displacement of the end of the rod."""
    nodes = increment.solved.nodes
    end = np.isclose(nodes.points[:, 0], nodes.points[:, 0].max())
    return float(nodes.displacement[end, 0].mean())


def cattaneo(increments: Sequence[SolvedIncrement]) -> list[Quantity]:
    """A block pressed, pushed, released half-way and released completely: see the module."""
    ends = [increment for increment in increments if increment.place.share == 1]
    pushed, last = _Strip.of(ends[1]), _Strip.of(ends[2])
    stick = np.sqrt(1.0 - pushed.share)
    back = np.sqrt(1.0 - (pushed.share - np.sign(pushed.side * last.side) * last.share) / 2.0)
    inner = np.sqrt(np.maximum(1.0 - (pushed.x / (stick * pushed.a)) ** 2, 0.0))
    outer = np.sqrt(np.maximum(1.0 - (pushed.x / pushed.a) ** 2, 0.0))
    even = 0.5 * (pushed.traction + np.interp(-pushed.x, pushed.x, pushed.traction))
    off = even - (outer - stick * inner)
    rms = float(np.sqrt(np.mean(off**2)))
    return [
        Quantity("c/a", pushed.sticking, float(stick)),
        Quantity("1 + rms of tractions", 1.0 + rms, 1.0),
        Quantity("b/a, unloaded", last.sticking, float(back)),
    ]


@dataclass(frozen=True, eq=False)
class _Strip:
    """The contact of an increment."""

    x: Array
    traction: Array
    """Coordinates and traction of the nodes in contact; the traction relative to μ p0. Shape
    (n,)."""
    a: float
    sticking: float
    """Half-width of the contact, and that of the sticking nodes relative to it."""
    share: float
    side: float
    """|Q| / (μ P), and the sign of Q."""

    @classmethod
    def of(cls, increment: SolvedIncrement) -> "_Strip":
        nodes, scene = increment.solved.nodes, increment.solved.model.scene
        coefficient = scene.contacts[0].law.coefficient
        at = np.flatnonzero(nodes.contact_pressure > 0.0)
        at = at[np.argsort(nodes.points[at, 0])]
        x, pressure = nodes.points[at, 0], nodes.contact_pressure[at]
        slope, top = np.polyfit(x**2, pressure**2, 1)
        a, peak = float(np.sqrt(-top / slope)), float(np.sqrt(top))
        force = increment.solved.summary["contacts"][0]["force"]
        sticks = x[nodes.contact_status[at] == 1.0]
        cell = float(np.diff(x).min())
        half = 0.5 * (np.ptp(sticks) + cell) if len(sticks) else 0.0
        return cls(
            x=x, traction=np.sign(force[0]) * nodes.friction_traction[at, 0] / (coefficient * peak),
            a=a, sticking=float(half / a), share=float(abs(force[0] / (coefficient * force[1]))),
            side=float(np.sign(force[0])),
        )  # fmt: skip


GROWTH, FINE = 1.3, 1.4
"""Growth factor of cells outside the contact, and distance up to which cells are equal."""


def graded_block(path: Path, cells: int, size: float = 100.0) -> Path:
    """Write a block whose cells are smallest around the middle of its top, (0, 0).

    Parameters
    ----------
    cells
        Number of cells per unit of length there.
    size
        Half the width, and the height of the block.
    """
    x, _, y = graded_lines(cells, size, GROWTH)
    return write_mesh(path, graded_box("quadrilateral", [x, y]))


def graded_lines(cells: int, size: float, growth: float) -> tuple[Array, Array, Array]:
    """Grid lines of `graded_block` across its middle, beside it, and downwards."""
    step = 1.0 / cells
    inner = np.arange(0.0, FINE + 0.5 * step, step)
    beside = np.concatenate([inner, inner[-1] + _growing(step, size - inner[-1], growth)])
    down = -np.concatenate([[0.0], _growing(step, size, growth)])[::-1]
    return np.concatenate([-beside[:0:-1], beside]), beside, down


def _growing(step: float, length: float, factor: float) -> Array:
    """Ends of cells over a length, each longer than the last one by a factor."""
    ends, at = [], 0.0
    while at < length:
        at += step
        ends.append(at)
        step *= factor
    return np.array(ends) * length / ends[-1]
