"""Smoothed aggregation of the problem without contact: prolongations and coarse operators.

PETSc's GAMG makes them once; every active set uses the same ones (`solver.primal.cycle`). The
near-kernel is the rigid motions of each body, from the coordinates of its nodes. Rigid bodies are
held in place: the levels do not contain their motions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from solver.primal.merged import MergedSystem, with_diagonal
from solver.primal.vertices import vertex_level
from solver.tfeti.constraints.matrix import lent


@dataclass(frozen=True)
class MultigridOptions:
    """The tuned numbers of the multigrid, measured on parts from a mesher.

    Attributes
    ----------
    threshold
        Couplings below this share are left out of aggregates, so that aggregates follow thin walls.
    aggressive
        Number of levels with aggressive (squared) coarsening. The second level then has a thirtieth
        of the unknowns, and a cycle costs little more than its smoothing steps on the finest level.
    smoothing
        Chebyshev steps before and after each coarse correction.
    smallest
        Unknowns below which no coarser level is made.
    singular
        Eigenvalues of the coarsest level below that share of its largest row sum are rigid motions.
    """

    threshold: float = 0.005
    aggressive: int = 1
    smoothing: int = 2
    smallest: int = 300
    singular: float = 1e-10


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Levels from fine to coarse.

    Attributes
    ----------
    prolongations
        Entry k maps level k + 1 to level k; level 0 is the finest.
    operators
        Stiffness of each level, K first.
    """

    prolongations: tuple[PETSc.Mat, ...]
    operators: tuple[PETSc.Mat, ...]
    options: MultigridOptions


def no_hierarchy(system: MergedSystem) -> Hierarchy:
    """The finest level alone, for methods that factor it."""
    return Hierarchy((), (system.K,), MultigridOptions())


def build_hierarchy(system: MergedSystem, options: MultigridOptions | None = None) -> Hierarchy:
    """Let GAMG aggregate (collective)."""
    options = options or MultigridOptions()
    K = with_diagonal(system.K, system.stiffless, float(system.diagonal.max(initial=1.0)))
    vertices = vertex_level(system)
    if vertices is None:
        top, rigid = K, np.where((system.held | system.stiffless)[:, None], 0.0, system.rigid)
    else:
        top, rigid = _on_vertices(system, vertices.P), vertices.rigid
    top.setNearNullSpace(near_kernel(system.comm, rigid))
    pc = PETSc.PC().create(system.comm)
    pc.setOperators(top)
    prefix = "contact_gamg_"
    pc.setOptionsPrefix(prefix)
    pc.setType("gamg")
    settings = {
        "pc_gamg_threshold": options.threshold,
        "pc_gamg_coarse_eq_limit": options.smallest,
        # the name until PETSc 3.18, and the one since
        "pc_gamg_square_graph": options.aggressive,
        "pc_gamg_aggressive_coarsening": options.aggressive,
        "mg_levels_ksp_max_it": options.smoothing,
        "mg_levels_pc_type": "jacobi",
        "mg_coarse_pc_type": "none",  # its factor is not needed
        "mg_coarse_ksp_type": "preonly",
    }
    with lent_options(prefix, settings), lent_options("", _products(system.comm)):
        pc.setFromOptions()
        pc.setUp()
    levels = pc.getMGLevels()
    prolongations = [pc.getMGInterpolation(k) for k in range(levels - 1, 0, -1)]
    solvers = [pc.getMGSmoother(k) for k in range(levels - 1, -1, -1)]
    operators = [top, *(ksp.getOperators()[0].copy() for ksp in solvers[1:])]
    pc.destroy()  # GAMG's own matrices keep the products K P that they were made of
    if vertices is not None:
        prolongations, operators = [vertices.P, *prolongations], [K, *operators]
    return Hierarchy(tuple(prolongations), tuple(operators), options)


def _products(comm: MPI.Intracomm) -> dict[str, object]:
    """Options for the product Pᵀ K P.

    On one rank as Pᵀ (K P), in half the time of PETSc's default.
    """
    return {"matptap_via": "rap"} if comm.size == 1 else {}


def galerkin(operator: PETSc.Mat, prolongation: PETSc.Mat) -> PETSc.Mat:
    """Pᵀ A P as two products, which takes half the time of PETSc's own (collective)."""
    product = operator.matMult(prolongation)
    result = prolongation.transposeMatMult(product)
    product.destroy()
    return result


class lent_options:
    """Context manager that sets options in PETSc's database."""

    def __init__(self, prefix: str, options: dict[str, object]) -> None:
        self._names = {prefix + name: value for name, value in options.items()}
        self._options = PETSc.Options()

    def __enter__(self) -> None:
        for name, value in self._names.items():
            self._options[name] = value

    def __exit__(self, *ended: object) -> None:
        for name in self._names:
            self._options.delValue(name)


def _on_vertices(system: MergedSystem, P: PETSc.Mat) -> PETSc.Mat:
    """Pᵀ K P of degree 1, with a diagonal for held vertices (collective)."""
    matrix = galerkin(system.K, P)
    diagonal = matrix.getDiagonal()
    values = diagonal.getArray()
    values[values == 0.0] = system.comm.allreduce(values.max(initial=0.0), op=MPI.MAX)
    matrix.setDiagonal(diagonal)
    matrix.setBlockSize(system.problem.dimension)
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    return matrix


def near_kernel(comm: MPI.Intracomm, rigid: NDArray[np.float64]) -> PETSc.NullSpace:
    """Rigid motions (unknowns, motions), orthonormal over all bodies together."""
    gram = comm.allreduce(rigid.T @ rigid, op=MPI.SUM)
    scale = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    independent = values > 1e-12 * values.max()
    basis = rigid @ (vectors[:, independent] / scale[:, None] / np.sqrt(values[independent]))
    columns = [np.ascontiguousarray(column) for column in basis.T]
    with lent(comm, *columns) as lent_columns:
        copies = [column.copy() for column in lent_columns]
    return PETSc.NullSpace().create(vectors=copies, comm=comm)
