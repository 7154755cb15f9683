"""What `tolerance: auto` saves: each scene solved to the default tolerance and to its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

from contact_app.configuration import load
from contact_app.run import SolvedScene, solve_scene
from contact_app.scene import build_scene


def savings(configs: Sequence[Path]) -> Iterator[str]:
    """Yield the rows of a table: products and total error, by the default and by `auto`."""
    yield (
        "| scene | Hessian multiplications at 1e-6 | `auto` | saved | tolerance chosen | error of "
        "the mesh | of the solver | total, over that at 1e-6 |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    sums = [0, 0]
    for config in configs:
        auto, default = (_solved(config, tolerance) for tolerance in ("auto", 1e-6))
        spent = [s.summary["solver"]["hessian_multiplications"] for s in (default, auto)]
        sums = [a + b for a, b in zip(sums, spent, strict=True)]
        accuracy, total = auto.accuracy, default.accuracy.total
        yield (
            f"| {config.stem} | {spent[0]} | {spent[1]} | {_share(spent)} | "
            f"{auto.solution.tolerance:.1e} | {100 * accuracy.discretisation:.2g} % | "
            f"{100 * accuracy.algebraic:.2g} % | {_over(accuracy.total, total)} |"
        )
    yield f"| all | {sums[0]} | {sums[1]} | {_share(sums)} | | | | |"


def _solved(config: Path, tolerance: float | str) -> SolvedScene:
    scene = build_scene(load(config, [f"solver.tolerance={tolerance}"]))
    return solve_scene(replace(scene, accuracy=None), MPI.COMM_SELF)


def _share(spent: Sequence[int]) -> str:
    return f"{100 * (1 - spent[1] / spent[0]):.0f} %" if spent[0] else "–"


def _over(total: float, reference: float) -> str:
    return "mesh exact" if reference < 1e-3 else f"{total / reference:.4f}"
