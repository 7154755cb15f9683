"""Probes: points at which the displacement is written, located in cells before the solve."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.model.geometry import Geometry
from contact_app.model.planes import subsets
from contact_app.scene.conditions import Tie
from contact_app.scene.scene import Mirror
from meshes import Reference, Subdomain
from meshes.arrays import Array, Ints
from meshes.crossing import Boxes
from meshes.point_location import locate_in

OUTSIDE = 1e-6
"""Distance from a cell, over its size, up to which a point belongs to it."""

ROOM = 0.1
"""Margin around nodes for the search of a point, over the size of cell or subdomain."""


@dataclass(frozen=True, eq=False)
class Probe:
    """A point in a cell of this rank."""

    name: str
    subdomain: int | None
    """Number of its subdomain on this rank; None if another rank has it."""
    nodes: Ints
    shares: Array
    """Nodes of the cell in the subdomain, and their shape functions at the point. Shape (n,)."""
    mirrors: tuple[Mirror, ...]
    """Planes of symmetry between the point and the part that is solved."""
    bodies: tuple[int, ...] = ()
    """Bodies at the point, on all ranks; the probe is in the first one."""


def locate_probes(
    geometry: Geometry, probes: Sequence[tuple[str, tuple[float, float, float]]]
) -> tuple[Probe, ...]:
    """The cells of probes with names and points (collective).

    Raises
    ------
    ConfigurationError
        A point lies in no body.
    """
    return tuple(_located(geometry, name, np.array(point)) for name, point in probes)


def _located(geometry: Geometry, name: str, point: Array) -> Probe:
    """The cell of a point and its shares at the nodes of this cell; empty on other ranks."""
    comm, d, here_are = geometry.comm, geometry.dimension, set[int]()
    best, probe = (np.inf, -1), Probe(name, None, np.zeros(0, np.int64), np.zeros(0), ())
    for subset in subsets(len(geometry.mirrors)):
        mirrors = tuple(geometry.mirrors[k] for k in subset)
        here = point[None]
        for mirror in mirrors:
            here = mirror.image(here)
        for number, subdomain in enumerate(geometry.partition.subdomains):
            outside, nodes, shares = in_cell(subdomain, here[0], d)
            if outside <= OUTSIDE:
                here_are.add(subdomain.body)
                outside = 0.0
            if (outside, subdomain.body) < best:
                best = outside, subdomain.body
                probe = Probe(name, number, nodes, shares, mirrors)
    (least, _), rank = comm.allreduce((best, comm.rank), op=MPI.MIN)
    if least > OUTSIDE:
        place = ", ".join(f"{v:g}" for v in point[:d])
        raise ConfigurationError(
            f"{geometry.at('output')}.probes.{name}: the point ({place}) lies in no body"
        )
    if rank != comm.rank:
        probe = Probe(name, None, np.zeros(0, np.int64), np.zeros(0), ())
    return replace(probe, bodies=tuple(sorted(set[int]().union(*comm.allgather(here_are)))))


def shared_probes(geometry: Geometry, probes: Sequence[Probe]) -> list[str]:
    """A sentence for each probe at which bodies meet that no tie joins."""
    tied = [{tie.body, tie.other} for tie in geometry.ties if isinstance(tie, Tie)]
    return [
        f"{geometry.at('output')}.probes.{probe.name}: "
        f"{' and '.join(geometry.bodies[b].name for b in probe.bodies)} meet at this point: the "
        f"displacement is that of {geometry.bodies[probe.bodies[0]].name}; move the point into a "
        "body to choose it"
        for probe in probes
        if len(probe.bodies) > 1 and set(probe.bodies) not in tied
    ]


def in_cell(subdomain: Subdomain, point: Array, d: int) -> tuple[float, Ints, Array]:
    """Distance of the point from the nearest cell, over its size.

    Nodes and shape functions there.
    """
    reference = subdomain.reference
    here = (point - subdomain.translation)[None]
    room = ROOM * np.ptp(reference.points, axis=0).max()
    lower, upper = reference.points.min(axis=0) - room, reference.points.max(axis=0) + room
    best = np.inf, np.zeros(0, np.int64), np.zeros(0)
    if not ((here >= lower) & (here <= upper)).all():
        return best
    for cell in _near(reference, here[0]):
        try:
            place = locate_in(reference, np.array([cell]), here, d)
        except np.linalg.LinAlgError:  # Newton's method left a cell that does not contain the point
            continue
        nodes = place.nodes[0].astype(np.int64)
        distance = place.distance[0] / np.ptp(reference.points[nodes], axis=0).max()
        if distance < best[0]:
            best = float(distance), nodes, place.shares[0]
    return best


def _near(reference: Reference, point: Array) -> Ints:
    """Cells with the point near their nodes; curved edges may reach beyond the nodes."""
    boxes = Boxes.of(reference.points, reference.cells)
    room = ROOM * (boxes.upper - boxes.lower)
    return np.flatnonzero(
        ((point >= boxes.lower - room) & (point <= boxes.upper + room)).all(axis=1)
    )
