"""Opens a result of lumenmesh in ParaView: the surface coloured by equi-angle skewness, the volume mesh in a cut.

    pvpython scripts/paraview/skewness.py RESULT [PICTURE.png]      writes a picture (default RESULT/skewness.png)
    paraview --script=scripts/paraview/skewness.py                  or as a macro; the folder is LUMENMESH_RESULT or the
                                                                    working folder
"""
import os
import sys

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
    shown.SetScalarBarVisibility(view, True)
    return shown


def main(folder, picture):
    view = pv.GetActiveViewOrCreate("RenderView")
    view.ViewSize = [1400, 900]
    surface = pv.XMLPolyDataReader(registrationName="surface", FileName=[os.path.join(folder, "surface", "lumen.vtp")])
    shown = coloured(view, surface, "EquiAngleSkewness", 0.75, "Equi-angle skewness")
    shown.Representation = "Surface With Edges"
    volume = os.path.join(folder, "volume", "lumen.vtu")
    if os.path.exists(volume):
        mesh = pv.XMLUnstructuredGridReader(registrationName="volume", FileName=[volume])
        cut = pv.Clip(registrationName="cut", Input=mesh)
        cut.ClipType = "Plane"
        mesh.UpdatePipeline()
        x0, x1, y0, y1, z0, z1 = mesh.GetDataInformation().GetBounds()
        cut.ClipType.Origin = [(x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2]
        cut.ClipType.Normal = [0, 1, 0]
        cut.Crinkleclip = 1
        inside = coloured(view, cut, "EquiVolumeSkewness", 0.95, "Equi-volume skewness")
        inside.Representation = "Surface With Edges"
        # Beside the surface, so that both are seen.
        inside.Position = [1.2 * (x1 - x0), 0.0, 0.0]
    lines = os.path.join(folder, "surface", "centerlines.vtp")
    if os.path.exists(lines):
        axis = pv.XMLPolyDataReader(registrationName="centerlines", FileName=[lines])
        pv.Show(axis, view).Visibility = 0
    view.CameraPosition, view.CameraViewUp = [0.0, -1.0, 0.2], [0.0, 0.0, 1.0]
    view.CameraFocalPoint = [0.0, 0.0, 0.0]
    pv.ResetCamera(view)
    pv.Render(view)
    if picture:
        pv.SaveScreenshot(picture, view)
        print(picture)


if BATCH and len(sys.argv) > 1:
    main(sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else os.path.join(sys.argv[1], "skewness.png"))
else:
    main(os.environ.get("LUMENMESH_RESULT", os.getcwd()), None)
