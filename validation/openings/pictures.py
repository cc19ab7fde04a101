"""A contact sheet of results: wall, edges, caps by role, centerlines.

    pictures.py OUT.png RESULT_DIR...
"""
import json, math, os, sys
import vtk

WALL, INLET, OUTLET, LINE = (0.85, 0.80, 0.72), (0.80, 0.15, 0.15), (0.15, 0.35, 0.80), (0.05, 0.05, 0.05)


def reader(path):
    r = vtk.vtkXMLPolyDataReader()
    r.SetFileName(path)
    r.Update()
    return r.GetOutput()


def actor(data, color, edges=False, width=1.0, opacity=1.0):
    m = vtk.vtkPolyDataMapper()
    m.SetInputData(data)
    m.ScalarVisibilityOff()
    a = vtk.vtkActor()
    a.SetMapper(m)
    p = a.GetProperty()
    p.SetColor(*color)
    p.SetOpacity(opacity)
    p.SetLineWidth(width)
    if edges:
        p.EdgeVisibilityOn()
        p.SetEdgeColor(0.45, 0.42, 0.38)
        p.SetLineWidth(0.3)
    return a


def patch(surface, wanted):
    t = vtk.vtkThreshold()
    t.SetInputData(surface)
    t.SetInputArrayToProcess(0, 0, 0, vtk.vtkDataObject.FIELD_ASSOCIATION_CELLS, "PatchId")
    t.SetLowerThreshold(wanted[0])
    t.SetUpperThreshold(wanted[1])
    g = vtk.vtkGeometryFilter()
    g.SetInputConnection(t.GetOutputPort())
    g.Update()
    return g.GetOutput()


def main():
    target, dirs = sys.argv[1], sys.argv[2:]
    columns = math.ceil(math.sqrt(len(dirs)))
    rows = math.ceil(len(dirs) / columns)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(8)
    window.SetSize(360 * columns, 330 * rows)
    for i, d in enumerate(dirs):
        c, r = i % columns, rows - 1 - i // columns
        ren = vtk.vtkRenderer()
        ren.SetViewport(c / columns, r / rows, (c + 1) / columns, (r + 1) / rows)
        ren.SetBackground(1, 1, 1)
        surface = reader(f"{d}/surface/lumen.vtp")
        report = json.load(open(f"{d}/report.json"))
        ren.AddActor(actor(patch(surface, (1, 1)), WALL, edges=surface.GetNumberOfCells() < 30000, opacity=0.45))
        for o in report["openings"]:
            ren.AddActor(actor(patch(surface, (o["id"], o["id"])), INLET if o["kind"] == "inlet" else OUTLET))
        lines = f"{d}/surface/centerlines.vtp"
        if os.path.exists(lines):
            ren.AddActor(actor(reader(lines), LINE, width=2))
        title = vtk.vtkTextActor()
        title.SetInput(f"{os.path.basename(os.path.normpath(d))}: {len(report['openings'])} openings")
        title.GetTextProperty().SetColor(0, 0, 0)
        title.GetTextProperty().SetFontSize(14)
        title.SetPosition(8, 8)
        ren.AddViewProp(title)
        window.AddRenderer(ren)
        ren.ResetCamera()
        # Look across the two longest axes of the box.
        b = surface.GetBounds()
        size = [b[1] - b[0], b[3] - b[2], b[5] - b[4]]
        thin = size.index(min(size))
        camera = ren.GetActiveCamera()
        f = camera.GetFocalPoint()
        away = [0.25 * max(size)] * 3
        away[thin] = 2 * max(size)
        camera.SetPosition(*[f[k] + away[k] for k in range(3)])
        camera.SetViewUp(*[1.0 if k == (thin + 2) % 3 else 0.0 for k in range(3)])
        camera.ParallelProjectionOn()
        ren.ResetCamera()
        camera.Zoom(1.25)
    window.Render()
    image = vtk.vtkWindowToImageFilter()
    image.SetInput(window)
    image.ReadFrontBufferOff()
    w = vtk.vtkPNGWriter()
    w.SetFileName(target)
    w.SetInputConnection(image.GetOutputPort())
    w.Write()


main()
