"""Projected CG steps that raise the cost: the paper's Figure 1, and a cycle.

Left, one step of each strategy from the same point of a tilted valley above the bound y = 0; right,
the projected gradient over the iterations of a problem on which plain ``projcg`` repeats seven
steps for ever.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from contact_app.studies.paper import plotting
from solver import MPRGP, BoxQP
from solver.qp.examples import cycling_problem, figure_1

SHOWN = ("fixed", "gfgf-opt", "projcg", "projcg-safe")


def draw_figure_1(output_dir: Path | str) -> Path:
    """Write ``figure1_safeguard.png``."""
    pyplot = plotting()
    output = Path(output_dir)
    output.mkdir(parents=True, exist_ok=True)
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(12.0, 5.0), layout="constrained")
    _first_steps(left)
    _cycle(right)
    path = output / "figure1_safeguard.png"
    figure.savefig(path, dpi=150)
    pyplot.close(figure)
    return path


def cost(qp: BoxQP, x: np.ndarray) -> float:
    """½ xᵀAx - bᵀx."""
    product = np.empty(qp.size)
    qp.operator.apply(np.ascontiguousarray(x), product)
    return 0.5 * float(x @ product) - float(qp.b @ x)


def _first_steps(axes: Any) -> None:
    qp, x0 = figure_1()
    x, y = np.meshgrid(np.linspace(-3.5, 2.0, 241), np.linspace(-1.4, 1.0, 161))
    values = np.array([cost(qp, np.array(p)) for p in zip(x.ravel(), y.ravel(), strict=True)])
    lowest = values.min()
    axes.contour(x, y, values.reshape(x.shape) - lowest, [0.5, 2, 4, 8, 16, 32, 64], cmap="Greys_r")
    axes.axhspan(-1.4, 0.0, color="0.9")
    axes.plot(*x0, "ko", label=f"start: {cost(qp, x0) - lowest:.2f}")
    for number, name in enumerate(SHOWN):
        end = MPRGP(name, 1.9, max_iterations=1).solve(qp, x0).x
        label = f"{name}: {cost(qp, end) - lowest:.2f}"
        axes.plot(*zip(x0, end, strict=True), ".-", color=f"C{number}", label=label)
    axes.set(
        title="The first step (grey: not feasible); cost above the lowest", xlabel="x", ylabel="y"
    )
    axes.legend()


def _cycle(axes: Any) -> None:
    qp = cycling_problem()
    for number, name in enumerate(SHOWN):
        history = MPRGP(name, max_iterations=60).solve(qp).history
        norms = [max(step.projected_gradient_norm, 1e-10) for step in history]
        axes.semilogy(norms, ".-", color=f"C{number}", label=name)
    axes.set(title="A problem on which projcg cycles", xlabel="iteration", ylabel="‖gᴾ‖")
    axes.legend()
