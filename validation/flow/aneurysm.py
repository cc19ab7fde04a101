"""(c) The aneurysm phantom and a real aneurysm: convergence, WSS on several mesh sizes, grid convergence."""
import subprocess

import numpy as np

import foam, pictures, tools
from tools import check

SCALES = (1.6, 1.25, 1.0, 0.8)
REAL_SCALES = (1.6, 1.0)


def solve(name, case, scale):
    """One mesh size: its row, and what a picture needs."""
    # OpenFOAM cannot work in a path with spaces.
    out = tools.WORK / "c" / f"{name}_{scale}".replace(" ", "_")
    report = tools.mesh(case, out, [f"surface.scale={scale}", "exports=[openfoam]"])
    folder = out / "openfoam"
    solved = foam.solve(folder)
    mesh = foam.Mesh(folder)
    rho = tools.density(report)
    wss, size = tools.wall_shear_stress(folder, mesh, rho)
    residual = max(v[-1] for v in foam.residuals(folder).values())
    outlets = [n for n in mesh.patches if n.startswith("outlet")]
    row = {
        "name": name, "scale": scale, "status": report["status"], "cells": mesh.cells, "h": 1e3 * float((mesh.volume.sum() / mesh.cells) ** (1 / 3)),
        **solved, "residual": residual, "wss_mean": tools.mean(wss, size), "wss_p99": tools.percentile(wss, size, 0.99), "wss_max": float(wss.max()),
        "low_area": float(size[wss < 0.4].sum() / size.sum()),
        "dp": rho * (foam.monitored(folder, "p_inlet") - foam.monitored(folder, f"p_{outlets[0]}")),
        "imbalance": 100 * abs(sum(foam.monitored(folder, f"phi_{n}") for n in mesh.patches if n != "wall")) / report["flow"]["total_m3_per_s"],
    }
    print(row, flush=True)
    return row, (mesh, wss)


def convergence(rows, key):
    """Observed order, extrapolated value and the finest mesh's error estimate (%), by least squares on f(h) = f0 + a h^p."""
    h = np.array([r["h"] for r in rows])
    f = np.array([r[key] for r in rows])
    best = None
    for p in np.arange(0.5, 4.01, 0.05):
        a = np.stack([np.ones_like(h), h ** p], 1)
        x, *_ = np.linalg.lstsq(a, f, rcond=None)
        miss = float(np.sum((a @ x - f) ** 2))
        if best is None or miss < best[0]:
            best = (miss, float(p), float(x[0]))
    return {"order": best[1], "extrapolated": best[2], "finest_error": 100 * float(f[-1] / best[2] - 1), "coarsest_error": 100 * float(f[0] / best[2] - 1)}


def run(masks):
    phantom = tools.WORK / "c/phantom"
    subprocess.run([str(tools.LUMENMESH), "phantom", "aneurysm", "-o", str(phantom)], check=True, stdout=subprocess.DEVNULL)
    rows, shown = [], {}
    for scale in SCALES:
        row, shown[scale] = solve("aneurysm phantom", phantom / "case.yaml", scale)
        rows.append(row)
    top = 1.1 * rows[-1]["wss_p99"]
    panels = [(*shown[s], f"WSS, edge length x {s}, {shown[s][0].cells} cells") for s in (SCALES[0], SCALES[-1])]
    pictures.wall(tools.RESULTS / "c_phantom.png", panels, top)
    grid = {key: convergence(rows, key) for key in ("wss_mean", "wss_p99", "dp")}
    checks = []
    for mask in masks:
        case = tools.WORK / f"c/{mask.stem}.yaml"
        case.write_text(f"input: {{mask: {mask}}}\n")
        real = [solve(mask.name.split(".")[0], case, s) for s in REAL_SCALES]
        rows += [r for r, _ in real]
        panels = [(*s, f"WSS, edge length x {r['scale']}, {r['cells']} cells") for r, s in real]
        pictures.wall(tools.RESULTS / f"c_{mask.name.split('.')[0]}.png", panels, 1.1 * real[-1][0]["wss_p99"])
    for r in rows:
        checks.append(check(f"{r['name']}, edge length x {r['scale']}: largest residual", r["residual"], 1e-5))
    checks.append(check("largest mass imbalance (%)", max(r["imbalance"] for r in rows), 0.01))
    checks.append(check("phantom: error of the mean WSS on the mesh of default size, by the series (%)",
                        abs(100 * (next(r for r in rows if r["scale"] == 1.0)["wss_mean"] / grid["wss_mean"]["extrapolated"] - 1)), 10))
    return {"rows": rows, "grid": grid, "checks": checks}
