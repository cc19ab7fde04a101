"""OpenFOAM's own checkMesh on a mesh that was written."""
import os
import shutil
import subprocess

HEAD = "FoamFile{version 2.0;format ascii;class dictionary;object dictionary;}\n"


def check_mesh(folder):
    """checkMesh's verdict and its largest non-orthogonality, degrees; nothing where it is not installed.

    Writes the dictionaries that checkMesh wants where the folder has a mesh alone.
    """
    if not shutil.which("checkMesh"):
        return None, None
    if not (folder / "system/controlDict").is_file():
        (folder / "system").mkdir(parents=True, exist_ok=True)
        (folder / "system/controlDict").write_text(
            HEAD + "startFrom startTime;startTime 0;stopAt endTime;endTime 1;deltaT 1;writeControl timeStep;writeInterval 1;\n"
        )
        (folder / "system/fvSchemes").write_text(
            HEAD + "ddtSchemes{} gradSchemes{} divSchemes{} laplacianSchemes{} interpolationSchemes{} snGradSchemes{}\n"
        )
        (folder / "system/fvSolution").write_text(HEAD + "solvers{}\n")
    env = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ}
    log = subprocess.run(["checkMesh", "-allGeometry", "-allTopology"], cwd=folder, env=env, capture_output=True, text=True).stdout
    angles = [float(line.split("Max:")[1].split()[0]) for line in log.splitlines() if "non-orthogonality Max:" in line]
    angle = angles[0] if angles else None
    if "Mesh OK." in log:
        return "Mesh OK", angle
    return "; ".join(line.strip(" *") for line in log.splitlines() if line.startswith(" ***")) or "no verdict", angle
