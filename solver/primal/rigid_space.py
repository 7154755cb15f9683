"""A coarse space of rigid motions, for bodies that contact holds.

A ball between two grooves can turn although no load makes it: facets and friction-free contact hold
its spin by next to nothing. Such motions, changed at the nodes of active rows so that these stay
closed, W = Π R, have so little energy that neither smoothing nor truncated coarse spaces see
them. With Q = W (Wᵀ K W)⁻¹ Wᵀ the correction M⁻¹ r becomes

    (I - Q K) M⁻¹ r + Q r

(J. M. Tang, R. Nabben, C. Vuik, Y. A. Erlangga, *Comparison of two-level preconditioners derived
from deflation, domain decomposition and multigrid methods*, 2009: A-DEF2). K W vanishes away from
the contact. Rigid bodies are such bodies, too: their motions have no other preconditioner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solver.primal.merged import MergedSystem, split_motions
from solver.primal.projector import Projector

Array = NDArray[np.float64]

HELD = 1e-8
"""Squared length of held unknowns under a rigid motion, over that of the largest, below which they
do not stop it."""

SINGULAR = 1e-13
"""Energy of a motion, over that of the largest, below which it is none but rounding errors."""

FULL = 3
"""Bodies up to which W is stored as a full matrix: that of more is mostly zeros."""

UNBALANCED = 1e-8
"""Work of a residual on a motion without energy, over that of the magnitudes of the load."""

MOST = 50
"""Bodies up to which the space has elastic ones: its matrix is dense."""


def floating_bodies(system: MergedSystem) -> list[int]:
    """Bodies that held unknowns alone do not hold (collective)."""
    rigid, body, result = system.rigid, system.body, []
    for number in range(system.problem.bodies.count):
        rows = rigid[system.held & (body == number)]
        values = np.linalg.eigvalsh(system.comm.allreduce(rows.T @ rows))
        scale = system.comm.allreduce(float(np.sum(rigid[body == number] ** 2)))
        if values[0] <= HELD * max(values[-1], 1e-6 * scale):
            result.append(number)
    return result


class RigidSpace:
    """W and what belongs to it for one active set (collective).

    Parameters
    ----------
    bodies
        Whose rigid motions it has.
    """

    def __init__(self, system: MergedSystem, projector: Projector, bodies: list[int]) -> None:
        self._comm = system.comm
        if len(bodies) > MOST:
            bodies = [body for body in bodies if system.problem.bodies.rigid[body]]
        self.empty = not bodies
        if self.empty:
            return
        columns, images = [], []
        for motion in split_motions(system, bodies).T:
            w = np.where(system.held, 0.0, motion)
            before = self._comm.allreduce(float(np.sum(system.diagonal * w**2)))
            w = projector.apply(np.ascontiguousarray(w))
            after = self._comm.allreduce(float(np.sum(system.diagonal * w**2)))
            w *= 1.0 / np.sqrt(after) if after > SINGULAR * before else 0.0
            image = system.multiply(system.K, w)
            image[np.abs(image) < 1e-14 * system.diagonal.max()] = 0.0
            columns.append(w)
            images.append(image)
        W, self._KWt = np.column_stack(columns), sparse.csr_matrix(np.stack(images))
        energy = self._comm.allreduce(self._KWt @ W)
        self._W = W if len(bodies) <= FULL else sparse.csr_matrix(W)
        self._Wt = self._W.T
        values, vectors = np.linalg.eigh(0.5 * (energy + energy.T))
        some = values > SINGULAR * max(values[-1], 0.0)
        self._inverse = vectors[:, some] / values[some] @ vectors[:, some].T
        self._free = vectors[:, ~some]

    def leaves(self, residual: Array, load: Array) -> bool:
        """Whether a residual drives a motion that the active rows leave free (collective).

        Parameters
        ----------
        residual : (unknowns,)
            Of the start, projected.
        load : (unknowns,)
            What it is small beside.
        """
        if self.empty or not self._free.shape[1]:
            return False
        work = self._comm.allreduce(self._Wt @ residual)
        scale = self._comm.allreduce(abs(self._Wt) @ np.abs(load))
        return bool(np.abs(self._free.T @ work).max() > UNBALANCED * scale.max(initial=0.0))

    def balance(self, residual: Array) -> Array:
        """Q r, where the space is not empty."""
        return np.asarray(self._W @ (self._inverse @ self._comm.allreduce(self._Wt @ residual)))

    def correct(self, residual: Array, z: Array) -> Array:
        """(I - Q K) z + Q r."""
        if self.empty:
            return z
        along = self._comm.allreduce(self._Wt @ residual - self._KWt @ z)
        return np.asarray(z + self._W @ (self._inverse @ along))
