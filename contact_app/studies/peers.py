"""What a PETSc user would pick instead, on the paper's cube without decomposition.

One process runs one method and prints one line of JSON, so that time and memory are its own:
``python -m contact_app.studies.peers METHOD CELLS``. The stiffness is assembled by dolfinx on the
whole mesh, the foot eliminated, the wall a bound on the displacements of its nodes.

=================  =============================================================================
``linear-gamg``    no wall at all: one linear solve by CG with GAMG and the rigid motions as
                   near-null space, to 1e-8; the price of admission of any iterative method
``linear-cholmod`` the same by one sparse Cholesky factor
``snes-vi``        SNES ``vinewtonrsls`` with CHOLMOD for the steps
``tao-bnls``       TAO ``bnls`` with its defaults
=================  =============================================================================
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from contact_app.assembly import Element
from contact_app.environment import peak_rss_gb
from contact_app.studies.cube import cube_scene
from meshes.subdomains import Reference
from solver.tfeti.kernels import rigid_motions

METHODS = ("linear-gamg", "linear-cholmod", "snes-vi", "tao-bnls")
RTOL = 1e-8


def run(method: str, cells: int) -> dict[str, Any]:
    """Solve the cube of ``cells``³ hexahedra by one method; seconds from mesh to solution."""
    scene = cube_scene(cells, 1)
    materials = scene.bodies[0].materials
    begin = time.perf_counter()
    box = dmesh.create_box(
        MPI.COMM_SELF, [np.zeros(3), np.ones(3)], [cells] * 3, dmesh.CellType.hexahedron
    )
    element = Element(Reference.of(box, "hexahedron"), 3)
    points, facets = element.reference.points, element.reference.facets
    K = element.stiffness(materials, None)
    top = np.flatnonzero((points[facets][:, :, 2] > 1 - 1e-9).all(axis=1)).astype(np.int32)
    load = element.traction(top, np.array(scene.tractions[0].vector))
    free = np.repeat(points[:, 2] > 1e-9, 3)
    wall = np.zeros((len(points), 3), bool)
    wall[points[:, 0] > 1 - 1e-9, 0] = True
    K, load, upper = K[free][:, free].tocsr(), load[free], wall.ravel()[free]
    assembled = time.perf_counter()
    matrix = PETSc.Mat().createAIJ(
        K.shape, csr=(K.indptr.astype(PETSc.IntType), K.indices.astype(PETSc.IntType), K.data)
    )
    matrix.setBlockSize(3)
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    solvers: dict[str, Callable[..., Any]] = {
        "linear-gamg": _gamg,
        "linear-cholmod": _cholmod,
        "snes-vi": _snes,
        "tao-bnls": _tao,
    }
    u, iterations = solvers[method](matrix, load, upper, points[free[::3]])
    end = time.perf_counter()
    return {
        "method": method,
        "cells": cells,
        "dofs": 3 * len(points),
        "seconds": end - begin,
        "solve_seconds": end - assembled,
        "peak_rss_gb": peak_rss_gb(),
        "iterations": iterations,
        "energy": float(u @ (0.5 * (K @ u) - load)),
        "penetration": float(np.maximum(u[upper], 0.0).max() / np.abs(u).max()),
    }


def _vectors(matrix: PETSc.Mat, load: np.ndarray) -> tuple[PETSc.Vec, PETSc.Vec]:
    x, b = matrix.createVecs()
    x.set(0.0)
    b.setArray(load)
    return x, b


def _gamg(matrix: PETSc.Mat, load: np.ndarray, _: np.ndarray, points: np.ndarray) -> Any:
    motions = rigid_motions(points, 3, points.mean(axis=0), 1.0).reshape(len(load), -1)
    basis = [PETSc.Vec().createWithArray(np.ascontiguousarray(q)) for q in
             np.linalg.qr(motions)[0].T]  # fmt: skip
    matrix.setNearNullSpace(PETSc.NullSpace().create(vectors=basis))
    x, b = _vectors(matrix, load)
    ksp = PETSc.KSP().create()
    ksp.setOperators(matrix)
    ksp.setType("cg")
    ksp.getPC().setType("gamg")
    ksp.setTolerances(rtol=RTOL, max_it=1000)
    ksp.solve(b, x)
    return x.array.copy(), ksp.getIterationNumber()


def _cholmod(matrix: PETSc.Mat, load: np.ndarray, *_: np.ndarray) -> Any:
    x, b = _vectors(matrix, load)
    pc = PETSc.PC().create()
    pc.setOperators(matrix)
    pc.setType("cholesky")
    pc.setFactorSolverType("cholmod")
    pc.apply(b, x)
    return x.array.copy(), 1


def _bounds(matrix: PETSc.Mat, wall: np.ndarray) -> tuple[PETSc.Vec, PETSc.Vec]:
    low, high = matrix.createVecs()
    low.set(PETSc.NINFINITY)
    high.setArray(np.where(wall, 0.0, PETSc.INFINITY))
    return low, high


def _snes(matrix: PETSc.Mat, load: np.ndarray, wall: np.ndarray, _: np.ndarray) -> Any:
    x, b = _vectors(matrix, load)

    def residual(_snes: PETSc.SNES, at: PETSc.Vec, out: PETSc.Vec) -> None:
        matrix.mult(at, out)
        out.axpy(-1.0, b)

    snes = PETSc.SNES().create()
    snes.setType("vinewtonrsls")
    snes.setFunction(residual, b.duplicate())
    snes.setJacobian(lambda *_: None, matrix, matrix)
    snes.setVariableBounds(*_bounds(matrix, wall))
    snes.setTolerances(rtol=RTOL, atol=0.0, stol=0.0, max_it=100)
    snes.getKSP().setType("preonly")
    snes.getKSP().getPC().setType("cholesky")
    snes.getKSP().getPC().setFactorSolverType("cholmod")
    snes.solve(None, x)
    return x.array.copy(), snes.getIterationNumber()


def _tao(matrix: PETSc.Mat, load: np.ndarray, wall: np.ndarray, _: np.ndarray) -> Any:
    x, b = _vectors(matrix, load)

    def objective(_tao: PETSc.TAO, at: PETSc.Vec, gradient: PETSc.Vec) -> float:
        matrix.mult(at, gradient)
        energy = 0.5 * at.dot(gradient) - at.dot(b)
        gradient.axpy(-1.0, b)
        return energy

    tao = PETSc.TAO().create()
    tao.setType("bnls")
    tao.setObjectiveGradient(objective, None)
    tao.setHessian(lambda *_: None, matrix, matrix)
    tao.setVariableBounds(_bounds(matrix, wall))
    tao.setTolerances(gatol=RTOL * float(np.linalg.norm(load)), grtol=0.0, gttol=0.0)
    tao.setSolution(x)
    tao.solve()
    return x.array.copy(), tao.getIterationNumber()


def main() -> None:
    """Run one method and print its row."""
    method, cells = sys.argv[1], int(sys.argv[2])
    print(json.dumps(run(method, cells)))


if __name__ == "__main__":
    main()
