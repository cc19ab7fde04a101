"""read_volume.py RESULTS: opens volume/lumen.vtu and surface/lumen.vtp with VTK's own readers and compares them."""
import sys

try:
    import numpy as np
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy
except ImportError:
    sys.exit(77)

folder = sys.argv[1]
reader = vtk.vtkXMLUnstructuredGridReader()
reader.SetFileName(folder + "/volume/lumen.vtu")
reader.Update()
grid = reader.GetOutput()
cells = grid.GetNumberOfCells()
types = {grid.GetCellType(i) for i in range(cells)}
assert types <= {vtk.VTK_TETRA, vtk.VTK_WEDGE}, types
points = vtk_to_numpy(grid.GetPoints().GetData()).astype(float)
assert points.dtype == np.float64
ids = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, 4)
a, b, c, d = (points[ids[:, i]] for i in range(4))
volumes = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6
assert (volumes > 0).all(), "cells that are not positive"

reader = vtk.vtkXMLPolyDataReader()
reader.SetFileName(folder + "/surface/lumen.vtp")
reader.Update()
surface = reader.GetOutput()
p = vtk_to_numpy(surface.GetPoints().GetData()).astype(float)
t = vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)
o = p[0]
enclosed = np.einsum("ij,ij->i", p[t[:, 0]] - o, np.cross(p[t[:, 1]] - o, p[t[:, 2]] - o)).sum() / 6
error = abs(volumes.sum() / enclosed - 1)
assert error <= 1e-9, f"volume {volumes.sum()} against {enclosed}: {error}"
arrays = {surface.GetCellData().GetArrayName(i) for i in range(surface.GetCellData().GetNumberOfArrays())}
assert {"PatchId", "EquiAngleSkewness"} <= arrays, arrays
print("cells", cells, "volume error", error)
