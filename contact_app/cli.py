"""The command line: ``contact-app``.

Slow imports are inside the commands, so that help and input errors appear at once.
"""

import importlib.util
import json
import logging
import math
import os
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from contact_app.errors import ConfigurationError, CouldNotRunError
from contact_app.machine.caches import usable_caches
from contact_app.machine.exits import Exit, end
from contact_app.machine.streams import safe_streams

app = typer.Typer(
    name="contact-app",
    help="Contact of elastic solids: where they touch, how hard they press, how accurate it is.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Config = Annotated[Path, typer.Argument(help="The scene, a YAML file.", show_default=False)]
Directory = Annotated[
    Path | None,
    typer.Option(
        "--output", "-o", help="Directory of the results; results/<config name> by default."
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Change a key: path.to.key=value, e.g. bodies.0.mesh.box.cells=[10,10,10].",
        show_default=False,
    ),
]


@app.command()
def run(
    config: Config,
    output: Directory = None,
    overrides: Overrides = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the checkpoint of a stopped run.")
    ] = False,
) -> None:
    """Validate a scene, solve it, certify the answer and write it.

    Exit code 0: converged and certified. 1: solved but not certified or not converged; the results
    so far are written. 2: bad input. 3: the scene has no equilibrium. 4: the program could not run
    (disk, memory, permissions, an internal error); the message has the remedy.

    Results of an earlier run in the directory are removed first. Ctrl-C or SIGTERM ends the solve:
    the results reached so far are written, with a checkpoint for --resume.
    """
    from mpi4py import MPI

    from contact_app.scene.build import build_scene
    from contact_app.scene.configuration import load

    scene = build_scene(load(config, overrides or ()), comm=MPI.COMM_WORLD)
    directory = output or Path("results") / config.stem
    _refuse_unwritable(directory)
    from contact_app.run.run import run as run_scene

    raise typer.Exit(run_scene(scene, directory, resume=resume))


@app.command()
def check(config: Config, overrides: Overrides = None) -> None:
    """Validate a scene and report the model, its omissions, and its cost."""
    from contact_app.scene.build import build_scene
    from contact_app.scene.configuration import load

    scene = build_scene(load(config, overrides or ()))
    from contact_app.run.check import report

    report(scene)


@app.command()
def plot(
    directory: Annotated[
        Path, typer.Argument(help="Directory of results of a run.", show_default=False)
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Directory of the pictures; that of the results by default."
        ),
    ] = None,
    field: Annotated[
        list[str] | None,
        typer.Option(
            help="Field that colours the picture; may be repeated. [von_mises, contact_pressure]"
        ),
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(help="Factor on the displacements; chosen to be visible by default."),
    ] = None,
    camera: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="In 3D: direction from the body to the camera, three numbers."),
    ] = None,
    time: Annotated[
        float | None,
        typer.Option(help="Increment of a load history, by completed steps; the last by default."),
    ] = None,
) -> None:
    """Draw a result: the deformed bodies, the contact pressure, and where friction sticks."""
    from contact_app.results.plot.picture import plot as draw

    if camera is not None and not any(camera):
        raise ConfigurationError("--camera is 0 0 0: it needs a direction")
    if not all(map(math.isfinite, (*(camera or ()), scale or 0.0, time or 0.0))):
        raise ConfigurationError("--scale, --camera and --time take finite numbers alone")
    pictures, remarks = draw(
        directory,
        output=output,
        fields=tuple(field or ("von_mises", "contact_pressure")),
        exaggeration=scale,
        camera=camera,
        time=time,
    )
    for sentence in remarks:
        typer.echo(sentence, err=True)
    for path in pictures:
        typer.echo(f"wrote {path}")


@app.command()
def schema() -> None:
    """Print the JSON schema of the configuration, for editors."""
    from contact_app.scene.configuration import Configuration

    typer.echo(json.dumps(Configuration.model_json_schema(by_alias=True), indent=2))


if importlib.util.find_spec("contact_app.studies.commands"):
    from contact_app.studies.commands import register

    register(app)


def main() -> None:
    """Run the command line; each exception becomes one message and an exit code (`exits`)."""
    # with PETSc's handlers a closed pipe (`| head`) would print a page of errors
    options = os.environ.get("PETSC_OPTIONS", "")
    os.environ["PETSC_OPTIONS"] = f"{options} -no_signal_handler".strip()
    # waiting ranks yield the processor: on shared cores three ranks take seconds, not minutes
    os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")
    with safe_streams():
        # compiling a form logs every command to the root logger
        terminal = logging.StreamHandler()
        terminal.setLevel(logging.WARNING)
        logging.getLogger().addHandler(terminal)
        try:
            code = _run_app()
        finally:
            logging.getLogger().removeHandler(terminal)
    sys.exit(code)


def _run_app() -> int:
    """Run the command of the command line and return its exit code."""
    try:
        usable_caches()
        try:
            app()
        except SystemExit as end_of_command:
            code = _code_of_exit(end_of_command)
        else:
            code = Exit.CERTIFIED
        sys.stdout.flush()
    except Exception as error:
        code = end(error)
    return int(code)


def _code_of_exit(ended: SystemExit) -> int:
    """Exit code of a command; typer would replace that of an interruption by 1."""
    cause: BaseException | None = ended
    while cause is not None:
        if isinstance(cause, KeyboardInterrupt):
            return Exit.INTERRUPTED
        cause = cause.__cause__ or cause.__context__
    return ended.code if isinstance(ended.code, int) else int(ended.code is not None)


def _refuse_unwritable(directory: Path) -> None:
    """Raise an error before the run if results cannot be written."""
    if os.path.exists(directory) and not os.path.isdir(directory):
        raise ConfigurationError(
            f"--output {directory}: results cannot be written there: it is a file"
        )
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        raise CouldNotRunError(
            f"--output {directory}: results cannot be written there: {error.strerror}; change its "
            "permissions, make room, or name another directory"
        ) from None
