"""The Python interface to scenes: `solve` takes a file or a mapping and returns arrays."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.accuracy.nodal_stress import nodal_stresses
from contact_app.accuracy.refine.levels import with_levels
from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError
from contact_app.machine.ranks import on_first
from contact_app.results.fields import NODAL_FIELDS
from contact_app.results.mirror import full_mesh
from contact_app.results.output import cells_of, write_fields
from contact_app.results.report import write_summary
from contact_app.results.series import Series
from contact_app.run.cases import Overview, solved_cases
from contact_app.run.files import refuse_without_bound
from contact_app.run.increments import SolvedIncrement, solved_increments
from contact_app.run.refined_steps import history_to_accuracy
from contact_app.run.solve import solve_scene
from contact_app.run.step_records import Record, record_of, summary_of_steps, write_table
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping, load
from contact_app.scene.scene import Scene
from meshes.arrays import Array, Ints
from solver.contact.certificate import Certificate


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a scene; arrays are of the nodes and cells of this rank.

    On one rank these are all nodes and cells. A scene that was cut at planes of symmetry has the
    arrays of the whole.
    """

    summary: dict[str, Any]
    """Content of `summary.json`."""
    points: Array  # (nodes, 3)
    displacement: Array  # (nodes, dimension)
    contact_pressure: Array  # (nodes,)
    """Force per area; zero away from contact, the largest value where a node lies on several
    contacts."""
    smoothed_contact_pressure: Array  # (nodes,)
    """Contact pressure without the variation within single facets."""
    gap: Array  # (nodes,)
    """Remaining distance; NaN where nothing is near."""
    friction_traction: Array | None
    slip: Array | None
    """Friction force per area on the body of `on`, and its slip (length) on the other side. None
    without friction. Shape (nodes, dimension)."""
    contact_status: Array | None  # (nodes,)
    """0 where a node is open, 1 where it sticks, 2 where it slides. None without friction."""
    cells: list[Ints]  # one (cells, nodes of a cell) array per body
    """Rows of `points` (under ``mpirun`` numbers of the nodes of all ranks), in VTK's order; joined
    they are in the order of `stress`. Mirror images follow with arrays of their own."""
    stress: Array  # (cells, 6)
    """Components xx, yy, zz, xy, yz, xz: the mean over each cell."""
    von_mises: Array  # (cells,)
    nodal_stress: Array | None
    nodal_von_mises: Array | None
    """The stress recovered at nodes; where several materials meet, that of the material with the
    largest von Mises stress. None if `output.fields` leaves them out. Shapes (nodes, 6),
    (nodes,)."""
    solved: SolvedScene

    @property
    def certificate(self) -> Certificate:
        """The certificate.

        Relative errors of the answer, and `passed`: whether all meet the tolerance.
        """
        return self.solved.solution.certificate

    @property
    def converged(self) -> bool:
        """Whether every number of the certificate is below the tolerance."""
        return self.solved.solution.converged

    def write(self, directory: Path | str) -> None:
        """Write the files of fields in `output`, and `summary.json` (collective)."""
        directory, model = Path(directory), self.solved.model
        on_first(model.comm, lambda: directory.mkdir(parents=True, exist_ok=True))
        write_fields(model, self.solved.fields, directory)
        on_first(model.comm, lambda: write_summary(directory / "summary.json", self.summary))


@dataclass(frozen=True, eq=False)
class CaseAnswers:
    """The answers to a scene with load cases."""

    cases: Mapping[str, Answer]
    """The answer to each case, by its name, in the order of the scene."""
    _overview: Overview

    @property
    def summary(self) -> dict[str, Any]:
        """The overview: ``summary.json`` in the directory of the run."""
        return self._overview.summary

    @property
    def converged(self) -> bool:
        """Whether every case is certified."""
        return all(answer.converged for answer in self.cases.values())

    def write(self, directory: Path | str) -> None:
        """Write a directory for each case, `envelope.xdmf` and `summary.json` (collective)."""
        directory = Path(directory)
        for name, answer in self.cases.items():
            answer.write(directory / name)
        self._overview.write(directory)


@dataclass(frozen=True, eq=False)
class StepAnswers:
    """The answers to a scene with load steps."""

    increments: Sequence[Answer]
    """The answer to each increment, in order; the `summary` of each is its record."""
    summary: dict[str, Any]
    """Content of `summary.json`: the summary of the last increment, and `steps` with a record per
    increment."""

    @property
    def last(self) -> Answer:
        """The answer to the last increment."""
        return self.increments[-1]

    @property
    def converged(self) -> bool:
        """Whether the history was solved to its end and every increment is certified."""
        return all(answer.converged for answer in self.increments)

    def write(self, directory: Path | str) -> None:
        """Write the files of fields, `increments.csv` and `summary.json` (collective)."""
        directory, comm = Path(directory), self.last.solved.model.comm
        on_first(comm, lambda: directory.mkdir(parents=True, exist_ok=True))
        series = Series()
        for answer, record in zip(self.increments, self.summary["steps"], strict=True):
            solved = answer.solved
            series.begin(record["time"])
            write_fields(solved.model, solved.fields, directory, series)
        on_first(comm, lambda: write_table(directory / "increments.csv", self.summary["steps"]))
        on_first(comm, lambda: write_summary(directory / "summary.json", self.summary))


def solve(
    scene: str | Path | Mapping[str, Any],
    overrides: Sequence[str] = (),
    comm: MPI.Intracomm = MPI.COMM_WORLD,
) -> Answer | CaseAnswers | StepAnswers:
    """Solve a scene and certify the answer (collective); writes nothing.

    Parameters
    ----------
    scene
        A YAML file, or a mapping of the same keys. Mesh files are relative to the directory of the
        YAML file; for a mapping, to the working directory.
    overrides
        Changes as ``path.to.key=value``, as after ``--set`` on the command line.
    comm
        Communicator of the ranks that share the work.

    Returns
    -------
    The answer; for a scene with `cases` the answers to all cases, with `steps` to all increments.

    Raises
    ------
    ConfigurationError
        Bad input: file, line, key and what is allowed.
    NoEquilibriumError
        A body would move away under its loads.
    CouldNotRunError
        The program could not run; the message has the remedy.
    """
    if not isinstance(scene, str | Path | Mapping):
        raise ConfigurationError(
            f"a scene is the path of a YAML file or a mapping of its keys, not {scene!r:.80}"
        )
    _check_arguments(overrides, comm)
    read = from_mapping(scene, overrides) if isinstance(scene, Mapping) else load(scene, overrides)
    built = build_scene(read, comm=comm)
    if built.symmetry:
        from contact_app.model.symmetry import halved

        built = halved(built).scene
    if built.cases:
        return _answers(built, comm)
    if built.steps and built.accuracy is not None:
        history = history_to_accuracy(built, comm, lambda place: None, refuse_without_bound)
        answers = map(_of_record, history.increments, history.records)
        return StepAnswers(list(answers), history.summary)
    if built.steps:
        return _step_answers(
            solved_increments(built, comm, lambda place: None, refuse_without_bound)
        )
    if built.accuracy is None:
        solved = solve_scene(built, comm, report=refuse_without_bound)
        return _answer(solved, solved.summary)
    refined = solve_to_accuracy(built, partial(solve_scene, comm=comm, report=refuse_without_bound))
    return _answer(refined.solved, with_levels(refined.solved.summary, refined))


def _check_arguments(overrides: Any, comm: Any) -> None:
    """Refuse overrides that are not texts, and anything else than a communicator."""
    if isinstance(overrides, str):
        raise ConfigurationError(f"overrides must be a list of texts, not one: [{overrides!r}]")
    texts = isinstance(overrides, Sequence) and all(isinstance(text, str) for text in overrides)
    if not texts:
        raise ConfigurationError(
            'overrides must be a list of texts, as ["solver.tolerance=1e-8"], not '
            f"{overrides!r:.80}; a communicator is given by its name, as comm=MPI.COMM_SELF"
        )
    if not isinstance(comm, MPI.Intracomm) or comm == MPI.COMM_NULL:
        raise ConfigurationError(
            f"comm must be a communicator of mpi4py, as MPI.COMM_WORLD, not {comm!r:.80}"
        )


def _answers(scene: Scene, comm: MPI.Intracomm) -> CaseAnswers:
    """The answers to all cases (collective)."""
    overview, answers = Overview(scene, comm), {}
    for solved in solved_cases(scene, comm, lambda name: None, refuse_without_bound):
        overview.add(solved, solved.summary)
        answers[solved.model.scene.case] = _answer(solved, solved.summary)
    return CaseAnswers(answers, overview)


def _step_answers(increments: Iterable[SolvedIncrement]) -> StepAnswers:
    """The answers to all increments (collective)."""
    records, answers = [], []
    for increment in increments:
        records.append(record_of(increment))
        answers.append(_of_record(increment, records[-1]))
    return StepAnswers(answers, summary_of_steps(answers[-1].solved.summary, records))


def _of_record(increment: SolvedIncrement, record: Record) -> Answer:
    return _answer(increment.solved, {**increment.solved.summary, **record})


def _answer(solved: SolvedScene, summary: dict[str, Any]) -> Answer:
    """The answer with the arrays of all mirror images."""
    nodes, cells, model = solved.nodes, solved.cells, solved.model
    nodal = solved.nodal or nodal_stresses(model, solved.solution, ErrorEstimator(model))
    images, rough = full_mesh(model.geometry, nodes).images, model.scene.has_friction
    places = model.geometry, model.node_exchange

    def at_nodes(values: Array, name: str = "") -> Array:
        """Values at the nodes of all images; a vector or stress is reflected, given its name."""
        parts = [image.field(name, values) if name else values for image in images]
        return np.concatenate([v[image.new] for v, image in zip(parts, images, strict=True)])

    return Answer(
        summary=summary,
        points=np.concatenate([image.points(nodes.points)[image.new] for image in images]),
        displacement=at_nodes(nodes.displacement, "displacement"),
        contact_pressure=at_nodes(nodes.contact_pressure),
        smoothed_contact_pressure=at_nodes(nodes.smoothed_contact_pressure),
        gap=at_nodes(nodes.gap),
        friction_traction=nodes.friction_traction if rough else None,  # halves have no friction
        slip=nodes.slip if rough else None,
        contact_status=nodes.contact_status if rough else None,
        cells=[of_body for image in images for of_body in cells_of(*places, image)],
        stress=np.concatenate([image.field("stress", cells.stress) for image in images]),
        von_mises=np.tile(cells.von_mises, len(images)),
        **{name: at_nodes(nodal[name], name) if name in nodal else None for name in NODAL_FIELDS},
        solved=solved,
    )
