"""What a run to an accuracy holds against its target: the estimate, corrected by energies.

Energies of the meshes of a run say both by how much estimates exceed the error
(`contact_app.calibration`: lowered) and by how much they fall short of it
(`contact_app.accuracy.agreement`: raised, or not believed at all).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from contact_app.accuracy.agreement import Agreement, Measured, Verdict, alone
from contact_app.calibration import Calibration, conforms
from contact_app.errors import ContactError
from contact_app.scene import Box, Decomposition, Scene

if TYPE_CHECKING:
    from contact_app.run import SolvedScene

FEWEST = 4
"""Cells along every edge of a first mesh from which on a mesh of half as many can confirm it."""


class Judge:
    """Corrects the estimates of a run's levels and says which of them are believed.

    Parameters
    ----------
    scene
        As the file has it.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._calibration = Calibration() if conforms(scene) else None
        self._agreement = Agreement()

    def hear(self, solved: SolvedScene, graded: bool) -> tuple[SolvedScene, float, Verdict]:
        """The next level with its estimate corrected, the factor on η², and whether to believe it.

        Parameters
        ----------
        graded
            Whether grid lines were laid by the error.
        """
        measured = measure(solved)
        verdict = self._agreement.add(measured)
        share = 1.0
        if self._calibration is not None:
            kind = f"{'graded' if graded else 'equal'} cells of degree {measured.degree}"
            share = self._calibration.share(kind, measured.energy, measured.square)
        share = verdict.raised if verdict.raised > 1.0 else share
        accuracy, target = solved.accuracy, self._scene.accuracy or 0.0
        first = len(self._agreement) == 1
        if first and alone(accuracy.discretisation, target, _fewest(self._scene)):
            verdict = Verdict(1.0)
        return replace(solved, accuracy=accuracy.calibrated(share)), share, verdict

    def confirm(
        self, solve: Callable[[Scene], SolvedScene], whole: bool
    ) -> tuple[SolvedScene, Verdict] | None:
        """Solve the first mesh with half its cells along every edge, to confirm its estimate.

        That is a fraction of the price of a finer mesh.

        Parameters
        ----------
        whole
            Whether boundaries need the grid lines of the start to be multiples of the coarse ones.

        Returns
        -------
        The answer of the coarse mesh and the verdict on the first; None where there is no such
        mesh.
        """
        coarse = halved_cells(self._scene, whole)
        if coarse is None or len(self._agreement) != 1:
            return None
        try:
            solved = solve(coarse)
        except ContactError:  # a boundary has no facet there, a partition no cells
            return None
        if not solved.solution.converged:
            return None
        return solved, self._agreement.add_coarser(measure(solved))


def measure(solved: SolvedScene) -> Measured:
    """What an answer says of its error, before any correction."""
    accuracy = solved.accuracy
    degree = min(body.degree for body in solved.model.scene.bodies)
    square = accuracy.discretisation**2 * accuracy.square
    return Measured(degree, solved.solution.measures.energy, square)


def halved_cells(scene: Scene, whole: bool) -> Scene | None:
    """The scene with half as many cells along every edge; None where they are too few, or odd."""
    bodies = []
    for body in scene.bodies:
        if not isinstance(body.mesh, Box) or min(body.mesh.cells) < FEWEST:
            return None
        if whole and any(n % 2 for n in body.mesh.cells):
            return None
        cells = tuple(n // 2 for n in body.mesh.cells)
        bodies.append(replace(body, mesh=replace(body.mesh, cells=cells)))
    return replace(scene, bodies=tuple(bodies), decomposition=Decomposition())


def _fewest(scene: Scene) -> int:
    """Cells along the edge of a box that has the fewest; 0 where a body comes from a file."""
    return min(min(body.mesh.cells) if isinstance(body.mesh, Box) else 0 for body in scene.bodies)
