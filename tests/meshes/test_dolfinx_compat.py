import dolfinx.jit
import numpy as np
import pytest
import ufl
from dolfinx import fem

from meshes import dolfinx_compat

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def _volume(edge: float) -> float:
    """Volume of a tetrahedron by dolfinx."""
    mesh = dolfinx_compat.create_mesh(np.array([[0, 1, 2, 3]]), edge * CORNERS, "tetrahedron")
    space = dolfinx_compat.scalar_space(mesh, 1)
    load = fem.assemble_vector(dolfinx_compat.compile_form(ufl.TestFunction(space) * ufl.dx))
    return float(load.array.sum())


def test_compiled_code_is_looked_up_once_for_all_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    looked_up = []
    look_up = dolfinx.jit.ffcx_jit

    def counted(*arguments, **options):
        looked_up.append(arguments)
        return look_up(*arguments, **options)

    monkeypatch.setattr(dolfinx.jit, "ffcx_jit", counted)
    assert _volume(1.0) == pytest.approx(1.0 / 6.0)
    once = len(looked_up)
    assert _volume(2.0) == pytest.approx(8.0 / 6.0)
    assert len(looked_up) == once
    assert dolfinx.jit.ffcx_jit is counted
