"""Methods of PETSc on a scene as one undecomposed system.

Each takes the system of `undecomposed.assemble`. `single_run` runs one method in a process of its
own (or several under ``mpirun``), so that time and memory belong to this method.

====================  ==========================================================================
``linear-gamg``       no contact at all: one linear solve by CG with GAMG, block size d, the rigid
                      motions as near-null space; the least cost of any iterative method
``linear-boomeramg``  the same with BoomerAMG: HMIS coarsening, aggressive on the first level,
                      extended interpolation, strong threshold 0.5
``linear-cholmod``    the same by one sparse Cholesky factor
``snes-vi``           SNES ``vinewtonrsls`` (reduced-space active sets); CG with BoomerAMG to 1e-3
                      for the steps
``snes-vi-cholmod``   the same with a CHOLMOD factor a step
``tao-bnls``          TAO ``bnls`` (Newton with line search on the free set); CG with Jacobi to 1e-2
``tao-bntr``          TAO ``bntr`` (Newton with trust region on the free set); the same
====================  ==========================================================================

The options are the fastest of those tried on the cube of 89,373 and 206,763 unknowns. Tried were
thresholds, coarsening and smoothers of GAMG (SOR and point-block Jacobi fail: a coarse matrix has
zero rows) and of BoomerAMG (its nodal coarsening is slower or fails); for TAO PETSc's default
preconditioner, Jacobi, ICC, GAMG, BoomerAMG and CHOLMOD; for SNES GAMG, BoomerAMG, MUMPS and
CHOLMOD. GAMG fails if the free set changes its size (an error in PETSc), and it loses the rigid
motions on the free set. Two ranks halve the time of iterative methods.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from contact_app.machine.environment import peak_rss_gb
from contact_app.scene.scene import Scene
from contact_app.studies.undecomposed import WholeSystem, assemble

Answer = tuple[PETSc.Vec, int, int, bool]
"""Unknowns, steps of the method, multiplications with the stiffness, convergence."""


def _linear(system: WholeSystem, tolerance: float) -> Answer:
    """One linear solve by conjugate gradients: bounds are ignored.

    On one rank GAMG multiplies Pᵀ (K P), which halves its set-up (an option of PETSc's).
    """
    load = system.load
    if load.comm.size == 1:
        PETSc.Options().setValue("matptap_via", "rap")
    ksp = PETSc.KSP().create(load.comm)
    ksp.setOperators(system.matrix)
    ksp.setType("cg")
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.setTolerances(rtol=tolerance, max_it=2000)
    ksp.setFromOptions()
    x = load.duplicate()
    x.set(0.0)
    ksp.solve(load, x)
    return x, 1, ksp.getIterationNumber(), ksp.getConvergedReason() > 0


def _snes(system: WholeSystem, tolerance: float) -> Answer:
    """Solve with SNES and variable bounds."""
    x, matrix, applications = system.load.duplicate(), system.matrix, _Counter()
    x.set(0.0)

    def residual(_snes: PETSc.SNES, at: PETSc.Vec, out: PETSc.Vec) -> None:
        matrix.mult(at, out)
        out.axpy(-1.0, system.load)
        applications.count += 1

    snes = PETSc.SNES().create(system.load.comm)
    snes.setType("vinewtonrsls")
    snes.setFunction(residual, x.duplicate())
    snes.setJacobian(lambda *_: None, matrix, matrix)
    snes.setVariableBounds(system.lower, system.upper)
    snes.setTolerances(rtol=tolerance, atol=0.0, stol=0.0, max_it=100)
    snes.setFromOptions()
    snes.solve(None, x)
    return x, snes.getIterationNumber(), applications.count, snes.getConvergedReason() > 0


def _tao(system: WholeSystem, tolerance: float) -> Answer:
    """Solve with TAO's active-set Newton methods."""
    x, matrix = system.load.duplicate(), system.matrix
    x.set(0.0)

    def objective(_tao: PETSc.TAO, at: PETSc.Vec, gradient: PETSc.Vec) -> float:
        matrix.mult(at, gradient)
        energy = 0.5 * at.dot(gradient) - at.dot(system.load)
        gradient.axpy(-1.0, system.load)
        return energy

    # a monitor of TAO's KSP would count, but crashes with PETSc 3.22
    PETSc.Log.begin()
    product = PETSc.Log.Event("MatMult")
    before = product.getPerfInfo()["count"]
    tao = PETSc.TAO().create(system.load.comm)
    tao.setObjectiveGradient(objective, None)
    tao.setHessian(lambda *_: None, matrix, matrix)
    tao.setVariableBounds((system.lower, system.upper))
    tao.setTolerances(gatol=tolerance * system.load.norm(), grtol=0.0, gttol=0.0)
    tao.setMaximumIterations(1000)
    tao.setSolution(x)
    tao.setFromOptions()
    tao.solve()
    applications = product.getPerfInfo()["count"] - before
    return x, tao.getIterationNumber(), int(applications), tao.getConvergedReason() > 0


class _Counter:
    count = 0


@dataclass(frozen=True)
class Method:
    """A method of PETSc and its options."""

    solve: Callable[[WholeSystem, float], Answer]
    contact: bool
    parallel: bool
    """Whether it gains from ranks; the others use the threads of BLAS."""
    options: dict[str, str] = field(default_factory=dict)


_BOOMERAMG = {
    "pc_type": "hypre",
    "pc_hypre_boomeramg_strong_threshold": "0.5",
    "pc_hypre_boomeramg_coarsen_type": "HMIS",
    "pc_hypre_boomeramg_interp_type": "ext+i",
    "pc_hypre_boomeramg_agg_nl": "1",
}
_NEWTON_CG = {"tao_bnk_ksp_type": "stcg", "tao_bnk_ksp_rtol": "1e-2", "tao_bnk_pc_type": "jacobi"}
"""Steihaug's CG: in bnls of PETSc 3.22 the plain one stops at a length that is not for it."""

METHODS = {
    "linear-gamg": Method(
        _linear, False, True, {"pc_type": "gamg", "pc_gamg_threshold": "0.01"}
    ),
    "linear-boomeramg": Method(_linear, False, True, _BOOMERAMG),
    "linear-cholmod": Method(
        _linear, False, False,
        {"pc_type": "cholesky", "pc_factor_mat_solver_type": "cholmod"},
    ),
    "snes-vi": Method(
        _snes, True, True, {"ksp_type": "cg", "ksp_rtol": "1e-3", **_BOOMERAMG}
    ),
    "snes-vi-cholmod": Method(
        _snes, True, False,
        {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "cholmod"},
    ),
    "tao-bnls": Method(_tao, True, True, {"tao_type": "bnls", **_NEWTON_CG}),
    "tao-bntr": Method(_tao, True, True, {"tao_type": "bntr", **_NEWTON_CG}),
}  # fmt: skip


@contextmanager
def options_of(method: str) -> Iterator[None]:
    """Set a method's options in PETSc, except those that are already set.

    Options of PETSc are global: they are removed afterwards, since the next method has others.
    """
    options = PETSc.Options()
    defaults = {k: v for k, v in METHODS[method].options.items() if not options.hasName(k)}
    for key, value in defaults.items():
        options.setValue(key, value)
    try:
        yield
    finally:
        for key in defaults:
            options.delValue(key)


def solve(
    scene: Scene,
    method: str,
    tolerance: float,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    change: Callable[[WholeSystem], None] | None = None,
    nodal: bool = False,
) -> tuple[dict[str, Any], WholeSystem, PETSc.Vec]:
    """Solve a scene by one method; its row, seconds from mesh to solution (collective).

    Parameters
    ----------
    change
        Changes the system in place before it is solved.
    nodal
        Bound the gaps at nodes also where this application bounds averages around vertices.
    """
    chosen = METHODS[method]
    comm.barrier()
    begin = time.perf_counter()
    system = assemble(scene, comm, nodal=nodal or not chosen.contact)
    if change is not None:
        change(system)
    assembled = time.perf_counter()
    with options_of(method):
        x, steps, applications, converged = chosen.solve(system, tolerance)
    comm.barrier()
    end = time.perf_counter()
    row = {
        "method": method,
        "dofs": system.dofs,
        "tolerance": tolerance,
        "seconds": end - begin,
        "solve_seconds": end - assembled,
        "peak_rss_gb": comm.allreduce(peak_rss_gb()),
        "ranks": comm.size,
        "steps": steps,
        "applications": applications,
        "energy": system.energy(x),
        "penetration": system.penetration(x),
        "converged": bool(converged),
    }
    return row, system, x
