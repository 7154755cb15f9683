"""Rows that hold rigid motions which nothing else holds.

No load does work on such a motion. It is held at a few nodes; the choice of nodes does not change
stresses. In the answer the motion is zero in the mean (`solver.problem.least_motion`).
"""

import numpy as np

from contact_app.model.equilibrium import body_frame
from contact_app.model.geometry import Geometry
from contact_app.model.rigid import FAINT, NODES, RigidUnknowns
from contact_app.model.surface_copies import SurfaceCopies
from solver.contact.equilibrium import BodyBalance
from solver.rigid_motions import rigid_motions
from solver.tfeti.constraints.supports import SupportRows
from solver.tfeti.subdomain.kernels import fixing_nodes


def support_rows(
    geometry: Geometry, surface: SurfaceCopies, balances: list[BodyBalance]
) -> SupportRows:
    """Rows that hold free motions of each body, on its first subdomain.

    Rows of a rigid body are at its two nodes.
    """
    supports, partition, bodies = SupportRows(), geometry.partition, geometry.bodies
    if partition.comm.rank == partition.comm.size - 1:
        supports = _of_rigid_bodies(RigidUnknowns.of(geometry), surface, balances[len(bodies) :])
    firsts = np.cumsum([0, *partition.subdomains_of_body])[:-1]
    for local, s in enumerate(partition.subdomains):
        if s.number != firsts[s.body]:
            continue
        body, points = bodies[s.body], s.points()[surface.local[local]]
        start = surface.starts[local]
        motions = balances[s.body].free_motions
        if motions.shape[1]:
            chosen = fixing_nodes(points, partition.dimension)
            motions_there = (
                rigid_motions(points[chosen], partition.dimension, *body_frame(body)) @ motions
            )
            basis = np.linalg.qr(motions_there.reshape(-1, motions.shape[1]))[0]
            for row in basis.T:
                supports.add(start + chosen, row.reshape(len(chosen), -1))
    return supports


def _of_rigid_bodies(
    unknowns: RigidUnknowns, surface: SurfaceCopies, balances: list[BodyBalance]
) -> SupportRows:
    """Rows of rigid bodies with their balances; the last rank has the bodies."""
    supports = SupportRows()
    for nth in range(unknowns.count):
        held = unknowns.held(unknowns.moving[nth])[0]
        for motion in balances[nth].free_motions.T:
            values = np.zeros(unknowns.size)
            values[: len(held)] = np.where(held | (np.abs(motion) < FAINT), 0.0, motion)
            copies = len(surface.nodes) + NODES * nth + np.arange(NODES)
            supports.add(copies, values.reshape(NODES, -1))
    return supports
