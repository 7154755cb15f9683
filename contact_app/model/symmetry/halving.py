"""Cutting a scene at its planes of symmetry.

Let the meshes, loads, conditions and obstacles of a scene be symmetric about a plane normal to an
axis, in the middle of the bodies. With `symmetry: allow`, only the lower side is modelled, and on
the cut face the displacement normal to the plane is zero. The answer of the whole is the mirrored
half: the energy of a scene is convex, so if u is a minimiser, so is the mean of u and its mirror
image. Planes across several axes make a quarter or an eighth.

Each body has to be its own mirror image or that of another body, of which one is then left out.
Boxes are compared by their cells, and meshes from files node by node and cell by cell
(`meshes.symmetric_half`). Boundaries are compared by their nodes and facets, so the names of a
boundary and its image may differ. A note gives the reason why a scene is not cut along an axis.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.model.symmetry.bodies import Half, halves_about, middle_plane, scene_size
from contact_app.model.symmetry.boundaries import BoundaryPart, part_of
from contact_app.model.symmetry.items import Descriptions, Item, are_alike
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
from contact_app.scene.scene import Decomposition, InnerSection, Mirror, Scene, Section
from meshes.arrays import Array
from meshes.symmetric_half import SAME, AsymmetryError

SAMPLES = {2: 32, 3: 8}
"""Points along the edge of a facet at which expressions are compared where meshes are refined."""

MIRRORED = ("displacements", "tractions", "pressures", "forces", "contacts", "pairs")
"""Fields of a scene with items that have to be mirror images of each other."""

AT_CUT = "symmetry across"
"""Source of the conditions that hold the solved part at a cut, before the name of the axis."""


@dataclass(frozen=True)
class Halving:
    """A scene cut at its planes of symmetry."""

    scene: Scene
    """The scene to model; its `mirrors` are the planes."""
    notes: tuple[str, ...]
    """One sentence per axis: the cut, or the reason why there is none."""


def halved(scene: Scene) -> Halving:
    """Cut a scene at each of its planes of symmetry."""
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
        remaining = {body.name for body in scene.bodies}
        notes += [
            f"symmetry: {body} is the mirror image of another body and is not solved"
            for body in before
            if body not in remaining
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
    """Raise an error if a scene has items that act on whole bodies or boundaries.

    An inner surface is one of them: the point behind it, from which its side of the body is found,
    may lie in the part that is left out, and the surface is not repeated in images, as planes are.
    """
    if scene.total_loads:
        raise AsymmetryError(
            f"{scene.total_loads[0].source} is a total force or moment on a whole boundary"
        )
    if scene.rigid.bodies:
        raise AsymmetryError(f"{scene.rigid.bodies[0].name} is rigid")
    if scene.ties:
        raise AsymmetryError(f"{scene.ties[0].source} is tied")
    for body in scene.bodies:
        if body.hold:
            raise AsymmetryError(f"{body.name} has rigid motions that are held on request")
    for section in scene.output.sections:
        if isinstance(section, InnerSection):
            raise AsymmetryError(f"section {section.name} is on an inner surface")
    rough = [contact for contact in scene.touching if contact.law.acts]
    if rough:
        raise AsymmetryError(f"{rough[0].source} has friction")


def _cut(scene: Scene, axis: int) -> Scene:
    """The lower half of a scene along an axis; raises an error if the scene is not symmetric."""
    _refuse_whole(scene)
    mirror = middle_plane(scene.bodies, axis)
    halves = halves_about(scene.bodies, mirror)
    remaining = [half.body for half in halves if half.body is not None]
    number = np.cumsum([half.body is not None for half in halves]) - 1
    parts: dict[tuple[int, str], BoundaryPart] = {}

    def part(body: int, boundary: str) -> BoundaryPart:
        if (body, boundary) not in parts:
            samples = SAMPLES[scene.dimension] if scene.accuracy is not None else 0
            part_of_body = part_of(scene.bodies[body], halves[body].surface, boundary, samples)
            parts[body, boundary] = part_of_body
        return parts[body, boundary]

    for loaded in [scene.under(case) for case in scene.loadings] or [scene]:
        _refuse_uneven_heat(
            loaded.bodies, loaded.temperatures, mirror, [half.number for half in halves]
        )

    def factors(item: Item) -> tuple[float, ...]:
        if isinstance(item, Contact | BodyContact):
            return ()
        return tuple(case.of(item.name) for case in scene.loadings)

    described = Descriptions(
        scene_size(scene.bodies), [half.number for half in halves], part, factors
    )
    _refuse_unpaired([i for key in MIRRORED for i in getattr(scene, key)], mirror, described)

    def solved_part(items: Iterable[Any]) -> tuple[Any, ...]:
        return tuple(
            replace(item, **{key: int(number[getattr(item, key)]) for key in ("body", "other")
                             if hasattr(item, key)})
            for item in items
            if _acts_on_solved_part(item, scene.bodies, halves, part)
        )  # fmt: skip

    parts_of: dict[str, Any] = {
        key: solved_part(getattr(scene, key)) for key in (*MIRRORED, "temperatures")
    }
    sections = tuple(
        replace(
            section,
            body=int(number[halves[section.body].number]),
            across=section.across if halves[section.body].body else (*section.across, axis),
        )
        for section in scene.output.sections
        if isinstance(section, Section)
    )
    held = tuple(0.0 if a == axis else None for a in range(scene.dimension))
    planes = [
        DisplacementCondition(int(number[k]), half.body.cuts[-1], held, f"{AT_CUT} {'xyz'[axis]}")
        for k, half in enumerate(halves)
        if half.body is not None and all(half.surface.of)
    ]
    return replace(
        scene,
        bodies=tuple(remaining),
        **{**parts_of, "displacements": (*parts_of["displacements"], *planes)},
        decomposition=_divided(scene.decomposition, remaining),
        output=replace(scene.output, sections=sections),
        mirrors=(
            *scene.mirrors,
            replace(
                mirror,
                partners=_partners(scene.displacements, scene.touching, mirror, described),
                contacts=scene.contact_names,
                conditions=scene.condition_names,
            ),
        ),
    )


def _refuse_unpaired(items: list[Item], mirror: Mirror, described: Descriptions) -> None:
    """Refuse items without a mirror image."""
    for item in items:
        for body, boundary in _boundaries(item):
            if not described.part(body, boundary).nodes.any():
                raise AsymmetryError(f"{item.source} is on a boundary without nodes")
    records = [described(item) for item in items]
    for item, record in zip(items, records, strict=True):
        image = described(item, mirror)
        if sum(are_alike(image, k) for k in records) != sum(are_alike(record, k) for k in records):
            raise AsymmetryError(f"{item.source} has no mirror image")


def _refuse_uneven_heat(
    bodies: Sequence[Body], temperatures: Sequence[Temperature], mirror: Mirror, numbers: list[int]
) -> None:
    """Refuse temperatures that differ at the mirror images of nodes and middles of cells."""
    for item in temperatures:
        partners = [k for k, number in enumerate(numbers) if number == numbers[item.body]]
        image = next((k for k in partners if k != item.body), item.body)
        points = _nodes_and_middles(bodies[item.body])
        values, image_values = (
            sum((t.rise(x) for t in temperatures if t.body == body), np.zeros(len(x)))
            for body, x in ((item.body, points), (image, mirror.image(points)))
        )
        if not np.allclose(values, image_values, rtol=0.0, atol=SAME * float(np.abs(values).max())):
            raise AsymmetryError(f"the temperature of {item.source} is not its mirror image")


def _nodes_and_middles(body: Body) -> Array:
    """Nodes and middles of cells (n, 3) of a body."""
    mesh: Any = body.mesh
    if isinstance(mesh, Box):
        ends = zip(mesh.lower, mesh.upper, mesh.cells, strict=True)
        axes = np.meshgrid(*[np.linspace(a, b, 2 * n + 1) for a, b, n in ends])
        points = np.stack([axis.ravel() for axis in axes], axis=1)
    else:
        points = np.concatenate([mesh.points, mesh.points[mesh.cells].mean(axis=1)])
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def _boundaries(item: Item) -> list[tuple[int, str]]:
    """Bodies and boundaries of an item."""
    if isinstance(item, BodyForce):
        return []
    first = [(item.body, item.boundary)]
    return [*first, (item.other, item.other_boundary)] if isinstance(item, BodyContact) else first


def _partners(
    displacements: Sequence[DisplacementCondition],
    touching: Sequence[Contact | BodyContact],
    mirror: Mirror,
    described: Descriptions,
) -> tuple[tuple[str, str], ...]:
    """Contacts and displacement conditions whose mirror images are other ones."""
    of_file = [c for c in displacements if not c.source.startswith(AT_CUT)]
    items: list[Item] = [*touching, *of_file]
    records = {item.source: described(item) for item in items}
    partners = []
    for item in items:
        image = described(item, mirror)
        if not are_alike(image, records[item.source]):
            partners.append(
                (item.source, next(s for s, d in records.items() if are_alike(image, d)))
            )
    return tuple(partners)


def _acts_on_solved_part(
    item: Item, bodies: Sequence[Body], halves: list[Half], part: Callable[[int, str], BoundaryPart]
) -> bool:
    """Whether an item acts on the part that is solved."""
    if isinstance(item, BodyForce | Temperature):
        return halves[item.body].body is not None
    by_facets = isinstance(item, Traction | Pressure | BodyContact)
    by_facets |= isinstance(item, Contact) and has_averaged_rows(bodies[item.body])
    return all(part(*where).on_lower_side(by_facets) for where in _boundaries(item))


def _divided(decomposition: Decomposition, bodies: list[Body]) -> Decomposition:
    """The requested subdomains, limited by the cells of the part that is solved."""
    parts = decomposition.subdomains
    if isinstance(parts, int):
        parts = min(parts, sum(body.mesh.total_cells for body in bodies))
    elif parts is not None:
        boxes = [body.mesh.cells for body in bodies if isinstance(body.mesh, Box)]
        parts = tuple(map(min, zip(parts, *boxes, strict=True)))
        while any(body.mesh.uncuttable(parts, body.name) for body in bodies):
            parts = tuple(p - 1 if p == max(parts) else p for p in parts)
    return Decomposition(parts)
