"""read_exports.py RESULTS: opens every exported mesh with somebody else's reader and holds it against report.json.

VTK for VTP, VTU, STL, PLY and SimVascular's folder, meshio for Gmsh's file and the VTU files, and Gmsh's own where its package is there.
Code 77: VTK or meshio is missing.
"""
import json
import re
import sys
from pathlib import Path

try:
    import meshio
    import numpy as np
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy
except ImportError:
    sys.exit(77)

folder = Path(sys.argv[1])
report = json.loads((folder / "report.json").read_text())
tets, prisms = report["volume"]["tets"], report["volume"]["prisms"]
names = [o["name"] for o in report["openings"]]
ids = {"wall": 1, **{o["name"]: o["id"] for o in report["openings"]}}


def read(reader, path):
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def array(data, name):
    found = data.GetArray(name)
    assert found is not None, f"no array {name}"
    return vtk_to_numpy(found)


def volume_of(points, cells, corners):
    if not len(cells):
        return 0.0
    # A prism is three tetrahedra.
    parts = [(0, 1, 2, 3)] if corners == 4 else [(0, 2, 1, 3), (1, 2, 4, 3), (2, 5, 4, 3)]
    total = 0
    for p in parts:
        a, b, c, d = (points[cells[:, i]] for i in p)
        v = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6
        assert corners == 6 or (v > 0).all(), "tetrahedra that are not positive"
        total += v.sum()
    return total


# SimVascular: ids from 1, faces that point back to nodes and cells of the volume, centimetres.
sv = folder / "simvascular/mesh-complete"
grid = read(vtk.vtkXMLUnstructuredGridReader(), sv / "mesh-complete.mesh.vtu")
types = np.array([grid.GetCellType(i) for i in range(grid.GetNumberOfCells())])
# One kind of cells only: each prism is three tetrahedra here.
assert (types == vtk.VTK_TETRA).all() and len(types) == tets + 3 * prisms
nodes = array(grid.GetPointData(), "GlobalNodeID")
assert nodes.dtype == np.int32 and (np.sort(nodes) == np.arange(1, grid.GetNumberOfPoints() + 1)).all()
elements = array(grid.GetCellData(), "GlobalElementID")
assert elements.dtype == np.int32 and (np.sort(elements) == np.arange(1, len(types) + 1)).all()
assert (array(grid.GetCellData(), "ModelRegionID") == 1).all()
points = vtk_to_numpy(grid.GetPoints().GetData()).astype(float)
offsets = vtk_to_numpy(grid.GetCells().GetOffsetsArray())
connectivity = vtk_to_numpy(grid.GetCells().GetConnectivityArray())
at = {n: p for n, p in zip(nodes, points)}
faces = 0
for path in sorted((sv / "mesh-surfaces").glob("*.vtp")):
    face = read(vtk.vtkXMLPolyDataReader(), path)
    assert path.stem in ids, path
    of = array(face.GetPointData(), "GlobalNodeID")
    p = vtk_to_numpy(face.GetPoints().GetData()).astype(float)
    assert (p == np.array([at[n] for n in of])).all(), f"{path.name}: nodes elsewhere than in the volume"
    behind = array(face.GetCellData(), "GlobalElementID")
    assert (array(face.GetCellData(), "ModelFaceID") == ids[path.stem]).all()
    polys, cell = face.GetPolys(), vtk.vtkIdList()
    for k in range(0, face.GetNumberOfCells(), 17):
        polys.GetCellAtId(k, cell)
        corners = {of[cell.GetId(i)] for i in range(cell.GetNumberOfIds())}
        c = behind[k] - 1
        assert corners <= set(nodes[connectivity[offsets[c]:offsets[c + 1]]]), f"{path.name}: face {k} is not its cell's"
    faces += face.GetNumberOfCells()
exterior = read(vtk.vtkXMLPolyDataReader(), sv / "mesh-complete.exterior.vtp")
assert exterior.GetNumberOfCells() == faces
edges = vtk.vtkFeatureEdges()
edges.SetInputData(exterior)
edges.FeatureEdgesOff()
edges.ManifoldEdgesOff()
edges.Update()
assert edges.GetOutput().GetNumberOfCells() == 0, "the exterior is not closed"
walls = read(vtk.vtkXMLPolyDataReader(), sv / "walls_combined.vtp")
assert walls.GetNumberOfCells() == read(vtk.vtkXMLPolyDataReader(), sv / "mesh-surfaces/wall.vtp").GetNumberOfCells()

# VMTK: boundary faces among the cells; 0 inside, 1 wall, openings from 2.
grid = read(vtk.vtkXMLUnstructuredGridReader(), folder / "vmtk/lumen.vtu")
entity = array(grid.GetCellData(), "CellEntityIds")
kinds = np.array([grid.GetCellType(i) for i in range(grid.GetNumberOfCells())])
solid = np.isin(kinds, [vtk.VTK_TETRA, vtk.VTK_WEDGE])
assert (entity[solid] == 0).all() and set(entity[~solid]) == set(ids.values())
quads = (kinds == vtk.VTK_QUAD).sum()
assert (~solid).sum() + quads == faces and solid.sum() == tets + prisms
faces = (~solid).sum()

# VTK's volume and boundary by meshio.
mesh = meshio.read(folder / "volume/lumen.vtu")
count = lambda kind: sum(len(b.data) for b in mesh.cells if b.type == kind)
assert (count("tetra"), count("wedge")) == (tets, prisms), mesh
assert mesh.field_data["MetresPerUnit"] == 0.001 and mesh.field_data["CoordinatesLPS"] == 1, mesh.field_data
assert all(len(d) for d in mesh.cell_data["EquiVolumeSkewness"])
boundary = meshio.read(folder / "volume/boundary.vtu")
patches = {n: int(v[0]) for n, v in ((n, np.ravel(v)) for n, v in boundary.field_data.items()) if len(v) == 2 and v[1] == 2}
assert patches == ids, (patches, ids)
assert sum(len(b.data) for b in boundary.cells) == faces
assert set(np.concatenate(boundary.cell_data["PatchId"])) == set(ids.values())
assert (boundary.points == mesh.points[boundary.point_data["VolumePointId"]]).all()
grid = read(vtk.vtkXMLUnstructuredGridReader(), folder / "volume/lumen.vtu")
assert array(grid.GetFieldData(), "MetresPerUnit")[0] == 0.001
grid = read(vtk.vtkXMLUnstructuredGridReader(), folder / "volume/boundary.vtu")
assert list(array(grid.GetFieldData(), "inlet").ravel()) == [ids["inlet"], 2]

# Gmsh 4.1 by meshio.
mesh = meshio.read(folder / "gmsh/lumen.msh")
count = lambda kind: sum(len(b.data) for b in mesh.cells if b.type == kind)
assert (count("tetra"), count("wedge")) == (tets, prisms), mesh
assert count("triangle") + count("quad") == faces
groups = {n: (int(v[0]), int(v[1])) for n, v in mesh.field_data.items()}
assert groups == {"fluid": (1, 3), **{n: (i, 2) for n, i in ids.items()}}, groups
# Gmsh's prism has its triangles the other way round than VTK's.
vtk_order = {"tetra": [0, 1, 2, 3], "wedge": [0, 2, 1, 3, 5, 4]}
total = sum(volume_of(mesh.points, b.data[:, vtk_order[b.type]], len(vtk_order[b.type])) for b in mesh.cells if b.type in vtk_order)
whole = volume_of(points, connectivity.reshape(-1, 4), 4)
# A prism's sides are not flat: which diagonal they are split along shows in the fifth digit.
assert abs(total / (whole * 1e3) - 1) < (1e-3 if prisms else 1e-9), (total, whole)
physical = np.concatenate([d for b, d in zip(mesh.cells, mesh.cell_data["gmsh:physical"]) if b.type in ("triangle", "quad")])
assert set(physical) == set(ids.values())

# Gmsh by Gmsh.
try:
    import gmsh
except (ImportError, OSError):
    print("gmsh: not installed, skipped")
else:
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(folder / "gmsh/lumen.msh"))
    groups = {gmsh.model.getPhysicalName(d, t): (t, d) for d, t in gmsh.model.getPhysicalGroups()}
    assert groups == {"fluid": (1, 3), **{n: (i, 2) for n, i in ids.items()}}, groups
    kinds, tags, _ = gmsh.model.mesh.getElements(3)
    assert {k: len(t) for k, t in zip(kinds, tags)} == {k: n for k, n in ((4, tets), (6, prisms)) if n}
    for t in tags:
        # Gmsh's own measure is positive for every cell: its order of a prism's corners is kept.
        assert min(gmsh.model.mesh.getElementQualities(t, "volume")) > 0
    gmsh.finalize()

# Surfaces: one solid a patch, closed together.
text = (folder / "surface/lumen.stl").read_text()
assert re.findall(r"^solid (\S+)", text, re.M) == ["wall", *names] == re.findall(r"^endsolid (\S+)", text, re.M)
surface = read(vtk.vtkXMLPolyDataReader(), folder / "surface/lumen.vtp")
for reader, path in ((vtk.vtkPLYReader(), "lumen.ply"), (vtk.vtkSTLReader(), "lumen.stl")):
    other = read(reader, folder / "surface" / path)
    assert other.GetNumberOfCells() == surface.GetNumberOfCells(), path
parts = [read(vtk.vtkSTLReader(), folder / f"surface/{n}.stl").GetNumberOfCells() for n in ids]
assert sum(parts) == surface.GetNumberOfCells() and min(parts) > 0
print("all readers agree:", tets, "tetrahedra,", prisms, "prisms,", faces, "boundary faces")
