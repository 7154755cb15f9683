"""The smallest mesh of a sweep that reaches an accuracy, with equal and with graded cells.

Equal cells of degree 1 and 2 come from the sweeps of `effectivity`. Graded meshes of degree 2 are
made for every number of layers: they begin with equal cells, and the grid lines are placed again
and again by the error of the last mesh. These lines are better than those of a single run through
the levels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from mpi4py import MPI

from contact_app.accuracy.refine.grading import layer_errors
from contact_app.accuracy.refine.next_mesh import equal_lines, on_lines, regraded
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from contact_app.scene.bodies import Box
from contact_app.scene.scene import Scene

REGRADES = 5
"""Number of times that grid lines are placed anew; after five they hardly move."""


@dataclass(frozen=True)
class Mesh:
    """A mesh of a sweep: description, number of unknowns, measured and estimated error."""

    name: str
    dofs: int
    error: float
    estimate: float


def graded_meshes(
    start: Scene, scene: Scene, cells: int, error: Callable[[SolvedScene], float]
) -> list[Mesh]:
    """Meshes of one number of cells along an edge with grid lines placed by the error.

    Parameters
    ----------
    start
        The scene on the first mesh, whose grid lines stay if it selects nodes by an expression.
    scene
        The same scene on equal cells of degree 2 with that number along an edge.
    error
        Function that measures the error of a solution.
    """
    box = start.bodies[0].mesh
    assert isinstance(box, Box)
    solved = solve_scene(scene, MPI.COMM_SELF)
    lines = equal_lines(scene)
    result = []
    for number in range(1, REGRADES + 1):
        _, lines = regraded(start, layer_errors(solved, lines), lines, cells / box.cells[0])
        solved = solve_scene(on_lines(scene, lines, 1), MPI.COMM_SELF)
        estimate = solved.accuracy.discretisation
        name = f"{cells} layers, laid {number}x"
        result.append(Mesh(name, solved.model.dofs, error(solved), estimate))
    return result


def smallest(meshes: Iterable[Mesh], target: float, by_estimate: bool = False) -> Mesh:
    """The mesh with the fewest unknowns whose error is at most the target.

    Raises
    ------
    ValueError
        No mesh has an error at most the target.
    """
    fitting = [m for m in meshes if (m.estimate if by_estimate else m.error) <= target]
    return min(fitting, key=lambda m: m.dofs)
