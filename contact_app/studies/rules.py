"""SMALBE-M's rules side by side on the paper's cube: the paper's and this solver's own.

Counts of Hessian multiplications, outer iterations in parentheses, to 1e-6 relative to the
right-hand side, each rule with its own bookkeeping (the paper's spends one multiplication an
outer iteration on the gradient, this solver's own does not). Subdomains of 4³ hexahedra, rows of B
orthonormal, no preconditioner.
"""

from collections.abc import Callable, Iterator

from mpi4py import MPI

from contact_app.machine.timings import Timings
from contact_app.model.model import build_model
from contact_app.studies.cube import RTOL, cube_scene, equality
from solver import MPRGP, SMALBE, BoxQP
from solver.qp.operators import estimate_norm

STRATEGIES = (
    ("projcg", 1.9), ("projcg-safe", 1.9), ("fixed", 1.9), ("fixed", 1.0), ("gfgf-opt", 1.2),
)  # fmt: skip
RULES: dict[str, Callable[[MPRGP], SMALBE]] = {"paper's rule": SMALBE.paper, "default": SMALBE}
CELLS_A_SUBDOMAIN = 4


def compare_rules(
    subdomains: int = 10, comm: MPI.Intracomm = MPI.COMM_WORLD
) -> Iterator[tuple[str, dict[str, tuple[int, int]]]]:
    """Each strategy's name, and multiplications and outer iterations under each rule."""
    scene = cube_scene(CELLS_A_SUBDOMAIN * subdomains, subdomains)
    model = build_model(scene, comm, Timings())
    problem = model.problem
    norm, _ = estimate_norm(problem.projected)
    qp = BoxQP(problem.projected, problem.rhs, lower=problem.lower)
    for expansion, alpha_u in STRATEGIES:
        counts = {}
        for name, rule in RULES.items():
            inner = MPRGP(expansion, alpha_u, rtol=RTOL, norm=norm)
            result = rule(inner).solve(qp, equality(model))
            if not result.converged:
                raise ArithmeticError(f"{expansion} {alpha_u}, {name}: {result.reason.value}")
            counts[name] = result.counts.hessian, result.counts.outer
        shown = f"`{expansion}`" + ("" if expansion.startswith("projcg") else f" {alpha_u}")
        yield shown, counts


def table(rows: Iterator[tuple[str, dict[str, tuple[int, int]]]]) -> Iterator[str]:
    """Lines of a Markdown table."""
    yield "| expansion | " + " | ".join(RULES) + " |"
    yield "|---|" + "---:|" * len(RULES)
    for name, counts in rows:
        yield f"| {name} | " + " | ".join(f"{h} ({o})" for h, o in counts.values()) + " |"
