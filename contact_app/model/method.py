"""Which method `solver.method: auto` stands for, and what a method asks of its model.

On parts from a mesher both methods take about as long (`contact-app bench parts`, whole runs
at 1e-8 on one rank of two cores, 27,000 to 176,000 unknowns): multigrid takes 0.69 to 1.16 of
the seconds of Total FETI, least where the sets are hard to find. Its iterations do not grow with
the mesh, 26 to 58, where those of Total FETI reach 318; so it is taken. Of degree 2 one body (the
pillow block, 64,035 unknowns) takes 0.40 of the CPU seconds of Total FETI; several bodies take 1.2
to 1.5 times as many (flange, hub, ball in grooves, 23,000 to 72,000), and stay there. Two parts on
which nothing was tuned take more by multigrid, too: a ribbed plate that lifts off row by row until
nothing touches (40,485 unknowns, 96 iterations instead of 122) 1.30 of the CPU seconds, a hook on
a bar (22,215) 1.33. Boxes take a fifth to a half by Total FETI, whose subdomains share their
factors.

With friction (`contact-app run configs/hub_on_shaft.yaml --set solver.method=primal --set
'contacts.0.friction={coulomb: 0.2}'`, and so on, CPU seconds of whole runs) multigrid takes 0.74
and 0.77 of those of Total FETI on one body beside an obstacle (pillow block, bracket), as many on
a pin in a lug, and 1.9 times as many on two bodies with many rows in contact (hub on a shaft,
bolted flange). Increments of a history share the factors of Total FETI, too. So friction stays
there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from contact_app.scene.scene import Scene
from solver.primal.thin import THIN
from solver.tfeti.options import TotalFetiOptions

LEAST_ALONE, LEAST_OF_SEVERAL = 20_000, 40_000
"""Unknowns of bodies from mesh files, one or several, from which on multigrid is taken."""

COMPRESSIBLE = 0.45
"""Poisson's ratio up to which smoothed aggregation works well."""

LARGEST_THIN = {2: 500_000, 3: 60_000}
"""Unknowns up to which factors of thin scenes are cheap, by dimension."""

PATIENCE = 200
"""Iterations of Total FETI on a thin scene after which the undecomposed problem is solved. Thin
scenes without peeling take 10 to 200 operator applications, and a fifth of the other's time."""


def chosen(scene: Scene) -> Scene:
    """The scene with the method that `auto` stands for, where that is multigrid.

    So it is where all bodies come from mesh files, in space, with as many unknowns as pay for its
    levels; and nothing asks for another method. Several bodies of degree 2 stay with Total FETI.
    """
    if scene.solver.method != "auto" or not _can_be_undecomposed(scene):
        return scene
    bodies = scene.bodies
    unknowns = scene.dimension * sum(body.nodes for body in bodies)
    large = unknowns >= (LEAST_ALONE if len(bodies) == 1 else LEAST_OF_SEVERAL)
    alike = any(body.mesh.congruent for body in bodies)
    pairs_of_degree_2 = len(bodies) > 1 and any(body.degree > 1 for body in bodies)
    soft = any(m.poisson > COMPRESSIBLE for body in bodies for m in body.materials)
    if scene.dimension == 2 or not large or alike or soft or pairs_of_degree_2:
        return scene
    return replace(scene, solver=replace(scene.solver, method="primal"))


def may_peel(scene: Scene) -> bool:
    """Whether `auto` has to reckon with contact that peels off row by row, as of thin bodies."""
    if scene.solver.method != "auto" or not _can_be_undecomposed(scene):
        return False
    unknowns = scene.dimension * sum(body.nodes for body in scene.bodies)
    extents = [np.subtract(body.mesh.upper, body.mesh.lower) for body in scene.bodies]
    thin = any(e.max() >= THIN * e.min() for e in extents)
    return bool(thin and scene.touching and unknowns <= LARGEST_THIN[scene.dimension])


def _can_be_undecomposed(scene: Scene) -> bool:
    """Whether nothing in the scene asks for Total FETI."""
    free = scene.decomposition.subdomains is None
    return free and not scene.has_friction


def is_undecomposed(scene: Scene) -> bool:
    """Whether the scene is solved for the displacements of bodies that are not cut."""
    return scene.solver.method == "primal"


def subdomains_of(scene: Scene, comm: MPI.Intracomm) -> None | int | tuple[int, ...]:
    """Subdomains as `meshes.decompose` takes them.

    A method for undecomposed bodies takes the fewest there can be: one for each body, and one for
    each rank.
    """
    asked = scene.decomposition.subdomains
    if asked is None and is_undecomposed(scene):
        return max(len(scene.bodies), comm.size)
    return asked


def feti_options(scene: Scene) -> TotalFetiOptions | None:
    """Whether subdomains are factored; None for the defaults."""
    return TotalFetiOptions(factored=False) if is_undecomposed(scene) else None
