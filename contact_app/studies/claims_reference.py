"""Error of an answer to a random scene, against one fine mesh of degree 2 per scene.

The reference has quadrilaterals or hexahedra of degree 2 between grid lines that are finer than the
start by `FINER` at least, and halve again and again towards the sides of the box and towards places
where a load, a support or a contact begins, where stresses may be singular. If its estimated error
is above 2 %, more grid lines are placed by that error, up to three times. A reference with an error
above a third of the target is not used, since the distance of two solutions of equal error tells
little about either. The estimated squared error of the reference, η_f², is added to the square of
each error.

The error of an answer u_h is the larger of two: its distance ‖u_f - u_h‖ in energy norm, summed by
quadrature on the cells of both meshes together, and, with flat obstacles, the difference of
energies, 2 (J(u_h) - J(u_f)). Both include η_f² and are relative to ‖u_h‖, as
docs/guide/accuracy.md defines the relative error.
"""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.refine.grading import graded, layer_errors
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from contact_app.scene.obstacles import Plane
from contact_app.scene.scene import Decomposition, Scene
from contact_app.studies.claims_scenes import ClaimScene
from contact_app.studies.fields_on_meshes import gradients
from contact_app.studies.reference import Fields
from contact_app.studies.single_run import fields_of
from meshes.arrays import Array
from meshes.graded import graded_box
from meshes.quadratic import VERTICES

FINER = {2: 8, 3: 4}
"""Equal cells of the reference per cell of the first mesh along an edge, by dimension; cells at the
ends of edges are `2 ** HALVINGS` times finer still."""

HALVINGS = {2: 6, 3: 2}

THINNEST = {2: 16, 3: 6}
"""Least number of equal cells of the reference across the shortest edge."""

LONGEST = 4.0
"""Largest ratio of the edges of the equal cells of the reference."""

TOLERANCE = 1e-8
"""Tolerance of the reference's solve."""

GAUSS, BATCH = 3, 200_000
"""Gauss points along each axis of a cell, and points at which gradients are evaluated at once."""

COORDINATE = 1e-9
"""Distance over the size of the body below which two coordinates are the same."""

EXACT = 0.02
"""Estimated relative error below which a reference is accurate enough."""

ROUNDS, MORE = 3, 1.5
"""Number of times that the lines of an inaccurate reference are placed anew, and the factor on
their number."""

LARGEST = {2: 100_000, 3: 120_000}
"""Largest number of unknowns of a reference."""

TRUSTED = 1.0 / 3.0
"""Largest estimated error of a reference relative to the target: it adds at most 6 % to the
measured error."""


@dataclass(frozen=True, eq=False)
class FineSolution:
    """The answer on the fine mesh."""

    solved: SolvedScene

    @property
    def missing(self) -> float:
        """η_f², the estimated squared error of the fine mesh."""
        return self.solved.accuracy.discretisation**2 * self.solved.accuracy.square

    def judges(self, target: float) -> bool:
        """Whether it is accurate enough to judge a run to a target."""
        return self.missing <= (TRUSTED * target) ** 2 * self.solved.accuracy.square

    def relative_error(self, solved: SolvedScene) -> float:
        """Relative error of a solution of the same scene on any mesh."""
        scene, square, finest = solved.model.scene, solved.accuracy.square, self.solved
        lame = scene.bodies[0].materials[0].lame(scene.plane)
        distance = square_distance(fields_of(finest), fields_of(solved), lame)
        if all(isinstance(contact.obstacle, Plane) for contact in scene.contacts):
            energies = [of.summary["solution"]["energy"] for of in (finest, solved)]
            distance = max(distance, 2.0 * (energies[1] - energies[0]))
        if square == 0.0:  # obstacles carry the loads directly: the body has no strains
            square = finest.accuracy.square
            return float(np.sqrt(distance / square)) if square > 0.0 else 0.0
        return float(np.sqrt((distance + self.missing) / square))


def square_distance(one: Fields | None, other: Fields | None, lame: tuple[float, float]) -> float:
    """a(v, v) of the difference of two fields on one box, by a Gauss rule.

    The meshes of a box are products of grid lines; triangles and tetrahedra cut the cells between
    the lines. Both fields are polynomials on the cells that the lines of both make together (up to
    the cuts).
    """
    assert one is not None
    assert other is not None  # one rank
    meshes = [fields.nodes(0) for fields in (one, other)]
    d, (lam, mu), total = meshes[0].dimension, lame, 0.0
    place, weight = np.polynomial.legendre.leggauss(GAUSS)
    vertices = [m.points[np.unique(m.cells[:, : VERTICES[m.cell]])] for m in meshes]
    axes, shares = [], []
    for x in np.concatenate(vertices).T[:d]:
        line = np.unique(x)
        line = line[np.concatenate([[True], np.diff(line) > COORDINATE * np.ptp(line)])]
        half = 0.5 * np.diff(line)[:, None]
        axes.append((line[:-1, None] + half * (1.0 + place)).ravel())
        shares.append((half * weight).ravel())
    points = np.zeros((np.prod([len(x) for x in axes]), 3))
    points[:, :d] = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, d)
    weights = reduce(np.multiply.outer, shares).ravel()
    for rows in np.array_split(np.arange(len(points)), 1 + len(points) // BATCH):
        first, second = (
            gradients(mesh, fields.displacement, points[rows])
            for mesh, fields in zip(meshes, (one, other), strict=True)
        )
        strain = 0.5 * (first - second)
        strain = strain + np.swapaxes(strain, 1, 2)
        density = 2.0 * mu * (strain**2).sum(axis=(1, 2))
        density += lam * np.trace(strain, axis1=1, axis2=2) ** 2
        total += float(density @ weights[rows])
    return total


def reference_lines(claim: ClaimScene, dimension: int) -> list[Array]:
    """Grid lines of the reference along each axis."""
    size, cells = np.array(claim.box["upper"]), claim.box["cells"]
    counts = [FINER[dimension] * n for n in cells]
    thin = int(np.argmin(size))
    counts[thin] = max(counts[thin], THINNEST[dimension])
    step = LONGEST * size.min() / THINNEST[dimension]
    counts = [max(n, int(np.ceil(x / step))) for n, x in zip(counts, size, strict=True)]
    result = []
    for axis, n in enumerate(counts):
        line = np.linspace(0.0, size[axis], n + 1)
        wanted = np.array([0.0, *claim.breaks[axis], size[axis]])
        line = np.concatenate([line, wanted])
        h = size[axis] / n
        for x in wanted:
            for k in range(1, HALVINGS[dimension] + 1):
                line = np.concatenate([line, [x - h * 0.5**k, x + h * 0.5**k]])
        line = np.unique(np.clip(line, 0.0, size[axis]))
        wide = np.diff(line) > 0.3 * h * 0.5 ** HALVINGS[dimension]
        result.append(_with(line[np.concatenate([[True], wide])], wanted, size[axis]))
    return result


def _finer_lines(claim: ClaimScene, solved: SolvedScene, lines: list[Array]) -> list[Array]:
    """Half as many lines again, placed by the error of the last reference."""
    (squares,) = layer_errors(solved, [lines])
    limit = LARGEST[len(lines)] / solved.model.dofs
    more = min(MORE, max(limit, 1.0) ** (1.0 / len(lines)))
    fixed = [
        np.unique([line[0], *breaks, line[-1]])
        for line, breaks in zip(lines, claim.breaks, strict=True)
    ]
    return [
        graded(line, part, round(more * (len(line) - 1)), still, degree=2)
        for line, part, still in zip(lines, squares, fixed, strict=True)
    ]


def _solved(scene: Scene, lines: list[Array]) -> SolvedScene:
    """The scene with cells of degree 2 between lines.

    Raises
    ------
    RuntimeError
        The solver did not reach its tolerance.
    """
    (body,) = scene.bodies
    cell = "hexahedron" if scene.dimension == 3 else "quadrilateral"
    fine = replace(
        scene, accuracy=None, bodies=(replace(body, mesh=graded_box(cell, lines), degree=2),),
        decomposition=Decomposition(1), solver=replace(scene.solver, tolerance=TOLERANCE),
    )  # fmt: skip
    solved = solve_scene(fine, MPI.COMM_SELF)
    if not solved.solution.converged:
        raise RuntimeError("the reference did not converge")
    return solved


def _with(line: Array, wanted: Array, size: float) -> Array:
    """The lines; for each wanted coordinate the nearest line is moved there."""
    for x in wanted:
        line[np.argmin(np.abs(line - x))] = x
    line[-1] = size
    return np.unique(line)


def fine_solution(claim: ClaimScene, scene: Scene) -> FineSolution:
    """The solution on the fine mesh."""
    lines = reference_lines(claim, scene.dimension)
    solved = _solved(scene, lines)
    for _ in range(ROUNDS):
        if solved.accuracy.discretisation < EXACT:
            break
        lines = _finer_lines(claim, solved, lines)
        solved = _solved(scene, lines)
    return FineSolution(solved)
