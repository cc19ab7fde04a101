#!/usr/bin/env python3
"""The paper's own evaluation, on the aneurysm phantom and on any masks given.

    validation/paper/run.sh [MASK...]

Writes validation/results/paper/README.md and pictures: deviation from the vertices of marching cubes (Figure 16),
Table 2 as ratios, Table 3, run times beside marching cubes and surface nets, Gaussian curvature (Figures 14, 15).
Needs vtk, numpy and SimpleITK from PyPI; builds examples/mask_to_surface (release).
"""
import json, subprocess, sys, time
from pathlib import Path

import numpy as np
import SimpleITK as sitk
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "validation"))
from surfaces import RISING, Closest, labels, picture, read_stl, to_world, triangles

RESULTS = ROOT / "validation/results/paper"
WORK = ROOT / "target/validation/paper"


def timed(make):
    """What `make` makes, and its processor's seconds, of all threads: other work on the machine does not count."""
    start = time.process_time()
    out = make()
    return out, time.process_time() - start


def marching_cubes(image):
    f = vtk.vtkMarchingCubes()
    f.SetInputData(image)
    f.SetValue(0, 0.5)
    f.Update()
    return f.GetOutput()


def surface_nets(image):
    """vtkSurfaceNets3D with its constrained smoothing: the kin of constrained elastic surface nets, 8 iterations."""
    f = vtk.vtkSurfaceNets3D()
    f.SetInputData(image)
    f.SetValue(0, 1)
    f.SmoothingOn()
    f.GetSmoother().SetNumberOfIterations(8)
    f.SetOutputMeshTypeToTriangles()
    f.Update()
    return f.GetOutput()


def skewness(poly):
    p, f = triangles(poly)
    angle = []
    for i in range(3):
        u, v = p[f[:, (i + 1) % 3]] - p[f[:, i]], p[f[:, (i + 2) % 3]] - p[f[:, i]]
        angle.append(np.degrees(np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v))))
    a = np.stack(angle, 1)
    return np.maximum((a.max(1) - 60) / 120, 1 - a.min(1) / 60)


def deviation(reference, surface):
    """Distance of every vertex of `reference` to `surface`, mm: the paper's measure."""
    return Closest(surface)(triangles(reference)[0])[0] ** 0.5


def gaussian_curvature(poly, voxel):
    """Gaussian curvature of every vertex in units of 1/voxel², from the angle defect."""
    f = vtk.vtkCurvatures()
    f.SetInputData(poly)
    f.SetCurvatureTypeToGaussian()
    f.Update()
    out = f.GetOutput()
    k = vtk_to_numpy(out.GetPointData().GetArray("Gauss_Curvature")) * voxel**2
    out.GetPointData().SetScalars(numpy_to_vtk(k, deep=True))
    return out, k


def oblique(camera):
    camera.Azimuth(25)
    camera.Elevation(20)


def phantom(folder):
    """A saccular aneurysm at a bifurcation, drawn here: as wide as the paper's, wider than the built-in phantom's."""
    path = folder / "aneurysm.nrrd"
    z, y, x = np.meshgrid(*[np.arange(n) * 1.0 for n in (61, 65, 90)], indexing="ij")
    p = np.stack([x, y, z], -1)

    def tube(a, b, ra, rb):
        a, b = np.array(a), np.array(b)
        t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - (ra + t * (rb - ra))

    def union(a, b, k):
        h = np.maximum(k - abs(a - b), 0) / k
        return np.minimum(a, b) - h * h * k / 4

    d = union(tube((6, 20, 14), (44, 30, 30), 5, 4), tube((44, 30, 30), (82, 14, 44), 4, 2.6), 2)
    d = union(d, tube((44, 30, 30), (70, 48, 16), 3.2, 2.0), 2)
    d = union(d, np.linalg.norm(p - np.array((47, 41, 41)), axis=-1) - 12.3, 3)
    image = sitk.GetImageFromArray((d < 0).astype(np.uint8))
    sitk.WriteImage(image, str(path), True)
    return path


def evaluate(path):
    name = path.name.split(".")[0]
    out = WORK / name
    run = subprocess.run([str(ROOT / "target/release/examples/mask_to_surface"), str(path), str(out), "paper"], capture_output=True, text=True)
    if run.returncode:
        raise SystemExit(f"{path}: {run.stderr}")
    report = json.loads(run.stdout)
    image = sitk.ReadImage(str(path))
    grid, spacing = labels(image), np.array(image.GetSpacing())
    diagonal = float(np.linalg.norm(spacing))
    mc, t_mc = timed(lambda: marching_cubes(grid))
    nets, t_nets = timed(lambda: surface_nets(grid))
    mc, nets = to_world(mc, image), to_world(nets, image)
    rows = {n: read_stl(out / f"{n}.stl") for n in ("polygonized", "improved", "front")}
    d, d_nets = deviation(mc, rows["polygonized"]) / diagonal, deviation(mc, nets) / diagonal
    table3 = {}
    for n, poly in rows.items():
        s = skewness(poly)
        table3[n] = (len(s), float(s.max()), float(s.min()), float(s.mean()))
    voxel = float(np.prod(spacing)) ** (1 / 3)
    curved = [(t, *gaussian_curvature(m, voxel)) for t, m in (("Marching cubes", mc), ("Surface nets", nets), ("MPU implicits", rows["front"]))]
    picture([(t, m) for t, m, _ in curved], RESULTS / f"{name}_curvature.png", (-0.2, 0.2), turn=oblique)
    mc.GetPointData().SetScalars(numpy_to_vtk(d, deep=True))
    picture([("Deviation of the polygonized surface, voxel diagonals", mc)], RESULTS / f"{name}_deviation.png", (0, 0.6), RISING, oblique)
    names = ("points", "fit", "guard", "polygonize")
    t = report["topology"]
    return dict(
        name=name, mc=mc.GetNumberOfPolys(), rows=table3, median=float(np.median(d)), mean=float(d.mean()), worst=float(d.max()),
        nets_median=float(np.median(d_nets)), nets_worst=float(d_nets.max()), t_mc=t_mc, t_nets=t_nets,
        t_ours=sum(report["processor_seconds"][n] for n in names), seconds=report["processor_seconds"], guarded=report["guarded_share"],
        chi_mask=2 * t["mask"]["euler"], chi_surface=t["surface"]["euler"], parts_mask=t["mask"]["components"], parts_surface=t["surface"]["components"],
        curvature=[(n, float(np.median(abs(k))), float(np.percentile(abs(k), 95))) for n, _, k in curved],
    )


def write(cases):
    lines = [
        "# The paper's evaluation",
        "",
        "Made by `validation/paper/run.sh`. Profile `paper`: the paper's placement rules, cells of 0.7 voxels, offset of 5 % of the voxel",
        "diagonal. Its data sets are not public; other vessels stand in, so ratios are compared, not counts.",
        "",
        "## Deviation from the vertices of marching cubes, voxel diagonals",
        "",
        "| case | median | mean | max | surface nets: median | max |",
        "|---|---|---|---|---|---|",
        "| the paper | 0.19 | | 1.9 (aneurysm) | 0.17 (mean, CESN) | |",
    ]
    lines += [f"| {c['name']} | {c['median']:.3f} | {c['mean']:.3f} | {c['worst']:.2f} | {c['nets_median']:.3f} | {c['nets_worst']:.2f} |" for c in cases]
    lines += [
        "",
        "The median is the paper's: most of it is the outward bias of its placement rules and of its offset, not noise. The maximum is",
        "far below the paper's because the guard keeps the wall within 0.6 voxel diagonals of the mask's voxel faces.",
        "",
        "## Table 2 as ratios of triangle counts",
        "",
        "| case | MPUI / MC | front / MPUI |",
        "|---|---|---|",
        "| the paper: BT, LT, CT, AN | 1.08, 2.09, 1.23, 1.13 | 0.68, 0.63, 0.72, 0.49 |",
    ]
    lines += [f"| {c['name']} | {c['rows']['polygonized'][0] / c['mc']:.2f} | {c['rows']['front'][0] / c['rows']['polygonized'][0]:.2f} |" for c in cases]
    lines += [
        "",
        "Bloomenthal's original tabulates the cube's own polygons; here every cell is six tetrahedra, which is closed and manifold",
        "whatever the function does and costs three to six times the triangles before remeshing (cells of 0.7 voxels alone give twice as",
        "many as marching cubes). The guidance field bounds the chord error, the paper's knew the curvature only: the ratio to the",
        "front's mesh follows from both.",
        "",
        "## Table 3: equi-angle skewness",
        "",
        "| case | mesh | faces | S max | S min | S mean |",
        "|---|---|---|---|---|---|",
        "| the paper's aneurysm | MPUI | 61314 | 1.0 | 0.01 | 0.63 |",
        "| | EC | 49356 | 0.74 | 0.03 | 0.28 |",
        "| | AF | 30112 | 0.72 | 0.0004 | 0.23 |",
    ]
    for c in cases:
        for title, n in (("MPUI", "polygonized"), ("improved", "improved"), ("front and repair", "front")):
            f, hi, lo, mean = c["rows"][n]
            lines.append(f"| {c['name']} | {title} | {f} | {hi:.3f} | {lo:.4f} | {mean:.3f} |")
    lines += [
        "",
        "Only triangles above 0.75 are repaired here, as in the paper, hence maxima just below it. The front's mean is above the paper's 0.23:",
        "the guidance field asks for short edges where the paper's point rules leave steps on thin vessels (see the curvature).",
        "The default profile repairs towards 0.45 and reaches a mean of about 0.07.",
        "",
        "## Run times, processor seconds of all threads, mask to polygonized surface",
        "",
        "| case | marching cubes (VTK) | surface nets (VTK) | ours | improve | front and repair |",
        "|---|---|---|---|---|---|",
        "| the paper's aneurysm | 1 | 2 (CESN) | 5 | | minutes |",
    ]
    for c in cases:
        s = c["seconds"]
        lines.append(f"| {c['name']} | {c['t_mc']:.3f} | {c['t_nets']:.3f} | {c['t_ours']:.2f} | {s['improve']:.1f} | {s['guidance field'] + s['advancing front'] + s['repair']:.1f} |")
    lines += [
        "",
        "Ours to marching cubes is above the paper's 5, because VTK's marching cubes is faster than that of 2008 and because six times as many",
        "triangles are made. `improve` and `front and repair` work on the polygonized surface, the one or the other.",
        "",
        "## Topology and guard",
        "",
        "| case | 2 χ(mask) | χ(surface) | components, mask | surface | vertices moved by the guard |",
        "|---|---|---|---|---|---|",
    ]
    lines += [f"| {c['name']} | {c['chi_mask']} | {c['chi_surface']} | {c['parts_mask']} | {c['parts_surface']} | {100 * c['guarded']:.1f} % |" for c in cases]
    lines += [
        "",
        "The offset of 5 % of the voxel diagonal may merge vessels less than three voxels apart: that is the paper's own limit.",
        "",
        "## Gaussian curvature, 1/voxel²",
        "",
        "| case | surface | median of the amount | 95 % |",
        "|---|---|---|---|",
    ]
    lines += [f"| {c['name']} | {n} | {m:.4f} | {p:.3f} |" for c in cases for n, m, p in c["curvature"]]
    lines += [
        "",
        "As in Figures 14 and 15 the implicit surface is free of marching cubes' steps where the vessel is wide (the sacs); on the branches, all along",
        "the phantom's and in stretches of `aneu_b_iso`'s, the paper's rules keep them, and surface nets are smoother. Hence another fit by default.",
    ]
    for c in cases:
        lines += ["", f"![Gaussian curvature of {c['name']}: marching cubes, surface nets, MPU implicits]({c['name']}_curvature.png)", "", f"![Deviation of {c['name']}]({c['name']}_deviation.png)"]
    (RESULTS / "README.md").write_text("\n".join(lines) + "\n")


def main():
    vtk.vtkObject.GlobalWarningDisplayOff()
    RESULTS.mkdir(parents=True, exist_ok=True)
    WORK.mkdir(parents=True, exist_ok=True)
    cases = [evaluate(p) for p in [phantom(WORK), *map(Path, sys.argv[1:])]]
    write(cases)
    print(RESULTS / "README.md")


main()
