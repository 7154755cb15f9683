"""The bodies of a scene fused into one: the linear problem with which several bodies are compared.

One mesh goes through all bodies (``meshes/samples/make_parts.py --fused``). Materials, supports
and loads are those of the scene; there is no contact. A part that is loaded only by its
interference gets its weight as a load instead, since without loads the solution would be zero.
"""

from pathlib import Path
from typing import Any

from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from contact_app.scene.scene import Scene
from contact_app.scene.yaml_reader import read

NAME = "fused"
LOADS = {"traction", "pressure", "force", "total_force", "total_moment"}


def mesh_of(mesh: Path) -> Path:
    """Path of the fused mesh of a part, given the mesh of its bodies."""
    return mesh.parent / NAME / mesh.name


def fused_scene(path: Path, mesh: Path, degree: int) -> Scene:
    """One body in place of the bodies of a scene file; with load cases its last one.

    Parameters
    ----------
    mesh
        Its groups of cells are named as the bodies, its groups of facets as their boundaries.
    """
    data = read(path)[0]
    bodies = {body["mesh"].get("group", body["name"]): body for body in data["bodies"]}
    conditions = [_moved(condition) for condition in data["conditions"]]
    if not any(LOADS & condition.keys() for condition in conditions):
        conditions.append({"in": NAME, "force": [1e-3, 1e-3, 1e-3]})
    made = {
        "dimension": data["dimension"],
        "bodies": [{
            "name": NAME, "degree": degree, "mesh": {"file": str(mesh.resolve())},
            "material": {group: body["material"] for group, body in bodies.items()},
        }],
        "conditions": conditions,
        "solver": {"method": "primal"},
        **{key: data[key] for key in ("cases",) if key in data},
    }  # fmt: skip
    scene = build_scene(from_mapping(made))
    return scene.under(scene.cases[-1]) if scene.cases else scene


def _moved(condition: dict[str, Any]) -> dict[str, Any]:
    """The condition on a boundary of one body, moved to that boundary of the fused body."""
    moved = dict(condition)
    if "on" in moved:
        moved["on"] = f"{NAME}.{moved['on'].partition('.')[2]}"
    if "in" in moved:
        moved["in"] = NAME
    return moved
