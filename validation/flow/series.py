"""(e) A series of three meshes: its table filled from the solver's runs, and what `lumenmesh convergence` says of it."""
import csv, subprocess

import aneurysm, tools
from tools import check

FIGURES = {"wss_mean_Pa": "wss_mean", "wss_99_percent_Pa": "wss_p99", "pressure_drop_Pa": "dp"}


def one(case, layers):
    out = tools.WORK / "e" / f"layers_{layers}"
    report = tools.mesh(case, out, ["volume.series=3", f"volume.boundary_layers.count={layers}", "exports=[openfoam]"])
    table = out / "series/convergence.csv"
    with table.open() as f:
        rows = list(csv.DictReader(f))
    for row in rows:
        row.pop("figure")
        flow = aneurysm.solved(out / row["folder"], report)[0]
        row |= {name: flow[key] for name, key in FIGURES.items()} | {"residual": flow["residual"], "sv_mean": flow["sv_mean"], "imbalance": flow["imbalance"]}
    with table.open("w") as f:
        kept = csv.DictWriter(f, [k for k in rows[0] if k not in ("residual", "sv_mean", "imbalance")], extrasaction="ignore")
        kept.writeheader()
        kept.writerows(rows)
    says = subprocess.run([str(tools.LUMENMESH), "convergence", str(table)], check=True, capture_output=True, text=True).stdout
    print(says, flush=True)
    return {"layers": layers, "rows": rows, "says": says}


def run():
    phantom = tools.WORK / "e/phantom"
    subprocess.run([str(tools.LUMENMESH), "phantom", "aneurysm", "-o", str(phantom)], check=True, stdout=subprocess.DEVNULL)
    series = [one(phantom / "case.yaml", layers) for layers in (0, 4)]
    rows = [r for s in series for r in s["rows"]]
    return {"series": series, "checks": [
        check("largest residual of all runs", max(r["residual"] for r in rows), 1e-5),
        check("largest mass imbalance (%)", max(r["imbalance"] for r in rows), 0.01),
        check("largest ratio of sizes to 1.4, off by (%)", max(abs(100 * (float(r["ratio"]) / 1.4 - 1)) for r in rows if r["ratio"]), 10),
    ]}
