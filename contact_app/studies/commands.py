"""Commands of the studies: ``svm``, ``reproduce``, ``bench``, ``effectivity`` and others."""

import json
import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from contact_app.studies.parts_meshes import Meshes


class Loss(StrEnum):
    """Loss of the support vector machine."""

    l1 = "l1"
    l2 = "l2"


class Scale(StrEnum):
    """Size of the paper's cube."""

    small = "small"
    paper = "paper"


OutputOption = Annotated[
    Path | None, typer.Option("--output", "-o", help="Directory of the results.")
]


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command("svm")(svm)
    reproduce = typer.Typer(help="Reproduce the paper's tables and figures.")
    reproduce.command("svm")(reproduce_svm)
    reproduce.command("cube")(reproduce_cube)
    reproduce.command("rules")(reproduce_rules)
    app.add_typer(reproduce, name="reproduce")
    measured = typer.Typer(
        help="This application and PETSc's solvers side by side: cubes, or parts."
    )
    measured.callback(invoke_without_command=True)(bench)
    measured.command("parts")(bench_parts)
    app.add_typer(measured, name="bench")
    app.command("effectivity")(effectivity)
    app.command("stability")(stability)
    app.command("chart")(chart)
    app.command("verify")(verify)


def verify(
    cases: Annotated[
        list[str] | None, typer.Argument(help="Names of cases; all unless given.")
    ] = None,
    output: OutputOption = None,
) -> None:
    """Solve contact problems with known solutions on series of meshes: tables, rates, a figure."""
    from contact_app.studies.verification_report import verify as run

    for line in run(cases or [], output or Path("results/verify")):
        typer.echo(line)


def svm(
    data: Annotated[Path, typer.Argument(help="Samples in LIBSVM format.")],
    loss: Annotated[Loss, typer.Option(help="Hinge (l1) or squared hinge (l2) loss.")] = Loss.l1,
    penalty: Annotated[float, typer.Option("--C", help="Penalty of misclassification.")] = 1.0,
    expansion: Annotated[str, typer.Option(help="Expansion of the active set.")] = "projcg",
    alpha_u: Annotated[float, typer.Option(help="Multiple of the expansion's step.")] = 1.9,
    rtol: Annotated[float, typer.Option(help="Relative tolerance of MPRGP.")] = 0.1,
) -> None:
    """Train the no-bias support vector machine; print JSON."""
    from contact_app.studies.svm_training import train

    try:
        report = train(data, loss.value, penalty, expansion, alpha_u, rtol)
    except ValueError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(2) from error
    typer.echo(json.dumps(report, indent=2))
    if not report["converged"]:
        raise typer.Exit(1)


def reproduce_svm(
    output: OutputOption = None,
    data: Annotated[
        Path | None,
        typer.Option("--data", help="Directory with australian, diabetes, ionosphere .libsvm."),
    ] = None,
) -> None:
    """Run the paper's 219 SVM rows: CSV, Figures 4 to 6, how many rows agree."""
    from contact_app.studies.svm import reproduce_svm as run

    try:
        report = run(output or Path("results/reproduce-svm"), data)
    except ValueError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(2) from error
    for line in (*report.summary(), *(f"wrote {path}" for path in report.files)):
        typer.echo(line)


def reproduce_cube(
    scale: Annotated[
        Scale, typer.Option(help="10x10x10 subdomains of 4³ or of 30³.")
    ] = Scale.small,
    output: OutputOption = None,
    expansion: Annotated[
        str | None, typer.Option(help="Small scale: only the rows of this expansion, e.g. projcg.")
    ] = None,
    settings: Annotated[
        str, typer.Option(help="Paper scale: rules to run, comma-separated: paper, ours.")
    ] = "paper,ours",
) -> None:
    """Run the paper's contact benchmark.

    Small: its 73 rows, CSV, Figure 3, a summary.json for each. Paper: its own problem of 81,812,703
    unknowns, with its rules and with the default ones. An interrupted run continues when the
    command is run again.
    """
    from contact_app.studies.cube import cube_scene, reproduce_cube
    from contact_app.studies.paper_run import PAPER_CELLS, Settings, paper_run

    directory = output or Path("results/reproduce-cube")
    if scale is Scale.small:
        lines = reproduce_cube(directory, expansion)
    else:
        try:
            chosen = tuple(Settings(name) for name in settings.split(","))
        except ValueError:
            typer.echo(f"error: --settings is {settings!r}; allowed: paper, ours", err=True)
            raise typer.Exit(2) from None
        lines = paper_run(directory, cube_scene(PAPER_CELLS, memory=math.inf), chosen)
    for line in lines:
        typer.echo(line)


def reproduce_rules(
    subdomains: Annotated[
        int, typer.Option(help="Subdomains along an edge of the cube.", min=2)
    ] = 10,
) -> None:
    """Print the multiplications of SMALBE's published rules and of the default ones on the cube."""
    from contact_app.studies.rules import compare_rules, table

    for line in table(compare_rules(subdomains)):
        typer.echo(line)


def bench(
    context: typer.Context,
    output: OutputOption = None,
    cells: Annotated[
        str, typer.Option(help="Cells along an edge of each cube of hexahedra, coarse to fine.")
    ] = "10,20,30,40,60",
    tolerance: Annotated[float, typer.Option(help="Relative tolerance of all methods.")] = 1e-8,
    limit: Annotated[float, typer.Option(help="Seconds a run may take.")] = 60.0,
    methods: Annotated[
        str, typer.Option(help="Methods to run, separated by commas; all unless given.")
    ] = "",
) -> None:
    """Run this application and PETSc's solvers on the paper's cube: table, CSV and figure.

    `bench parts` takes the parts of the tutorials instead.
    """
    if context.invoked_subcommand is not None:
        for key in context.params:
            source = context.get_parameter_source(key)
            if source is not None and source.name == "COMMANDLINE":
                _refuse(f"--{key} stands before `parts`: options of `bench parts` stand behind it")
        return
    from contact_app.studies import parts as study
    from contact_app.studies.parts_meshes import Meshes
    from contact_app.studies.peers import METHODS

    chosen = _methods(methods, ("auto", *METHODS)) or ["auto", *METHODS]
    meshes = [Meshes(f"{n}³", cells=n) for n in sorted(_numbers("--cells", cells))]
    settings = study.Settings(tolerance, limit=limit, parallel=False)
    _table(output or Path("results/bench"), [study.CUBE], meshes, chosen, settings)


def bench_parts(
    parts: Annotated[
        list[str] | None,
        typer.Argument(help="Parts of the tutorials or scene files; all parts unless given."),
    ] = None,
    output: OutputOption = None,
    sizes: Annotated[
        str | None,
        typer.Option(
            help="Draw the parts with Gmsh: sizes of cells near contact over those of the shipped "
            "meshes, coarse to fine. [1,0.5,0.3 where Gmsh is there]",
            show_default=False,
        ),
    ] = None,
    meshes: Annotated[
        list[Path] | None,
        typer.Option(help="Directory of meshes drawn before; may be repeated, coarse to fine."),
    ] = None,
    degree: Annotated[int, typer.Option(help="Of all bodies.", min=1, max=2)] = 1,
    tolerance: Annotated[float, typer.Option(help="Relative tolerance of all methods.")] = 1e-8,
    limit: Annotated[float, typer.Option(help="Seconds a run may take.")] = 120.0,
    methods: Annotated[
        str, typer.Option(help="Methods to run, separated by commas; the usual ones unless given.")
    ] = "",
) -> None:
    """Compare contact with one linear solve and PETSc's solvers on parts: table, CSV, figure."""
    from contact_app.studies import parts as study
    from contact_app.studies.peers import METHODS
    from contact_app.studies.single_run import OWN_METHODS

    chosen = _methods(methods, (*OWN_METHODS, *METHODS)) or study.CHOSEN
    scenes = [_part(name, study.CONFIGS, study.PARTS) for name in parts or study.PARTS]
    directory = output or Path("results/bench-parts")
    drawable = all(scene.parent == study.CONFIGS and scene.stem in study.PARTS for scene in scenes)
    rows = _part_meshes(sizes, meshes or [], directory / "meshes", drawable)
    settings = study.Settings(tolerance, degree, limit)
    _table(directory, scenes, rows, chosen, settings)


def _table(directory: Path, *measured: Any) -> None:
    """Print the lines of a benchmark as they are measured."""
    from contact_app.studies.parts import bench

    for text in bench(directory, *measured):
        typer.echo(text)
    typer.echo(f"wrote {directory / 'parts.csv'}, parts.md and parts.png")


def _part(name: str, configs: Path, names: tuple[str, ...]) -> Path:
    """The scene of a part, or a scene file."""
    path = configs / f"{name}.yaml" if name in names else Path(name)
    if name in names and not path.is_file():
        _refuse(f"{name}: {path} is missing; the parts need a checkout of the repository")
    if not path.is_file():
        _refuse(f"{name!r} is no scene file and none of the parts {', '.join(names)}")
    return path


def _part_meshes(
    sizes: str | None, directories: list[Path], to: Path, drawable: bool
) -> "list[Meshes]":
    """The meshes of the options of `bench parts`; prints a note if they are the shipped ones."""
    from contact_app.studies.parts_meshes import SHIPPED, Meshes, can_draw, drawn

    if directories:
        if sizes is not None:
            _refuse("--sizes draws meshes and --meshes names drawn ones: give one of them")
        for directory in directories:
            if not directory.is_dir():
                _refuse(f"--meshes {directory}: there is no such directory")
        return [Meshes(str(directory), directory) for directory in directories]
    if sizes is not None and not drawable:
        _refuse("--sizes draws the parts of the tutorials alone; other scenes need --meshes")
    if sizes is not None and not can_draw():
        _refuse("--sizes draws the parts with Gmsh's Python module, which is missing: install gmsh")
    if not drawable:
        return [SHIPPED]
    if not can_draw():
        typer.echo(
            "Gmsh's Python module is missing: the parts have their shipped, small meshes; finer "
            "ones need gmsh, or --meshes with a directory of drawn ones",
            err=True,
        )
        return [SHIPPED]
    factors = sorted(_positive("--sizes", sizes or "1,0.5,0.3"), reverse=True)
    return [drawn(factor, to) for factor in factors]


def chart(
    config: Annotated[Path, typer.Argument(help="The scene, a YAML file.", show_default=False)],
    output: OutputOption = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a key: path.to.key=value.", show_default=False),
    ] = None,
    largest: Annotated[
        int, typer.Option(help="Degrees of freedom of the finest mesh of the sweep.")
    ] = 250_000,
    limit: Annotated[float, typer.Option(help="Time limit of a point, in seconds.")] = 30.0,
    peers: Annotated[bool, typer.Option(help="Run PETSc's solvers as well.")] = True,
    meshes: Annotated[
        list[Path] | None,
        typer.Option(
            help="Directory with the meshes of the scene, drawn before; repeated, coarse to fine. "
            "Instead of halving cells.",
            show_default=False,
        ),
    ] = None,
    references: Annotated[
        list[Path] | None,
        typer.Option(
            help="With --meshes: three directories for the reference, cells half as long from one "
            "to the next.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Draw speed against accuracy: degrees, cells, meshes, tolerances, expansions, solvers."""
    from contact_app.studies import chart as study
    from contact_app.studies.chart_meshes import plan_meshes

    directory = output or Path("results") / f"chart-{config.stem}"
    changes = overrides or []
    if meshes:
        sweep = plan_meshes(config, changes, meshes, references or [], largest, peers)
    else:
        sweep = study.plan(config, changes, largest, peers)
    for progress in study.chart(config, directory, sweep, changes, limit):
        row = progress.row
        if row is None:
            typer.echo(progress.text)
        else:
            errors = (f"{name[6:]} {row[name]:.1e}" for name in study.COLUMNS[-3:])
            typer.echo(f"{progress.text}: {row['seconds']:.2f} s, errors: {', '.join(errors)}")
    typer.echo(f"wrote {directory / 'frontier.csv'} and frontier.png")


def _methods(text: str, names: tuple[str, ...]) -> list[str]:
    """Names of methods separated by commas."""
    chosen = [name.strip() for name in text.split(",") if name.strip()]
    for name in chosen:
        if name not in names:
            _refuse(f"--methods names {name!r}; known are {', '.join(names)}")
    return chosen


def _positive(option: str, text: str) -> list[float]:
    """Positive numbers separated by commas."""
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        numbers = []
    if not numbers or not all(0.0 < number < float("inf") for number in numbers):
        _refuse(f"{option} is {text!r}; it has the form 1,0.5,0.3")
    return numbers


def _numbers(option: str, text: str) -> list[int]:
    """Positive whole numbers separated by commas."""
    numbers = [int(n) if n.strip().isdigit() else 0 for n in text.split(",")]
    if not numbers or min(numbers) < 1:
        _refuse(f"{option} is {text!r}; it has the form 10,20,30")
    return numbers


def _refuse(message: str) -> NoReturn:
    typer.echo(f"error: {message}", err=True)
    raise typer.Exit(2)


def stability(output: OutputOption = None) -> None:
    """Run this application and PETSc's solvers on hard scenes: verdicts (some minutes)."""
    from contact_app.studies.stability import stability as run

    for path in run(output or Path("results/stability"), typer.echo):
        typer.echo(f"wrote {path}")


def effectivity(output: OutputOption = None) -> None:
    """Compare the error estimate with known errors, and runs to an accuracy with their errors."""
    from contact_app.studies.effectivity import effectivity as run

    for line in run(output or Path("results/effectivity")):
        typer.echo(line)
