#!/usr/bin/env python3
"""Remeshing beside its peers at the same edge length, in one run: validation/remeshing/run.sh [PHANTOM|MASK ...]

Every remesher starts from the same polygonized surface. Writes validation/results/remeshing/README.md and pictures of
the meshes coloured by S (the paper's Figure 17). Seconds are of this machine and this run: only ratios mean anything.
"""
import argparse, json, os, shutil, statistics, subprocess, time
from pathlib import Path

import numpy as np
import pyvista as pv

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "validation/results/remeshing"
WORK = ROOT / "target/validation/remeshing"
PROGRAM = Path(os.environ.get("LUMENMESH", ROOT / "target/release/lumenmesh"))


def mesh(mask, out, *settings, stop="surface"):
    """A run of lumenmesh: its report and the surface it wrote."""
    shutil.rmtree(out, ignore_errors=True)
    command = [PROGRAM, "mesh", mask, "-o", out, "--stop-after", stop, "--quiet"]
    for s in settings:
        command += ["--set", s]
    done = subprocess.run(command, capture_output=True, text=True)
    if not (out / "report.json").exists():
        raise RuntimeError(done.stderr)
    return json.loads((out / "report.json").read_text()), pv.read(out / "surface/lumen.vtp")


def seconds(report, *names):
    return sum(s["seconds"] for s in report["run"]["stages"] if s["name"] in names)


def shape(surface):
    """S of every triangle, neighbours' ratio of areas (99th percentile), and whether the surface is a closed manifold."""
    p, t = np.asarray(surface.points, float), surface.faces.reshape(-1, 4)[:, 1:]
    a, b, c = (p[t[:, i]] for i in range(3))
    def angle(o, x, y):
        cross = np.linalg.norm(np.cross(x - o, y - o), axis=1)
        return np.degrees(np.arctan2(cross, np.einsum("ij,ij->i", x - o, y - o)))
    angles = np.stack([angle(a, b, c), angle(b, c, a), angle(c, a, b)])
    s = np.maximum((angles.max(0) - 60) / 120, (60 - angles.min(0)) / 60)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    edges = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(t)), 3)
    _, inverse, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(inverse.ravel(), kind="stable")
    first = np.concatenate([[0], np.cumsum(count)[:-1]])[count == 2]
    i, j = owner[order[first]], owner[order[first + 1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.maximum(area[i], area[j]) / np.minimum(area[i], area[j])
    lengths = np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1)
    return {"s": s, "ratio": np.nanpercentile(ratio, 99), "closed": bool((count == 2).all()), "edge": lengths.mean()}


def acvd(raw, wanted):
    """pyacvd, which needs a denser input than its output: subdivided until it is."""
    import pyacvd
    start = time.perf_counter()
    c = pyacvd.Clustering(raw)
    while c.mesh.n_cells < 8 * wanted:
        c.subdivide(1)
    c.cluster(wanted // 2)
    return c.create_mesh(), time.perf_counter() - start


def meshlab(raw, edge):
    import pymeshlab
    source = pymeshlab.Mesh(np.asarray(raw.points, float), raw.faces.reshape(-1, 4)[:, 1:])
    start = time.perf_counter()
    work = pymeshlab.MeshSet()
    work.add_mesh(source)
    work.meshing_isotropic_explicit_remeshing(iterations=10, targetlen=pymeshlab.PureValue(edge))
    taken = time.perf_counter() - start
    m = work.current_mesh()
    return pv.PolyData.from_regular_faces(m.vertex_matrix(), m.face_matrix()), taken


def cgal(raw, edge):
    import pygalmesh
    path = WORK / "cgal.off"
    pv.save_meshio(path, raw)
    start = time.perf_counter()
    # Delaunay balls of the radius that an equilateral triangle of this edge has; the proven bound of 30 degrees.
    m = pygalmesh.remesh_surface(
        str(path), min_facet_angle=30.0, max_radius_surface_delaunay_ball=edge / 3**0.5, max_facet_distance=0.1 * edge,
        max_edge_size_at_feature_edges=edge, verbose=False,
    )
    taken = time.perf_counter() - start
    return pv.PolyData.from_regular_faces(m.points, m.cells_dict["triangle"]), taken


def picture(surface, s, path, title):
    surface = surface.copy()
    surface.cell_data["S"] = s
    plot = pv.Plotter(off_screen=True, window_size=(560, 500))
    plot.add_mesh(surface, scalars="S", cmap="turbo", clim=(0, 0.75), show_edges=True, line_width=0.5, edge_color="#202020",
                  edge_opacity=0.35, ambient=0.45, scalar_bar_args={"title": "S", "n_labels": 4, "width": 0.5, "position_x": 0.25})
    plot.add_text(title, font_size=8)
    # Close enough to see triangles: the upper part.
    low, high = np.percentile(surface.points[:, 2], [60, 100])
    near = surface.points[(surface.points[:, 2] >= low) & (surface.points[:, 2] <= high)]
    plot.view_vector((0.35, -1, 0.3), (0, 0, 1))
    plot.set_focus(near.mean(axis=0))
    plot.camera.zoom(2.6)
    plot.screenshot(path)
    plot.close()


def compare(name, mask, edge, lines):
    raw_report, raw = mesh(mask, WORK / f"{name}-raw", stop="reconstruction")
    raw = pv.PolyData(raw.points.astype(float), raw.faces)
    if edge is None:
        edge = raw_report["remeshing"]["guidance_field"]["median"]
    uniform = [f"surface.edge_length={edge:.4f} mm"]
    rows, own, ratio = [], [], {}
    closed = [*uniform, "surface.remesher=isotropic", 'openings.detect="off"']
    for label, remesher in [("isotropic", "isotropic"), ("advancing front", "advancing-front")]:
        # Closed like the peers' surfaces: no openings.
        report, surface = mesh(mask, WORK / f"{name}-{remesher}", *uniform, f"surface.remesher={remesher}", 'openings.detect="off"')
        rows.append((label, surface, seconds(report, "remesh"), report["surface"].get("front_fraction")))
    wanted = rows[0][1].n_cells
    peers = [("pyacvd", lambda: acvd(raw, wanted)), ("PyMeshLab isotropic", lambda: meshlab(raw, edge)), ("CGAL (pygalmesh)", lambda: cgal(raw, edge))]
    for label, run in peers:
        try:
            surface, taken = run()
        except ImportError as e:
            print(f"skipped: {label}: {e}", flush=True)
            lines.append(f"| {name} | {label} | skipped: not installed | | | | | | |")
            continue
        rows.append((label, surface, taken, None))
        # Our own time again beside each peer's: on a machine that does other things too only neighbours compare.
        own.append(seconds(mesh(mask, WORK / f"{name}-again", *closed)[0], "remesh"))
        ratio[label] = taken / own[-1]
    rows[0] = (*rows[0][:2], statistics.median([rows[0][2], *own]), rows[0][3])
    for label, surface, taken, fraction in rows:
        f = shape(surface)
        note = f" ({100 * fraction:.1f} % by the front)" if fraction is not None else ""
        lines.append(
            f"| {name} | {label}{note} | {surface.n_cells} | {f['edge']:.3f} | {f['s'].max():.3f} | {f['s'].mean():.3f} | {f['ratio']:.2f} "
            f"| {'yes' if f['closed'] else 'no'} | {taken:.2f} | {ratio.get(label, taken / rows[0][2]):.1f} |"
        )
        print(lines[-1], flush=True)
        picture(surface, f["s"], RESULTS / f"{name}-{label.split(' ')[0].lower()}.png", f"{label}: S max {f['s'].max():.2f}, mean {f['s'].mean():.3f}")


def whole_way(name, mask, lines):
    """Mask to surface beside TetGen filling that surface as it is: radius-edge 1.4, dihedral 18 degrees, faces kept."""
    import tetgen
    report, surface = mesh(mask, WORK / f"{name}-surface")
    times = []
    for _ in range(3):
        start = time.perf_counter()
        fill = tetgen.TetGen(pv.PolyData(surface.points.astype(float), surface.faces))
        fill.tetrahedralize(order=1, mindihedral=18, minratio=1.4, nobisect=True)
        times.append(time.perf_counter() - start)
    taken = statistics.median(times)
    ours = seconds(report, "guidance field", "remesh", "openings")
    way = seconds(report, "read", "clean", "reconstruct", "polygonize", "centerlines", "guidance field", "remesh", "openings")
    lines.append(f"| {name} | {report['surface']['faces']} | {way:.2f} | {ours:.2f} | {taken:.2f} | {way / taken:.1f} | {ours / taken:.1f} |")
    print(lines[-1], flush=True)


def scaling(mask, largest, lines, done):
    first = None
    for wanted in (10_000, 30_000, 100_000, 300_000, 1_000_000):
        if wanted > largest:
            break
        report, surface = mesh(mask, WORK / "scaling", f"surface.target_faces={wanted}", 'openings.detect="off"')
        per_face = 1e6 * seconds(report, "remesh") / surface.n_cells
        first = first or per_face
        s = report["surface"]
        lines.append(f"| {wanted} | {surface.n_cells} | {s['s_max']:.3f} | {s['s_mean']:.3f} | {seconds(report, 'remesh'):.2f} | {per_face:.1f} | {per_face / first:.2f} |")
        print(lines[-1], flush=True)
        done()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=["aneurysm", "bifurcation"])
    parser.add_argument("--edge", type=float, help="edge length, mm; the guidance field's median without it")
    parser.add_argument("--largest", type=int, default=1_000_000, help="triangles up to which growth is measured; 0: not")
    options = parser.parse_args()
    RESULTS.mkdir(parents=True, exist_ok=True)
    WORK.mkdir(parents=True, exist_ok=True)
    peers = ["| case | remesher | faces | mean edge (mm) | S max | S mean | area ratio p99 | closed manifold | seconds | × isotropic |", "|-|-|-|-|-|-|-|-|-|-|"]
    way = ["| case | faces | mask to surface (s) | guidance, remeshing, cuts (s) | TetGen's fill (s) | mask to surface / fill | remeshing / fill |", "|-|-|-|-|-|-|-|"]
    grow = ["| wanted | faces | S max | S mean | seconds | µs a face | × first |", "|-|-|-|-|-|-|-|"]
    for given in options.names:
        mask, name = Path(given), Path(given).name.split(".")[0]
        if not mask.exists():
            shutil.rmtree(WORK / name, ignore_errors=True)
            subprocess.run([PROGRAM, "phantom", given, "-o", WORK / name], check=True, capture_output=True)
            mask = WORK / name / "mask.nrrd"
        compare(name, mask, options.edge, peers)
        save(peers, way, grow)
        whole_way(name, mask, way)
        save(peers, way, grow)
    if options.largest:
        scaling(mask, options.largest, grow, lambda: save(peers, way, grow))


def save(peers, way, grow):
    """Writes what there is: a run that is stopped keeps it."""
    text = ["# Remeshing beside its peers", "", "Made by `validation/remeshing/run.sh`. All start from the same polygonized surface, at the same edge length, without openings.",
            "Seconds are of one machine and one run: only ratios mean anything.", "", *peers, "",
            "## The whole way beside TetGen's fill", "", *way, ""]
    if len(grow) > 2:
        text += ["## Time a face as meshes grow", "", *grow, ""]
    text += ["## Pictures", ""] + [f"![{p.stem}]({p.name})" for p in sorted(RESULTS.glob("*.png"))] + [""]
    notes = RESULTS / "notes.md"
    if notes.exists():
        text += [notes.read_text()]
    (RESULTS / "README.md").write_text("\n".join(text))


if __name__ == "__main__":
    main()
