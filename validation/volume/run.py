"""Fills the same surfaces with our volume stage and with other meshers, and measures all of them by the same definitions.

Surfaces are made by `lumenmesh mesh MASK --stop-after surface`; every mesh is measured by `lumenmesh check`, whose numbers
equal checkMesh's (tests/openfoam.rs). Ours are given to checkMesh itself as well. Peers are told to keep the surface and
to aim at its mean edge length. Writes validation/results/volume/table.md and table.json.
"""
import json
import os
import pathlib
import resource
import shutil
import subprocess
import sys
import time

from foam import check_mesh

ROOT = pathlib.Path(__file__).resolve().parents[2]
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"
OUT = ROOT / "validation/results/volume"
WORK = ROOT / "target/validation/volume"
PHANTOMS = ["tube", "aneurysm", "bifurcation", "stenosis"]
LIMIT = 300  # seconds for one mesh


def read_ply(path):
    """Points and triangles of a PLY file as lumenmesh writes it (meshio stops at scalars after a face's list)."""
    import numpy as np
    types = {"uchar": "u1", "int": "<i4", "uint": "<u4", "float": "<f4", "double": "<f8"}
    head, data = pathlib.Path(path).read_bytes().split(b"end_header\n", 1)
    count, fields, element = {}, {"vertex": [], "face": []}, None
    for words in (line.split() for line in head.decode().splitlines()):
        if words[0] == "element":
            element = words[1]
            count[element] = int(words[2])
        elif words[:2] == ["property", "list"]:
            fields[element] += [("n", types[words[2]]), (words[4], types[words[3]], 3)]
        elif words[0] == "property":
            fields[element].append((words[2], types[words[1]]))
    vertex = np.frombuffer(data, fields["vertex"], count["vertex"])
    face = np.frombuffer(data, fields["face"], count["face"], vertex.nbytes)
    return np.stack([vertex[x] for x in "xyz"], 1), face["vertex_indices"].astype("int64")


def mean_edge(points, triangles):
    import numpy as np
    corners = points[triangles]
    return float(np.mean([np.linalg.norm(corners[:, i] - corners[:, (i + 1) % 3], axis=1).mean() for i in range(3)]))


def write(path, points, tets):
    import meshio
    meshio.write(path, meshio.Mesh(points, [("tetra", tets)]), file_format="gmsh22", binary=False)


def tetgen(surface):
    import tetgen as package
    points, triangles = read_ply(surface)
    h = mean_edge(points, triangles)
    mesher = package.TetGen(points, triangles)
    nodes, tets = mesher.tetrahedralize(switches=f"pYq1.4/10a{h ** 3 / 3:.9g}Q")[:2]
    return nodes, tets


def mmg(surface):
    """MMG3D's optimiser on TetGen's mesh, the surface kept."""
    import mmgpy
    nodes, tets = tetgen(surface)
    mesh = mmgpy.MmgMesh3D(nodes, tets.astype("int32"))
    mesh.remesh(optim=True, nosurf=True, verbose=-1)
    return mesh.get_vertices(), mesh.get_tetrahedra()


def gmsh(surface):
    """gmsh's Delaunay mesher with its own optimiser and Netgen's."""
    import gmsh as api
    import numpy as np
    points, triangles = read_ply(surface)
    api.initialize()
    api.option.setNumber("General.Terminal", 0)
    face = api.model.addDiscreteEntity(2, 1)
    api.model.mesh.addNodes(2, face, list(range(1, len(points) + 1)), points.ravel())
    api.model.mesh.addElementsByType(face, 2, [], (triangles + 1).ravel())
    api.model.geo.addVolume([api.model.geo.addSurfaceLoop([face])])
    api.model.geo.synchronize()
    api.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 1)
    api.option.setNumber("Mesh.MeshSizeMax", mean_edge(points, triangles))
    api.option.setNumber("Mesh.Optimize", 1)
    api.option.setNumber("Mesh.OptimizeNetgen", 1)
    api.model.mesh.generate(3)
    ids, coordinates, _ = api.model.mesh.getNodes()
    _, nodes = api.model.mesh.getElementsByType(4)
    order = np.zeros(int(ids.max()) + 1, dtype=int)
    order[ids.astype(int)] = np.arange(len(ids))
    return coordinates.reshape(-1, 3), order[nodes.astype(int)].reshape(-1, 4)


def pygalmesh(surface):
    """CGAL's mesher; it makes a surface of its own."""
    import pygalmesh as package
    points, triangles = read_ply(surface)
    h = mean_edge(points, triangles)
    mesh = package.generate_volume_mesh_from_surface_mesh(
        surface, max_edge_size_at_feature_edges=h, max_facet_distance=h / 20, max_cell_circumradius=0.7 * h, verbose=False
    )
    return mesh.points, mesh.cells_dict["tetra"]


PEERS = {"TetGen 1.6 (PyPI)": tetgen, "MMG3D after TetGen": mmg, "gmsh + Netgen": gmsh, "CGAL (pygalmesh)": pygalmesh}


def peer(name, surface, out):
    begin = time.perf_counter()
    points, tets = PEERS[name](surface)
    seconds = time.perf_counter() - begin
    import numpy as np
    corners = points[tets]
    volume = np.einsum("ij,ij->i", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 3] - corners[:, 0])
    tets = np.where((volume < 0)[:, None], tets[:, [1, 0, 2, 3]], tets)
    write(out, points, tets)
    print(seconds)


def measure(path):
    done = subprocess.run([TARGET / "lumenmesh", "check", path, "--json"], capture_output=True, text=True)
    if not done.stdout:
        raise RuntimeError(done.stderr.strip())
    return json.loads(done.stdout)["volume"]


def verdict(q):
    f = q["openfoam"]
    bad = [name for name in ("nonpositive_volumes", "non_orthogonality_errors", "wrong_pyramids", "skewness_over_4", "determinant_under_0001",
                             "wrong_face_tets", "concave_cells", "weight_under_005", "volume_ratio_under_001") if f[name]]
    return "Mesh OK" if not bad else ", ".join(f"{f[b]} {b}" for b in bad)


def row(case, mesher, q, seconds, said=None):
    return {
        "case": case, "mesher": mesher, "tets": q["tets"], "prisms": q["prisms"], "sv_max": q["sv_max"], "sv_mean": q["sv_mean"],
        "over_080": q["sv_over_080"], "over_090": q["sv_over_090"], "dihedral": [q["min_dihedral"], q["max_dihedral"]],
        "non_orthogonality": q["openfoam"]["non_orthogonality_max"], "determinant": q["openfoam"]["determinant_min"],
        "orthogonal_quality": q["fluent"]["orthogonal_quality_min"], "checkmesh": said or verdict(q), "seconds": seconds,
    }


def ours(case, surface, layers=0, cells=None):
    folder = WORK / case / f"ours{layers}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command = [TARGET / "examples/surface_to_volume", surface, "--openfoam", folder]
    command += ["--layers", str(layers)] if layers else []
    command += ["--target-cells", str(cells)] if cells else []
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip())
    out = json.loads(done.stdout)
    build = out["build"]
    name = f"lumenmesh, {layers} layers" if layers else "lumenmesh"
    r = row(case, name, out["quality"], out["seconds"]["all"], check_mesh(folder)[0])
    r["tetgen_seconds"] = out["seconds"]["tetgen"]
    r["optimiser_seconds"] = out["seconds"]["optimiser"]
    r["size_ratio"] = build["fill"]["size_ratio"]
    r["estimated_cells"] = build["fill"]["estimated_cells"]
    if build["layers"]:
        r["area_at_full_thickness"] = build["layers"]["area_at_full_thickness"]
    return r


def surfaces(masks):
    if not masks:
        for name in PHANTOMS:
            folder = WORK / "phantoms" / name
            if not (folder / "mask.nrrd").is_file():
                subprocess.run([TARGET / "lumenmesh", "phantom", name, "-o", folder], check=True)
            yield name, folder / "mask.nrrd"
        masks = [p for p in sorted((ROOT / "../shared/data").glob("*")) if p.name.split(".", 1)[-1] in ("nrrd", "mha", "nii.gz")]
        masks += [p for p in sorted((ROOT / "../shared/data/phantoms").glob("*")) if p.name.split(".", 1)[-1] in ("nrrd", "nii.gz")]
        # The airway is a tree of hundreds of ends, the large aortas take minutes: name them to have them.
        masks = [m for m in masks if not m.name.startswith(("airway", "abd_", "ts_"))]
    for mask in masks:
        yield pathlib.Path(mask).name.split(".")[0], pathlib.Path(mask)


def main():
    if sys.argv[1:2] == ["--peer"]:
        peer(*sys.argv[2:5])
        return
    OUT.mkdir(parents=True, exist_ok=True)
    rows, skipped = [], set()
    for case, mask in surfaces(sys.argv[1:]):
        folder = WORK / case / "surface"
        if not (folder / "surface/lumen.vtp").is_file():
            command = [TARGET / "lumenmesh", "mesh", mask, "-o", folder, "--stop-after", "surface", "--quiet", "--set", "exports=[vtk, ply]"]
            done = subprocess.run(command, capture_output=True, text=True)
            if not (folder / "surface/lumen.vtp").is_file():
                print(f"SKIPPED: {case}: {done.stderr.strip()}", flush=True)
                continue
        vtp, ply = folder / "surface/lumen.vtp", folder / "surface/lumen.ply"
        for layers in (0, 4):
            rows.append(ours(case, vtp, layers))
            print(line(rows[-1]), flush=True)
        for name in PEERS:
            out = WORK / case / f"{name.split()[0]}.msh"
            try:
                done = subprocess.run([sys.executable, __file__, "--peer", name, ply, out], capture_output=True, text=True, timeout=LIMIT)
            except subprocess.TimeoutExpired:
                print(f"{case}: {name} did not end within {LIMIT} s", flush=True)
                continue
            if done.returncode:
                said = (done.stderr.strip().splitlines() or ["no message"])[-1]
                if "ModuleNotFoundError" in said:
                    skipped.add(f"{name}: {said.split(': ', 1)[1]}")
                print(f"SKIPPED: {case}: {name}: {said}", flush=True)
                continue
            rows.append(row(case, name, measure(out), float(done.stdout.split()[-1])))
            print(line(rows[-1]), flush=True)
            save(rows, None, skipped)
    big = None
    first = next((r["case"] for r in rows if r["case"] in ("coronary_thin", "aneurysm")), rows[0]["case"])
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    big = ours(first, WORK / first / "surface/surface/lumen.vtp", cells=1_050_000)
    big["peak_mib"] = max(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, before) / 1024
    save(rows, big, skipped)
    print(OUT / "table.md")


def save(rows, big, skipped):
    (OUT / "table.json").write_text(json.dumps({"rows": rows, "million": big, "skipped": sorted(skipped)}, indent=1) + "\n")
    (OUT / "table.md").write_text(page(rows, big, skipped))


HEAD = "| case | mesher | tets | prisms | S_V max | mean | > 0.8 | > 0.9 | dihedral | non-orth | det min | OQ min | checkMesh | s |"


def line(r):
    return "| {case} | {mesher} | {tets} | {prisms} | {sv_max:.3f} | {sv_mean:.3f} | {over_080} | {over_090} | {dihedral[0]:.1f}–{dihedral[1]:.1f}° | {non_orthogonality:.1f}° | {determinant:.4f} | {orthogonal_quality:.3f} | {checkmesh} | {seconds:.1f} |".format(**r)


def page(rows, big, skipped):
    own = [r for r in rows if "tetgen_seconds" in r]
    ratios = [r["optimiser_seconds"] / r["tetgen_seconds"] for r in own]
    text = "# Volume meshes beside those of other meshers, same surfaces\n\nMade by `validation/volume/run.sh`. "
    text += "All meshes measured by `lumenmesh check`; ours also by checkMesh -allGeometry -allTopology itself.\n\n"
    text += HEAD + "\n" + "|-" * (HEAD.count("|") - 1) + "|\n" + "\n".join(line(r) for r in rows) + "\n\n"
    text += f"Optimiser over TetGen, time within one run: median {sorted(ratios)[len(ratios) // 2]:.2f}, largest {max(ratios):.2f} (aim 1, limit 3).\n\n"
    text += "Interior edges over wished ones, 5th to 95th percentile, worst case: "
    text += f"{min(r['size_ratio'][0] for r in own):.2f} to {max(r['size_ratio'][2] for r in own):.2f} (limit 1/1.5 to 1.5).\n\n"
    layered = [r for r in own if "area_at_full_thickness" in r]
    text += "Wall with at least 95 % of the wished layer thickness: " + ", ".join(f"{r['case']} {100 * r['area_at_full_thickness']:.1f} %" for r in layered) + ".\n\n"
    if big:
        text += f"{big['tets']} tetrahedra ({big['case']}, target 1 050 000): S_V max {big['sv_max']:.3f}, {big['checkmesh']}, largest process {big['peak_mib']:.0f} MiB, {big['seconds']:.0f} s.\n"
    if skipped:
        text += "\nSkipped: " + "; ".join(sorted(skipped)) + ".\n"
    return text


if __name__ == "__main__":
    main()
