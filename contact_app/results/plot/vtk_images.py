"""Images of triangles in space by VTK, where Python has it, in a process of its own.

VTK shades curved surfaces smoothly. Without a display some of its builds end the process that
draws, Debian's with an abort that no exception announces. So this file runs as a script: the parent
writes arrays, the child draws without a window, and the parent reads the images or says why there
are none. Points are in pixels, so that the images lie on those of `raster`.
"""

import importlib.util
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

EDGE = 0.2
"""Opacity of the edges of faces."""


def images(
    drawings: list[dict[str, Any]], seconds: float = 20.0
) -> tuple[list[NDArray[np.float64]] | None, str]:
    """Images (height, width, 3), or None and the reason; no reason if Python has no VTK.

    Parameters
    ----------
    drawings
        Of each image, in pixels to the right, downwards and towards the eye: ``corners`` and
        ``values`` (n, 3, 3) and (n, 3) of triangles (NaN: bare), the numbers ``nodes`` (n, 3) of
        the corners, ``edges`` (k, 2, 3), ``outline`` (l, 2, 3) of the undeformed bodies and
        ``size`` (2,). Colours: ``colours`` (m, 3) from ``limits[0]`` to ``limits[1]``, ``bare`` and
        ``grey`` (3,), ``veil``, the opacity of bare faces (below 1 others are not shaded). Light:
        ``light``, its direction to the right, upwards and towards the eye, ``bright`` (2,), ambient
        and diffuse, and ``crease``, the angle in degrees of sharp edges.
    seconds
        Limit on the time of the child, which takes three of one core for two images of the hub on a
        shaft, 40,000 triangles each.
    """
    if importlib.util.find_spec("vtkmodules") is None:
        return None, ""
    try:
        with TemporaryDirectory() as scratch:
            for i, drawing in enumerate(drawings):
                np.savez(Path(scratch, f"{i}.npz"), **drawing)
            command = [sys.executable, "-P", __file__, scratch, str(len(drawings))]
            child = subprocess.run(command, capture_output=True, text=True, timeout=seconds)
            if child.returncode == 0:
                drawn = [np.load(Path(scratch, f"{i}.npy")) for i in range(len(drawings))]
                return [image / 255.0 for image in drawn], ""
    except subprocess.TimeoutExpired:
        return None, f"it took more than {seconds:g} s"
    except (OSError, ValueError) as error:
        return None, str(error)
    last = (child.stderr.strip().splitlines() or ["no message"])[-1].rpartition("| ")[2]
    return None, f"its process ended with {child.returncode} ({last[-200:]})"


def _draw(d: Any) -> NDArray[np.uint8]:
    """Image (height, width, 3) of a drawing, by VTK."""
    import vtkmodules.vtkRenderingOpenGL2  # noqa: F401
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkLookupTable, vtkUnsignedCharArray
    from vtkmodules.vtkRenderingCore import vtkCamera, vtkLight, vtkRenderer, vtkRenderWindow

    wide, high = map(int, d["size"])
    corners, normals = d["corners"], _normals(d["corners"], d["nodes"], float(d["crease"]))
    bare, veil = np.isnan(d["values"]).any(axis=1), float(d["veil"])
    coloured = _actor(corners[~bare], normals[~bare], d["values"][~bare])
    plain = _actor(corners[bare], normals[bare])
    edges, outline = _actor(d["edges"]), _actor(d["outline"])
    table = vtkLookupTable()
    table.SetNumberOfTableValues(len(d["colours"]))
    for i, colour in enumerate(d["colours"]):
        table.SetTableValue(i, *colour, 1.0)
    coloured.GetMapper().SetLookupTable(table)
    coloured.GetMapper().SetScalarRange(*d["limits"])
    coloured.GetMapper().InterpolateScalarsBeforeMappingOn()
    coloured.GetProperty().SetLighting(veil == 1.0)
    plain.GetProperty().SetBackfaceCulling(veil < 1.0)
    looks = (plain, d["bare"], veil), (edges, (0.0, 0.0, 0.0), EDGE), (outline, d["grey"], 1.0)
    for actor, colour, opacity in looks:
        actor.GetProperty().SetColor(*colour)
        actor.GetProperty().SetOpacity(opacity)
    for lines in (edges, outline):
        lines.GetProperty().SetLineWidth(2.0)
        lines.AddPosition(0.0, 0.0, 1e-3 * max(wide, high))  # in front of the faces they lie on
    renderer, light, camera = vtkRenderer(), vtkLight(), vtkCamera()
    renderer.SetBackground(1.0, 1.0, 1.0)
    for actor in (coloured, plain, edges, outline):
        actor.GetProperty().SetAmbient(float(d["bright"][0]))
        actor.GetProperty().SetDiffuse(float(d["bright"][1]))
        renderer.AddActor(actor)
    light.SetPosition(*d["light"])
    renderer.AddLight(light)
    nearest = max(float(d[name][..., 2].max(initial=0.0)) for name in ("corners", "outline"))
    camera.ParallelProjectionOn()
    camera.SetParallelScale(0.5 * high)
    camera.SetFocalPoint(0.5 * wide, -0.5 * high, nearest)
    camera.SetPosition(0.5 * wide, -0.5 * high, nearest + wide)
    renderer.SetActiveCamera(camera)
    renderer.ResetCameraClippingRange()
    renderer.SetUseDepthPeeling(True)
    renderer.SetMaximumNumberOfPeels(50)
    window, pixels = vtkRenderWindow(), vtkUnsignedCharArray()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)  # depth peeling excludes it
    window.SetAlphaBitPlanes(1)
    window.SetSize(wide, high)
    window.AddRenderer(renderer)
    window.Render()
    window.GetPixelData(0, 0, wide - 1, high - 1, 0, pixels, 0)
    return np.asarray(vtk_to_numpy(pixels).reshape(high, wide, 3)[::-1])


def _normals(
    corners: NDArray[np.float64], nodes: NDArray[np.int64], crease: float
) -> NDArray[np.float64]:
    """Unit normals (n, 3, 3) at the corners of triangles, with jumps at sharp edges alone."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkPolyDataNormals

    points = np.zeros((nodes.max(initial=-1) + 1, 3))
    points[nodes] = corners
    split = vtkPolyDataNormals()
    split.SetInputData(_cells(points, nodes))
    split.SetFeatureAngle(crease)
    split.ConsistencyOff()
    split.Update()
    result = split.GetOutput()
    order = vtk_to_numpy(result.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return np.asarray(vtk_to_numpy(result.GetPointData().GetNormals())[order])


def _actor(
    corners: NDArray[np.float64],
    normals: NDArray[np.float64] | None = None,
    values: NDArray[np.float64] | None = None,
) -> Any:
    """Actor of triangles (n, 3, 3) or lines (n, 2, 3), with normals and values at corners."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

    n, k, _ = corners.shape
    data = _cells(corners.reshape(-1, 3), np.arange(n * k).reshape(n, k))
    if normals is not None:
        data.GetPointData().SetNormals(numpy_to_vtk(normals.reshape(-1, 3), deep=True))
    if values is not None:
        data.GetPointData().SetScalars(numpy_to_vtk(values.ravel(), deep=True))
    mapper, actor = vtkPolyDataMapper(), vtkActor()
    mapper.SetInputData(data)
    mapper.SetScalarVisibility(values is not None)
    actor.SetMapper(mapper)
    return actor


def _cells(points: NDArray[np.float64], nodes: NDArray[np.int64]) -> Any:
    """VTK's triangles (n, 3) or lines (n, 2) on points in pixels; upwards is y."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    places, cells, data = vtkPoints(), vtkCellArray(), vtkPolyData()
    places.SetData(numpy_to_vtk(points * (1.0, -1.0, 1.0), deep=True))
    ends = nodes.shape[1] * np.arange(len(nodes) + 1)
    cells.SetData(*(numpy_to_vtkIdTypeArray(a, deep=True) for a in (ends, nodes.ravel())))
    data.SetPoints(places)
    (data.SetPolys if nodes.shape[1] == 3 else data.SetLines)(cells)
    return data


if __name__ == "__main__":
    for number in range(int(sys.argv[2])):
        with np.load(Path(sys.argv[1], f"{number}.npz")) as arrays:
            np.save(Path(sys.argv[1], f"{number}.npy"), _draw(arrays))
