"""Energy that a form gives to displacements, cell by cell.

The moduli of a form follow from its energies in a cell under displacements b + G x: with
G = I the resistance to a change of volume, with tr G = 0 that to a change of shape.
"""

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from contact_app.forms.uniform import EqualCells
from meshes import dolfinx_compat
from meshes.arrays import Array


class CellEnergies:
    """a(w, w) over each cell that this rank owns, without the integrals over facets.

    The displacement w is a Function u of the space, or b + G x with b and G constant in each cell.
    One compiled form serves both, or the matrices of equal cells where these have all integrals.

    Attributes
    ----------
    reduced
        Whether some integral over cells is by one point.
    """

    def __init__(self, form: Any, space: Any, equal: EqualCells | None = None) -> None:
        mesh, d = space.mesh, space.mesh.topology.dim
        integrals = [part for part in form.integrals() if part.integral_type() == "cell"]
        self.reduced = any(part.metadata().get("quadrature_degree", 2) < 2 for part in integrals)
        self._equal = equal if equal is not None and equal.complete else None
        if self._equal is not None:
            self._points = space.tabulate_dof_coordinates()[:, :d][self._equal.nodes]
            return
        self._cells = mesh.topology.index_map(d).size_local
        self._u, self._factor = fem.Function(space), fem.Constant(mesh, 0.0)
        self._affine = fem.Function(dolfinx_compat.cellwise_vectors(mesh, d + d * d))
        x, part = ufl.SpatialCoordinate(mesh), self._affine
        w = ufl.as_vector([
            self._factor * self._u[i] + part[i] + sum(part[d + d * i + j] * x[j] for j in range(d))
            for i in range(d)
        ])  # fmt: skip
        of_cells = dolfinx_compat.cellwise_scalars(mesh)
        q = ufl.TestFunction(of_cells)
        replaced = dict.fromkeys(form.arguments(), w)
        self._form = dolfinx_compat.compile_form(
            ufl.Form([
                integral.reconstruct(integrand=q * ufl.replace(integral.integrand(), replaced))
                for integral in integrals
            ])
        )  # fmt: skip
        self._places = dolfinx_compat.dof_nodes(of_cells)[: self._cells, 0]
        self._affine_places = dolfinx_compat.dof_nodes(self._affine.function_space)[:, 0]

    def of(self, u: Array) -> Array:
        """Energies (cells,) of a displacement, (nodes of the space with ghosts, d)."""
        if self._equal is not None:
            return self._equal.energies(u[self._equal.nodes])
        self._u.x.array[:] = u.ravel()
        self._affine.x.array[:] = 0.0
        return self._assembled(1.0)

    def of_affine(self, gradient: Array, middle: Array, value: Array) -> Array:
        """Energies (cells,) of value + gradient (x - middle).

        Parameters
        ----------
        gradient : (cells, d, d)
            ∂w_i / ∂x_j.
        middle, value : (cells, d)
        """
        if self._equal is not None:
            at = (self._points - middle[:, None]) @ np.swapaxes(gradient, 1, 2)
            return self._equal.energies(at + value[:, None])
        offset = value - (gradient @ middle[:, :, None])[:, :, 0]
        entries = np.concatenate([offset, gradient.reshape(len(gradient), -1)], axis=1)
        at = self._affine_places[: self._cells]
        self._affine.x.array.reshape(-1, entries.shape[1])[at] = entries
        return self._assembled(0.0)

    def _assembled(self, factor: float) -> Array:
        self._factor.value = factor
        return np.asarray(fem.assemble_vector(self._form).array[self._places])
