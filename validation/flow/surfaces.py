"""(d) The same vessel from lumenmesh's default, from the paper's profile and from marching cubes: how the WSS differs."""
import json, subprocess

import numpy as np
import tetgen
import vtk
from scipy.spatial import cKDTree
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

import foam, pictures, tools
from tools import check


def read_mask(path):
    """Voxels and geometry of a raw or gzip NRRD with axis-parallel directions."""
    import gzip, re
    data = path.read_bytes()
    at = data.index(b"\n\n")
    head = data[:at].decode()
    value = lambda key: re.search(rf"^{key}:?=?\s*(.*)$", head, re.M).group(1)
    size = [int(x) for x in value("sizes").split()]
    body = data[at + 2:]
    body = gzip.decompress(body) if "gz" in value("encoding") else body
    voxels = np.frombuffer(body, np.uint8).reshape(size[::-1])
    numbers = lambda text: np.array([float(x) for x in re.findall(r"[-+0-9.e]+", text)])
    return voxels, np.diag(numbers(value("space directions")).reshape(3, 3)), numbers(value("space origin"))


def marching_cubes(mask, openings):
    """Closed triangles of marching cubes, cut flat at the openings' planes."""
    voxels, spacing, origin = read_mask(mask)
    image = vtk.vtkImageData()
    padded = np.pad(voxels, 1)
    image.SetDimensions(*padded.shape[::-1])
    image.SetSpacing(*spacing)
    image.SetOrigin(*(origin - spacing))
    image.GetPointData().SetScalars(numpy_to_vtk(padded.ravel(), deep=True))
    cubes = vtk.vtkMarchingCubes()
    cubes.SetInputData(image)
    cubes.SetValue(0, 0.5)
    clean = vtk.vtkCleanPolyData()
    clean.SetInputConnection(cubes.GetOutputPort())
    planes = vtk.vtkPlaneCollection()
    for o in openings:
        plane = vtk.vtkPlane()
        plane.SetOrigin(*o["center"])
        plane.SetNormal(*(-np.array(o["normal"])))
        planes.AddItem(plane)
    clip = vtk.vtkClipClosedSurface()
    clip.SetInputConnection(clean.GetOutputPort())
    clip.SetClippingPlanes(planes)
    clip.SetTolerance(1e-4)
    joined = vtk.vtkCleanPolyData()
    joined.SetInputConnection(clip.GetOutputPort())
    joined.ConvertPolysToLinesOff()
    triangles = vtk.vtkTriangleFilter()
    triangles.SetInputConnection(joined.GetOutputPort())
    triangles.PassLinesOff()
    triangles.PassVertsOff()
    triangles.Update()
    out = triangles.GetOutput()
    return vtk_to_numpy(out.GetPoints().GetData()).astype(float), vtk_to_numpy(out.GetPolys().GetConnectivityArray()).reshape(-1, 3)


def fill(points, triangles, openings, cell_volume):
    """TetGen on the surface as it stands; boundary faces by the planes they lie in."""
    engine = tetgen.TetGen(points, triangles)
    engine.tetrahedralize(switches=f"pq1.4a{cell_volume:.6g}Q")
    nodes, cells = np.asarray(engine.node), np.asarray(engine.elem)[:, :4]
    a, b, c, d = (nodes[cells[:, i]] for i in range(4))
    flipped = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    cells[flipped] = cells[flipped][:, [1, 0, 2, 3]]
    faces = np.concatenate([cells[:, f] for f in ([0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2])])
    _, first, count = np.unique(np.sort(faces, 1), axis=0, return_index=True, return_counts=True)
    outer = faces[first[count == 1]]
    patch = np.ones(len(outer), int)
    for o in openings:
        off = np.abs((nodes - o["center"]) @ o["normal"])
        patch[(off[outer] < 1e-3).all(1)] = o["id"]
    return nodes, cells, outer, patch


def write_gmsh(path, nodes, cells, outer, patch, openings):
    names = [(1, "wall"), *((o["id"], o["name"]) for o in openings)]
    with open(path, "w") as f:
        f.write("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n%d\n" % (len(names) + 1))
        f.writelines(f'2 {i} "{n}"\n' for i, n in names)
        f.write('3 1 "fluid"\n$EndPhysicalNames\n$Nodes\n%d\n' % len(nodes))
        f.writelines("%d %.17g %.17g %.17g\n" % (i + 1, *p) for i, p in enumerate(nodes))
        f.write("$EndNodes\n$Elements\n%d\n" % (len(outer) + len(cells)))
        f.writelines("%d 2 2 %d %d %d %d %d\n" % (i + 1, p, p, *(t + 1)) for i, (t, p) in enumerate(zip(outer, patch)))
        f.writelines("%d 4 2 1 1 %d %d %d %d\n" % (i + 1 + len(outer), *(t + 1)) for i, t in enumerate(cells))
        f.write("$EndElements\n")


def solved(folder, rho):
    run = foam.solve(folder)
    mesh = foam.Mesh(folder)
    wss, size = tools.wall_shear_stress(folder, mesh, rho)
    return run, mesh, wss, size


def run():
    work = tools.WORK / "d"
    phantom = work / "phantom"
    subprocess.run([str(tools.LUMENMESH), "phantom", "aneurysm", "-o", str(phantom)], check=True, stdout=subprocess.DEVNULL)
    base = tools.mesh(phantom / "case.yaml", work / "default", ["exports=[openfoam]"])
    openings = base["openings"]
    rho, rate = tools.density(base), base["flow"]["total_m3_per_s"] * 1e6
    # The same planes and the same flow for all.
    (work / "paper.yaml").write_text(json.dumps({
        "input": {"mask": str(phantom / "mask.nrrd")}, "reconstruction": {"profile": "paper"},
        "openings": [{"name": o["name"], "center": o["center"], "normal": o["normal"]} for o in openings],
        "flow": {"inlet": {"flow_rate": rate}}, "exports": ["openfoam"]}))
    paper = tools.mesh(work / "paper.yaml", work / "paper")
    mesh = foam.Mesh(work / "default/openfoam")
    points, triangles = marching_cubes(phantom / "mask.nrrd", openings)
    filled = fill(points, triangles, openings, 1.6e9 * mesh.volume.sum() / mesh.cells)
    write_gmsh(work / "cubes.msh", *filled, openings)
    example = tools.LUMENMESH.parent / "examples/solver_case"
    subprocess.run([str(example), str(work / "cubes.msh"), str(work / "cubes"), f"{rate:.12g}"], check=True)
    quality = subprocess.run([str(tools.LUMENMESH), "check", str(work / "cubes.msh"), "--json"], capture_output=True, text=True)
    quality = json.loads(quality.stdout)["volume"]
    rows, shown, checks = [], [], []
    truth = None
    for name, folder, report in (("lumenmesh, default", work / "default/openfoam", base["volume"]),
                                 ("lumenmesh, paper profile", work / "paper/openfoam", paper["volume"]),
                                 ("marching cubes + TetGen", work / "cubes", quality)):
        run, mesh, wss, size = solved(folder, rho)
        centre = mesh.centre[mesh.patches["wall"]]
        if truth is None:
            truth = (cKDTree(centre), wss, size)
        near = truth[1][truth[0].query(centre)[1]]
        # Scatter: how much a face differs from the mean of its neighbourhood of 1 mm.
        tree = cKDTree(centre)
        around = np.array([np.average(wss[i], weights=size[i]) for i in tree.query_ball_point(centre, 1e-3)])
        row = {"name": name, "cells": mesh.cells, **run, "sv_max": report["sv_max"],
               "wss_mean": tools.mean(wss, size), "wss_p99": tools.percentile(wss, size, 0.99), "wss_max": float(wss.max()),
               "difference_rms": float(np.sqrt(tools.mean((wss - near) ** 2, size)) / tools.mean(near, size)) * 100,
               "scatter": 100 * float(np.sqrt(tools.mean((wss - around) ** 2, size)) / tools.mean(wss, size)),
               "dp": rho * (foam.monitored(folder, "p_inlet") - foam.monitored(folder, "p_outlet_1"))}
        rows.append(row)
        shown.append((mesh, wss, f"{name}, {mesh.cells} cells"))
        print(row, flush=True)
    pictures.wall(tools.RESULTS / "d.png", shown, 1.1 * rows[0]["wss_p99"], width=460)
    checks.append(check("default: converged (1 = yes)", 1 if rows[0]["iterations"] else 0, 1, larger=True))
    checks.append(check("scatter of the WSS, default over marching cubes", rows[0]["scatter"] / rows[2]["scatter"], 1))
    return {"rows": rows, "checks": checks}
