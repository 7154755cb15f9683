"""A ball pressed into a block of wood that lies on springs: an orthotropic material.

Along the grain (x) spruce is twenty times as stiff as across, and the contact patch is no circle.
The block lies on a bed of springs, a term of the form ``a``; no Dirichlet condition is needed.
Run it with ``python docs/guide/orthotropic_block.py``. Units: mm, N, MPa.
"""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from contact_app import Contact, ContactProblem, Sphere

# Young's moduli, Poisson's ratios and shear moduli: x along the grain, y radial, z tangential
E = 10_000.0, 800.0, 450.0
NU_XY, NU_XZ, NU_YZ = 0.37, 0.42, 0.47
G_YZ, G_XZ, G_XY = 40.0, 620.0, 660.0
compliance = np.diag([1 / E[0], 1 / E[1], 1 / E[2], 1 / G_YZ, 1 / G_XZ, 1 / G_XY])
compliance[0, 1] = compliance[1, 0] = -NU_XY / E[0]
compliance[0, 2] = compliance[2, 0] = -NU_XZ / E[0]
compliance[1, 2] = compliance[2, 1] = -NU_YZ / E[1]
C = ufl.as_matrix(np.linalg.inv(compliance).tolist())

corners = [np.array([-10.0, -10.0, 0.0]), np.array([10.0, 10.0, 8.0])]
block = mesh.create_box(MPI.COMM_WORLD, corners, [24, 24, 8], mesh.CellType.hexahedron)
if hasattr(fem, "functionspace"):  # dolfinx 0.9
    V = fem.functionspace(block, ("Lagrange", 1, (3,)))
else:
    V = fem.VectorFunctionSpace(block, ("Lagrange", 1))
faces = [mesh.locate_entities_boundary(block, 2, lambda x, z=z: np.isclose(x[2], z))
         for z in (0.0, 8.0)]  # fmt: skip
facets, values = np.concatenate(faces), np.repeat([1, 2], [len(f) for f in faces])
order = np.argsort(facets)
tags = mesh.meshtags(block, 2, facets[order], values[order].astype(np.int32))
BED, TOP = 1, 2


def strain(w):
    """Voigt's vector: xx, yy, zz, 2 yz, 2 xz, 2 xy."""
    e = ufl.sym(ufl.grad(w))
    return ufl.as_vector([e[0, 0], e[1, 1], e[2, 2], 2 * e[1, 2], 2 * e[0, 2], 2 * e[0, 1]])


u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
ds = ufl.ds(domain=block, subdomain_data=tags)
springs = 50.0 * ufl.inner(u, v) * ds(BED)  # N/mm per mm²
a = ufl.inner(C * strain(u), strain(v)) * ufl.dx + springs
L = ufl.inner(fem.Constant(block, np.zeros(3)), v) * ufl.dx
ball = Sphere(center=(0, 0, 8 + 30 - 0.3), radius=30)  # pressed in by 0.3 mm
problem = ContactProblem(a, L, [], [Contact(tags, TOP, ball, name="top")], tolerance=1e-8)
uh = problem.solve()

pressure = problem.contact_pressure  # a Function
x = pressure.function_space.tabulate_dof_coordinates()
pushed = x[pressure.x.array > 0]
along, across = (block.comm.allreduce(np.abs(pushed[:, i]).max(initial=0), op=MPI.MAX)
                 for i in (0, 1))  # fmt: skip
if block.comm.rank == 0:
    print(f"certified: {problem.certificate.passed}")
    print(f"force: {-problem.summary['contacts'][0]['force'][2]:.1f} N")
    print(f"half length of the contact: {along:.2f} mm along the grain, {across:.2f} mm across")
