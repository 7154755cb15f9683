"""The level of degree 1 below degree 2: displacements at vertices, linear between them.

Smoothed aggregation is slow on cells of degree 2: their matrices have positive couplings and twice
the entries a row. The displacements of degree 1 on the same cells are a subspace of those of degree
2 (where edges are straight), and GAMG works well on their stiffness Pᵀ K P. P maps vertices to
midside nodes and nodes inside faces and cells as means of the adjacent vertices.
"""

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from solver.distributed import petsc_rows
from solver.primal.merged import MergedSystem
from solver.primal.merged_nodes import MergedNodes
from solver.vectors import Array


@dataclass(frozen=True, eq=False)
class VertexLevel:
    """The displacements of degree 1; local parts."""

    P: PETSc.Mat
    """Matrix from vertices to the unknowns of the problem; zero on held unknowns and unknowns of
    rigid bodies, and from held vertices."""
    rigid: Array  # (vertex unknowns, motions)
    """The rigid motions, zero where held."""


def vertex_level(system: MergedSystem) -> VertexLevel | None:
    """The level of degree 1; None where all bodies are of degree 1 (collective)."""
    places, d = system.problem.places, system.problem.dimension
    if not system.comm.allreduce(int(any(p.vertex_weights is not None for p in places))):
        return None
    nodes = system.nodes
    weights = _weights(system, nodes)
    vertex = weights.diagonal() > 0.5
    vertices = nodes.at_owners(vertex[nodes.first_here])
    first = (system.comm.exscan(int(vertices.sum())) or 0) * d
    unknowns = np.flatnonzero(np.repeat(vertices, d))
    numbers = np.zeros(system.size)
    numbers[unknowns] = first + np.arange(len(unknowns))
    column = system.at_copies(numbers).astype(np.int64)
    fixed = system.held | system.stiffless
    free = system.at_copies(np.where(fixed, 0.0, 1.0))
    spread = sparse.kron(weights[nodes.first_here], sparse.eye(d), format="csr")
    rows = nodes.unknowns(np.flatnonzero(nodes.first_here), d)
    entries = spread.data * free[spread.indices]
    entries *= np.repeat(free[rows], np.diff(spread.indptr))
    shape = len(rows), system.comm.allreduce(len(unknowns))
    local = sparse.csr_matrix((entries, column[spread.indices], spread.indptr), shape)
    local = nodes.at_owners(local, d)
    local.sort_indices()
    P = petsc_rows(system.comm, local, len(unknowns))
    P.setBlockSizes(d, d)
    rigid = np.where(fixed[:, None], 0.0, system.rigid)[unknowns]
    return VertexLevel(P, rigid)


def _weights(system: MergedSystem, nodes: MergedNodes) -> sparse.csr_matrix:
    """Weights of the vertices at each distinct node of this rank, from one of its copies."""
    count = len(nodes.numbers)
    rows, columns, values = [], [], []
    has_weights = np.zeros(count, bool)
    for place, at in zip(system.problem.places, nodes.copies, strict=True):
        weights = place.vertex_weights
        weights = sparse.identity(at.shape[1], format="csr") if weights is None else weights
        for member in at:
            new = weights[np.flatnonzero(~has_weights[member])].tocoo()
            rows.append(member[~has_weights[member]][new.row])
            columns.append(member[new.col])
            values.append(new.data)
            has_weights[member] = True
    none = np.zeros(0, np.int64)
    places = np.concatenate([none, *rows]), np.concatenate([none, *columns])
    return sparse.csr_matrix((np.concatenate([np.zeros(0), *values]), places), (count, count))
