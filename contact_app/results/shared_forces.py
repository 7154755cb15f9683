"""Forces that equilibrium does not divide between the contacts of a node.

A node that rests in two contacts has more rows than directions. Let the rows of R be the normals of
its contacts that press and the tangents of its points that rest. Only the sum f = Rᵀ λ of their
forces is determined: every λ + t Δ with Rᵀ Δ = 0 that leaves the normal forces positive and the
friction within its limits belongs to the same displacement. An edge that sticks on a rough floor
and touches a wall is an example: the wall may press more if the friction of the floor pushes back.

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
from solver.contact.friction_points import AT_LIMIT
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem

Array = NDArray[np.float64]

DEPENDENT = 1e-6
"""Sine of the angle between rows below which one is a combination of the others."""

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
    """The contacts of a node.

    Attributes
    ----------
    sources : (contacts,)
    normals, normal_forces : (contacts, d), (contacts,)
    tangents, friction : (contacts, d - 1, d), (contacts, d - 1)
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

    def ranges(self) -> Array:
        """Range of each normal force, (contacts,): at least what one direction of Δ allows."""
        count = len(self.sources)
        rows = np.concatenate([self.normals, *np.moveaxis(self.tangents, 1, 0)])
        slips = np.tile(self.rests, self.tangents.shape[1])
        acts = np.concatenate([self.presses, slips])
        left, sizes, _ = np.linalg.svd(rows[acts])
        ranges, null = np.zeros(count), left[:, int((sizes > DEPENDENT).sum()) :]
        for k in np.flatnonzero(self.presses):
            change = np.zeros(len(rows))
            change[acts] = null @ null[np.count_nonzero(acts[:k])]
            if change[k] > DEPENDENT:
                ranges[k] = change[k] * (self._reach(change) + self._reach(-change))
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
        slides = (of_node > 0.0) & ~node.rests & (node.coefficients > 0.0)
        moves = moves or bool(slides.any()) or node.is_wedged()
        nodes += bool(of_node.any())
    nodes, ranges = comm.allreduce(nodes), comm.allreduce(ranges)
    shares = np.divide(ranges, total, out=np.zeros(contacts), where=total > 0.0)
    return SharedForces(nodes, shares, comm.allreduce(moves, op=MPI.LOR))


def _nodes(
    problem: DualProblem, solution: Solution, normal: Array, least: float
) -> Iterator[SharedNode]:
    """The nodes of this rank in several contacts of which one has friction and another presses.

    Contacts between bodies do not count: their rows are independent of each other.

    Parameters
    ----------
    normal : (contact rows,)
        Normal forces.
    least
        Force above which a contact presses or holds; zero if nothing presses on any rank.
    """
    points, rough, contact, d = (
        problem.friction, problem.shared.friction, problem.contact, problem.dimension,
    )  # fmt: skip
    if least == 0.0:
        return
    of_row = rough.places(contact)
    friction = points.forces(solution.multiplier)
    residual = problem.residual(problem.on_interface(solution.displacements))
    still = solution.tolerance * solution.measures.displacement
    resting = points.sizes(points.slips(residual)) <= still
    resting &= points.slip_limits(solution.multiplier) > least
    fixed = ~(contact.wide | contact.on_rigid)
    _, node = np.unique(contact.nodes, return_inverse=True)
    several = fixed & (np.bincount(node, fixed)[node] > 1)
    chosen = np.flatnonzero(several)  # sorted by node
    order = np.argsort(of_row, kind="stable")
    order = order[np.isin(of_row[order], chosen)]
    row, point = np.searchsorted(chosen, of_row[order]), points.point[order]
    direction = np.arange(len(row)) - np.searchsorted(row, row)
    tangents, forces = np.zeros((len(chosen), d - 1, d)), np.zeros((len(chosen), d - 1))
    tangents[row, direction], forces[row, direction] = rough.rows.normals[order], friction[order]
    coefficients, limits = np.zeros((2, len(chosen)))
    coefficients[row], limits[row] = points.coefficients[point], points.limits[point]
    rests = np.zeros(len(chosen), bool)
    rests[row] = resting[point]
    presses = normal[chosen] > least
    ends = np.flatnonzero(np.diff(contact.nodes[chosen])) + 1
    for part in np.split(np.arange(len(chosen)), ends):
        if presses[part].any() and rests[part].any():
            rows = chosen[part]
            yield SharedNode(
                contact.sources[rows], contact.normals[rows], normal[rows], tangents[part],
                forces[part], coefficients[part], limits[part], presses[part], rests[part],
            )  # fmt: skip
