"""The next mesh of bodies from files: cells with a large share of the error are refined.

Triangles and tetrahedra with straight edges are marked, as few as possible, until they hold a share
θ of η², and are halved along every edge (`meshes.bisect`). Other cells cannot be refined one by
one; a body of such cells is refined as a whole if it has more than its part of the remaining η².
Let r be the target over the present η², and q the factor by which halving reduces η² of a cell.
Then θ = (1 - r)/(1 - q), but at most `MOST`, since an estimate on coarse cells is uncertain (W.
Dörfler, *A convergent adaptive algorithm for Poisson's equation*, SINUM 33, 1996).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.scene.bodies import Body, Box
from contact_app.scene.finer_meshes import halved
from meshes.arrays import Array
from meshes.quadratic import VERTICES
from meshes.unstructured import CellMesh, matching_rows

MOST = 0.8
"""Largest share of η² that is refined at once."""

LEAST = 0.3
"""Smallest share: a mesh with few new cells costs a solve and gains little."""


def locally_refined(bodies: Sequence[Body], solved: SolvedScene, target: float) -> tuple[Body, ...]:
    """The bodies of the last solve with finer meshes (collective).

    Parameters
    ----------
    target
        Target of the error relative to the present error.
    """
    squares = cell_errors(solved)
    total = sum(float(part.sum()) for part in squares)
    degree = min(body.degree for body in bodies)
    theta = float(np.clip((1.0 - target**2) / (1.0 - 4.0**-degree), LEAST, MOST))
    indivisible = [not _divisible(body) for body in bodies]
    left = (1.0 - theta) * total / len(bodies)
    round_sides: list[list[str]] = [[] for _ in bodies]
    for pair in solved.model.scene.pairs:
        if pair.round:
            round_sides[pair.body].append(pair.boundary)
            round_sides[pair.other].append(pair.other_boundary)
    finer: list[Body] = []
    marked_share = 0.0
    for body, part, together in zip(bodies, squares, indivisible, strict=True):
        if together and part.sum() > left:
            marked_share += float(part.sum())
            body = _finer(body, round_sides[len(finer)])
        finer.append(body)
    some = np.concatenate(
        [np.zeros(0), *(p for p, w in zip(squares, indivisible, strict=True) if not w)]
    )
    ordered = np.sort(some)[::-1]
    enough = np.searchsorted(np.cumsum(ordered), theta * total - marked_share)
    if len(ordered) and theta * total > marked_share:
        least = ordered[min(int(enough), len(ordered) - 1)]
        for b, (body, part) in enumerate(zip(finer, squares, strict=True)):
            marked = np.flatnonzero(part >= least)
            if not indivisible[b] and len(marked):
                finer[b] = halved(body, round_sides[b], marked)
    return tuple(finer)


def cell_errors(solved: SolvedScene) -> list[Array]:
    """η² of the cells of each body in the order of its mesh; of a box in any order (collective)."""
    model = solved.model
    partition = model.partition
    by_class = solved.estimator.cell_squares(solved.solution)
    result = []
    for b, body in enumerate(model.scene.bodies):
        mesh = body.mesh
        sums = np.zeros(mesh.total_cells)
        rows = np.sort(mesh.cells, axis=1) if isinstance(mesh, CellMesh) else None
        first = 0
        for s, (cls, column) in zip(partition.subdomains, model.place, strict=True):
            if s.body != b:
                continue
            squares = by_class[cls][:, column]
            if rows is None:
                sums[first : first + len(squares)] = squares
                first += len(squares)
            else:
                corners = s.reference.cells[:, : VERTICES[mesh.cell]]
                vertices = np.sort(s.nodes[corners] - partition.first_node[b], axis=1)
                sums[matching_rows(rows, vertices)] += squares
        if rows is None:
            sums[0] = sums.sum()
            sums[1:] = 0.0
        result.append(model.comm.allreduce(sums, op=MPI.SUM))
    return result


def _divisible(body: Body) -> bool:
    """Whether cells of the body can be refined one by one."""
    mesh = body.mesh
    return (
        isinstance(mesh, CellMesh)
        and mesh.cell in ("triangle", "tetrahedron")
        and mesh.middles is None
    )


def _finer(body: Body, round_sides: Sequence[str]) -> Body:
    """The body with every edge of its mesh halved."""
    mesh = body.mesh
    if isinstance(mesh, Box):
        return replace(body, mesh=replace(mesh, cells=tuple(2 * n for n in mesh.cells)))
    return halved(body, round_sides)
