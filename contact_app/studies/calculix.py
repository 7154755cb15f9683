"""This application beside CalculiX on the same meshes: displacements, forces, seconds, memory.

    python -m contact_app.studies.calculix [NAME …] [-o DIR]

CalculiX (G. Dhondt, *The Finite Element Method for Three-Dimensional Thermomechanical
Applications*, 2004; Debian's calculix-ccx) uses the same nodes and tetrahedra of the mesh file, of
first or second order. Contact is its surface-to-surface penalty, p = K · penetration. Motions that
`hold` prevents here are resisted by weak springs there. A body that only contact holds is first
pushed into contact by a displacement, which is then removed. Both programs use one thread.

The displacements are compared at all nodes of the mesh, without the free sliding of bodies that
nothing holds: the largest displacement, and ‖u - u_ccx‖ over ‖u‖ in the root mean square. A second
comparison removes the rigid motion of each body from u - u_ccx, since a contact with clearance
hardly resists it. Without `ccx` nothing is done.
"""

import argparse
import json
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from contact_app.scene.yaml_reader import read
from contact_app.studies.calculix_deck import COMMAND, Deck, measured
from contact_app.studies.rough_models import Fixed, PlainScene
from contact_app.studies.rough_scenes import plain_body
from meshes.arrays import Array

Fields = Sequence[Array]
"""An array for each body."""

ROOT = Path(__file__).parents[2]
PENALTY = 5e6
"""K, force per volume: 25 E for steel in mm; a pressure of 100 MPa penetrates by 2e-5 mm."""


@dataclass(frozen=True)
class Part:
    """A shipped scene of parts in one mesh file."""

    scene: str
    factors: dict[str, float] = field(default_factory=dict)
    """Factors of named conditions, for scenes with load cases."""
    degree: int | None = None
    """Degree in place of the file's; None to keep it."""
    push: Fixed | None = None
    """The displacement with which CalculiX has to begin."""
    mesh: str = ""
    """A mesh file in place of the scene's."""


PARTS = {
    "pin_in_lug": Part(
        "configs/pin_in_lug.yaml",
        push=Fixed(0, "pull", 0, -0.06, ""),
        mesh="meshes/samples/fine/pin_in_lug.msh",
    ),
    "bolted_flange": Part("configs/bolted_flange.yaml", {"pull": 1.0}, degree=1),
    "hub_on_shaft": Part("configs/hub_on_shaft.yaml"),
}


def scene_of(part: Part) -> dict[str, Any]:
    """The scene of a part, without load cases, its mesh by an absolute path."""
    path = ROOT / part.scene
    made: dict[str, Any] = read(path)[0]
    made.pop("cases", None)
    made.pop("output", None)
    for body in made["bodies"]:
        mesh_file = ROOT / part.mesh if part.mesh else path.parent / body["mesh"]["file"]
        body["mesh"]["file"] = str(mesh_file.resolve())
        if part.degree is not None:
            body["degree"] = part.degree
    active = [c for c in made["conditions"] if part.factors.get(c.get("name"), 1.0 - ("name" in c))]
    made["conditions"] = active
    return made


def plain(part: Part, made: dict[str, Any]) -> PlainScene:
    """The scene for CalculiX."""
    bodies = build_scene(from_mapping(made)).bodies
    numbers = {body.name: number for number, body in enumerate(bodies)}

    def side(name: str) -> tuple[int, str]:
        body, _, boundary = name.partition(".")
        return numbers[body], boundary

    (contact,) = made["contacts"]
    fixed = [
        Fixed(*side(c["on"]), axis, value, "")
        for c in made["conditions"]
        for axis, value in enumerate(c.get("displacement", ()))
        if value is not None
    ]
    loads = [c for c in made["conditions"] if "displacement" not in c]
    return PlainScene(
        [plain_body(body, body.degree) for body in bodies], 0.0,
        side(contact["on"]), side(contact["against"]), fixed, None, [{}],
        forces=[(*side(c["on"]), c["total_force"]) for c in loads],
        loose=loose(made), push=part.push, penalty=PENALTY,
    )  # fmt: skip


def loose(made: dict[str, Any]) -> list[int]:
    """Bodies with motions that are held on request."""
    return [number for number, body in enumerate(made["bodies"]) if body.get("hold")]


def differences(
    points: Fields, computed: Fields, other: Fields, loose: Sequence[int] = ()
) -> tuple[float, float, float]:
    """Relative differences of the largest displacement, of all, and of all without rigid motions.

    All without the rigid motions of the loose bodies.
    """
    for b in loose:
        computed, other = (
            [*of[:b], of[b] - _rigid_part(points[b], of[b]), *of[b + 1 :]]
            for of in (computed, other)
        )
    largest = [max(np.linalg.norm(u, axis=1).max() for u in of) for of in (computed, other)]
    difference = [u - v for u, v in zip(computed, other, strict=True)]
    strained = [u - _rigid_part(x, u) for x, u in zip(points, difference, strict=True)]
    size, every, rest = (
        np.linalg.norm(np.concatenate(of)) for of in (computed, difference, strained)
    )
    return abs(float(largest[1] / largest[0]) - 1.0), float(every / size), float(rest / size)


def _rigid_part(points: Array, u: Array) -> Array:
    """The rigid motion nearest to displacements, (nodes, 3)."""
    x = points - points.mean(axis=0)
    about = [np.cross(axis, x) for axis in np.eye(3)]
    motions = np.stack([*(np.broadcast_to(e, x.shape) for e in np.eye(3)), *about], axis=2)
    amounts = np.linalg.lstsq(motions.reshape(-1, 6), u.ravel(), rcond=None)[0]
    return np.asarray(motions @ amounts)


def _at_nodes(points: Fields, file: Path) -> Fields:
    """Our displacements at the nodes of each body."""
    fields, result = np.load(file), []
    ends = [*fields["first_node"], len(fields["points"])]
    for x, begin, end in zip(points, ends[:-1], ends[1:], strict=False):
        of_body = slice(int(begin), int(end))
        place = cKDTree(fields["points"][of_body]).query(x)[1]
        result.append(fields["displacement"][of_body][place])
    return result


def compared(name: str, directory: Path) -> dict[str, float]:
    """Differences, seconds and memory of both programs on a part."""
    made = scene_of(PARTS[name])
    deck = Deck(plain(PARTS[name], made))
    directory.mkdir(parents=True, exist_ok=True)
    scene = directory / "scene.yaml"
    scene.write_text(json.dumps(made), encoding="utf-8")
    (directory / "deck.inp").write_text("\n".join(deck.lines()) + "\n", encoding="utf-8")
    command = [sys.executable, "-m", "contact_app.studies.single_run", str(scene)]
    application = measured([*command, "--fields", "fields.npz"], directory)
    summary = json.loads((directory / "output.txt").read_text(encoding="utf-8").splitlines()[-1])
    calculix = measured([COMMAND, "deck"], directory)
    outcome = deck.outcome(directory / "deck.dat")
    points, other = outcome.points, outcome.displacement
    u = _at_nodes(points, directory / "fields.npz")
    largest, every, strained = differences(points, u, other, loose(made))
    contact = summary["contacts"][0]
    force = float(np.linalg.norm(contact["force"]))
    balanced = force < 1e-2 * contact["max_pressure"] * contact["area"]  # all around a shaft
    return {
        "dofs": 3.0 * sum(map(len, points)), "largest": largest, "every": every,
        "strained": strained,
        "force": np.nan if balanced else force, "force ccx": float(np.linalg.norm(outcome.force)),
        **application,
        **{f"{key} ccx": value for key, value in calculix.items()},
    }  # fmt: skip


def table(names: Sequence[str], directory: Path) -> Iterator[str]:
    """Rows of a table for a page."""
    yield (
        "| part | unknowns | largest displacement differs by | all displacements | without rigid "
        "motions | contact force | of CalculiX | processor seconds | "
        "of CalculiX | memory, GB | of CalculiX |"
    )
    yield "|" + "---|" * 11
    for name in names or PARTS:
        f = compared(name, directory / name)
        forces = [f"{v:.5g}" for v in (f["force"], f["force ccx"])]
        if np.isnan(f["force"]):
            forces = ["in balance", ""]
        yield (
            f"| {name} | {f['dofs']:,.0f} | {100 * f['largest']:.2f} % | "
            f"{100 * f['every']:.2f} % | {100 * f['strained']:.2f} % | "
            f"{' | '.join(forces)} | {f['cpu']:.1f} | {f['cpu ccx']:.1f} | "
            f"{f['gb']:.2f} | {f['gb ccx']:.2f} |"
        )


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(PARTS)}; all unless given")
    parser.add_argument("-o", "--output", type=Path, default=Path("results/calculix"))
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(PARTS))
    if unknown:
        parser.error(f"unknown part {unknown[0]}; known: {', '.join(PARTS)}")
    if shutil.which(COMMAND) is None:
        print(f"skipped: there is no {COMMAND} (Debian: calculix-ccx)")
        return
    for line in table(arguments.names, arguments.output.resolve()):
        print(line, flush=True)


if __name__ == "__main__":
    main()
