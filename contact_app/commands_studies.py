"""Commands of the studies: ``svm`` and ``reproduce``."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


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
    reproduce = typer.Typer(help="The paper's tables and figures, ours beside theirs.")
    reproduce.command("svm")(reproduce_svm)
    reproduce.command("cube")(reproduce_cube)
    reproduce.command("figure1")(reproduce_figure1)
    app.add_typer(reproduce, name="reproduce")


def svm(
    data: Annotated[Path, typer.Argument(help="Samples in LIBSVM format.")],
    loss: Annotated[Loss, typer.Option(help="Hinge (l1) or squared hinge (l2) loss.")] = Loss.l1,
    penalty: Annotated[float, typer.Option("--C", help="Penalty of misclassification.")] = 1.0,
    expansion: Annotated[str, typer.Option(help="Expansion of the active set.")] = "projcg",
    alpha_u: Annotated[float, typer.Option(help="Multiple of the expansion's step.")] = 1.9,
    rtol: Annotated[float, typer.Option(help="Relative tolerance of MPRGP.")] = 0.1,
) -> None:
    """Train the no-bias support vector machine; print JSON."""
    from contact_app.svm import train

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
        str | None, typer.Option(help="Only the rows of this expansion, e.g. projcg.")
    ] = None,
) -> None:
    """Run the paper's 73 contact rows: CSV, Figure 3, a summary.json for each."""
    from contact_app.studies.cube import reproduce_cube as run

    for line in run(output or Path("results/reproduce-cube"), scale.value, expansion):
        typer.echo(line)


def reproduce_figure1(output: OutputOption = None) -> None:
    """Draw the paper's Figure 1: the projected CG step that raises the cost, and the safeguard."""
    from contact_app.studies.safeguard import draw_figure_1

    typer.echo(f"wrote {draw_figure_1(output or Path('results/reproduce-figure1'))}")
