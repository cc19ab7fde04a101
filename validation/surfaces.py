"""What the measurements of surfaces share: masks and meshes in VTK, peers' surfaces in place, pictures side by side."""
import numpy as np
import SimpleITK as sitk
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

DIVERGING = ((0.23, 0.30, 0.75), (0.87, 0.87, 0.87), (0.71, 0.02, 0.15))
RISING = ((0.27, 0.0, 0.33), (0.19, 0.41, 0.56), (0.21, 0.72, 0.47), (0.99, 0.91, 0.14))


def labels(image):
    """A SimpleITK mask as vtkImageData, one voxel of background round it, in the image's own axes."""
    array = np.pad((sitk.GetArrayFromImage(image) > 0).astype(np.uint8), 1)
    grid = vtk.vtkImageData()
    grid.SetDimensions(*array.shape[::-1])
    grid.SetSpacing(*image.GetSpacing())
    grid.GetPointData().SetScalars(numpy_to_vtk(array.ravel(), deep=True))
    return grid


def to_world(poly, image):
    """Moves a surface made from `labels(image)` to LPS millimetres."""
    p = vtk_to_numpy(poly.GetPoints().GetData()).astype(float) - np.array(image.GetSpacing())
    p = p @ np.array(image.GetDirection()).reshape(3, 3).T + np.array(image.GetOrigin())
    points = vtk.vtkPoints()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(p), deep=True))
    poly.SetPoints(points)
    return poly


def read_stl(path):
    r = vtk.vtkSTLReader()
    r.SetFileName(str(path))
    r.Update()
    return r.GetOutput()


def triangles(poly):
    """Points and triangles as arrays."""
    return vtk_to_numpy(poly.GetPoints().GetData()).astype(float), vtk_to_numpy(poly.GetPolys().GetConnectivityArray()).reshape(-1, 3)


class Closest:
    """The nearest point of a surface, one call a point."""

    def __init__(self, poly):
        self.locator = vtk.vtkStaticCellLocator()
        self.locator.SetDataSet(poly)
        self.locator.BuildLocator()

    def __call__(self, x):
        """Squared distances, triangles and nearest points."""
        cell, sub, d2, ids, c = vtk.vtkGenericCell(), vtk.mutable(0), vtk.mutable(0.0), vtk.mutable(0), [0.0] * 3
        squared, face, near = np.empty(len(x)), np.empty(len(x), int), np.empty((len(x), 3))
        for i, q in enumerate(x):
            self.locator.FindClosestPoint(q, c, cell, ids, sub, d2)
            squared[i], face[i], near[i] = float(d2), int(ids), c
        return squared, face, near


def picture(parts, path, span, colours=DIVERGING, turn=lambda camera: camera.Elevation(-70)):
    """The meshes side by side under one camera, coloured by their point scalars over `span`."""
    table = vtk.vtkColorTransferFunction()
    if colours is DIVERGING:
        table.SetColorSpaceToDiverging()
    for x, c in zip(np.linspace(*span, len(colours)), colours):
        table.AddRGBPoint(x, *c)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    # The colour bar has a strip of its own.
    width = 560 * len(parts) + 120
    window.SetSize(width, 560)
    camera = None
    for n, (name, poly) in enumerate(parts):
        mapper = vtk.vtkPolyDataMapper()
        mapper.SetInputData(poly)
        mapper.SetLookupTable(table)
        mapper.UseLookupTableScalarRangeOn()
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        title = vtk.vtkTextActor()
        title.SetInput(name)
        title.GetTextProperty().SetColor(0, 0, 0)
        title.GetTextProperty().SetFontSize(20)
        title.SetPosition(12, 528)
        r = vtk.vtkRenderer()
        r.SetBackground(1, 1, 1)
        r.SetViewport(560 * n / width, 0, 560 * (n + 1) / width, 1)
        r.AddActor(actor)
        r.AddViewProp(title)
        if camera is None:
            r.ResetCamera()
            camera = r.GetActiveCamera()
            turn(camera)
            camera.OrthogonalizeViewUp()
            r.ResetCamera()
        else:
            r.SetActiveCamera(camera)
        window.AddRenderer(r)
    bar = vtk.vtkScalarBarActor()
    bar.SetLookupTable(table)
    bar.SetNumberOfLabels(5)
    bar.GetLabelTextProperty().SetColor(0, 0, 0)
    bar.SetPosition(0.05, 0.1)
    bar.SetWidth(0.9)
    bar.SetHeight(0.8)
    strip = vtk.vtkRenderer()
    strip.SetBackground(1, 1, 1)
    strip.SetViewport(560 * len(parts) / width, 0, 1, 1)
    strip.AddViewProp(bar)
    window.AddRenderer(strip)
    window.Render()
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.Update()
    w = vtk.vtkPNGWriter()
    w.SetFileName(str(path))
    w.SetInputConnection(grab.GetOutputPort())
    w.Write()
