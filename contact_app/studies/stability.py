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

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import replace
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
from contact_app.studies.outcomes import OURS, WHOLE, Outcome, built, shortened
from contact_app.studies.qp_solvers import RTOL, Problem, run_tao
from solver import MPRGP, BoxQP
from solver.errors import QPError

ENERGY, PENETRATION = 1e-6, 1e-6
STRAINS = 1e-3
"""Relative error of a body's strain energy, of first order in that of its displacements."""

GROWTH = 3.0
LIMIT = 30.0
"""Time limit of a run in seconds."""

PEERS = {
    "SNES VI": "snes-vi-cholmod",
    "TAO bnls": "tao-bnls",
    "TAO bntr": "tao-bntr",
}
METHODS = (OURS, WHOLE, *PEERS)
COLUMNS = (
    "case",
    "method",
    "verdict",
    "detail",
    "applications",
    "growth",
    "energy",
    "penetration",
)


Solve = Callable[[str, Config, Any], Outcome]
"""Function of a method, a configuration and its subdomains that returns an outcome."""


def run_case(
    case: Case, methods: Sequence[str] = METHODS, solve: Solve | None = None
) -> dict[str, Outcome]:
    """All methods on one case, each by `solve_by` unless another function is given."""
    solve = solve or solve_by
    known = None if case.energy is None else Outcome("", energy=case.energy)
    if known is None and case.expected == HOLDS:
        made = case.make()
        made["solver"]["tolerance"] = 1e-10
        known = solve(OURS, made, 1)
    found = {}
    for method in methods:
        outcome = _judged(case, _attempt(solve, method, case, case.make()), known)
        if outcome.verdict == HOLDS and case.mild is not None:
            outcome = _grown(outcome, _attempt(solve, method, case, case.mild()))
        found[method] = outcome
    return found


def _grown(outcome: Outcome, mild: Outcome) -> Outcome:
    if mild.verdict not in ("", HOLDS) or not mild.applications:
        return outcome
    growth = outcome.applications / mild.applications
    verdict = HOLDS if growth <= GROWTH else "degrades"
    return replace(outcome, verdict=verdict, growth=growth)


def _judged(case: Case, outcome: Outcome, known: Outcome | None) -> Outcome:
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
    assert known is not None
    error = abs(outcome.energy - known.energy) / (abs(known.energy) or case.scale)
    if not error <= ENERGY:
        return replace(outcome, verdict="WRONG", detail=f"energy off by {error:.1e}")
    if not outcome.penetration <= PENETRATION:
        detail = f"penetrates by {outcome.penetration:.1e}"
        return replace(outcome, verdict="WRONG", detail=detail)
    if len(known.strains) > 1:
        errors = np.abs(np.array(outcome.strains) / np.array(known.strains) - 1.0)
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
    except (
        ValueError,
        RuntimeError,
    ) as error:  # unsuitable scene, or an error of PETSc
        unsuitable = type(error).__name__ == "UnsuitableError"
        kind = "cannot" if unsuitable else "fails"
        return Outcome(kind, shortened(str(error).strip().splitlines()[-1]))


def solve_by(method: str, made: Config, subdomains: Any) -> Outcome:
    """Verdict of a method on a configuration; empty if it reports convergence."""
    scene = built(made, subdomains)
    if method in (OURS, WHOLE):
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

    row, _, _ = peers.solve(scene, PEERS[method], scene.solver.expected_tolerance)
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


# ------------------------------------------------------------------------------------- document

Table = dict[str, dict[str, Outcome]]

HEAD = """# Scenes on which methods fail

Made by `contact-app stability`; every cell is a run. The number in parentheses is its work:
Hessian multiplications of the dual problem for this application, multiplications with the stiffness
for TAO, Newton steps (one factor each) for SNES VI. They can be compared within a column, not
within a row. ×2.0 is the growth of the work from a milder variant of the scene.

| verdict | meaning |
|---|---|
| holds | the answer is right: energy to 1e-6, penetration below 1e-6; of several bodies, \
the strain energy of each to 1e-3 |
| degrades | right, with more than three times the work of the variant |
| refused | an error message with the reason |
| fails | the method reports that it did not converge, or exceeds its limit of 30 seconds |
| **WRONG** | the method reports convergence, and the answer is wrong |
| cannot | the scene cannot be stated as bounds on the displacements of one body, or its mesh \
cannot be read |

The reference is the exact solution if it is known, else a run without decomposition at tolerance
1e-10, whose duality gap bounds its error. The tests (`tests/stability`) compare every row with a
reference that shares no code with this application.

## Scenes

`contact-app` is the run with the body cut into subdomains, *whole* the run without decomposition,
which `auto` chooses for bodies of this size. SNES VI is `vinewtonrsls` with a CHOLMOD factor in
each step; TAO uses CG with Jacobi. The tolerance of all is 1e-8.

"""

FRICTION = """
## Scenes with friction

The law is Coulomb's. `contact-app` is Total FETI with active sets in subdomains, *whole* the same
without decomposition, *multigrid* active sets on the undecomposed body (`solver.method: primal`),
and SMALBE-M the method with a proof of convergence, with MPRGP on discs of friction forces
(`smalbe`), in subdomains. The number in parentheses is operator applications, for multigrid those
of the stiffness. The test of the energy is 1e-6; for a load history it is the sum of energies over
all increments. Milder variants are the same scenes without friction, with μ = 0.3, or at half the
load.

"""

MIDDLE = """
## Quadratic programmes

The strategies of `solver.MPRGP` and PETSc's TAO start from the same point and stop at a projected
gradient of 1e-6 ‖b‖. A solution is right if this residual is below 1e-5. TAO measures x - P(x - g),
which mixes the units of variables and gradient: if gradients are large compared with the box, it
stops at the start.

"""

TAIL = """
## Random scenes

`python -m tests.stability.fuzz 1000` makes 1000 random scenes (bodies, also slender ones, slivers
and far from the origin, one on another, boxes and distorted cells from mesh files; degree 1 and 2,
mean dilatation; units; materials to a contrast of 1e6; conditions, loads, obstacles; tolerances,
`auto` too; partitions) and compares each answer with the undecomposed reference and each refusal
with a linear programme. Every fourth scene is of a kind that an earlier version solved wrongly,
slowly or not at all (`tests/stability/defect_scenes.py`): a weak body beside a strong one, a stiff
block between walls on a soft one, a strip or plate lifted off a floor, a load on the face that
touches, a body moved far and squeezed a little, several contacts at a node, a slender cantilever in
many subdomains at tolerances to 1e-12, and mesh files whose cells overlap.

Each answer is compared in its energy and, in each body, in its strains: the squared energy norm of
the error over a(u, u) may be twice the tolerance. The reference solves each group of bodies that
can touch separately and corrects the solution in extended precision (`tests/stability/polish.py`).
Faults are a crash, a scene that hangs, a wrong solution with a passed certificate, no solution
where the reference has one (and double precision suffices for its strains), a wrong decision on
equilibrium, and accepted overlapping cells.

The defects that it found are guarded now: nodes squeezed between two obstacles; bodies of both
degrees side by side; stiff bodies on soft ones, whose forces depend on the last digits of their
displacements; active sets that hold a body only by rounding errors; and subdomains of cells a
hundred times longer than wide. Forces between such subdomains cancel to the last digit, and
conjugate gradients stop at rounding errors, far from a solution. Such a scene is solved again
without decomposition, as far as memory allows (on several ranks with one subdomain for each). If
that fails too, augmented Lagrangians and Newton's method solve for the displacements, with one
sparse factor per step (`solver/primal/newton.py`): this is slower, but does not depend on the
digits of a dual operator. It also follows an exception of the solver. The certificate warns of such
a fallback (`contact_app/run/fallback.py`).

The verdicts: "agrees" is certified and right; "contradicts" and "escapes" are refused, and there is
no equilibrium; "refused" is wrong input with an error message; "degraded" is not certified, where
strains are rounding errors or the reference has no solution; "undecided" is certified, while the
reference does not converge, also not in extended precision (`tests/extended.py`).

<!-- python -m tests.stability.fuzz 1000 --document docs/benchmarks/stability.md -->
"""


def stability(output: Path, tell: Callable[[str], None] = print) -> list[Path]:
    """Run everything, write ``stability.csv`` and ``stability.md``."""
    output.mkdir(parents=True, exist_ok=True)
    PETSc.Log.begin()  # counts TAO's multiplications
    scenes: Table = {}
    for case in CASES:
        scenes[case.name] = run_case(case)
        tell(_line(case.name, scenes[case.name]))
    rough = friction_table(tell)
    programmes: Table = {}
    for qp_case in QP_CASES:
        programmes[qp_case.name] = run_qp_case(qp_case)
        tell(_line(qp_case.name, programmes[qp_case.name]))
    table, page = output / "stability.csv", output / "stability.md"
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for name, outcomes in (*scenes.items(), *rough.items(), *programmes.items()):
            for method, o in outcomes.items():
                numbers = (o.applications, o.growth, o.energy, o.penetration)
                writer.writerow((name, method, o.verdict, o.detail, *numbers))
    page.write_text(document(scenes, rough, programmes), encoding="utf-8")
    return [table, page]


def friction_table(tell: Callable[[str], None] = print) -> Table:
    """All methods on all scenes with friction."""
    found: Table = {}
    for case in FRICTION_CASES:
        found[case.name] = run_case(case, tuple(FRICTION_METHODS), solve_rough)
        tell(_line(case.name, found[case.name]))
    return found


def friction_section(found: Table) -> str:
    """The section of the page."""
    guards = [(c.name, c.failure, c.guard) for c in FRICTION_CASES if c.name in found]
    table = _markdown(("scene", *FRICTION_METHODS), found)
    return "".join((FRICTION, table, "\n", _guards(guards, found)))


def document(scenes: Table, rough: Table, programmes: Table) -> str:
    """``docs/benchmarks/stability.md``."""
    guards = [(c.name, c.failure, c.guard) for c in (*CASES, *QP_CASES)]
    return "".join(
        (
            HEAD,
            _markdown(("scene", *METHODS), scenes),
            "\n",
            _guards([g for g in guards if g[0] in scenes], scenes),
            friction_section(rough),
            MIDDLE,
            _markdown(("problem", *QP_METHODS), programmes),
            "\n",
            _guards([g for g in guards if g[0] in programmes], programmes),
            TAIL,
        )
    )


def _line(name: str, outcomes: dict[str, Outcome]) -> str:
    return f"{name}: " + "; ".join(f"{m} {o}" for m, o in outcomes.items())


def _markdown(head: tuple[str, ...], found: Table) -> str:
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for name, outcomes in found.items():
        lines.append(f"| {name} | " + " | ".join(_cell(o) for o in outcomes.values()) + " |")
    return "\n".join(lines) + "\n"


def _cell(outcome: Outcome) -> str:
    verdict = f"**{outcome.verdict}**" if outcome.verdict == "WRONG" else outcome.verdict
    notes = [str(outcome.applications)] if outcome.applications else []
    if outcome.growth:
        notes.append(f"×{outcome.growth:.1f}")
    return f"{verdict} ({', '.join(notes)})" if notes else verdict


def _guards(guards: list[tuple[str, str, str]], found: Table) -> str:
    lines = ["| | without care | the guard |", "|---|---|---|"]
    for name, failure, guard in guards:
        ours = next(iter(found[name].values()))
        said = f"; it says: “{ours.detail}”" if ours.verdict == REFUSED else ""
        lines.append(f"| {name} | {failure} | {guard}{said} |")
    return "\n".join(lines) + "\n"
