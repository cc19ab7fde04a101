#!/usr/bin/env python3
"""Every case at two sizes, with and without prism layers, by the program as it is delivered; one table row a mesh.

    validation/volume/matrix.sh [--only NAME] [--scale FACTOR]... [--layers N]... [--redo] [MASK...]

Without masks: every built-in phantom, and the masks in ../shared/data where that folder is present. Runs
`lumenmesh mesh`, reads report.json, runs checkMesh -allGeometry -allTopology on the OpenFOAM case that was written
where checkMesh is installed. A row is kept as soon as it is there (validation/results/volume/matrix.jsonl); rows of
the same program are not made again without --redo. Writes validation/results/volume/matrix.md. Exit code 1 if a row
misses a figure.
"""
import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import masks
from foam import check_mesh

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = Path(os.environ.get("LUMENMESH", ROOT / "target/release/lumenmesh"))
WORK = ROOT / "target/validation/matrix"
OUT = ROOT / "validation/results/volume"
DATA = ROOT.parent / "shared/data"
# A tree of hundreds of ends, a job of its own: named, it is run.
LEFT_OUT = ("airway",)
LIMIT = 1800


def run(name, mask, extra, scale, layers):
    out = WORK / "out"
    shutil.rmtree(out, ignore_errors=True)
    command = [PROGRAM, "mesh", mask, "-o", out, "--quiet", "--set", "exports=[openfoam]", *extra]
    if scale != 1:
        command += ["--set", f"surface.scale={scale}"]
    if layers:
        command += ["--set", f"volume.boundary_layers.count={layers}"]
    row = {"case": name, "scale": scale, "layers": layers}
    begin = time.perf_counter()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
        row["code"], words = done.returncode, done.stderr.strip().splitlines()
    except subprocess.TimeoutExpired:
        row["code"], words = -1, [f"not finished within {LIMIT} s"]
    row["seconds"] = time.perf_counter() - begin
    if row["code"] not in (0, 6):
        row["error"] = words[0][:200] if words else ""
        return row
    return row | figures(out)


def figures(out):
    """What a finished run says of its volume mesh, and checkMesh."""
    r = json.loads((out / "report.json").read_text())
    v = r["volume"]
    build = v["build"]
    row = {
        "faces": r["surface"]["faces"], "s_max": r["surface"]["s_max"], "tets": v["tets"], "prisms": v["prisms"],
        "sv_max": v["sv_max"], "sv_mean": v["sv_mean"], "inverted": v["nonpositive_cells"],
        "dihedral": [v["min_dihedral"], v["max_dihedral"]], "orthogonal_quality": v["orthogonal_quality"],
        "non_orthogonality": v["non_orthogonality"], "determinant": v["openfoam"]["determinant_min"],
        "size_ratio": build["fill"]["size_ratio"], "estimated": build["fill"]["estimated_cells"],
        "attempts": len(build["fill"]["attempts"]),
        "hard_missed": [g["name"] for g in r["gates"] if g["hard"] and not g["passed"]],
        "boundary_ok": all(g["passed"] for g in r["gates"] if "boundary faces" in g["name"]),
        "optimiser_over_tetgen": build["optimise"]["seconds"] / max(sum(a["seconds"] for a in build["fill"]["attempts"]), 1e-9)
        if build["optimise"] and "seconds" in build["optimise"] else None,
    }
    if build["layers"]:
        row |= {"full": build["layers"]["area_at_full_thickness"], "inner_s": build["layers"]["inner_skewness"],
                "prism_s": build["layers"]["prism_skewness"]}
    row["checkmesh"], row["checkmesh_non_orthogonality"] = check_mesh(out / "openfoam")
    return row


def missed(r):
    """The figures of the row that miss."""
    if r["code"] not in (0, 6):
        return [f"code {r['code']}: {r['error']}"]
    out = [f"hard gate: {g}" for g in r["hard_missed"]]
    aim = 0.85 if r["layers"] else 0.80
    for text, bad in [
        (f"S_V {r['sv_max']:.3f}", r["sv_max"] > aim),
        (f"mean {r['sv_mean']:.3f}", r["sv_mean"] > 0.28),
        (f"{r['inverted']} inverted", r["inverted"] > 0),
        (f"dihedral {r['dihedral'][0]:.1f}", r["dihedral"][0] < 15),
        (f"dihedral {r['dihedral'][1]:.1f}", r["dihedral"][1] > 155),
        (f"orthogonal quality {r['orthogonal_quality']:.3f}", r["orthogonal_quality"] < 0.15),
        (f"non-orthogonality {r['non_orthogonality']:.1f}", r["non_orthogonality"] > 65),
        ("boundary faces", not r["boundary_ok"]),
        (f"inner S {r.get('inner_s', 0):.3f}", r.get("inner_s", 0) > 0.6),
        (f"checkMesh: {r['checkmesh']}", r["checkmesh"] not in ("Mesh OK", None)),
        (f"layers full on {100 * r.get('full', 1):.0f} %", "aneu" in r["case"] and r.get("full", 1) < 0.9),
    ]:
        if bad:
            out.append(text)
    return out


HEAD = ("| case | scale | layers | faces | tets | prisms | S_V max | mean | inverted | dihedral | OQ min | non-orth | det min "
        "| inner S | wall at ≥ 95 % thickness | checkMesh | s | build | missed |")


def line(r):
    head = f"| {r['case']} | {r['scale']} | {r['layers']} "
    if r["code"] not in (0, 6):
        return head + "| " * 13 + f"| {r['seconds']:.0f} | {r['program'][:4]} | {'; '.join(missed(r))} |"
    inner = f"{r['inner_s']:.3f} | {100 * r['full']:.1f} %" if "full" in r else " | "
    return head + (
        f"| {r['faces']} | {r['tets']} | {r['prisms']} | {r['sv_max']:.3f} | {r['sv_mean']:.3f} | {r['inverted']} "
        f"| {r['dihedral'][0]:.1f}–{r['dihedral'][1]:.1f}° | {r['orthogonal_quality']:.3f} | {r['non_orthogonality']:.1f}° "
        f"| {r['determinant']:.4f} | {inner} | {(r['checkmesh'] or 'not run')[:80]} | {r['seconds']:.0f} | {r['program'][:4]} | {'; '.join(missed(r))} |"
    )


def page(rows):
    version = subprocess.run([PROGRAM, "--version"], capture_output=True, text=True).stdout.strip()
    good = [r for r in rows if r["code"] in (0, 6)]
    text = ["# Volume meshes of every case at two sizes, with and without prism layers", ""]
    text += [f"Made by `validation/volume/matrix.sh` with {version}: `lumenmesh mesh` with all defaults but `surface.scale` and",
             "`volume.boundary_layers.count`; checkMesh is OpenFOAM's own, with -allGeometry -allTopology, on the case as written.",
             "Seconds are of a shared two-core machine. Limits: S_V ≤ 0.80 (0.85 with prisms), mean ≤ 0.28, none inverted, dihedral",
             "angles within 15°–155°, orthogonal quality ≥ 0.15, non-orthogonality ≤ 65°, inner surface S ≤ 0.6, aneurysms ≥ 95 % of",
             "the wished thickness on 90 % of the wall. The last column names what misses.", ""]
    bad = [r for r in rows if missed(r)]
    builds = sorted({r["program"][:4] for r in rows})
    if len(builds) > 1:
        text += [f"Rows of {len(builds)} builds (column `build`): run the script anew for a table of one.", ""]
    text += [f"{len(rows)} meshes, {len(rows) - len(bad)} meet everything.", ""]
    if good:
        low, high = min(r["size_ratio"][0] for r in good), max(r["size_ratio"][2] for r in good)
        plain = [r["tets"] / r["estimated"] for r in good if r["estimated"]]
        text += [f"Interior edges over wished ones, 5th to 95th percentile, worst mesh: {low:.2f} to {high:.2f} (limit 1/1.5 to 1.5). "
                 f"Tetrahedra over those expected before the work: {min(plain):.2f} to {max(plain):.2f}.", ""]
    text += [HEAD, "|-" * (HEAD.count("|") - 1) + "|", *map(line, rows), ""]
    return "\n".join(text)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="cases whose name contains this")
    parser.add_argument("--scale", action="append", type=float, help="factors on the edge length; 1 and 1.6 by default")
    parser.add_argument("--layers", action="append", type=int, help="numbers of prism layers; 0 and 4 by default")
    parser.add_argument("--redo", action="store_true", help="make rows anew that are there already")
    parser.add_argument("masks", nargs="*", type=Path)
    a = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    WORK.mkdir(parents=True, exist_ok=True)
    kept = OUT / "matrix.jsonl"
    program = hashlib.sha256(PROGRAM.read_bytes()).hexdigest()[:12]
    rows = {}
    if kept.exists():
        for r in map(json.loads, kept.read_text().splitlines()):
            rows[r["case"], r["scale"], r["layers"]] = r
    cases = [(m.name.split(".")[0], m, []) for m in a.masks] or [*masks.built_in(PROGRAM, WORK), *masks.shared(DATA, LEFT_OUT)]
    for name, mask, extra in cases:
        if a.only and a.only not in name:
            continue
        for scale in a.scale or [1.0, 1.6]:
            for layers in a.layers if a.layers is not None else [0, 4]:
                key = (name, scale, layers)
                if not a.redo and rows.get(key, {}).get("program") == program:
                    continue
                rows[key] = run(name, mask, extra, scale, layers) | {"program": program}
                print(line(rows[key]), flush=True)
                kept.write_text("".join(json.dumps(r) + "\n" for r in rows.values()))
                (OUT / "matrix.md").write_text(page(list(rows.values())))
    shutil.rmtree(WORK / "out", ignore_errors=True)
    return 1 if any(missed(r) for r in rows.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
