"""Ranks that share the checks of a mesh, or the rows of pairs, find what one rank finds."""

import tempfile
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from meshes import MeshError
from meshes.mortar import mean_gaps
from meshes.repair import load_mesh
from meshes.ties import Decided, mean_jumps
from tests import meshfiles
from tests.meshes.test_mortar import cap, patch
from tests.ranks import execute


def broken() -> dict[str, meshio.Mesh]:
    """A spiral that runs into itself, cells within others, and hanging nodes."""
    coarse, fine = (meshfiles.block("hexahedron", n) for n in (2, 4))
    points = np.vstack([coarse.points, fine.points + [1.0, 0, 0]])
    cells = np.vstack([coarse.cells[0].data, fine.cells[0].data + len(coarse.points)])
    return {
        "cross": meshfiles.spiral("tetrahedron", 1.6, 0.4, 0.2),
        "in other cells": meshfiles.two_sheets(),
        "hanging": meshfiles.of_cells("hexahedron", points, cells),
    }


def message(mesh: meshio.Mesh, comm: MPI.Intracomm) -> str:
    """The message that refuses a broken mesh."""
    dimension = 3 if mesh.cells[0].type in ("tetra", "hexahedron") else 2
    with tempfile.TemporaryDirectory() as directory:
        path = meshfiles.write(mesh, Path(directory) / "a.vtu", None)
        with pytest.raises(MeshError) as caught:
            load_mesh(path, dimension, comm=comm)
    return str(caught.value)


def compare_with_one_rank() -> None:
    """Messages, and the rows of pairs in contact and tied; one of them has a single facet."""
    comm = MPI.COMM_WORLD
    for words, mesh in broken().items():
        told = message(mesh, comm)
        assert words in told
        assert told == message(mesh, MPI.COMM_SELF)
    for on, against in (
        (cap(7, 1.0, 0, False), cap(5, 1.05, 1000, True)),
        (patch("triangle", 1, False), patch("quadrilateral", 3, True, first=1000)),
    ):
        together, alone = mean_gaps(on, against, comm), mean_gaps(on, against)
        for name, values in vars(alone).items():
            np.testing.assert_allclose(getattr(together, name), values, rtol=1e-12, atol=1e-14)
        nothing = Decided(np.zeros(0, np.int64), np.zeros((0, 3), bool), np.zeros(0, np.int64))
        shared, own = mean_jumps(on, against, nothing, comm), mean_jumps(on, against, nothing)
        assert shared.gap == pytest.approx(own.gap, abs=1e-14)
        for rows, expected in zip(shared.rows, own.rows, strict=True):
            for name, values in vars(expected).items():
                np.testing.assert_allclose(getattr(rows, name), values, rtol=1e-12, atol=1e-14)


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, 3])
def test_several_ranks_find_the_cells_of_one_rank(ranks: int) -> None:
    program = "from tests.meshes.test_shares import compare_with_one_rank as c; c(); print('ok')"
    assert execute(program, ranks=ranks).count("ok") == ranks
