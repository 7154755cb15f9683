"""Normal forces of an answer by node and contact: where friction of the next increment begins."""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from meshes.arrays import Array, Ints
from solver.contact.solution import Solution
from solver.problem.constraints.conditions import ContactRows
from solver.tfeti.dual import DualProblem

Stored = list[list[list[float]]]
"""Nodes, contacts and forces of each rank."""


@dataclass(frozen=True, eq=False)
class NormalForces:
    """Normal forces of this rank's contact rows; rows of other models of the scene may differ."""

    nodes: Ints
    sources: Ints
    forces: Array
    """Node, contact and force, sorted by node and then by contact. Shape (rows,)."""

    @classmethod
    def of(cls, problem: DualProblem, solution: Solution) -> "NormalForces":
        """The forces of an answer, where they press."""
        rows = problem.contact
        forces = rows.spread * solution.multiplier[problem.inequality]
        presses = forces > 0.0
        return cls(rows.nodes[presses], rows.sources[presses], forces[presses])

    def at(self, rows: ContactRows) -> Array:
        """The force at each of some contact rows, (rows,); zero where nothing pressed."""
        both = [np.stack([part.nodes, part.sources]) for part in (self, rows)]
        keys, place = np.unique(np.hstack(both), axis=1, return_inverse=True)
        place = place.reshape(-1)
        forces = np.zeros(keys.shape[1])
        forces[place[: len(self.forces)]] = self.forces
        return forces[place[len(self.forces) :]]

    def stored(self, comm: MPI.Intracomm) -> Stored | None:
        """The forces of all ranks for a checkpoint; None on ranks but the first (collective)."""
        return comm.gather([v.tolist() for v in (self.nodes, self.sources, self.forces)])

    @classmethod
    def read(cls, stored: Stored, rank: int) -> "NormalForces":
        """The forces of a rank in a checkpoint."""
        nodes, sources, forces = stored[rank]
        return cls(np.array(nodes, np.int64), np.array(sources, np.int64), np.array(forces, float))
