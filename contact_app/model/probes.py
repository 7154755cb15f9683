"""Probes: points at which the displacement is asked for, found in their cells before the solve."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.errors import ConfigurationError
from contact_app.scene.scene import Mirror, Scene
from meshes import Partition, Subdomain
from meshes.quadratic import VERTICES
from meshes.subdomains import vtk_places, vtk_shapes

Array = NDArray[np.float64]

OUTSIDE = 1e-6
"""Distance from the reference cell up to which a point belongs to it, over the cell's size."""


@dataclass(frozen=True, eq=False)
class Probe:
    """A point in a cell of this rank.

    Attributes
    ----------
    subdomain
        Place of its subdomain among those of this rank; None where another rank has it.
    nodes, shares : (n,)
        Nodes of the cell in the subdomain, and their shape functions at the point.
    mirrors
        Planes across which the point lies from what is solved.
    """

    name: str
    subdomain: int | None
    nodes: NDArray[np.int64]
    shares: Array
    mirrors: tuple[Mirror, ...]


def locate_probes(scene: Scene, partition: Partition) -> tuple[Probe, ...]:
    """The cells of all probes (collective).

    Raises
    ------
    ConfigurationError
        A point lies in no body.
    """
    return tuple(
        _located(scene, partition, name, np.array(point)) for name, point in scene.output.probes
    )


def _located(scene: Scene, partition: Partition, name: str, point: Array) -> Probe:
    comm = partition.comm
    best, found = np.inf, Probe(name, None, np.zeros(0, np.int64), np.zeros(0), ())
    for mirrors in _subsets(scene.mirrors):
        here = point[None]
        for mirror in mirrors:
            here = mirror.image(here)
        for number, subdomain in enumerate(partition.subdomains):
            outside, nodes, shares = _in_cell(subdomain, here[0], scene.dimension)
            if outside < best - OUTSIDE:
                best, found = outside, Probe(name, number, nodes, shares, mirrors)
    least, rank = comm.allreduce((best, comm.rank), op=MPI.MIN)
    if least > OUTSIDE:
        place = ", ".join(f"{v:g}" for v in point[: scene.dimension])
        raise ConfigurationError(
            f"{scene.at('output')}.probes.{name}: the point ({place}) lies in no body"
        )
    if rank != comm.rank:
        return Probe(name, None, np.zeros(0, np.int64), np.zeros(0), ())
    return found


def _subsets(mirrors: tuple[Mirror, ...]) -> list[tuple[Mirror, ...]]:
    return [some for size in range(len(mirrors) + 1) for some in combinations(mirrors, size)]


def _in_cell(subdomain: Subdomain, point: Array, d: int) -> tuple[float, NDArray[np.int64], Array]:
    """How far the point is outside of the nearest cell, over its size; its nodes and shares."""
    reference, points = subdomain.reference, subdomain.points()
    none = np.inf, np.zeros(0, np.int64), np.zeros(0)
    room = 0.1 * np.ptp(points, axis=0).max()
    if ((point < points.min(axis=0) - room) | (point > points.max(axis=0) + room)).any():
        return none
    corners = points[reference.cells][..., :d]
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    slack = (
        0.1 * (upper - lower)
        if reference.curved
        else OUTSIDE * (upper - lower).max(axis=1)[:, None]
    )
    near = np.flatnonzero(((point[:d] >= lower - slack) & (point[:d] <= upper + slack)).all(axis=1))
    if not len(near):
        return none
    cell = reference.cell
    count = reference.cells.shape[1] if reference.curved else VERTICES[cell]
    degree = 2 if reference.curved else 1
    nodes = corners[near][:, :count]
    places = vtk_places(cell, degree, nodes, np.broadcast_to(point[:d], (len(near), d)))
    if cell in ("triangle", "tetrahedron"):
        outside = np.maximum(-places.min(axis=1), places.sum(axis=1) - 1.0)
    else:
        outside = np.abs(places - 0.5).max(axis=1) - 0.5
    outside = np.maximum(np.where(np.isfinite(outside), outside, np.inf), 0.0)
    nearest = int(np.argmin(outside))
    own = reference.cells[near[nearest]].astype(np.int64)
    shares = vtk_shapes(cell, reference.degree, places[nearest][None])[0][0]
    return float(outside[nearest]), own, shares
