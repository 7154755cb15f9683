"""Scenes on which methods fail: every method on every such scene, side by side (``stability``).

Each cell of the table is a real run with a verdict. The verdict follows from the solution, not from
the method's own report:

holds      the energy is right to 1e-6 and nothing penetrates by more than 1e-6; where there are
           several bodies, the strain energy of each is right to 1e-3
degrades   the same, with more than three times the work of the milder variant
refused    an error message with the reason, before or instead of a solution
fails      the method says that it did not converge, or runs out of time
WRONG      the method says that it converged, and the answer is none
cannot     the scene cannot be stated for the method

The reference is the exact energy if it is known, else the energy of this application without
decomposition at tolerance 1e-10, whose duality gap bounds its error. The tests compare it with a
reference that shares no code with this application.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from contact_app.errors import ConfigurationError, ContactError, NoEquilibriumError
from contact_app.machine.time_limit import OutOfTime, time_limit
from contact_app.studies.failing_friction import FRICTION_CASES, FRICTION_METHODS, solve_rough
from contact_app.studies.failing_qps import QP_CASES, QPCase
from contact_app.studies.failing_scenes import CASES, HOLDS, REFUSED, Case, Config
from contact_app.studies.outcomes import APPLICATION, WHOLE, Outcome, built, shortened
from contact_app.studies.qp_solvers import RTOL, Problem, run_tao
from contact_app.studies.tables import fill, write
from solver import MPRGP, BoxQP
from solver.errors import QPError

ENERGY, PENETRATION = 1e-6, 1e-6
STRAINS = 1e-3
"""Relative error of a body's strain energy, of first order in that of its displacements."""

GROWTH = 3.0
LIMIT = 30.0
"""Time limit of a run in seconds."""

PEERS = {"SNES VI": "snes-vi-cholmod", "TAO bnls": "tao-bnls", "TAO bntr": "tao-bntr"}
METHODS = (APPLICATION, WHOLE, *PEERS)
COLUMNS = ("case", "method", "verdict", "detail", "applications", "growth", "energy",
           "penetration")  # fmt: skip


Solve = Callable[[str, Config, Any], Outcome]
"""Function of a method, a configuration and its subdomains that returns an outcome."""


def run_case(
    case: Case, methods: Sequence[str] = METHODS, solve: Solve | None = None
) -> dict[str, Outcome]:
    """All methods on one case, each by `solve_by` unless another function is given."""
    solve = solve or solve_by
    reference = None if case.energy is None else Outcome("", energy=case.energy)
    if reference is None and case.expected == HOLDS:
        made = case.make()
        made["solver"]["tolerance"] = 1e-10
        reference = solve(APPLICATION, made, 1)
    outcomes = {}
    for method in methods:
        outcome = _judged(case, _attempt(solve, method, case, case.make()), reference)
        if outcome.verdict == HOLDS and case.mild is not None:
            outcome = _grown(outcome, _attempt(solve, method, case, case.mild()))
        outcomes[method] = outcome
    return outcomes


def _grown(outcome: Outcome, mild: Outcome) -> Outcome:
    if mild.verdict not in ("", HOLDS) or not mild.applications:
        return outcome
    growth = outcome.applications / mild.applications
    verdict = HOLDS if growth <= GROWTH else "degrades"
    return replace(outcome, verdict=verdict, growth=growth)


def _judged(case: Case, outcome: Outcome, reference: Outcome | None) -> Outcome:
    """The verdict on a solution, given the reference; other outcomes have one already."""
    if outcome.verdict:
        return outcome
    if case.expected == REFUSED:
        return replace(
            outcome,
            verdict="WRONG",
            detail=f"says it converged, penetrating {outcome.penetration:.1e}, "
            f"energy {outcome.energy:.3g}",
        )
    assert reference is not None
    error = abs(outcome.energy - reference.energy) / (abs(reference.energy) or case.scale)
    if not error <= ENERGY:
        return replace(outcome, verdict="WRONG", detail=f"energy off by {error:.1e}")
    if not outcome.penetration <= PENETRATION:
        detail = f"penetrates by {outcome.penetration:.1e}"
        return replace(outcome, verdict="WRONG", detail=detail)
    if len(reference.strains) > 1:
        errors = np.abs(np.array(outcome.strains) / np.array(reference.strains) - 1.0)
        if not errors.max() <= STRAINS:
            detail = f"the strain energy of a body is off by {errors.max():.1e}"
            return replace(outcome, verdict="WRONG", detail=detail)
    return replace(outcome, verdict=HOLDS)


def _attempt(solve: Solve, method: str, case: Case, made: Config) -> Outcome:
    """Run a method; an empty verdict where it says it converged."""
    subdomains = case.subdomains
    if method == WHOLE:
        subdomains = 1
    elif isinstance(subdomains, tuple):
        subdomains = list(subdomains)
    try:
        with time_limit(LIMIT):
            return solve(method, made, subdomains)
    except OutOfTime:
        return Outcome("fails", f"no end in {LIMIT:.0f} s")
    except (NoEquilibriumError, ConfigurationError) as error:
        kind = "cannot" if method in PEERS else REFUSED  # PETSc gets the scene read here
        return Outcome(kind, shortened(str(error)))
    except ContactError as error:
        return Outcome("fails", shortened(str(error)))
    except (ValueError, RuntimeError) as error:  # unsuitable scene, or an error of PETSc
        unsuitable = type(error).__name__ == "UnsuitableError"
        kind = "cannot" if unsuitable else "fails"
        return Outcome(kind, shortened(str(error).strip().splitlines()[-1]))


def solve_by(method: str, made: Config, subdomains: Any) -> Outcome:
    """Verdict of a method on a configuration; empty if it reports convergence."""
    scene = built(made, subdomains)
    if method in (APPLICATION, WHOLE):
        from contact_app.run.solve import solve_scene

        solved = solve_scene(scene)
        summary, strains = solved.summary, solved.solution.measures.strains
        certificate, solver = summary["certificate"], summary["solver"]
        outcome = Outcome(
            "",
            "",
            solver["hessian_multiplications"],
            summary["solution"]["energy"],
            certificate["max_penetration"],
            strains=tuple(float(s) for s in strains),
        )
        if not certificate["passed"]:
            return replace(outcome, verdict="fails", detail=shortened(solver["reason"]))
        return outcome
    from contact_app.studies import peers

    row, _, _ = peers.solve(scene, PEERS[method], scene.solver.least_tolerance)
    applications = row["applications"] if "tao" in PEERS[method] else row["steps"]
    outcome = Outcome("", "", applications, row["energy"], row["penetration"])
    return outcome if row["converged"] else replace(outcome, verdict="fails", detail="says so")


# ------------------------------------------------------------------------- quadratic programmes

STRATEGIES = {
    "projcg-safe": ("projcg-safe", 1.9),
    "projcg": ("projcg", 1.9),
    "fixed 1.9": ("fixed", 1.9),
    "gfgr-opt 1.9": ("gfgr-opt", 1.9),
    "gfgf-opt 2.0": ("gfgf-opt", 2.0),
}
TAO = ("bnls", "tron", "bqnls")
QP_METHODS = (*STRATEGIES, *(f"TAO {kind}" for kind in TAO))
RESIDUAL = 1e-5
"""Largest accepted relative projected gradient, for solvers with a tolerance of 1e-6."""


def run_qp_case(case: QPCase, methods: Sequence[str] = QP_METHODS) -> dict[str, Outcome]:
    """All strategies, and PETSc's solvers, on one quadratic programme."""
    return {method: _solve_qp(method, case) for method in methods}


def _solve_qp(method: str, case: QPCase) -> Outcome:
    A, b, lower, upper, x0 = case.make()
    n = len(b)
    problem = Problem(
        case.name,
        sparse.csr_array(A),
        b,
        np.full(n, -np.inf) if lower is None else lower,
        np.full(n, np.inf) if upper is None else upper,
    )
    try:
        with time_limit(LIMIT):
            if method not in STRATEGIES:
                entry = run_tao(problem, method.removeprefix("TAO "))
                return _qp_verdict(case, entry.multiplications or 0, entry.residual, entry.note)
            expansion, alpha_u = STRATEGIES[method]
            solver = MPRGP(expansion, alpha_u, rtol=RTOL, max_iterations=20_000)
            result = solver.solve(BoxQP(problem.A, b, lower, upper), x0)
    except OutOfTime:
        return Outcome("fails", f"no end in {LIMIT:.0f} s")
    except QPError as error:
        return Outcome(REFUSED, shortened(str(error)))
    except RuntimeError as error:  # PETSc's
        return Outcome("fails", shortened(str(error).strip().splitlines()[-1]))
    note = "" if result.converged else result.reason.name.lower().replace("_", " ")
    applications = result.counts.hessian + result.counts.norm_estimation
    return _qp_verdict(case, applications, problem.residual(result.x), note)


def _qp_verdict(case: QPCase, applications: int, residual: float, note: str) -> Outcome:
    if note:
        return Outcome("fails", note.replace("stopped: reason ", "PETSc's reason "), applications)
    if case.refused or not residual <= RESIDUAL:
        return Outcome("WRONG", f"says it converged, residual {residual:.1e}", applications)
    return Outcome(HOLDS, "", applications)


Table = dict[str, dict[str, Outcome]]


def stability(output: Path, tell: Callable[[str], None] = print) -> list[Path]:
    """Run everything, write ``stability.csv`` and the tables of ``stability.md``."""
    output.mkdir(parents=True, exist_ok=True)
    PETSc.Log.begin()  # counts TAO's multiplications
    rough = tuple(FRICTION_METHODS), solve_rough
    runs = {
        "Scenes": {c.name: partial(run_case, c) for c in CASES},
        "Scenes with friction": {c.name: partial(run_case, c, *rough) for c in FRICTION_CASES},
        "Quadratic programmes": {c.name: partial(run_qp_case, c) for c in QP_CASES},
    }
    tables: dict[str, Table] = {title: {} for title in runs}
    for title, of_title in runs.items():
        for name, run in of_title.items():
            tables[title][name] = outcomes = run()
            tell(f"{name}: " + "; ".join(f"{m} {o}" for m, o in outcomes.items()))
    csv, page = output / "stability.csv", output / "stability.md"
    rows = [
        {"case": name, "method": method, **asdict(outcome)}
        for table in tables.values()
        for name, outcomes in table.items()
        for method, outcome in outcomes.items()
    ]
    write(rows, COLUMNS, csv)
    fill(page, {title: _markdown(table) for title, table in tables.items()})
    return [csv, page]


def _markdown(table: Table) -> str:
    methods = list(next(iter(table.values())))
    lines = ["| " + " | ".join(["case", *methods]) + " |", "|---" * (1 + len(methods)) + "|"]
    for name, outcomes in table.items():
        lines.append(f"| {name} | " + " | ".join(o.cell for o in outcomes.values()) + " |")
    return "\n".join(lines) + "\n"
