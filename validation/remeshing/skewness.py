#!/usr/bin/env python3
"""Holds the surface of every case against the bounds on shape, at several edge lengths.

    validation/remeshing/skewness.py [--scales 1,0.5,2] [--remesher isotropic] [--table FILE] [MASK|PHANTOM ...]

Without names: all built-in phantoms and all masks of ../shared/data. Runs `lumenmesh mesh --stop-after surface` and
reads report.json. A bound that does not hold is set in **bold**. Needs Python alone and a release build (or a program
named by LUMENMESH).
"""
import argparse, json, os, shutil, subprocess, sys, time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "../shared/data"
WORK = ROOT / "target/validation/skewness"
PROGRAM = Path(os.environ.get("LUMENMESH", ROOT / "target/release/lumenmesh"))


def everything():
    names = subprocess.run([PROGRAM, "phantom", "list"], capture_output=True, text=True, check=True).stdout.split()
    masks = [p for p in DATA.glob("*") if p.name.endswith((".nrrd", ".mha", ".nii.gz"))]
    masks += [p for p in (DATA / "phantoms").glob("*") if p.name.endswith((".nrrd", ".nii.gz"))]
    # The small ones first.
    masks.sort(key=lambda p: p.stat().st_size)
    if not masks:
        print("skipped: the masks of ../shared/data are not there", file=sys.stderr)
    # Of several labels which are lumen has to be said: all, or one.
    whole = [f"{p}@input.label=[1, 2, 4]" if "multilabel" in p.name else str(p) for p in masks]
    single = [f"{p}@input.label={n}" for p in masks if "multilabel" in p.name for n in (1, 2)]
    return names + whole + single


def mask_of(name):
    """The mask that a name on the command line stands for, and the settings that go with it (FILE@key.path=value)."""
    if "@" in name:
        path, setting = name.split("@")
        return Path(path), [setting]
    if not Path(name).exists():
        folder = WORK / "phantoms" / name
        if not (folder / "mask.nrrd").exists():
            folder.mkdir(parents=True, exist_ok=True)
            subprocess.run([PROGRAM, "phantom", name, "-o", folder], check=True, capture_output=True)
        return folder / "mask.nrrd", []
    return Path(name), []


def figures(report):
    """The figures of a report that have a bound."""
    s = report["surface"]
    wall = [p for p in s["patches"] if p["id"] == 1]
    caps = [p for p in s["patches"] if p["id"] != 1]
    gates = {g["name"]: g for g in report["gates"]}
    euler = next(g for n, g in gates.items() if n.startswith("Euler"))
    field = report["remeshing"]["guidance_field"]
    sizes = [field] if isinstance(field, dict) else field
    graded = any(f["max"] > 1.2 * f["min"] for f in sizes)
    return {
        "faces": s["faces"],
        "wall": max(p["s_max"] for p in wall),
        "caps": max([p["s_max"] for p in caps], default=0.0),
        "mean": s["s_mean"],
        "graded": graded,
        "wall_ratio": s["wall_area_ratio"]["p99"],
        "cap_ratio": s["cap_area_ratio"]["p99"],
        "off": report["remeshing"].get("off_implicit", {}).get("max_voxels"),
        "crossings": s["self_intersections"],
        "topology": euler["passed"],
        "front": s.get("front_fraction"),
        "remesh": sum(x["seconds"] for x in report["run"]["stages"] if x["name"] in ("guidance field", "remesh", "openings")),
    }


def row(label, scale, f):
    def held(value, limit, text):
        return text if value <= limit else f"**{text}**"
    off = "" if f["off"] is None else held(f["off"], 1e-6, f"{f['off']:.0e}")
    return (
        f"| {label} | {scale:g} | {f['faces']} | {held(f['wall'], 0.4505, '%.3f' % f['wall'])} | {held(f['caps'], 0.5005, '%.3f' % f['caps'])} "
        f"| {held(f['mean'], 0.12 if f['graded'] else 0.10, '%.3f' % f['mean'])} | {held(f['wall_ratio'], 1.7, '%.2f' % f['wall_ratio'])} "
        f"| {held(f['cap_ratio'], 1.7, '%.2f' % f['cap_ratio'])} | {off} | {held(f['crossings'], 0, str(f['crossings']))} "
        f"| {'same' if f['topology'] else '**changed**'} | {f['remesh']:.1f} |"
    )


HEAD = """| case | size | faces | S max wall | S max caps | S mean | area ratio wall | caps | off the implicit (voxels) | self-intersections | topology | seconds |
|-|-|-|-|-|-|-|-|-|-|-|-|"""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--scales", default="1,0.5,2")
    parser.add_argument("--remesher", default="auto")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--table", help="file to write the table to")
    parser.add_argument("--timeout", type=float, default=1800)
    options = parser.parse_args()
    lines = [HEAD]
    print(HEAD, flush=True)
    for name in options.names or everything():
        mask, settings = mask_of(name)
        label = Path(name.split("@")[0]).name.split(".")[0] + (" " + name.split("@")[1] if "@" in name else "")
        for scale in map(float, options.scales.split(",")):
            out = WORK / f"{label.replace(' ', '-')}-{scale:g}-{options.remesher}"
            sets = [f"surface.scale={scale}", f"surface.remesher={options.remesher}", *settings, *options.set]
            command = [PROGRAM, "mesh", mask, "-o", out, "--stop-after", "surface", "--quiet"]
            for s in sets:
                command += ["--set", s]
            shutil.rmtree(out, ignore_errors=True)
            try:
                done = subprocess.run(command, capture_output=True, text=True, timeout=options.timeout)
                said = done.stderr.strip().replace("\n", " ")
            except subprocess.TimeoutExpired:
                said = f"not finished within {options.timeout:g} s"
            if (out / "report.json").exists():
                line = row(label, scale, figures(json.loads((out / "report.json").read_text())))
            else:
                line = f"| {label} | {scale:g} | **{said[:300]}** |" + " |" * 9
            lines.append(line)
            print(line, flush=True)
            if options.table:
                # Row by row: a run that is stopped keeps what it has.
                Path(options.table).parent.mkdir(parents=True, exist_ok=True)
                Path(options.table).write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
