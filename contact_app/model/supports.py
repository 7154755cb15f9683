"""Rows that hold rigid motions which nothing else holds and no load works on."""

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
    """Rows that hold free motions at a few nodes of each body's first subdomain.

    Those of a rigid body are at the nodes that stand for it.
    """
    supports = _of_rigid_bodies(scene, partition, surface, balances)
    firsts = np.cumsum([0, *partition.subdomains_of_body])[:-1]
    for local, s in enumerate(partition.subdomains):
        motions = balances[s.body].free_motions
        if s.number != firsts[s.body] or motions.shape[1] == 0:
            continue
        points = s.points()[surface.local[local]]
        chosen = fixing_nodes(points, scene.dimension)
        frame = body_frame(scene.bodies[s.body])
        seen = rigid_motions(points[chosen], scene.dimension, *frame) @ motions
        basis = np.linalg.qr(seen.reshape(-1, motions.shape[1]))[0]
        for row in basis.T:
            supports.copies.append(surface.starts[local] + chosen)
            supports.values.append(row.reshape(len(chosen), -1))
    return supports


def _of_rigid_bodies(
    scene: Scene, partition: Partition, surface: SurfaceCopies, balances: list[BodyBalance]
) -> SupportRows:
    """On the rank that has them."""
    supports, unknowns = SupportRows(), RigidUnknowns.of(scene, partition)
    if partition.comm.rank < partition.comm.size - 1:
        return supports
    for nth in range(unknowns.count):
        held = unknowns.held(nth)[0]
        for motion in balances[len(scene.bodies) + nth].free_motions.T:
            values = np.zeros(unknowns.size)
            values[unknowns.slots] = np.where(held | (np.abs(motion) < FAINT), 0.0, motion)
            supports.copies.append(len(surface.nodes) + NODES * nth + np.arange(NODES))
            supports.values.append(values.reshape(NODES, -1))
    return supports
