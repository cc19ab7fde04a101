#!/usr/bin/env python3
"""The main job on many masks, all defaults: one table row a case.

    validation/cases/run.sh [--only NAME] [--set KEY=VALUE]... [MASK...]

Without masks: every built-in phantom, and the masks in ../shared/data where that folder is present. Runs
`lumenmesh mesh`, reads report.json, writes validation/results/cases/README.md. Exit code 1 if a hard gate is missed.
"""
import argparse, json, subprocess, sys, time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import masks

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "target/release/lumenmesh"
WORK = ROOT / "target/validation/cases"
DATA = ROOT.parent / "shared/data"


def row(name, mask, extra, sets):
    out = WORK / "out" / name.replace(", ", "_").replace(" ", "")
    command = [PROGRAM, "mesh", mask, "-o", out, "--quiet", *extra]
    for s in sets:
        command += ["--set", s]
    start = time.perf_counter()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=1800)
        code, words = done.returncode, done.stderr.strip().splitlines()
    except subprocess.TimeoutExpired:
        code, words = -1, ["not finished within 1800 s"]
    seconds = time.perf_counter() - start
    if code not in (0, 6):
        return code, f"| {name} | | | | | | | | | {seconds:.1f} | | code {code}: {words[0][:160] if words else ''} |"
    r = json.loads((out / "report.json").read_text())
    s, f, v = r["surface"], r["fidelity"]["to_marching_cubes"], r["volume"]
    missed = [g["name"] for g in r["gates"] if not g["passed"]]
    hard = [g["name"] for g in r["gates"] if g["hard"] and not g["passed"]]
    verdict = "MISSED: " + "; ".join(hard) if hard else ("met; not reached: " + "; ".join(missed) if missed else "met")
    return code, (f"| {name} | {r['input']['lumen_voxels']} | {len(r.get('openings', []))} | {s['faces']} | {s['s_max']:.3f} / {s['s_mean']:.3f} "
                  f"| {f['median']:.3f} / {f['max']:.2f} | {v['cells']} | {v['sv_max']:.3f} / {v['sv_mean']:.3f} "
                  f"| {v['non_orthogonality']:.1f} | {seconds:.1f} | {r['run']['peak_memory_bytes'] / 2**20:.0f} | {verdict} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="cases whose name contains this")
    parser.add_argument("--set", action="append", default=[], help="as for lumenmesh")
    parser.add_argument("masks", nargs="*", type=Path)
    a = parser.parse_args()
    WORK.mkdir(parents=True, exist_ok=True)
    cases = [(m.name.split(".")[0], m, []) for m in a.masks] or [*masks.built_in(PROGRAM, WORK), *masks.shared(DATA)]
    cases = [c for c in cases if not a.only or a.only in c[0]]
    head = ["| case | lumen voxels | openings | faces | S max / mean | deviation median / max (voxel diagonals) | cells | S_V max / mean "
            "| non-orthogonality (°) | seconds | MiB | gates |", "|-|-|-|-|-|-|-|-|-|-|-|-|"]
    rows, missed = [], 0
    for case in cases:
        code, line = row(*case, a.set)
        missed += code != 0
        rows.append(line)
        print(line, flush=True)
    if not a.only and not a.masks:
        results = ROOT / "validation/results/cases"
        results.mkdir(parents=True, exist_ok=True)
        version = subprocess.run([PROGRAM, "--version"], capture_output=True, text=True).stdout.strip()
        text = ["# The main job on many masks", "", f"`validation/cases/run.sh {' '.join('--set ' + s for s in a.set)}`".replace(" `", "`")
                + f", {version}, all defaults, ends detected. Deviation is from the marching cubes surface of the mask; seconds and",
                "peak memory (of this process, the volume engine aside) are of a shared two-core machine.", "", *head, *rows, ""]
        (results / ("README.md" if not a.set else "-".join(s.replace("=", "_") for s in a.set) + ".md")).write_text("\n".join(text))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
