#!/usr/bin/env python3
"""Inputs other than a clean mask: open surfaces, probability maps, noisy masks, each by the whole program.

    validation/accuracy/inputs.py [DATA]

Needs the built program, numpy, SimpleITK and VTK (run.sh makes an environment that has them). Writes
validation/results/accuracy/inputs.md, row by row.
"""
import json, subprocess, sys
from pathlib import Path

import numpy as np
import SimpleITK as sitk
import vtk

import run
from run import PROGRAM, RESULTS, ROOT, WORK, Closest, cases, measure, normals_of, peers, triangles

HERE = WORK / "inputs"


def opened(path, ends, out):
    """A closed surface cut flat 0.8 radii inside each of its ends, without lids; the number of its faces."""
    poly = run.read_stl(path)
    for e in ends:
        c, n = np.array(e["center"], float), np.array(e["normal"], float)
        ball, plane, both = vtk.vtkSphere(), vtk.vtkPlane(), vtk.vtkImplicitBoolean()
        ball.SetCenter(*c)
        ball.SetRadius(2.2 * e["radius"])
        plane.SetOrigin(*(c - 0.8 * e["radius"] * n))
        plane.SetNormal(*(-n))
        both.SetOperationTypeToIntersection()
        both.AddFunction(ball)
        both.AddFunction(plane)
        clip = vtk.vtkClipPolyData()
        clip.SetInputData(poly)
        clip.SetClipFunction(both)
        clip.Update()
        poly = clip.GetOutput()
    part = vtk.vtkPolyDataConnectivityFilter()
    part.SetInputData(poly)
    part.SetExtractionModeToLargestRegion()
    clean = vtk.vtkCleanPolyData()
    clean.SetInputConnection(part.GetOutputPort())
    writer = vtk.vtkSTLWriter()
    writer.SetFileTypeToBinary()
    writer.SetFileName(str(out))
    writer.SetInputConnection(clean.GetOutputPort())
    writer.Write()
    return run.read_stl(out)


def program(case, out):
    """Runs a case file to the surface; exit code, report and the surface."""
    file = HERE / f"{out.name}.yaml"
    file.write_text(json.dumps(case))
    done = subprocess.run([str(PROGRAM), "run", str(file), "-o", str(out), "--stop-after", "surface", "--quiet"], capture_output=True, text=True)
    if done.returncode not in (0, 6):
        return done.returncode, None, done.stderr.strip().splitlines()[-1]
    r = vtk.vtkXMLPolyDataReader()
    r.SetFileName(str(out / "surface/lumen.vtp"))
    r.Update()
    return done.returncode, json.loads((out / "report.json").read_text()), r.GetOutput()


def row(name, what, code, report, surface, truth, image):
    if report is None:
        return f"| {name} | {what} | exit {code} | | | | | | | | {surface} |"
    r = measure(surface, truth, image)[0]
    missed = [g["name"] for g in report["gates"] if not g["passed"]]
    t = report["fidelity"]["topology"]
    same = "as the mask's" if t["surface"]["euler"] == 2 * t["mask"]["euler"] else f"{t['surface']['euler']} for {2 * t['mask']['euler']}"
    return (f"| {name} | {what} | exit {code} | {len(report['openings'])} | {same} | {r['median']:.3f} | {r['rms']:.3f} | {r['bias']:+.3f} | {r['max']:.3f} | {r['n50']:.1f}° / {r['n99']:.1f}° | "
            + (", ".join(missed) or "met") + " |")


def noisy(image, share, seed):
    """The mask with a share of the voxels at its boundary flipped, and one in 2000 of those inside emptied."""
    rng = np.random.default_rng(seed)
    a = sitk.GetArrayFromImage(image) != 0
    box = sitk.GetImageFromArray(a.astype(np.uint8))
    near = (sitk.GetArrayFromImage(sitk.BinaryDilate(box, [1, 1, 1], sitk.sitkCross)) != 0) & ~(sitk.GetArrayFromImage(sitk.BinaryErode(box, [1, 1, 1], sitk.sitkCross)) != 0)
    b = a ^ (near & (rng.random(a.shape) < share)) ^ (a & ~near & (rng.random(a.shape) < 1 / 2000))
    out = sitk.GetImageFromArray(b.astype(np.uint8))
    out.CopyInformation(image)
    return out


def blobs(image, share, seed):
    """The mask with balls of 2 to 3 voxels across flipped at its boundary, a share of whose voxels they hold."""
    rng = np.random.default_rng(seed)
    a = sitk.GetArrayFromImage(image) != 0
    box = sitk.GetImageFromArray(a.astype(np.uint8))
    near = (sitk.GetArrayFromImage(sitk.BinaryDilate(box, [1, 1, 1], sitk.sitkCross)) != 0) & ~(sitk.GetArrayFromImage(sitk.BinaryErode(box, [1, 1, 1], sitk.sitkCross)) != 0)
    places = rng.permutation(np.argwhere(near))
    # A ball takes the label that its middle has not: about as many dents as bumps.
    b, at = a.copy(), 0
    while (b != a)[near].sum() < share * near.sum():
        middle, r = places[at], rng.uniform(1.0, 1.5)
        low = np.maximum(middle - 2, 0)
        cut = tuple(slice(l, m + 3) for l, m in zip(low, middle))
        z, y, x = np.ogrid[cut]
        ball = (z - middle[0]) ** 2 + (y - middle[1]) ** 2 + (x - middle[2]) ** 2 <= r * r
        b[cut][ball[: b[cut].shape[0], : b[cut].shape[1], : b[cut].shape[2]]] = ~a[tuple(middle)]
        at += 1
    out = sitk.GetImageFromArray(b.astype(np.uint8))
    out.CopyInformation(image)
    return out


def main():
    vtk.vtkObject.GlobalWarningDisplayOff()
    HERE.mkdir(parents=True, exist_ok=True)
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT.parent / "shared/data"
    lines = [
        "# Inputs other than a clean mask",
        "",
        "Made by `validation/accuracy/inputs.py`: the whole program to its surface, all defaults. Distances of the wall to the true wall in voxel",
        "diagonals, normals' angles in degrees (median / 99 %). Open surfaces are the true surfaces cut flat inside each end, without lids; their unit is",
        "the voxel of the mask made from them. Probability maps are 1/(1 + exp(2d)), d the true distance in voxels, rounded to 1/255. Noisy masks",
        "have a share of the voxels at their boundary flipped at random, and one in 2000 of those inside emptied; the second row of each is Taubin's",
        "smoothing of marching cubes of the same mask. Balls of 2 to 3 voxels are flipped whole, as a segmentation errs, until they hold that share.",
        "",
        "| case | input | exit | ends | Euler number | median | rms | bias | max | normals | gates |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]

    def add(line):
        lines.append(line)
        print(line, flush=True)
        (RESULTS / "inputs.md").write_text("\n".join(lines) + "\n")

    for kind, name, path, truth, *lids in cases(data):
        image = sitk.ReadImage(str(path))
        if kind == "real" and name in ("aneu_b_iso", "carotid_aniso", "coronary_thin"):
            import gzip

            whole = HERE / f"{name}.stl"
            whole.write_bytes(gzip.open(data / "truth" / f"{name}.stl.gz").read())
            cut = opened(whole, lids[0], HERE / f"{name}-open.stl")
            points, faces = triangles(cut)
            normals, closest = normals_of(points, faces), Closest(cut)

            def exact(x, _):
                squared, face, near = closest(x)
                return np.copysign(squared**0.5, np.einsum("ij,ij->i", x - near, normals[face])), normals[face]

            code, report, surface = program({"input": {"surface": str(HERE / f"{name}-open.stl")}}, HERE / f"{name}-open")
            add(row(name, f"surface, {len(lids[0])} open ends", code, report, surface, exact, image))
        if name in ("aneurysm", "bifurcation-anisotropic", "thin", "ph3_aneurysm_Y_iso"):
            size = image.GetSize()
            grid = np.stack(np.meshgrid(*[np.arange(n) for n in size], indexing="ij"), -1).reshape(-1, 3).astype(float)
            axes = np.array(image.GetDirection()).reshape(3, 3) @ np.diag(image.GetSpacing())
            d = truth(grid @ axes.T + np.array(image.GetOrigin()), min(image.GetSpacing()))[0] / min(image.GetSpacing())
            p = np.round(255 / (1 + np.exp(np.clip(2 * d, -50, 50)))) / 255
            level = sitk.GetImageFromArray(p.reshape(size).transpose(2, 1, 0).astype(np.float32))
            level.CopyInformation(image)
            sitk.WriteImage(level, str(HERE / f"{name}-map.nrrd"))
            code, report, surface = program({"input": {"probability": str(HERE / f"{name}-map.nrrd"), "isovalue": 0.5}}, HERE / f"{name}-map")
            add(row(name, "probability map", code, report, surface, truth, image))
        if name in ("aneurysm", "bifurcation-anisotropic", "tree"):
            for share, made, kind_of in ((0.05, noisy, "flipped"), (0.15, noisy, "flipped"), (0.05, blobs, "flipped in balls of 2 to 3 voxels")):
                noise = made(image, share, 5)
                sitk.WriteImage(noise, str(HERE / f"{name}-noise.nrrd"))
                code, report, surface = program({"input": {"mask": str(HERE / f"{name}-noise.nrrd")}}, HERE / f"{name}-noise")
                what = f"mask, {share:.0%} of its boundary {kind_of}"
                if report:
                    what += ": " + ", ".join(f"{t['changes']} {t['kind'].replace('_', ' ')}" for t in report["cleaning"]["totals"])
                add(row(name, what, code, report, surface, truth, image))
                r = measure(peers(noise)[0]["Taubin"], truth, image)[0]
                add(f"| | Taubin | | | | {r['median']:.3f} | {r['rms']:.3f} | {r['bias']:+.3f} | {r['max']:.3f} | {r['n50']:.1f}° / {r['n99']:.1f}° | |")


if __name__ == "__main__":
    main()
