"""Wall shear stress on the wall as pictures, drawn off screen by VTK."""
import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk


def surface(mesh, values):
    faces = mesh.faces[mesh.patches["wall"]]
    poly = vtk.vtkPolyData()
    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(mesh.points * 1e3, deep=True))
    cells = vtk.vtkCellArray()
    for f in faces:
        ids = f[:3] if f[2] == f[3] else f
        cells.InsertNextCell(len(ids), [int(i) for i in ids])
    poly.SetPoints(points)
    poly.SetPolys(cells)
    array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    array.SetName("WSS")
    poly.GetCellData().SetScalars(array)
    return poly


def colours(top, title):
    table = vtk.vtkLookupTable()
    table.SetNumberOfTableValues(256)
    from matplotlib import colormaps
    for i in range(256):
        table.SetTableValue(i, *colormaps["turbo"](i / 255))
    low, high = top if isinstance(top, tuple) else (0, top)
    table.SetRange(low, high)
    table.Build()
    bar = vtk.vtkScalarBarActor()
    bar.SetLookupTable(table)
    bar.SetNumberOfLabels(5)
    bar.SetLabelFormat("%.3g")
    bar.SetTitle(title)
    bar.SetUnconstrainedFontSize(True)
    bar.SetWidth(0.08)
    bar.SetHeight(0.45)
    bar.SetPosition(0.9, 0.05)
    for text in (bar.GetLabelTextProperty(), bar.GetTitleTextProperty()):
        text.SetColor(0, 0, 0)
        text.ItalicOff()
        text.BoldOff()
        text.SetFontSize(13)
        text.ShadowOff()
    return table, bar


def direction(points):
    """The view along which the points spread least, and up where they spread most."""
    _, _, axes = np.linalg.svd(points - points.mean(0), full_matrices=False)
    axes = axes * np.sign(axes[np.arange(3), np.abs(axes).argmax(1)])[:, None]
    return axes[2], axes[0]


def wall(path, panels, top, width=560, height=460, unit="Pa", edges=False):
    """Panels (mesh, value a wall face, caption) side by side in the same colours, from 0 (or top[0]) to top, seen alike."""
    path.parent.mkdir(parents=True, exist_ok=True)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(4)
    window.SetSize(width * len(panels), height)
    look, up = direction(panels[0][0].points)
    for k, (mesh, values, caption) in enumerate(panels):
        table, bar = colours(top, unit)
        mapper = vtk.vtkPolyDataMapper()
        mapper.SetInputData(surface(mesh, values))
        mapper.SetLookupTable(table)
        mapper.UseLookupTableScalarRangeOn()
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        actor.GetProperty().SetAmbient(0.35)
        actor.GetProperty().SetDiffuse(0.65)
        if edges:
            actor.GetProperty().EdgeVisibilityOn()
            actor.GetProperty().SetEdgeColor(0.15, 0.15, 0.15)
            actor.GetProperty().SetLineWidth(0.5)
        text = vtk.vtkTextActor()
        text.SetInput(caption)
        text.SetPosition(10, height - 26)
        text.GetTextProperty().SetColor(0, 0, 0)
        text.GetTextProperty().SetFontSize(15)
        renderer = vtk.vtkRenderer()
        renderer.SetBackground(1, 1, 1)
        renderer.SetViewport(k / len(panels), 0, (k + 1) / len(panels), 1)
        for a in (actor, bar, text):
            renderer.AddViewProp(a)
        camera = renderer.GetActiveCamera()
        centre = panels[0][0].points.mean(0) * 1e3
        camera.SetFocalPoint(*centre)
        camera.SetPosition(*(centre + look * 100))
        camera.SetViewUp(*up)
        camera.ParallelProjectionOn()
        renderer.ResetCamera()
        camera.Zoom(1.0)
        window.AddRenderer(renderer)
    window.Render()
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    grab.Update()
    # A palette keeps the files small.
    small = vtk.vtkPNGWriter()
    small.SetFileName(str(path))
    small.SetCompressionLevel(9)
    small.SetInputConnection(grab.GetOutputPort())
    small.Write()
