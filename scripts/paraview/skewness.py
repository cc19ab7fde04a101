"""Opens a result of lumenmesh in ParaView: the surface coloured by equi-angle skewness, the volume mesh in a cut.

    pvpython scripts/paraview/skewness.py RESULT [PICTURE.png]      writes a picture (default RESULT/skewness.png)
    paraview --script=scripts/paraview/skewness.py                  or as a macro; the folder is LUMENMESH_RESULT or the
                                                                    working folder
"""
import os
import sys

from paraview import servermanager
from paraview import simple as pv

BATCH = os.path.basename(sys.executable or "").startswith("pvpython") or len(sys.argv) > 1


def coloured(view, source, array, limit, label):
    """Shows `source` with cell array `array` from 0 to `limit` in viridis."""
    shown = pv.Show(source, view)
    pv.ColorBy(shown, ("CELLS", array))
    lut = pv.GetColorTransferFunction(array)
    lut.ApplyPreset("Viridis (matplotlib)", True)
    lut.RescaleTransferFunction(0.0, limit)
    bar = pv.GetScalarBar(lut, view)
    bar.Title, bar.ComponentTitle = label, ""
    bar.TitleColor = bar.LabelColor = [0.1, 0.1, 0.1]
    shown.SetScalarBarVisibility(view, True)
    return shown


def main(folder, picture):
    view = pv.GetActiveViewOrCreate("RenderView")
    view.ViewSize = [1600, 900]
    view.UseColorPaletteForBackground = 0
    view.Background = [1.0, 1.0, 1.0]
    surface = pv.XMLPolyDataReader(registrationName="surface", FileName=[os.path.join(folder, "surface", "lumen.vtp")])
    surface.UpdatePipeline()
    bounds = surface.GetDataInformation().GetBounds()
    size = [bounds[2 * a + 1] - bounds[2 * a] for a in range(3)]
    # Looked at, and cut, across the direction in which the vessel is flattest.
    flat = size.index(min(size))
    shown = coloured(view, surface, "EquiAngleSkewness", 0.75, "Equi-angle skewness")
    shown.Representation = "Surface"
    volume = os.path.join(folder, "volume", "lumen.vtu")
    if os.path.exists(volume):
        mesh = pv.XMLUnstructuredGridReader(registrationName="volume", FileName=[volume])
        points = servermanager.Fetch(surface).GetPoints()
        middle = [sum(points.GetPoint(i)[a] for i in range(points.GetNumberOfPoints())) / points.GetNumberOfPoints() for a in range(3)]
        cut = pv.Clip(registrationName="cut", Input=mesh)
        cut.ClipType = "Plane"
        cut.ClipType.Origin = middle
        cut.ClipType.Normal = [float(a == flat) for a in range(3)]
        # The side that looks away from the camera stays.
        cut.Invert = 0
        cut.Crinkleclip = 1
        inside = coloured(view, cut, "EquiVolumeSkewness", 0.95, "Equi-volume skewness")
        inside.Representation = "Surface With Edges"
        inside.EdgeColor = [0.2, 0.2, 0.2]
        # Beside the surface, so that both are seen.
        beside = (flat + 1) % 3 if flat != 1 else 0
        inside.Position = [1.15 * size[a] if a == beside else 0.0 for a in range(3)]
    lines = os.path.join(folder, "surface", "centerlines.vtp")
    if os.path.exists(lines):
        axis = pv.XMLPolyDataReader(registrationName="centerlines", FileName=[lines])
        pv.Show(axis, view).Visibility = 0
    view.CameraPosition = [-float(a == flat) for a in range(3)]
    view.CameraFocalPoint = [0.0, 0.0, 0.0]
    view.CameraViewUp = [0.0, 1.0, 0.0] if flat == 2 else [0.0, 0.0, 1.0]
    pv.ResetCamera(view)
    pv.GetActiveCamera().Zoom(1.3)
    pv.Render(view)
    if picture:
        pv.SaveScreenshot(picture, view)
        print(picture)


if BATCH and len(sys.argv) > 1:
    main(sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else os.path.join(sys.argv[1], "skewness.png"))
else:
    main(os.environ.get("LUMENMESH_RESULT", os.getcwd()), None)
