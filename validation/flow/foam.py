"""OpenFOAM cases in ASCII: meshes, fields, runs. SI units, as the solver has them."""
import os, re, subprocess, time
from pathlib import Path

import numpy as np

ENVIRONMENT = dict(os.environ, WM_PROJECT_DIR=os.environ.get("WM_PROJECT_DIR", "/usr/share/openfoam"))


def body(path):
    """The items of a list file, without its head."""
    text = Path(path).read_text()
    text = re.sub(r"//.*", "", text[text.index("}") + 1:])
    return text[text.index("(") + 1:text.rindex(")")]


def numbers(text):
    return np.array(text.translate(str.maketrans("()", "  ")).split(), float)


class Mesh:
    """Points, faces (triangles as quadrilaterals with a repeated vertex), owner, neighbour, patches; face and cell geometry."""

    def __init__(self, case):
        folder = Path(case) / "constant/polyMesh"
        self.points = numbers(body(folder / "points")).reshape(-1, 3)
        faces = [f.split() for f in re.findall(r"\(([^)]*)\)", body(folder / "faces"))]
        self.faces = np.array([f if len(f) == 4 else [*f, f[-1]] for f in faces], int)
        self.owner = numbers(body(folder / "owner")).astype(int)
        self.neighbour = numbers(body(folder / "neighbour")).astype(int)
        text = (folder / "boundary").read_text()
        self.patches = {}
        for name, entries in re.findall(r"(\w[\w.\-]*)\s*\{([^}]*nFaces[^}]*)\}", text):
            value = lambda key: int(re.search(key + r"\s+(\d+)", entries).group(1))
            self.patches[name] = slice(value("startFace"), value("startFace") + value("nFaces"))
        x = self.points[self.faces]
        middle = np.where((self.faces[:, 2] == self.faces[:, 3])[:, None], x[:, :3].mean(1), x.mean(1))
        nxt = np.roll(x, -1, 1)
        parts = np.cross(nxt - x, middle[:, None] - x) / 2
        size = np.linalg.norm(parts, axis=2)
        self.area = parts.sum(1)
        self.centre = ((x + nxt + middle[:, None]) / 3 * size[:, :, None]).sum(1) / size.sum(1)[:, None]
        inner = len(self.neighbour)
        self.cells = int(max(self.owner.max(), self.neighbour.max())) + 1
        rough, count = np.zeros((self.cells, 3)), np.zeros(self.cells)
        for ids, faces in ((self.owner, slice(None)), (self.neighbour, slice(inner))):
            np.add.at(rough, ids, self.centre[faces])
            np.add.at(count, ids, 1)
        rough /= count[:, None]
        self.volume, self.cell_centre = np.zeros(self.cells), np.zeros((self.cells, 3))
        for ids, sign, faces in ((self.owner, 1, slice(None)), (self.neighbour, -1, slice(inner))):
            pyramid = sign * np.einsum("ij,ij->i", self.area[faces], self.centre[faces] - rough[ids]) / 3
            np.add.at(self.volume, ids, pyramid)
            np.add.at(self.cell_centre, ids, pyramid[:, None] * (0.75 * self.centre[faces] + 0.25 * rough[ids]))
        self.cell_centre /= self.volume[:, None]

    def opening(self, name):
        """Area, centre, unit normal out of the vessel."""
        s = self.area[self.patches[name]]
        size = np.linalg.norm(s, axis=1)
        total = s.sum(0)
        centre = (self.centre[self.patches[name]] * size[:, None]).sum(0) / size.sum()
        return np.linalg.norm(total), centre, total / np.linalg.norm(total)


def field(path, patch=None):
    """Values of a field in the cells, or on a patch."""
    text = Path(path).read_text()
    text = text[re.search(r"\n\s*%s\s*\n\s*\{" % re.escape(patch), text).end():] if patch else text[text.index("internalField"):]
    start = re.search(r"nonuniform\s+List<(\w+)>\s*\n?(\d+)\s*\n?\(", text)
    values = numbers(text[start.end():text.index("\n)", start.end())])
    return values.reshape(int(start.group(2)), -1)


def last_time(case):
    return max((d for d in Path(case).iterdir() if re.fullmatch(r"[0-9.]+", d.name) and d.name != "0"), key=lambda d: float(d.name))


def solve(case):
    """./Allrun; iterations to convergence (None: not converged), seconds, checkMesh's verdict."""
    start = time.perf_counter()
    subprocess.run(["nice", "-n", "2", "./Allrun"], cwd=case, env=ENVIRONMENT, check=True, stdout=subprocess.DEVNULL)
    seconds = time.perf_counter() - start
    log = (Path(case) / "log.simpleFoam").read_text()
    found = re.search(r"solution converged in (\d+) iterations", log)
    ok = "Mesh OK" in (Path(case) / "log.checkMesh").read_text()
    return {"iterations": int(found.group(1)) if found else None, "seconds": round(seconds, 1), "mesh_ok": ok}


def residuals(case):
    """Initial residuals of each iteration: {Ux, Uy, Uz, p}, first solve of each."""
    out, rows = {}, {}
    for line in (Path(case) / "log.simpleFoam").read_text().splitlines():
        if line.startswith("Time = "):
            for k, v in rows.items():
                out.setdefault(k, []).append(v)
            rows = {}
        m = re.search(r"Solving for (\w+), Initial residual = ([0-9.e+-]+)", line)
        if m:
            rows.setdefault(m.group(1), float(m.group(2)))
    for k, v in rows.items():
        out.setdefault(k, []).append(v)
    return out


def iterations_to(case, residual):
    """Iterations until all initial residuals stay below `residual`; None where they never do."""
    worst = [max(r) for r in zip(*residuals(case).values())]
    above = [i for i, r in enumerate(worst) if r > residual]
    return above[-1] + 2 if above and above[-1] + 1 < len(worst) else (1 if not above else None)


def monitored(case, name):
    """Last value of a patch monitor."""
    text = next((Path(case) / "postProcessing" / name).rglob("*.dat")).read_text()
    return float(text.split()[-1])
