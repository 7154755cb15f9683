"""A stiff layer on a soft ground, pressed on a wavy floor: a notebook that plots.

The cells between the ``# %%`` lines run one by one in Jupyter or an editor, or all at once with
``python docs/guide/contact_of_layers.py [picture.png]``.
"""

# %% The body: 4 long and 1 high, its lower fifth ten times as stiff as the rest.
import sys

import matplotlib as mpl
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from contact_app import Contact, ContactProblem

mpl.use("Agg")  # in a notebook leave this out
import matplotlib.pyplot as plt

corners = [np.array([0.0, 0.0]), np.array([4.0, 1.0])]
body = mesh.create_rectangle(MPI.COMM_SELF, corners, [80, 20], mesh.CellType.triangle)
if hasattr(fem, "functionspace"):  # dolfinx 0.9
    V = fem.functionspace(body, ("Lagrange", 1, (2,)))
else:
    V = fem.VectorFunctionSpace(body, ("Lagrange", 1))
u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
height = ufl.SpatialCoordinate(body)[1]
young = ufl.conditional(ufl.lt(height, 0.2), 10.0, 1.0)
strain = ufl.sym(ufl.grad(u))
stress = young * (0.6 * ufl.tr(strain) * ufl.Identity(2) + 0.8 * strain)
a = ufl.inner(stress, ufl.sym(ufl.grad(v))) * ufl.dx

# %% Its loads and the floor: a signed distance takes points (n, 2) and returns (n,).
bottom = mesh.locate_entities_boundary(body, 1, lambda x: np.isclose(x[1], 0))
top = mesh.locate_entities_boundary(body, 1, lambda x: np.isclose(x[1], 1))
tags = mesh.meshtags(body, 1, np.sort(bottom), np.full(len(bottom), 1, np.int32))
pressed = fem.dirichletbc(np.array([0.0, -0.05]), fem.locate_dofs_topological(V, 1, top), V)
L = ufl.inner(fem.Constant(body, np.zeros(2)), v) * ufl.dx


def floor(x):
    """Height of a point over a wavy floor, and so about its distance from it."""
    return x[:, 1] - 0.02 * (np.cos(2 * np.pi * x[:, 0]) - 1)


# %% Solve.
problem = ContactProblem(a, L, [pressed], [Contact(tags, 1, floor)], tolerance=1e-8)
uh = problem.solve()
print(f"certified: {problem.certificate.passed}")
print(f"force per thickness: {problem.summary['contacts'][0]['force'][1]:.4f}")

# %% Plot the deformed body, and the pressure along its lower side.
x, moved = V.tabulate_dof_coordinates(), uh.x.array.reshape(-1, 2)
dofs = V.dofmap.list
triangles = np.asarray(dofs if isinstance(dofs, np.ndarray) else dofs.array).reshape(-1, 3)
figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
drawn = upper.tripcolor(
    x[:, 0] + moved[:, 0], x[:, 1] + moved[:, 1], triangles, moved[:, 1], shading="gouraud"
)
figure.colorbar(drawn, ax=upper, label="vertical displacement")
upper.set_aspect("equal")
at = problem.contact_pressure.function_space.tabulate_dof_coordinates()
below = np.flatnonzero(np.isclose(at[:, 1], 0))
below = below[np.argsort(at[below, 0])]
lower.plot(at[below, 0], problem.contact_pressure.x.array[below], label="pressure")
lower.plot(at[below, 0], problem.gap.x.array[below], label="gap")
lower.set_xlabel("x")
lower.legend()
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=120)
    print(f"wrote {sys.argv[1]}")
