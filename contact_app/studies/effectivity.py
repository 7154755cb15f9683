"""Quality of the error estimate: effectivity on scenes with known error, and runs to targets.

The error ‖u - u_h‖ in energy norm is computed in two ways. If every admissible displacement of the
mesh is admissible in the continuum (flat obstacles), it follows from energies,

    ‖u - u_h‖² ≤ 2 (J(u_h) - J(u)),

with J(u) extrapolated (Aitken) from the three finest meshes. The difference from the value of the
three meshes before is the accuracy of the reference. On a curved obstacle the gap condition holds
only at nodes, and energies approach their limit from either side. There the error follows from the
difference to the finest mesh f, which contains the others,

    ‖u - u_h‖² = ‖u_f - u_h‖² + ‖u - u_f‖²,

with the last term chosen so that the errors of the two finest meshes have the rate of the two
meshes before. The meshes of a box are nested, also those of triangles and tetrahedra. With mean
dilatation the energy is not that of u_h, and the distance of the stresses is used, ∫ (σ_f - σ_h) :
C⁻¹ : (σ_f - σ_h) dx.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.estimate.stress_recovery import (
    StressRecovery,
    apply,
    at_cells,
    stress_operator,
)
from contact_app.accuracy.refine.next_mesh import STEPS
from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from contact_app.scene.bodies import BodyMesh, Box
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene
from contact_app.studies.fields_on_meshes import interpolation
from contact_app.studies.reference import Fields
from contact_app.studies.single_run import fields_of
from contact_app.studies.tables import write
from meshes.arrays import Array
from meshes.graded import graded_box
from meshes.unstructured import CellMesh

TOLERANCE = 1e-9
"""Tolerance of the solves: their algebraic error is negligible compared with that of the mesh."""


@dataclass(frozen=True)
class Case:
    """A sweep: a packaged scene, its cell, its numbers of cells along an edge, and its targets.

    `conforming` chooses the way to its error, and `targets` are the accuracies of its runs. With
    mean dilatation the material is nearly incompressible.
    """

    scene: str
    cell: str
    meshes: tuple[int, ...]
    conforming: bool
    targets: tuple[float, ...] = ()
    degree: int = 1
    mean_dilatation: bool = False

    @property
    def element(self) -> str:
        """The cell, its degree and its treatment of the volume, in words."""
        return (
            self.cell
            + (" of degree 2" if self.degree == 2 else "")
            + (", B-bar, ν = 0.4999" if self.mean_dilatation else "")
        )

    def scene_of(self, cells: int, *overrides: str) -> Scene:
        """The scene with a number of cells along every edge."""
        with as_file(files("contact_app.studies").joinpath(f"data/{self.scene}.yaml")) as path:
            dimension = 3 if self.cell in ("hexahedron", "tetrahedron") else 2
            made = [
                f"bodies.0.mesh.box.cells={[cells] * dimension}",
                f"bodies.0.mesh.box.cell={self.cell}",
                "decomposition=auto",
            ]
            if self.degree == 2:
                made.append("bodies.0.degree=2")
            if self.mean_dilatation:
                made += [
                    "bodies.0.mean_dilatation=true",
                    "bodies.0.material.poisson=0.4999",
                    "decomposition.subdomains=1",
                ]
            return build_scene(load(path, [*made, *overrides]))


CASES = (
    Case("paper_cube", "hexahedron", (5, 10, 20, 40), True, (0.1, 0.05, 0.02, 0.01)),
    Case("paper_cube", "tetrahedron", (5, 10, 20, 40), True),
    Case("flat_punch", "quadrilateral", (8, 16, 32, 64, 128), True, (0.1, 0.05, 0.02, 0.01)),
    Case("flat_punch", "triangle", (8, 16, 32, 64, 128), True),
    Case("hertz", "quadrilateral", (8, 16, 32, 64, 128), False, (0.1, 0.05, 0.02, 0.01)),
    Case("hertz", "triangle", (8, 16, 32, 64, 128), False),
    Case("paper_cube", "hexahedron", (3, 6, 12, 24), True, degree=2),
    Case("paper_cube", "tetrahedron", (2, 4, 8, 16), True, degree=2),
    Case("flat_punch", "quadrilateral", (8, 16, 32, 64), True, degree=2),
    Case("flat_punch", "triangle", (8, 16, 32, 64), True, degree=2),
    Case("hertz", "quadrilateral", (8, 16, 32, 64), False, degree=2),
    Case("paper_cube", "hexahedron", (4, 8, 16, 32), False, mean_dilatation=True),
    Case("flat_punch", "quadrilateral", (8, 16, 32, 64, 128), False, mean_dilatation=True),
    Case("hertz", "quadrilateral", (8, 16, 32, 64, 128), False, mean_dilatation=True),
)


@dataclass(frozen=True)
class Row:
    """A mesh of a sweep; errors relative to the energy norm of its answer."""

    scene: str
    element: str
    cells: int
    dofs: int
    error: float
    estimate: float
    effectivity: float
    reference_accuracy: float
    seconds: float
    estimate_seconds: float


@dataclass(frozen=True, eq=False)
class AnswerOnMesh:
    """Stored results of a mesh: nodal values, energy, estimate."""

    case: Case
    cells: int
    solved: SolvedScene

    @cached_property
    def energy(self) -> float:
        """J(u_h)."""
        return float(self.solved.summary["solution"]["energy"])

    @cached_property
    def square(self) -> float:
        """a(u_h, u_h)."""
        return self.product(self.displacement)

    @cached_property
    def fields(self) -> Fields:
        """Nodes, cells and displacements."""
        fields = fields_of(self.solved)
        assert fields is not None  # one rank
        return fields

    @property
    def displacement(self) -> Array:
        """Nodal displacements, (nodes, dimension)."""
        return self.fields.displacement

    @property
    def norm(self) -> float:
        """Energy norm of the answer; with mean dilatation of its stress."""
        if self.case.mean_dilatation:
            return float(np.linalg.norm(self.stresses(self.displacement, self.cells)))
        return float(self.square**0.5)

    def product(self, field: Array) -> float:
        """a(v, v) of a nodal field on this mesh."""
        model, total = self.solved.model, 0.0
        for s, (cls, _) in zip(model.partition.subdomains, model.place, strict=True):
            v = field[s.nodes].ravel()
            total += float(v @ (model.problem.classes[cls].stiffness @ v))
        return total

    def on(self, fine: "AnswerOnMesh") -> Array:
        """The displacements at the nodes of a mesh that refines this one."""
        values = interpolation(self.fields.nodes(0), fine.fields.points)
        return np.asarray(values @ self.displacement)

    def error_to(self, fine: "AnswerOnMesh") -> float:
        """‖u_f - u_h‖; with mean dilatation the distance of the stresses, over C⁻¹."""
        if self.case.mean_dilatation:
            difference = fine.stresses(fine.displacement, fine.cells)
            difference -= fine.stresses(self.on(fine), self.cells)
            return float(np.linalg.norm(difference))
        return fine.product(fine.displacement - self.on(fine)) ** 0.5

    def stresses(self, field: Array, cells: int) -> Array:
        """Stresses on this mesh of a field on a mesh with a number of cells along an edge.

        B-bar: div u is averaged over the cells of that mesh. Squares add up to ∫ σ : C⁻¹ : σ.

        Returns
        -------
        (cells, points, components)
        """
        model = self.solved.model
        (subdomain,), d = model.partition.subdomains, model.scene.dimension
        recovery = StressRecovery(model)
        patches, every = recovery.cells[0], np.zeros(1, np.int64)
        table = patches.table(2)
        shape, volume = recovery.moduli[0][0]
        root = np.linalg.cholesky(np.linalg.inv(shape + volume))
        local = at_cells(field[subdomain.nodes][:, None], patches.nodes)
        gradients, jacobian = patches.gradients(every, table)
        stress = apply(stress_operator(gradients, root.T @ shape @ recovery.V), local)[0]
        trace = np.eye(d).reshape(1, -1)
        divergence = apply(stress_operator(patches.mean_gradients(every), trace), local)[0, :, 0]
        box = model.scene.bodies[0].mesh
        lower, upper = np.array(box.lower), np.array(box.upper)
        centres = subdomain.points()[subdomain.reference.cells].mean(axis=1)[:, :d]
        place = np.floor((centres - lower) / (upper - lower) * cells).astype(int)
        block = place @ cells ** np.arange(d)
        mean = (np.bincount(block, divergence) / np.bincount(block))[block]
        stress = stress.reshape(len(mean), len(table.weights), -1)
        stress += mean[:, None, None] * (root.T @ volume[0])
        return np.asarray(stress * np.sqrt(table.weights * jacobian)[..., None])


def aitken(values: list[float]) -> float:
    """Limit of a sequence that converges geometrically, from its last three values."""
    a, b, c = values[-3:]
    return c + (c - b) / ((b - a) / (c - b) - 1.0)


def errors_from_differences(differences: list[float]) -> tuple[list[float], float]:
    """‖u - u_h‖ of all meshes but the finest from ‖u_f - u_h‖, and the share of ‖u - u_f‖.

    E_k² = D_k² + E_f², with the rate of E between the last two of D continued to E_f.
    """
    squares, finest = np.array(differences) ** 2, 0.0
    for _ in range(50):
        ratio = (squares[-2] + finest) / (squares[-1] + finest)
        finest = (squares[-1] + finest) / ratio
    return [float(v) for v in np.sqrt(squares + finest)], float(np.sqrt(finest))


@dataclass(frozen=True)
class Sweep:
    """Rows of a case, and the data for other meshes: J(u) and the rate of the error."""

    rows: tuple[Row, ...]
    energy: float
    rate: float


def sweep(case: Case) -> Sweep:
    """Solve the meshes of a case and compare estimate and error."""
    answers = [estimated_answer(case, cells) for cells in case.meshes]
    energies = [answer.energy for answer in answers]
    reference = aitken(energies)
    if case.conforming:
        errors = [(2.0 * (energy - reference)) ** 0.5 for energy in energies]
        uncertain = [abs(reference - aitken(energies[:-1])) / error**2 for error in errors]
    else:
        errors, finest = errors_from_differences([a.error_to(answers[-1]) for a in answers[:-1]])
        uncertain = [0.5 * (finest / error) ** 2 for error in errors]
    rows = []
    for answer, error, doubt in zip(answers, errors, uncertain, strict=False):
        timings = answer.solved.summary["timings"]
        relative = error / answer.norm
        estimate = answer.solved.accuracy.discretisation
        dofs = answer.solved.model.dofs
        rows.append(
            Row(
                case.scene, case.element, answer.cells, dofs, relative, estimate,
                estimate / relative, doubt, timings["total"], timings["estimate"],
            )
        )  # fmt: skip
    return Sweep(tuple(rows), reference, float(np.log2(errors[-2] / errors[-1])))


def estimated_answer(case: Case, cells: int) -> AnswerOnMesh:
    """The solved case on a mesh with a number of cells, with the data that measure its error."""
    scene = case.scene_of(cells, f"solver.tolerance={TOLERANCE}")
    return AnswerOnMesh(case, cells, solve_scene(scene, MPI.COMM_SELF))


@dataclass(frozen=True)
class AccuracyRun:
    """A run to an accuracy: `error` is measured.

    `equal_dofs` are the unknowns that equal cells of degree 1 need by the rate of their sweep.
    `all_dofs` is the sum over the levels.
    """

    scene: str
    cell: str
    target: float
    levels: int
    dofs: int
    degree: int
    equal_dofs: int
    estimate: float
    error: float
    all_dofs: int
    hessian_multiplications: int
    seconds: float
    missed: str


START = {2: 8, 3: 4}
"""Cells along an edge at the start of runs to an accuracy, by dimension."""


def measured(case: Case, solved: SolvedScene, series: Sweep) -> float:
    """Relative error of an answer on any mesh of a case.

    On curved obstacles it is the distance to a mesh twice as fine, raised by the part that this
    leaves out according to the rate of such cells.
    """
    degree = solved.model.scene.bodies[0].degree
    answer = AnswerOnMesh(replace(case, degree=degree), 0, solved)
    if case.conforming:
        error = (2.0 * max(answer.energy - series.energy, 0.0)) ** 0.5
    else:
        finer = AnswerOnMesh(answer.case, 0, solve_scene(_halved_cells(solved.model.scene)))
        error = answer.error_to(finer)
        error /= (1.0 - 4.0 ** -STEPS.fastest[degree]) ** 0.5
    return float(error / answer.norm)


def reach(case: Case, target: float, series: Sweep) -> AccuracyRun:
    """Run to an accuracy and measure the error."""
    dimension = case.scene_of(2).dimension
    scene = case.scene_of(START[dimension], f"accuracy={target}")
    refined = solve_to_accuracy(scene, partial(solve_scene, comm=MPI.COMM_SELF))
    levels, last = refined.levels, refined.levels[-1]
    solved = refined.solved
    finest = series.rows[-1]
    cells = finest.cells * (finest.estimate / target) ** (1.0 / series.rate)
    return AccuracyRun(
        case.scene, case.cell, target, len(levels), last.dofs,
        solved.model.scene.bodies[0].degree,
        round(dimension * (cells + 1) ** dimension), last.total, measured(case, solved, series),
        sum(level.dofs for level in levels),
        sum(level.hessian_multiplications for level in levels),
        sum(level.seconds for level in levels), refined.missed,
    )  # fmt: skip


def _halved_cells(scene: Scene) -> Scene:
    """The scene with halved cells of its box, solved to far below the mesh's error."""
    (body,) = scene.bodies
    if isinstance(body.mesh, Box):
        mesh: BodyMesh = replace(body.mesh, cells=tuple(2 * n for n in body.mesh.cells))
    else:
        assert isinstance(body.mesh, CellMesh)
        axes = [np.unique(x) for x in body.mesh.points.T]
        halved_axes = [np.sort(np.concatenate([x, 0.5 * (x[1:] + x[:-1])])) for x in axes]
        mesh = graded_box(body.mesh.cell, halved_axes)
    return replace(
        scene, accuracy=None, bodies=(replace(body, mesh=mesh),),
        solver=replace(scene.solver, tolerance=TOLERANCE),
    )  # fmt: skip


def effectivity(directory: Path, cases: tuple[Case, ...] = CASES) -> Iterator[str]:
    """Write ``effectivity.csv`` and ``targets.csv``; yields tables for a page."""
    rows: list[Row] = []
    reached: list[AccuracyRun] = []
    yield "| scene | cell | cells | unknowns | error | estimate | effectivity | error known to |"
    yield "|---|---|---|---|---|---|---|---|"
    sweeps: dict[Case, Sweep] = {}
    for case in cases:
        sweeps[case] = sweep(case)
        rows += sweeps[case].rows
        for r in sweeps[case].rows:
            yield (
                f"| {r.scene} | {r.element} | {r.cells} | {r.dofs:,} | {100 * r.error:.2f} % | "
                f"{100 * r.estimate:.2f} % | {r.effectivity:.2f} | "
                f"{100 * r.reference_accuracy:.1g} % |"
            )
    yield ""
    yield (
        "| scene | target | levels | unknowns | equal cells of degree 1 | estimate | error | "
        "unknowns of all levels | Hessian multiplications | seconds |"
    )
    yield "|---" * 10 + "|"
    for case, series in sweeps.items():
        for target in case.targets:
            run = reach(case, target, series)
            reached.append(run)
            yield (
                f"| {run.scene} | {100 * run.target:g} % | {run.levels} | {run.dofs:,} | "
                f"{run.equal_dofs:,} | {100 * run.estimate:.2f} % | {100 * run.error:.2f} % | "
                f"{run.all_dofs:,} | {run.hessian_multiplications} | {run.seconds:.1f} | "
                f"{run.missed}"
            )
    directory.mkdir(parents=True, exist_ok=True)
    tables: dict[str, list[Any]] = {"effectivity": [asdict(row) for row in rows],
                                    "targets": [asdict(run) for run in reached]}  # fmt: skip
    for name, table in tables.items():
        write(table, list(table[0]), directory / f"{name}.csv")
        yield f"wrote {directory / f'{name}.csv'}"
