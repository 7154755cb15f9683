"""What `tolerance: auto` saves: each scene solved to the default tolerance and to its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from solver.contact.options import SolverOptions

EXACT = SolverOptions().tightest
"""Error of a mesh below which `auto` has nothing to follow."""

REPEATS = 2
"""Runs of which the faster tells the seconds."""


def savings(configs: Sequence[Path]) -> Iterator[str]:
    """Yield the rows of a table: multiplications, seconds, total error, by the default and `auto`.

    Seconds are those of the solve and of the error's estimate, which `auto` makes on the way.
    """
    yield (
        "| scene | Hessian multiplications at 1e-6 | `auto` | saved | tolerance chosen | error of "
        "the mesh | of the solver | total, over that at 1e-6 | seconds at 1e-6 | `auto` |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    sums, times = [0, 0], [0.0, 0.0]
    for config in configs:
        (default, slower), (auto, faster) = (_solved(config, t) for t in (1e-6, "auto"))
        spent = [s.summary["solver"]["hessian_multiplications"] for s in (default, auto)]
        sums = [a + b for a, b in zip(sums, spent, strict=True)]
        times = [a + b for a, b in zip(times, (slower, faster), strict=True)]
        accuracy, total = auto.accuracy, default.accuracy.total
        yield (
            f"| {config.stem} | {spent[0]} | {spent[1]} | {_share(spent)} | "
            f"{auto.solution.tolerance:.1e} | {100 * accuracy.discretisation:.2g} % | "
            f"{100 * accuracy.algebraic:.2g} % | {_over(accuracy.total, total)} | "
            f"{slower:.2f} | {faster:.2f} |"
        )
    yield (
        f"| all | {sums[0]} | {sums[1]} | {_share(sums)} | | | | | "
        f"{times[0]:.2f} | {times[1]:.2f} |"
    )


def _solved(config: Path, tolerance: float | str) -> tuple[SolvedScene, float]:
    """A scene solved, and the seconds of its solve and estimate."""
    scene = replace(build_scene(load(config, [f"solver.tolerance={tolerance}"])), accuracy=None)
    seconds = []
    for _ in range(REPEATS):
        solved = solve_scene(scene, MPI.COMM_SELF)
        timings = solved.summary["timings"]
        seconds.append(timings["solve"] + timings["estimate"])
    return solved, min(seconds)


def _share(spent: Sequence[int]) -> str:
    return f"{100 * (1 - spent[1] / spent[0]):.0f} %" if spent[0] else "–"


def _over(total: float, reference: float) -> str:
    return "mesh exact" if reference < EXACT else f"{total / reference:.4f}"
