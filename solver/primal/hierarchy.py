"""Smoothed aggregation of the problem without contact: prolongations and coarse operators.

They are made once (`solver.primal.aggregation`); every active set uses the same ones
(`solver.primal.cycle`). The near-kernel is the rigid motions of each body, from the coordinates of
its nodes. Rigid bodies are held in place: the levels do not contain their motions.
"""

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from solver.primal.aggregation import coarsened
from solver.primal.block_rows import BlockRows
from solver.primal.blocks import in_blocks, keep_in_blocks, petsc_blocks
from solver.primal.lanczos import largest_eigenvalue
from solver.primal.merged import MergedSystem
from solver.primal.products import with_diagonal
from solver.primal.vertices import vertex_level
from solver.vectors import Array


@dataclass(frozen=True)
class MultigridOptions:
    """The tuned numbers of the multigrid, measured on parts from a mesher."""

    threshold: float = 0.005
    """Couplings below this share are left out of aggregates, so that aggregates follow thin
    walls."""
    aggressive: int = 1
    """Number of levels with aggressive (squared) coarsening. The second level then has a thirtieth
    of the unknowns, and a cycle costs little more than its smoothing steps on the finest level."""
    damping: float = 1.4
    """ω of the prolongation times the largest eigenvalue of D⁻¹ A, as GAMG has it."""
    smoothing: int = 2
    """Chebyshev steps before and after each coarse correction."""
    interval: tuple[float, float] = (0.1, 1.1)
    """Damped eigenvalues of D⁻¹ K over the estimate of the largest one, as PETSc has them."""
    changed: float = 0.15
    """Changed springs, relative to the rows of the set, up to which a cycle keeps those it has.
    With 0.05 eleven parts take 477 operator applications and make more cycles, with 0.15 they take
    464: a tray 43 instead of 47, a cup on a ball 76 instead of 87, an eye on a pin 38 instead of
    36."""
    noticed: float = 0.3
    """Change of a spring, relative to the larger one, or sine of the angle by which its row turns,
    from which on it counts as changed."""
    smallest: int = 300
    """Unknowns below which no coarser level is made."""
    singular: float = 1e-10
    """Eigenvalues of the coarsest level below that share of its largest row sum are rigid
    motions."""


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Levels from fine to coarse."""

    prolongations: tuple[PETSc.Mat, ...]
    """Entry k maps level k + 1 to level k; level 0 is the finest."""
    operators: tuple[PETSc.Mat, ...]
    """Stiffness of each level, K first; coarser ones from `solver.primal.blocks.petsc_blocks`."""
    options: MultigridOptions
    largest: float = 0.0
    """Estimate of the largest eigenvalue of D⁻¹ K; zero where K is the only level."""


def no_hierarchy(system: MergedSystem) -> Hierarchy:
    """The finest level alone, for methods that factor it."""
    return Hierarchy((), (system.K,), MultigridOptions())


def build_hierarchy(system: MergedSystem, options: MultigridOptions | None = None) -> Hierarchy:
    """Aggregate level by level (collective)."""
    options, d = options or MultigridOptions(), system.problem.dimension
    K = with_diagonal(system.K, system.stiffless, float(system.diagonal.max(initial=1.0)))
    vertices = vertex_level(system)
    if vertices is None:
        A, top = BlockRows.of(K), K
        rigid = np.where((system.held | system.stiffless)[:, None], 0.0, system.rigid)
        keep_in_blocks(K, A)
    else:
        A, rigid = _on_vertices(system, vertices.P), vertices.rigid
        top = petsc_blocks(A)
    prolongations, operators = [], [top]
    motions = rigid.reshape(-1, d, rigid.shape[1])
    aggressive, eigenvalues = options.aggressive, list[float]()
    while operators[-1].getSize()[0] > options.smallest:
        operator = in_blocks(K) if operators[-1] is K else operators[-1]
        eigenvalues.append(largest_eigenvalue(operator, _flexibility(operator)))
        damping = options.damping / eigenvalues[-1]
        level = coarsened(A, motions, damping, options.threshold, aggressive > 0)
        if level is None:
            break
        A, motions = A.galerkin(level.P), level.rigid
        aggressive -= 1
        prolongations.append(level.P.to_petsc())
        operators.append(petsc_blocks(A))
    if vertices is not None:
        prolongations, operators = [vertices.P, *prolongations], [K, *operators]
        eigenvalues.insert(0, largest_eigenvalue(in_blocks(K), _flexibility(K)))
    return Hierarchy(tuple(prolongations), tuple(operators), options, (eigenvalues or [0.0])[0])


def _flexibility(operator: PETSc.Mat) -> Array:
    """One over the diagonal, zero where that is zero."""
    diagonal = operator.getDiagonal().getArray()
    return np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)


def _on_vertices(system: MergedSystem, P: PETSc.Mat) -> BlockRows:
    """Pᵀ K P of degree 1, with a diagonal for held vertices (collective)."""
    return BlockRows.of(system.K).galerkin(BlockRows.of(P)).with_diagonal()
