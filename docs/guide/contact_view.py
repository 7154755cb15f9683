"""The usual view of a result in ParaView: deformed bodies coloured by von Mises stress.

In ParaView: Tools, Python Shell, Run Script, with the result open in the pipeline browser. Without
a window:

    pvbatch docs/guide/contact_view.py results/cube/solution.xdmf [cube.png] [FIELD] [FACTOR]

writes a picture of one field (von_mises unless given; contact_pressure, gap, displacement, stress;
with friction contact_status, in three colours: open, stick, slip), displacements enlarged by
FACTOR, by default until the largest is a twelfth of the bodies' size. Written for ParaView 5.9 and
later.
"""

import math
import os
import sys

from paraview.simple import (
    ColorBy,
    GetActiveSource,
    GetActiveViewOrCreate,
    GetColorTransferFunction,
    GetScalarBar,
    Hide,
    ResetCamera,
    SaveScreenshot,
    Show,
    WarpByVector,
    Xdmf3ReaderS,
)

STATUSES = (  # value, name, colour
    ("0", "open", (0.733, 0.733, 0.733)),
    ("1", "stick", (0.0, 0.447, 0.698)),
    ("2", "slip", (0.902, 0.624, 0.0)),
)


def arrays(source):
    """Where each field of a source stands: {name: "POINTS" or "CELLS"}."""
    places = (("POINTS", source.PointData), ("CELLS", source.CellData))
    return {data.GetArray(i).Name: place for place, data in places for i in range(len(data))}


def largest(source, name):
    """Largest magnitude of a field at the nodes."""
    low, high = source.PointData[name].GetRange(-1)
    return max(abs(low), abs(high))


def show(source, field="von_mises", factor=None):
    """Show a result deformed and coloured by a field, in the active view; return the view."""
    source.UpdatePipeline()
    found = arrays(source)
    if field not in found:
        raise SystemExit(f"the result has no field {field}, only {', '.join(sorted(found))}")
    bounds = source.GetDataInformation().GetBounds()
    size = math.dist(bounds[::2], bounds[1::2])
    if factor is None:
        moved = largest(source, "displacement")
        factor = size / 12.0 / moved if moved > 0.0 else 1.0
    view = GetActiveViewOrCreate("RenderView")
    Hide(source, view)
    warped = WarpByVector(Input=source, Vectors=["POINTS", "displacement"], ScaleFactor=factor)
    warped.UpdatePipeline()
    display = Show(warped, view)
    display.Representation = "Surface With Edges" if _cells(source) < 60000 else "Surface"
    display.Ambient, display.Diffuse, display.Specular = 0.55, 0.5, 0.0  # colours are to be read
    display.EdgeColor = [0.5, 0.5, 0.5]
    ColorBy(display, (found[field], field))
    display.RescaleTransferFunctionToDataRange(False, True)
    colours = GetColorTransferFunction(field)
    if field == "contact_status":
        display.InterpolateScalarsBeforeMapping = 0  # between nodes colours are mixed, not numbers
        name_statuses(colours)
    else:
        colours.ApplyPreset("Viridis (matplotlib)", True)
    colours.NanColor = [0.8, 0.8, 0.8]
    display.SetScalarBarVisibility(view, True)
    bar = GetScalarBar(colours, view)
    bar.TitleColor = bar.LabelColor = [0.0, 0.0, 0.0]
    bar.TitleFontSize = bar.LabelFontSize = 14
    bar.Orientation = "Horizontal"
    bar.WindowLocation = "Lower Center"
    outline = Show(source, view)
    outline.Representation = "Outline"
    outline.AmbientColor = outline.DiffuseColor = [0.4, 0.4, 0.4]
    view.UseColorPaletteForBackground = 0
    view.Background = [1.0, 1.0, 1.0]
    view.OrientationAxesLabelColor = [0.0, 0.0, 0.0]
    view.CameraParallelProjection = 1
    if bounds[4] == bounds[5]:  # of the plane
        view.InteractionMode = "2D"
        direction, up = [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]
    else:
        direction, up = [1.2, -1.0, 0.6], [0.0, 0.0, 1.0]
    middle = [0.5 * (a + b) for a, b in zip(bounds[::2], bounds[1::2], strict=True)]
    view.CameraFocalPoint = middle
    view.CameraPosition = [m + size * d for m, d in zip(middle, direction, strict=True)]
    view.CameraViewUp = up
    ResetCamera(view)
    view.CameraParallelScale *= 1.2  # room for the colours below the bodies
    return view


def name_statuses(colours):
    """Colours and names of the values of contact_status, as in the pictures of `plot`."""
    colours.InterpretValuesAsCategories = 1
    colours.AnnotationsInitialized = 1
    colours.Annotations = [text for row in STATUSES for text in row[:2]]
    colours.IndexedColors = [share for row in STATUSES for share in row[2]]


def _cells(source):
    return source.GetDataInformation().GetNumberOfCells()


def main(arguments):
    """Write a picture of the file named first, or show what is open."""
    if not arguments:
        source = GetActiveSource()
        if source is None:
            raise SystemExit("open a solution.xdmf, or name one: pvbatch contact_view.py FILE")
        show(source)
        return
    path = os.path.abspath(arguments[0])
    if not os.path.isfile(path):
        raise SystemExit(f"{path} is not there")
    picture = arguments[1] if len(arguments) > 1 else os.path.splitext(path)[0] + ".png"
    field = arguments[2] if len(arguments) > 2 else "von_mises"
    factor = float(arguments[3]) if len(arguments) > 3 else None
    GetActiveViewOrCreate("RenderView").ViewSize = [1400, 1000]
    view = show(Xdmf3ReaderS(FileName=[path]), field, factor)
    SaveScreenshot(picture, view, ImageResolution=[1400, 1000])
    print(f"wrote {picture}")


if __name__ == "__main__":
    main(sys.argv[1:])
