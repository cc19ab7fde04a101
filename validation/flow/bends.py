"""(b) A 90 degree bend and a Y bifurcation: mass balance and convergence."""
import numpy as np

import foam, masks, pictures, tools
from tools import check

VOXEL = 0.4


def bend(p):
    """Radius 2 mm round 8 mm, legs of 12 mm."""
    x, y = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    d = masks.arc(p, [0, 0, 0], x, y, 8, np.pi / 2)
    d = np.minimum(d, masks.segment(p, [8, 0, 0], [8, -12, 0]))
    return np.minimum(d, masks.segment(p, [0, 8, 0], [-12, 8, 0])) - 2.0


def wye(p):
    """Radius 2 mm into 1.6 and 1.3 mm."""
    trunk = masks.segment(p, [0, 0, -16], [0, 0, 0]) - 2.0
    left = masks.segment(p, [0, 0, 0], [9, 2, 13]) - 1.6
    right = masks.segment(p, [0, 0, 0], [-9, -3, 12]) - 1.3
    return masks.smooth_min(masks.smooth_min(trunk, left, 1.0), right, 1.0)


SHAPES = {"bend": (bend, [-15, -15, -3], [11, 11, 3]), "bifurcation": (wye, [-12, -6, -19], [12, 6, 16])}


def run():
    rows, checks = [], []
    for name, (shape, low, high) in SHAPES.items():
        work = tools.WORK / f"b/{name}"
        masks.write(work / "mask.nrrd", shape, low, high, VOXEL, (0.21, 0.43, 0.11))
        (work / "case.yaml").write_text("input: {mask: mask.nrrd}\nexports: [openfoam]\n")
        report = tools.mesh(work / "case.yaml", work / "out")
        folder = work / "out/openfoam"
        solved = foam.solve(folder)
        mesh = foam.Mesh(folder)
        flows = {n: foam.monitored(folder, f"phi_{n}") for n in mesh.patches if n != "wall"}
        q = report["flow"]["total_m3_per_s"]
        wss, size = tools.wall_shear_stress(folder, mesh, tools.density(report))
        row = {"name": name, "cells": mesh.cells, "openings": len(flows), **solved, "to_1e5": foam.iterations_to(folder, 1e-5), "flows": flows,
               "imbalance": 100 * abs(sum(flows.values())) / q, "wss_mean": tools.mean(wss, size), "wss_max": float(wss.max())}
        rows.append(row)
        print(row, flush=True)
        pictures.wall(tools.RESULTS / f"b_{name}.png", [(mesh, wss, f"{name}: wall shear stress, Pa")], 1.2 * tools.percentile(wss, size, 0.98))
        checks += [check(f"{name}: mass imbalance (%)", row["imbalance"], 0.01),
                   check(f"{name}: iterations until all residuals are below 1e-5", row["to_1e5"], 300),
                   check(f"{name}: openings missing", abs(row["openings"] - (2 if name == "bend" else 3)), 0)]
    return {"rows": rows, "checks": checks}
