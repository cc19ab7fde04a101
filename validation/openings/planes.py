"""Runs every case with end planes in truth/*.json with those planes as the user's, to the surface.

    planes.py LUMENMESH DATA OUT [CASE...]      writes OUT/CASE.yaml, OUT/CASE/, prints a table
"""
import json, os, subprocess, sys


def main():
    program, data, out = sys.argv[1:4]
    names = sys.argv[4:] or sorted(f[:-5] for f in os.listdir(f"{data}/truth") if f.endswith(".json"))
    os.makedirs(out, exist_ok=True)
    print("| case | planes | openings | exit | S max wall, rims included | S max caps | planarity / box | verdict |\n|-|-|-|-|-|-|-|-|")
    bad = 0
    for name in names:
        mask = next(f for f in sorted(os.listdir(data)) if f.startswith(name + "."))
        ends = json.load(open(f"{data}/truth/{name}.json"))["ends"]
        widest = max(range(len(ends)), key=lambda i: ends[i]["radius"])
        outlets = iter(range(1, len(ends) + 1))
        lines = [f"input: {{mask: {os.path.relpath(f'{data}/{mask}', out)}}}", "openings:"]
        for i, e in enumerate(ends):
            label = "inlet" if i == widest else f"outlet_{next(outlets)}"
            lines.append(f"- {{name: {label}, center: {e['center']}, normal: {e['normal']}}}")
        case = f"{out}/{name}.yaml"
        open(case, "w").write("\n".join(lines) + "\n")
        done = subprocess.run([program, "run", case, "-o", f"{out}/{name}", "--stop-after", "surface", "--quiet"], capture_output=True, text=True)
        row = [name, len(ends)]
        if os.path.exists(f"{out}/{name}/report.json") and done.returncode in (0, 6):
            r = json.load(open(f"{out}/{name}/report.json"))
            gate = lambda text: next(g["value"] for g in r["gates"] if text in g["name"])
            missed = [g["name"] for g in r["gates"] if g["hard"] and not g["passed"]]
            row += [len(r["openings"]), done.returncode, f"{gate('wall and rims'):.3f}", f"{gate('aimed at, caps'):.3f}", f"{gate('caps planar'):.1e}", "; ".join(missed) or "met"]
            bad += bool(missed) or len(r["openings"]) != len(ends)
        else:
            row += ["", done.returncode, "", "", "", done.stderr.strip().splitlines()[-1] if done.stderr.strip() else ""]
            bad += 1
        print("| " + " | ".join(map(str, row)) + " |", flush=True)
    sys.exit(bad > 0)


main()
