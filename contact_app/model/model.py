"""Construction of the dual problem of a scene: subdomains, loads, conditions at nodes, rows of B.

A body that is one subdomain and whose held nodes stop every rigid motion needs no gluing and no
coarse problem: its held unknowns are eliminated. Every other subdomain floats, as in Total FETI,
and its conditions are rows of B.

Load cases of a scene differ in load vectors, prescribed displacements and gaps alone
(`model_of_case`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from mpi4py import MPI

from contact_app.machine.memory import give_back
from contact_app.machine.timings import Timings
from contact_app.model.assembly import Element
from contact_app.model.candidates import Needed
from contact_app.model.equilibrium import directions_in_words, group_numbers, loose_bodies, upward
from contact_app.model.friction import without_area
from contact_app.model.geometry import Geometry
from contact_app.model.method import feti_options, is_undecomposed
from contact_app.model.normal_forces import NormalForces
from contact_app.model.outline import Outline, Report, outline_of_scene
from contact_app.model.pairs import doubled_pairs
from contact_app.model.probes import Probe, shared_probes
from contact_app.model.rigid import RigidUnknowns, rigid_subdomains, subdomains_of_copies
from contact_app.model.rigid_ties import ContactsAndTies, rough_at_tied_nodes
from contact_app.model.sections import SectionPiece
from contact_app.model.supports import support_rows
from contact_app.model.total_loads import LinearTraction
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import RigidTie
from contact_app.scene.material import Material
from contact_app.scene.rigid import idle_loads
from contact_app.scene.scene import Scene
from meshes import Partition
from meshes.arrays import Array, Ints, Mask
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows
from solver.problem.parts import NodePlaces
from solver.tfeti.build import CongruentSubdomains, ConstraintRows, build_problem
from solver.tfeti.constraints.options import TotalFetiOptions
from solver.tfeti.constraints.rows import write_rows
from solver.tfeti.dual import DualProblem

Part = TypeVar("Part")


@dataclass(frozen=True, eq=False)
class Model:
    """The discrete model of a scene."""

    scene: Scene
    geometry: Geometry
    """The bodies, cut into subdomains."""
    problem: DualProblem
    place: Ints  # (subdomains, 2)
    """Class and column of each subdomain of this rank, which locate its vectors."""
    elements: tuple[Element, ...]
    """Finite-element forms of each class, for stresses and areas."""
    materials: tuple[tuple[Material, ...], ...]
    """Materials of each class, by the tags of its cells."""
    needed: Mask
    left_out: ContactRows
    """Mask of this rank's candidate rows that are contact rows, and the other candidates, in which
    the answer is tested."""
    merged: ContactRows
    """Rows that a tighter parallel row of the same node makes redundant."""
    node_exchange: NodeExchange
    """Exchange of all nodes (not only surface nodes) with their owners."""
    linear: tuple[LinearTraction, ...] = ()
    """The tractions of total forces and moments."""
    probes: tuple[Probe, ...] = ()
    """Cells of the points at which the displacement is written."""
    temperatures: tuple[Array | None, ...] = ()
    """Temperatures at the nodes of each class, (nodes, members); None for classes without heat."""
    sections: tuple[SectionPiece, ...] = ()
    """Cells on both sides of the planes of section forces."""
    notes: tuple[str, ...] = ()
    """Sentences on how the scene is modelled, for the log."""
    cautions: tuple[str, ...] = ()
    """The notes that are warnings of an answer, too."""
    pressed_before: NormalForces | None = None
    """Normal forces at the beginning of an increment; None where it begins without loads."""

    @property
    def partition(self) -> Partition:
        """The subdomains."""
        return self.geometry.partition

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""
        return self.partition.comm

    def elastic(self, values: Sequence[Part]) -> Sequence[Part]:
        """The values of classes with a mesh, without rigid bodies."""
        return values[: len(self.elements)]

    @cached_property
    def dofs(self) -> int:
        """Undecomposed degrees of freedom, held ones included."""
        return self.partition.nodes * self.scene.dimension


def build_model(
    scene: Scene,
    comm: MPI.Intracomm,
    timings: Timings | None = None,
    needed: Needed = "all",
    report: Report | None = None,
    options: TotalFetiOptions | None = None,
) -> Model:
    """Mesh, assemble, write the constraints, factor; parameters and errors of `outline`.

    Parameters
    ----------
    report
        Called with the scene and its outline before anything is assembled (collective).
    options
        Options of the constraints and the coarse problem.
    """
    timings = timings or Timings()
    with timings.measure("setup"):
        outline = outline_of_scene(scene, comm, timings, needed)
        if report is not None:
            report(scene, outline)
        return model_of_outline(scene, outline, timings, options)


def model_of_case(model: Model, outline: Outline, scene: Scene) -> Model:
    """The model of a scene that differs in the factors of its conditions alone (collective).

    It shares the meshes, constraints and factors of the model, and has its own loads, prescribed
    displacements and gaps.

    Parameters
    ----------
    outline
        The outline of the scene, with the contact rows of the model.
    """
    lifting, members = _lifting(outline), _members(model)
    vectors = [_vectors(outline, m, lifting) for m in members]
    c = model.problem.right_hand_side(outline.rows.held, outline.shared)
    case = model.problem.with_loads(
        [forces for forces, _, _ in vectors], [lifted for _, _, lifted in vectors], c,
        [thermal for _, thermal, _ in vectors],
    )  # fmt: skip
    return replace(
        model, scene=scene, problem=case, needed=outline.needed, left_out=outline.left_out,
        merged=outline.rows.merged, linear=outline.acting.linear,
        temperatures=tuple(_temperatures(outline, m) for m in members),
        notes=_notes(outline, is_undecomposed(scene.solver), case), cautions=_cautions(outline),
    )  # fmt: skip


def _members(model: Model) -> list[list[int]]:
    """Local numbers of the subdomains of each class, by column."""
    members: list[list[int]] = [[-1] * cls.members for cls in model.problem.classes]
    for local, (cls, column) in enumerate(model.place):
        members[cls][column] = local
    return members


def model_of_outline(
    scene: Scene, outline: Outline, timings: Timings, options: TotalFetiOptions | None = None
) -> Model:
    """Assemble, write the constraints, factor (collective)."""
    comm, options = outline.partition.comm, options or feti_options(scene.solver)
    partition, surface, exchange = outline.partition, outline.surface, outline.exchange
    held, balances, eliminated = outline.rows.held, outline.balances, outline.eliminated
    body_of_held = np.searchsorted(partition.first_node, held.nodes, side="right") - 1
    geometry, unknowns = outline.geometry, RigidUnknowns.of(outline.geometry)
    of_copies = subdomains_of_copies(surface, partition, unknowns.count)
    rows, shared = write_rows(
        exchange, of_copies, held, outline.shared, eliminated[body_of_held], options
    )
    supports = support_rows(geometry, surface, balances)
    lifting = _lifting(outline)
    classes = _congruent(scene.bodies, partition, lifting)
    place = np.empty((len(partition.subdomains), 2), np.int64)
    for number, members in enumerate(classes.values()):
        place[members, 0], place[members, 1] = number, np.arange(len(members))
    levels = is_undecomposed(scene.solver)
    with timings.measure("assembly"):
        subdomains = [
            _assembled(scene.plane, levels, outline, key, members, lifting)
            for key, members in classes.items()
        ] + rigid_subdomains(unknowns, surface, partition)
    steady = all(b.steady for b in balances)
    constraints = ConstraintRows(exchange, rows, shared, supports, steady)
    problem = build_problem(
        subdomains, constraints, group_numbers(geometry),
        lambda: timings.measure("factorization"), options, loose_bodies(scene.bodies, balances),
    )  # fmt: skip
    give_back()
    nodes = [np.zeros(0, np.int64), *(s.nodes for s in partition.subdomains)]
    return Model(
        scene=scene,
        geometry=geometry,
        problem=problem,
        place=place,
        elements=tuple(outline.elements[key[0]] for key in classes),
        materials=tuple(key[1] for key in classes),
        needed=outline.needed,
        left_out=outline.left_out,
        merged=outline.rows.merged,
        node_exchange=NodeExchange(comm, np.concatenate(nodes), partition.nodes),
        linear=outline.acting.linear,
        probes=outline.probes,
        temperatures=tuple(_temperatures(outline, members) for members in classes.values()),
        sections=outline.sections,
        notes=_notes(outline, levels, problem),
        cautions=_cautions(outline),
    )


def _notes(outline: Outline, undecomposed: bool, problem: DualProblem) -> tuple[str, ...]:
    """Sentences on how a scene is modelled (collective)."""
    partition, eliminated = outline.partition, outline.eliminated
    notes = [f"{body.name}: {note}" for body in outline.geometry.bodies for note in body.mesh.notes]
    notes += _cautions(outline)
    if undecomposed:
        notes.append("undecomposed bodies: conjugate gradients with algebraic multigrid")
    elif not eliminated.all():
        floating = int((~eliminated).sum())
        notes.append(
            f"Total FETI: {partition.count} subdomains, {floating} of {len(eliminated)} bodies "
            "with a coarse problem of rigid motions"
        )
    else:
        notes.append("every body is one held subdomain: no gluing, no coarse problem")
    if not problem.one_sided:
        notes.append("no contact rows: plain conjugate gradients")
    return tuple(notes)


def _cautions(outline: Outline) -> tuple[str, ...]:
    """Sentences on bodies that no load drives, loads and friction without effect, and ties.

    Collective.
    """
    geometry, rigid = outline.geometry, outline.geometry.rigid
    cautions = [
        f"{name} can move freely along {directions_in_words(upward(balance.free_motions))} and no "
        "load does work in that motion: the run holds it in its place"
        for name, balance in zip(geometry.body_names, outline.balances, strict=True)
        if balance.free_motions.shape[1]
    ]
    held = idle_loads(rigid.loads, rigid.motions, rigid.dimension)
    cautions += [
        f"{load.source}: {rigid.bodies[load.body].name} is held against this load: its "
        "reaction takes the load, which acts on no other body"
        for load in held
    ]
    touched = {contact.rigid for contact in geometry.contacts}
    touched |= {tie.rigid for tie in geometry.ties if isinstance(tie, RigidTie)}
    cautions += [
        f"{body.name}: no entry of `contacts` names this rigid body, and nothing touches it"
        for number, body in enumerate(rigid.bodies)
        if number not in touched
    ]
    cautions += doubled_pairs(geometry)
    cautions += without_area(geometry, outline.tangential)
    cautions += rough_at_tied_nodes(
        ContactsAndTies(geometry, outline.contact, outline.rows.tied.rows)
    )
    cautions += shared_probes(geometry, outline.probes)
    return (*cautions, *outline.rows.tied.notes)


ClassKey = tuple[int, tuple[Material, ...], bytes | None]
"""Key of a class of congruent subdomains: mesh, materials and eliminated unknowns."""


def _congruent(
    bodies: Sequence[Body], partition: Partition, lifting: "Sequence[Lifting | None]"
) -> dict[ClassKey, list[int]]:
    """Local numbers of the subdomains of each class."""
    classes: dict[ClassKey, list[int]] = {}
    for local, s in enumerate(partition.subdomains):
        lifted = lifting[local]
        held = None if lifted is None else lifted[0].tobytes()
        key = (id(s.reference), bodies[s.body].materials, held)
        classes.setdefault(key, []).append(local)
    return classes


def _assembled(
    plane: str | None,
    levels: bool,
    outline: Outline,
    key: ClassKey,
    members: list[int],
    lifting: "Sequence[Lifting | None]",
) -> CongruentSubdomains:
    """Stiffness and loads of a class.

    Parameters
    ----------
    levels
        Whether the nodes need data for the levels of a multigrid.
    """
    partition, surface, element = outline.partition, outline.surface, outline.elements[key[0]]
    stiffness = element.stiffness(key[1], plane)
    forces, thermal, lifted = _vectors(outline, members, lifting)
    held = lifting[members[0]]
    starts = surface.starts[members]
    nodes = surface.local[members[0]]
    return CongruentSubdomains(
        stiffness=stiffness,
        points=element.reference.points,
        nodes=nodes,
        copies=starts[:, None] + np.arange(len(nodes)),
        forces=forces,
        lifting=lifted,
        eliminated=None if held is None else held[0],
        bodies=np.array([partition.subdomains[local].body for local in members], np.int64),
        places=_places(partition, members, levels),
        thermal=thermal,
    )


def _vectors(
    outline: Outline, members: list[int], lifting: "Sequence[Lifting | None]"
) -> tuple[Array, Array | None, Array]:
    """Loads, their thermal part if any, and lifting of a class, (unknowns, members) each."""
    nodes = outline.partition.subdomains[members[0]].nodes
    forces, thermal, lifted = (
        np.zeros((outline.partition.dimension * len(nodes), len(members)), order="F")
        for _ in range(3)
    )
    for nth, local in enumerate(members):
        for sums, load in (
            (forces, outline.acting.vectors[local]),
            (thermal, outline.acting.thermal[local]),
        ):
            if load is not None:
                sums[:, nth] += load
        if (values := lifting[local]) is not None:
            lifted[values[0], nth] = values[1]
    return forces + thermal, thermal if thermal.any() else None, lifted


def _places(partition: Partition, members: list[int], levels: bool) -> NodePlaces:
    """Nodes of the subdomains of a class, with data for the levels of a multigrid."""
    subdomains = [partition.subdomains[local] for local in members]
    return NodePlaces(
        numbers=np.stack([s.nodes for s in subdomains]).astype(np.int64),
        translations=np.stack([s.translation for s in subdomains]),
        points=subdomains[0].reference.points,
        vertex_weights=subdomains[0].reference.vertex_weights if levels else None,
    )


def _temperatures(outline: Outline, members: list[int]) -> Array | None:
    """Temperatures of a class, (nodes, members); None without heat."""
    temperatures = [outline.acting.temperatures[local] for local in members]
    if all(t is None for t in temperatures):
        return None
    count = len(outline.partition.subdomains[members[0]].nodes)
    return np.stack([np.zeros(count) if t is None else t for t in temperatures], axis=1)


Lifting = tuple[Ints, Array]
"""Eliminated unknowns of a subdomain and their displacements."""


def _lifting(outline: Outline) -> list[Lifting | None]:
    """Eliminated unknowns of each subdomain and their displacements; None for floating ones.

    Collective.
    """
    if not outline.eliminated.any():
        return [None] * len(outline.partition.subdomains)
    exchange, surface, held = outline.exchange, outline.surface, outline.rows.held
    has_held = np.isin(exchange.nodes, held.nodes)
    at = np.searchsorted(held.nodes, exchange.nodes[has_held])
    mask, values = (np.zeros((len(has_held), held.held.shape[1]), kind) for kind in (bool, float))
    mask[has_held], values[has_held] = held.held[at], held.values[at]
    mask, values = exchange.from_owners(mask), exchange.from_owners(values)
    result: list[Lifting | None] = []
    for local, s in enumerate(outline.partition.subdomains):
        if not outline.eliminated[s.body]:
            result.append(None)
            continue
        part = surface.copies(local)
        node, component = np.nonzero(mask[part])
        unknowns = surface.local[local][node] * mask.shape[1] + component
        order = np.argsort(unknowns)
        result.append((unknowns[order], values[part][node, component][order]))
    return result
