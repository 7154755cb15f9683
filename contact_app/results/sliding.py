"""Distances by which bodies slide along obstacles and along each other, where they touch."""

import numpy as np
from mpi4py import MPI

from meshes.arrays import Array
from solver.contact.solution import Solution
from solver.exchange import NodeExchange
from solver.tfeti.dual import DualProblem


def largest_sliding(
    problem: DualProblem, exchange: NodeExchange, u: Array, solution: Solution, source: int
) -> float:
    """Largest tangential displacement of touching nodes of one contact (collective).

    Parameters
    ----------
    u : (owned, d)
        Displacement of the nodes this rank owns.
    """
    contact = problem.contact
    touching = (solution.multiplier[problem.inequality] > 0.0) & (contact.sources == source)
    moved, normal = u[contact.nodes[touching] - exchange.first], contact.normals[touching]
    along = moved - np.einsum("ij,ij->i", moved, normal)[:, None] * normal
    largest = float(np.linalg.norm(along, axis=1).max(initial=0.0))
    return float(problem.comm.allreduce(largest, op=MPI.MAX))


def sliding_on_each_other(
    problem: DualProblem, exchange: NodeExchange, u: Array, solution: Solution, source: int
) -> tuple[float, float]:
    """Largest tangential motion of a touching row of a pair of bodies, and its facets' size.

    A row weighs nodes by Σ_c value_c n_c, its entries being weights times the mean normal
    (collective).

    Parameters
    ----------
    u : (owned, d)
        Displacement of the nodes this rank owns.
    """
    d, contact = problem.dimension, problem.contact
    pushed = solution.multiplier[problem.inequality] > 0.0
    rows = contact.of(pushed & (contact.sources == source))
    entries, normals = rows.entries, rows.normals
    query = exchange.among(entries.node)
    at_entries = query.from_owners(u[query.nodes - exchange.first])
    weight = entries.value * -normals[entries.row, entries.component]
    motion = np.zeros((len(rows.nodes), d))
    np.add.at(motion, entries.row, weight[:, None] * at_entries)
    motion -= np.einsum("ij,ij->i", motion, normals)[:, None] * normals
    size = np.linalg.norm(motion, axis=1)
    worst = int(np.argmax(size)) if len(size) else -1
    longest = (
        (float(size[worst]), float(rows.areas[worst] ** (1 / (d - 1)))) if len(size) else (0.0, 0.0)
    )
    return max(problem.comm.allgather(longest))
