"""Half of a mesh from a file, and what must not be halved.

Wholes are held against the same scene without `symmetry`, on the same file.
"""

import copy
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from scipy.spatial import cKDTree

from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.model.symmetry import halved
from contact_app.run.solve import solve_scene
from contact_app.scene.scene import Scene
from tests import meshfiles, scenes
from tests.comparison import same_contacts

SAMPLES = Path(__file__).parents[3] / "meshes" / "samples"
HARD, SOFT = {"young": 4000.0, "poisson": 0.35}, {"young": 500.0, "poisson": 0.2}


def block(cell: str, file: Path, degree: int = 1) -> scenes.Config:
    """A block of two materials side by side along x, pressed under a ball; it mirrors across y."""
    down, up = scenes.down(cell), scenes.up(cell)
    return scenes.config(
        cell,
        [{"name": "block", "mesh": {"file": str(file)}, "degree": degree,
          "material": {"soft": SOFT, "hard": HARD},
          "boundaries": {"deep": {"where": "z < 0.3" if cell in scenes.CELLS_3D else "y < 0.3"}}}],
        [scenes.clamp(cell, f"block.{down}"), {"on": "block.x+", "pressure": 20},
         {"in": "block", "force": scenes.vector(cell, 3, 0, 5)}],
        [{"on": f"block.{up}", "obstacle":
            {"sphere": {"center": scenes.vector(cell, 0.4, 0.5, 1.98), "radius": 1.0}}}],
    )  # fmt: skip


def mirrored(cell: str, directory: Path, axes: str = "y", n: int = 4) -> Path:
    return meshfiles.write(meshfiles.mirrored(cell, n, axes), directory / "block.msh")


def cut(scene: Scene, axes: str) -> Scene:
    found = halved(scene)
    assert "".join("xyz"[m.axis] for m in found.scene.mirrors) == axes, found.notes
    return found.scene


def hold(known: SolvedScene, found: SolvedScene, tolerance: float = 1e-7) -> None:
    """Totals of the whole, and displacement and pressure at the nodes of what was solved."""
    assert found.summary["mesh"] == known.summary["mesh"]
    for key in ("energy", "max_displacement", "mean_displacement", "max_contact_pressure"):
        value = pytest.approx(known.summary["solution"][key], rel=tolerance)
        assert found.summary["solution"][key] == value, key
    for key in ("contact_force", "pair_forces"):
        a, b = (s.summary["solution"][key] for s in (known, found))
        a, b = (list(v.values()) if isinstance(v, dict) else v for v in (a, b))
        np.testing.assert_allclose(b, a, atol=10 * tolerance * np.abs(a).max(initial=0.0))
    same_contacts(found.summary, known.summary, 30 * tolerance)
    # nodes of several bodies may share a place
    points, place = known.nodes.points, cKDTree(known.nodes.points)
    distance, at = place.query(found.nodes.points)
    assert distance.max() < 1e-9 * np.ptp(points)
    once = np.bincount(cKDTree(points).query(points)[1], minlength=len(points))[at] == 1
    assert once.mean() > 0.9
    for name in ("displacement", "contact_pressure", "gap"):
        a, b = getattr(known.nodes, name)[at][once], getattr(found.nodes, name)[once]
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b), err_msg=name)
        a, b = np.nan_to_num(a), np.nan_to_num(b)
        of = "displacement" if name == "gap" else name
        scale = np.abs(getattr(known.nodes, of)).max()
        np.testing.assert_allclose(b, a, rtol=0, atol=30 * tolerance * scale, err_msg=name)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
@pytest.mark.parametrize(("held", "split"), [("z-", 1), ("deep", 4)])
def test_two_materials(cell: str, degree: int, held: str, split: int, tmp_path: Path) -> None:
    """Materials mirror; an expression that holds nodes of the sides holds none inside the cut."""
    made = block(cell, mirrored(cell, tmp_path), degree)
    made["conditions"][0]["on"] = f"block.{held}"
    scene = scenes.build(made, split)
    half = cut(scene, "y")
    assert 2 * half.bodies[0].mesh.total_cells == scene.bodies[0].mesh.total_cells
    hold(solve_scene(scene), solve_scene(half))


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("parts", [None, 5])
def test_roller_on_a_block(degree: int, parts: int | None, tmp_path: Path) -> None:
    """Two round and flat bodies, both cut."""
    sample = meshio.read(SAMPLES / "roller_on_block.msh")
    file = meshfiles.write(meshfiles.with_image(sample, 0, 0.0), tmp_path / "roller.msh")
    bodies = [
        {"name": name, "mesh": {"file": str(file), "group": name}, "degree": degree,
         "material": {"young": young, "poisson": 0.3},
         "boundaries": {"middle": {"where": "abs(x) < 1e-9"}}}
        for name, young in (("roller", 2.1e5), ("block", 7.0e4))
    ]  # fmt: skip
    made = scenes.config(
        "triangle",
        bodies,
        [{"on": "block.foot", "displacement": [None, 0]}, {"on": "roller.top", "pressure": 350},
         *({"on": f"{b}.middle", "displacement": [0, None]} for b in ("roller", "block"))],
        [{"on": "roller.face", "against": "block.face"}],
    )  # fmt: skip
    scene = scenes.build(made, parts)
    hold(solve_scene(scene), solve_scene(cut(scene, "x")), 1e-6)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_facets_that_face_the_plane(cell: str, degree: int, tmp_path: Path) -> None:
    """A lid over a hollow: along their normals facets beside the plane meet some beyond it."""
    mesh = meshfiles.mirrored(cell, 4, "x")
    up = scenes.dimension(cell) - 1
    mesh.points[:, up] *= 1.0 + 0.4 * np.abs(mesh.points[:, 0] - 0.5)
    block = {"name": "block", "degree": degree, "material": SOFT,
             "mesh": {"file": str(meshfiles.write(mesh, tmp_path / "block.msh"))}}  # fmt: skip
    lid = {**scenes.block(cell, 4, "lid", lower=(0, 0, 1.3), upper=(1, 1, 1.6)), "degree": degree}
    if cell == "triangle":  # the half of a box of triangles is another mesh
        flat = meshfiles.mirrored(cell, 4, "x")
        flat.points[:, 1] = 1.3 + 0.3 * flat.points[:, 1]
        lid["mesh"] = {"file": str(meshfiles.write(flat, tmp_path / "lid.msh"))}
    made = scenes.config(
        cell,
        [block, lid],
        [{"on": f"block.{'yz'[up - 1]}-", "displacement": [0] * (up + 1)},
         {"on": f"lid.{scenes.up(cell)}", "displacement": [0] * up + [-0.35]}],
        [{"on": f"block.{'yz'[up - 1]}+", "against": f"lid.{scenes.down(cell)}"}],
    )  # fmt: skip
    scene = scenes.build(made)
    known, found = solve_scene(scene), solve_scene(cut(scene, "xy" if up == 2 else "x"))
    assert known.summary["solution"]["active_contacts"]
    hold(known, found, 1e-6)


def test_forces_of_contacts_that_are_images(tmp_path: Path) -> None:
    """Two feet of a table on two pads: either contact has its own force, the other's mirrored."""
    pads = scenes.block("hexahedron", 4, "ground", upper=(1, 1, 0.5), boundaries={
        "left": "z > 0.5 - 1e-9 and x < 0.3", "right": "z > 0.5 - 1e-9 and x > 0.7",
    })  # fmt: skip
    table = scenes.block("hexahedron", 4, "table", lower=(0, 0, 0.501), boundaries={
        "left": "z < 0.502 and x < 0.3", "right": "z < 0.502 and x > 0.7",
        "line": "abs(x - 0.5) < 1e-9 and abs(y - 0.5) < 1e-9",
        "ends": "abs(x - 0.5) < 1e-9 and abs(y - 0.5) > 0.5 - 1e-9",
    })  # fmt: skip
    made = scenes.config(
        "hexahedron",
        [pads, table],
        [scenes.clamp("hexahedron", "ground.z-"), {"on": "table.z+", "pressure": 20},
         {"on": "table.x-", "pressure": 30}, {"on": "table.x+", "pressure": 30},
         {"on": "table.ends", "displacement": [0, None, None]},
         {"on": "table.line", "displacement": [None, 0, None]}],
        [{"on": f"table.{side}", "against": f"ground.{side}"} for side in ("right", "left")],
    )  # fmt: skip
    scene = scenes.build(made, 1)
    known, found = solve_scene(scene), solve_scene(cut(scene, "xy"))
    hold(known, found, 1e-6)
    assert list(found.summary["solution"]["pair_forces"]) == ["contacts[0]", "contacts[1]"]


def test_ring_with_curved_edges(tmp_path: Path) -> None:
    """An eighth of a ring and its image, round, of degree 2: rows, loads and areas on curves."""
    eighth = meshfiles.second_order(
        meshfiles.block("hexahedron", 2), "hexahedron", "hexahedron27", meshfiles.bend
    )
    quarter = meshfiles.with_image(eighth, 1, 0.0)
    file = meshfiles.write(quarter, tmp_path / "ring.msh")
    clamp = scenes.clamp("hexahedron", "ring.y+")
    made = scenes.config(
        "hexahedron",
        [{"name": "ring", "mesh": {"file": str(file)}, "degree": 2, "material": HARD}],
        [clamp, {"on": "ring.x-", "pressure": 50}],
        [{"on": "ring.x+", "obstacle":
            {"cylinder": {"point": [0, 0, 0], "axis": [0, 0, 1], "radius": 2.001,
                          "hollow": True}}}],
    )  # fmt: skip
    scene = scenes.build(made)
    half = cut(scene, "yz")
    assert half.bodies[0].mesh.middles is not None
    hold(solve_scene(scene), solve_scene(half))


def moved(mesh: meshio.Mesh) -> None:
    corner = np.argmin(np.abs(mesh.points - [1, 1, 0]).sum(axis=1))
    mesh.points[corner, 1] += 1e-6


def test_mirror_symmetry_of_files(tmp_path: Path) -> None:
    """Asymmetric nodes, cells, materials, parts of the surface: none is halved."""
    triangles = meshfiles.mirrored("triangle", 4, "y")
    off = copy.deepcopy(triangles)
    moved(off)
    cases = [
        ("y", triangles, ""),
        ("y", off, "no node at the image"),
        ("x", triangles, "whose mirror image is none"),
        ("x", meshfiles.block("quadrilateral", 4, distort=0.0), "of another material"),
        ("y", meshfiles.block("quadrilateral", 4, distort=0.0), ""),
        ("y", meshfiles.block("quadrilateral", 5, distort=0.0), "that the plane cuts"),
    ]
    for axis, mesh, why in cases:
        cell = "triangle" if mesh.cells[0].type == "triangle" else "quadrilateral"
        made = block(cell, meshfiles.write(mesh, tmp_path / "block.msh"))
        made["conditions"] = [{"on": "block.x-", "displacement": [0, 0]},
                              {"on": "block.x+", "pressure": 20}]  # fmt: skip
        made["contacts"] = []
        found = halved(scenes.build(made))
        note = next(n for n in found.notes if f"across {axis}:" in n or f"about {axis} =" in n)
        assert (why in note) if why else ("the scene is symmetric" in note), note


@pytest.mark.parametrize(
    ("conditions", "planes"),
    [
        ([], "xy"),
        ([{"on": "block.x-", "pressure": 5}], "y"),
        ([{"on": "block.x-", "pressure": 5}, {"on": "block.x+", "pressure": 5}], "xy"),
        ([{"on": "block.x-", "pressure": 5}, {"on": "block.x+", "pressure": 4}], "y"),
        # twice on one side, once on the other
        ([{"on": "block.x-", "pressure": 5}] * 2 + [{"on": "block.x+", "pressure": 5}], "y"),
        # an expression picks the image of a group
        ([{"on": "block.x-", "pressure": 5}, {"on": "block.end", "pressure": 5}], "xy"),
        ([{"on": "block.end", "displacement": [0.01, None, None]}], "y"),
        ([{"on": "block.end", "displacement": [0.01, None, None]},
          {"on": "block.x-", "displacement": [-0.01, None, None]}], "xy"),
        ([{"on": "block.end", "displacement": [0.01, None, None]},
          {"on": "block.x-", "displacement": [0.01, None, None]}], "y"),
        ([{"on": "block.patch", "traction": [0, 0, 1]}], ""),
        ([{"on": "block.patch", "traction": [0, 0, 1]},
          {"on": "block.opposite", "traction": [0, 0, 1]}], "y"),
    ],
)  # fmt: skip
def test_conditions_on_one_side(
    conditions: list[dict[str, Any]], planes: str, tmp_path: Path
) -> None:
    """Loads and conditions count with their images, as often as they are given.

    Where a scene is cut it is solved, and the whole as well.
    """
    made = block("tetrahedron", mirrored("tetrahedron", tmp_path, "xy"))
    body = made["bodies"][0]
    body["material"] = {"soft": SOFT, "hard": SOFT}  # alike on both sides
    for name, where in {
        "end": "x > 1 - 1e-9",
        "patch": "z < 1e-9 and x <= 0.5 and y < 0.51",
        "opposite": "z < 1e-9 and x <= 0.5 and y > 0.49",
    }.items():
        body["boundaries"][name] = {"where": where}
    made["conditions"] = [
        scenes.clamp("tetrahedron", "block.z-"),
        {"in": "block", "force": [0, 0, 5]},
        *conditions,
    ]
    made["contacts"][0]["obstacle"]["sphere"]["center"][0] = 0.5
    scene = scenes.build(made)
    if any(c.get("on") == "block.end" and "displacement" in c for c in conditions):
        # what is held twice at the edges must agree
        made["conditions"][0]["on"] = "block.foot"
        body["boundaries"]["foot"] = {"where": "z < 1e-9 and x > 0.1 and x < 0.9"}
        scene = scenes.build(made)
    half = cut(scene, planes)
    if planes and conditions:
        hold(solve_scene(scene), solve_scene(half), 1e-6)


def test_an_obstacle_on_one_side(tmp_path: Path) -> None:
    made = block("tetrahedron", mirrored("tetrahedron", tmp_path))
    made["contacts"][0]["obstacle"]["sphere"]["center"][1] = 0.51
    found = halved(scenes.build(made))
    assert not found.scene.mirrors
    assert "contacts[0] has no mirror image" in found.notes[1]


def test_refined_to_an_accuracy(tmp_path: Path) -> None:
    """The half is refined; its cut stays one, and the answer that of a finer whole."""
    made = block("triangle", mirrored("triangle", tmp_path, "x"))
    made["bodies"][0]["material"] = HARD
    made["conditions"] = [scenes.clamp("triangle", "block.y-"), {"in": "block", "force": [0, 5]}]
    made["contacts"][0]["obstacle"]["sphere"]["center"][0] = 0.5
    made["accuracy"] = 0.1
    made["solver"]["tolerance"] = 1e-6
    scene = cut(scenes.build(made), "x")
    refined = solve_to_accuracy(scene, lambda level, start: solve_scene(level))
    assert not refined.missed
    assert len(refined.levels) > 1
    body = refined.solved.model.scene.bodies[0]
    on = np.unique(body.mesh.topology.facets[body.mesh.sides[body.cuts[0]]])
    assert (body.mesh.points[on, 0] == 0.5).all()
    assert len(on) > 5
    made["bodies"][0]["mesh"]["refine"] = 4
    del made["accuracy"]
    known = solve_scene(scenes.build(made)).summary["solution"]["energy"]
    found = refined.solved.summary["solution"]["energy"]
    assert found == pytest.approx(known, rel=0.02)  # of e ~ 0.1 the energy has e²


def test_expressions_between_nodes(tmp_path: Path) -> None:
    """If meshes will be refined, a boundary has to be symmetric on all meshes, not only on this
    one."""
    made = block("triangle", mirrored("triangle", tmp_path, "x"))
    made["bodies"][0]["material"] = HARD
    made["bodies"][0]["boundaries"]["top"] = {"where": "y > 1 - 1e-9 and x > 0.1 and x < 0.8"}
    made["contacts"] = []
    made["conditions"] = [scenes.clamp("triangle", "block.y-"),
                          {"on": "block.top", "pressure": 1}]  # fmt: skip
    assert halved(scenes.build(made)).scene.mirrors
    found = halved(scenes.build({**made, "accuracy": 0.1}))
    assert not found.scene.mirrors
    assert "conditions[1] has no mirror image" in found.notes[0]


def table(cell: str, degree: int, directory: Path | None) -> scenes.Config:
    """A slab on two feet, boxes or from files, with loads on both feet; it mirrors across x."""
    up = scenes.dimension(cell) - 1
    feet = [
        scenes.block(cell, 2, "left", lower=(0, 0, 0), upper=(0.4, 1, 1)),
        scenes.block(cell, 2, "right", lower=(1.6, 0, 0), upper=(2, 1, 1)),
    ]
    slab = scenes.block(cell, 4, "slab", lower=(0.1, 0, 1.002), upper=(1.9, 1, 1.4))
    if directory:
        foot = meshfiles.block(cell, 2)
        foot.points[:, 0] *= 0.4 + 0.1 * foot.points[:, up]  # a slanted side
        image = meshfiles.with_image(foot, 0, 1.0)
        for body, name, left in ((feet[0], "left", True), (feet[1], "right", False)):
            half = (image.points[:, 0] < 1.0) == left
            cells = image.cells[0].data
            both = meshfiles.named(cell, image.points, cells[half[cells].all(axis=1)])
            body["mesh"] = {"file": str(meshfiles.write(both, directory / f"{name}.msh"))}
    for body in feet:
        body["boundaries"] = {
            "top": {"where": f"{'xyz'[up]} > 1 - 1e-9"},
            "foot": {"where": f"{'xyz'[up]} < 1e-9"},
            "outside": {"where": f"(x < 1e-9 or x > 2 - 1e-9) and {'xyz'[up]} > 0.4"},
        }
    slab["boundaries"] = {"middle": {"where": "abs(x - 1) < 1e-9"}}
    if up == 2:
        slab["boundaries"]["middle"]["where"] += " and (y < 1e-9 or y > 1 - 1e-9)"
    down = [0.0] * up + [-3.0]
    made = scenes.config(
        cell,
        [feet[0], slab, feet[1]],
        [
            *(scenes.clamp(cell, f"{b}.foot") for b in ("left", "right")),
            *({"on": f"{b}.outside", "pressure": 7} for b in ("right", "left")),
            *({"in": b, "force": [f, *[0.0] * (up - 1), -1.0]}
              for b, f in (("left", 2.0), ("right", -2.0))),
            {"in": "slab", "force": down},
            {"on": "slab.middle", "displacement": [0, *[None] * up]},
            {"on": f"slab.{scenes.up(cell)}", "pressure": 5},
        ],
        [{"on": f"{b}.top", "against": f"slab.{scenes.down(cell)}"} for b in ("right", "left")],
    )  # fmt: skip
    if up == 2:
        where = {"where": "abs(y - 0.5) < 1e-9 and z > 1.39 and abs(x - 1) > 0.8"}
        slab["boundaries"]["line"] = where
        made["conditions"].append({"on": "slab.line", "displacement": [None, 0, None]})
    for body in feet:
        body["degree"] = degree
    return made


@pytest.mark.parametrize(
    ("cell", "degree", "parts"),
    [("quadrilateral", 1, 1), ("quadrilateral", 2, 7), ("hexahedron", 1, 7)],
)
@pytest.mark.parametrize("files", [False, True])
def test_bodies_that_are_images(
    cell: str, degree: int, parts: int, files: bool, tmp_path: Path
) -> None:
    """One of two feet is left out, and what acts on it; it is written, and so are its forces."""
    made = table(cell, degree, tmp_path if files else None)
    scene = scenes.build(made, parts)
    half = halved(scene)
    assert half.scene.mirrors[0].at == pytest.approx(1.0)
    assert [body.name for body in half.scene.bodies] == ["left", "slab"]
    assert "right is the mirror image of another body" in half.notes[1]
    hold(solve_scene(scene), solve_scene(half.scene), 1e-6)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda made: made["bodies"][2]["material"].update(young=999.0), "different materials"),
        (lambda made: made["bodies"][2].update(degree=2), "different degree"),
        (lambda made: made["bodies"][2]["mesh"]["box"].update(cells=[3, 2]), "different cells"),
        (lambda made: made["bodies"][2]["mesh"]["box"].update(upper=[2.1, 1]), "off the middle"),
        (lambda made: made["conditions"].pop(2), "conditions[2] has no mirror image"),
        (lambda made: made["conditions"].pop(4), "conditions[4] has no mirror image"),
        (lambda made: made["conditions"][4].update(force=[-2.0, -1.0]), "conditions[4]"),
        (lambda made: made["contacts"].pop(), "contacts[0] has no mirror image"),
    ],
)
def test_bodies_that_are_not_images(change: Any, why: str) -> None:
    made = table("quadrilateral", 1, None)
    change(made)
    found = halved(scenes.build(made))
    assert not found.scene.mirrors
    assert why in found.notes[0]


def test_a_box_and_a_mesh_file(tmp_path: Path) -> None:
    """Bodies of both kinds share a plane, or there is none."""
    made = block("triangle", mirrored("triangle", tmp_path, "x"))
    made["bodies"][0]["material"] = HARD
    made["contacts"] = [{"on": "block.y+", "against": "lid.y-"}]
    lid = scenes.block("quadrilateral", 6, "lid", lower=(0.1, 0, 1), upper=(0.9, 0, 1.3))
    made["bodies"].append(lid)
    made["conditions"] = [
        scenes.clamp("triangle", "block.y-"),
        {"on": "lid.y+", "pressure": 30},
        {"on": "lid.middle", "displacement": [0, None]},
    ]
    lid["boundaries"] = {"middle": {"where": "abs(x - 0.5) < 1e-9"}}
    scene = scenes.build(made)
    hold(solve_scene(scene), solve_scene(cut(scene, "x")), 1e-6)
    lid["mesh"]["box"]["upper"][0] = 0.95
    assert "lid is off the middle of all bodies" in halved(scenes.build(made)).notes[0]
