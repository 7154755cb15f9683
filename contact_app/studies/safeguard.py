"""Projected CG steps that raise the cost: the paper's Figure 1, a cycle, a random search.

The figure: left, one step of each strategy from the same point of a tilted valley above the bound
y = 0; right, the projected gradient over the iterations of a problem on which plain ``projcg``
repeats seven steps for ever. The search: random problems in two to five variables, a CG step and
then an expansion by each strategy from the same point.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from contact_app.studies.paper import plotting
from solver import MPRGP, BoxQP
from solver.qp.examples import cycling_problem, figure_1
from solver.qp.iterate import Iterate

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


@dataclass(frozen=True)
class Search:
    """Result of a search over random expansions.

    Attributes
    ----------
    expansions : int
        Expansions by the projected CG step.
    rises : int
        Number of these expansions that raised the cost.
    safe_rises : int
        Number of expansions of ``projcg-safe`` from the same points that raised the cost.
    losses : int
        Number of the ``rises`` in which ``projcg-safe`` ended above the standard expansion,
        ``fixed`` with 1.9.
    further_multiplications : int
        Hessian multiplications that ``projcg-safe`` spent beyond those of ``projcg``.
    elsewhere : int
        Those of them where ``projcg`` did not raise the cost.
    """

    expansions: int
    rises: int
    safe_rises: int
    losses: int
    further_multiplications: int
    elsewhere: int

    def __str__(self) -> str:
        return (
            f"of {self.expansions} random expansions projcg raised the cost in {self.rises}, "
            f"projcg-safe in {self.safe_rises}; of the {self.rises}, projcg-safe ended above the "
            f"standard expansion in {self.losses}, and spent a further multiplication in "
            f"{self.further_multiplications}; in all others in {self.elsewhere}"
        )


def search(problems: int = 3000) -> Search:
    """Compare the first expansion after a CG step on random problems."""
    total = rises = safe_rises = losses = further = elsewhere = 0
    for seed in range(problems):
        qp, x0 = random_start(seed)
        steps = [second_step(qp, x0, name) for name in ("projcg", "projcg-safe", "fixed")]
        if steps[0] is None or steps[1] is None or steps[2] is None:
            continue
        before = steps[0][1]
        plain, safe, standard = (cost(qp, step[0].x) for step in steps if step is not None)
        more = steps[1][0].counts.hessian - steps[0][0].counts.hessian
        total += 1
        safe_rises += safe > before
        further += more
        if plain > before:
            rises += 1
            losses += safe > standard + 1e-9 * abs(standard - before)
        else:
            elsewhere += more
    return Search(total, rises, safe_rises, losses, further, elsewhere)


def random_start(seed: int) -> tuple[BoxQP, np.ndarray]:
    """A random problem in two to five variables, of condition up to 1e4, and a point inside."""
    random = np.random.default_rng(seed)
    n = int(random.integers(2, 6))
    axes, _ = np.linalg.qr(random.standard_normal((n, n)))
    hessian = (axes * np.geomspace(1.0, 10.0 ** random.uniform(0.5, 4.0), n)) @ axes.T
    hessian = 0.5 * (hessian + hessian.T)
    lower = -np.abs(random.standard_normal(n))
    qp = BoxQP(hessian, hessian @ random.standard_normal(n), lower=lower)
    return qp, lower + 3.0 * np.abs(random.standard_normal(n))


def second_step(qp: BoxQP, x0: np.ndarray, expansion: str) -> tuple[Iterate, float] | None:
    """The iterate after a CG step and an expansion, and the cost between; None for other steps."""
    it = Iterate(qp, x0)
    it.measure_b()
    strategy = MPRGP(expansion).strategy
    it.evaluate()
    alpha_cg, alpha_f = it.probe()
    if alpha_cg > alpha_f:
        return None
    it.advance(alpha_cg)
    it.conjugate()
    before = cost(qp, it.x)
    alpha_cg, alpha_f = it.probe()
    if alpha_cg <= 1.001 * alpha_f:
        return None
    strategy.prepare(it)
    strategy.expand(it, alpha_cg, alpha_f)
    return it, before
