"""What the error estimate is worth: effectivity on scenes whose error is known, and targets met.

Two ways to the error ‖u - u_h‖ in energy norm. Where every admissible displacement of the mesh is
admissible in the continuum (flat obstacles), from energies,

    ‖u - u_h‖² ≤ 2 (J(u_h) - J(u)),

J(u) extrapolated (Aitken) from the three finest meshes; by how much the value from the three
before differs is the accuracy of the reference. On a curved obstacle the gap holds at nodes alone,
and energies approach theirs from either side: there from the difference to the finest mesh f,
which contains the others,

    ‖u - u_h‖² = ‖u_f - u_h‖² + ‖u - u_f‖²,

the last term being what makes the errors of the two finest meshes differ by the rate of the two
before. Triangles and tetrahedra of a box refine into themselves as quadrilaterals and hexahedra do.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.configuration import load
from contact_app.refinement import needs_multiples, refined, solve_to_accuracy
from contact_app.run import SolvedScene, solve_scene
from contact_app.scene import Box, Scene, build_scene

Array = NDArray[np.float64]

TOLERANCE = 1e-9
"""Of the solves: their algebraic error is nothing beside that of the mesh."""


@dataclass(frozen=True)
class Case:
    """A sweep: a packaged scene, its cell, cells along an edge, and what is asked of it.

    `conforming` says how its error is found, `targets` which accuracies are asked for.
    """

    scene: str
    cell: str
    meshes: tuple[int, ...]
    conforming: bool
    targets: tuple[float, ...] = ()

    def scene_of(self, cells: int, *overrides: str) -> Scene:
        """The scene with that many cells along every edge."""
        with as_file(files("contact_app").joinpath(f"data/{self.scene}.yaml")) as path:
            dimension = 3 if self.cell in ("hexahedron", "tetrahedron") else 2
            made = [
                f"bodies.0.mesh.box.cells={[cells] * dimension}",
                f"bodies.0.mesh.box.cell={self.cell}",
                "decomposition=auto",
            ]
            return build_scene(load(path, [*made, *overrides]))


CASES = (
    Case("paper_cube", "hexahedron", (5, 10, 20, 40), True, (0.1, 0.05, 0.02)),
    Case("paper_cube", "tetrahedron", (5, 10, 20, 40), True),
    Case("flat_punch", "quadrilateral", (8, 16, 32, 64, 128), True, (0.1, 0.05, 0.02, 0.01)),
    Case("flat_punch", "triangle", (8, 16, 32, 64, 128), True),
    Case("hertz", "quadrilateral", (8, 16, 32, 64, 128), False, (0.1, 0.05, 0.02, 0.01)),
    Case("hertz", "triangle", (8, 16, 32, 64, 128), False),
)


@dataclass(frozen=True)
class Row:
    """A mesh of a sweep; errors relative to the energy norm of its answer."""

    scene: str
    cell: str
    cells: int
    dofs: int
    error: float
    estimate: float
    effectivity: float
    reference_accuracy: float
    seconds: float
    estimate_seconds: float


@dataclass(frozen=True, eq=False)
class _Answer:
    """What a mesh's answer leaves behind: nodal values, energy, estimate."""

    case: Case
    cells: int
    solved: SolvedScene

    @cached_property
    def energy(self) -> float:
        return float(self.solved.summary["solution"]["energy"])

    @cached_property
    def square(self) -> float:
        """a(u_h, u_h)."""
        return self.product(self.displacement)

    @cached_property
    def displacement(self) -> Array:
        """Nodal displacements, (nodes along x, …, dimension), the last axis slowest."""
        found = self.solved.displacement_at_nodes()
        assert found is not None
        dimension = found[1].shape[1]
        lattice = found[1].reshape(*[self.cells + 1] * dimension, dimension)
        return np.transpose(lattice, (*reversed(range(dimension)), dimension))

    def product(self, field: Array) -> float:
        """a(v, v) of a nodal field on this mesh."""
        dimension = field.shape[-1]
        nodal = np.transpose(field, (*reversed(range(dimension)), dimension)).reshape(-1, dimension)
        model, total = self.solved.model, 0.0
        for s, (cls, _) in zip(model.partition.subdomains, model.place, strict=True):
            v = nodal[s.nodes].ravel()
            total += float(v @ (model.problem.classes[cls].stiffness @ v))
        return total

    def on(self, cells: int) -> Array:
        """The same displacements on a mesh refined by halving."""
        field = self.displacement
        while field.shape[0] < cells + 1:
            field = halved(field, self.case.cell in ("triangle", "tetrahedron"))
        return field

    def error_to(self, fine: _Answer) -> float:
        """‖u_f - u_h‖."""
        return fine.product(fine.displacement - self.on(fine.cells)) ** 0.5


def halved(field: Array, simplices: bool) -> Array:
    """Nodal values (…, components) on the lattice with half the spacing.

    A new node halves an edge: of simplices (cut along the diagonals that ascend along all axes)
    from its lower to its upper neighbour, of quadrilaterals and hexahedra axis by axis.
    """
    axes = range(field.ndim - 1)
    if simplices:
        fine = np.ix_(*(np.arange(2 * n - 1) for n in field.shape[:-1]))
        lower, upper = tuple(i // 2 for i in fine), tuple((i + 1) // 2 for i in fine)
        return np.asarray(0.5 * (field[lower] + field[upper]))
    for axis in axes:
        moved = np.moveaxis(field, axis, 0)
        twice = np.empty((2 * len(moved) - 1, *moved.shape[1:]))
        twice[::2], twice[1::2] = moved, 0.5 * (moved[1:] + moved[:-1])
        field = np.moveaxis(twice, 0, axis)
    return field


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
    """Rows of a case, and what they tell of other meshes: J(u), and the rate of the error."""

    rows: tuple[Row, ...]
    energy: float
    rate: float


def sweep(case: Case) -> Sweep:
    """Solve the meshes of a case and compare estimate and error."""
    answers = [_answer(case, cells) for cells in case.meshes]
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
        relative = error / answer.square**0.5
        estimate = answer.solved.accuracy.discretisation
        assert estimate is not None
        rows.append(
            Row(
                case.scene, case.cell, answer.cells, answer.solved.model.dofs, relative, estimate,
                estimate / relative, doubt, timings["total"], timings["estimate"],
            )
        )  # fmt: skip
    return Sweep(tuple(rows), reference, float(np.log2(errors[-2] / errors[-1])))


def _answer(case: Case, cells: int) -> _Answer:
    scene = case.scene_of(cells, f"solver.tolerance={TOLERANCE}")
    return _Answer(case, cells, solve_scene(scene, MPI.COMM_SELF))


@dataclass(frozen=True)
class Reached:
    """A run to an accuracy: `error` is measured, `best_dofs` the least equal cells need.

    Where the run graded its cells, that follows from the rate of the sweep.
    """

    scene: str
    cell: str
    target: float
    levels: int
    dofs: int
    best_dofs: int
    estimate: float
    error: float
    hessian_multiplications: int
    seconds: float
    missed: str


START = 8
"""Cells along an edge where runs to an accuracy begin."""

LARGEST = 300_000
"""Degrees of freedom up to which the best mesh is searched, and a mesh solved to compare with."""


def reach(case: Case, target: float, known: Sweep) -> Reached:
    """Ask for an accuracy and measure what came out.

    On curved obstacles the error is that to a mesh twice as fine, which leaves out a part that
    the rate of the sweep tells.
    """
    scene = case.scene_of(START, f"accuracy={target}")
    found = solve_to_accuracy(scene, lambda level: solve_scene(level, MPI.COMM_SELF))
    levels, last = found.levels, found.levels[-1]
    solved = found.solved
    mesh = solved.model.scene.bodies[0].mesh
    problem, fields = solved.model.problem, solved.solution.displacements
    square = sum(float(np.vdot(u, c.stiffness @ u)) for c, u in zip(problem.classes, fields,
                                                                    strict=True))  # fmt: skip
    if case.conforming:
        energy = float(solved.summary["solution"]["energy"])
        error = (2.0 * max(energy - known.energy, 0.0)) ** 0.5
    else:
        assert isinstance(mesh, Box)  # no singularity: cells stay equal
        answer = _Answer(case, mesh.cells[0], solved)
        error = answer.error_to(_answer(case, 2 * mesh.cells[0]))
        error /= (1.0 - 4.0**-known.rate) ** 0.5
    best = last.dofs
    if not isinstance(mesh, Box):
        finest = known.rows[-1]
        cells = finest.cells * (finest.estimate / target) ** (1.0 / known.rate)
        best = round(mesh.dimension * (cells + 1) ** mesh.dimension)
    elif not found.missed and best <= LARGEST and len(levels) > 1:
        best = _best(scene, levels[-2].cells, levels[-1].cells, target)
    return Reached(
        case.scene, case.cell, target, len(levels), last.dofs, best, last.total,
        error / square**0.5, sum(level.hessian_multiplications for level in levels),
        sum(level.seconds for level in levels), found.missed,
    )  # fmt: skip


def _best(scene: Scene, below: int, enough: int, target: float) -> int:
    """Least degrees of freedom at which the estimate meets a target, by bisection."""
    mesh = scene.bodies[0].mesh
    assert isinstance(mesh, Box)
    one, dimension = mesh.total_cells / START**mesh.dimension, mesh.dimension
    low, high = (round((cells / one) ** (1.0 / dimension)) for cells in (below, enough))
    step = START if needs_multiples(scene) else 1
    dofs = dimension * (high + 1) ** dimension
    while high - low > step:
        middle = low + (high - low) // (2 * step) * step
        solved = solve_scene(refined(scene, middle / START), MPI.COMM_SELF)
        total = solved.accuracy.total
        if total is not None and total <= target:
            high, dofs = middle, solved.model.dofs
        else:
            low = middle
    return dofs


def effectivity(directory: Path, cases: tuple[Case, ...] = CASES) -> Iterator[str]:
    """Write ``effectivity.csv`` and ``targets.csv``; yields their rows as tables for a page."""
    rows: list[Row] = []
    reached: list[Reached] = []
    yield "| scene | cell | cells | unknowns | error | estimate | effectivity | error known to |"
    yield "|---|---|---|---|---|---|---|---|"
    sweeps = []
    for case in cases:
        sweeps.append(sweep(case))
        rows += sweeps[-1].rows
        for r in sweeps[-1].rows:
            yield (
                f"| {r.scene} | {r.cell} | {r.cells} | {r.dofs:,} | {100 * r.error:.2f} % | "
                f"{100 * r.estimate:.2f} % | {r.effectivity:.2f} | "
                f"{100 * r.reference_accuracy:.1g} % |"
            )
    yield ""
    yield (
        "| scene | cell | asked for | levels | unknowns | equal cells need | estimate | error | "
        "Hessian multiplications | seconds |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for case, known in zip(cases, sweeps, strict=True):
        for target in case.targets:
            run = reach(case, target, known)
            reached.append(run)
            yield (
                f"| {run.scene} | {run.cell} | {100 * run.target:g} % | {run.levels} | "
                f"{run.dofs:,} | {run.best_dofs:,} | {100 * run.estimate:.2f} % | "
                f"{100 * run.error:.2f} % | {run.hessian_multiplications} | {run.seconds:.1f} | "
                f"{run.missed}"
            )
    directory.mkdir(parents=True, exist_ok=True)
    tables: dict[str, list[Any]] = {"effectivity": rows, "targets": reached}
    for name, table in tables.items():
        with (directory / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(asdict(table[0])))
            writer.writeheader()
            writer.writerows(asdict(row) for row in table)
        yield f"wrote {directory / f'{name}.csv'}"
