"""A scene with friction by CalculiX: its input file, and its printed output.

Contact is CalculiX's surface-to-surface penalty with `*FRICTION` (stick slope). CalculiX has
contact only in space, so a plane scene becomes one layer of wedges whose nodes stay in their
planes. Between two bodies the side `against` is the slave, so that normals are those of the side
`on`, as in this application. The floor is one fixed hexahedron.

Tuned are the penalty K and the stick slope λ, `PENALTY` and `STICK` times Young's modulus over the
length of a facet. A body that only contact holds gets a weak spring, and a first step moves it into
contact.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contact_app.studies.rough_models import Facets, Fixed, Outcome, PlainBody, PlainScene

Array = NDArray[np.float64]

PENALTY, STICK = 50.0, 5.0
"""K and λ over E / h."""

ENTERING = 0.03
"""Distance of the first step for a body that only contact holds, relative to a facet."""

SPRING = 1e-6
"""Stiffness of the spring at its nodes under pressure, over Young's modulus times the thickness."""

FACES = {
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
        if body.cell == "hexahedron":
            self.kind, self.cells = "hexahedron", first[:, :20]
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

    def nodes(self, side: str) -> NDArray[np.int64]:
        """Numbers of the nodes of a side."""
        on = np.isin(self.back, self.body.sides[side])
        return self.node + np.intersect1d(np.flatnonzero(on), self.used)

    def faces(self, side: str) -> list[tuple[int, int]]:
        """Element and number of each face of a side, from one."""
        corners = 2 ** (self.body.points.shape[1] - 1)
        wanted = {tuple(row) for row in np.sort(self.body.sides[side][:, :corners], axis=1)}
        found = []
        for number, face in enumerate(FACES[self.kind], start=1):
            if self.kind == "wedge" and number < 3:
                continue
            ends = np.sort(self.back[self.cells[:, face[:corners]]], axis=1)
            found += [(self.element + k, number) for k, e in enumerate(ends) if tuple(e) in wanted]
        return sorted(found)


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
        facets: Facets = scene.bodies[b].sides[side]
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
        steps = [({"press": 0.0}, True)] if self.scene.pressure else []
        for factors, entering in [*steps, *((f, False) for f in self.scene.factors)]:
            yield from self._step(factors, entering)

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
        yield f"{PENALTY * unit:.6e}\n*FRICTION\n{scene.coefficient}, {STICK * unit:.6e}"
        yield "*CONTACT PAIR, INTERACTION=ROUGH, TYPE=SURFACE TO SURFACE\n" + self._pair

    @property
    def _pair(self) -> str:
        """Slave and master."""
        return "ON, AGAINST" if self.scene.against is None else "AGAINST, ON"

    def _held_softly(self) -> Iterator[str]:
        """A spring where a pressure acts on a body that only contact holds."""
        if self.scene.pressure is None:
            return
        body, side, _ = self.scene.pressure
        nodes = self.solids[body].nodes(side)
        yield "*ELEMENT, TYPE=SPRING1, ELSET=WEAK"
        yield from (f"{self.after[1] + 1 + k}, {node}" for k, node in enumerate(nodes))
        stiff = SPRING * self.solids[body].body.young / len(nodes)
        yield f"*SPRING, ELSET=WEAK\n{self.scene.dimension}\n{stiff:.6e}"

    def _step(self, factors: dict[str, float], entering: bool) -> Iterator[str]:
        """A step to the load factors, or the first step into contact."""
        scene = self.scene
        yield "*STEP, INC=1000, NLGEOM=NO\n*STATIC\n1., 1.\n*BOUNDARY, OP=NEW"
        if scene.against is None:
            yield "FLOOR, 1, 3"
        if scene.dimension == 2:
            yield "ALL, 3, 3"
        fixed = list(scene.fixed)
        if entering and scene.pressure is not None:
            body, side, _ = scene.pressure
            axis = scene.dimension - 1
            fixed.append(Fixed(body, side, axis, -ENTERING * self.size, ""))
        for f in fixed:
            value = f.value * (factors.get(f.name, 0.0) if f.name else 1.0)
            for node in self.solids[f.body].nodes(f.side):
                yield f"{node}, {f.axis + 1}, {f.axis + 1}, {value:.12e}"
        if scene.pressure is not None and not entering:
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
        own = 1.0 if self.scene.against is None else -1.0
        none = np.zeros((0, d))
        return Outcome(points, displacements, none, none, own * force)


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
