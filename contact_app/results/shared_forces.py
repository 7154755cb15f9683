"""Forces that equilibrium does not divide between the contacts of a node.

A node that rests in two contacts has more rows than directions. Let the rows of R be the normals of
its contacts that press and the tangents of its points that rest. Only the sum f = Rᵀ λ of their
forces is determined: every λ + t Δ with Rᵀ Δ = 0 that leaves the normal forces positive and the
friction within its limits belongs to the same displacement. An edge that sticks on a rough floor
and touches a wall is an example: the wall may press more if the friction of the floor pushes back.
Where three bodies meet in a node of each, R has the components of all three: a brick may rest on
two others with more friction if these press each other less. A tie there is a row of R whose force
has no limit: a brick may rest more on one of two tied blocks and less on the other, since the tie
carries the difference, with friction or without.

The displacement need not be unique, either,

* if a contact whose normal force may change so slides: its friction μ λ_n changes with it;
* if a node in an edge of two contacts rests only because friction across the edge adds to the
  normal forces. With f = a N₁ + b N₂ + f_e e it could slide along the edge e if
  |f_e| > μ₁ a + s₁ + μ₂ b + s₂.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from contact_app.results.percent import percent
from contact_app.results.undetermined import PRESSING
from meshes.arrays import Array, Ints, Mask
from meshes.connected import connected
from solver.contact.friction_points import AT_LIMIT
from solver.contact.solution import Solution
from solver.problem.constraints.conditions import ContactRows
from solver.tfeti.dual import DualProblem

DEPENDENT = 1e-6
"""Sine of the angle between rows below which one is a combination of the others."""

MOST = 300
"""Contact points that bodies join, above which they are not tested: null vectors of more would take
seconds. Where meshes match there are three at a place in which three bodies meet."""

SMALL_SHARE = 0.01
"""Share of the normal forces of a contact that may be divided otherwise without a warning."""


@dataclass(frozen=True, eq=False)
class SharedForces:
    """Nodes whose force may be divided between their contacts in several ways."""

    nodes: int
    shares: Array  # (contacts,)
    """Range of the normal forces of these nodes over all normal forces of the contact."""
    moves: bool
    """Whether the displacement depends on the division."""
    tied: bool = False
    """Whether a tie takes part."""


@dataclass(frozen=True, eq=False)
class SharedNode:
    """The contacts of a node, or of nodes that contacts between bodies join."""

    sources: Ints  # (contacts,)
    normals: Array
    normal_forces: Array
    """A row of a tie counts as a contact whose force is infinite: it has no limit. Shapes
    (contacts, nodes · d), (contacts,)."""
    tangents: Array
    friction: Array
    """Tangents are zero where there is no friction. Shapes (contacts, d - 1, nodes · d), (contacts,
    d - 1)."""
    coefficients: Array
    limits: Array
    """Shapes (contacts,), (contacts,)."""
    presses: Mask
    rests: Mask
    """Masks of contacts with a normal force, and of those with friction and without a slip. Shapes
    (contacts,), (contacts,)."""
    nodes: int = 1

    @property
    def ties(self) -> Mask:
        """Mask (contacts,) of rows of ties."""
        return np.isinf(self.normal_forces)

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
        for source in np.unique(self.sources[~self.ties]):
            pressing = np.flatnonzero(self.presses & (self.sources == source))
            change = np.zeros(len(rows))
            change[acts] = null @ null[place[pressing]].sum(axis=0)
            change[np.abs(change) < DEPENDENT] = 0.0  # rounding errors limit no force
            if change[pressing].sum() > DEPENDENT:
                reach = self._reach(change) + self._reach(-change)
                changed = pressing[change[pressing] != 0.0]
                ranges[changed] = change[changed] * reach if np.isfinite(reach) else np.inf
        return ranges

    def _reach(self, change: Array) -> float:
        """Largest t for which normal forces press and friction is within its limits."""
        count = len(self.sources)
        normal = change[:count]
        across = change[count:].reshape(-1, count).T
        falls = normal < 0.0
        reach = float((self.normal_forces[falls] / -normal[falls]).min(initial=np.inf))
        limit = self.coefficients * np.where(self.ties, 0.0, self.normal_forces) + self.limits
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
        too += ", and so may the force of the tie" if shared.tied else ""
        causes = {"friction": problem.friction.acts, "a tie": shared.tied}
        why = " or ".join(cause for cause, acts in causes.items() if acts)
        yield (
            f"{name}: {shared.nodes} nodes rest in several contacts, and {why} allows other "
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
    comm = problem.comm
    if not problem.friction.acts and not comm.allreduce(len(problem.shared.tied.nodes)):
        return SharedForces(0, np.zeros(contacts), False)
    normal = problem.contact.spread * solution.multiplier[problem.inequality]
    sources = problem.contact.sources
    least = PRESSING * comm.allreduce(float(normal.max(initial=0.0)), op=MPI.MAX)
    total = comm.allreduce(np.bincount(sources, np.maximum(normal, 0.0), contacts))
    ranges, nodes, moves, tied = np.zeros(contacts), 0, False, False
    for node in _nodes(problem, solution, normal, least, contacts):
        of_node = node.ranges()
        ranges += np.bincount(node.sources, of_node, contacts)[:contacts]
        tied = tied or bool(node.ties.any() and of_node.any())
        slides = (of_node != 0.0) & ~node.rests & (node.coefficients > 0.0)
        moves = moves or bool(slides.any()) or node.is_wedged()
        nodes += node.nodes * bool(of_node.any())
    nodes, ranges = comm.allreduce(nodes), comm.allreduce(ranges)
    shares = np.divide(ranges, total, out=np.zeros(contacts), where=total > 0.0)
    moves, tied = (comm.allreduce(some, op=MPI.LOR) for some in (moves, tied))
    return SharedForces(nodes, shares, moves, tied)


def _nodes(
    problem: DualProblem, solution: Solution, normal: Array, least: float, contacts: int
) -> Iterator[SharedNode]:
    """The nodes in several contacts of which one presses, with friction or a tie (collective).

    The first rank has those of all ranks. Contacts with rigid bodies that move, and boundaries tied
    to rigid bodies, do not count.

    Parameters
    ----------
    normal : (contact rows,)
        Normal forces.
    least
        Force above which a contact presses or holds; zero if nothing presses on any rank.
    contacts
        Number of contacts; ties are counted from there on.
    """
    if least == 0.0:
        return
    contact, comm, d = problem.contact, problem.comm, problem.dimension
    points = _Points.of(problem, solution, normal, least)
    acts = (points.presses | points.rests) & ~contact.on_rigid
    tied = _ties_at(problem.shared.tied, contact.of(acts), comm)
    points = _Points.joined([points, _Points.of_ties(tied, contacts)])
    table = _table(problem, tied)
    row, node = table[:2].astype(np.int64)
    acts = np.concatenate([acts, np.ones(len(tied.nodes), bool)])
    row, node, table = (x[..., acts[row // d]] for x in (row, node, table))
    # a row with one node counts by itself, the rows of a contact between bodies once at each node
    wide = np.concatenate([contact.wide, np.ones(len(tied.nodes), bool)])
    by = np.where(wide, points.sources, -1 - np.arange(len(points.sources)))
    pairs = np.unique(np.hstack(comm.allgather(np.stack([node, by[row // d]]))), axis=1)
    nodes, touching = np.unique(pairs[0], return_counts=True)
    chosen = np.unique(row[np.isin(node, nodes[touching > 1])] // d)
    of_chosen = np.isin(row // d, chosen)
    row, table = row[of_chosen], table[:, of_chosen]
    table[0] = np.searchsorted(chosen, row // d) * d + row % d
    gathered = comm.gather((table, points.at(chosen)))
    if gathered is None:
        return
    tables, parts = zip(*gathered, strict=True)
    starts = d * np.cumsum([0, *(len(part.sources) for part in parts)])
    for each, start in zip(tables, starts, strict=False):
        each[0] += start
    yield from _groups(np.hstack(tables), _Points.joined(parts), d)


@dataclass(frozen=True, eq=False)
class _Points:
    """Contact rows with the state of their friction, and rows of ties; arrays (rows, …)."""

    nodes: Ints
    sources: Ints
    normal_forces: Array
    friction: Array  # (rows, d - 1)
    coefficients: Array
    limits: Array
    presses: Mask
    rests: Mask
    """Masks of rows with a normal force, and of those with friction and without a slip."""

    @classmethod
    def of(cls, problem: DualProblem, solution: Solution, normal: Array, least: float) -> "_Points":
        """The contact rows of this rank; parameters as of `_nodes`."""
        points, contact, multiplier = problem.friction, problem.contact, solution.multiplier
        residual = np.zeros(problem.size)
        if points.acts:
            residual = problem.jumps(solution.displacements)
        still = solution.tolerance * solution.measures.displacement
        slides = points.sizes(points.slips(residual)) > still
        rests = (points.slip_limits(multiplier) > least) & ~slides
        of_row, count = problem.shared.friction.places(contact), len(contact.nodes)
        friction = np.zeros((count + 1, problem.dimension - 1))  # the last: without a contact row
        friction[of_row, _directions(of_row)] = points.forces(multiplier)
        laws = np.zeros((3, count + 1))
        laws[:, of_row] = np.stack([points.coefficients, points.limits, rests])[:, points.point]
        coefficients, limits, resting = laws[:, :count]
        return cls(
            contact.nodes, contact.sources, normal, friction[:count], coefficients, limits,
            normal > least, resting > 0.0,
        )  # fmt: skip

    @classmethod
    def of_ties(cls, tied: ContactRows, contacts: int) -> "_Points":
        """Rows of ties as contacts without friction that press with an infinite force."""
        count, d = tied.normals.shape
        none, no = np.zeros(count), np.zeros(count, bool)
        return cls(
            tied.nodes, contacts + tied.sources, none + np.inf, np.zeros((count, d - 1)), none,
            none, ~no, no,
        )  # fmt: skip

    def at(self, rows: Ints) -> "_Points":
        """Some of the rows."""
        return _Points(*(values[rows] for values in vars(self).values()))

    @classmethod
    def joined(cls, parts: "Sequence[_Points]") -> "_Points":
        """The rows of several ranks."""
        return cls(*map(np.concatenate, zip(*(vars(p).values() for p in parts), strict=True)))


def _directions(of_row: Ints) -> Ints:
    """Number of each tangential row among those of its contact row."""
    order = np.argsort(of_row, kind="stable")
    numbers = np.zeros(len(of_row), np.int64)
    numbers[order] = np.arange(len(order)) - np.searchsorted(of_row[order], of_row[order])
    return numbers


def _ties_at(tied: ContactRows, contact: ContactRows, comm: MPI.Intracomm) -> ContactRows:
    """Rows of ties of bodies with entries at nodes of contact rows of any rank (collective)."""
    nodes = np.unique(np.concatenate([contact.entries.node, contact.held.node]))
    meets = np.isin(tied.entries.node, np.concatenate(comm.allgather(nodes)))
    some = np.zeros(len(tied.nodes), bool)
    some[tied.entries.row[meets]] = True
    return tied.of(some & ~tied.on_rigid)


def _table(problem: DualProblem, tied: ContactRows) -> Array:
    """Entries of the forces of contact rows on nodes for multipliers of one, (4, entries).

    Their numbers (d for each contact row, then for each row of a tie: that of its normal, then
    those of its tangents), nodes, components and values.
    """
    d, rough = problem.dimension, problem.shared.friction
    of_row = rough.places(problem.contact)
    tangents = np.where(of_row < 0, -1, of_row * d + 1 + _directions(of_row))
    count = len(problem.contact.nodes)
    normals, ties = np.arange(count) * d, (count + np.arange(len(tied.nodes))) * d
    parts = [
        np.stack([number[part.row], part.node, part.component, -part.value])
        for rows, number in ((problem.contact, normals), (rough.rows, tangents), (tied, ties))
        for part in (rows.entries, rows.held)
    ]
    table = np.hstack(parts)
    return np.asarray(table[:, (np.abs(table[3]) > DEPENDENT) & (table[0] >= 0)])


def _without_lone_ties(table: Array, tied: Mask, d: int) -> Array:
    """The entries without rows of ties that act on a component of a node alone.

    No other force balances theirs. So most rows of a tie go, and few places are joined.
    """
    while True:
        row, node, component = table[:3].astype(np.int64)
        _, place, count = np.unique(node * d + component, return_inverse=True, return_counts=True)
        lone = np.zeros(len(tied) * d, bool)
        lone[row[count[place] == 1]] = True
        gone = lone[row] & tied[row // d]
        if not gone.any():
            return table
        table = table[:, ~gone]


def _groups(table: Array, points: _Points, d: int) -> Iterator[SharedNode]:
    """The nodes that rows join, where one presses, and one rests or is tied."""
    table = _without_lone_ties(table, np.isinf(points.normal_forces), d)
    row, node, component = table[:3].astype(np.int64)
    _, node = np.unique(node, return_inverse=True)
    count = len(points.sources)
    label = connected(np.stack([row // d, count + node]), count + node.max(initial=-1) + 1)
    for group in np.unique(label[:count]):
        rows = np.flatnonzero(label[:count] == group)
        nodes = np.flatnonzero(label[count:] == group)
        some = points.at(rows)
        tied = np.isinf(some.normal_forces)
        one = (some.presses & ~tied).any() and (some.rests | tied).any()
        if not one or len(rows) > MOST:
            continue
        forces = np.zeros((len(rows), d, len(nodes), d))
        of = np.flatnonzero(label[row // d] == group)
        at = np.searchsorted(rows, row[of] // d), row[of] % d, np.searchsorted(nodes, node[of])
        np.add.at(forces, (*at, component[of]), table[3, of])
        forces = forces.reshape(len(rows), d, -1)
        yield SharedNode(
            some.sources, forces[:, 0], some.normal_forces, forces[:, 1:], some.friction,
            some.coefficients, some.limits, some.presses, some.rests, len(np.unique(some.nodes)),
        )  # fmt: skip
