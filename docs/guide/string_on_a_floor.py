"""A string that sags on a floor, cut into four pieces: Total FETI from plain arrays.

Tension 1 and load 1 a length, both ends held, floor 0.05 below. Where the string leaves the floor
its slope is zero: at sqrt(2 · 0.05) from each end. The floor carries the load between.
Run it with ``python docs/guide/string_on_a_floor.py``, or on ranks with mpirun.
"""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from solver.contact import SolverOptions
from solver.driver import solve
from solver.tfeti import Held, Obstacle, Subdomain, problem_from_arrays

PIECES, CELLS, LOAD, DEPTH = 4, 50, 1.0, 0.05
comm = MPI.COMM_WORLD
h = 1.0 / (PIECES * CELLS)

# the stiffness of a piece: linear elements, nothing held
stiffness = PETSc.Mat().createAIJ((CELLS + 1, CELLS + 1), nnz=3, comm=PETSc.COMM_SELF)
for i in range(CELLS):
    stiffness.setValues([i, i + 1], [i, i + 1], np.array([[1, -1], [-1, 1]]) / h, addv=True)
stiffness.assemble()
load = np.full(CELLS + 1, -LOAD * h)
load[[0, -1]] /= 2

mine = range(comm.rank, PIECES, comm.size)  # pieces of this rank
pieces = []
for piece in mine:
    nodes = piece * CELLS + np.arange(CELLS + 1)  # pieces share the nodes at their ends
    pieces.append(
        Subdomain(stiffness, load, nodes, h * nodes[:, None], kernel=np.ones((CELLS + 1, 1)))
    )
known = np.unique(np.concatenate([piece.nodes for piece in pieces]))
ends = known[(known == 0) | (known == PIECES * CELLS)]
inner = np.setdiff1d(known, ends)
held = Held(ends, np.ones((len(ends), 1), bool), np.zeros((len(ends), 1)))
floor = Obstacle(inner, np.full((len(inner), 1), -1.0), np.full(len(inner), DEPTH))

problem = problem_from_arrays(comm, pieces, held, [floor])
answer = solve(problem, SolverOptions(tolerance=1e-8))
forces = (answer.multiplier * problem.spread)[problem.inequality]
carried = comm.allreduce(forces.sum())
lowest = comm.allreduce(min(u.min() for u in answer.displacements), op=MPI.MIN)
expected = LOAD * (1.0 - 2.0 * np.sqrt(2.0 * DEPTH / LOAD))
if comm.rank == 0:
    print(f"certified: {answer.converged}, by {answer.method}")
    print(f"the floor carries {carried:.4f} of 1 (exact: {expected:.4f}); lowest {lowest:.4f}")
