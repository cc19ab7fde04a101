"""What all parts share: running lumenmesh, checks, results."""
import json, os, shutil, subprocess
from pathlib import Path

import numpy as np

import foam

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "validation/results/flow"
WORK = ROOT / "target/validation/flow"
LUMENMESH = Path(os.environ.get("LUMENMESH", ROOT / "target/release/lumenmesh")).resolve()


def mesh(case, out, settings=()):
    """`lumenmesh run`; gives the report. Runs that miss a gate keep their files and go on."""
    # A study's own working folder holds the solver's results of the last time, which lumenmesh would not replace.
    if Path(out).resolve().is_relative_to(WORK):
        shutil.rmtree(out, ignore_errors=True)
    sets = [x for s in settings for x in ("--set", s)]
    done = subprocess.run([str(LUMENMESH), "run", str(case), "-o", str(out), "--quiet", *sets], capture_output=True, text=True)
    if done.returncode not in (0, 6):
        raise SystemExit(f"lumenmesh run {case}: code {done.returncode}\n{done.stderr}")
    return json.loads((Path(out) / "report.json").read_text())


def check(name, value, limit, larger=False):
    value = float("inf") if value is None else float(value)
    return {"name": name, "value": value, "limit": limit, "passed": bool(value >= limit if larger else value <= limit)}


def save(part, result):
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{part}.json").write_text(json.dumps(result, indent=1) + "\n")


def load(part):
    path = RESULTS / f"{part}.json"
    return json.loads(path.read_text()) if path.exists() else None


def wall_shear_stress(case, mesh, density):
    """Magnitude on each wall face, Pa; the faces' areas."""
    values = np.linalg.norm(foam.field(foam.last_time(case) / "wallShearStress", "wall"), axis=1) * density
    return values, np.linalg.norm(mesh.area[mesh.patches["wall"]], axis=1)


def mean(values, areas):
    return float((values * areas).sum() / areas.sum())


def percentile(values, areas, q):
    """The value below which the part q of the area lies."""
    order = np.argsort(values)
    return float(np.interp(q, np.cumsum(areas[order]) / areas.sum(), values[order]))


def density(report):
    return report["flow"].get("density_kg_per_m3", 1060.0)
