"""Pairs of bodies whose touching surfaces are tilted against each other.

The gap of a row is measured along the mean normal n of the `on` surface, and contact holds n · u at
that gap. Where the other surface has the normal -m, the bodies would touch after a motion of
g n · m along m. The two differ by g (1 - n · m) at least: little where the surfaces are nearly
parallel or the gap is small, much where the flank of a tooth overlaps a smooth surface.
"""

from collections.abc import Iterator

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from contact_app.model.geometry import Geometry
from meshes.contact_surface import Surface
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem

TILTED = 0.03
"""Mean of g (1 - n · m) over the contact force, over the largest displacement, above which there is
a warning. A hub that is shrunk on a shaft has 0.004, a hose on the teeth of a fitting 0.015, a lid
on a bead 0.012, and a rack on a pinion 0.0003. With exchanged sides the last three have 0.09, 0.036
and 0.088: energies are 3, 1.4 and 1.1 times apart, forces up to 2.2 times."""


def tilted_pairs(geometry: Geometry, problem: DualProblem, solution: Solution) -> Iterator[str]:
    """Sentences on pairs whose gaps depend much on the side they are measured from (collective)."""
    for source, pair in enumerate(geometry.pairs, start=len(geometry.contacts)):
        surface = geometry.boundary_surface(pair.other, pair.other_boundary)
        names = geometry.bodies[pair.body].name, geometry.bodies[pair.other].name
        moved = float(solution.measures.deformations[[pair.body, pair.other]].max())
        if surface is None:
            continue
        text = tilted(problem, solution, source, surface, names, moved)
        if text:
            yield f"{pair.source}: {text}"


def tilted(
    problem: DualProblem,
    solution: Solution,
    source: int,
    other: Surface,
    names: tuple[str, str],
    moved: float,
) -> str:
    """A sentence on a pair whose gaps depend much on their side; empty otherwise (collective).

    Parameters
    ----------
    source
        Number of the contact.
    other
        The surface that the `on` surface touches.
    names
        Of the bodies of both.
    moved
        Their largest displacement.
    """
    force, d, comm = solution.multiplier[problem.inequality], problem.dimension, problem.comm
    chosen = (force > 0.0) & (problem.contact.sources == source)
    rows, pressed = problem.contact.of(chosen), force[chosen]
    cosine = np.ones(len(pressed))
    if len(pressed):
        normals = rows.normals / np.linalg.norm(rows.normals, axis=1, keepdims=True)
        touched = rows.points.copy()
        touched[:, :d] -= rows.gaps[:, None] * normals
        facets = cKDTree(other.centres).query(touched)[1]
        cosine = np.einsum("ri,ri->r", normals, other.normals[facets, :d])
    off = comm.allreduce(float(pressed @ (np.abs(rows.gaps) * (1.0 - cosine))))
    total = comm.allreduce(float(pressed.sum()))
    if off <= TILTED * moved * total:
        return ""
    farthest = comm.allreduce(np.abs(rows.gaps).max(initial=0.0), op=MPI.MAX)
    on, against = names
    return (
        f"surfaces of {on} and {against} press that are tilted against each other and up to "
        f"{farthest:.2g} apart or inside each other before loading: gaps and forces are along the "
        f"normals of {on}, and differ much if `on` and `against` change places; take the smoother "
        "surface as `on`, or draw the bodies where they touch"
    )
