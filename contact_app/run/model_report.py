"""The model of a scene and what it leaves out, in lines for the screen and the log."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from mpi4py import MPI

from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.model.boundaries import boundary_nodes
from contact_app.model.equilibrium import group_numbers
from contact_app.model.loaded_area import loaded_facets
from contact_app.model.loads import Loads
from contact_app.model.method import LIMITS, MethodChoice, is_undecomposed, patience
from contact_app.model.obstacle_hints import obstacle_hints
from contact_app.model.outline import Outline, left_out_notes
from contact_app.results.repeated_sentences import without_repetitions
from contact_app.run.cost import distinct_nodes, gluing_rows, groups_of
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import (
    BodyContact,
    Contact,
    DisplacementCondition,
    Pressure,
    RigidTie,
    Tie,
    TotalLoad,
    Traction,
)
from contact_app.scene.read_conditions import Condition
from contact_app.scene.rigid import RigidBodies
from contact_app.scene.scene import LoadCase, LoadStep, Scene

ROUNDED = 1e-9
"""Overlap over the size of the body that rounding errors of coordinates may make."""

KINDS = {"strain": "2D, plane strain", "stress": "2D, plane stress", None: "3D"}

LEFT_OUT = (
    "large strains and rotations: strains are linear in the displacement",
    "motion of the contact point: the gap is the signed distance of the undeformed node along the "
    "obstacle's normal there, between bodies along the normal of the undeformed surface",
    "contact of a body with itself, and contact between bodies that no entry of contacts names",
    "inertia: the answer is the static equilibrium",
)


def modelled_lines(scene: Scene, outline: Outline) -> list[str]:
    """Lines on the model, its method and what it leaves out (collective)."""
    unloaded = [] if scene.loadings else _unloaded(outline, scene.displacements)
    return [
        f"{scene.title or scene.source.name} ({KINDS[scene.plane]})",
        *_modelled(outline, Loads.of(scene), scene.displacements, bool(scene.loadings)),
        *_cases(scene.cases, scene.steps),
        "",
        *_decomposed(scene, outline),
        "",
        *_left_out(outline, unloaded, scene.plane, bool(scene.steps)),
    ]


def _modelled(
    outline: Outline,
    loads: Loads,
    displacements: Sequence[DisplacementCondition],
    has_loadings: bool,
) -> list[str]:
    """Lines on bodies, conditions and contacts (collective)."""
    geometry, partition = outline.geometry, outline.partition
    bodies, rigid, d = geometry.bodies, geometry.rigid, geometry.dimension
    dofs, on = partition.nodes * d, partial(_on, bodies)
    lines = [f"  {partition.cells:,} cells, {partition.nodes:,} nodes, {dofs:,} degrees of freedom"]
    for i, body in enumerate(bodies):
        materials = "; ".join(
            f"Young's modulus {m.young:g}, Poisson's ratio {m.poisson:g}"
            + (f", expansion {m.expansion:g} per degree" if m.expansion else "")
            for m in body.materials
        )
        element = ", degree 2" if body.degree == 2 else ""
        if body.mean_dilatation:
            element = ", change of volume as its mean over cells"
        lines.append(f"body {body.name}: {body.mesh.describe()}{element}, {materials}")
        corners = np.array([body.mesh.lower, body.mesh.upper])
        corners[np.abs(corners) < 1e-12 * np.ptp(corners, axis=0).max()] = 0.0
        lines.append("  from {} to {}".format(*(_vector(tuple(corner)) for corner in corners)))
        lines += [f"  {note}" for note in body.mesh.notes]
        if not has_loadings:
            lines.append(f"  total load {_vector(_resultant(outline, i, d))}")
    lines += [_held(bodies, condition, outline) for condition in displacements]
    for traction in (load for load in loads.on_facets if isinstance(load, Traction)):
        lines.append(
            f"{_name(traction)}: {on(traction)} loaded by "
            f"{_vector(traction.vector)} per area {_facets(bodies, outline, traction)}"
        )
    for pressure in (load for load in loads.on_facets if isinstance(load, Pressure)):
        lines.append(
            f"{_name(pressure)}: {on(pressure)} under a pressure of "
            f"{pressure.value:g} {_facets(bodies, outline, pressure)}"
        )
    for load, linear in zip(loads.totals, outline.acting.linear, strict=True):
        lines.append(
            f"{_name(load)}: {on(load)} loaded by a total force "
            f"{_vector(load.force)}{_moment(load, d)} on an area of {linear.area:.4g}"
        )
    for force in loads.forces:
        lines.append(
            f"{_name(force)}: {bodies[force.body].name} loaded by {_vector(force.vector)} "
            "per volume"
        )
    for heat in loads.temperatures:
        lines.append(
            f"{_name(heat)}: temperature of {bodies[heat.body].name} is {heat.rise.text} "
            "above the stress-free state"
        )
    lines += _rigid(rigid)
    for i, contact in enumerate(geometry.contacts):
        obstacle = contact.obstacle.describe(d)
        nodes = _count_nodes(bodies, outline, contact)
        whose = "" if contact.rigid is None else f"{rigid.bodies[contact.rigid].name}, a "
        lines.append(
            f"{contact.source}: {on(contact)} may touch {whose or 'the '}{obstacle} "
            f"({_candidates(outline, i, bodies[contact.body], nodes)})"
            f"{_law(contact)}"
        )
    hints = obstacle_hints(outline.geometry, outline.rows.contact)
    lines += [f"warning: {hint}" for hint in hints]
    for i, pair in enumerate(geometry.pairs, start=len(geometry.contacts)):
        other = f"{bodies[pair.other].name}.{pair.other_boundary}"
        lines.append(
            f"{pair.source}: {on(pair)} may touch {other}, by a mortar method "
            f"({_candidates(outline, i, bodies[pair.body])})"
            f"{_law(pair)}"
        )
    for tie in (tie for tie in geometry.ties if isinstance(tie, Tie)):
        other = f"{bodies[tie.other].name}.{tie.other_boundary}"
        lines.append(f"{tie.source}: {on(tie)} is tied to {other}, by a mortar method")
    for glued in (tie for tie in geometry.ties if isinstance(tie, RigidTie)):
        name = rigid.bodies[glued.rigid].name
        lines.append(f"{glued.source}: {on(glued)} moves with {name}, which is rigid")
    lines += [f"warning: {note}" for note in outline.rows.tied.notes]
    return lines


def _held(bodies: Sequence[Body], condition: DisplacementCondition, outline: Outline) -> str:
    """Line of a displacement condition (collective)."""
    held, nodes = _components("xyz", condition.values), _count_nodes(bodies, outline, condition)
    return f"{_name(condition)}: {_on(bodies, condition)} displaced by {held} ({nodes:,} nodes)"


def _rigid(rigid: RigidBodies) -> list[str]:
    """One line per rigid body with its shapes below it, and one line per condition."""
    lines, d = [], rigid.dimension
    for body in rigid.bodies:
        at = _vector(body.center[:d])
        lines.append(f"body {body.name}: rigid, moves and turns about {at}; small rotations")
        lines += [f"  {shape.describe(d)}" for shape in body.obstacles]
    names = {2: ("x", "y", "rotation"), 3: (*"xyz", "rotation x", "rotation y", "rotation z")}[d]
    for motion in rigid.motions:
        held = _components(names, motion.values)
        lines.append(f"{_name(motion)}: {rigid.bodies[motion.body].name} moved by {held}")
    for load in rigid.loads:
        lines.append(
            f"{_name(load)}: {rigid.bodies[load.body].name} under a force "
            f"{_vector(load.force)} and a moment {_vector(load.moment)}"
        )
    return lines


def _components(names: Sequence[str], values: Sequence[float | None]) -> str:
    """The given ones of some components, as `x = 0, y = 1`."""
    pairs = zip(names, values, strict=False)
    return ", ".join(f"{name} = {value:g}" for name, value in pairs if value is not None)


def _law(contact: Contact | BodyContact) -> str:
    """Friction and interference or clearance of a contact, as the end of a line."""
    law = f", with {contact.law.description}" if contact.law.acts else ""
    if not contact.interference:
        return law
    kind = "an interference" if contact.interference > 0.0 else "a clearance"
    return f"{law}, with {kind} of {abs(contact.interference):g}"


def _name(condition: Condition) -> str:
    """Place of a condition in the file, and its name if it has one."""
    return f"{condition.source} ({condition.name})" if condition.name else condition.source


def _cases(cases: Sequence[LoadCase], steps: Sequence[LoadStep]) -> list[str]:
    """The factors of each case or step."""
    lines = []
    for case in cases:
        factors = ", ".join(f"{factor:g} × {name}" for name, factor in case.factors if factor)
        lines.append(f"case {case.name}: {factors or 'only the conditions without a name'}")
    for number, step in enumerate(steps, start=1):
        ends = ", ".join(f"{name} {factor:g}" for name, factor in step.factors)
        many = "increments" if step.increments > 1 else "increment"
        lines.append(f"step {number}: to {ends}, in {step.increments} {many}")
    return lines


def loads_on_bodies(bodies: Sequence[Body], outline: Outline) -> list[str]:
    """The total load on each body of a case (collective)."""
    d = outline.partition.dimension
    return [
        f"total load on {body.name} {_vector(_resultant(outline, i, d))}"
        for i, body in enumerate(bodies)
    ]


def _decomposed(scene: Scene, outline: Outline) -> list[str]:
    """Lines on the method, the subdomains, and what holds each body (collective)."""
    partition = outline.partition
    groups = groups_of(outline, scene.decomposition)
    many = partition.count > 1
    if is_undecomposed(scene.solver):
        why = "its iterations hardly grow with the size"
        return [
            f"method: primal, multigrid on the undecomposed bodies; {why}; one subdomain for each "
            "body and rank, none factored"
        ]
    lines = [
        f"decomposition: {partition.count} subdomain{'s' * many} of about "
        f"{partition.nodes * scene.dimension / partition.count:,.0f} unknowns, {len(groups)} of "
        f"them different on this process: one factor each; {gluing_rows(outline):,} rows "
        "glue them"
    ]
    names = outline.geometry.body_names
    obstacles = [body.name for body in scene.rigid.bodies if body.name not in names]
    lines += [f"  {name}: held in all components, so it is a fixed obstacle" for name in obstacles]
    undecomposed = np.append(outline.eliminated, np.zeros(len(scene.moving), bool))
    for name, balance, eliminated in zip(names, outline.balances, undecomposed, strict=True):
        if eliminated:
            state = "held by its conditions and not decomposed: no gluing and no coarse problem"
        elif name not in [body.name for body in scene.bodies] and not balance.free_motions.shape[1]:
            state = "rigid: its contacts and its conditions hold it"
        elif balance.held:
            state = "held by its conditions; its subdomains float (Total FETI)"
        elif balance.free_motions.shape[1]:
            state = (
                f"free in {balance.free_motions.shape[1]} rigid motions on which no load does "
                "work: the run holds the body in its place"
            )
        else:
            state = "held by its contacts alone, or by its contacts and conditions together"
        lines.append(f"  {name}: {state}")
    if not scene.touching:
        lines.append("  no contacts: conjugate gradients solve the linear problem")
    choice = MethodChoice.of(scene)
    if choice.may_peel:
        lines.append(
            "method: Total FETI, which is faster than multigrid on thin bodies; after "
            f"{patience(scene.bodies)} iterations the undecomposed bodies are solved by `primal`, "
            "since contact of thin bodies may open row by row"
        )
    elif scene.solver.method == "auto" and scene.touching:
        later = f"; after {LIMITS.patience_with_friction} iterations `primal`"
        later *= choice.may_stall and not scene.steps
        if choice.may_jump:
            later = "; if its active sets do not settle, `primal`"
        lines.append(f"method: Total FETI; {choice.why_total_feti}{later}")
    return lines


def _left_out(
    outline: Outline, unloaded: Sequence[str], plane: str | None, has_steps: bool
) -> list[str]:
    """Lines on what the model leaves out, with those on unloaded bodies (collective)."""
    geometry = outline.geometry
    has_friction = any(contact.law.acts for contact in geometry.touching)
    notes = [*left_out_notes(outline), *_repeated(geometry.contacts), *unloaded]
    notes = without_repetitions(notes, [body.name for body in geometry.bodies])
    lines = ["left out:", *(f"  {sentence}" for sentence in notes)]
    smooth = [contact.source for contact in geometry.touching if not contact.law.acts]
    if smooth:
        of = f" of {', '.join(dict.fromkeys(smooth))}" if has_friction else ""
        lines.append(f"  friction: contact forces{of} act along the normal of the surface")
    if has_friction and not has_steps:
        lines.append("  the history of loads: slips are measured from the undeformed state")
    lines += [f"  {sentence}" for sentence in LEFT_OUT]
    if plane:
        lines.append(
            f"  the third direction: the model is plane {plane}, forces are per unit of thickness"
        )
    if any(contact.obstacle.curvature_radius for contact in geometry.contacts):
        lines.append(
            "  curvature of the obstacles under sliding nodes: the run warns where it matters"
        )
    return lines


def _repeated(contacts: Sequence[Contact]) -> list[str]:
    """Contacts that add no rows because an earlier contact has them."""
    return [
        f"{later.source}: repeats {earlier.source} and adds no rows"
        for j, later in enumerate(contacts)
        for earlier in contacts[:j]
        if replace(later, source=earlier.source) == earlier
    ]


def _unloaded(outline: Outline, displacements: Sequence[DisplacementCondition]) -> list[str]:
    """Bodies without load, heat, displacement or overlap, directly or through other bodies."""
    geometry, comm = outline.geometry, outline.partition.comm
    acted = np.zeros(len(geometry.bodies), bool)
    for loads in (outline.acting.vectors, outline.acting.thermal):
        for s, load in zip(outline.partition.subdomains, loads, strict=True):
            acted[s.body] |= load is not None and bool(load.any())
    for condition in displacements:
        acted[condition.body] |= any(condition.values)
    for joint in (*geometry.contacts, *geometry.ties):
        acted[joint.body] |= getattr(joint, "rigid", None) is not None
    gaps, sources = outline.rows.contact.gaps, outline.rows.contact.sources
    touched = np.array([c.body for c in geometry.touching], int)
    acted[touched[sources[gaps < 0.0]]] = True
    group = group_numbers(geometry)
    group = group[: len(acted)]  # bodies of a group act on each other
    acted = np.isin(group, group[comm.allreduce(acted.astype(int)) > 0])
    return [
        f"{body.name}: has no load, no prescribed displacement and no overlap; it does not deform"
        for body, some in zip(geometry.bodies, acted, strict=True)
        if not some
    ]


def _count_nodes(
    bodies: Sequence[Body], outline: Outline, condition: DisplacementCondition | Contact
) -> int:
    body = bodies[condition.body]
    nodes = [
        s.nodes[boundary_nodes(s, body, condition.boundary)]
        for s in outline.partition.subdomains
        if s.body == condition.body
    ]
    return int(outline.partition.comm.allreduce(len(distinct_nodes(outline, nodes))))


def _facets(bodies: Sequence[Body], outline: Outline, load: Traction | Pressure) -> str:
    count, area = loaded_facets(bodies, outline.partition, load)
    return f"({count:,} facets, area {area:.4g})"


def _candidates(outline: Outline, contact: int, body: Body, on_boundary: int = 0) -> str:
    """Phrase with the number of candidate nodes on the boundary, and their smallest gap.

    An overlap is explained.
    """
    comm = outline.partition.comm
    gaps, sources = outline.rows.contact.gaps, outline.rows.contact.sources
    smallest = comm.allreduce(float(gaps[sources == contact].min(initial=np.inf)), op=MPI.MIN)
    if np.isinf(smallest):
        return "no candidate nodes: other conditions determine all nodes of the boundary"
    count = comm.allreduce(int((outline.contact.sources == contact).sum()))
    others = max(on_boundary - comm.allreduce(int((sources == contact).sum())), 0)
    decided = ""
    if others and not has_averaged_rows(body):  # these have rows for vertices alone
        decided = f" and {others:,} that are held or belong to other contacts"
    size = float(np.linalg.norm(np.subtract(body.mesh.upper, body.mesh.lower)))
    overlap = ": an overlap, which presses as an interference fit" * (smallest < -ROUNDED * size)
    return f"{count:,} candidate nodes{decided}, smallest gap {smallest:.4g}{overlap}"


def _resultant(outline: Outline, body: int, dimension: int) -> tuple[float, ...]:
    """Sum of the loads on a body."""
    total = np.zeros(dimension)
    for s, load in zip(outline.partition.subdomains, outline.acting.vectors, strict=True):
        if s.body == body and load is not None:
            total += load.reshape(-1, dimension).sum(axis=0)
    total = outline.partition.comm.allreduce(total)
    total[np.abs(total) < 1e-12 * np.abs(total).max(initial=0.0)] = 0.0
    return tuple(total)


def _moment(load: TotalLoad, dimension: int) -> str:
    if not any(load.moment) and load.at is None:
        return ""
    moment = load.moment if dimension == 3 else load.moment[2:]
    where = "its centroid" if load.at is None else _vector(load.at[:dimension])
    return f" and a moment {_vector(moment)} at {where}"


Named = (
    DisplacementCondition | Traction | TotalLoad | Pressure | Contact | BodyContact | Tie | RigidTie
)
"""Conditions and contacts on a boundary of a body."""


def _on(bodies: Sequence[Body], item: Named) -> str:
    return f"{bodies[item.body].name}.{item.boundary}"


def _vector(vector: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in vector) + ")"
