"""Completion of a scene that was solved on one side of its planes of symmetry.

Each subset of the planes gives one mirror image of the solved part. Nodes on a plane are their own
image and get no second number: the whole is one mesh, as if it had not been cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.geometry import Geometry
from contact_app.model.planes import on_planes, subsets
from contact_app.results.fields import NodeFields
from contact_app.scene.obstacles import SHAPES
from contact_app.scene.scene import Mirror
from meshes.arrays import Array, Ints, Mask
from meshes.quadratic import node_vertices

SHEARS = {0: (3, 5), 1: (3, 4), 2: (4, 5)}
"""Components of a stress xx, yy, zz, xy, yz, xz that change their sign across an axis."""

REVERSED = {
    "triangle": (0, 2, 1),
    "quadrilateral": (0, 3, 2, 1),
    "tetrahedron": (0, 2, 1, 3),
    "hexahedron": (0, 3, 2, 1, 4, 7, 6, 5),
}
"""Vertices of a mirrored cell in the order of a cell, which a mirror turns inside out."""


@dataclass(frozen=True, eq=False)
class Image:
    """A mirror image of the solved part about some of the planes."""

    mirrors: tuple[Mirror, ...]
    """The planes; none for the solved part itself."""
    numbers: Ints  # (nodes,)
    """Number in the whole of each node that this rank owns."""
    new: Mask  # (nodes,)
    """Mask of the nodes that are not nodes of an earlier image, too."""
    first: int
    """Number of this rank's first new node."""

    def origin(self, source: str) -> str:
        """Source in the solved part whose mirror image this source of the whole is."""
        for mirror in self.mirrors:
            source = dict(mirror.partners).get(source, source)
        return source

    def points(self, points: Array) -> Array:
        """Coordinates (n, 3) of the images of points."""
        for mirror in self.mirrors:
            points = mirror.image(points)
        return points

    def field(self, name: str, values: Array) -> Array:
        """Values of a field in the image; displacements and stresses are reflected."""
        values = values.copy()
        for mirror in self.mirrors:
            if name == "displacement":
                values[:, mirror.axis] *= -1.0
            elif name == "stress" or name.startswith("nodal_stress"):
                values[:, SHEARS[mirror.axis]] *= -1.0
        return values

    def cells(self, cells: NDArray[Any], cell: str, degree: int) -> NDArray[Any]:
        """Cells (n, nodes) in VTK's order, with positive volume again."""
        odd = len(self.mirrors) % 2
        return cells[:, _turned(cell, degree)] if odd else cells


@dataclass(frozen=True, eq=False)
class FullMesh:
    """All mirror images of the solved part; the part itself comes first."""

    images: tuple[Image, ...]
    nodes: int
    cells: int
    """Numbers of nodes and cells of the whole."""
    weight: Ints  # (nodes,)
    """Number of nodes of the whole for each node that this rank owns."""


def full_mesh(geometry: Geometry, nodes: NodeFields) -> FullMesh:
    """Number the nodes of the whole (collective)."""
    comm, mirrors = geometry.comm, geometry.mirrors
    on = on_planes(geometry.bodies, geometry.mirrors, nodes.points)
    images: dict[tuple[int, ...], Image] = {}
    total = 0
    for subset in subsets(len(mirrors)):
        new = ~on[list(subset)].any(axis=0)
        count = int(new.sum())
        first = total + (comm.exscan(count) or 0)
        numbers = np.empty(len(new), np.int64)
        numbers[new] = first + np.arange(count)
        for k in subset:  # a node on a plane is where it is without that plane
            smaller = images[tuple(i for i in subset if i != k)]
            numbers[on[k]] = smaller.numbers[on[k]]
        chosen = tuple(mirrors[k] for k in subset)
        images[subset] = Image(chosen, numbers, new, first)
        total += comm.allreduce(count, op=MPI.SUM)
    weight = np.sum([image.new for image in images.values()], axis=0)
    cells = geometry.partition.cells * len(images)
    return FullMesh(tuple(images.values()), total, cells, weight)


@cache
def _turned(cell: str, degree: int) -> list[int]:
    """Nodes of a mirrored cell in the order of a cell."""
    vertices = REVERSED[cell]
    if degree == 1:
        return list(vertices)
    nodes = [frozenset(on) for on in node_vertices(cell)]
    return [nodes.index(frozenset(vertices[v] for v in on)) for on in nodes]


def whole_summary(summary: dict[str, Any], geometry: Geometry, nodes: NodeFields) -> dict[str, Any]:
    """`summary.json` of the whole, from that of the solved part (collective).

    `decomposition` and `active_contacts` are those of the solved part.
    """
    comm, d, whole = geometry.comm, geometry.dimension, full_mesh(geometry, nodes)
    copies = len(whole.images)
    magnitude = np.linalg.norm(nodes.displacement, axis=1)
    mean = comm.allreduce(float(whole.weight @ magnitude)) / whole.nodes
    factor = np.full(3, float(copies))
    factor[[m.axis for m in geometry.mirrors]] = 0.0
    solution = {
        **summary["solution"],
        "energy": copies * summary["solution"]["energy"],
        "mean_displacement": mean,
        "contact_force": _times(summary["solution"]["contact_force"], factor),
        "pair_forces": _pair_forces(summary["solution"]["pair_forces"], geometry.mirrors),
    }
    planes = [f"{'xyz'[m.axis]} = {m.at:g}" for m in geometry.mirrors]
    return {
        **summary,
        "mesh": {"cells": whole.cells, "nodes": whole.nodes, "dofs": whole.nodes * d},
        "solution": solution,
        "symmetry": {"planes": planes, "images": copies, "solved": summary["mesh"]},
    }


def _pair_forces(
    forces: dict[str, list[float]], mirrors: Sequence[Mirror]
) -> dict[str, list[float]]:
    """Forces between the whole bodies, by pair, from those of the solved part."""
    sums = {pair: np.array(force) for pair, force in forces.items()}
    pairs = {c.source for c in mirrors[0].contacts if c.against not in SHAPES}
    for mirror in reversed(mirrors):
        partners = {a: b for a, b in mirror.partners if a in pairs}
        turn = np.ones(3)
        turn[mirror.axis] = -1.0
        none = np.zeros(3)
        sums = {
            pair: sums.get(pair, none) + turn * sums.get(partners.get(pair, pair), none)
            for pair in {**sums, **partners}
        }
    order = sorted(sums, key=lambda pair: (len(pair), pair))
    return {pair: [float(v) for v in sums[pair]] for pair in order}


def _times(force: list[float], factor: Array) -> list[float]:
    return [float(v) for v in np.array(force) * factor]
