"""The error that a run compares with its target: the estimate, corrected by energies of its meshes.

Energies of the meshes of a run show by how much estimates exceed the error
(`contact_app.accuracy.estimate.calibration`: lowered) and by how much they fall short of it
(`contact_app.accuracy.agreement`: raised or rejected).
"""

from collections.abc import Sequence
from dataclasses import replace

from contact_app.accuracy.agreement import (
    EITHER_WAY,
    FALLING,
    INHERITED,
    Agreement,
    Measured,
    Verdict,
    needs_no_confirmation,
)
from contact_app.accuracy.estimate.calibration import Calibration, conforms
from contact_app.scene.bodies import CELLS_PER_CUBE, Body, Box
from contact_app.scene.scene import Scene
from solver.contact.solution import Accuracy

FEWEST = 8
"""Number of cells along every edge from which on a mesh of half as many can confirm an estimate."""

ACROSS = 5
"""Cells across a body from a file, times the degree, from which on the estimate of the file's own
mesh is accepted. Cells are counted as if the body were a square or a cube."""


SHORTFALL = {2: 1.1, 3: 1.25}
"""Factor that raises the estimate of nearly incompressible bodies, by dimension. Of the random
scenes in space that claimed an accuracy, one in ten was wrong by a factor of 1.4, with other
materials by 1.2 (`contact_app.studies.claims`)."""


class Judge:
    """Corrects the estimates of a run's levels and decides which of them are accepted.

    Parameters
    ----------
    scene
        The scene as the file gives it.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        inherits = bool(scene.steps) and scene.has_friction
        self._falling = conforms(scene.bodies, scene.touching) and not inherits
        either = INHERITED if inherits else EITHER_WAY
        self._agreement = Agreement(FALLING if self._falling else either)
        stiff = any(body.nearly_incompressible(scene.plane) for body in scene.bodies)
        # there the ratio of estimate and error varies from mesh to mesh
        self._calibration = Calibration() if self._falling and not stiff else None
        short = stiff and not scene.guaranteed
        self._shortfall = SHORTFALL[scene.dimension] ** 2 if short else 1.0

    def assess(self, level: Measured, estimate: float, graded: bool) -> tuple[float, Verdict]:
        """The verdict on the next level: the factor on η², and whether the estimate is accepted.

        Parameters
        ----------
        estimate
            Relative error of the mesh, before any correction.
        graded
            Whether grid lines were placed by the error.
        """
        verdict = self._agreement.add(level)
        share = 1.0
        if self._calibration is not None:
            kind = f"{'graded' if graded else 'equal'} cells of degree {level.degree}"
            share = self._calibration.share(kind, level.energy, level.square)
        first = len(self._agreement) == 1
        if first and (self._stands_alone(estimate) or _fine_files(self._scene.bodies)):
            verdict = Verdict(1.0)
        return self._shortfall * (verdict.raised if verdict.raised > 1.0 else share), verdict

    def _stands_alone(self, estimate: float) -> bool:
        """Whether the first mesh needs no other mesh.

        A round obstacle may pass between its nodes.
        """
        target = self._scene.accuracy or 0.0
        return self._falling and needs_no_confirmation(
            estimate, target, _fewest(self._scene.bodies)
        )

    def forget(self) -> None:
        """Compare the next levels with those before the last one."""
        self._agreement.forget()

    def compare_with(self, coarse: Measured) -> Verdict:
        """The verdict on the last level's estimate by a coarser mesh."""
        verdict = self._agreement.add_coarser(coarse)
        return replace(verdict, raised=self._shortfall * verdict.raised)


def coarser(bodies: Sequence[Body], even: bool) -> tuple[Body, ...] | None:
    """The bodies with half the cells along every edge; the answer on them can confirm an estimate.

    It costs a fraction of a finer mesh. None if a body is not a box of equal cells, has too few
    cells, or has a number of cells that cannot be halved.

    Parameters
    ----------
    even
        Whether boundaries require that the coarse mesh has grid lines of the scene only.
    """
    halved = []
    for body in bodies:
        if not isinstance(body.mesh, Box) or min(body.mesh.cells) < FEWEST:
            return None
        if even and any(n % 2 for n in body.mesh.cells):
            return None
        cells = tuple(n // 2 for n in body.mesh.cells)
        halved.append(replace(body, mesh=replace(body.mesh, cells=cells)))
    return tuple(halved)


def measured(accuracy: Accuracy, energy: float, bodies: Sequence[Body]) -> Measured:
    """The estimated error of an answer to a scene before any correction."""
    square = accuracy.discretisation**2 * accuracy.square
    return Measured(lowest_degree(bodies), energy, square, accuracy.square)


def lowest_degree(bodies: Sequence[Body]) -> int:
    """The lowest degree of displacements of the bodies."""
    return min(body.degree for body in bodies)


def _fine_files(bodies: Sequence[Body]) -> bool:
    """Whether some meshes are from files, all fine enough to need no other mesh.

    A finer mesh of a round body is the same polygon, whose new nodes lie off the curve. Next to a
    fitting obstacle such a mesh is worse than the one of the file and confirms nothing.
    """
    files = [body for body in bodies if not isinstance(body.mesh, Box)]
    d = bodies[0].mesh.dimension
    return bool(files) and all(
        body.mesh.total_cells * body.degree**d >= CELLS_PER_CUBE.get(body.mesh.cell, 1) * ACROSS**d
        for body in files
    )


def _fewest(bodies: Sequence[Body]) -> int:
    """Smallest number of cells along an edge of a box; 0 if a body comes from a file."""
    return min(min(body.mesh.cells) if isinstance(body.mesh, Box) else 0 for body in bodies)
