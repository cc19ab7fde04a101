#!/usr/bin/env python3
"""How near the reconstructed wall lies to the true one, beside what users have today.

    validation/accuracy/run.sh [DATA [--resume] [NAME...]]

Every built-in phantom and, where DATA (default ../shared/data) is present, its phantoms and its real masks with the
surfaces they were made from. Per mask, in one run: the smooth fit polygonized at half a voxel (before remeshing),
marching cubes (vtkFlyingEdges3D) and marching cubes smoothed as Taubin's (vtkWindowedSincPolyDataFilter, pass band 0.1,
30 iterations). Writes validation/results/accuracy/README.md and pictures; with names, prints the figures of these alone.
The table grows case by case; `--resume` takes what a stopped run has measured.
"""
import gzip, json, subprocess, sys, tempfile, time
from pathlib import Path

import numpy as np
import SimpleITK as sitk
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "validation"))
from surfaces import Closest, labels, picture, read_stl, to_world, triangles

RESULTS = ROOT / "validation/results/accuracy"
WORK = ROOT / "target/validation/accuracy"
TOOL = ROOT / "target/release/examples/mask_to_surface"
RANDOM = ROOT / "target/release/examples/random_phantoms"
PROGRAM = ROOT / "target/release/lumenmesh"
SAMPLES = 40000
SEED = ("3", "20261124")  # rounds and seed of the pictures at random: no seed that the weights were ever chosen by
BORDER = 4.0  # samples nearer to the picture's border than this, in voxels, are left out: vessels are cut there
WALL = 1
LIMITS = dict(median=0.03, rms=0.05, bias=0.01, p99=0.15, max=0.45)
REMESHED = dict(bias=0.015, n50=5.0)
MOST_FACES = 1.5  # of marching cubes, for real vessels
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
    p, f = triangles(poly)
    n = normals_of(p, f)
    closest = Closest(poly)

    def both(x, _):
        squared, face, near = closest(x)
        return np.copysign(squared**0.5, np.einsum("ij,ij->i", x - near, n[face])), n[face]

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


def measure(poly, truth, image, lids=()):
    """Figures of a surface's wall: what lies on the `lids` (end planes that close a true surface) is left out."""
    p, f = triangles(poly)
    ids = poly.GetCellData().GetArray("PatchId")
    if ids is not None:
        f = f[vtk_to_numpy(ids) == WALL]
    x, face = sample(p, f)
    spacing, diagonal = np.array(image.GetSpacing()), float(np.linalg.norm(image.GetSpacing()))
    axes = np.array(image.GetDirection()).reshape(3, 3) @ np.diag(spacing)
    at = (x - np.array(image.GetOrigin())) @ np.linalg.inv(axes).T
    keep = np.all((at > BORDER) & (at < np.array(image.GetSize()) - 1 - BORDER), axis=1)
    for end in lids:
        w = x - np.array(end["center"])
        keep &= (w @ np.array(end["normal"]) < -diagonal) | (np.linalg.norm(w, axis=1) > 1.5 * end["radius"] + diagonal)
    x, face = x[keep], face[keep]
    d, g = truth(x, diagonal)
    d = d / diagonal
    w = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", g, normals_of(p, f)[face]), -1, 1)))
    a = np.abs(d)
    return dict(faces=len(f), median=float(np.median(a)), rms=float(np.sqrt((a**2).mean())), bias=float(d.mean()), p99=float(np.percentile(a, 99)),
                max=float(a.max()), n50=float(np.median(w)), n99=float(np.percentile(w, 99))), (x, d)


def peers(image):
    """Marching cubes and its smoothed surface; seconds and processor seconds of both together, the best of five runs."""
    grid = labels(image)
    seconds, processor = [], []
    for _ in range(5):
        start, used = time.perf_counter(), time.process_time()
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
        processor.append(time.process_time() - used)
    out = {"marching cubes": to_world(cubes.GetOutput(), image), "Taubin": to_world(sinc.GetOutput(), image)}
    return out, (min(seconds), min(processor))


def fit(path, out, rounds):
    """Makes the fit before remeshing; its report, and seconds and processor seconds from cleaned mask to polygonized surface, the best of some runs."""
    reports = []
    for _ in range(rounds):
        run = subprocess.run([str(TOOL), str(path), str(out), "smooth"], capture_output=True, text=True)
        if run.returncode:
            raise SystemExit(f"{path}: {run.stderr}")
        reports.append(json.loads(run.stdout))
    best = [min(r[kind]["fit"] + r[kind]["polygonize"] for r in reports) for kind in ("seconds", "processor_seconds")]
    return reports[0], best


def remeshed(path, out, *settings):
    """The program's own surface with all defaults but `settings`: remeshed at automatic size, ends cut; `None` where it refuses the mask."""
    sets = [x for s in settings for x in ("--set", s)]
    run = subprocess.run([str(PROGRAM), "mesh", str(path), "-o", str(out / "run"), "--stop-after", "surface", "--quiet", *sets], capture_output=True, text=True)
    if run.returncode not in (0, 6):
        print(f"{path}: {run.stderr}", file=sys.stderr)
        return None
    r = vtk.vtkXMLPolyDataReader()
    r.SetFileName(str(out / "run/surface/lumen.vtp"))
    r.Update()
    return r.GetOutput()


def coloured(poly, truth, diagonal):
    p, _ = triangles(poly)
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
        yield "real", name, path, surface_truth(truth), json.loads((truth.parent / f"{name}.json").read_text())["ends"]


PICTURES = ("aneurysm", "ph3_aneurysm_Y_iso", "aneu_a_aniso", "carotid_aniso")


def names_given():
    return any(a != "--resume" for a in sys.argv[2:])


def evaluate(kind, name, path, truth, lids=()):
    image = sitk.ReadImage(str(path))
    report, seconds = fit(path, WORK / name, 3)
    surface = read_stl(WORK / name / "polygonized.stl")
    others, peer_seconds = peers(image)
    meshes = {"fit": surface, **others}
    rows = {n: measure(m, truth, image, lids)[0] for n, m in meshes.items()}
    final = remeshed(path, WORK / name)
    if final:
        rows["remeshed"] = measure(final, truth, image, lids)[0]
    # Thin vessels get more triangles than marching cubes make of them: compared at the number that is allowed, too.
    allowed = MOST_FACES * rows["Taubin"]["faces"]
    if kind == "real" and final and rows["remeshed"]["faces"] > allowed:
        fewer = remeshed(path, WORK / name, f"surface.target_faces={int(0.97 * allowed)}")
        if fewer:
            rows["remeshed, target_faces"] = measure(fewer, truth, image, lids)[0]
    spacing = np.array(image.GetSpacing())
    if name in PICTURES and not names_given():
        picture([(n, coloured(m, truth, float(np.linalg.norm(spacing)))) for n, m in meshes.items()], RESULTS / f"{name}.png", (-0.3, 0.3))
    t = report["topology"]
    print(name, {k: round(v, 4) for k, v in rows["fit"].items()}, f"processor {seconds[1]:.2f} s, peer {peer_seconds[1]:.3f} s", flush=True)
    return dict(kind=kind, name=name, rows=rows, seconds=seconds, peer=peer_seconds, anisotropic=bool(spacing.max() > 1.5 * spacing.min()),
                chi=(2 * t["mask"]["euler"], t["surface"]["euler"]), parts=(t["mask"]["components"], t["surface"]["components"]),
                volume=report["volume"] / report["mask_volume"], boundary=report["boundary_voxels"], voxels=report["voxels"], memory=report["peak_memory_bytes"])


def growth():
    """Time and memory of the aneurysm phantom repeated until it has a million boundary voxels."""
    image = sitk.ReadImage(str(WORK / "phantoms/aneurysm/mask.nrrd"))
    array = sitk.GetArrayFromImage(image)
    found = []
    for times in ((1, 1, 2), (2, 2, 4), (4, 5, 8)):
        many = sitk.GetImageFromArray(np.tile(array[5:], times))
        many.SetSpacing(image.GetSpacing())
        path = WORK / "many.nrrd"
        sitk.WriteImage(many, str(path))
        report, (_, cpu) = fit(path, WORK / "many", 1)
        found.append((int(np.prod(times)), report, cpu))
        print(found[-1][0], report["boundary_voxels"], f"{cpu:.2f} s", flush=True)
    return found


def table(found, title, note):
    lines = ["", f"## {title}", "", note, "", "| case | surface | faces | median | rms | bias | 99 % | max | normals 50 % | 99 % | limits |", "|---|---|---|---|---|---|---|---|---|---|---|"]
    for c in found:
        for n, r in c["rows"].items():
            missed = ""
            if n == "fit" and c["kind"] != "real":
                a, b = NORMALS[bool(c["anisotropic"])]
                bad = [k for k, v in LIMITS.items() if abs(r[k]) > v] + [k for k, v in (("normals 50 %", a), ("normals 99 %", b)) if r[k.replace("normals ", "n").replace(" %", "")] > v]
                missed = "missed: " + ", ".join(bad) if bad else "met"
            elif n == "remeshed" and c["kind"] != "real":
                bad = [k for k, v in REMESHED.items() if abs(r[k]) > v]
                missed = "missed: " + ", ".join(bad) if bad else "met"
            elif n == "fit" or n.startswith("remeshed"):
                worse = [f"{k} ({o})" for o in ("marching cubes", "Taubin") for k in ("median", "rms", "p99", "max", "n50", "n99") if r[k] > c["rows"][o][k]]
                if n.startswith("remeshed") and r["faces"] > MOST_FACES * c["rows"]["Taubin"]["faces"]:
                    worse.append("triangles")
                missed = "worse: " + ", ".join(worse) if worse else "better throughout"
            lines.append(f"| {c['name'] if n == 'fit' else ''} | {n} | {r['faces']} | {r['median']:.3f} | {r['rms']:.3f} | {r['bias']:+.3f} | {r['p99']:.3f} | {r['max']:.3f} | {r['n50']:.1f}° | {r['n99']:.1f}° | {missed} |")
    return lines


def write(found, grown):
    lines = [
        "# Accuracy of the reconstructed wall",
        "",
        "Made by `validation/accuracy/run.sh`. Distances to the true wall in voxel diagonals (bias: positive outwards), angles between",
        f"the triangles' normals and the true wall's; {SAMPLES} random points of each wall, {BORDER:.0f} voxels from the picture's border. `fit` is the",
        "default reconstruction polygonized at half a voxel, before remeshing; `remeshed` the surface of `lumenmesh mesh` with all defaults, its",
        "ends cut, the wall alone.",
    ]
    limits = "Limits for `fit`: median ≤ 0.03, rms ≤ 0.05, |bias| ≤ 0.01, 99 % ≤ 0.15, max ≤ 0.45; normals ≤ 3.5° and 15° (anisotropic voxels: 5° and 20°). For `remeshed`: |bias| ≤ 0.015, normals ≤ 5°."
    lines += table([c for c in found if c["kind"] == "built-in"], "Built-in phantoms", limits)
    if any(c["kind"] == "phantom" for c in found):
        lines += table([c for c in found if c["kind"] == "phantom"], "Shared phantoms", limits)
    if any(c["kind"] == "real" for c in found):
        lines += table([c for c in found if c["kind"] == "real"], "Real vessels, against the surfaces that the masks were made from", "`fit` and `remeshed` should be better than marching cubes and Taubin smoothing in each figure, `remeshed` with at most 1.5 times their triangles (where the automatic size takes more, `surface.target_faces` asks for that many in a row of its own). The lids that close the true surfaces at their ends are no wall and are left out.")
    notes = RESULTS / "notes.md"
    if notes.exists():
        lines += ["", notes.read_text().strip()]
    random = RESULTS / "random.md"
    if random.exists():
        lines += ["", "## Pictures at random", "", "`cargo run --release --example random_phantoms`: the same phantoms with voxel size, offset and direction of the grid drawn at random, mean of three", f"pictures a row (seed {SEED[1]}); the limits are those above.", "", random.read_text().strip()]
    lines += ["", "## Topology, volume, time and memory", "",
              "From cleaned mask to polygonized surface beside vtkFlyingEdges3D and vtkWindowedSincPolyDataFilter in the same run: seconds and processor", "seconds (of all threads), the best of three and of five runs.", "",
              "| case | 2 χ(mask), χ(surface) | parts | volume / mask | boundary voxels | seconds | VTK | ratio | processor | VTK | ratio | µs a boundary voxel | peak MB | bytes a boundary voxel | bytes a voxel |", "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"]
    for c in found:
        memory, (s, cpu), (peer, peer_cpu) = c["memory"] or 0, c["seconds"], c["peer"]
        lines.append(f"| {c['name']} | {c['chi'][0]}, {c['chi'][1]} | {c['parts'][0]}, {c['parts'][1]} | {c['volume']:.4f} | {c['boundary']} | {s:.2f} | {peer:.3f} | {s / peer:.0f} | {cpu:.2f} | {peer_cpu:.3f} | {cpu / peer_cpu:.0f} | {1e6 * cpu / c['boundary']:.1f} | {memory / 1e6:.0f} | {memory / c['boundary']:.0f} | {memory / c['voxels']:.0f} |")
    lines += ["", "Growth: the aneurysm phantom many times side by side.", "", "| pictures | boundary voxels | voxels | processor µs a boundary voxel | peak MB | bytes a boundary voxel | bytes a voxel |", "|---|---|---|---|---|---|---|"]
    for n, r, cpu in grown:
        lines.append(f"| {n} | {r['boundary_voxels']} | {r['voxels']} | {1e6 * cpu / r['boundary_voxels']:.1f} | {r['peak_memory_bytes'] / 1e6:.0f} | {r['peak_memory_bytes'] / r['boundary_voxels']:.0f} | {r['peak_memory_bytes'] / r['voxels']:.1f} |")
    for name in PICTURES:
        if (RESULTS / f"{name}.png").exists():
            lines += ["", f"![Signed distance of {name} to the true wall: the fit, marching cubes, Taubin smoothing]({name}.png)"]
    (RESULTS / "README.md").write_text("\n".join(lines) + "\n")


def main():
    vtk.vtkObject.GlobalWarningDisplayOff()
    RESULTS.mkdir(parents=True, exist_ok=True)
    WORK.mkdir(parents=True, exist_ok=True)
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT.parent / "shared/data"
    names = [a for a in sys.argv[2:] if a != "--resume"]
    found = []
    for case in cases(data):
        kept = WORK / case[1] / "figures.json"
        if names and case[1] not in names:
            continue
        if "--resume" in sys.argv and kept.exists():
            found.append(json.loads(kept.read_text()))
        else:
            found.append(evaluate(*case))
            kept.write_text(json.dumps(found[-1]))
        if not names:
            write(found, [])
    if names:
        print("\n".join(table([c for c in found if c["kind"] == "real"], "Real", "") + table([c for c in found if c["kind"] != "real"], "Phantoms", "")))
        return
    grown = growth()
    write(found, grown)
    random = subprocess.run([str(RANDOM), *SEED], capture_output=True, text=True, check=True).stdout
    (RESULTS / "random.md").write_text(random)
    write(found, grown)
    print(RESULTS / "README.md")


if __name__ == "__main__":
    main()
