"""From a scene to its dual problem: subdomains, loads, conditions at nodes, rows of B.

A body that is one subdomain and whose held nodes stop every rigid motion needs no gluing and no
coarse problem: its held unknowns are eliminated. Every other subdomain floats, as in Total FETI,
and its conditions are rows of B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha1

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from contact_app.machine.memory import give_back
from contact_app.machine.timings import Timings
from contact_app.model.assembly import Element
from contact_app.model.candidates import Needed
from contact_app.model.equilibrium import directions_in_words, group_numbers, upward
from contact_app.model.outline import Outline, Tell, outline
from contact_app.model.supports import SupportRows, support_rows
from contact_app.model.surface_copies import SurfaceCopies
from contact_app.scene.scene import Material, Scene
from meshes import Partition, Reference
from solver.tfeti.bodies import bodies_of
from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.coarse.gram import KernelRows
from solver.tfeti.coarse.row_patterns import Kind, kinds_of
from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.constraints.matrix import ConstraintMatrix
from solver.tfeti.constraints.nodal import nodal_rows
from solver.tfeti.constraints.rows import ContactRows, HeldRows, RowKind, Rows, write_rows
from solver.tfeti.dual import DualProblem
from solver.tfeti.subdomain.classes import subdomain_class


@dataclass(frozen=True, eq=False)
class Model:
    """A scene made ready to solve.

    Attributes
    ----------
    place : (subdomains, 2)
        Class and column of each subdomain of this rank: where its vectors are.
    elements
        Finite-element forms of each class, for stresses and areas.
    materials
        Materials of each class, by the tags of its cells.
    exchange
        Where the copies of surface nodes meet; `copies` gives their subdomain and local node.
    needed, left_out
        Which of this rank's candidate rows are contact rows, and the others, which the answer is
        held against.
    merged
        Rows that a tighter one of the same node in the same direction makes redundant.
    reach
        How far the nodes of each contact may come nearer, (contacts,).
    notes
        Sentences on what was left out or added, for `check`, the log and the certificate.
    """

    scene: Scene
    partition: Partition
    problem: DualProblem
    place: NDArray[np.int64]
    elements: tuple[Element, ...]
    materials: tuple[tuple[Material, ...], ...]
    needed: NDArray[np.bool_]
    left_out: ContactRows
    merged: ContactRows
    reach: NDArray[np.float64]
    notes: tuple[str, ...] = field(default=())

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""
        return self.partition.comm

    @cached_property
    def dofs(self) -> int:
        """Undecomposed degrees of freedom, held ones included."""
        return self.partition.nodes * self.scene.dimension

    @cached_property
    def node_exchange(self) -> NodeExchange:
        """Exchange of all nodes (not only surface nodes) with their owners."""
        nodes = [s.nodes for s in self.partition.subdomains]
        return NodeExchange(self.comm, np.concatenate(nodes), self.partition.nodes)


def build_model(
    scene: Scene,
    comm: MPI.Intracomm,
    timings: Timings | None = None,
    needed: Needed = "all",
    tell: Tell | None = None,
) -> Model:
    """Mesh, assemble, write the constraints, factor; parameters and errors of `outline`.

    Parameters
    ----------
    tell
        Called with the scene and its outline before anything is assembled (collective).
    """
    timings = timings or Timings()
    with timings.measure("setup"):
        known = outline(scene, comm, timings, needed)
        if tell is not None:
            tell(scene, known)
        return _built(scene, comm, timings, known)


def _built(scene: Scene, comm: MPI.Intracomm, timings: Timings, known: Outline) -> Model:
    """The model; all but assembly and factorization is set-up."""
    partition, surface, exchange = known.partition, known.surface, known.exchange
    held, contact, elements, loads = known.held, known.contact, known.elements, known.loads
    balances, eliminated = known.balances, known.eliminated
    body_of_held = np.searchsorted(partition.first_node, held.nodes, side="right") - 1
    rows, contact = write_rows(
        exchange, surface.subdomains, held, contact, eliminated[body_of_held]
    )
    supports = support_rows(scene, partition, surface, balances)
    lifting = _lifting(partition, surface, exchange, held, eliminated)

    problem, place, keys = _dual_problem(
        scene, partition, surface, exchange, rows, contact, supports, loads, lifting, elements,
        all(b.held for b in balances), timings,
    )  # fmt: skip
    notes = [f"{body.name}: {note}" for body in scene.bodies for note in body.mesh.notes]
    for body, found in zip(scene.bodies, balances, strict=True):
        if found.free_motions.shape[1]:
            freely = directions_in_words(upward(found.free_motions))
            notes.append(
                f"{body.name} can move freely along {freely} and no load works on that motion: it "
                "is held where it is"
            )
    if not eliminated.all():
        floating = int((~eliminated).sum())
        notes.append(
            f"Total FETI: {partition.count} subdomains, {floating} of {len(eliminated)} bodies "
            "with a coarse problem of rigid motions"
        )
    else:
        notes.append("every body is one held subdomain: no gluing, no coarse problem")
    if not comm.allreduce(int((problem.kinds == RowKind.CONTACT).sum())):
        notes.append("no contact rows: plain conjugate gradients")
    give_back()
    return Model(
        scene=scene,
        partition=partition,
        problem=problem,
        place=place,
        elements=tuple(elements[key[0]] for key in keys),
        materials=tuple(key[1] for key in keys),
        needed=known.needed,
        left_out=known.left_out,
        merged=known.merged,
        reach=known.reach,
        notes=tuple(notes),
    )


def _lifting(
    partition: Partition,
    surface: SurfaceCopies,
    exchange: NodeExchange,
    held: HeldRows,
    eliminated: NDArray[np.bool_],
) -> list[tuple[NDArray[np.int64], NDArray[np.float64]] | None]:
    """Eliminated unknowns of each subdomain and their displacements; None where it floats."""
    at = np.searchsorted(held.nodes, exchange.nodes)
    at = np.minimum(at, max(len(held.nodes) - 1, 0))
    if len(held.nodes):
        known = held.nodes[at] == exchange.nodes
        mask = held.held[at] & known[:, None]
        values = np.where(mask, held.values[at], 0.0)
    else:
        mask = np.zeros((len(exchange.nodes), held.held.shape[1]), bool)
        values = np.zeros(mask.shape)
    mask, values = exchange.from_owners(mask), exchange.from_owners(values)
    result: list[tuple[NDArray[np.int64], NDArray[np.float64]] | None] = []
    for local, s in enumerate(partition.subdomains):
        if not eliminated[s.body]:
            result.append(None)
            continue
        part = surface.copies(local)
        node, component = np.nonzero(mask[part])
        unknowns = surface.local[local][node] * mask.shape[1] + component
        order = np.argsort(unknowns)
        result.append((unknowns[order], values[part][node, component][order]))
    return result


def _dual_problem(
    scene: Scene,
    partition: Partition,
    surface: SurfaceCopies,
    exchange: NodeExchange,
    rows: Rows,
    contact: ContactRows,
    supports: SupportRows,
    loads: list[NDArray[np.float64] | None],
    lifting: list[tuple[NDArray[np.int64], NDArray[np.float64]] | None],
    elements: dict[int, Element],
    held_without_contact: bool,
    timings: Timings,
) -> tuple[DualProblem, NDArray[np.int64], list[tuple]]:
    """Group subdomains into classes, number the interface, build B, G and the factors."""
    comm, d = partition.comm, scene.dimension
    touched = exchange.from_owners(rows.touched(len(exchange.nodes), d))
    for copies, values in zip(supports.copies, supports.values, strict=True):
        touched[copies] |= values != 0.0

    groups: dict[tuple, list[int]] = {}
    for local, s in enumerate(partition.subdomains):
        lifted = lifting[local]
        held_key = None if lifted is None else lifted[0].tobytes()
        key = (id(s.reference), scene.bodies[s.body].materials, held_key)
        groups.setdefault(key, []).append(local)

    place = np.empty((len(partition.subdomains), 2), np.int64)
    columns = np.full(touched.shape, -1, np.int64)
    classes, class_loads, class_lifts = [], [], []
    size, failed = 0, ""
    alike = _meshed_by_all(comm, [elements[key[0]].reference for key in groups])
    for number, (key, members) in enumerate(groups.items()):
        place[members, 0], place[members, 1] = number, np.arange(len(members))
        lifted, local_nodes = lifting[members[0]], surface.local[members[0]]
        touched_by_any = np.zeros((len(local_nodes), d), bool)
        for local in members:
            touched_by_any |= touched[surface.copies(local)]
        with timings.measure("assembly"):
            stiffness = elements[key[0]].stiffness(key[1], scene.plane)
        sharing = comm if alike[number] and _made_by_all(comm, stiffness, lifted) else None
        if sharing is not None:
            comm.Allreduce(MPI.IN_PLACE, touched_by_any, op=MPI.LOR)
        node, component = np.nonzero(touched_by_any)
        with timings.measure("factorization"):
            points = elements[key[0]].reference.points
            try:
                cls = subdomain_class(
                    stiffness, points, d, local_nodes[node] * d + component, len(members),
                    None if lifted is None else lifted[0], sharing,
                )  # fmt: skip
            except (ArithmeticError, ValueError) as error:  # of this rank: the others go on
                failed = failed or f"{error}"
                continue
        place_of = np.full(cls.unknowns, -1, np.int64)
        place_of[cls.interface] = np.arange(len(cls.interface))
        position = place_of[local_nodes[:, None] * d + np.arange(d)]
        for nth, local in enumerate(members):
            shifted = position + size + nth * len(cls.interface)
            columns[surface.copies(local)] = np.where(position >= 0, shifted, -1)
        size += len(cls.interface) * len(members)
        classes.append(cls)
        load = np.zeros((cls.unknowns, len(members)), order="F")
        lift = np.zeros_like(load)
        for nth, local in enumerate(members):
            if loads[local] is not None:
                load[:, nth] = loads[local]
            own = lifting[local]
            if own is not None:
                lift[own[0], nth] = own[1]
        class_loads.append(load)
        class_lifts.append(lift)

    for text in filter(None, comm.allgather(failed)):
        raise ArithmeticError(text)
    first_column = comm.exscan(size) or 0
    columns = np.where(columns >= 0, columns + first_column, -1)
    kernels = [(cls.members, cls.kernel[cls.interface]) for cls in classes]
    B, c, kinds, metric, repeated = _constraint_matrix(
        comm, exchange, rows, supports, columns, size, kernels
    )
    e = np.concatenate(
        [
            np.zeros(0),
            *((cls.kernel.T @ load).T.ravel() for cls, load in zip(classes, class_loads,
                                                                    strict=True)),
        ]
    )  # fmt: skip
    coarse = None
    if comm.allreduce(len(e)):
        with timings.measure("factorization"):
            coarse = CoarseProblem(B, kernels, kinds == RowKind.CONTACT, metric, repeated)
    members_of = [
        np.array([partition.subdomains[local].body for local in members], np.int64)
        for members in groups.values()
    ]
    widths = [len(cls.interface) for cls in classes]
    bodies = bodies_of(comm, B, group_numbers(scene), members_of, widths)
    wide = np.zeros(len(kinds), bool)
    wide[kinds == RowKind.CONTACT] = contact.wide
    problem = DualProblem(
        comm=comm,
        dimension=d,
        classes=tuple(classes),
        B=B,
        c=c,
        kinds=kinds,
        contact=contact,
        wide=wide,
        forces=tuple(class_loads),
        lifting=tuple(class_lifts),
        coarse=coarse,
        e=e,
        held_without_contact=held_without_contact,
        bodies=bodies,
    )
    return problem, place, list(groups)


def _meshed_by_all(comm: MPI.Intracomm, references: Sequence[Reference]) -> list[bool]:
    """Which of this rank's meshes all ranks hold in the same place of their lists."""
    if comm.size == 1:
        return [False] * len(references)
    mine = [sha1(r.points.tobytes(), usedforsecurity=False).digest() for r in references]
    of_ranks = comm.allgather(mine)
    shortest = min(map(len, of_ranks))
    same = [len(set(places)) == 1 for places in zip(*of_ranks, strict=False)]
    return same + [False] * (len(references) - shortest)


def _made_by_all(
    comm: MPI.Intracomm,
    stiffness: sparse.csr_matrix,
    lifted: tuple[NDArray[np.int64], NDArray[np.float64]] | None,
) -> bool:
    """Whether all ranks hold this stiffness, to the last bit, as the class they make now."""
    digest = sha1(usedforsecurity=False)
    for array in (stiffness.indptr, stiffness.indices, stiffness.data):
        digest.update(np.ascontiguousarray(array).data)
    if lifted is not None:
        digest.update(lifted[0].tobytes())
    return len(set(comm.allgather(digest.digest()))) == 1


def _constraint_matrix(
    comm: MPI.Intracomm,
    exchange: NodeExchange,
    rows: Rows,
    supports: SupportRows,
    columns: NDArray[np.int64],
    size: int,
    kernels: Sequence[tuple[int, NDArray[np.float64]]],
) -> tuple[
    ConstraintMatrix, NDArray[np.float64], NDArray[np.int8], NDArray[np.float64], list[Kind]
]:
    """B on interface columns, its right-hand side, the kind and weight of each row; what repeats.

    Parameters
    ----------
    kernels : one (members, (m, k) array) pair a class
        Rigid motions on the class's interface.
    """
    d = columns.shape[1]
    row, column, value = [[part] for part in rows.entries(exchange.to_owners(columns))]
    for nth, (copies, values) in enumerate(zip(supports.copies, supports.values, strict=True)):
        node, component = np.nonzero(values)
        row.append(np.full(len(node), len(rows.kind) + nth))
        column.append(columns[copies[node], component])
        value.append(values[node, component])
    extra = len(supports.copies)
    kinds = np.concatenate([rows.kind, np.full(extra, RowKind.SUPPORT, np.int8)])
    c = np.concatenate([rows.rhs, np.zeros(extra)])
    total = comm.allreduce(size)
    local = sparse.csr_matrix(
        (np.concatenate(value), (np.concatenate(row), np.concatenate(column))),
        shape=(len(kinds), total),
    )
    local.sort_indices()
    weight = np.concatenate([rows.weight, np.ones(extra)])
    seen = KernelRows(ConstraintMatrix(comm, local, size), kernels)
    own = comm.exscan(size) or 0, size
    order, nodal, alike = _row_order(local, kinds, seen, own, d)
    B = ConstraintMatrix(comm, local[order], size, nodal, d)
    return B, c[order], kinds[order], weight[order], alike


def _row_order(
    local: sparse.csr_matrix,
    kinds: NDArray[np.int8],
    seen: KernelRows,
    own: tuple[int, int],
    d: int,
) -> tuple[NDArray[np.int64], int, list[Kind]]:
    """The order of rows in which those that repeat are together and products read nearby.

    Rows that do the same to each component of some nodes of this rank come first, then those that
    do so to nodes of other ranks as well, rows of contact and supports last, as they are.

    Parameters
    ----------
    local
        Rows that do the same to each component of a node next to each other.
    own
        First column of this rank, and how many it has.
    d
        Components of a node.

    Returns
    -------
    The order, how many rows come first, and kinds of rows.
    """
    inner = (kinds == RowKind.GLUING) | (kinds == RowKind.DIRICHLET)
    runs = np.empty(0, np.int64)
    if seen.motions and not any(n % d for n in own):
        runs = nodal_rows(local, d).reshape(-1, d)
        runs = runs[inner[runs].all(axis=1), 0]
    begin, end = local.indptr[runs], local.indptr[runs + 1] - 1
    inside = (local.indices[begin] >= own[0]) & (local.indices[end] < sum(own))
    parts: list[NDArray[np.int64]] = []
    alike: list[Kind] = []
    for mine in (runs[inside], runs[~inside]):
        order, found = kinds_of(seen, mine, d, d * sum(map(len, parts)))
        parts.append(mine[order])
        alike += found
    nodal = (np.concatenate(parts)[:, None] + np.arange(d)).ravel()
    left = inner.copy()
    left[nodal] = False
    others = np.flatnonzero(left)
    begins, start, _, place, _ = seen.entries_of(others)
    others = others[np.lexsort((place[begins[:-1]], start[begins[1:] - 1], start[begins[:-1]]))]
    order = np.concatenate([nodal, others, np.flatnonzero(~inner)])
    return order, d * len(parts[0]), alike
