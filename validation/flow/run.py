#!/usr/bin/env python3
"""Flow through lumenmesh's meshes, solved by OpenFOAM and held against laws.

    validation/flow/run.sh [a] [b] [c] [d] [e] [s] [MASK]

a  Poiseuille flow through an oblique tube, three sub-voxel positions, without and with prism layers
b  a 90 degree bend and a Y bifurcation: mass balance and convergence
c  the aneurysm phantom, and the real aneurysm MASK where given: convergence, WSS on several sizes, grid convergence
d  the aneurysm phantom's surface from the paper profile and from marching cubes: how the WSS differs
e  a series of three meshes of the aneurysm phantom, without and with prism layers: its grid-convergence table, filled
s  the tube of a with other schemes; on request only

Each part writes validation/results/flow/<part>.json and pictures; README.md is made of all parts that are there.
"""
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import page
import tools


PARTS = {"a": "poiseuille", "b": "bends", "c": "aneurysm", "d": "surfaces", "e": "series", "s": "schemes"}


def main():
    parts = [p for p in sys.argv[1:] if p in PARTS] or ["a", "b", "c", "d", "e"]
    masks = [Path(p).resolve() for p in sys.argv[1:] if p not in PARTS]
    good = True
    for part in parts:
        module = __import__(PARTS[part])
        result = module.run(masks) if part == "c" else module.run()
        tools.save(part, result)
        good &= all(c["passed"] for c in result["checks"])
        for c in result["checks"]:
            print(("met     " if c["passed"] else "MISSED  ") + f"{c['name']}: {c['value']:.4g} (limit {c['limit']:g})", flush=True)
        page.write()
    sys.exit(0 if good else 1)


main()
