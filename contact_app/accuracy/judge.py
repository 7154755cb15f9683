"""What a run to an accuracy holds against its target: the estimate, corrected by energies.

Energies of the meshes of a run say both by how much estimates exceed the error
(`contact_app.calibration`: lowered) and by how much they fall short of it
(`contact_app.accuracy.agreement`: raised, or not believed at all).
"""

from __future__ import annotations

from dataclasses import replace

from contact_app.accuracy.agreement import Agreement, Measured, Verdict, alone
from contact_app.calibration import Calibration, conforms
from contact_app.scene import Box, Decomposition, Scene
from contact_app.solution import Accuracy

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

    def hear(self, level: Measured, estimate: float, graded: bool) -> tuple[float, Verdict]:
        """What the next level is worth: the factor on η², and whether it is believed.

        Parameters
        ----------
        estimate
            Relative error of the mesh, before any correction.
        graded
            Whether grid lines were laid by the error.
        """
        verdict = self._agreement.add(level)
        share = 1.0
        if self._calibration is not None:
            kind = f"{'graded' if graded else 'equal'} cells of degree {level.degree}"
            share = self._calibration.share(kind, level.energy, level.square)
        target, first = self._scene.accuracy or 0.0, len(self._agreement) == 1
        if first and alone(estimate, target, _fewest(self._scene)):
            verdict = Verdict(1.0)
        return (verdict.raised if verdict.raised > 1.0 else share), verdict

    def coarser(self, whole: bool) -> Scene | None:
        """The first mesh with half its cells along every edge, which can confirm its estimate.

        That takes a fraction of the price of a finer mesh. None where the first mesh is not the
        only one, has too few cells, or cannot be halved.

        Parameters
        ----------
        whole
            Whether boundaries need the grid lines of the start to be those of the coarse mesh.
        """
        bodies = []
        for body in self._scene.bodies:
            if not isinstance(body.mesh, Box) or min(body.mesh.cells) < FEWEST:
                return None
            if whole and any(n % 2 for n in body.mesh.cells):
                return None
            cells = tuple(n // 2 for n in body.mesh.cells)
            bodies.append(replace(body, mesh=replace(body.mesh, cells=cells)))
        if len(self._agreement) != 1:
            return None
        return replace(self._scene, bodies=tuple(bodies), decomposition=Decomposition())

    def compare_with(self, coarse: Measured) -> Verdict:
        """What a coarser mesh than the first says of the first."""
        return self._agreement.add_coarser(coarse)


def measured(accuracy: Accuracy, energy: float, scene: Scene) -> Measured:
    """What an answer to a scene says of its error, before any correction."""
    degree = min(body.degree for body in scene.bodies)
    return Measured(degree, energy, accuracy.discretisation**2 * accuracy.square)


def _fewest(scene: Scene) -> int:
    """Cells along the edge of a box that has the fewest; 0 where a body comes from a file."""
    return min(min(body.mesh.cells) if isinstance(body.mesh, Box) else 0 for body in scene.bodies)
