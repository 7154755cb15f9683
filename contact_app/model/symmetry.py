"""Half the scene where the other half is its mirror image.

With `symmetry: allow`, a scene whose meshes, loads, conditions and obstacles mirror about a plane
across an axis, midway through every body, is modelled on the lower side of that plane alone: its
cut face keeps the displacement across the plane at zero. The answer of the whole is the mirrored
half: the energy of a scene is convex, so if u is a minimiser, so is the mean of u and its mirror
image. Planes across several axes make a quarter or an eighth.

Each body has to be its own mirror image, or that of another body, which is then left out: a box by
its cells, a mesh from a file node by node and cell by cell (`meshes.symmetric_half`). Boundaries
mirror where their nodes and facets do: what acts on one needs a counterpart on its image, whatever
the two are called. What stands in the way along an axis is told.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from hashlib import sha1
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.scene.bodies import Body, Box
from contact_app.scene.conditions import (
    BodyContact,
    BodyForce,
    Contact,
    DisplacementCondition,
    Pressure,
    Temperature,
    Traction,
)
from contact_app.scene.obstacles import Cylinder, Obstacle, Plane, Sphere
from contact_app.scene.scene import Decomposition, Mirror, Scene
from meshes.symmetric_half import (
    SAME,
    AsymmetryError,
    HalfSurface,
    box_images,
    half_box,
    half_mesh,
    mesh_images,
)

ALIKE = 1e-12
"""Relative difference below which two numbers of a scene are the same."""

SAMPLES = {2: 32, 3: 8}
"""Points along the edge of a facet at which expressions are compared where meshes are refined."""

Bools = NDArray[np.bool_]
Item = DisplacementCondition | Traction | Pressure | BodyForce | Contact | BodyContact
Key = tuple[Any, ...]
Description = tuple[Key, NDArray[np.float64]]


AT_CUT = "symmetry across"
"""Source of the conditions that hold what is solved at a cut, before the name of the axis."""


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


@dataclass(frozen=True, eq=False)
class _Half:
    """What a body is in a symmetric scene.

    Attributes
    ----------
    body
        What is left of it; None where it is left out as the image of another body.
    surface
        Beside its image.
    kept
        Number of the body that is kept: its own, or that of which it is the image.
    """

    body: Body | None
    surface: HalfSurface
    kept: int


@dataclass(frozen=True, eq=False)
class _Part:
    """A boundary of a symmetric body, on the surface of its lower half and of the image of it.

    Attributes
    ----------
    nodes, facets : (2, nodes), (2, facets)
        Which belong to it in the half, and whose images do.
    beside : (nodes,)
        Nodes that do not lie on the plane.
    samples : (2, points)
        Whether further points are inside an expression.
    """

    nodes: Bools
    facets: Bools
    beside: Bools
    samples: Bools

    def key(self, image: bool = False) -> Key:
        """What equals the key of another boundary if both are one; or that of its image."""
        order = slice(None, None, -1) if image else slice(None)
        parts = [np.packbits(m[order], axis=1) for m in (self.nodes, self.facets, self.samples)]
        return tuple(sha1(p.tobytes(), usedforsecurity=False).digest() for p in parts)

    def kept(self, by_facets: bool) -> bool:
        """Whether what acts here acts on the half, too, or else is an image of what does."""
        here, there = (self.facets if by_facets else self.nodes & self.beside).any(axis=1)
        return bool(here or not there)


def halved(scene: Scene) -> Halving:
    """Cut a scene at each plane it mirrors about."""
    notes = []
    for axis in range(scene.dimension):
        name, before = "xyz"[axis], [body.name for body in scene.bodies]
        try:
            scene = _cut(scene, axis)
        except AsymmetryError as why:
            notes.append(f"symmetry: none across {name}: {why}")
            continue
        at = scene.mirrors[-1].at
        notes.append(
            f"symmetry: the scene is symmetric about {name} = {at:g}: the part below is solved, "
            "and the part above is written as its mirror image"
        )
        left = {body.name for body in scene.bodies}
        notes += [
            f"symmetry: {body} is the mirror image of another body and is not solved"
            for body in before
            if body not in left
        ]
    if scene.mirrors:
        notes += [
            f"symmetry: the {body.mesh.cell}s of {body.name} are made in the part that is solved; "
            "those of the other part are their mirror images"
            for body in scene.bodies
            if isinstance(body.mesh, Box) and body.mesh.cell in ("triangle", "tetrahedron")
        ]
    return Halving(scene, tuple(notes))


def _refuse_whole(scene: Scene) -> None:
    """Raise where a scene has what acts on whole bodies or boundaries only."""
    if scene.total_loads:
        raise AsymmetryError(
            f"{scene.total_loads[0].source} is a total force or moment on a whole boundary"
        )
    if scene.rigid_bodies:
        raise AsymmetryError(f"{scene.rigid_bodies[0].name} is rigid")
    if scene.ties:
        raise AsymmetryError(f"{scene.ties[0].source} is tied")
    for body in scene.bodies:
        if body.hold:
            raise AsymmetryError(f"{body.name} has rigid motions that are held on request")
    rough = [contact for contact in scene.touching if contact.friction is not None]
    if rough:
        raise AsymmetryError(f"{rough[0].source} has friction")


def _cut(scene: Scene, axis: int) -> Scene:
    """The lower side of the middle of an axis; raises where the scene does not mirror about it."""
    _refuse_whole(scene)
    mirror = _plane(scene, axis)
    halves = _halves(scene, mirror)
    left = [half.body for half in halves if half.body is not None]
    number = np.cumsum([half.body is not None for half in halves]) - 1
    parts: dict[tuple[int, str], _Part] = {}

    def part(body: int, boundary: str) -> _Part:
        if (body, boundary) not in parts:
            samples = SAMPLES[scene.dimension] if scene.accuracy is not None else 0
            found = _part(scene.bodies[body], halves[body].surface, boundary, samples)
            parts[body, boundary] = found
        return parts[body, boundary]

    for loaded in [scene.under(case) for case in scene.loadings] or [scene]:
        _refuse_uneven_heat(loaded, mirror, [half.kept for half in halves])

    def factors(item: Item) -> tuple[float, ...]:
        if isinstance(item, Contact | BodyContact):
            return ()
        return tuple(case.of(item.name) for case in scene.loadings)

    described = _Described(_size(scene), [half.kept for half in halves], part, factors)
    _refuse_unpaired(scene, mirror, described)

    def kept(items: Iterable[Any]) -> tuple[Any, ...]:
        return tuple(
            replace(item, **{key: int(number[getattr(item, key)]) for key in ("body", "other")
                             if hasattr(item, key)})
            for item in items
            if _is_kept(item, scene, halves, part)
        )  # fmt: skip

    sections = tuple(
        replace(
            section,
            body=int(number[halves[section.body].kept]),
            across=section.across if halves[section.body].body else (*section.across, axis),
        )
        for section in scene.output.sections
    )
    held = tuple(0.0 if a == axis else None for a in range(scene.dimension))
    planes = [
        DisplacementCondition(int(number[k]), half.body.cuts[-1], held, f"{AT_CUT} {'xyz'[axis]}")
        for k, half in enumerate(halves)
        if half.body is not None and all(half.surface.of)
    ]
    return replace(
        scene,
        bodies=tuple(left),
        displacements=(*kept(scene.displacements), *planes),
        tractions=kept(scene.tractions),
        pressures=kept(scene.pressures),
        forces=kept(scene.forces),
        contacts=kept(scene.contacts),
        pairs=kept(scene.pairs),
        temperatures=kept(scene.temperatures),
        decomposition=_divided(scene.decomposition, left),
        output=replace(scene.output, sections=sections),
        mirrors=(
            *scene.mirrors,
            replace(
                mirror,
                partners=_partners(scene, mirror, described),
                contacts=scene.contact_names,
                conditions=scene.condition_names,
            ),
        ),
    )


def _plane(scene: Scene, axis: int) -> Mirror:
    """The middle of all bodies along an axis."""
    ends, size = _ends(scene, axis), _size(scene)
    at = 0.5 * float(ends[:, 0].min() + ends[:, 1].max())
    for body, middle in zip(scene.bodies, ends.mean(axis=1), strict=True):
        if isinstance(body.mesh, Box) and abs(middle - at) <= SAME * size:
            return Mirror(axis, float(middle))  # a box has it exactly
    return Mirror(axis, at)


def _ends(scene: Scene, axis: int) -> NDArray[np.float64]:
    """Where the bodies begin and end along an axis, (bodies, 2)."""
    return np.array([(b.mesh.lower[axis], b.mesh.upper[axis]) for b in scene.bodies])


def _size(scene: Scene) -> float:
    return max(float(np.ptp([b.mesh.lower, b.mesh.upper], axis=0).max()) for b in scene.bodies)


def _halves(scene: Scene, mirror: Mirror) -> list[_Half]:
    """What the bodies are: halves about the plane, or images of one another."""
    size = _size(scene)
    middles = _ends(scene, mirror.axis).mean(axis=1)
    away = middles - mirror.at
    boxes = np.array([isinstance(b.mesh, Box) for b in scene.bodies])
    tolerance = np.where(boxes, ALIKE * max(size, *np.abs(middles)), SAME * size)
    found: dict[int, _Half] = {}
    for k in np.flatnonzero(np.abs(away) <= tolerance):
        half, surface = _half(scene.bodies[k], mirror)
        found[int(k)] = _Half(half, surface, int(k))
    for k in np.flatnonzero(away < -tolerance):
        image = _image(scene, int(k), mirror, set(found))
        surfaces = _beside(scene.bodies[k], scene.bodies[image], mirror, size)
        found[int(k)] = _Half(scene.bodies[k], surfaces[0], int(k))
        found[image] = _Half(None, surfaces[1], int(k))
    for k in range(len(scene.bodies)):
        if k not in found:
            raise _alone(scene.bodies[k], mirror)
    return [found[k] for k in range(len(scene.bodies))]


def _alone(body: Body, mirror: Mirror) -> AsymmetryError:
    return AsymmetryError(
        f"{body.name} is off the middle of all bodies, {'xyz'[mirror.axis]} = {mirror.at:g}, and "
        "no other is its image"
    )


def _image(scene: Scene, number: int, mirror: Mirror, taken: set[int]) -> int:
    """The body where the image of a body is."""
    body, size = scene.bodies[number], _size(scene)
    corners = np.array([body.mesh.lower, body.mesh.upper])
    corners[:, mirror.axis] = 2.0 * mirror.at - corners[::-1, mirror.axis]
    for k, other in enumerate(scene.bodies):
        there = np.array([other.mesh.lower, other.mesh.upper])
        near = np.abs(corners - there).max() <= SAME * size
        if near and k not in taken and isinstance(other.mesh, Box) == isinstance(body.mesh, Box):
            return k
    raise _alone(body, mirror)


def _beside(
    body: Body, other: Body, mirror: Mirror, size: float
) -> tuple[HalfSurface, HalfSurface]:
    """The surfaces of a body and of its image."""
    mesh, there, name = body.mesh, other.mesh, f"{body.name} and {other.name}"
    if mesh.upper[mirror.axis] > mirror.at - SAME * size:
        raise AsymmetryError(f"{name} meet at the plane they mirror about")
    if body.degree != other.degree:
        raise AsymmetryError(f"{name} are of different degree")
    materials = [*body.materials, *other.materials]
    kinds = tuple(np.array([materials.index(m) for m in b.materials]) for b in (body, other))
    if isinstance(mesh, Box) and isinstance(there, Box):
        if (mesh.cells, mesh.cell) != (there.cells, there.cell):
            raise AsymmetryError(f"{name} have different cells")
        if kinds[0] != kinds[1]:
            raise AsymmetryError(f"{name} are of different materials")
        return box_images(mesh.shape(body.degree), there.shape(body.degree), mirror.axis)
    try:
        return mesh_images(
            mesh.shape(1), there.shape(1), body.degree, (kinds[0], kinds[1]), mirror.axis, mirror.at
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
            alike = np.array([body.materials.index(m) for m in body.materials])
            half, surface = half_mesh(mesh.shape(1), body.degree, alike, axis, at, cut)
    except AsymmetryError as why:
        raise AsymmetryError(f"{body.name} {why}") from None
    return replace(body, mesh=half, cuts=(*body.cuts, cut)), surface


def _part(body: Body, surface: HalfSurface, boundary: str, samples: int) -> _Part:
    """Where a boundary is on a symmetric body."""
    beside, points = ~surface.on_plane, (surface.points, surface.images)
    if boundary not in body.boundaries:
        facets = np.stack(surface.sides[boundary])
        nodes = np.zeros((2, len(beside)), bool)
        for found, rows in zip(nodes, facets, strict=True):
            found[surface.facets[rows]] = True
        nodes |= nodes[::-1] & ~beside  # nodes on the plane are one
        return _Part(nodes, facets, beside, np.zeros((2, 0), bool))
    expression = body.boundaries[boundary]
    own = np.ones(len(surface.facets), bool)
    for name in body.cuts:
        own &= ~np.any(surface.sides[name], axis=0)
    both = list(zip(points, surface.of, strict=True))
    nodes = np.stack([expression(x) & has for x, has in both])
    nodes[1, ~beside] = nodes[0, ~beside]
    facets = nodes[:, surface.facets].all(axis=2) & own
    on_surface = np.zeros(len(beside), bool)
    on_surface[surface.facets[own]] = True
    between = np.zeros((2, 0), bool)
    if samples:
        shares = _shares(len(body.mesh.lower), body.mesh.cell, samples)
        vertices = surface.facets[own][:, : shares.shape[1]]
        places = [np.einsum("sv,fvi->fsi", shares, x[vertices]).reshape(-1, 3) for x in points]
        both = list(zip(places, surface.of, strict=True))
        between = np.stack([expression(x) & has for x, has in both])
    return _Part(nodes & on_surface, facets, beside, between)


def _shares(dimension: int, cell: str, count: int) -> NDArray[np.float64]:
    """Shares of the vertices of a facet in points all over it, (points, vertices)."""
    t = np.linspace(0.0, 1.0, count + 1)
    line = np.stack([1.0 - t, t], axis=1)
    if dimension == 2:
        return line
    if cell == "hexahedron":  # vertices anticlockwise
        corners = np.einsum("si,tj->stij", line, line).reshape(-1, 4)
        return corners[:, [0, 1, 3, 2]]
    a, b = (g.ravel() for g in np.meshgrid(t, t))
    inside = a + b <= 1.0 + 1e-9
    return np.stack([1.0 - a - b, a, b], axis=1)[inside]


@dataclass(frozen=True, eq=False)
class _Described:
    """Describes items such that equal ones have equal descriptions.

    Attributes
    ----------
    size
        A length of the scene.
    kept
        Number of the body that is kept for each, as a `_Half` has it.
    part
        Where a boundary of a body is.
    factors
        Those of an item in each load case; none for contacts.
    """

    size: float
    kept: list[int]
    part: Callable[[int, str], _Part]
    factors: Callable[[Item], tuple[float, ...]]

    def __call__(self, item: Item, mirror: Mirror | None = None) -> Description:
        """What an item is, or its mirror image: words, and numbers of order one to compare.

        Among the words are its factors in the load cases: a scene mirrors where each case does.
        """
        words, numbers = self._described(item, mirror)
        return (*words, self.factors(item)), numbers

    def _described(self, item: Item, mirror: Mirror | None) -> Description:
        kind = type(item).__name__
        if isinstance(item, BodyForce):
            return (kind, self._body(item.body, mirror)), _scaled(_reflected(item.vector, mirror))
        where: Key = (kind, *self._boundary(item.body, item.boundary, mirror))
        if isinstance(item, DisplacementCondition):
            free = tuple(v is None for v in item.values)
            values = _reflected([v or 0.0 for v in item.values], mirror)
            return (*where, free), _scaled(values)
        if isinstance(item, Traction):
            return where, _scaled(_reflected(item.vector, mirror))
        if isinstance(item, Pressure):
            return where, _scaled(np.array([item.value]))
        if isinstance(item, BodyContact):
            other = self._boundary(item.other, item.other_boundary, mirror)
            return (*where, *other, item.round), _scaled(np.array([item.interference]))
        words, numbers = _described_obstacle(item.obstacle, self.size, mirror)
        return (*where, *words), np.append(numbers, _scaled(np.array([item.interference])))

    def _boundary(self, body: int, boundary: str, mirror: Mirror | None) -> Key:
        return (self.kept[body], self.part(body, boundary).key(image=mirror is not None))

    def _body(self, body: int, mirror: Mirror | None) -> int:
        """The number of a body, or of its image."""
        if mirror is None or self.kept.count(self.kept[body]) == 1:
            return body
        return next(k for k, n in enumerate(self.kept) if n == self.kept[body] and k != body)


def _refuse_unpaired(scene: Scene, mirror: Mirror, described: _Described) -> None:
    """Refuse what acts on a scene as often as its image does not."""
    items = _items(scene)
    for item in items:
        for body, boundary in _boundaries(item):
            if not described.part(body, boundary).nodes.any():
                raise AsymmetryError(f"{item.source} is on a boundary without nodes")
    known = [described(item) for item in items]
    for item, own in zip(items, known, strict=True):
        image = described(item, mirror)
        if sum(_alike(image, k) for k in known) != sum(_alike(own, k) for k in known):
            raise AsymmetryError(f"{item.source} has no mirror image")


def _refuse_uneven_heat(scene: Scene, mirror: Mirror, kept: list[int]) -> None:
    """Refuse temperatures that differ at nodes and middles of cells from those at their images."""
    for item in scene.temperatures:
        partners = [k for k, number in enumerate(kept) if number == kept[item.body]]
        image = next((k for k in partners if k != item.body), item.body)
        points = _nodes_and_middles(scene.bodies[item.body])
        here, there = (
            sum((t.rise(x) for t in scene.temperatures if t.body == body), np.zeros(len(x)))
            for body, x in ((item.body, points), (image, mirror.image(points)))
        )
        if not np.allclose(here, there, rtol=0.0, atol=SAME * float(np.abs(here).max())):
            raise AsymmetryError(f"the temperature of {item.source} is not its mirror image")


def _nodes_and_middles(body: Body) -> NDArray[np.float64]:
    """Points (n, 3) all over a body."""
    mesh: Any = body.mesh
    if isinstance(mesh, Box):
        ends = zip(mesh.lower, mesh.upper, mesh.cells, strict=True)
        axes = np.meshgrid(*[np.linspace(a, b, 2 * n + 1) for a, b, n in ends])
        points = np.stack([axis.ravel() for axis in axes], axis=1)
    else:
        points = np.concatenate([mesh.points, mesh.points[mesh.cells].mean(axis=1)])
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def _boundaries(item: Item) -> list[tuple[int, str]]:
    """Bodies and boundaries an item names."""
    if isinstance(item, BodyForce):
        return []
    first = [(item.body, item.boundary)]
    return [*first, (item.other, item.other_boundary)] if isinstance(item, BodyContact) else first


def _partners(scene: Scene, mirror: Mirror, described: _Described) -> tuple[tuple[str, str], ...]:
    """Contacts and displacement conditions that are images of others, not of themselves."""
    of_file = [c for c in scene.displacements if not c.source.startswith(AT_CUT)]
    items: list[Item] = [*scene.touching, *of_file]
    known = {item.source: described(item) for item in items}
    found = []
    for item in items:
        image = described(item, mirror)
        if not _alike(image, known[item.source]):
            found.append((item.source, next(s for s, d in known.items() if _alike(image, d))))
    return tuple(found)


def _is_kept(
    item: Item, scene: Scene, halves: list[_Half], part: Callable[[int, str], _Part]
) -> bool:
    """Whether an item acts on what is kept."""
    if isinstance(item, BodyForce | Temperature):
        return halves[item.body].body is not None
    by_facets = isinstance(item, Traction | Pressure | BodyContact)
    by_facets |= isinstance(item, Contact) and has_averaged_rows(scene.bodies[item.body])
    return all(part(*where).kept(by_facets) for where in _boundaries(item))


def _divided(decomposition: Decomposition, bodies: list[Body]) -> Decomposition:
    """The subdomains asked for, as far as what is solved has cells."""
    parts = decomposition.subdomains
    if isinstance(parts, int):
        parts = min(parts, sum(body.mesh.total_cells for body in bodies))
    elif parts is not None:
        boxes = [body.mesh.cells for body in bodies if isinstance(body.mesh, Box)]
        parts = tuple(map(min, zip(parts, *boxes, strict=True)))
        while any(body.mesh.uncuttable(parts, body.name) for body in bodies):
            parts = tuple(p - 1 if p == max(parts) else p for p in parts)
    return Decomposition(parts)


def _items(scene: Scene) -> list[Item]:
    """Everything that acts on the bodies."""
    return [
        *scene.displacements, *scene.tractions, *scene.pressures, *scene.forces, *scene.contacts,
        *scene.pairs,
    ]  # fmt: skip


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
        here = np.array(list(values), float)
        return here if mirror is None else mirror.image(here)

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
