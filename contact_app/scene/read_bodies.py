"""Reading the bodies of a scene file, with checks of names, meshes, materials and boundaries."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contact_app.errors import ConfigurationError
from contact_app.machine.memory import needed_bytes
from contact_app.scene.bodies import CELLS, MOTION_NAMES, Body, BodyMesh, Box
from contact_app.scene.expressions import Expression, ExpressionError
from contact_app.scene.keys import Keys, Place
from contact_app.scene.material import Material
from contact_app.scene.schema import bodies as c

if TYPE_CHECKING:
    from meshes.read import FileContent

Read = Callable[[Path, int], "FileContent"]

SHORTEST_EDGE = 1e-15
"""Shortest admissible edge of a cell; dolfinx treats boxes a few times shorter as empty."""

LONGEST_CELL = 1e4
"""Largest admissible ratio of longest to shortest edge of a cell.

Beyond it round-off hides the stiffness along the short edge.
"""

NEAREST_HALF = 1e-6
"""Least distance of Poisson's ratio from 0.5 and -1, where the stiffness is unbounded."""


def read_bodies(keys: Keys) -> tuple[Body, ...]:
    """The elastic bodies; names of all bodies, including rigid ones, must differ.

    Raises
    ------
    ConfigurationError
        Naming file, line, key and what is allowed.
    """
    entries = keys.configuration.bodies
    for i, body in enumerate(entries):
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_-]{0,99}", body.name):
            keys.fail(
                ("bodies", i, "name"),
                f"is {body.name!r}; a letter from A to Z or a to z or _ first, then these, digits "
                "and - are allowed",
            )
    elastic = {i: body for i, body in enumerate(entries) if isinstance(body, c.Body)}
    meshes = _meshes(keys, elastic)
    bodies = tuple(_body(keys, i, body, meshes[i]) for i, body in elastic.items())
    names = [body.name for body in entries]
    for i, name in enumerate(names):
        if name in names[:i]:
            keys.fail(("bodies", i, "name"), f"is {name!r}, the name of an earlier body")
    if not bodies:
        keys.fail(("bodies",), "are all rigid; at least one elastic body with a mesh is needed")
    return bodies


def _reading_once() -> Read:
    """Reads mesh files, each once: the bodies of an assembly often share one."""

    @cache
    def read(path: Path, dimension: int) -> "FileContent":
        from meshes.read import read_file  # meshio, which boxes do not need

        return read_file(path, dimension)

    return read


def _meshes(keys: Keys, bodies: dict[int, c.Body]) -> dict[int, BodyMesh]:
    """The mesh of each body (collective).

    Ranks share the checks of each mesh, or the bodies if there are enough: then no part of reading
    is done twice. Bodies go to the ranks there and back, as the first body is often the largest.
    """
    read, comm = _reading_once(), keys.comm
    files = [i for i, body in bodies.items() if body.mesh.file is not None]
    if comm is None or not 1 < comm.size <= len(files):
        return {i: _mesh(keys, i, body, read) for i, body in bodies.items()}
    alone = Keys(keys.configuration, keys.memory)
    of_rank: dict[int, BodyMesh | ConfigurationError] = {}
    ranks = [*range(comm.size), *reversed(range(comm.size))]
    reader = {i: ranks[k % len(ranks)] for k, i in enumerate(files)}
    for i in (i for i in files if reader[i] == comm.rank):
        try:
            of_rank[i] = _mesh(alone, i, bodies[i], read)
        except ConfigurationError as error:
            of_rank[i] = error
    meshes: dict[int, BodyMesh] = {}
    for i, body in bodies.items():
        if i not in reader:
            meshes[i] = _mesh(keys, i, body, read)
            continue
        result = comm.bcast(of_rank.get(i), root=reader[i])
        if isinstance(result, ConfigurationError):
            raise result
        meshes[i] = result
    return meshes


def _body(keys: Keys, i: int, body: c.Body, mesh: BodyMesh) -> Body:
    """A body as resolved from its keys and its mesh."""
    path: Place = ("bodies", i)
    materials, mesh = _materials(keys, body, mesh, (*path, "material"))
    if body.mean_dilatation:
        _check_mean_dilatation(keys, body, mesh.cell, (*path, "mean_dilatation"))
        materials = tuple(replace(m, mean_dilatation=True) for m in materials)
    made = Body(
        name=body.name,
        mesh=mesh,
        degree=body.degree,
        materials=materials,
        boundaries=_boundaries(keys, body, mesh, (*path, "boundaries")),
        hold=_held_motions(keys, body, (*path, "hold")),
        degree_given="degree" in body.model_fields_set or keys.configuration.certificate.guaranteed,
    )
    return _refined(keys, made, body.mesh.refine) if body.mesh.refine else made


def _refined(keys: Keys, body: Body, times: int) -> Body:
    """The body with the edges of its mesh halved several times."""
    from contact_app.scene.finer_meshes import halved

    contacts = [contact for contact in keys.configuration.contacts if contact.round]
    both = [(contact.on, contact.against or "") for contact in contacts]
    sides = [side.partition(".") for pair in both for side in pair]
    round_sides = [boundary for name, _, boundary in sides if name == body.name]
    for _ in range(times):
        body = halved(body, round_sides)
    return body


def _held_motions(keys: Keys, body: c.Body, path: Place) -> tuple[int, ...]:
    """Numbers of the rigid motions that are held."""
    names = MOTION_NAMES[keys.dimension]
    for i, name in enumerate(body.hold):
        if name not in names:
            keys.fail((*path, i), f"is {name!r}; allowed: {', '.join(names)}")
        if name in body.hold[:i]:
            keys.fail((*path, i), f"is {name}, which is given before")
    return tuple(sorted(names.index(name) for name in body.hold))


def _check_mean_dilatation(keys: Keys, body: c.Body, cell: str, path: Place) -> None:
    if body.degree != 1 or cell not in ("quadrilateral", "hexahedron"):
        keys.fail(
            path,
            "is for quadrilaterals and hexahedra of degree 1, not "
            f"{cell}s of degree {body.degree}"
            + (": use degree 2 there" if body.degree == 1 else ", which needs none"),
        )
    if keys.plane == "stress":
        keys.fail(path, "is for plane strain and 3D: in plane stress the volume is free")


def _boundaries(keys: Keys, body: c.Body, mesh: BodyMesh, path: Place) -> dict[str, Expression]:
    """Boundaries that an expression defines, by name."""
    boundaries = {}
    for name, boundary in body.boundaries.items():
        at = (*path, name)
        if name in mesh.boundaries or name in mesh.inner:
            keys.fail(at, f"redefines {name}, which the mesh knows already; choose another name")
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_+-]{0,99}", name):
            keys.fail(
                at,
                "is no name for a boundary; a letter from A to Z or a to z or _ first, then these, "
                "digits, + and - are allowed",
            )
        variables = ("x", "y", "z")[: keys.dimension]
        try:
            boundaries[name] = Expression.parse(boundary.where, variables)
        except ExpressionError as error:
            keys.fail((*at, "where"), str(error))
    return boundaries


def _materials(
    keys: Keys, body: c.Body, mesh: BodyMesh, path: Place
) -> tuple[tuple[Material, ...], BodyMesh]:
    """The materials of a body, and its mesh with each cell tagged by the number of its material."""
    materials_by_group = body.material
    if isinstance(materials_by_group, c.Material):
        return (_material(keys, materials_by_group, path),), mesh
    if body.mesh.box is not None:
        keys.fail(path, "by tag needs a mesh from a file; a box takes {young, poisson}")
    from meshes import MeshError

    materials = tuple(_material(keys, m, (*path, name)) for name, m in materials_by_group.items())
    try:
        return materials, mesh.tagged(tuple(materials_by_group))  # type: ignore[union-attr]
    except MeshError as error:
        keys.fail(path, str(error))


def _material(keys: Keys, material: c.Material, path: Place) -> Material:
    """A material with admissible numbers."""
    poisson = material.poisson
    if min(0.5 - poisson, 1.0 + poisson) < NEAREST_HALF:
        keys.fail(
            (*path, "poisson"),
            f"is {poisson:.10g}; an isotropic solid needs -1 < ν < 0.5, and nearer than "
            f"{NEAREST_HALF:g} to these round-off would decide the answer (nearly incompressible: "
            "ν ≤ 0.4999, and mind the certificate's warning)",
        )
    return Material(
        material.young, poisson, yield_stress=material.yield_stress, expansion=material.expansion
    )


def _mesh(keys: Keys, i: int, body: c.Body, read: Read) -> BodyMesh:
    """The mesh of a body."""
    mesh, path = body.mesh, ("bodies", i, "mesh")
    if (mesh.box is None) == (mesh.file is None):
        both = "has both; exactly one of" if mesh.box else "needs"
        keys.fail(path, f"{both} `box: {{lower, upper, cells, cell}}` or `file: part.msh`")
    if mesh.box is not None:
        for key in ("group", "scale", "rotate", "translate", "refine"):
            if key in mesh.model_fields_set:
                keys.fail((*path, key), "belongs to a mesh from a file; a box has corners")
        return _box(keys, mesh.box, (*path, "box"))
    return _file(keys, mesh, body.degree, path, read)


def _file(keys: Keys, mesh: c.Mesh, degree: int, path: Place, read: Read) -> BodyMesh:
    # imports dolfinx and meshio, which boxes do not need here
    """The mesh of a file, placed."""
    from meshes import MeshError
    from meshes.repair import Placement, load_mesh

    axis: Any = (0.0, 0.0, 1.0)
    if mesh.rotate is not None and mesh.rotate.axis is not None:
        if keys.dimension == 2:
            keys.fail((*path, "rotate", "axis"), "is not allowed in 2D; give the angle alone")
        axis = keys.direction(mesh.rotate.axis, (*path, "rotate", "axis"))
    elif mesh.rotate is not None and keys.dimension == 3:
        keys.fail((*path, "rotate"), "needs an axis in 3D: {axis: [0, 0, 1], angle: 90}")
    placement = Placement(
        scale=mesh.scale,
        axis=axis,
        angle=mesh.rotate.angle if mesh.rotate else 0.0,
        translation=keys.space(
            mesh.translate or (0.0,) * keys.dimension, (*path, "translate"), "a translation"
        ),
    )
    groups = [mesh.group] if isinstance(mesh.group, str) else mesh.group or []
    if not mesh.file or not mesh.file.isprintable():
        keys.fail((*path, "file"), f"is {mesh.file!r}, which is no valid file name")
    file = keys.configuration.source.parent / mesh.file
    try:
        body_mesh = load_mesh(file, keys.dimension, placement, groups, degree, read, keys.comm)
    except MeshError as error:
        keys.fail((*path, "file"), f"is {file}, which {error}")
    dofs = float(body_mesh.nodes * keys.dimension * 2 ** (keys.dimension * mesh.refine))
    needed, available = needed_bytes(dofs), keys.memory
    if needed > available:
        keys.fail(
            (*path, "refine"),
            f"makes about {dofs:.3g} degrees of freedom, which need {needed / 1e9:.3g} GB; "
            f"{available / 1e9:.3g} GB are available",
        )
    return body_mesh


def _box(keys: Keys, box: c.Box, path: Place) -> Box:
    """The mesh of a box with admissible corners and cells."""
    lower = keys.vector(box.lower, (*path, "lower"), "a corner")
    upper = keys.vector(box.upper, (*path, "upper"), "a corner")
    if len(box.cells) != keys.dimension:
        keys.fail(
            (*path, "cells"),
            f"has {len(box.cells)} numbers; a box in {keys.dimension}D has {keys.dimension}",
        )
    for axis, (a, b) in enumerate(zip(lower, upper, strict=True)):
        if not b > a:
            keys.fail(
                (*path, "upper"),
                f"is {b:g} along {'xyz'[axis]}, not above lower ({a:g}): the box has no volume",
            )
        if (b - a) / box.cells[axis] <= 1e-12 * max(abs(a), abs(b)):
            keys.fail(
                (*path, "cells"), f"are too small along {'xyz'[axis]} to tell their nodes apart"
            )
    edges = [(b - a) / n for a, b, n in zip(lower, upper, box.cells, strict=True)]
    if min(edges) < SHORTEST_EDGE:
        keys.fail(
            (*path, "cells"),
            f"make cells of {min(edges):.3g} along an edge; at least {SHORTEST_EDGE:g} is "
            "allowed: choose a smaller unit of length",
        )
    if max(edges) > LONGEST_CELL * min(edges):
        keys.fail(
            (*path, "cells"),
            f"make cells {max(edges) / min(edges):.3g} times as long as wide; up to "
            f"{LONGEST_CELL:g} is allowed",
        )
    cell = box.cell or CELLS[keys.dimension][0]
    if cell not in CELLS[keys.dimension]:
        keys.fail(
            (*path, "cell"),
            f"is {cell}; in {keys.dimension}D {' or '.join(CELLS[keys.dimension])} is allowed",
        )
    return Box(lower, upper, tuple(box.cells), cell)
