"""The symmetry of each body about a plane: its own mirror image, or that of another body."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contact_app.scene.bodies import Body, Box
from contact_app.scene.scene import Mirror
from meshes.arrays import Array
from meshes.symmetric_half import (
    SAME,
    AsymmetryError,
    HalfSurface,
    box_images,
    half_box,
    half_mesh,
    mesh_images,
)

ROUNDED = 1e-12
"""Relative difference below which two numbers of a scene count as equal."""


@dataclass(frozen=True, eq=False)
class Half:
    """A body of a symmetric scene."""

    body: Body | None
    """The lower half of the body; None if the body is the mirror image of another one."""
    surface: HalfSurface
    """Surface of the half and its mirror image."""
    number: int
    """Number of the body that is solved: the body itself, or the one whose mirror image it is."""


def middle_plane(bodies: Sequence[Body], axis: int) -> Mirror:
    """The middle of all bodies along an axis."""
    ends, size = _ends(bodies, axis), scene_size(bodies)
    at = 0.5 * float(ends[:, 0].min() + ends[:, 1].max())
    for body, middle in zip(bodies, ends.mean(axis=1), strict=True):
        if isinstance(body.mesh, Box) and abs(middle - at) <= SAME * size:
            return Mirror(axis, float(middle))  # a box has it exactly
    return Mirror(axis, at)


def _ends(bodies: Sequence[Body], axis: int) -> Array:
    """Lower and upper end of the bodies along an axis, (bodies, 2)."""
    return np.array([(b.mesh.lower[axis], b.mesh.upper[axis]) for b in bodies])


def scene_size(bodies: Sequence[Body]) -> float:
    """Longest side of the box about all bodies."""
    return max(float(np.ptp([b.mesh.lower, b.mesh.upper], axis=0).max()) for b in bodies)


def halves_about(bodies: Sequence[Body], mirror: Mirror) -> list[Half]:
    """The symmetry of each body about the plane."""
    size = scene_size(bodies)
    middles = _ends(bodies, mirror.axis).mean(axis=1)
    away = middles - mirror.at
    boxes = np.array([isinstance(b.mesh, Box) for b in bodies])
    tolerance = np.where(boxes, ROUNDED * max(size, *np.abs(middles)), SAME * size)
    halves: dict[int, Half] = {}
    for k in np.flatnonzero(np.abs(away) <= tolerance):
        half, surface = _half(bodies[k], mirror)
        halves[int(k)] = Half(half, surface, int(k))
    for k in np.flatnonzero(away < -tolerance):
        image = _image(bodies, int(k), mirror, set(halves))
        surfaces = _surfaces(bodies[k], bodies[image], mirror, size)
        halves[int(k)] = Half(bodies[k], surfaces[0], int(k))
        halves[image] = Half(None, surfaces[1], int(k))
    for k in range(len(bodies)):
        if k not in halves:
            raise _without_image(bodies[k], mirror)
    return [halves[k] for k in range(len(bodies))]


def _without_image(body: Body, mirror: Mirror) -> AsymmetryError:
    return AsymmetryError(
        f"{body.name} is off the middle of all bodies, {'xyz'[mirror.axis]} = {mirror.at:g}, and "
        "no other is its image"
    )


def _image(bodies: Sequence[Body], number: int, mirror: Mirror, used: set[int]) -> int:
    """The body at the place of the mirror image of a body."""
    body, size = bodies[number], scene_size(bodies)
    corners = np.array([body.mesh.lower, body.mesh.upper])
    corners[:, mirror.axis] = 2.0 * mirror.at - corners[::-1, mirror.axis]
    for k, other in enumerate(bodies):
        ends = np.array([other.mesh.lower, other.mesh.upper])
        near = np.abs(corners - ends).max() <= SAME * size
        if near and k not in used and isinstance(other.mesh, Box) == isinstance(body.mesh, Box):
            return k
    raise _without_image(body, mirror)


def _surfaces(
    body: Body, other: Body, mirror: Mirror, size: float
) -> tuple[HalfSurface, HalfSurface]:
    """The surfaces of a body and of its mirror image, another body."""
    mesh, image, name = body.mesh, other.mesh, f"{body.name} and {other.name}"
    if mesh.upper[mirror.axis] > mirror.at - SAME * size:
        raise AsymmetryError(f"{name} meet at their plane of symmetry")
    if body.degree != other.degree:
        raise AsymmetryError(f"{name} are of different degree")
    materials = [*body.materials, *other.materials]
    kinds = tuple(np.array([materials.index(m) for m in b.materials]) for b in (body, other))
    if isinstance(mesh, Box) and isinstance(image, Box):
        if (mesh.cells, mesh.cell) != (image.cells, image.cell):
            raise AsymmetryError(f"{name} have different cells")
        if kinds[0] != kinds[1]:
            raise AsymmetryError(f"{name} are of different materials")
        return box_images(mesh.shape(body.degree), image.shape(body.degree), mirror.axis)
    try:
        return mesh_images(
            mesh.shape(1), image.shape(1), body.degree, (kinds[0], kinds[1]), mirror.axis, mirror.at
        )
    except AsymmetryError as why:
        raise AsymmetryError(f"{body.name} {why}") from None


def _half(body: Body, mirror: Mirror) -> tuple[Body, HalfSurface]:
    """The lower half of a body, and its surface."""
    mesh, axis, at = body.mesh, mirror.axis, mirror.at
    try:
        if isinstance(mesh, Box):
            surface = half_box(mesh.shape(body.degree), axis)
            upper, cells = list(mesh.upper), list(mesh.cells)
            upper[axis], cells[axis] = at, cells[axis] // 2
            cut = f"{'xyz'[axis]}+"
            half: Any = replace(mesh, upper=tuple(upper), cells=tuple(cells))
        else:
            cut = f"cut across {'xyz'[axis]}"
            while cut in (*mesh.boundaries, *body.boundaries):
                cut += "'"
            numbers = np.array([body.materials.index(m) for m in body.materials])
            half, surface = half_mesh(mesh.shape(1), body.degree, numbers, axis, at, cut)
    except AsymmetryError as why:
        raise AsymmetryError(f"{body.name} {why}") from None
    return replace(body, mesh=half, cuts=(*body.cuts, cut)), surface
