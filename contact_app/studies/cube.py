"""The paper's contact benchmark: 73 rows on a cube in 10×10×10 subdomains (section 5.1, Figure 3).

Every row solves the same dual problem with SMALBE-M under the paper's rule, ρ = 1.1‖F‖,
M = 100‖F‖ divided by 10, to 1e-6 relative to the right-hand side, counted as the paper counts: one
Hessian multiplication an outer iteration. The small scale has 4³ elements in each subdomain, the
paper 30³; and the rows of B are orthonormal here and scaled by multiplicity in the paper. Therefore
the curves of counts are compared, not single numbers. One more solve shows this solver's own
defaults.
"""

from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator, accuracy_of
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.machine.timings import Timings
from contact_app.model.model import Model, build_model
from contact_app.results.fields import cell_fields, node_fields
from contact_app.results.report import write_summary
from contact_app.run.summary import summary_of_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene
from contact_app.studies.paper import Comparison, Row, draw, paper_rows, write_csv
from meshes.arrays import Array
from solver import MPRGP, SMALBE, BoxQP, Counts
from solver.contact.solution import Accuracy, Solution
from solver.qp.operators import estimate_norm
from solver.tfeti.methods.answers import certified_answer
from solver.tfeti.methods.by_smalbe import METHOD
from solver.tfeti.projected import ProjectorEquality

SMALL_CELLS = 40
#: Relative tolerance of the benchmark.
RTOL = 1e-6


def cube_scene(cells: int, subdomains: int = 10, memory: float | None = None) -> Scene:
    """The paper's cube with ``cells``³ elements in ``subdomains``³ subdomains."""
    resource = files("contact_app.studies").joinpath("data/paper_cube.yaml")
    with as_file(resource) as path:
        configuration = load(
            path,
            [
                f"bodies.0.mesh.box.cells=[{cells},{cells},{cells}]",
                f"decomposition.subdomains=[{subdomains},{subdomains},{subdomains}]",
            ],
        )
        return build_scene(configuration, memory)


def reproduce_cube(
    output_dir: Path | str, expansion: str | None = None, comm: MPI.Intracomm = MPI.COMM_WORLD
) -> Iterator[str]:
    """Run the rows, write ``cube_counts.csv``, Figure 3 and a directory with each summary.

    Parameters
    ----------
    expansion : str, optional
        Only the rows of this expansion.

    Yields
    ------
    str
        A sentence for each row and each written file.
    """
    rows = [r for r in paper_rows("contact") if expansion in (None, r.expansion)]
    if not rows:
        names = ", ".join(dict.fromkeys(r.expansion for r in paper_rows("contact")))
        raise ValueError(f"the paper has no rows for the expansion {expansion!r}; it has {names}")
    for line in run_rows(Path(output_dir), cube_scene(SMALL_CELLS), rows, comm):
        if comm.rank == 0:
            yield line


def run_rows(
    output: Path, scene: Scene, rows: list[Row], comm: MPI.Intracomm = MPI.COMM_WORLD
) -> Iterator[str]:
    """Run these rows of the paper on a scene."""
    timings = Timings()
    study = _Study(build_model(scene, comm, timings), output, timings)
    norm, _ = estimate_norm(study.model.problem.projected)
    pairs: list[Comparison] = []
    for paper in rows:
        inner = MPRGP(paper.expansion, paper.alpha_u or 1.9, rtol=RTOL, norm=norm)
        counts = study.run(SMALBE.paper(inner), _name(paper))
        measured = Row(
            paper.benchmark, paper.expansion, paper.alpha_u, counts.outer, counts.hessian,
            counts.cg, counts.expansion, counts.proportioning,
        )  # fmt: skip
        pairs.append(Comparison(measured, paper))
        yield (
            f"{_name(paper)}: {measured.hessian} Hessian multiplications in {measured.outer} outer "
            f"iterations; the paper, on its mesh: {paper.hessian} in {paper.outer}"
        )
    inner = MPRGP("projcg-safe", rtol=RTOL, norm=norm)
    counts = study.run(SMALBE(inner), "default")
    yield (
        f"this solver's own rule with projcg-safe: {counts.hessian} Hessian multiplications in "
        f"{counts.outer} outer iterations"
    )
    if comm.rank == 0:
        table, figure = output / "cube_counts.csv", output / "figure3_cube.png"
        write_csv(table, pairs)
        draw(figure, "Figure 3: contact benchmark", pairs)
        yield f"wrote {table}"
        yield f"wrote {figure}"


def _name(row: Row) -> str:
    return row.expansion if row.alpha_u is None else f"{row.expansion}-{row.alpha_u:g}"


class _Study:
    """The model and all other data that the rows share."""

    def __init__(self, model: Model, output: Path, timings: Timings) -> None:
        self.model, self.output, self.timings = model, output, timings
        self._modelled = timings.as_dict()["total"]
        self._squares: Array | None = None

    def run(self, solver: SMALBE, name: str) -> Counts:
        """Solve, certify, and write a summary."""
        model, problem = self.model, self.model.problem
        clock = self.timings.branched(self._modelled)
        with clock.measure("solve"):
            qp = BoxQP(problem.projected, problem.rhs, lower=problem.lower)
            constraint = equality(model)
            result = solver.solve(qp, constraint)
            force = np.empty(problem.size)
            constraint.apply_transpose(result.multiplier, force)
            answer = certified_answer(problem, result.x, force, RTOL)
            solution = replace(answer, counts=result.counts, reason=result.reason, method=METHOD)
        with clock.measure("output"):
            nodes, cells = node_fields(model, solution), cell_fields(model, solution)
            solved = SolvedScene(model, solution, nodes, cells, self._accuracy(solution), clock)
        summary = summary_of_scene(solved)
        summary["scene"]["title"] = f"{model.scene.title}: {name}"
        if problem.comm.rank == 0:
            (self.output / name).mkdir(parents=True, exist_ok=True)
            write_summary(self.output / name / "summary.json", summary)
        return result.counts

    def _accuracy(self, solution: Solution) -> Accuracy:
        """The mesh error of the first solution; others differ from it by the duality gap."""
        if self._squares is None:
            self._squares = ErrorEstimator(self.model).squares(solution)
        return accuracy_of(self._squares, solution)


def equality(model: Model) -> ProjectorEquality:
    """The equality constraints Gλ = 0."""
    if model.problem.coarse is None:
        raise ValueError("the benchmark needs more than one subdomain")
    return ProjectorEquality(model.problem.coarse)
