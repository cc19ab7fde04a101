"""(a) A straight tube: pressure drop and wall shear stress against Poiseuille's law."""
import numpy as np

import foam, masks, tools
from tools import check

RADIUS, HALF = 2.0, 13.0          # mm: 13 R long
DIRECTION = np.array([0.55, 0.35, 0.76]) / np.linalg.norm([0.55, 0.35, 0.76])
SHIFTS = {"0": (0, 0, 0), "1": (0.31, 0.67, 0.12), "2": (0.5, 0.25, 0.75)}
REYNOLDS = 100
# Voxels a radius and prism layers. Edges follow the voxels: R/h is 5.4 with 8 voxels, 6 with 10.
MESHES = ((8, 0), (10, 0), (8, 4))


def case(work, voxels, shift):
    far = (HALF + 3) * DIRECTION
    low, high = -np.abs(far) - 3, np.abs(far) + 3
    masks.write(work / "mask.nrrd", lambda p: masks.segment(p, -far, far) - RADIUS, low, high, RADIUS / voxels, shift)
    end = HALF * DIRECTION
    plane = lambda name, c, n: f"- {{name: {name}, center: [{c[0]}, {c[1]}, {c[2]}], normal: [{n[0]}, {n[1]}, {n[2]}]}}\n"
    (work / "case.yaml").write_text(
        "input: {mask: mask.nrrd}\nopenings:\n" + plane("inlet", -end, -DIRECTION) + plane("outlet_1", end, DIRECTION)
        + f"flow: {{inlet: {{reynolds: {REYNOLDS}}}}}\nexports: [openfoam]\n")
    return work / "case.yaml"


def measure(folder, report):
    mesh = foam.Mesh(folder)
    rho, mu, q = tools.density(report), 3.498e-3, report["flow"]["total_m3_per_s"]
    (a_in, c_in, _), (a_out, c_out, _) = mesh.opening("inlet"), mesh.opening("outlet_1")
    axis = c_out - c_in
    length = np.linalg.norm(axis)
    axis /= length
    area = mesh.volume.sum() / length
    radius = np.sqrt(area / np.pi)
    z = (mesh.cell_centre - c_in) @ axis / length
    middle = (z > 0.25) & (z < 0.75)
    p = foam.field(foam.last_time(folder) / "p")[:, 0] * rho
    slope = -np.polyfit(z[middle] * length, p[middle], 1)[0]
    wss, size = tools.wall_shear_stress(folder, mesh, rho)
    z = (mesh.centre[mesh.patches["wall"]] - c_in) @ axis / length
    middle = (z > 0.25) & (z < 0.75)
    wss, size = wss[middle], size[middle]
    mean = tools.mean(wss, size)
    percent = lambda value, law: 100 * (value / law - 1)
    return {
        "cells": mesh.cells,
        "area_error": percent(area * 1e6, np.pi * RADIUS ** 2),
        "dp_error": percent(slope, 8 * np.pi * mu * q / area ** 2),
        "wss_error": percent(mean, 4 * mu * q / (np.pi * radius ** 3)),
        "wss_scatter": 100 * np.sqrt(tools.mean((wss - mean) ** 2, size)) / mean,
        "imbalance": 100 * abs(foam.monitored(folder, "phi_inlet") + foam.monitored(folder, "phi_outlet_1")) / q,
    }


def rows(meshes=MESHES):
    for voxels, layers in meshes:
        for name, shift in SHIFTS.items():
            work = tools.WORK / f"a/{voxels}_{layers}_{name}"
            report = tools.mesh(case(work, voxels, shift), work / "out", [f"volume.boundary_layers.count={layers}"])
            solved = foam.solve(work / "out/openfoam")
            measured = {k: float(v) for k, v in measure(work / "out/openfoam", report).items()}
            row = {"voxels": voxels, "layers": layers, "shift": list(shift), "status": report["status"], **solved, **measured}
            print(row, flush=True)
            yield row


def run():
    return judge(list(rows()))


def judge(rows):
    checks = []
    for voxels, layers in MESHES:
        of = [r for r in rows if (r["voxels"], r["layers"]) == (voxels, layers)]
        if not of:
            continue
        kind = f"{'prism layers' if layers else 'tetrahedra'}, {voxels} voxels a radius"
        worst = lambda key: max(abs(r[key]) for r in of)
        checks += [
            check(f"{kind}: pressure drop, worst error (%)", worst("dp_error"), 3),
            check(f"{kind}: mean wall shear stress, worst error (%)", worst("wss_error"), 2 if layers else 5),
            check(f"{kind}: scatter of the wall shear stress, worst (%)", worst("wss_scatter"), 8),
            check(f"{kind}: area, worst error (%)", worst("area_error"), 3),
            check(f"{kind}: runs not converged or not Mesh OK", sum(not r["iterations"] or not r["mesh_ok"] for r in of), 0),
        ]
    return {"rows": rows, "checks": checks}
