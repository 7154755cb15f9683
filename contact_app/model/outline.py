"""The outline of a model: all data that need no assembled or factored matrices.

Meshes, subdomains and the coefficients of all rows are independent of loads. Load vectors,
prescribed displacements, gaps and the balance of each body belong to a load case, and
`outline_of_case` computes only these.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.machine.ranks import agreed
from contact_app.machine.timings import Timings
from contact_app.model.assembly import Element
from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.model.candidates import Needed, distinct
from contact_app.model.conditions import (
    contradiction,
    mortar_rows,
    node_conditions,
    refuse_empty_boundaries,
    rows_in_the_mean,
)
from contact_app.model.decomposition import choose_split
from contact_app.model.equilibrium import body_balances, groups_in_contact
from contact_app.model.friction import always_rough, rough_contacts
from contact_app.model.geometry import Geometry
from contact_app.model.heat import node_temperatures, thermal_loads
from contact_app.model.loads import Loads, load_vectors
from contact_app.model.mean_motions import mean_motion_rows
from contact_app.model.method import is_undecomposed
from contact_app.model.probes import Probe, locate_probes
from contact_app.model.rigid import exchange_with, moving_contacts, moving_rows
from contact_app.model.rigid_ties import ContactsAndTies
from contact_app.model.sections import SectionPiece, locate_sections
from contact_app.model.surface_copies import SurfaceCopies
from contact_app.model.tangential_rows import tangential_rows
from contact_app.model.ties import TiedRows, tied_rows, without_determined
from contact_app.model.total_loads import LinearTraction, linear_tractions
from contact_app.scene.conditions import DisplacementCondition
from contact_app.scene.scene import Scene
from meshes import Partition, decompose
from meshes.arrays import Array, Mask
from solver.contact.equilibrium import BodyBalance
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows, ContradictionError, HeldRows
from solver.problem.constraints.friction import FrictionRows
from solver.problem.constraints.merge import merge_contact, merge_held
from solver.problem.constraints.shared_rows import SharedRows


def partition_scene(scene: Scene, comm: MPI.Intracomm) -> Partition:
    """Cut the scene's bodies into subdomains.

    Raises
    ------
    ConfigurationError
        The requested decomposition is impossible.
    """
    try:
        shapes = [body.mesh.shape(body.degree) for body in scene.bodies]
        choose = partial(choose_split, single=len(shapes) == 1)
        subdomains = scene.decomposition.subdomains
        if subdomains is None and is_undecomposed(scene.solver):  # the fewest possible
            subdomains = max(len(shapes), comm.size)
        return decompose(shapes, subdomains, comm, choose)
    except ValueError as error:
        raise ConfigurationError(f"{scene.at('decomposition')}: {error}") from error


@dataclass(frozen=True, eq=False)
class CandidateRows:
    """The rows of conditions, contacts and ties that this rank owns."""

    held: HeldRows
    contact: ContactRows
    """Candidate rows of all contacts."""
    merged: ContactRows
    """Rows that a candidate row of the same node makes redundant."""
    tied: TiedRows
    """Rows of tied pairs."""


@dataclass(frozen=True, eq=False)
class ActingLoads:
    """The loads of a scene on the subdomains of this rank."""

    linear: tuple[LinearTraction, ...]
    """The tractions of total forces and moments."""
    vectors: list[Array | None]
    """Load vector of each subdomain; None without loads."""
    temperatures: list[Array | None]
    thermal: list[Array | None]
    """Temperatures at the nodes of each subdomain, and thermal loads; None without heat."""


@dataclass(frozen=True, eq=False)
class Outline:
    """The outline of a model: all data that need no assembled or factored matrices."""

    geometry: Geometry
    surface: SurfaceCopies
    exchange: NodeExchange
    uncut: tuple[ContactRows, ...]
    """Rows of contacts on averages, before held components are removed."""
    rows: CandidateRows
    needed: Mask
    """Mask of the candidate rows that become contact rows."""
    elements: dict[int, Element]
    """Finite-element forms by the identity of their reference."""
    acting: ActingLoads
    probes: tuple[Probe, ...]
    """The cells of the probes' points."""
    sections: tuple[SectionPiece, ...]
    """The cells on either side of planes with requested section forces."""
    means: ContactRows
    """Rows that hold rigid motions of bodies in the mean."""
    balances: list[BodyBalance]
    """Equilibrium of each body, elastic ones first, then moving rigid ones."""
    friction: FrictionRows
    """Tangential rows at all candidate rows of this rank."""

    @property
    def partition(self) -> Partition:
        """The subdomains."""
        return self.geometry.partition

    @cached_property
    def contact(self) -> ContactRows:
        """The contact rows of this rank."""
        return self.rows.contact.of(self.needed)

    @cached_property
    def left_out(self) -> ContactRows:
        """The other candidate rows."""
        return self.rows.contact.of(~self.needed)

    @cached_property
    def tangential(self) -> FrictionRows:
        """Tangential rows at the contact rows of this rank."""
        return self.friction.at(self.contact)

    @property
    def shared(self) -> SharedRows:
        """The rows over nodes of several ranks."""
        return SharedRows(self.contact, self.tangential, self.rows.tied.rows, self.means)

    @cached_property
    def eliminated(self) -> Mask:
        """Mask (bodies,) of bodies that are one held subdomain: no gluing, no coarse problem.

        With friction all bodies float, as its active sets need a coarse problem.
        """
        single = np.array([n == 1 for n in self.partition.subdomains_of_body])
        held = np.array([b.held for b in self.balances[: len(single)]])
        return single & held & (not self.friction.acts)


Report = Callable[[Scene, Outline], None]


def outline_of_scene(
    scene: Scene, comm: MPI.Intracomm, timings: Timings | None = None, needed: Needed = "all"
) -> Outline:
    """Cut into subdomains, find conditions, loads and their equilibrium (collective).

    Parameters
    ----------
    timings
        Timings to which the time of each stage is added.
    needed
        Candidate rows that become contact rows; if these are not all, the caller has to test the
        answer in the others.

    Raises
    ------
    NoEquilibriumError
        A body leaves, or conditions on a node exclude each other.
    ConfigurationError
        The decomposition is impossible or a boundary is empty.
    """
    timings = timings or Timings()
    with timings.measure("setup"):
        partition = partition_scene(scene, comm)
    geometry = Geometry.of(scene, partition)
    surface, probes = SurfaceCopies(partition), locate_probes(geometry, scene.output.probes)
    exchange = exchange_with(surface, partition, len(scene.moving))
    uncut = tuple(
        mortar_rows(geometry, exchange, pair, i)
        for i, pair in enumerate(scene.pairs, start=len(scene.contacts))
    )
    uncut += tuple(
        rows_in_the_mean(geometry, exchange, c, i)
        for i, c in enumerate(scene.contacts)
        if has_averaged_rows(scene.bodies[c.body]) and c.rigid not in scene.moving
    )
    rows = _written_rows(geometry, scene.displacements, exchange, uncut)
    elements: dict[int, Element] = {}
    for subdomain in partition.subdomains:
        reference = subdomain.reference
        if id(reference) not in elements:
            elements[id(reference)] = Element(reference, scene.dimension)
    means = mean_motion_rows(geometry, exchange, elements, rows.held)
    acting = _acting(geometry, Loads.of(scene), elements, timings)
    loads = acting.vectors, scene.in_step
    friction, balances = _friction_and_balances(geometry, exchange, rows, *loads)
    if isinstance(needed, str):
        some = _distinct(geometry, rows.contact, balances)
        needed = np.ones(len(some), bool) if needed == "all" else some
    sections = locate_sections(geometry, scene.output.sections)
    return Outline(
        geometry, surface, exchange, uncut, rows, needed, elements, acting, probes, sections,
        means, balances, friction,
    )  # fmt: skip


def outline_of_case(
    outline: Outline, scene: Scene, timings: Timings | None = None
) -> Outline | None:
    """The outline of a scene that differs from a known one in the factors of its conditions.

    Meshes, subdomains and coefficients of rows are shared (collective).

    Returns
    -------
    None if the displacements change which rows are redundant, or if the scene has rigid bodies:
    then it needs a model of its own.

    Raises
    ------
    NoEquilibriumError
        A body leaves, or conditions on a node exclude each other.
    """
    if scene.rigid.bodies:  # each case has other placements
        return None
    timings, exchange = timings or Timings(), outline.exchange
    geometry = Geometry.of(scene, outline.partition)
    means, rows = outline.means, outline.rows
    if any(condition.name is not None for condition in scene.displacements):
        rows = _written_rows(geometry, scene.displacements, exchange, outline.uncut)
        means = mean_motion_rows(geometry, exchange, outline.elements, rows.held)
        same = _same_rows(rows.contact, outline.rows.contact)
        if not geometry.comm.allreduce(int(same), op=MPI.MIN):
            return None
    acting = _acting(geometry, Loads.of(scene), outline.elements, timings)
    loads = acting.vectors, scene.in_step
    friction, balances = _friction_and_balances(geometry, exchange, rows, *loads)
    needed = _distinct(geometry, rows.contact, balances)
    return replace(
        outline, geometry=geometry, rows=rows, needed=needed, acting=acting, means=means,
        balances=balances, friction=friction,
    )  # fmt: skip


def _written_rows(
    geometry: Geometry,
    displacements: Sequence[DisplacementCondition],
    exchange: NodeExchange,
    uncut: Sequence[ContactRows],
) -> CandidateRows:
    """The rows of conditions, contacts and ties (collective)."""
    with agreed(geometry.comm):
        conditions = node_conditions(geometry, displacements)
    refuse_empty_boundaries(geometry, displacements, conditions)
    moving = np.isin(conditions.contact_source, moving_contacts(geometry))
    fixed = conditions.of_contacts(~moving)
    try:
        held = merge_held(exchange, conditions)
        contact, merged = merge_contact(exchange, fixed, held, geometry.length, uncut)
        if geometry.rigid.moving:
            of_moving = conditions.of_contacts(moving)
            on_motions = moving_rows(geometry, exchange, of_moving, held)
            contact, merged = (
                ContactRows.join([a, b]) for a, b in zip((contact, merged), on_motions, strict=True)
            )
    except ContradictionError as error:
        raise contradiction(geometry, displacements, error) from error
    tied = tied_rows(geometry, exchange, held)
    contact, determined = without_determined(ContactsAndTies(geometry, contact, tied.rows))
    return CandidateRows(held, contact, ContactRows.join([merged, determined]), tied)


def _friction_and_balances(
    geometry: Geometry,
    exchange: NodeExchange,
    rows: CandidateRows,
    loads: Sequence[Array | None],
    in_step: bool,
) -> tuple[FrictionRows, list[BodyBalance]]:
    """Tangential rows and the equilibrium of each body (collective)."""
    held, contact, tied = rows.held, rows.contact, rows.tied.rows
    rough = rough_contacts(geometry, exchange, held)
    friction = tangential_rows(exchange, rough, contact, rows.merged, held, tied)
    return friction, body_balances(geometry, (held, tied), contact, loads, friction, in_step)


def _acting(
    geometry: Geometry, loads: Loads, elements: dict[int, Element], timings: Timings
) -> ActingLoads:
    """The loads of a scene on its subdomains (collective)."""
    with timings.measure("assembly"):
        linear = linear_tractions(geometry, elements, loads.totals)
        vectors = load_vectors(geometry, loads, elements, linear)
        with agreed(geometry.comm):
            temperatures = node_temperatures(geometry, loads.temperatures)
        with agreed(geometry.comm):
            thermal = thermal_loads(geometry, elements, loads.plane, loads.temperatures)
    return ActingLoads(linear, vectors, temperatures, thermal)


def _same_rows(one: ContactRows, other: ContactRows) -> bool:
    """Whether two sets of rows belong to the same contacts at the same nodes."""
    return np.array_equal(one.nodes, other.nodes) and np.array_equal(one.sources, other.sources)


def _distinct(geometry: Geometry, contact: ContactRows, balances: Sequence[BodyBalance]) -> Mask:
    """Mask of the candidate rows that become contact rows, (rows,)."""
    touching = geometry.touching
    steady, held = np.array([b.steady for b in balances]), np.zeros(len(balances), bool)
    for group in groups_in_contact(geometry):
        held[group] = steady[group].all()
    of_contacts = np.array([held[item.body] for item in touching], bool)
    return distinct(contact, of_contacts) | always_rough(touching, contact)


def left_out_notes(outline: Outline) -> list[str]:
    """A sentence on the contact rows of each contact that are left out (collective)."""
    touching = outline.geometry.touching
    count = len(touching)
    numbers = [
        np.bincount(rows.sources, minlength=count) for rows in (outline.left_out, outline.contact)
    ]
    repeated, used = outline.partition.comm.allreduce(np.stack(numbers))
    return [
        f"{item.source}: at {repeated[i]:,} of {repeated[i] + used[i]:,} candidate nodes another "
        "contact is nearer in nearly the same direction, and they have no row; if the answer "
        "penetrates them, they get rows and the scene is solved again"
        for i, item in enumerate(touching)
        if repeated[i]
    ]
