"""Stiffness of the bodies of a contact of forms, as Hertz's theory has it.

The bulk modulus K of d dimensions and the shear modulus G follow from the energies of a form
(`contact_app.forms.locking.Moduli`). With λ = K - 2 G/d the modulus E/(1 - ν²) of the theory is

    4 G (λ + G)/(λ + 2 G),

and E in plane stress, whose K is E/(2 (1 - ν)). A material is isotropic if one more change of shape
has the energy that follows from K and G.
"""

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from contact_app.accuracy.hertz import thickness_at
from contact_app.forms.boundary import exterior_facets
from contact_app.forms.locking import Moduli
from contact_app.forms.model import FormModel
from contact_app.forms.results import Owners
from meshes import dolfinx_compat
from meshes.arrays import Array

EQUAL = 1e-3
"""Largest relative difference of moduli that count as equal."""

STRAIN = np.array([[1.0, 0.3, 0.5], [0.3, -0.7, 0.2], [0.5, 0.2, 0.4]])
"""A change of shape and volume whose energies differ in different materials."""


def half_spaces(
    model: FormModel, owners: Owners, number: int, middle: Array, normal: Array
) -> tuple[float, float] | None:
    """E* of the bodies of a contact, and the least of their thicknesses behind its middle (3,).

    None if one is not of one isotropic material (collective).
    """
    parts, d = model.parts, model.parts.dimension
    of_copies = owners.copies(model.bodies.of_node.astype(float)).astype(np.int64)
    body = of_copies[parts.cells[:, 0]]
    moduli = model.moduli or Moduli.of(parts, model.form)
    strain = np.tile(STRAIN[:d, :d], (len(body), 1, 1))
    middles = parts.points[parts.cells].mean(axis=1)[:, :d]
    energies = moduli.energies.of_affine(strain, middles, np.zeros_like(middles))
    cells = dolfinx_compat.cellwise_scalars(parts.space.mesh)
    integral = dolfinx_compat.compile_form(ufl.TestFunction(cells) * ufl.dx)
    size = fem.assemble_vector(integral).array[dolfinx_compat.dof_nodes(cells)[: len(body), 0]]
    K, G = moduli.volume / (d * size), moduli.shape / (2.0 * size)
    part = K + (1.0 - 2.0 / d) * G
    isotropic = np.abs(moduli.energy(strain[None]) - energies) <= EQUAL * energies
    compliance = np.where(isotropic, (part + G) / (4.0 * G * part), np.inf)
    total, thickness, outside = 0.0, np.inf, exterior_facets(parts)
    body_of_facet = of_copies[outside.copies[:, 0]]
    for side in model.sides[number].surfaces:
        bodies = sorted(model.bodies_at(side))
        on = np.isin(body_of_facet, bodies)
        thickness = min(thickness, thickness_at(parts.comm, [outside.points[on]], middle, normal))
        of_side = compliance[np.isin(body, bodies)]
        least = parts.comm.allreduce(float(of_side.min(initial=np.inf)), op=MPI.MIN)
        most = parts.comm.allreduce(float(of_side.max(initial=0.0)), op=MPI.MAX)
        if most > (1.0 + EQUAL) * least or most == np.inf:
            return None
        total += most
    return 1.0 / total, float(thickness)
