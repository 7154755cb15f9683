"""Construction of a scene from a configuration, and checks that need the whole scene.

These checks are of the decomposition, the required memory and the presence of a load.
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from contact_app.machine.memory import needed_bytes
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import (
    BodyContact,
    BodyForce,
    Contact,
    DisplacementCondition,
    Pressure,
    RigidTie,
    Temperature,
    Tie,
    TotalLoad,
    Traction,
)
from contact_app.scene.configuration import Configuration
from contact_app.scene.keys import Keys, Place
from contact_app.scene.load_factors import idle_conditions, read_cases, read_steps
from contact_app.scene.read_bodies import read_bodies
from contact_app.scene.read_conditions import ConditionReader
from contact_app.scene.read_rigid import read_rigid_bodies, refuse_with_rigid
from contact_app.scene.rigid import RigidBodies, RigidLoad, RigidMotion
from contact_app.scene.scene import Decomposition, InnerSection, OutputOptions, Scene, Section
from contact_app.scene.schema.bodies import Body as BodyKeys
from contact_app.scene.schema.options import PlaneSection, SurfaceSection
from contact_app.scene.yaml_reader import key_text

if TYPE_CHECKING:
    from mpi4py import MPI

    from solver.contact.options import SolverOptions


def build_scene(
    configuration: Configuration, memory: float | None = None, comm: "MPI.Intracomm | None" = None
) -> Scene:
    """Resolve a configuration (collective where ranks are given).

    Parameters
    ----------
    memory
        Bytes the scene may take; what the machine has left unless given.
    comm
        Ranks that all build this scene: they share the checks of meshes.

    Raises
    ------
    ConfigurationError
        Naming file, line, key and what is allowed.
    """
    keys = Keys(configuration, memory, comm)
    bodies, rigid_bodies = read_bodies(keys), read_rigid_bodies(keys)
    decomposition = _decomposition(keys, bodies)
    _check_memory(keys, bodies, decomposition)
    reader = ConditionReader(keys, bodies, rigid_bodies)
    conditions = [
        replace(reader.condition(i, item), name=item.name)
        for i, item in enumerate(configuration.conditions)
    ]
    contacts = [
        x for i, item in enumerate(configuration.contacts) for x in reader.contacts(i, item)
    ]

    def of(kind: type) -> tuple[Any, ...]:
        return tuple(item for item in (*conditions, *contacts) if isinstance(item, kind))

    scene = Scene(
        title=configuration.title,
        dimension=keys.dimension,
        plane=keys.plane,
        bodies=bodies,
        displacements=of(DisplacementCondition),
        tractions=of(Traction),
        pressures=of(Pressure),
        forces=of(BodyForce),
        total_loads=of(TotalLoad),
        temperatures=of(Temperature),
        contacts=of(Contact),
        pairs=of(BodyContact),
        ties=of(Tie),
        rigid_ties=of(RigidTie),
        rigid=RigidBodies(keys.dimension, rigid_bodies, of(RigidMotion), of(RigidLoad)),
        decomposition=decomposition,
        accuracy=configuration.accuracy,
        solver=_solver_options(configuration),
        output=_output(keys, bodies),
        source=configuration.source,
        symmetry=configuration.symmetry == "allow",
        guaranteed=configuration.certificate.guaranteed,
        cases=read_cases(keys),
        steps=read_steps(keys),
        idle=idle_conditions(keys),
        places=_places(configuration),
    ).placed_as_held()
    refuse_with_rigid(keys, scene)
    _refuse_with_loadings(keys, scene)
    return scene


def _refuse_with_loadings(keys: Keys, scene: Scene) -> None:
    """Refuse loads that load nothing, and options that cases or steps exclude."""
    if scene.cases and scene.accuracy is not None:
        keys.fail(
            ("accuracy",),
            "is not available with cases: each case needs another mesh, and all cases share one; "
            "find the mesh by a scene without cases that has the loads of the worst case",
        )
    if scene.steps and not any(_loaded(scene.under(end)) for end in scene.loadings):
        keys.fail(("steps",), "load nothing: give a factor to a condition that is a load")
    for case in scene.cases:
        if not _loaded(scene.under(case)):
            keys.fail(
                ("cases", case.name), "loads nothing: give a factor to a condition that is a load"
            )
    if not _loaded(scene):
        keys.fail(
            ("conditions",),
            "load nothing: give a traction, pressure, force, total_force, total_moment, "
            "temperature or non-zero displacement, an interference, or an "
            "obstacle or a body that overlaps another body",
        )


def _solver_options(configuration: Configuration) -> "SolverOptions":
    """Options of the solver; with `accuracy` its tolerance follows the mesh unless one is given."""
    from solver.contact.options import SolverOptions  # imports PETSc

    solver, accuracy = configuration.solver, configuration.accuracy
    options = SolverOptions(**solver.model_dump())
    if accuracy is not None and "tolerance" not in solver.model_fields_set:
        options = replace(options, tolerance="auto")
    if accuracy is None:
        return options
    return replace(options, tightest=min(options.tightest, 0.1 * accuracy))


def _output(keys: Keys, bodies: tuple[Body, ...]) -> OutputOptions:
    output = keys.configuration.output
    probes = tuple(
        (name, keys.space(point, ("output", "probes", name), "a point"))
        for name, point in output.probes.items()
    )
    sections = tuple(
        _section(keys, bodies, name, section) for name, section in output.sections.items()
    )
    fields = tuple(dict.fromkeys(output.fields))
    return OutputOptions(output.xdmf, output.vtu, fields, probes, sections)


def _section(
    keys: Keys, bodies: tuple[Body, ...], name: str, section: PlaneSection | SurfaceSection
) -> Section | InnerSection:
    """A section as resolved from its keys."""
    names, path = [body.name for body in bodies], ("output", "sections", name)
    if isinstance(section, SurfaceSection):
        where = ConditionReader(keys, bodies).boundary(section.on, (*path, "on"), inner=True)
        return InnerSection(name, *where, keys.space(section.behind, (*path, "behind"), "a point"))
    if section.inside not in names:
        keys.fail((*path, "in"), f"is {section.inside}; the bodies are {', '.join(names)}")
    point = keys.space(section.plane.point, (*path, "plane", "point"), "a point")
    normal = keys.direction(section.plane.normal, (*path, "plane", "normal"))
    return Section(name, names.index(section.inside), section.inside, point, normal)


def _places(configuration: Configuration) -> dict[str, str]:
    """Places of conditions, contacts and the decomposition in the file."""
    paths: list[Place] = [
        (name, i)
        for name in ("conditions", "contacts", "steps")
        for i in range(len(getattr(configuration, name) or ()))
    ]
    paths += [("cases", name) for name in configuration.cases or ()]
    paths += [("bodies", i, "hold") for i in range(len(configuration.bodies))]
    paths += [(key,) for key in ("cases", "steps", "accuracy", "decomposition", "output")]
    paths.append(("certificate", "guaranteed"))
    return {key_text(path): configuration.where(path) for path in paths}


def _decomposition(keys: Keys, bodies: tuple[Body, ...]) -> Decomposition:
    """The decomposition as resolved from its key."""
    decomposition = keys.configuration.decomposition
    if isinstance(decomposition, str):
        return Decomposition(None)
    parts = decomposition.subdomains
    if isinstance(parts, int):
        cells = sum(b.mesh.total_cells for b in bodies)
        if parts > cells:
            keys.fail(
                ("decomposition", "subdomains"),
                f"is {parts}; at most one per cell is allowed, {cells} here",
            )
        return Decomposition(parts)
    if len(parts) != keys.dimension:
        keys.fail(
            ("decomposition", "subdomains"),
            f"has {len(parts)} numbers; along the axes of {keys.dimension}D there are "
            f"{keys.dimension}",
        )
    for body in bodies:
        why = body.mesh.uncuttable(tuple(parts), body.name)
        if why:
            keys.fail(("decomposition", "subdomains"), why)
    return Decomposition(tuple(parts))


def _check_memory(keys: Keys, bodies: tuple[Body, ...], decomposition: Decomposition) -> None:
    """Refuse scenes that exceed the memory, by their mesh or by factors of large subdomains."""
    d = keys.dimension
    dofs = sum(b.nodes for b in bodies) * d
    parts = decomposition.subdomains
    factors: list[tuple[float, int]] = []
    for body in bodies:
        unknowns = float(body.nodes * d)
        if isinstance(parts, int):
            factors += [(dofs / parts, d)] * min(math.ceil(parts / len(bodies)), 1000)
        elif isinstance(parts, tuple):  # congruent sub-boxes: one factor for each body
            count = math.prod(parts)
            factors += [(unknowns / count, d)] * (1 if body.mesh.congruent else count)
        elif not body.mesh.congruent:
            from meshes.decompose import choose_parts  # available: the mesh was read

            count = choose_parts(body.nodes, d, degree=body.degree)
            factors += [(unknowns / count, d)] * count
    needed, available = needed_bytes(dofs, factors=tuple(factors)), keys.memory
    if needed > available:
        largest = int(np.argmax([float(b.nodes) for b in bodies]))
        i, entry = [
            (i, body)
            for i, body in enumerate(keys.configuration.bodies)
            if isinstance(body, BodyKeys)
        ][largest]
        key = ("box", "cells") if entry.mesh.box else ("file",)
        keys.fail(
            ("bodies", i, "mesh", *key),
            f"{'make' if len(key) == 2 else 'makes'} {float(dofs):.3g} degrees of freedom in "
            f"all, which need about {needed / 1e9:.3g} GB; {available / 1e9:.3g} GB are "
            "available",
        )


def _loaded(scene: Scene) -> bool:
    """Whether some load, displacement or overlap acts on a body."""
    vectors = [x.vector for x in scene.tractions] + [x.vector for x in scene.forces]
    vectors += [(*x.force, *x.moment) for x in scene.total_loads]
    vectors += [(*x.force, *x.moment) for x in scene.rigid.loads]
    prescribed = [condition.values for condition in scene.displacements]
    prescribed += [motion.values for motion in scene.rigid.motions]
    pressed = any(map(any, vectors)) or any(load.value for load in scene.pressures)
    moved = any(map(any, prescribed))
    moved |= any(contact.interference > 0.0 for contact in scene.touching)
    entered = any(_may_enter(scene.bodies, contact) for contact in scene.contacts)
    overlapping = any(_may_overlap(scene.bodies, pair) for pair in scene.pairs)
    heated = not all(item.rise.vanishes for item in scene.temperatures)
    return pressed or heated or moved or entered or overlapping


def _may_enter(bodies: tuple[Body, ...], contact: Contact) -> bool:
    """Whether the box of a body enters an obstacle."""
    box = bodies[contact.body].mesh
    lower, upper = (np.array([*v, *(0.0,) * (3 - len(v))]) for v in (box.lower, box.upper))
    return contact.obstacle.may_overlap(lower, upper)


def _may_overlap(bodies: tuple[Body, ...], pair: BodyContact) -> bool:
    """Whether the boxes of two bodies have a part in common."""
    a, b = bodies[pair.body].mesh, bodies[pair.other].mesh
    lower, upper = np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper)
    return bool((lower < upper).all())
