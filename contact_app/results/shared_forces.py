"""Forces that equilibrium does not divide between the contacts of a node.

A node that rests in two contacts has more rows than directions. Let the rows of R be the normals of
its contacts that press and the tangents of its points that rest. Only the sum f = Rᵀ λ of their
forces is determined: every λ + t Δ with Rᵀ Δ = 0 that leaves the normal forces positive and the
friction within its limits belongs to the same displacement. An edge that sticks on a rough floor
and touches a wall is an example: the wall may press more if the friction of the floor pushes back.
Where three bodies meet in a node of each, R has the components of all three: a brick may rest on
two others with more friction if these press each other less.

The displacement need not be unique, either,

* if a contact whose normal force may change so slides: its friction μ λ_n changes with it;
* if a node in an edge of two contacts rests only because friction across the edge adds to the
  normal forces. With f = a N₁ + b N₂ + f_e e it could slide along the edge e if
  |f_e| > μ₁ a + s₁ + μ₂ b + s₂.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.results.percent import percent
from contact_app.results.undetermined import PRESSING
from meshes.connected import connected
from solver.contact.friction_points import AT_LIMIT
from solver.contact.solution import Solution
from solver.tfeti.constraints.conditions import ContactRows
from solver.tfeti.dual import DualProblem

Array = NDArray[np.float64]

DEPENDENT = 1e-6
"""Sine of the angle between rows below which one is a combination of the others."""

MOST = 300
"""Contact points that bodies join, above which they are not tested: null vectors of more would take
seconds. Where meshes match there are three at a place in which three bodies meet."""

SMALL_SHARE = 0.01
"""Share of the normal forces of a contact that may be divided otherwise without a warning."""


@dataclass(frozen=True, eq=False)
class SharedForces:
    """Nodes whose force may be divided between their contacts in several ways.

    Attributes
    ----------
    nodes
        Their number.
    shares : (contacts,)
        Range of the normal forces of these nodes over all normal forces of the contact.
    moves
        Whether the displacement depends on the division.
    """

    nodes: int
    shares: Array
    moves: bool


@dataclass(frozen=True, eq=False)
class SharedNode:
    """The contacts of a node, or of nodes that contacts between bodies join.

    Attributes
    ----------
    nodes
        Their number.
    sources : (contacts,)
    normals, normal_forces : (contacts, nodes · d), (contacts,)
    tangents, friction : (contacts, d - 1, nodes · d), (contacts, d - 1)
        Tangents are zero where there is no friction.
    coefficients, limits : (contacts,), (contacts,)
    presses, rests : (contacts,), (contacts,)
        Masks of contacts with a normal force, and of those with friction and without a slip.
    """

    sources: NDArray[np.int64]
    normals: Array
    normal_forces: Array
    tangents: Array
    friction: Array
    coefficients: Array
    limits: Array
    presses: NDArray[np.bool_]
    rests: NDArray[np.bool_]
    nodes: int = 1

    def ranges(self) -> Array:
        """Range of the normal forces, (contacts,): at least what one direction of Δ allows.

        The parts of a contact add up to the range of its sum.
        """
        count = len(self.sources)
        rows = np.concatenate([self.normals, *np.moveaxis(self.tangents, 1, 0)])
        slips = np.tile(self.rests, self.tangents.shape[1])
        acts = np.concatenate([self.presses, slips])
        left, sizes, _ = np.linalg.svd(rows[acts])
        ranges, null = np.zeros(count), left[:, int((sizes > DEPENDENT).sum()) :]
        place = np.cumsum(acts) - 1
        for source in np.unique(self.sources):
            pressing = np.flatnonzero(self.presses & (self.sources == source))
            change = np.zeros(len(rows))
            change[acts] = null @ null[place[pressing]].sum(axis=0)
            if change[pressing].sum() > DEPENDENT:
                ranges[pressing] = change[pressing] * (self._reach(change) + self._reach(-change))
        return ranges

    def _reach(self, change: Array) -> float:
        """Largest t for which normal forces press and friction is within its limits."""
        count = len(self.sources)
        normal = change[:count]
        across = change[count:].reshape(-1, count).T
        falls = normal < 0.0
        reach = float((self.normal_forces[falls] / -normal[falls]).min(initial=np.inf))
        limit = self.coefficients * self.normal_forces + self.limits
        growth = self.coefficients * normal
        a = (across**2).sum(axis=1) - growth**2
        b = 2.0 * ((self.friction * across).sum(axis=1) - growth * limit)
        c = np.minimum((self.friction**2).sum(axis=1) - limit**2, 0.0)
        for k in np.flatnonzero(self.rests):
            roots = np.roots([a[k], b[k], c[k]])
            roots = roots[np.isreal(roots)].real
            later = roots[roots > 0.0] if c[k] < 0.0 or b[k] <= 0.0 else np.zeros(1)
            reach = min(reach, float(later.min(initial=np.inf)))
        return reach

    def is_wedged(self) -> bool:
        """Whether the node rests in an edge along which it could slide without friction across."""
        both = np.flatnonzero(self.presses & self.rests)
        if self.normals.shape[1] != 3 or len(both) != 2 or self.presses.sum() != 2:
            return False
        force = self.normal_forces @ self.normals
        force = force + np.einsum("ck,cki->i", self.friction, self.tangents)
        edge = np.cross(*self.normals[both])
        if np.linalg.norm(edge) < DEPENDENT:
            return False
        *normal, along = np.linalg.solve(
            np.column_stack([*self.normals[both], edge / np.linalg.norm(edge)]), force
        )
        limit = float(self.coefficients[both] @ normal + self.limits[both].sum())
        return bool(min(normal) > 0.0 and abs(along) > (1.0 + AT_LIMIT) * limit)


def shared_force_warnings(
    problem: DualProblem, solution: Solution, names: Sequence[str]
) -> Iterator[str]:
    """Sentences on contacts whose force is one of several (collective).

    Parameters
    ----------
    names
        Of all contacts.
    """
    shared = shared_forces(problem, solution, len(names))
    for name, share in zip(names, shared.shares, strict=True):
        if share <= SMALL_SHARE:
            continue
        most = f"by {percent(share)}" if np.isfinite(share) else "without bound"
        too = ", and so may displacements" if shared.moves else ""
        yield (
            f"{name}: {shared.nodes} nodes rest in several contacts, and friction allows other "
            "divisions of their force: the sum of the normal forces of this contact may differ "
            f"{most}{too}; the answer is one of several"
        )


def shared_forces(problem: DualProblem, solution: Solution, contacts: int) -> SharedForces:
    """Nodes of an answer whose force may be divided in several ways (collective).

    Parameters
    ----------
    contacts
        Number of contacts.
    """
    if not problem.friction.acts:
        return SharedForces(0, np.zeros(contacts), False)
    normal = problem.contact.spread * solution.multiplier[problem.inequality]
    sources, comm = problem.contact.sources, problem.comm
    least = PRESSING * comm.allreduce(float(normal.max(initial=0.0)), op=MPI.MAX)
    total = comm.allreduce(np.bincount(sources, np.maximum(normal, 0.0), contacts))
    ranges, nodes, moves = np.zeros(contacts), 0, False
    for node in _nodes(problem, solution, normal, least):
        of_node = node.ranges()
        ranges += np.bincount(node.sources, of_node, contacts)
        slides = (of_node != 0.0) & ~node.rests & (node.coefficients > 0.0)
        moves = moves or bool(slides.any()) or node.is_wedged()
        nodes += node.nodes * bool(of_node.any())
    nodes, ranges = comm.allreduce(nodes), comm.allreduce(ranges)
    shares = np.divide(ranges, total, out=np.zeros(contacts), where=total > 0.0)
    return SharedForces(nodes, shares, comm.allreduce(moves, op=MPI.LOR))


def _nodes(
    problem: DualProblem, solution: Solution, normal: Array, least: float
) -> Iterator[SharedNode]:
    """The nodes in several contacts of which one has friction and another presses (collective).

    The first rank has those of all ranks. Contacts with rigid bodies that move do not count.

    Parameters
    ----------
    normal : (contact rows,)
        Normal forces.
    least
        Force above which a contact presses or holds; zero if nothing presses on any rank.
    """
    if least == 0.0:
        return
    points, rough, contact, d = (
        problem.friction, problem.shared.friction, problem.contact, problem.dimension,
    )  # fmt: skip
    count, of_row = len(contact.nodes), rough.places(contact)
    residual = problem.residual(problem.on_interface(solution.displacements))
    still = solution.tolerance * solution.measures.displacement
    limits = points.slip_limits(solution.multiplier)
    resting = (points.sizes(points.slips(residual)) <= still) & (limits > least)
    order = np.argsort(of_row, kind="stable")
    component = np.zeros(len(of_row), np.int64)  # number of each tangent among those of its row
    component[order] = np.arange(len(order)) - np.searchsorted(of_row[order], of_row[order])
    friction, laws = np.zeros((count + 1, d - 1)), np.zeros((count + 1, 3))
    friction[of_row, component] = points.forces(solution.multiplier)  # -1: without a contact row
    laws[of_row] = np.column_stack([points.coefficients, points.limits, resting])[points.point]
    friction, laws = friction[:count], laws[:count]
    presses, rests = normal > least, laws[:, 2] > 0.0
    acts = (presses | rests) & ~contact.on_rigid
    one = _entries(contact, np.arange(count) * d)
    more = _entries(rough.rows, np.where(of_row < 0, -1, of_row * d + 1 + component))
    row, node, place, value = np.hstack([one, more[:, more[0] >= 0]])
    row, node = row.astype(np.int64), node.astype(np.int64)
    row, node, place, value = (x[acts[row // d]] for x in (row, node, place, value))
    # a row with one node counts by itself, the rows of a contact between bodies once at each node
    by = np.where(contact.wide, contact.sources, -1 - np.arange(count))
    comm = problem.comm
    pairs = np.unique(np.hstack(comm.allgather(np.stack([node, by[row // d]]))), axis=1)
    nodes, contacts = np.unique(pairs[0], return_counts=True)
    several = np.isin(node, nodes[contacts > 1])
    chosen = np.unique(row[several] // d)
    take = np.isin(row // d, chosen)
    number = np.searchsorted(chosen, row[take] // d) * d + row[take] % d
    data = np.column_stack(
        [contact.sources, contact.nodes, normal, friction, laws[:, :2], presses, rests]
    )
    gathered = comm.gather((np.stack([number, node[take], place[take], value[take]]), data[chosen]))
    if gathered is None:
        return
    first = np.cumsum([0, *(len(rows) for _, rows in gathered)])
    tables = [
        table + [[n * d], [0], [0], [0]] for n, (table, _) in zip(first, gathered, strict=False)
    ]
    yield from _groups(np.hstack(tables), np.vstack([rows for _, rows in gathered]), d)


def _entries(rows: ContactRows, number: NDArray[np.int64]) -> Array:
    """Numbers of rows, nodes, components and forces for a multiplier of one, (4, entries)."""
    parts = [
        np.stack([number[part.row], part.node, part.component, -part.value])
        for part in (rows.entries, rows.held)
    ]
    table = np.hstack(parts)
    return np.asarray(table[:, np.abs(table[3]) > DEPENDENT])


def _groups(table: Array, data: Array, d: int) -> Iterator[SharedNode]:
    """The nodes that rows join, where one presses and one rests."""
    row, node, component = table[:3].astype(np.int64)
    _, node = np.unique(node, return_inverse=True)
    label = connected(np.stack([row // d, len(data) + node]), len(data) + node.max(initial=-1) + 1)
    for group in np.unique(label[: len(data)]):
        rows = np.flatnonzero(label[: len(data)] == group)
        nodes = np.flatnonzero(label[len(data) :] == group)
        presses, rests = data[rows, -2] > 0.0, data[rows, -1] > 0.0
        if not (presses.any() and rests.any()) or len(rows) > MOST:
            continue
        forces = np.zeros((len(rows), d, len(nodes), d))
        of = np.flatnonzero(label[row // d] == group)
        at = np.searchsorted(rows, row[of] // d), row[of] % d, np.searchsorted(nodes, node[of])
        np.add.at(forces, (*at, component[of]), table[3, of])
        forces = forces.reshape(len(rows), d, -1)
        sources, of_row, normal = data[rows, :3].T
        coefficients, limits = data[rows, 2 + d : 4 + d].T
        yield SharedNode(
            sources.astype(np.int64), forces[:, 0], normal, forces[:, 1:], data[rows, 3 : 2 + d],
            coefficients, limits, presses, rests, len(np.unique(of_row)),
        )  # fmt: skip
