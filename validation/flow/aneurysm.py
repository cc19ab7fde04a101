"""(c) The aneurysm phantom and a real aneurysm: convergence, WSS on several mesh sizes, grid convergence."""
import json, subprocess

import numpy as np

import foam, pictures, tools
from tools import check

SCALES = (1.6, 1.25, 1.0, 0.8)
LAYER_SCALES = (2.0, 1.6, 1.25)      # with four prism layers
REAL_SCALES = (1.6, 1.0)


def solve(name, case, scale, layers=0):
    """One mesh size: its row, and what a picture needs."""
    # OpenFOAM cannot work in a path with spaces.
    out = tools.WORK / "c" / f"{name}_{scale}_{layers}".replace(" ", "_")
    report = tools.mesh(case, out, [f"surface.scale={scale}", f"volume.boundary_layers.count={layers}", "exports=[openfoam]"])
    row, shown = solved(out, report)
    row = {"name": name, "scale": scale, "layers": layers, "status": report["status"], **row}
    print(row, flush=True)
    return row, shown


def solved(out, report):
    """A folder of results after its solver: its figures, mesh and wall shear stress."""
    folder = out / "openfoam"
    run = foam.solve(folder)
    mesh = foam.Mesh(folder)
    rho = tools.density(report)
    wss, size = tools.wall_shear_stress(folder, mesh, rho)
    outlets = [n for n in mesh.patches if n.startswith("outlet")]
    row = {
        "cells": mesh.cells, "h": 1e3 * float((mesh.volume.sum() / mesh.cells) ** (1 / 3)), "sv_mean": json.loads((out / "report.json").read_text())["volume"]["sv_mean"],
        **run, "residual": max(v[-1] for v in foam.residuals(folder).values()),
        "wss_mean": tools.mean(wss, size), "wss_p99": tools.percentile(wss, size, 0.99), "wss_max": float(wss.max()),
        "low_area": float(size[wss < 0.4].sum() / size.sum()),
        "dp": rho * (foam.monitored(folder, "p_inlet") - foam.monitored(folder, f"p_{outlets[0]}")),
        "imbalance": 100 * abs(sum(foam.monitored(folder, f"phi_{n}") for n in mesh.patches if n != "wall")) / report["flow"]["total_m3_per_s"],
    }
    return row, (mesh, wss)


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
    rows += [solve("aneurysm phantom", phantom / "case.yaml", s, 4)[0] for s in LAYER_SCALES]
    checks = []
    for mask in masks:
        case = tools.WORK / f"c/{mask.stem}.yaml"
        case.write_text(f"input: {{mask: {mask}}}\n")
        real = [solve(mask.name.split(".")[0], case, s) for s in REAL_SCALES]
        rows += [r for r, _ in real]
        panels = [(*s, f"WSS, edge length x {r['scale']}, {r['cells']} cells") for r, s in real]
        pictures.wall(tools.RESULTS / f"c_{mask.name.split('.')[0]}.png", panels, 1.1 * real[-1][0]["wss_p99"])
    for r in rows:
        layers = ", 4 layers" if r["layers"] else ""
        checks.append(check(f"{r['name']}, edge length x {r['scale']}{layers}: largest residual", r["residual"], 1e-5))
    checks.append(check("largest mass imbalance (%)", max(r["imbalance"] for r in rows), 0.01))
    return {"rows": rows, "checks": checks}
