"""Images of a skin by VTK, drawn off-screen: ``python vtk_panels.py FOLDER``.

Runs in a process of its own, which must import nothing of dolfinx: see
`contact_app.results.plot.space_picture`, which writes ``skin.npz`` and ``view.json`` into the
folder and reads ``panel0.png`` and so on.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np


def draw(folder: Path) -> None:
    """Draw each panel that ``view.json`` asks for."""
    import pyvista

    view = json.loads((folder / "view.json").read_text(encoding="utf-8"))
    skin = np.load(folder / "skin.npz")
    points = skin["points"]
    faces = [skin[name] for name in sorted(skin.files) if name.startswith("faces")]
    cells = np.concatenate([np.insert(sides, 0, sides.shape[1], axis=1).ravel() for sides in faces])
    edges = skin["outline"].reshape(-1, 3)
    ends = np.arange(len(edges)).reshape(-1, 2)
    outline = pyvista.PolyData(edges, lines=np.insert(ends, 0, 2, axis=1).ravel())
    away = float(np.ptp(points, axis=0).max()) + float(np.ptp(edges, axis=0).max(initial=0.0))
    for number, panel in enumerate(view["panels"]):
        bodies = pyvista.PolyData(points, faces=cells)
        values = skin[f"values{number}"]
        data = bodies.point_data if len(values) == len(points) else bodies.cell_data
        data["colour"] = values
        plotter = pyvista.Plotter(off_screen=True, window_size=view["size"], lighting="none")
        plotter.add_light(pyvista.Light(position=view["light"], light_type="scene light"))
        plotter.set_background("white")
        if len(edges):
            plotter.add_mesh(outline, color="grey", line_width=3, lighting=False)
        looks: dict[str, Any] = {
            "ambient": view["ambient"], "diffuse": view["diffuse"], "specular": 0.0,
            "show_edges": view["edges"], "edge_opacity": 0.25,
        }  # fmt: skip
        parts = [(bodies, 1.0)]
        if panel["through"]:
            plotter.enable_depth_peeling(8)
            known = np.isfinite(values)
            if len(values) == len(points):
                known = np.concatenate([known[sides].all(axis=1) for sides in faces])
            parts = [
                (bodies.extract_cells(np.flatnonzero(known)), 1.0),
                (bodies.extract_cells(np.flatnonzero(~known)), view["veil"]),
            ]
        for part, opacity in parts:
            if part.n_cells:
                plotter.add_mesh(
                    part, scalars="colour", clim=panel["limits"], cmap=panel["colours"],
                    nan_color=view["bare"], opacity=opacity, show_scalar_bar=False, **looks,
                )  # fmt: skip
        plotter.enable_parallel_projection()
        centre = np.array(view["centre"])
        camera = plotter.camera
        camera.focal_point = centre
        camera.position = centre + 2.0 * away * np.array(view["direction"])
        camera.up = view["up"]
        camera.parallel_scale = view["half_height"]
        plotter.renderer.reset_camera_clipping_range()
        plotter.enable_anti_aliasing("ssaa")
        plotter.screenshot(folder / f"panel{number}.png")
        plotter.close()


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
