#!/usr/bin/env python3
"""How near the reconstructed wall lies to the true one, beside what users have today.

    validation/accuracy/run.sh [DATA]

Every built-in phantom and, where DATA (default ../shared/data) is present, its phantoms and its real masks with the
surfaces they were made from. Per mask, in one run: the smooth fit polygonized at half a voxel (before remeshing),
marching cubes (vtkFlyingEdges3D) and marching cubes smoothed as Taubin's (vtkWindowedSincPolyDataFilter, pass band 0.1,
30 iterations). Writes validation/results/accuracy/README.md and pictures.
"""
import gzip, json, subprocess, sys, tempfile, time
from pathlib import Path

import numpy as np
import SimpleITK as sitk
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "validation/results/accuracy"
WORK = ROOT / "target/validation/accuracy"
TOOL = ROOT / "target/release/examples/mask_to_surface"
PROGRAM = ROOT / "target/release/lumenmesh"
SAMPLES = 40000
BORDER = 4.0  # samples nearer to the picture's border than this, in voxels, are left out: vessels are cut there
LIMITS = dict(median=0.03, rms=0.05, bias=0.01, p99=0.15, max=0.45)
NORMALS = {False: (3.5, 15.0), True: (5.0, 20.0)}


def distance_of(prim):
    kind, r = prim["type"], prim["radius"]
    if kind == "sphere":
        return lambda x: np.linalg.norm(x - np.array(prim["c"]), axis=1) - r
    if kind == "cylinder":
        c, d = np.array(prim["p"], float), np.array(prim["dir"], float)
        return lambda x: np.linalg.norm((x - c) - np.outer((x - c) @ d, d), axis=1) - r
    if kind == "capsule":
        a, b, r2 = np.array(prim["a"], float), np.array(prim["b"], float), prim.get("radius2", r)

        def f(x):
            t = np.clip((x - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            return np.linalg.norm(x - a - t[:, None] * (b - a), axis=1) - (r + t * (r2 - r))

        return f
    if kind == "torus_arc":
        c, u, v, big, angle = np.array(prim["c"], float), np.array(prim["u"]), np.array(prim["v"]), prim["R"], prim["angle"]

        def f(x):
            w = x - c
            p, q, s = w @ u, w @ v, w @ np.cross(u, v)
            t = np.arctan2(q, p)
            t = np.where(t < -1e-9, t + 2 * np.pi, t)
            ends = np.minimum(np.linalg.norm(w - big * u, axis=1), np.linalg.norm(w - big * (np.cos(angle) * u + np.sin(angle) * v), axis=1))
            return np.where(t <= angle, np.hypot(np.hypot(p, q) - big, s), ends) - r

        return f
    raise SystemExit(f"truth: unknown primitive {kind}")


def formula(path):
    """Signed distance and unit normal of a phantom's wall: primitives joined, smoothly where they have a k."""
    parts = [(distance_of(p), p.get("k", 0.0)) for p in json.loads(Path(path).read_text())["prims"]]

    def f(x):
        d = parts[0][0](x)
        for g, k in parts[1:]:
            e = g(x)
            h = np.maximum(k - np.abs(d - e), 0) / k if k else 0
            d = np.minimum(d, e) - h * h * k / 4
        return d

    def both(x, unit):
        e = 1e-4 * unit
        g = np.stack([f(x + e * a) - f(x - e * a) for a in np.eye(3)], 1) / (2 * e)
        s = np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 0.2)
        return f(x) / s[:, 0], g / s

    return both


def mesh_of(poly):
    return vtk_to_numpy(poly.GetPoints().GetData()).astype(float), vtk_to_numpy(poly.GetPolys().GetConnectivityArray()).reshape(-1, 3)


def read_stl(path):
    r = vtk.vtkSTLReader()
    r.SetFileName(str(path))
    r.Update()
    return r.GetOutput()


def normals_of(p, f):
    n = np.cross(p[f[:, 1]] - p[f[:, 0]], p[f[:, 2]] - p[f[:, 0]])
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)


def surface_truth(path):
    """Signed distance and normal of a closed surface (STL, maybe gzipped)."""
    if str(path).endswith(".gz"):
        with tempfile.NamedTemporaryFile(suffix=".stl") as t:
            t.write(gzip.open(path).read())
            t.flush()
            poly = read_stl(t.name)
    else:
        poly = read_stl(path)
    p, f = mesh_of(poly)
    n = normals_of(p, f)
    locator = vtk.vtkStaticCellLocator()
    locator.SetDataSet(poly)
    locator.BuildLocator()

    def both(x, _):
        cell, sub, d2, ids, c = vtk.vtkGenericCell(), vtk.mutable(0), vtk.mutable(0.0), vtk.mutable(0), [0.0] * 3
        d, face = np.empty(len(x)), np.empty(len(x), int)
        for i, q in enumerate(x):
            locator.FindClosestPoint(q, c, cell, ids, sub, d2)
            face[i] = int(ids)
            d[i] = np.copysign(float(d2) ** 0.5, (q - c) @ n[face[i]])
        return d, n[face]

    return both


def sample(p, f):
    rng = np.random.default_rng(1)
    area = np.linalg.norm(np.cross(p[f[:, 1]] - p[f[:, 0]], p[f[:, 2]] - p[f[:, 0]]), axis=1)
    i = rng.choice(len(f), SAMPLES, p=area / area.sum())
    u, v = rng.random(SAMPLES), rng.random(SAMPLES)
    over = u + v > 1
    u[over], v[over] = 1 - u[over], 1 - v[over]
    a = p[f[i, 0]]
    return a + u[:, None] * (p[f[i, 1]] - a) + v[:, None] * (p[f[i, 2]] - a), i


def measure(poly, truth, image):
    p, f = mesh_of(poly)
    x, face = sample(p, f)
    spacing, diagonal = np.array(image.GetSpacing()), float(np.linalg.norm(image.GetSpacing()))
    axes = np.array(image.GetDirection()).reshape(3, 3) @ np.diag(spacing)
    at = (x - np.array(image.GetOrigin())) @ np.linalg.inv(axes).T
    keep = np.all((at > BORDER) & (at < np.array(image.GetSize()) - 1 - BORDER), axis=1)
    x, face = x[keep], face[keep]
    d, g = truth(x, diagonal)
    d = d / diagonal
    w = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", g, normals_of(p, f)[face]), -1, 1)))
    a = np.abs(d)
    return dict(faces=len(f), median=float(np.median(a)), rms=float(np.sqrt((a**2).mean())), bias=float(d.mean()), p99=float(np.percentile(a, 99)),
                max=float(a.max()), n50=float(np.median(w)), n99=float(np.percentile(w, 99))), (x, d)


def peers(image):
    """Marching cubes and its smoothed surface; seconds of both together, the better of three runs."""
    array = np.pad((sitk.GetArrayFromImage(image) > 0).astype(np.uint8), 1)
    grid = vtk.vtkImageData()
    grid.SetDimensions(*array.shape[::-1])
    grid.SetSpacing(*image.GetSpacing())
    grid.GetPointData().SetScalars(numpy_to_vtk(array.ravel(), deep=True))
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        cubes = vtk.vtkFlyingEdges3D()
        cubes.SetInputData(grid)
        cubes.SetValue(0, 0.5)
        cubes.ComputeNormalsOff()
        cubes.Update()
        sinc = vtk.vtkWindowedSincPolyDataFilter()
        sinc.SetInputConnection(cubes.GetOutputPort())
        sinc.SetPassBand(0.1)
        sinc.SetNumberOfIterations(30)
        sinc.NormalizeCoordinatesOn()
        sinc.Update()
        seconds.append(time.perf_counter() - start)
    out = {}
    direction, origin = np.array(image.GetDirection()).reshape(3, 3), np.array(image.GetOrigin())
    for name, poly in (("marching cubes", cubes.GetOutput()), ("Taubin", sinc.GetOutput())):
        p = (vtk_to_numpy(poly.GetPoints().GetData()).astype(float) - np.array(image.GetSpacing())) @ direction.T + origin
        points = vtk.vtkPoints()
        points.SetDataTypeToDouble()
        points.SetData(numpy_to_vtk(np.ascontiguousarray(p), deep=True))
        poly.SetPoints(points)
        out[name] = poly
    return out, min(seconds)


def ours(path, out):
    best = None
    for _ in range(3):
        run = subprocess.run([str(TOOL), str(path), str(out), "smooth"], capture_output=True, text=True)
        if run.returncode:
            raise SystemExit(f"{path}: {run.stderr}")
        report = json.loads(run.stdout)
        t = report["seconds"]["fit"] + report["seconds"]["polygonize"]
        if best is None or t < best[0]:
            best = (t, report)
    return read_stl(out / "polygonized.stl"), best[1], best[0]


def picture(parts, path):
    """The surfaces side by side, coloured by signed distance to the truth in voxel diagonals."""
    table = vtk.vtkColorTransferFunction()
    table.SetColorSpaceToDiverging()
    for x, c in ((-0.3, (0.23, 0.30, 0.75)), (0.0, (0.87, 0.87, 0.87)), (0.3, (0.71, 0.02, 0.15))):
        table.AddRGBPoint(x, *c)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetSize(560 * len(parts), 560)
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
        r.SetViewport(n / len(parts), 0, (n + 1) / len(parts), 1)
        r.AddActor(actor)
        r.AddViewProp(title)
        if camera is None:
            r.ResetCamera()
            camera = r.GetActiveCamera()
            camera.Elevation(-70)
            camera.OrthogonalizeViewUp()
            r.ResetCamera()
        else:
            r.SetActiveCamera(camera)
        if n + 1 == len(parts):
            bar = vtk.vtkScalarBarActor()
            bar.SetLookupTable(table)
            bar.SetNumberOfLabels(5)
            bar.GetLabelTextProperty().SetColor(0, 0, 0)
            bar.SetWidth(0.1)
            r.AddViewProp(bar)
        window.AddRenderer(r)
    window.Render()
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.Update()
    w = vtk.vtkPNGWriter()
    w.SetFileName(str(path))
    w.SetInputConnection(grab.GetOutputPort())
    w.Write()


def coloured(poly, truth, diagonal):
    p, _ = mesh_of(poly)
    poly.GetPointData().SetScalars(numpy_to_vtk(truth(p, diagonal)[0] / diagonal, deep=True))
    return poly


def cases(data):
    for name in subprocess.run([str(PROGRAM), "phantom", "list"], capture_output=True, text=True, check=True).stdout.split():
        folder = WORK / "phantoms" / name
        if not (folder / "mask.nrrd").exists():
            subprocess.run([str(PROGRAM), "phantom", name, "-o", str(folder)], check=True, capture_output=True)
        yield "built-in", name, folder / "mask.nrrd", formula(folder / "truth.json")
    if not data.is_dir():
        print(f"{data} is not there: built-in phantoms only", file=sys.stderr)
        return
    for path in sorted((data / "phantoms").glob("*.n*")):
        name = path.name.split(".")[0]
        yield "phantom", name, path, formula(data / "phantoms" / f"{name.rsplit('_', 1)[0]}.json")
    for truth in sorted((data / "truth").glob("*.stl.gz")):
        name = truth.name.split(".")[0]
        path = next(p for p in data.glob(name + ".*") if p.is_file())
        yield "real", name, path, surface_truth(truth)


PICTURES = ("aneurysm", "ph3_aneurysm_Y_iso", "aneu_a_aniso", "carotid_aniso")


def evaluate(kind, name, path, truth):
    image = sitk.ReadImage(str(path))
    surface, report, seconds = ours(path, WORK / name)
    others, peer_seconds = peers(image)
    meshes = {"fit": surface, **others}
    rows = {n: measure(m, truth, image)[0] for n, m in meshes.items()}
    spacing = np.array(image.GetSpacing())
    if name in PICTURES:
        picture([(n, coloured(m, truth, float(np.linalg.norm(spacing)))) for n, m in meshes.items()], RESULTS / f"{name}.png")
    t = report["topology"]
    print(name, {k: round(v, 4) for k, v in rows["fit"].items()}, f"{seconds:.2f} s, peer {peer_seconds:.3f} s", flush=True)
    return dict(kind=kind, name=name, rows=rows, seconds=seconds, peer=peer_seconds, anisotropic=spacing.max() > 1.5 * spacing.min(),
                chi=(2 * t["mask"]["euler"], t["surface"]["euler"]), parts=(t["mask"]["components"], t["surface"]["components"]),
                volume=report["volume"] / report["mask_volume"], boundary=report["boundary_voxels"], voxels=report["voxels"], memory=report["peak_memory_bytes"])


def table(found, title, note):
    lines = ["", f"## {title}", "", note, "", "| case | surface | faces | median | rms | bias | 99 % | max | normals 50 % | 99 % | limits |", "|---|---|---|---|---|---|---|---|---|---|---|"]
    for c in found:
        for n, r in c["rows"].items():
            missed = ""
            if n == "fit" and c["kind"] != "real":
                a, b = NORMALS[bool(c["anisotropic"])]
                bad = [k for k, v in LIMITS.items() if abs(r[k]) > v] + [k for k, v in (("normals 50 %", a), ("normals 99 %", b)) if r[k.replace("normals ", "n").replace(" %", "")] > v]
                missed = "missed: " + ", ".join(bad) if bad else "met"
            elif n == "fit":
                worse = [f"{k} ({o})" for o in ("marching cubes", "Taubin") for k in ("median", "rms", "p99", "max", "n50", "n99") if r[k] > c["rows"][o][k]]
                missed = "worse: " + ", ".join(worse) if worse else "better throughout"
            lines.append(f"| {c['name'] if n == 'fit' else ''} | {n} | {r['faces']} | {r['median']:.3f} | {r['rms']:.3f} | {r['bias']:+.3f} | {r['p99']:.3f} | {r['max']:.3f} | {r['n50']:.1f}° | {r['n99']:.1f}° | {missed} |")
    return lines


def write(found):
    lines = [
        "# Accuracy of the reconstructed wall",
        "",
        "Made by `validation/accuracy/run.sh`. Distances to the true wall in voxel diagonals (bias: positive outwards), angles between",
        f"the triangles' normals and the true wall's; {SAMPLES} random points of each surface, {BORDER:.0f} voxels from the picture's border. `fit` is the",
        "default reconstruction polygonized at half a voxel, before remeshing.",
    ]
    limits = "Limits for `fit`: median ≤ 0.03, rms ≤ 0.05, |bias| ≤ 0.01, 99 % ≤ 0.15, max ≤ 0.45; normals ≤ 3.5° and 15° (anisotropic voxels: 5° and 20°)."
    lines += table([c for c in found if c["kind"] == "built-in"], "Built-in phantoms", limits)
    if any(c["kind"] == "phantom" for c in found):
        lines += table([c for c in found if c["kind"] == "phantom"], "Shared phantoms", limits)
    if any(c["kind"] == "real" for c in found):
        lines += table([c for c in found if c["kind"] == "real"], "Real vessels, against the surfaces that the masks were made from", "`fit` should be better than both others in each figure.")
    notes = RESULTS / "notes.md"
    if notes.exists():
        lines += ["", notes.read_text().strip()]
    lines += ["", "## Topology, volume, time and memory", "",
              "Seconds from cleaned mask to polygonized surface beside vtkFlyingEdges3D and vtkWindowedSincPolyDataFilter (best of three runs each, the same machine at the same time).", "",
              "| case | 2 χ(mask), χ(surface) | parts | volume / mask | boundary voxels | seconds | VTK | ratio | µs a boundary voxel | peak MB | bytes a boundary voxel |", "|---|---|---|---|---|---|---|---|---|---|---|"]
    for c in found:
        memory = c["memory"] or 0
        lines.append(f"| {c['name']} | {c['chi'][0]}, {c['chi'][1]} | {c['parts'][0]}, {c['parts'][1]} | {c['volume']:.4f} | {c['boundary']} | {c['seconds']:.2f} | {c['peer']:.3f} | {c['seconds'] / c['peer']:.0f} | {1e6 * c['seconds'] / c['boundary']:.1f} | {memory / 1e6:.0f} | {memory / c['boundary']:.0f} |")
    for name in PICTURES:
        if (RESULTS / f"{name}.png").exists():
            lines += ["", f"![Signed distance of {name} to the true wall: the fit, marching cubes, Taubin smoothing]({name}.png)"]
    (RESULTS / "README.md").write_text("\n".join(lines) + "\n")


def main():
    vtk.vtkObject.GlobalWarningDisplayOff()
    RESULTS.mkdir(parents=True, exist_ok=True)
    WORK.mkdir(parents=True, exist_ok=True)
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT.parent / "shared/data"
    write([evaluate(*c) for c in cases(data)])
    print(RESULTS / "README.md")


main()
