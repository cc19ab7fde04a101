#!/usr/bin/env python3
"""The paper's profile on large masks: is the polygonized surface's topology the cleaned mask's, and what does it cost?

    validation/paper/large.py MASK...

Runs the release build's `lumenmesh mesh MASK --set reconstruction.profile=paper --stop-after reconstruction` and writes
validation/results/paper/large.md, a row a mask as they come.
"""
import json, subprocess, sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "target/validation/paper/large"
HEAD = """# The paper's profile on large masks

Made by `validation/paper/large.py`: profile `paper` up to the polygonized surface. Where its topology is not the cleaned mask's the
guard is drawn narrower, to an eighth at most (`band`, in voxel diagonals), then the polygonizer's cells are made finer, to half at most (`cells`, in
voxels). Seconds of a shared machine.

| case | points | leaves | triangles | 2 χ(mask), χ(surface) | parts | band | cells | points and fit | polygons, all attempts |
|---|---|---|---|---|---|---|---|---|---|
"""


def main():
    rows, notes = [], ROOT / "validation/results/paper/large_notes.md"
    tail = "\n" + notes.read_text() if notes.exists() else ""
    for mask in map(Path, sys.argv[1:]):
        name = mask.name.split(".")[0]
        out = WORK / name
        # Exit code 6: a gate is missed. The triangles' shape is one, before remeshing.
        run = subprocess.run([str(ROOT / "target/release/lumenmesh"), "mesh", str(mask), "-o", str(out), "--set", "reconstruction.profile=paper", "--stop-after", "reconstruction", "--quiet"])
        if run.returncode not in (0, 6):
            raise SystemExit(f"{mask}: exit code {run.returncode}")
        report = json.loads((out / "report.json").read_text())
        fit, topology = report["reconstruction"], report["surface"]["topology"]
        seconds = {s["name"]: s["seconds"] for s in report["run"]["stages"]}
        mask_topology = report["cleaning"]["after"]
        rows.append(
            f"| {name} | {fit['mpu']['points']} | {fit['mpu']['leaves']} | {fit['polygonizer']['triangles']} | {2 * mask_topology['euler']}, {topology['euler']} "
            f"| {mask_topology['components']}, {topology['components']} | {fit['guard']['band'] if 'guard' in fit else 'not narrowed'} | {fit.get('finer_cells', 0.7):.2f} | {seconds['reconstruct']:.1f} | {seconds['polygonize']:.1f} |"
        )
        print(rows[-1], flush=True)
        (ROOT / "validation/results/paper/large.md").write_text(HEAD + "\n".join(rows) + "\n" + tail)


if __name__ == "__main__":
    main()
