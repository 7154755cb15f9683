"""MPRGP compared with PETSc's TAO on quadratic programs with bounds.

``python -m contact_app.studies.qp_solvers`` prints the table of ``solver/README.md``:
multiplications with the Hessian, or with its free part where a solver takes submatrices. All
solvers start from zero, stop at ‖g^P‖ ≤ 1e-6 ‖b‖ and use multiplications only: the Newton solvers
of TAO run without preconditioner, since their default one factors A. For TAO the multiplications
are the calls of MatMult that PETSc logs.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from solver.qp.box_qp import BoxQP
from solver.qp.mprgp import MPRGP
from solver.vectors import Vector

RTOL = 1e-6
TAO = ("bnls", "bntr", "tron", "bncg", "bqnls")
MPRGP_EXPANSIONS = ("fixed", "gfgf-opt", "projcg", "projcg-safe")


@dataclass(frozen=True)
class Problem:
    """A box-constrained QP as arrays."""

    name: str
    A: sparse.csr_array
    b: Vector
    lower: Vector
    upper: Vector

    def residual(self, x: Vector) -> float:
        """‖g^P‖/‖b‖ at the projection of x; within 1e-9 of a bound counts as on it.

        If b = 0, it is relative to the gradient at the feasible point next to zero.
        """
        x = np.clip(x, self.lower, self.upper)
        g = self.A @ x - self.b
        near = 1e-9 * max(1.0, float(np.abs(x).max()))
        g[(x - self.lower <= near) & (g > 0.0)] = 0.0
        g[(self.upper - x <= near) & (g < 0.0)] = 0.0
        start = self.A @ np.clip(np.zeros_like(x), self.lower, self.upper)
        scale = np.linalg.norm(self.b) or np.linalg.norm(start) or 1.0
        return float(np.linalg.norm(g) / scale)


@dataclass(frozen=True)
class Entry:
    """Result of a solver: Hessian multiplications, final ‖g^P‖/‖b‖, reason of an early stop."""

    multiplications: int
    residual: float
    note: str = ""


def problems() -> list[Problem]:
    """Problems: a string and a membrane over obstacles, random boxes, support vector machines."""
    problems_of_all = []
    n = 400
    i, h = np.arange(n), 1.0 / (n + 1)
    string = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(n, n))
    wavy = np.sin(4.0 * np.pi * i * h - np.pi / 6.0) / 2.0 - 2.0
    problems_of_all.append(
        _problem(f"string over an obstacle, n = {n}", string, np.full(n, -30 * h**2), wavy)
    )
    m = 60
    second = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(m, m))
    x, y = np.meshgrid(*2 * [np.linspace(0.0, 1.0, m + 2)[1:-1]])
    hills = (-0.05 - 0.05 * np.sin(6.0 * x) * np.cos(9.0 * y)).ravel()
    problems_of_all.append(
        _problem(
            f"membrane over an obstacle, n = {m * m}",
            sparse.kronsum(second, second),
            np.full(m * m, -2.0 / m**2),
            hills,
        )
    )
    for condition in (1e3, 1e6):
        problems_of_all.append(random_box(400, condition))
    problems_of_all.append(random_box(400, 1e3, degenerate=True))
    problems_of_all += [support_vector_machine("l2", 300), support_vector_machine("l1", 300)]
    return problems_of_all


def _problem(name, A, b, lower=None, upper=None) -> Problem:  # type: ignore[no-untyped-def]
    n = b.size
    return Problem(
        name,
        sparse.csr_array(A),
        b,
        np.full(n, -np.inf) if lower is None else lower,
        np.full(n, np.inf) if upper is None else upper,
    )


def random_box(n: int, condition: float, degenerate: bool = False) -> Problem:
    """Random dense problem between two bounds; `degenerate`: most multipliers vanish."""
    rng = np.random.default_rng(7)
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    A = (Q * np.geomspace(1.0, condition, n)) @ Q.T
    A = 0.5 * (A + A.T)
    lower, upper = -np.abs(rng.standard_normal(n)), np.abs(rng.standard_normal(n))
    x = np.clip(rng.standard_normal(n), lower, upper)
    multiplier = np.where(x <= lower, 1.0, np.where(x >= upper, -1.0, 0.0)) * rng.random(n)
    if degenerate:
        multiplier[rng.random(n) < 0.7] = 0.0
    b = A @ x - 10.0 * multiplier
    kind = "random box, dual degenerate" if degenerate else "random box"
    return _problem(f"{kind}, n = {n}, condition {condition:.0e}", A, b, lower, upper)


def support_vector_machine(loss: str, samples: int) -> Problem:
    """Dual of a support vector machine on random data; l1 is semidefinite."""
    rng = np.random.default_rng(8)
    X = np.c_[rng.uniform(-1.0, 1.0, (samples, 12)), np.ones(samples)]
    y = np.sign(X @ rng.standard_normal(13) + 0.7 * rng.standard_normal(samples))
    Z = y[:, None] * X
    shift, upper = (1.0, None) if loss == "l2" else (0.0, np.ones(samples))
    A = Z @ Z.T + shift * np.eye(samples)
    name = f"support vector machine, {loss} loss, n = {samples}"
    return _problem(name, A, np.ones(samples), np.zeros(samples), upper)


def run_mprgp(problem: Problem, expansion: str) -> Entry:
    """Run one expansion strategy; the multiplications that estimate ‖A‖ count."""
    qp = BoxQP(problem.A, problem.b, problem.lower, problem.upper)
    result = MPRGP(expansion, rtol=RTOL, max_iterations=20_000).solve(qp)
    note = "" if result.converged else result.reason.name.lower().replace("_", " ")
    multiplications = result.counts.hessian + result.counts.norm_estimation
    return Entry(multiplications, problem.residual(result.x), note)


def run_tao(problem: Problem, kind: str) -> Entry:
    """Run a bound-constrained solver of TAO with its default options."""
    comm = PETSc.COMM_SELF
    A = problem.A
    matrix = PETSc.Mat().createAIJ(
        A.shape,
        csr=(A.indptr.astype(PETSc.IntType), A.indices.astype(PETSc.IntType), A.data),
        comm=comm,
    )
    b, lower, upper = (
        PETSc.Vec().createWithArray(v.copy(), comm=comm)
        for v in (
            problem.b,
            np.maximum(problem.lower, PETSc.NINFINITY),
            np.minimum(problem.upper, PETSc.INFINITY),
        )
    )
    x = b.duplicate()
    x.set(0.0)
    tao = PETSc.TAO().create(comm)
    tao.setType(kind)
    tao.setVariableBounds(lower, upper)

    def objective_gradient(tao, x, g):  # type: ignore[no-untyped-def]
        matrix.mult(x, g)
        value = 0.5 * g.dot(x) - b.dot(x)
        g.axpy(-1.0, b)
        return value

    tao.setObjectiveGradient(objective_gradient, b.duplicate())
    tao.setHessian(lambda tao, x, H, P: None, matrix, matrix)
    tao.setTolerances(gatol=RTOL * float(np.linalg.norm(problem.b)), grtol=0.0, gttol=0.0)
    tao.setMaximumIterations(20_000)
    tao.setSolution(x)
    options = PETSc.Options()
    if kind in ("bnls", "bntr", "tron"):  # multiplications alone, as MPRGP has: no factors of A
        for name in (f"tao_{kind}_pc_type", "pc_type"):
            options.setValue(name, "none")
        tao.setFromOptions()
        for name in (f"tao_{kind}_pc_type", "pc_type"):
            options.delValue(name)
    tao.setUp()
    event = PETSc.Log.Event("MatMult")
    before = event.getPerfInfo()["count"]
    tao.solve()
    multiplications = event.getPerfInfo()["count"] - before
    note = "" if tao.getConvergedReason() > 0 else f"stopped: reason {tao.getConvergedReason()}"
    entry = Entry(multiplications, problem.residual(x.getArray().copy()), note)
    tao.destroy()
    return entry


def table() -> Iterator[str]:
    """Lines of a Markdown table: multiplications by problem and solver."""
    solvers = (*MPRGP_EXPANSIONS, *(f"TAO `{kind}`" for kind in TAO))
    yield f"| problem | {' | '.join(solvers)} |"
    yield "|---|" + "---:|" * len(solvers)
    for problem in problems():
        entries = [run_mprgp(problem, expansion) for expansion in MPRGP_EXPANSIONS]
        entries += [run_tao(problem, kind) for kind in TAO]
        cells = (f"({e.multiplications})" if e.note else str(e.multiplications) for e in entries)
        yield f"| {problem.name} | " + " | ".join(cells) + " |"


if __name__ == "__main__":
    PETSc.Log.begin()
    for line in table():
        print(line)
