#!/usr/bin/env python3
"""Every export of many masks through somebody else's reader: one table row a mask.

    validation/exports/run.sh [--only NAME] [--set KEY=VALUE]... [MASK...]

Without masks: every built-in phantom, and the masks in ../shared/data where that folder is present. `lumenmesh mesh` with
all exports; then VTK, meshio and Gmsh (tests/read_exports.py; Gmsh where its package is installed), OpenFOAM's two converters of FLUENT meshes with checkMesh
and the names of the patches, checkMesh on the OpenFOAM case, and `lumenmesh check` on VTU, FLUENT mesh and OpenFOAM case.
Exit code 1 if a reader says no.
"""
import argparse, json, os, re, shutil, subprocess, sys, time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import masks

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = Path(os.environ.get("LUMENMESH", ROOT / "target/release/lumenmesh")).resolve()
WORK = ROOT / "target/validation/exports"
RESULTS = ROOT / "validation/results/exports"
DATA = ROOT.parent / "shared/data"
ENVIRONMENT = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ}
EXPORTS = "exports=[vtk, stl, ply, openfoam, fluent, gmsh, simvascular, vmtk]"


def foam(folder, *command):
    done = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    return done.returncode, done.stdout + done.stderr


def mesh_ok(folder, code, log, names):
    """What checkMesh and the boundary file say."""
    if code:
        return "failed: " + log.strip().splitlines()[-1][:80]
    boundary = (folder / "constant/polyMesh/boundary").read_text().split()
    lost = [n for n in names if n not in boundary]
    if lost:
        return "names lost: " + ", ".join(lost)
    _, log = foam(folder, "checkMesh", "-allGeometry", "-allTopology")
    return "OK" if "Mesh OK" in log else "; ".join(l.strip(" *") for l in log.splitlines() if "***" in l)[:100]


def row(name, mask, extra, sets):
    out = WORK / name.replace(", ", "_").replace(" ", "")
    shutil.rmtree(out, ignore_errors=True)
    command = [PROGRAM, "mesh", mask, "-o", out, "--quiet", "--set", EXPORTS, *extra]
    for s in sets:
        command += ["--set", s]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode not in (0, 6):
        return False, f"| {name} | | | | | | | | | code {done.returncode}: {done.stderr.strip().splitlines()[0][:120]} |"
    report = json.loads((out / "report.json").read_text())
    names = ["wall", *(o["name"] for o in report["openings"])]
    seconds = {s["name"]: s["seconds"] for s in report["run"]["stages"]}
    read = subprocess.run([sys.executable, ROOT / "tests/read_exports.py", out], capture_output=True, text=True)
    readers = "agree" if read.returncode == 0 else "no: " + (read.stderr.strip().splitlines() or ["?"])[-1][:100]
    case = out / "openfoam"
    said = [readers, mesh_ok(case, 0, "", names)]
    for tool in ("fluentMeshToFoam", "fluent3DMeshToFoam"):
        folder = WORK / "converted"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(case / "system", folder / "system")
        said.append(mesh_ok(folder, *foam(folder, tool, out / "fluent/lumen.msh"), names))
    codes = [subprocess.run([PROGRAM, "check", out / p], capture_output=True).returncode for p in ("volume/lumen.vtu", "fluent/lumen.msh", "gmsh/lumen.msh", "openfoam")]
    said.append("met" if not any(codes) else f"codes {codes}")
    good = said == ["agree", "OK", "OK", "OK", "met"]
    v = report["volume"]
    line = f"| {name} | {v['tets']} | {v['prisms']} | " + " | ".join(said) + f" | {seconds['write']:.2f} | {seconds['volume']:.2f} |"
    shutil.rmtree(out, ignore_errors=True)
    return good, line


def save(lines, sets):
    """The page so far, with the notes that stand beside it: a run that is stopped keeps it."""
    head = f"# Exports through other people's readers\nMade by `validation/exports/run.sh`, settings: {', '.join(sets) or 'all defaults'}, all exports. " \
           "VTP, VTU, STL, PLY and SimVascular's folder\nread by VTK, Gmsh's file by meshio; OpenFOAM's two converters of FLUENT meshes with the patches' names and checkMesh -allGeometry\n" \
           "-allTopology; `lumenmesh check` on VTU, FLUENT, Gmsh and OpenFOAM files.\n\n"
    notes = RESULTS / "notes.md"
    (RESULTS / "README.md").write_text(head + "\n".join(lines) + "\n\n" + (notes.read_text() if notes.exists() else ""))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="cases whose name contains this")
    parser.add_argument("--set", action="append", default=[], help="as for lumenmesh")
    parser.add_argument("masks", nargs="*", type=Path)
    a = parser.parse_args()
    WORK.mkdir(parents=True, exist_ok=True)
    RESULTS.mkdir(parents=True, exist_ok=True)
    closed = ("sphere", "torus")
    cases = [(m.name.split(".")[0], m, []) for m in a.masks] or [*masks.built_in(PROGRAM, WORK), *masks.shared(DATA)]
    cases = [c for c in cases if not c[0].startswith(closed) and (not a.only or a.only in c[0])]
    lines = ["| case | tets | prisms | VTK, meshio, Gmsh | OpenFOAM case | fluentMeshToFoam | fluent3DMeshToFoam | lumenmesh check | writing all (s) | filling and optimising (s) |", "|-|-|-|-|-|-|-|-|-|-|"]
    bad = 0
    for case in cases:
        good, line = row(*case, a.set)
        bad += not good
        lines.append(line)
        print(line, flush=True)
        save(lines, a.set)
    sys.exit(bad > 0)


main()
