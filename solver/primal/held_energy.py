"""The strain energy if some unknowns are held at values other than zero."""

import numpy as np

from solver.primal.merged import MergedSystem
from solver.vectors import Array


class HeldEnergy:
    """The contribution of held displacements to the energy of the strains."""

    def __init__(self, system: MergedSystem) -> None:
        self._system, problem = system, system.problem
        at_rest = system.at_rest
        moved = system.comm.allreduce(int(at_rest.any()))
        self._coupling, self._work = None, 0.0
        if moved:
            moves = system.on_subdomains(at_rest)
            forces = [cls.stiffness @ u for cls, u in zip(problem.classes, moves, strict=True)]
            self._work = sum(float(np.vdot(u, f)) for u, f in zip(moves, forces, strict=True))
            self._coupling = np.where(system.held, 0.0, system.summed(forces))

    def strained(self, u: Array, left: Array) -> float:
        """a(u, u) = u_f (f - r) + 2 u_f K_fh u_h + u_h K_hh u_h, with f the load minus K_fh u_h."""
        system = self._system
        work = float(np.sum(np.where(system.held, 0.0, u * (system.load - left)))) + self._work
        if self._coupling is not None:
            work += 2.0 * float(u @ self._coupling)
        return max(float(system.comm.allreduce(work)), 0.0)
