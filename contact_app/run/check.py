"""What a scene will be modelled as, what is left out, and what it costs, without solving it.

The outline of the model (subdomains, conditions, loads, what balances them) is the one a run
begins with, so whatever a run would refuse before it assembles a matrix, `check` refuses too.

Time is estimated from the sizes of the subdomains by the model that chooses the decomposition
(`solver.tfeti.subdomain.costs`), for the Hessian multiplications that bodies of such a shape were
seen to need; a badly conditioned scene needs several times as many. Each cell adds its share of
error estimate and output. `python -m contact_app.studies.estimates` holds estimates against runs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from rich.console import Console

from contact_app.machine.memory import available_bytes, needed_bytes
from contact_app.model.boundaries import boundary_nodes
from contact_app.model.decomposition import PRODUCTS_GLUED, PRODUCTS_WHOLE
from contact_app.model.far_obstacles import far_obstacle_hints
from contact_app.model.loaded_area import loaded_facets
from contact_app.model.method import PATIENCE, chosen, is_undecomposed, may_peel
from contact_app.model.outline import Outline, left_out_notes, outline
from contact_app.run.case_models import outlines_of_cases
from contact_app.run.repeated_sentences import said_once
from contact_app.run.rigid_lines import rigid_lines
from contact_app.scene.conditions import (
    BodyContact,
    BodyForce,
    Contact,
    DisplacementCondition,
    Pressure,
    Temperature,
    TotalLoad,
    Traction,
)
from contact_app.scene.scene import Scene
from meshes import Subdomain
from solver.tfeti.subdomain.costs import Group, run_seconds

Condition = DisplacementCondition | Traction | Pressure | TotalLoad | BodyForce | Temperature

CELL_RATE = {2: 8e-7, 3: 2e-6}
"""Seconds for error estimate, fields and output of a cell, by dimension."""

PACE = 0.6
"""Seconds of runs in an ordinary hour over those of the cost model, fitted in a slow one."""

STEP_SECONDS = 7e-4
"""Calls of a product with its share of a face's, where there is gluing; however a body is cut."""

STARTED = 0.022
"""Seconds of a run beside, whatever its size."""

LEFT_OUT = (
    "large strains and rotations: strains are linear in the displacement",
    "motion of the contact point: the gap is the signed distance of the undeformed node along the "
    "obstacle's normal there, between bodies along the normal of the undeformed surface",
    "contact of a body with itself, and between bodies that no contact names",
    "inertia: the answer is the static equilibrium",
)


@dataclass(frozen=True)
class Cost:
    """Estimated peak memory (bytes) and time (seconds) of a run on one process."""

    memory: float
    seconds: float


def report(scene: Scene, comm: MPI.Intracomm = MPI.COMM_WORLD) -> None:
    """Print what a run would model and what it would cost (collective).

    Raises
    ------
    ConfigurationError, NoEquilibriumError
        What a run would refuse, too.
    """
    from contact_app.accuracy.guarantee.box_surface import refuse_unguaranteed, stress_bytes
    from contact_app.model.symmetry import halved

    halving = halved(scene)
    if scene.symmetry:
        scene = halving.scene
    scene = chosen(scene)
    outlines: dict[str, Outline] = {}
    if scene.loadings:
        outlines = {k: v for k, v in outlines_of_cases(scene, comm).items() if v is not None}
        known = next(iter(outlines.values()))
    else:
        known = outline(scene, comm, needed="estimated")
    refuse_unguaranteed(scene, known.partition)
    lines = describe(scene, known)
    for name, own in outlines.items():
        what = f"case {name}" if scene.cases else name
        lines += [f"{what}: {line}" for line in _loads_on_bodies(scene, own)]
    if scene.symmetry:
        lines = [*halving.notes, "", *lines]
    elif halving.scene.mirrors:
        share = 2 ** len(halving.scene.mirrors)
        lines.append(f"symmetry: `symmetry: allow` would solve one of {share} equal parts")
    if scene.guaranteed:
        lines.append(
            "error: a guaranteed bound, whose stresses take about "
            f"{stress_bytes(scene) / 1e9:.2g} GB and some time on top of the above"
        )
    if comm.rank == 0:
        console = Console(highlight=False, markup=False, soft_wrap=True)
        for line in lines:
            console.print(line)


def describe(scene: Scene, known: Outline) -> list[str]:
    """Lines of the report (collective)."""
    return [*modelled_lines(scene, known), "", *_cost_lines(scene, known)]


def modelled_lines(scene: Scene, known: Outline) -> list[str]:
    """What is modelled, how, and what is left out (collective)."""
    return [
        *_modelled(scene, known),
        *_cases(scene),
        "",
        *_decomposed(scene, known),
        "",
        *_left_out(scene, known),
    ]


def estimate(scene: Scene, known: Outline) -> Cost:
    """What a run costs, by the formulas of this module and of `memory` (collective)."""
    partition, d = known.partition, scene.dimension
    gluing, groups = _gluing_rows(scene, known), _groups(scene, known)
    contact = partition.comm.allreduce(len(known.contact.gaps))
    held = partition.comm.allreduce(int(known.held.held.sum()))
    rows = gluing + contact + (0 if known.eliminated.all() else held)
    dofs = partition.nodes * d
    memory = needed_bytes(dofs, rows, tuple((g.unknowns, d) for g in groups))
    seconds = STARTED + CELL_RATE[d] * partition.cells
    products = _products(scene, bool(gluing))
    seconds += PACE * run_seconds(groups, rows, products, bool(gluing))
    seconds += STEP_SECONDS * products if gluing else 0.0
    return Cost(memory, seconds)


def _products(scene: Scene, glued: bool) -> float:
    """Applications of the dual operator expected: more for slender bodies and more digits."""
    slenderness = 1.0
    for body in scene.bodies:
        edges = np.subtract(body.mesh.upper, body.mesh.lower)[: scene.dimension]
        slenderness = max(slenderness, float(edges.max() / edges.min()))
    digits = max(-math.log10(scene.solver.expected_tolerance), 2.0) / 6.0
    products = PRODUCTS_GLUED if glued else PRODUCTS_WHOLE
    return float(products * math.sqrt(slenderness) * digits**0.6)


def _modelled(scene: Scene, known: Outline) -> list[str]:
    kind = {"strain": "2D, plane strain", "stress": "2D, plane stress", None: "3D"}[scene.plane]
    partition = known.partition
    dofs = partition.nodes * scene.dimension
    lines = [
        f"{scene.title or scene.source.name} ({kind})",
        f"  {partition.cells:,} cells, {partition.nodes:,} nodes, {dofs:,} degrees of freedom",
    ]
    for i, body in enumerate(scene.bodies):
        materials = "; ".join(
            f"Young's modulus {m.young:g}, Poisson's ratio {m.poisson:g}"
            + (f", expansion {m.expansion:g} per degree" if m.expansion else "")
            for m in body.materials
        )
        element = ", degree 2" if body.degree == 2 else ""
        if body.mean_dilatation:
            element = ", change of volume as its mean over cells"
        lines.append(f"body {body.name}: {body.mesh.describe()}{element}, {materials}")
        ends = (_vector(corner) for corner in (body.mesh.lower, body.mesh.upper))
        lines.append("  from {} to {}".format(*ends))
        lines += [f"  {note}" for note in body.mesh.notes]
        if not scene.loadings:
            lines.append(f"  load in all {_vector(_resultant(known, i, scene.dimension))}")
    lines += _held(scene, known)
    for traction in scene.tractions:
        lines.append(
            f"{_name(traction)}: {_on(scene, traction)} loaded by {_vector(traction.vector)} per "
            f"area {_facets(scene, known, traction)}"
        )
    for pressure in scene.pressures:
        lines.append(
            f"{_name(pressure)}: {_on(scene, pressure)} under a pressure of {pressure.value:g} "
            f"{_facets(scene, known, pressure)}"
        )
    for load, linear in zip(scene.total_loads, known.linear, strict=True):
        lines.append(
            f"{_name(load)}: {_on(scene, load)} loaded by a total force {_vector(load.force)}"
            f"{_moment(scene, load)} on an area of {linear.area:.4g}"
        )
    for force in scene.forces:
        lines.append(
            f"{_name(force)}: {scene.bodies[force.body].name} loaded by {_vector(force.vector)} "
            "per volume"
        )
    for heat in scene.temperatures:
        lines.append(
            f"{_name(heat)}: {scene.bodies[heat.body].name} warmer by {heat.rise.text} than free "
            "of stress"
        )
    lines += rigid_lines(scene)
    for i, contact in enumerate(scene.contacts):
        obstacle = contact.obstacle.describe(scene.dimension)
        whose = "" if contact.rigid is None else f"{scene.rigid_bodies[contact.rigid].name}, a "
        lines.append(
            f"{contact.source}: {_on(scene, contact)} may touch {whose or 'the '}{obstacle} "
            f"({_candidates(known, i, _count_nodes(scene, known, contact))})"
            f"{_friction(contact)}{_interference(contact)}"
        )
    gaps, sources = known.candidates
    hints = far_obstacle_hints(scene, gaps, sources, partition.comm)
    lines += [f"warning: {hint}" for hint in hints]
    for i, pair in enumerate(scene.pairs, start=len(scene.contacts)):
        other = f"{scene.bodies[pair.other].name}.{pair.other_boundary}"
        lines.append(
            f"{pair.source}: {_on(scene, pair)} may touch {other}, by a mortar method "
            f"({_candidates(known, i)}){_friction(pair)}{_interference(pair)}"
        )
    for tie in scene.ties:
        other = f"{scene.bodies[tie.other].name}.{tie.other_boundary}"
        on = f"{scene.bodies[tie.body].name}.{tie.boundary}"
        lines.append(f"{tie.source}: {on} is tied to {other}, by a mortar method")
    lines += [f"warning: {note}" for note in known.tied.notes]
    return lines


def _held(scene: Scene, known: Outline) -> list[str]:
    """Displacement conditions, a line each (collective)."""
    lines = []
    for condition in scene.displacements:
        held = ", ".join(
            f"{axis} = {value:g}"
            for axis, value in zip("xyz", condition.values, strict=False)
            if value is not None
        )
        lines.append(
            f"{_name(condition)}: {_on(scene, condition)} displaced by {held} "
            f"({_count_nodes(scene, known, condition):,} nodes)"
        )
    return lines


def _friction(contact: Contact | BodyContact) -> str:
    """The law of friction of a contact; nothing where there is none."""
    law = contact.friction
    if law is None:
        return ""
    if law.coulomb is not None:
        return f", with Coulomb friction of {law.coulomb:g}"
    return f", with Tresca friction up to {law.tresca:g} per area"


def _interference(contact: Contact | BodyContact) -> str:
    """What a contact says beside its geometry."""
    amount = contact.interference
    if not amount:
        return ""
    return f", with {'an interference' if amount > 0.0 else 'a clearance'} of {abs(amount):g}"


def _name(condition: Condition) -> str:
    """Where a condition stands in the file, and its name if it has one."""
    return f"{condition.source} ({condition.name})" if condition.name else condition.source


def _cases(scene: Scene) -> list[str]:
    """The factors of each case or step."""
    lines = []
    for case in scene.cases:
        factors = ", ".join(f"{factor:g} × {name}" for name, factor in case.factors if factor)
        lines.append(f"case {case.name}: {factors or 'what has no name'}")
    for number, step in enumerate(scene.steps, start=1):
        ends = ", ".join(f"{name} {factor:g}" for name, factor in step.factors)
        lines.append(f"step {number}: to {ends}, in {step.increments} increments")
    return lines


def _loads_on_bodies(scene: Scene, known: Outline) -> list[str]:
    """The load in all on each body of a case (collective)."""
    d = scene.dimension
    return [
        f"load on {body.name} in all {_vector(_resultant(known, i, d))}"
        for i, body in enumerate(scene.bodies)
    ]


def _decomposed(scene: Scene, known: Outline) -> list[str]:
    partition = known.partition
    groups = _groups(scene, known)
    many = partition.count > 1
    if is_undecomposed(scene):
        why = "on bodies from mesh files its iterations do not grow with the size"
        return [
            f"method: primal, multigrid on the undecomposed bodies; {why}; one subdomain for each "
            "body and rank, none factored"
        ]
    lines = [
        f"decomposition: {partition.count} subdomain{'s' * many} of about "
        f"{partition.nodes * scene.dimension / partition.count:,.0f} unknowns, {len(groups)} of "
        f"them different on this process: one factor each; {_gluing_rows(scene, known):,} rows "
        "glue them"
    ]
    obstacles = [body.name for body in scene.rigid_bodies if body.name not in scene.body_names]
    lines += [f"  {name}: held in all components: an obstacle" for name in obstacles]
    whole = np.append(known.eliminated, np.zeros(len(scene.moving), bool))
    for name, found, eliminated in zip(scene.body_names, known.balances, whole, strict=True):
        if eliminated:
            how = "one held subdomain: no gluing and no coarse problem"
        elif name not in [body.name for body in scene.bodies] and not found.free_motions.shape[1]:
            how = "rigid, all kernel: kept by what it touches and its conditions"
        elif found.held:
            how = "held by its conditions; its subdomains float (Total FETI)"
        elif found.free_motions.shape[1]:
            how = (
                f"free along {found.free_motions.shape[1]} rigid motions no load works on: it is "
                "held where it is"
            )
        else:
            how = "kept by what it touches alone, or by that and its conditions"
        lines.append(f"  {name}: {how}")
    if not scene.touching:
        lines.append("  no contacts: plain conjugate gradients")
    if may_peel(scene):
        lines.append(
            f"method: Total FETI; after {PATIENCE} iterations the undecomposed bodies are solved "
            "with factors, since contact of thin bodies may peel off row by row"
        )
    return lines


def _left_out(scene: Scene, known: Outline) -> list[str]:
    notes = [*left_out_notes(scene, known), *_repeated(scene)]
    notes += [] if scene.loadings else _unloaded(scene, known)
    notes = said_once(notes, [body.name for body in scene.bodies])
    lines = ["left out:", *(f"  {sentence}" for sentence in notes)]
    smooth = [contact.source for contact in scene.touching if contact.friction is None]
    if smooth:
        of = f" of {', '.join(dict.fromkeys(smooth))}" if scene.has_friction else ""
        lines.append(f"  friction: contact forces{of} are normal to the surface")
    if scene.has_friction and not scene.steps:
        lines.append("  the history of loads: slips are measured from the undeformed state")
    lines += [f"  {sentence}" for sentence in LEFT_OUT]
    if scene.plane:
        lines.append(f"  the third direction: it is plane {scene.plane}, per unit of thickness")
    if any(contact.obstacle.curvature_radius for contact in scene.contacts):
        lines.append(
            "  curvature of the obstacles under sliding nodes: the run warns where it matters"
        )
    return lines


def _repeated(scene: Scene) -> list[str]:
    """Contacts that add no rows because another says the same."""
    contacts = scene.contacts
    return [
        f"{later.source}: repeats {earlier.source} and adds no rows"
        for j, later in enumerate(contacts)
        for earlier in contacts[:j]
        if replace(later, source=earlier.source) == earlier
    ]


def _unloaded(scene: Scene, known: Outline) -> list[str]:
    """Bodies that nothing loads, moves or overlaps."""
    comm = known.partition.comm
    acted = np.zeros(len(scene.bodies), bool)
    for s, load in zip(known.partition.subdomains, known.loads, strict=True):
        acted[s.body] |= load is not None and bool(load.any())
    for condition in scene.displacements:
        acted[condition.body] |= any(condition.values)
    for rigid in scene.contacts:
        acted[rigid.body] |= rigid.rigid is not None
    gaps, sources = known.candidates
    touched = np.array([c.body for c in scene.touching], int)
    acted[touched[sources[gaps < 0.0]]] = True
    for pair in scene.pairs:  # what the one does the other feels
        acted[[pair.body, pair.other]] = True
    acted = comm.allreduce(acted.astype(int)) > 0
    return [
        f"{body.name}: has no load, no prescribed displacement and no overlap; it does not deform"
        for body, some in zip(scene.bodies, acted, strict=True)
        if not some
    ]


def _cost_lines(scene: Scene, known: Outline) -> list[str]:
    cost = estimate(scene, known)
    each = "for the first case and less for each later one, " if scene.cases else ""
    if scene.steps:
        each = "for the first increment and less for each later one, "
    lines = [
        f"memory: about {cost.memory / 1e9:.2g} GB of {available_bytes() / 1e9:.3g} GB available",
        f"time: about {_duration(cost.seconds)} {each}on one process of two cores, within a factor "
        "of two or three on other machines; several times longer where the scene is badly "
        "conditioned (thin cells, Poisson's ratio near 0.5, bodies of unlike stiffness)",
        "checked: names, sizes, boundaries, contradictions and equilibrium; nothing was solved",
    ]
    if cost.memory > available_bytes():
        lines.insert(1, "  which is more than there is: use a coarser mesh or more subdomains")
    return lines


def _groups(scene: Scene, known: Outline) -> list[Group]:
    """Subdomains of this rank by shape and material."""
    members: dict[tuple, list[int]] = {}
    for local, s in enumerate(known.partition.subdomains):
        key: tuple = (id(s.reference), scene.bodies[s.body].materials)
        if known.eliminated[s.body]:
            key = (*key, s.body)
        members.setdefault(key, []).append(local)
    groups = []
    for numbers in members.values():
        s = known.partition.subdomains[numbers[0]]
        interface = len(known.surface.local[numbers[0]])
        if known.eliminated[s.body]:
            first, last = known.partition.first_node[s.body : s.body + 2]
            nodes = known.contact.entries.node
            interface = len(np.unique(nodes[(nodes >= first) & (nodes < last)]))
        d = scene.dimension
        unknowns = len(s.reference.points) * d
        groups.append(
            Group(d, unknowns, interface * d, len(numbers), _reflections(scene, known, s))
        )
    return groups


def _reflections(scene: Scene, known: Outline, s: Subdomain) -> int:
    """Reflections, their products and the identity that a subdomain is expected to have."""
    graph = isinstance(scene.decomposition.subdomains, int)
    if known.eliminated[s.body] or graph or not scene.bodies[s.body].mesh.congruent:
        return 1
    return 2**scene.dimension if s.reference.cell in ("quadrilateral", "hexahedron") else 2


def _gluing_rows(scene: Scene, known: Outline) -> int:
    """Rows of B that glue: one less than the copies of each shared unknown."""
    comm = known.partition.comm
    distinct = comm.allreduce(len(_unique(known, [known.surface.nodes])))
    return int((comm.allreduce(len(known.surface.nodes)) - distinct) * scene.dimension)


def _unique(known: Outline, nodes: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Distinct node numbers of all ranks on rank 0, none elsewhere."""
    here = np.unique(np.concatenate([np.zeros(0, np.int64), *nodes]))
    parts = known.partition.comm.gather(here)
    return here[:0] if parts is None else np.unique(np.concatenate(parts))


def _count_nodes(scene: Scene, known: Outline, condition: DisplacementCondition | Contact) -> int:
    body = scene.bodies[condition.body]
    nodes = [
        s.nodes[boundary_nodes(s, body, condition.boundary)]
        for s in known.partition.subdomains
        if s.body == condition.body
    ]
    return int(known.partition.comm.allreduce(len(_unique(known, nodes))))


def _facets(scene: Scene, known: Outline, load: Traction | Pressure) -> str:
    count, area = loaded_facets(scene, known.partition, load)
    return f"({count:,} facets, area {area:.4g})"


def _candidates(known: Outline, contact: int, on_boundary: int = 0) -> str:
    """How many nodes may touch of those on the boundary, and how near they are."""
    comm = known.partition.comm
    gaps, sources = known.candidates
    smallest = comm.allreduce(float(gaps[sources == contact].min(initial=np.inf)), op=MPI.MIN)
    if np.isinf(smallest):
        return "no candidate nodes left: other conditions decide on all of them"
    count = comm.allreduce(int((known.contact.sources == contact).sum()))
    if count == 0:
        return f"none of its nodes can come that far, smallest gap {smallest:.4g}"
    others = max(on_boundary - comm.allreduce(int((sources == contact).sum())), 0)
    decided = f" and {others:,} that are held or decided by other contacts" if others else ""
    return f"{count:,} candidate nodes{decided}, smallest gap {smallest:.4g}"


def _resultant(known: Outline, body: int, dimension: int) -> tuple[float, ...]:
    """Sum of the loads on a body."""
    total = np.zeros(dimension)
    for s, load in zip(known.partition.subdomains, known.loads, strict=True):
        if s.body == body and load is not None:
            total += load.reshape(-1, dimension).sum(axis=0)
    total = known.partition.comm.allreduce(total)
    total[np.abs(total) < 1e-12 * np.abs(total).max(initial=0.0)] = 0.0
    return tuple(total)


def _moment(scene: Scene, load: TotalLoad) -> str:
    if not any(load.moment) and load.at is None:
        return ""
    moment = load.moment if scene.dimension == 3 else load.moment[2:]
    where = "its centroid" if load.at is None else _vector(load.at[: scene.dimension])
    return f" and a moment {_vector(moment)} at {where}"


Named = DisplacementCondition | Traction | TotalLoad | Pressure | Contact | BodyContact
"""What acts on a boundary of a body."""


def _on(scene: Scene, item: Named) -> str:
    return f"{scene.bodies[item.body].name}.{item.boundary}"


def _vector(vector: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in vector) + ")"


def _duration(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.1g} s" if seconds < 10.0 else f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
