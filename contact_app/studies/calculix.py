"""This application beside CalculiX on the same meshes: displacements, forces, seconds, memory.

    python -m contact_app.studies.calculix [NAME …] [--mesh FILE] [--penalty K] [-o DIR]

CalculiX (G. Dhondt, *The Finite Element Method for Three-Dimensional Thermomechanical
Applications*, 2004; Debian's calculix-ccx) uses the same nodes and tetrahedra of the mesh file, of
first or second order. Contact is its surface-to-surface penalty, p = K · penetration. Motions that
`hold` prevents here are resisted by weak springs there. A body that only contact holds is first
pushed into contact by a displacement, which is then removed. Both programs use one thread.

The displacements are compared at all nodes of the mesh, without the free sliding of bodies that
nothing holds: the largest displacement, and ‖u - u_ccx‖ over ‖u‖ in the root mean square. A second
comparison removes the rigid motion of each body from u - u_ccx, since a contact with clearance
hardly resists it. The turn is the rotation of the first body in each program, about the axis about
which they differ most. Without `ccx` nothing is done.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import meshio
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contact_app.scene.yaml_reader import read

Array = NDArray[np.float64]

ROOT = Path(__file__).parents[2]
COMMAND = "ccx"

PENALTY = 5e6
"""K, force per volume: 25 E for steel in mm; a pressure of 100 MPa penetrates by 2e-5 mm."""

SPRING = 1.0
"""Stiffness of a weak spring at each node of a body that nothing else holds, force per length."""

FACES = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
"""Corners of the faces S1 to S4 of a tetrahedron."""


class Push(NamedTuple):
    """A displacement that brings bodies into contact before loads act."""

    boundary: str
    axis: int
    value: float


@dataclass(frozen=True)
class Part:
    """A shipped scene of parts in one mesh file.

    Attributes
    ----------
    factors
        Factors of named conditions, for scenes with load cases.
    degree
        Degree in place of the file's; None to keep it.
    push
        The displacement with which CalculiX has to begin.
    mesh
        A mesh file in place of the scene's.
    """

    scene: str
    factors: dict[str, float] = field(default_factory=dict)
    degree: int | None = None
    push: Push | None = None
    mesh: str = ""


PARTS = {
    "pin_in_lug": Part(
        "configs/pin_in_lug.yaml",
        push=Push("lug.pull", 0, -0.06),
        mesh="meshes/samples/fine/pin_in_lug.msh",
    ),
    "bolted_flange": Part("configs/bolted_flange.yaml", {"pull": 1.0}, degree=1),
    "hub_on_shaft": Part("configs/hub_on_shaft.yaml"),
}


def scene_of(part: Part, mesh: Path | None = None) -> dict[str, Any]:
    """The scene of a part, without load cases, its mesh (another if given) by an absolute path."""
    path = ROOT / part.scene
    made: dict[str, Any] = read(path)[0]
    made.pop("cases", None)
    made.pop("output", None)
    for body in made["bodies"]:
        own = ROOT / part.mesh if part.mesh else path.parent / body["mesh"]["file"]
        body["mesh"]["file"] = str((mesh or own).resolve())
        if part.degree is not None:
            body["degree"] = part.degree
    active = [c for c in made["conditions"] if part.factors.get(c.get("name"), 1.0 - ("name" in c))]
    made["conditions"] = active
    return made


class Mesh:
    """Nodes, tetrahedra and named triangles of a Gmsh file."""

    def __init__(self, file: Path) -> None:
        found = meshio.read(file)
        self.points: Array = found.points
        names = {(int(d), int(n)): name for name, (n, d) in found.field_data.items()}
        self.cells: dict[str, NDArray[np.int64]] = {}
        self.facets: dict[str, NDArray[np.int64]] = {}
        for block, tags in zip(found.cells, found.cell_data["gmsh:physical"], strict=True):
            solid = block.type.startswith("tetra")
            if not solid and not block.type.startswith("triangle"):
                continue
            for tag in np.unique(tags):
                into, name = (self.cells, names[3, tag]) if solid else (self.facets, names[2, tag])
                mine = block.data[tags == tag].astype(np.int64)
                into[name] = np.concatenate([into[name], mine]) if name in into else mine
        self.first = dict(
            zip(self.cells, np.cumsum([1, *map(len, self.cells.values())]), strict=False)
        )

    def nodes(self, boundary: str) -> NDArray[np.int64]:
        """Nodes of a boundary, as body.name."""
        return np.unique(self.facets[boundary.split(".")[1]])

    def faces(self, boundary: str) -> Iterator[str]:
        """Lines of an element surface."""
        body, name = boundary.split(".")
        cells = self.cells[body]
        every = np.sort(cells[:, FACES], axis=2).reshape(-1, 3)
        wanted = {tuple(row) for row in np.sort(self.facets[name][:, :3], axis=1)}
        for k, row in enumerate(every):
            if tuple(row) in wanted:
                yield f"{self.first[body] + k // 4}, S{k % 4 + 1}"

    def forces(self, boundary: str, total: Sequence[float]) -> Iterator[str]:
        """Lines of nodal forces of a uniform traction with a total on flat facets."""
        facets = self.facets[boundary.split(".")[1]]
        x = self.points[facets[:, :3]]
        area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        at = facets if facets.shape[1] == 3 else facets[:, 3:]  # second order: midside nodes
        share = np.bincount(at.ravel(), np.repeat(area / 3.0, 3), len(self.points)) / area.sum()
        for node in np.flatnonzero(share):
            for axis, value in enumerate(total):
                if value:
                    yield f"{node + 1}, {axis + 1}, {share[node] * value:.12e}"


def deck(
    made: dict[str, Any], mesh: Mesh, push: Push | None, penalty: float = PENALTY
) -> Iterator[str]:
    """The lines of CalculiX's input."""
    yield "*NODE, NSET=ALL"
    yield from (f"{i}, {x:.12e}, {y:.12e}, {z:.12e}" for i, (x, y, z) in enumerate(mesh.points, 1))
    number = 1
    for name, cells in mesh.cells.items():
        yield f"*ELEMENT, TYPE=C3D{cells.shape[1]}, ELSET={name}"
        for cell in cells:
            yield ", ".join(map(str, [number, *(cell + 1)]))
            number += 1
    for body in made["bodies"]:
        name, material = body["name"], body["material"]
        yield f"*MATERIAL, NAME=M{name}\n*ELASTIC\n{material['young']}, {material['poisson']}"
        yield f"*SOLID SECTION, ELSET={name}, MATERIAL=M{name}"
    loose = [body["name"] for body in made["bodies"] if body.get("hold")]
    if loose:
        yield from _springs(mesh, loose, number)
    for i, contact in enumerate(made["contacts"]):
        for side in ("on", "against"):
            yield f"*SURFACE, NAME={side}{i}, TYPE=ELEMENT"
            yield from mesh.faces(contact[side])
        yield f"*SURFACE INTERACTION, NAME=I{i}\n*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"
        yield f"{penalty}\n*CONTACT PAIR, INTERACTION=I{i}, TYPE=SURFACE TO SURFACE"
        yield f"on{i}, against{i}"
    yield from (_step(made, mesh, push, pushed) for pushed in ([True, False] if push else [False]))


def _springs(mesh: Mesh, bodies: Sequence[str], number: int) -> Iterator[str]:
    """Weak springs along the axes at the nodes of bodies that nothing holds."""
    nodes = np.unique(np.concatenate([mesh.cells[name][:, :4].ravel() for name in bodies]))
    for axis in (1, 2, 3):
        yield f"*ELEMENT, TYPE=SPRING1, ELSET=WEAK{axis}"
        for node in nodes:
            yield f"{number}, {node + 1}"
            number += 1
        yield f"*SPRING, ELSET=WEAK{axis}\n{axis}\n{SPRING}"


def _step(made: dict[str, Any], mesh: Mesh, push: Push | None, pushed: bool) -> str:
    """A step: into contact by a displacement, or under the loads."""
    lines = ["*STEP, INC=1000, NLGEOM=NO", "*STATIC, SOLVER=SPOOLES", "1., 1.", "*BOUNDARY, OP=NEW"]
    loads: list[str] = []
    for condition in made["conditions"]:
        if "displacement" in condition:
            for axis, value in enumerate(condition["displacement"], 1):
                if value is not None:
                    lines += [
                        f"{n + 1}, {axis}, {axis}, {value}" for n in mesh.nodes(condition["on"])
                    ]
        else:
            loads += mesh.forces(condition["on"], condition["total_force"])
    if pushed and push is not None:
        axis = push.axis + 1
        lines += [f"{n + 1}, {axis}, {axis}, {push.value}" for n in mesh.nodes(push.boundary)]
        loads = []
    lines += ["*CLOAD, OP=NEW", *loads] if loads else []
    lines += ["*NODE PRINT, NSET=ALL", "U"]
    for i in range(len(made["contacts"])):
        lines += [f"*CONTACT PRINT, SLAVE=on{i}, MASTER=against{i}", "CF"]
    return "\n".join([*lines, "*END STEP"])


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


def printed_displacements(dat: Path, nodes: int) -> Array:
    """The last displacements in CalculiX's output, (nodes, 3)."""
    found, row = np.zeros((nodes, 3)), 0
    with dat.open(encoding="utf-8") as file:
        for line in file:
            words = line.split()
            if words[:1] == ["displacements"]:
                row = 0
            elif len(words) == 4 and row < nodes:
                found[int(words[0]) - 1] = [float(word) for word in words[1:]]
                row += 1
    return found


def printed_force(dat: Path) -> float:
    """Size of the last total contact force in CalculiX's output."""
    lines = dat.read_text(encoding="utf-8").splitlines()
    at = max(i for i, line in enumerate(lines) if "total surface force" in line)
    numbers = next(line.split() for line in lines[at + 1 :] if len(line.split()) >= 6)
    return float(np.linalg.norm([float(word) for word in numbers[:3]]))


def differences(
    made: dict[str, Any], mesh: Mesh, ours: Array, theirs: Array
) -> tuple[float, float, float]:
    """Relative differences of the largest displacement, of all, and of all without rigid motions.

    All are without the rigid motions that `hold` prevents.
    """
    ours, theirs = ours.copy(), theirs.copy()
    for body in made["bodies"]:
        if body.get("hold"):
            nodes = np.unique(mesh.cells[body["name"]])
            for u in (ours, theirs):
                u[nodes] -= _rigid_part(mesh.points[nodes], u[nodes])
    largest, other = (float(np.linalg.norm(u, axis=1).max()) for u in (ours, theirs))
    apart, size = ours - theirs, float(np.linalg.norm(ours))
    every = float(np.linalg.norm(apart)) / size
    for cells in mesh.cells.values():
        nodes = np.unique(cells)
        apart[nodes] -= _rigid_part(mesh.points[nodes], apart[nodes])
    return abs(other / largest - 1.0), every, float(np.linalg.norm(apart)) / size


def turns(made: dict[str, Any], mesh: Mesh, ours: Array, theirs: Array) -> tuple[float, float]:
    """Rotations of the first body, about the axis about which the programs differ most."""
    nodes = np.unique(mesh.cells[made["bodies"][0]["name"]])
    one, other = (_rigid_motion(mesh.points[nodes], u[nodes])[1][3:] for u in (ours, theirs))
    axis = int(np.abs(one - other).argmax())
    return float(one[axis]), float(other[axis])


def _rigid_part(points: Array, u: Array) -> Array:
    """The rigid motion nearest to displacements."""
    motions, amounts = _rigid_motion(points, u)
    return np.asarray(motions @ amounts)


def _rigid_motion(points: Array, u: Array) -> tuple[Array, Array]:
    """Basis of rigid motions about the centre, (nodes, 3, 6), and coefficients nearest to u."""
    x = points - points.mean(axis=0)
    about = [np.cross(axis, x) for axis in np.eye(3)]
    motions = np.stack([*(np.broadcast_to(e, x.shape) for e in np.eye(3)), *about], axis=2)
    return motions, np.linalg.lstsq(motions.reshape(-1, 6), u.ravel(), rcond=None)[0]


def _at_nodes(made: dict[str, Any], mesh: Mesh, file: Path) -> Array:
    """Our displacements at the nodes of the mesh file, (nodes, 3)."""
    fields = np.load(file)
    result = np.zeros((len(mesh.points), 3))
    ends = [*fields["first_node"], len(fields["points"])]
    for b, body in enumerate(made["bodies"]):
        nodes, mine = np.unique(mesh.cells[body["name"]]), slice(int(ends[b]), int(ends[b + 1]))
        place = cKDTree(fields["points"][mine]).query(mesh.points[nodes])[1]
        result[nodes] = fields["displacement"][mine][place]
    return result


def compared(
    name: str, directory: Path, mesh_file: Path | None = None, penalty: float = PENALTY
) -> dict[str, float]:
    """Both programs on a part."""
    part = PARTS[name]
    made = scene_of(part, mesh_file)
    mesh = Mesh(Path(made["bodies"][0]["mesh"]["file"]))
    directory.mkdir(parents=True, exist_ok=True)
    scene = directory / "scene.yaml"
    scene.write_text(json.dumps(made), encoding="utf-8")
    (directory / "deck.inp").write_text(
        "\n".join(deck(made, mesh, part.push, penalty)) + "\n", encoding="utf-8"
    )
    own = [sys.executable, "-m", "contact_app.studies.single_run", str(scene)]
    ours = measured([*own, "--fields", "fields.npz"], directory)
    summary = json.loads((directory / "output.txt").read_text(encoding="utf-8").splitlines()[-1])
    theirs = measured([COMMAND, "deck"], directory)
    used = np.unique(np.concatenate([cells.ravel() for cells in mesh.cells.values()]))
    u = _at_nodes(made, mesh, directory / "fields.npz")
    dat = directory / "deck.dat"
    other = printed_displacements(dat, len(mesh.points))
    largest, every, strained = differences(made, mesh, u, other)
    turn, other_turn = turns(made, mesh, u, other)
    contact = summary["contacts"][0]
    force = float(np.linalg.norm(contact["force"]))
    balanced = force < 1e-2 * contact["max_pressure"] * contact["area"]  # around a shaft
    return {
        "dofs": 3.0 * len(used), "largest": largest, "every": every,
        "strained": strained, "turn": turn, "turn ccx": other_turn,
        "force": np.nan if balanced else force, "force ccx": printed_force(dat),
        **{f"{key} ours": value for key, value in ours.items()},
        **{f"{key} ccx": value for key, value in theirs.items()},
    }  # fmt: skip


def table(
    names: Sequence[str], directory: Path, mesh: Path | None = None, penalty: float = PENALTY
) -> Iterator[str]:
    """Rows of a table for a page."""
    yield (
        "| part | unknowns | largest displacement differs by | all displacements | without rigid "
        "motions | turn | of CalculiX | contact force | of CalculiX | processor seconds | "
        "of CalculiX | memory, GB | of CalculiX |"
    )
    yield "|" + "---|" * 13
    for name in names or PARTS:
        f = compared(name, directory / name, mesh, penalty)
        forces = [f"{v:.5g}" for v in (f["force"], f["force ccx"])]
        if np.isnan(f["force"]):
            forces = ["in balance", ""]
        yield (
            f"| {name} | {f['dofs']:,.0f} | {100 * f['largest']:.2f} % | "
            f"{100 * f['every']:.2f} % | {100 * f['strained']:.2f} % | "
            f"{f['turn']:.1e} | {f['turn ccx']:.1e} | {forces[0]} | "
            f"{forces[1]} | {f['cpu ours']:.1f} | {f['cpu ccx']:.1f} | {f['gb ours']:.2f} | "
            f"{f['gb ccx']:.2f} |"
        )


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(PARTS)}; all unless given")
    parser.add_argument("-o", "--output", type=Path, default=Path("results/calculix"))
    parser.add_argument("--mesh", type=Path, help="another mesh file of the one part named")
    parser.add_argument("--penalty", type=float, default=PENALTY, help="K of CalculiX")
    given = parser.parse_args()
    if given.mesh and len(given.names) != 1:
        parser.error("--mesh is of one part: name it")
    unknown = sorted(set(given.names) - set(PARTS))
    if unknown:
        parser.error(f"unknown part {unknown[0]}; known: {', '.join(PARTS)}")
    if shutil.which(COMMAND) is None:
        print(f"skipped: there is no {COMMAND} (Debian: calculix-ccx)")
        return
    for line in table(given.names, given.output.resolve(), given.mesh, given.penalty):
        print(line, flush=True)


if __name__ == "__main__":
    main()
