"""Sizes of the loads of a problem without factors.

The inner products of a vector compare load cases. With factors it is d = B K⁺ f - c. B f - c alone
would not do: loads away from contact rows would have no effect. Each load is divided by the root of
the stiffness at its unknown, f_i / √K_ii, and prescribed values are multiplied by the root of the
mean K_ii of elastic bodies, so that all have one unit.
"""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from solver.contact.bodies import Bodies, largest
from solver.problem.subdomains import SubdomainClass
from solver.vectors import Array


def loads_in_energy(
    comm: MPI.Intracomm,
    classes: Sequence[SubdomainClass],
    loads: Sequence[Array],
    prescribed: Array,
) -> Array:
    """The vector (any,) of this rank (collective).

    Parameters
    ----------
    loads : one (n, members) array per class
    prescribed : (k,)
        Right-hand sides of the rows that hold with equality.
    """
    stiffness = [cls.resistance[cls.free] for cls in classes]
    parts = [
        (load[cls.free] / np.sqrt(diagonal)[:, None]).ravel()
        for cls, load, diagonal in zip(classes, loads, stiffness, strict=True)
    ]
    elastic = [diagonal for cls, diagonal in zip(classes, stiffness, strict=True) if not cls.rigid]
    sums = np.array([sum(diagonal.sum() for diagonal in elastic), sum(map(len, elastic))])
    total, count = comm.allreduce(sums)
    return np.concatenate([*parts, prescribed * np.sqrt(total / max(count, 1.0))])


def lengths_at_unknowns(
    bodies: Bodies, classes: Sequence[SubdomainClass], loads: Sequence[Array], comm: MPI.Intracomm
) -> Array:
    """Largest f_i / K_ii of each body, (bodies,) (collective)."""
    result = np.zeros(bodies.count)
    for cls, load, body in zip(classes, loads, bodies.members, strict=True):
        moved = np.abs(load[cls.free] / cls.resistance[cls.free, None])
        np.maximum.at(result, body, moved.max(axis=0, initial=0.0))
    return largest(comm, result)


def pushes_of_rigid_bodies(
    bodies: Bodies, classes: Sequence[SubdomainClass], forces: Sequence[Array], comm: MPI.Intracomm
) -> tuple[Array, Array]:
    """Displacement and a(u, u) of one unknown of each body by forces on rigid bodies (collective).

    F is the largest force, or moment over the length of the scene, on the free unknowns of the
    rigid bodies of a group, and k the mean K_ii of a body in this group.

    Returns
    -------
    F / k and F² / k, (bodies,); zero for rigid bodies.
    """
    force, stiffness, unknowns = np.zeros((3, bodies.count))
    for cls, load, body in zip(classes, forces, bodies.members, strict=True):
        if cls.rigid:
            np.maximum.at(force, body, np.abs(load[cls.free]).max(axis=0, initial=0.0))
        else:
            np.add.at(stiffness, body, cls.resistance.sum())
            np.add.at(unknowns, body, cls.unknowns)
    total, count = comm.allreduce(np.stack([stiffness, unknowns]))
    mean = np.divide(total, count, out=np.full(bodies.count, np.inf), where=count > 0.0)
    force = bodies.by_group(largest(comm, force))[bodies.groups]
    return force / mean, force**2 / mean


def given_motions(bodies: Bodies, lifting: Sequence[Array], comm: MPI.Intracomm) -> Array:
    """The largest prescribed displacement in the group of each body, (bodies,) (collective)."""
    result = np.zeros(bodies.count)
    for lift, body in zip(lifting, bodies.members, strict=True):
        np.maximum.at(result, body, np.abs(lift).max(axis=0, initial=0.0))
    return bodies.by_group(largest(comm, result))[bodies.groups]
