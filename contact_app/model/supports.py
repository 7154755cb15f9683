"""Rows that hold rigid motions which nothing else holds.

No load does work on such a motion. It is held at a few nodes; the choice of nodes does not change
stresses.
"""

from __future__ import annotations

import numpy as np

from contact_app.model.equilibrium import body_frame
from contact_app.model.rigid import FAINT, NODES, RigidUnknowns
from contact_app.model.surface_copies import SurfaceCopies
from contact_app.scene.scene import Scene
from meshes import Partition
from solver.contact.equilibrium import BodyBalance
from solver.tfeti.constraints.supports import SupportRows
from solver.tfeti.subdomain.kernels import fixing_nodes, rigid_motions


def support_rows(
    scene: Scene, partition: Partition, surface: SurfaceCopies, balances: list[BodyBalance]
) -> SupportRows:
    """Rows that hold free motions of each body, on its first subdomain.

    Rows of a rigid body are at its two nodes.
    """
    supports = _of_rigid_bodies(scene, partition, surface, balances)
    firsts = np.cumsum([0, *partition.subdomains_of_body])[:-1]
    for local, s in enumerate(partition.subdomains):
        if s.number != firsts[s.body]:
            continue
        body, points = scene.bodies[s.body], s.points()[surface.local[local]]
        start = surface.starts[local]
        motions = balances[s.body].free_motions
        if motions.shape[1]:
            chosen = fixing_nodes(points, scene.dimension)
            motions_there = (
                rigid_motions(points[chosen], scene.dimension, *body_frame(body)) @ motions
            )
            basis = np.linalg.qr(motions_there.reshape(-1, motions.shape[1]))[0]
            for row in basis.T:
                supports.add(start + chosen, row.reshape(len(chosen), -1))
    return supports


def _of_rigid_bodies(
    scene: Scene, partition: Partition, surface: SurfaceCopies, balances: list[BodyBalance]
) -> SupportRows:
    """Rows of rigid bodies, on the rank that has the bodies."""
    supports, unknowns = SupportRows(), RigidUnknowns.of(scene, partition)
    if partition.comm.rank < partition.comm.size - 1:
        return supports
    for nth in range(unknowns.count):
        held = unknowns.held(nth)[0]
        for motion in balances[len(scene.bodies) + nth].free_motions.T:
            values = np.zeros(unknowns.size)
            values[: len(held)] = np.where(held | (np.abs(motion) < FAINT), 0.0, motion)
            copies = len(surface.nodes) + NODES * nth + np.arange(NODES)
            supports.add(copies, values.reshape(NODES, -1))
    return supports
