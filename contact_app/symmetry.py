"""Half the scene where the other half is its mirror image.

With `symmetry: allow`, a scene whose meshes, loads, conditions and obstacles mirror about a plane
across an axis, midway through every body, is modelled on the lower side of that plane alone: its
cut face keeps the displacement across the plane at zero. The answer of the whole is the mirrored
half: the energy of a scene is convex, so if u is a minimiser, so is the mean of u and its mirror
image. Planes across several axes make a quarter or an eighth.

Only boxes of quadrilaterals and hexahedra with an even number of cells are looked at: triangles and
tetrahedra cut their cells along diagonals that no mirror keeps. Each body has to be its own mirror
image. What stands in the way along an axis is told.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.obstacles import Cylinder, Obstacle, Plane, Sphere
from contact_app.scene import (
    Body,
    BodyContact,
    BodyForce,
    Box,
    Contact,
    Decomposition,
    DisplacementCondition,
    Mirror,
    Pressure,
    Scene,
    Traction,
)

ALIKE = 1e-12
"""Relative difference below which two numbers of a scene are the same."""

Item = DisplacementCondition | Traction | Pressure | BodyForce | Contact | BodyContact


@dataclass(frozen=True)
class Halving:
    """A scene cut at its planes of symmetry.

    Attributes
    ----------
    scene
        What is left to model; its `mirrors` are the planes.
    notes
        Where it was cut, and why not elsewhere, a sentence an axis.
    """

    scene: Scene
    notes: tuple[str, ...]


def halved(scene: Scene) -> Halving:
    """Cut a scene at each plane it mirrors about."""
    notes = []
    for axis in range(scene.dimension):
        why, name = _asymmetry(scene, axis), "xyz"[axis]
        if why:
            notes.append(f"symmetry: none across {name}: {why}")
        else:
            scene = _cut(scene, axis)
            at = scene.mirrors[-1].at
            notes.append(
                f"symmetry: everything mirrors about {name} = {at:g}: what lies above is left out "
                "of the solve and written as the image of what lies below"
            )
    return Halving(scene, tuple(notes))


def _asymmetry(scene: Scene, axis: int) -> str:
    """Why a scene does not mirror about the middle of an axis; empty where it does."""
    middles = []
    for body in scene.bodies:
        mesh = body.mesh
        if not isinstance(mesh, Box):
            return f"the mesh of {body.name} is no box"
        if mesh.cell not in ("quadrilateral", "hexahedron"):
            return f"the diagonals of {body.name}'s {mesh.cell}s have no mirror image"
        if mesh.cells[axis] % 2:
            return f"{body.name} has an odd number of cells, {mesh.cells[axis]}"
        middles.append(0.5 * (mesh.lower[axis] + mesh.upper[axis]))
    size = max(float(np.ptp([b.mesh.lower, b.mesh.upper], axis=0).max()) for b in scene.bodies)
    if np.ptp(middles) > ALIKE * max(size, *map(abs, middles)):
        return "the bodies have different middles"
    mirror = Mirror(axis, middles[0])
    items = _items(scene)
    used = {(i.body, i.boundary) for i in items if not isinstance(i, BodyForce)}
    used |= {(i.other, i.other_boundary) for i in items if isinstance(i, BodyContact)}
    for number, boundary in sorted(used):
        body = scene.bodies[number]
        if boundary in body.boundaries:
            why = _boundary_asymmetry(body, boundary, mirror)
            if why:
                return f"{body.name}.{boundary} {why}"
    known = [_described(item, size) for item in items]
    for item in items:
        image = _described(item, size, mirror)
        if not any(_alike(image, other) for other in known):
            return f"{item.source} has no mirror image"
    return ""


def _items(scene: Scene) -> list[Item]:
    """Everything that acts on the bodies."""
    return [
        *scene.displacements, *scene.tractions, *scene.pressures, *scene.forces, *scene.contacts,
        *scene.pairs,
    ]  # fmt: skip


def _boundary_asymmetry(body: Body, name: str, mirror: Mirror) -> str:
    """What keeps a boundary given by an expression from being its own mirror image."""
    inside = body.boundaries[name]
    points = _surface_points(body)
    image = points.copy()
    image[:, mirror.axis] = 2.0 * mirror.at - image[:, mirror.axis]
    if (inside(points) != inside(image)).any():
        return "has no mirror image"
    cut = _lattice(body)
    cut[mirror.axis] = np.array([mirror.at])
    on = inside(_grid(cut)).reshape([len(a) for a in cut])
    inner, facets = on, on
    for axis in set(range(len(body.mesh.lower))) - {mirror.axis}:
        inner = np.take(inner, range(1, inner.shape[axis] - 1), axis)
        facets = np.take(facets, range(0, facets.shape[axis], body.degree), axis)
        facets = np.logical_and(*(np.delete(facets, end, axis) for end in (0, -1)))
    if inner.any() or facets.any():
        return "reaches into the body, where it would be cut"
    return ""


def _lattice(body: Body) -> list[NDArray[np.float64]]:
    """Coordinates of the nodes of a box along each axis; in the plane z is zero."""
    mesh = body.mesh
    assert isinstance(mesh, Box)
    axes = [
        np.linspace(a, b, body.degree * n + 1)
        for a, b, n in zip(mesh.lower, mesh.upper, mesh.cells, strict=True)
    ]
    return axes + [np.zeros(1)] * (3 - len(axes))


def _surface_points(body: Body) -> NDArray[np.float64]:
    """Nodes on the faces of a box (n, 3), those of edges more than once."""
    faces = []
    for axis, end in itertools.product(range(len(body.mesh.lower)), (0, -1)):
        lattice = _lattice(body)
        lattice[axis] = lattice[axis][[end]]
        faces.append(_grid(lattice))
    return np.concatenate(faces)


def _grid(axes: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _described(
    item: Item, size: float, mirror: Mirror | None = None
) -> tuple[tuple[Any, ...], NDArray[np.float64]]:
    """What an item is, or its mirror image: words, and numbers of order one to compare."""
    kind = type(item).__name__
    if isinstance(item, BodyForce):
        return (kind, item.body), _scaled(_reflected(item.vector, mirror))
    where: tuple[Any, ...] = (kind, item.body, _face(item.boundary, mirror))
    if isinstance(item, DisplacementCondition):
        free = tuple(v is None for v in item.values)
        values = _reflected([v or 0.0 for v in item.values], mirror)
        return (*where, free), _scaled(values)
    if isinstance(item, Traction):
        return where, _scaled(_reflected(item.vector, mirror))
    if isinstance(item, Pressure):
        return where, _scaled(np.array([item.value]))
    if isinstance(item, BodyContact):
        return (*where, item.other, _face(item.other_boundary, mirror)), np.zeros(0)
    words, numbers = _described_obstacle(item.obstacle, size, mirror)
    return (*where, *words), numbers


def _face(boundary: str, mirror: Mirror | None) -> str:
    """The face of a box opposite along the axis; other boundaries are their own image."""
    if mirror is None or boundary[:-1] != "xyz"[mirror.axis] or boundary[-1] not in "-+":
        return boundary
    return boundary[:-1] + ("+" if boundary[-1] == "-" else "-")


def _reflected(vector: Iterable[float], mirror: Mirror | None) -> NDArray[np.float64]:
    """A vector, or its image."""
    image = np.array(list(vector), float)
    if mirror is not None:
        image[mirror.axis] *= -1.0
    return image


def _scaled(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Size and direction: numbers that are compared relative to the size."""
    size = float(np.abs(vector).max(initial=0.0))
    return np.array([np.log(size) if size else -np.inf, *(vector / (size or 1.0))])


def _described_obstacle(
    obstacle: Obstacle, size: float, mirror: Mirror | None
) -> tuple[tuple[Any, ...], NDArray[np.float64]]:
    """Kind and numbers that are equal for equal obstacles, lengths over a size of the scene."""

    def point(values: Iterable[float]) -> NDArray[np.float64]:
        image = np.array(list(values), float)
        if mirror is not None:
            image[mirror.axis] = 2.0 * mirror.at - image[mirror.axis]
        return image

    if isinstance(obstacle, Plane):
        normal = _reflected(obstacle.normal, mirror)
        normal /= np.linalg.norm(normal)
        return ("plane",), np.append(normal, point(obstacle.point) @ normal / size)
    if isinstance(obstacle, Sphere):
        words = ("sphere", obstacle.hollow)
        return words, np.append(point(obstacle.center), obstacle.radius) / size
    assert isinstance(obstacle, Cylinder), f"no mirror image of {obstacle} is known"
    along = _reflected(obstacle.axis, mirror)
    along /= np.linalg.norm(along) * np.sign(along[np.argmax(np.abs(along) > ALIKE)])
    foot = point(obstacle.point)
    foot -= (foot @ along) * along
    return ("cylinder", obstacle.hollow), np.array([*along, *foot / size, obstacle.radius / size])


def _alike(a: tuple[tuple[Any, ...], Any], b: tuple[tuple[Any, ...], Any]) -> bool:
    return a[0] == b[0] and np.allclose(a[1], b[1], rtol=ALIKE, atol=ALIKE)


def _cut(scene: Scene, axis: int) -> Scene:
    """The lower side of the middle of an axis."""
    name, bodies = "xyz"[axis], []
    for body in scene.bodies:
        mesh = body.mesh
        assert isinstance(mesh, Box)
        at = 0.5 * (mesh.lower[axis] + mesh.upper[axis])
        upper, cells = list(mesh.upper), list(mesh.cells)
        upper[axis], cells[axis] = at, cells[axis] // 2
        bodies.append(replace(body, mesh=replace(mesh, upper=tuple(upper), cells=tuple(cells))))
    held = tuple(0.0 if a == axis else None for a in range(scene.dimension))
    cut = f"{name}+"
    planes = [
        DisplacementCondition(number, cut, held, f"symmetry across {name}")
        for number in range(len(bodies))
    ]

    def kept(items: Iterable[Any]) -> tuple[Any, ...]:
        return tuple(i for i in items if i.boundary != cut)

    parts = scene.decomposition.subdomains  # of what is solved, as far as it has cells
    if isinstance(parts, int):
        parts = min(parts, sum(b.mesh.total_cells for b in bodies))
    elif parts is not None:
        most = min(b.mesh.cells[axis] for b in bodies)  # type: ignore[attr-defined]
        parts = tuple(min(p, most) if a == axis else p for a, p in enumerate(parts))
    return replace(
        scene,
        bodies=tuple(bodies),
        displacements=(*kept(scene.displacements), *planes),
        tractions=kept(scene.tractions),
        pressures=kept(scene.pressures),
        contacts=kept(scene.contacts),
        pairs=kept(scene.pairs),
        decomposition=Decomposition(parts),
        mirrors=(*scene.mirrors, Mirror(axis, at)),
    )
