"""Normals of detected ends against the vessel's own axis.

The planes in truth/*.json are where the source surfaces were cut, square to the vessel or not. The axis of the vessel is
taken from the truth surface itself: the normal of the plane through the detected centre whose section is smallest.

    axis.py LUMENMESH DATA [CASE...]     prints a table, writes ends.md beside the results if OUT is set
"""
import gzip, json, os, re, subprocess, sys, tempfile
import numpy as np
import vtk
from scipy.optimize import minimize


def planes(text):
    out = []
    number = r"\[(.*?)\]"
    for m in re.finditer(rf"- name: (\S+)\n\s+kind: (\S+)\n\s+center: {number}\n\s+normal: {number}", text):
        point = lambda t: np.array([float(x) for x in t.split(",")])
        out.append((m[1], point(m[3]), point(m[4])))
    return out


def surface(path):
    with tempfile.NamedTemporaryFile(suffix=".stl") as f:
        f.write(gzip.open(path).read())
        f.flush()
        r = vtk.vtkSTLReader()
        r.SetFileName(f.name)
        r.Update()
    return r.GetOutput()


def section(poly, center, normal, radius):
    """Area, middle and openness of the loop round `center`."""
    plane = vtk.vtkPlane()
    plane.SetOrigin(*center)
    plane.SetNormal(*normal)
    near = vtk.vtkExtractPolyDataGeometry()
    ball = vtk.vtkSphere()
    ball.SetCenter(*center)
    ball.SetRadius(6 * radius)
    near.SetImplicitFunction(ball)
    near.ExtractBoundaryCellsOn()
    near.SetInputData(poly)
    cut = vtk.vtkCutter()
    cut.SetInputConnection(near.GetOutputPort())
    cut.SetCutFunction(plane)
    strip = vtk.vtkStripper()
    strip.SetInputConnection(cut.GetOutputPort())
    strip.JoinContiguousSegmentsOn()
    strip.Update()
    out = strip.GetOutput()
    best = (np.inf, None)
    e = np.cross(normal, [1, 0, 0] if abs(normal[0]) < 0.7 else [0, 1, 0])
    u = e / np.linalg.norm(e)
    v = np.cross(normal, u)
    for i in range(out.GetNumberOfCells()):
        ids = out.GetCell(i).GetPointIds()
        p = np.array([out.GetPoint(ids.GetId(k)) for k in range(ids.GetNumberOfIds())]) - center
        x, y = p @ u, p @ v
        a = np.unwrap(np.arctan2(y, x))
        if abs(a[-1] - a[0]) < 5:  # does not go round the centre
            continue
        area = 0.5 * abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
        if area < best[0]:
            best = (area, p.mean(0) + center)
    return best


def axis(poly, center, start, radius):
    """Normal of the smallest section through `center`."""
    e = np.cross(start, [1, 0, 0] if abs(start[0]) < 0.7 else [0, 1, 0])
    u = e / np.linalg.norm(e)
    v = np.cross(start, u)
    turned = lambda t: (start + np.tan(t[0]) * u + np.tan(t[1]) * v) / np.linalg.norm(start + np.tan(t[0]) * u + np.tan(t[1]) * v)
    cost = lambda t: min(section(poly, center, turned(t), radius)[0], 1e9)
    best = None
    for s in ([0, 0], [0.4, 0.4], [-0.4, 0.4], [0.4, -0.4], [-0.4, -0.4]):
        r = minimize(cost, s, method="Nelder-Mead", options=dict(xatol=2e-3, fatol=1e-4 * radius**2, initial_simplex=[s, [s[0] + 0.2, s[1]], [s[0], s[1] + 0.2]]))
        if best is None or r.fun < best.fun:
            best = r
    return turned(best.x), best.fun


def angle(a, b):
    return np.degrees(np.arccos(np.clip(abs(a @ b) / np.linalg.norm(a) / np.linalg.norm(b), 0, 1)))


def main():
    program, data = sys.argv[1:3]
    names = sys.argv[3:] or sorted(f[:-5] for f in os.listdir(f"{data}/truth") if f.endswith(".json"))
    rows = ["| case | end | radius mm | distance R | to the source's cut ° | to the axis of the truth ° | the source's cut to that axis ° | found as |", "|-|-|-|-|-|-|-|-|"]
    for name in names:
        mask = next(f"{data}/{f}" for f in sorted(os.listdir(data)) if f.startswith(name + "."))
        text = subprocess.run([program, "init", mask], capture_output=True, text=True, check=True).stdout
        found = planes(text)
        poly = surface(f"{data}/truth/{name}.stl.gz")
        used = set()
        for n, end in enumerate(json.load(open(f"{data}/truth/{name}.json"))["ends"]):
            c, own, r = np.array(end["center"]), np.array(end["normal"]), end["radius"]
            d = [np.linalg.norm(p - c) for _, p, _ in found]
            k = int(np.argmin(d)) if d else -1
            if k < 0 or d[k] > 2.5 * r:
                rows.append(f"| {name} | {n + 1} | {r:.2f} | {d[k] / r if d else np.nan:.2f} | | | | MISSED |")
                continue
            used.add(k)
            label, p, normal = found[k]
            a, _ = axis(poly, p, normal, r)
            rows.append(f"| {name} | {n + 1} | {r:.2f} | {d[k] / r:.2f} | {angle(normal, own):.1f} | {angle(normal, a):.1f} | {angle(own, a):.1f} | {label} |")
        for k in set(range(len(found))) - used:
            rows.append(f"| {name} | | | | | | | invented: {found[k][0]} |")
        for line in text.splitlines():
            if "# closed:" in line:
                rows.append(f"| {name} | | | | | | | {line.strip('# ').strip()} |")
    print("\n".join(rows))


main()
