"""validation/results/flow/README.md, of the parts that were run."""
import tools


def table(heads, rows):
    return "\n".join(["| " + " | ".join(heads) + " |", "|" + "-|" * len(heads), *("| " + " | ".join(str(c) for c in r) + " |" for r in rows)]) + "\n"


def number(x, digits=2):
    return "–" if x is None else f"{x:.{digits}f}"


def verdicts(result):
    return table(["held against", "value", "limit", ""], [[c["name"], f"{c['value']:.3g}", f"{c['limit']:g}", "met" if c["passed"] else "**missed**"] for c in result["checks"]])


def part_a(r):
    rows = [[("4 layers" if x["layers"] else "tetrahedra"), x["voxels"], ", ".join(f"{s:g}" for s in x["shift"]), int(x["cells"]), f"{x['area_error']:+.2f}", f"{x['dp_error']:+.2f}",
             f"{x['wss_error']:+.2f}", number(x["wss_scatter"]), x["iterations"], "OK" if x["mesh_ok"] else "failed"] for x in r["rows"]]
    return ("## (a) Poiseuille\nA straight tube of radius 2 mm, 26 mm long, oblique, as a mask of 8 or 10 voxels a radius, the grid at three positions, given in voxels. Re 100, parabolic "
            "inlet. Area = volume / length against the true circle; pressure gradient and mean wall shear stress of the middle half against the law with the mesh's own area. Errors in %.\n\n"
            + table(["mesh", "voxels / radius", "shift (voxels)", "cells", "area", "pressure drop", "WSS, mean", "WSS, scatter", "iterations", "checkMesh"], rows) + "\n" + verdicts(r))


def part_b(r):
    rows = [[x["name"], x["cells"], x["iterations"], f"{x['imbalance']:.1e}", number(x["wss_mean"]), number(x["wss_max"])] for x in r["rows"]]
    pictures = "".join(f"![{x['name']}](b_{x['name']}.png)" for x in r["rows"])
    return ("## (b) Bend and bifurcation\nFrom the mask to the finished run with all defaults (Re 300, outlets by Murray's law).\n\n"
            + table(["vessel", "cells", "iterations", "mass imbalance (%)", "WSS mean (Pa)", "WSS max (Pa)"], rows) + "\n" + verdicts(r) + "\n" + pictures + "\n")


def part_c(r):
    rows = [[x["name"], x["scale"], x["cells"], number(x["h"], 3), x["iterations"] or "not in 1000", f"{x['residual']:.1e}", number(x["wss_mean"], 3), number(x["wss_p99"]), number(x["wss_max"]),
             number(x["dp"], 1), number(100 * x["low_area"], 1)] for x in r["rows"]]
    grid = [[k, number(g["order"]), f"{g['extrapolated']:.4g}", f"{g['coarsest_error']:+.1f}", f"{g['finest_error']:+.1f}"] for k, g in r["grid"].items()]
    names = {"wss_mean": "WSS, mean (Pa)", "wss_p99": "WSS, 99 % of the area (Pa)", "dp": "pressure drop (Pa)"}
    grid = [[names[g[0]], *g[1:]] for g in grid]
    seen = []
    for x in r["rows"]:
        name = "phantom" if x["name"] == "aneurysm phantom" else x["name"]
        if name not in seen:
            seen.append(name)
    pictures = "\n".join(f"![{n}](c_{n}.png)\n" for n in seen)
    return ("## (c) Aneurysms: convergence and mesh size\n`surface.scale` multiplies every edge length; h is the edge of a cube of the mean cell volume.\n\n"
            + table(["vessel", "scale", "cells", "h (mm)", "iterations", "largest residual", "WSS mean (Pa)", "WSS 99 % (Pa)", "WSS max (Pa)", "pressure drop (Pa)", "area below 0.4 Pa (%)"], rows)
            + "\nGrid convergence of the phantom, least squares of f(h) = f0 + a h^p over its sizes:\n\n" + table(["figure", "p", "f0", "error of the coarsest (%)", "of the finest (%)"], grid) + "\n"
            + verdicts(r) + "\nAs in the paper's Figure 18, the coarse mesh blurs the stress peaks:\n\n" + pictures)


def part_d(r):
    rows = [[x["name"], x["cells"], x["iterations"] or "not in 1000", number(x["sv_max"], 3), number(x["wss_mean"], 3), number(x["wss_p99"]), number(x["wss_max"]), number(x["dp"], 1),
             number(x["difference_rms"], 1), number(x["scatter"], 1)] for x in r["rows"]]
    return ("## (d) What the surface does to the WSS\nThe aneurysm phantom's mask, the same planes and flow rate; marching cubes is cut flat by VTK and filled by TetGen (pq1.4a) with cells of like size. "
            "Difference: rms against the nearest wall face of the first row, part of the mean. Scatter: rms against the mean of the 1 mm around.\n\n"
            + table(["surface", "cells", "iterations", "S_V max", "WSS mean (Pa)", "WSS 99 % (Pa)", "WSS max (Pa)", "pressure drop (Pa)", "difference (%)", "scatter (%)"], rows) + "\n"
            + verdicts(r) + "\n![surfaces](d.png)\n")


def write():
    parts = {"a": part_a, "b": part_b, "c": part_c, "d": part_d}
    text = "# Proof by flow\nMade by `validation/flow/run.sh`: mask → `lumenmesh run` → `./Allrun` (checkMesh, simpleFoam of Debian's openfoam), no edit by hand.\n\n"
    for part, make in parts.items():
        result = tools.load(part)
        if result:
            text += make(result) + "\n"
    (tools.RESULTS / "README.md").write_text(text)
