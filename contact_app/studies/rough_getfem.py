"""A scene with friction by GetFEM.

    python -m contact_app.studies.rough_getfem SCENE OUTCOME

GetFEM (Y. Renard, K. Poulios, ACM Trans. Math. Softw. 47, 2020; Debian's python3-getfem) solves the
augmented Lagrangian of P. Alart and A. Curnier, written in its language of weak forms, by Newton's
method with one sparse factor per step: contact forces of degree one on the side `on`, displacements
of degree one or two. Meshes are those of this application. Each point of a round `on` side meets
the other body along the normal of its circle, as in this application; the brick for bodies that do
not match, `add_integral_contact_between_nonmatching_meshes_brick`, let the roller into the block.

Tuned are the augmentation parameter r, `AUGMENTATION` times Young's modulus over the
length of a facet, and a first displacement of the body that only contact holds. At the node on the
plane of symmetry there is no force along the floor.
"""

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from contact_app.studies.rough_models import Outcome, PlainBody, PlainScene
from meshes.arrays import Ints

AUGMENTATION = 0.3
"""r over E / h."""

TOLERANCE, STEPS = 1e-10, 60
"""Relative residual at which Newton's method ends, and its largest number of steps."""

RADIUS = 50.0
"""Radius of the roller, whose centre is at (0, RADIUS)."""

ENTERING = 0.02
"""First overlap of a body that only contact holds, relative to a facet."""

ORDER = {
    ("triangle", 1): [0, 1, 2],
    ("triangle", 2): [0, 3, 1, 5, 4, 2],
    ("hexahedron", 1): [0, 1, 3, 2, 4, 5, 7, 6],
}
"""Nodes of a cell in GetFEM's order."""

TRANSFORMATION = {"triangle": "GT_PK(2,{})", "hexahedron": "GT_QK(3,{})"}


class Program:
    """GetFEM's objects for a scene."""

    def __init__(self, scene: PlainScene) -> None:
        self.gf: Any = import_module("getfem")
        self.gf.util_trace_level(1)
        self.scene = scene
        self.model = self.gf.Model("real")
        self.meshes = [self._mesh(body) for body in scene.bodies]
        self.spaces = [self._body(b) for b in range(len(scene.bodies))]
        self._conditions()
        self.touching, self.forces = self._contact()

    def _mesh(self, body: PlainBody) -> Any:
        d = body.points.shape[1]
        curved = body.degree if body.cell == "triangle" else 1
        order = ORDER[body.cell, curved]
        mesh = self.gf.Mesh("empty", d)
        kind = self.gf.GeoTrans(TRANSFORMATION[body.cell].format(curved))
        mesh.add_convex(kind, np.moveaxis(body.points[body.cells[:, order]], 0, -1).swapaxes(0, 1))
        outer = {tuple(face) for face in mesh.outer_faces().T}
        for number, facets in enumerate(body.sides.values(), start=1):
            nodes = np.unique(facets if curved == body.degree else facets[:, : 2 ** (d - 1)])
            pids = mesh.pid_from_coords(body.points[nodes].T).ravel()
            faces = [f for f in mesh.faces_from_pid(pids).T if tuple(f) in outer]
            mesh.set_region(number, np.array(faces).T)
        return mesh

    def _region(self, body: int, side: str) -> int:
        return 1 + list(self.scene.bodies[body].sides).index(side)

    def _body(self, b: int) -> Any:
        body, model = self.scene.bodies[b], self.model
        space = self.gf.MeshFem(self.meshes[b], body.points.shape[1])
        space.set_classical_fem(body.degree)
        model.add_fem_variable(f"u{b}", space)
        model.add_fem_data(f"w{b}", space)
        young, poisson = body.young, body.poisson
        lame = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
        model.add_initialized_data(f"lame{b}", lame)
        model.add_initialized_data(f"shear{b}", 0.5 * young / (1.0 + poisson))
        model.add_isotropic_linearized_elasticity_brick(
            self.gf.MeshIm(self.meshes[b], 2 * body.degree), f"u{b}", f"lame{b}", f"shear{b}"
        )
        return space

    def _conditions(self) -> None:
        scene, model = self.scene, self.model
        for i, fixed in enumerate(scene.fixed):  # by multipliers of one component
            mesh, u = self.meshes[fixed.body], f"u{fixed.body}({fixed.axis + 1})"
            degree = scene.bodies[fixed.body].degree
            space, region = self.gf.MeshFem(mesh, 1), self._region(fixed.body, fixed.side)
            space.set_classical_fem(degree)
            model.add_filtered_fem_variable(f"hold{i}", space, region)
            model.add_initialized_data(f"value{i}", 0.0)
            test = f"Test_u{fixed.body}({fixed.axis + 1})"
            model.add_linear_term(
                self.gf.MeshIm(mesh, 2 * degree),
                f"hold{i}*{test}+({u}-value{i})*Test_hold{i}", region,
            )  # fmt: skip
        if scene.pressure is not None:
            body, side, _ = scene.pressure
            model.add_initialized_data("pressure", 0.0)
            rule = self.gf.MeshIm(self.meshes[body], 4)
            region = self._region(body, side)
            model.add_nonlinear_term(rule, f"pressure*Normal.Test_u{body}", region)

    def _contact(self) -> tuple[Ints, Any]:
        """The dofs of contact forces in their space, and that space."""
        scene, model, gf = self.scene, self.model, self.gf
        b, side = scene.on
        mesh, region, d = self.meshes[b], self._region(*scene.on), scene.dimension
        space = gf.MeshFem(mesh, d)
        space.set_classical_fem(1)
        dofs = np.asarray(space.basic_dof_on_region(region))
        where = space.basic_dof_nodes()[:, dofs]
        held = np.zeros(len(dofs), bool)
        for fixed in scene.fixed:  # of planes of symmetry
            if fixed.body != b:
                continue
            ends = scene.bodies[b].points[np.unique(scene.bodies[b].sides[fixed.side])]
            plane = ends[0, fixed.axis]
            held |= (dofs % d == fixed.axis) & (np.abs(where[fixed.axis] - plane) < 1e-9)
        free = dofs[~held]
        model.add_fem_variable("force", gf.MeshFem("partial", space, free))
        facets = scene.bodies[b].sides[side]
        size = float(np.ptp(scene.bodies[b].points[facets[:, :2]], axis=1).max(axis=1).mean())
        model.add_initialized_data("r", AUGMENTATION * scene.bodies[b].young / size)
        model.add_initialized_data("mu", scene.coefficient)
        rule = gf.MeshIm(mesh, 6)
        if scene.against is None:
            normal, gap, test, slip = "[0;0;-1]", f"X(3)+u{b}(3)", f"Test_u{b}", f"(u{b}-w{b})"
        else:
            c, height = scene.against[0], f"({RADIUS}-X(2))"
            normal = f"([X(1);-{height}]/{RADIUS})"  # along a radius of the roller to y = 0
            model.add_interpolate_transformation_from_expression(
                "T", mesh, self.meshes[c], f"[X(1)*{RADIUS}/{height};0]"
            )
            jump = f"(u{b}-Interpolate(u{c},T))"
            slip = f"({jump}-(w{b}-Interpolate(w{c},T)))"
            gap = f"X(2)*{RADIUS}/{height}-{jump}.{normal}"
            test = f"(Test_u{b}-Interpolate(Test_u{c},T))"
        model.add_nonlinear_term(rule, f"-force.{test}", region)
        law = f"Coulomb_friction_coupled_projection(force,{normal},{slip},{gap},mu,r)"
        model.add_nonlinear_term(rule, f"-(1/r)*(force-{law}).Test_force", region)
        if scene.against is not None:
            u = model.variable(f"u{b}")
            u[d - 1 :: d] = -ENTERING * size
            model.set_variable(f"u{b}", u)
        return free, space

    def solve(self) -> tuple[Outcome, list[int]]:
        """The solution at the end of the history, and the Newton steps of each increment.

        Raises
        ------
        RuntimeError
            Newton's method does not converge.
        """
        scene, model = self.scene, self.model
        steps: list[int] = []
        for factors in scene.factors:
            for i, fixed in enumerate(scene.fixed):
                factor = factors.get(fixed.name, 0.0) if fixed.name else 1.0
                model.set_variable(f"value{i}", factor * fixed.value)
            if scene.pressure is not None:
                model.set_variable("pressure", scene.pressure[2] * factors["press"])
            count, converged = model.solve(
                "max_res", TOLERANCE, "max_iter", STEPS, "lsearch", "simplest"
            )
            if not converged:
                raise RuntimeError(f"increment {len(steps) + 1}: no end in {count} steps")
            steps.append(count)
            for b in range(len(scene.bodies)):
                model.set_variable(f"w{b}", model.variable(f"u{b}"))
        return self._outcome(), steps

    def _outcome(self) -> Outcome:
        scene, model = self.scene, self.model
        d, (b, _) = scene.dimension, scene.on
        points = [space.basic_dof_nodes()[:, ::d].T for space in self.spaces]
        moved = [model.variable(f"u{i}").reshape(-1, d) for i in range(len(points))]
        every = np.zeros(self.forces.nbdof())
        every[self.touching] = model.variable("force")
        chosen = np.unique(self.touching // d)
        force = every.reshape(-1, d)[chosen]
        places = self.forces.basic_dof_nodes()[:, ::d].T[chosen]
        normal = np.zeros_like(places)
        normal[:, -1] = -1.0
        if scene.against is not None:
            normal = (places - [0.0, RADIUS]) / RADIUS
        along = force - np.einsum("ni,ni->n", force, normal)[:, None] * normal
        rule = self.gf.MeshIm(self.meshes[b], 6)
        region = self._region(*scene.on)
        total = [self.gf.asm_generic(rule, 0, f"force({i + 1})", region, model) for i in range(d)]
        return Outcome(points, moved, places, along, np.array(total, float))


def main() -> None:
    """Solve a scene from a file and save the outcome."""
    outcome, steps = Program(PlainScene.load(Path(sys.argv[1]))).solve()
    outcome.save(Path(sys.argv[2]))
    print(f"{sum(steps)} steps of Newton's method: {steps}")


if __name__ == "__main__":
    main()
