"""A rigid ball pressed into a block: contact for a form of dolfinx, beside the theory of Hertz.

A quarter of the block is modelled, and its mesh refined towards the contact by moving the nodes.
Run it with ``python docs/guide/hertz_with_forms.py``, on ranks under ``mpirun``. Units: mm, N, MPa.
"""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from contact_app import Contact, ContactProblem, Sphere

RADIUS, FORCE, YOUNG, POISSON = 8.0, 0.1, 200.0, 0.3
block = mesh.create_unit_cube(MPI.COMM_WORLD, 16, 16, 16, mesh.CellType.hexahedron)
block.geometry.x[:] **= 2  # corner cells become small; the ball touches at the origin
if hasattr(fem, "functionspace"):  # dolfinx 0.9
    V = fem.functionspace(block, ("Lagrange", 1, (3,)))
else:
    V = fem.VectorFunctionSpace(block, ("Lagrange", 1))

top = mesh.locate_entities_boundary(block, 2, lambda x: np.isclose(x[2], 0))
tags = mesh.meshtags(block, 2, np.sort(top), np.full(len(top), 1, np.int32))

u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
lam, mu = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON), YOUNG / 2 / (1 + POISSON)
strain = lambda w: ufl.sym(ufl.grad(w))  # noqa: E731
stress = lam * ufl.tr(strain(u)) * ufl.Identity(3) + 2 * mu * strain(u)
a = ufl.inner(stress, strain(v)) * ufl.dx
far = ufl.conditional(ufl.gt(ufl.SpatialCoordinate(block)[2], 0.9999), 1.0, 0.0)
L = -FORCE / 4 * far * v[2] * ufl.ds  # on a quarter, of which the far side has the area one
bcs = [
    fem.dirichletbc(0.0, fem.locate_dofs_topological(V.sub(i), 2, mesh.locate_entities_boundary(
        block, 2, lambda x, i=i: np.isclose(x[i], 0))), V.sub(i))
    for i in (0, 1)
]  # fmt: skip
ball = Sphere(center=(0, 0, -RADIUS), radius=RADIUS)
problem = ContactProblem(a, L, bcs, [Contact(tags, 1, ball)], tolerance=1e-8)
uh = problem.solve()  # a Function, as of LinearProblem

modulus = YOUNG / (1 - POISSON**2)
radius = (3 * FORCE * RADIUS / (4 * modulus)) ** (1 / 3)
contact = problem.summary["contacts"][0]
if block.comm.rank == 0:
    print(f"certified: {problem.certificate.passed}")
    print(f"force on a quarter: {contact['force'][2]:.6f} ({FORCE / 4})")
    print(f"largest pressure: {contact['max_pressure']:.3f} "
          f"(Hertz {3 * FORCE / (2 * np.pi * radius**2):.3f})")  # fmt: skip
    print(f"contact radius: {np.sqrt(4 * contact['area'] / np.pi):.4f} (Hertz {radius:.4f})")
