"""A plain scene by CalculiX: its input file, its run, and its printed output.

Contact is CalculiX's surface-to-surface penalty, with `*FRICTION` (stick slope) where there is
friction. CalculiX has contact only in space, so a plane scene becomes one layer of wedges whose
nodes stay in their planes. Between two bodies with friction the side `against` is the slave, so
that normals are those of the side `on`, as in this application. The floor is one fixed hexahedron.

Tuned are the penalty K and the stick slope λ, `PENALTY` and `STICK` times Young's modulus over the
length of a facet. A body that only contact holds gets weak springs, and a first step moves it into
contact.
"""

import os
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from contact_app.studies.rough_models import Fixed, Outcome, PlainBody, PlainScene
from meshes.arrays import Ints

COMMAND = "ccx"

PENALTY, STICK = 50.0, 5.0
"""K and λ over E / h."""

ENTERING = 0.03
"""Distance of the first step for a body that only contact holds, relative to a facet."""

SPRING = 1e-6
"""Stiffness of the spring at its nodes under pressure, over Young's modulus times the thickness."""

LOOSE = 1.0
"""Stiffness of a weak spring at each corner node of a loose body, force per length."""

FACES = {
    "tetrahedron": [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]],
    "wedge": [[0, 1, 2], [3, 4, 5], [0, 1, 4, 3], [1, 2, 5, 4], [2, 0, 3, 5]],
    "hexahedron": [
        [0, 1, 2, 3], [4, 7, 6, 5], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0],
    ],
}  # fmt: skip
"""Corners of the faces S1, S2, … of an element."""


class _Solid:
    """A body in space, numbered after the previous bodies.

    Attributes
    ----------
    points : (nodes, 3)
    node, element
        First numbers, from one.
    back : (nodes,)
        Node of the plane body below each node.
    """

    def __init__(self, body: PlainBody, node: int, element: int) -> None:
        self.node, self.element, self.body = node, element, body
        n, first = len(body.points), body.cells
        self.corners = 3 if body.cell == "tetrahedron" else 2 ** (body.points.shape[1] - 1)
        if body.cell != "triangle":
            self.kind, self.cells = body.cell, first[:, :20]
            self.points, self.back = body.points, np.arange(n)
        else:
            self.kind = "wedge"
            corners = np.unique(first[:, :3])
            middle = np.full(n, -1)
            middle[corners] = 2 * n + np.arange(len(corners))
            layers = [first[:, :3], first[:, :3] + n]
            if body.degree == 2:
                layers += [first[:, 3:], first[:, 3:] + n, middle[first[:, :3]]]
            self.cells = np.concatenate(layers, axis=1)
            levels = [(body.points, 0.0), (body.points, 1.0)]
            self.back = np.concatenate([np.arange(n), np.arange(n)])
            if body.degree == 2:
                levels.append((body.points[corners], 0.5))
                self.back = np.concatenate([self.back, corners])
            self.points = np.concatenate(
                [np.column_stack([x, np.full(len(x), z)]) for x, z in levels]
            )
        used = np.unique(self.cells)  # without nodes inside faces and cells
        self.used = used

    @property
    def type(self) -> str:
        """CalculiX's type of its elements."""
        return f"C3D{self.cells.shape[1]}"

    def nodes(self, side: str) -> Ints:
        """Numbers of the nodes of a side."""
        on = np.isin(self.back, self.body.sides[side])
        return self.node + np.intersect1d(np.flatnonzero(on), self.used)

    def faces(self, side: str) -> list[tuple[int, int]]:
        """Element and number of each face of a side, from one."""
        wanted = {tuple(row) for row in np.sort(self.body.sides[side][:, : self.corners], axis=1)}
        faces = []
        for number, face in enumerate(FACES[self.kind], start=1):
            if self.kind == "wedge" and number < 3:
                continue
            ends = np.sort(self.back[self.cells[:, face[: self.corners]]], axis=1)
            faces += [(self.element + k, number) for k, e in enumerate(ends) if tuple(e) in wanted]
        return sorted(faces)

    def forces(self, side: str, total: Sequence[float]) -> Iterator[str]:
        """Lines of nodal forces of a uniform traction with a total on flat triangles."""
        facets = self.body.sides[side]
        x = self.points[facets[:, :3]]
        area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        at = facets[:, -3:]  # vertices; of second order the middles of edges
        share = np.bincount(at.ravel(), np.repeat(area / 3.0, 3), len(self.points)) / area.sum()
        for node in np.flatnonzero(share):
            for axis, value in enumerate(total, start=1):
                if value:
                    yield f"{self.node + node}, {axis}, {share[node] * value:.12e}"


class Deck:
    """CalculiX's input for a scene, and how to read its output."""

    def __init__(self, scene: PlainScene) -> None:
        self.scene = scene
        self.solids: list[_Solid] = []
        node = element = 1
        for body in scene.bodies:
            self.solids.append(_Solid(body, node, element))
            node += len(self.solids[-1].points)
            element += len(self.solids[-1].cells)
        self.after = (node, element)
        b, side = scene.on
        facets: Ints = scene.bodies[b].sides[side]
        x = scene.bodies[b].points
        self.size = float(np.linalg.norm(x[facets[:, 0]] - x[facets[:, 1]], axis=1).mean())

    def lines(self) -> Iterator[str]:
        """The whole input."""
        for b, solid in enumerate(self.solids):
            yield "*NODE, NSET=ALL"
            for i in solid.used:
                yield ", ".join([str(solid.node + i), *(f"{v:.12e}" for v in solid.points[i])])
            yield f"*ELEMENT, TYPE={solid.type}, ELSET=B{b}"
            for number, cell in enumerate(solid.cells + solid.node, start=solid.element):
                words = [str(number), *map(str, cell)]
                yield ", ".join(words[:11]) + ("," if len(words) > 11 else "")
                if len(words) > 11:
                    yield ", ".join(words[11:])
            yield f"*MATERIAL, NAME=M{b}\n*ELASTIC\n{solid.body.young}, {solid.body.poisson}"
            yield f"*SOLID SECTION, ELSET=B{b}, MATERIAL=M{b}"
        yield from self._contact()
        yield from self._held_softly()
        push = self._push()
        if push is not None:
            yield from self._step({}, push)
        for factors in self.scene.factors:
            yield from self._step(factors, None)

    def _contact(self) -> Iterator[str]:
        scene = self.scene
        yield "*SURFACE, NAME=ON, TYPE=ELEMENT"
        yield from (f"{e}, S{s}" for e, s in self.solids[scene.on[0]].faces(scene.on[1]))
        if scene.against is None:
            node, element = self.after
            floor = [[-9, -9, -9], [9, -9, -9], [9, 9, -9], [-9, 9, -9]]
            floor += [[x, y, 0] for x, y, _ in floor]
            yield "*NODE, NSET=FLOOR"
            yield from (f"{node + i}, {x}, {y}, {z}" for i, (x, y, z) in enumerate(floor))
            yield "*ELEMENT, TYPE=C3D8, ELSET=BF"
            yield ", ".join(map(str, [element, *range(node, node + 8)]))
            yield "*SOLID SECTION, ELSET=BF, MATERIAL=M0"
            yield f"*SURFACE, NAME=AGAINST, TYPE=ELEMENT\n{element}, S2\n*BOUNDARY\nFLOOR, 1, 3"
        else:
            yield "*SURFACE, NAME=AGAINST, TYPE=ELEMENT"
            other = self.solids[scene.against[0]]
            yield from (f"{e}, S{s}" for e, s in other.faces(scene.against[1]))
        unit = min(body.young for body in scene.bodies) / self.size
        yield "*SURFACE INTERACTION, NAME=ROUGH\n*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"
        yield f"{scene.penalty or PENALTY * unit:.6e}"
        if scene.coefficient:
            yield f"*FRICTION\n{scene.coefficient}, {STICK * unit:.6e}"
        yield "*CONTACT PAIR, INTERACTION=ROUGH, TYPE=SURFACE TO SURFACE\n" + self._pair

    @property
    def _pair(self) -> str:
        """Slave and master."""
        rough_pair = self.scene.against is not None and self.scene.coefficient
        return "AGAINST, ON" if rough_pair else "ON, AGAINST"

    def _held_softly(self) -> Iterator[str]:
        """Weak springs along axes at the nodes of bodies that nothing but contact holds."""
        number = self.after[1] + 1
        for axes, nodes, stiffness in self._springs():
            for axis in axes:
                yield f"*ELEMENT, TYPE=SPRING1, ELSET=WEAK{number}"
                yield from (f"{number + k}, {node}" for k, node in enumerate(nodes))
                yield f"*SPRING, ELSET=WEAK{number}\n{axis}\n{stiffness:.6e}"
                number += len(nodes)

    def _springs(self) -> Iterator[tuple[Sequence[int], Ints, float]]:
        """Axes, nodes and stiffness: where a pressure acts, and all over loose bodies."""
        if self.scene.pressure is not None:
            body, side, _ = self.scene.pressure
            nodes = self.solids[body].nodes(side)
            stiffness = SPRING * self.solids[body].body.young / len(nodes)
            yield [self.scene.dimension], nodes, stiffness
        loose = [self.solids[body] for body in self.scene.loose]
        for solid in loose:
            yield [1, 2, 3], solid.node + np.unique(solid.cells[:, :4]), LOOSE

    def _push(self) -> Fixed | None:
        """The displacement of a first step that moves a body into contact."""
        scene = self.scene
        if scene.pressure is None:
            return scene.push
        body, side, _ = scene.pressure
        return Fixed(body, side, scene.dimension - 1, -ENTERING * self.size, "")

    def _step(self, factors: dict[str, float], push: Fixed | None) -> Iterator[str]:
        """A step to the load factors, or the first step into contact."""
        scene = self.scene
        yield "*STEP, INC=1000, NLGEOM=NO\n*STATIC, SOLVER=SPOOLES\n1., 1.\n*BOUNDARY, OP=NEW"
        if scene.against is None:
            yield "FLOOR, 1, 3"
        if scene.dimension == 2:
            yield "ALL, 3, 3"
        fixed = [*scene.fixed, *([push] if push else [])]
        for f in fixed:
            value = f.value * (factors.get(f.name, 0.0) if f.name else 1.0)
            for node in self.solids[f.body].nodes(f.side):
                yield f"{node}, {f.axis + 1}, {f.axis + 1}, {value:.12e}"
        if scene.forces and push is None:
            yield "*CLOAD, OP=NEW"
            for body, side, total in scene.forces:
                yield from self.solids[body].forces(side, total)
        if scene.pressure is not None and push is None:
            body, side, value = scene.pressure
            yield "*DLOAD, OP=NEW"
            for element, face in self.solids[body].faces(side):
                yield f"{element}, P{face}, {value * factors['press']:.12e}"
        yield "*NODE PRINT, NSET=ALL\nU"
        yield f"*CONTACT PRINT, SLAVE={self._pair.replace(', ', ', MASTER=')}\nCF"
        yield "*END STEP"

    def outcome(self, dat: Path) -> Outcome:
        """The last lines printed by CalculiX."""
        tables = _tables(dat)
        moved = {int(row[0]): row[1:] for row in tables["displacements"]}
        d, points, displacements = self.scene.dimension, [], []
        for solid in self.solids:
            flat = solid.used[solid.used < len(solid.body.points)]
            points.append(solid.body.points[flat])
            displacements.append(np.array([moved[solid.node + i][:d] for i in flat]))
        force = np.array(tables["total surface force"][0][:d])
        sign = 1.0 if self.scene.against is None else -1.0
        none = np.zeros((0, d))
        return Outcome(points, displacements, none, none, sign * force)


def _tables(dat: Path) -> dict[str, list[list[float]]]:
    """The last rows of numbers below each heading, by its first words."""
    names = ("displacements", "total surface force")
    tables: dict[str, list[list[float]]] = {name: [] for name in names}
    name = ""
    with dat.open(encoding="utf-8") as file:
        for line in file:
            words = line.split()
            heading = next((n for n in names if line.strip().startswith(n)), "")
            if heading:
                name, tables[heading] = heading, []
            elif words and name:
                try:
                    tables[name].append([float(w) for w in words])
                except ValueError:
                    name = ""
    return tables


def measured(command: Sequence[str], directory: Path) -> dict[str, float]:
    """Run a command on one thread: seconds of processor and clock, and peak memory in GB.

    Raises
    ------
    RuntimeError
        The command failed.
    """
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1"}
    begin = time.perf_counter()
    with (directory / "output.txt").open("w", encoding="utf-8") as out:
        process = subprocess.Popen(
            command, cwd=directory, stdout=out, stderr=subprocess.STDOUT, env={**os.environ, **one}
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{command[0]} failed; see {directory / 'output.txt'}")
    return {
        "cpu": usage.ru_utime + usage.ru_stime, "clock": time.perf_counter() - begin,
        "gb": usage.ru_maxrss * 1024 / 1e9,
    }  # fmt: skip
