"""(s) Which schemes: the tube of part (a), tetrahedra and prisms, solved with other gradients, fluxes and relaxation."""
import shutil

import foam, poiseuille, tools

LSQ, VISCOUS, UPWIND, RELAX = "default pointCellsLeastSquares;", "laplacian(nuEff,U) Gauss linear faceCorrected;", "bounded Gauss linearUpwind grad(U)", "equations { U 0.9; }"
CORRECTED = ("fvSchemes", VISCOUS, "")
POINT_U = "grad(U) Gauss pointLinear;"
POINT_P = ("fvSchemes", LSQ, LSQ + " grad(p) Gauss pointLinear;")
# What differs from the case as written: (file, text, replacement).
VARIANTS = {
    "as written": [],
    "viscous flux corrected instead of face-corrected": [CORRECTED],
    "grad(U) pointCellsLeastSquares": [("fvSchemes", POINT_U, "")],
    "grad(U) leastSquares": [("fvSchemes", POINT_U, "grad(U) leastSquares;")],
    "convection LUST": [("fvSchemes", "bounded Gauss linearUpwind", "bounded Gauss LUST")],
    "convection linearUpwindV": [("fvSchemes", "bounded Gauss linearUpwind", "bounded Gauss linearUpwindV")],
    "U relaxed by 0.8": [CORRECTED, ("fvSolution", RELAX, "equations { U 0.8; }")],
    "SIMPLE instead of SIMPLEC": [CORRECTED, ("fvSolution", "consistent yes", "consistent no"), ("fvSolution", "relaxationFactors { " + RELAX, "relaxationFactors { fields { p 0.3; } equations { U 0.7; }")],
    "grad(p) Gauss pointLinear": [CORRECTED, POINT_P],
    "grad(p) Gauss pointLinear, face-corrected": [POINT_P],
    "all gradients Gauss pointLinear": [CORRECTED, ("fvSchemes", LSQ, "default Gauss pointLinear;")],
    "grad(p) Gauss linear": [CORRECTED, ("fvSchemes", LSQ, LSQ + " grad(p) Gauss linear;")],
    "grad(p) leastSquares": [CORRECTED, ("fvSchemes", LSQ, LSQ + " grad(p) leastSquares;")],
    "grad(p) edgeCellsLeastSquares": [CORRECTED, ("fvSchemes", LSQ, LSQ + " grad(p) edgeCellsLeastSquares;")],
    "convection Gauss linear": [CORRECTED, ("fvSchemes", UPWIND, "bounded Gauss linear")],
    "convection Gauss linear, grad(p) Gauss pointLinear": [CORRECTED, POINT_P, ("fvSchemes", UPWIND, "bounded Gauss linear")],
}
PRISM_VARIANTS = ("as written", "grad(U) pointCellsLeastSquares", "viscous flux corrected instead of face-corrected")


def run():
    rows = []
    for layers, names in ((0, VARIANTS), (4, PRISM_VARIANTS)):
        work = tools.WORK / f"s/{layers}"
        report = tools.mesh(poiseuille.case(work, 8, (0, 0, 0)), work / "out", [f"volume.boundary_layers.count={layers}"])
        for k, name in enumerate(names):
            case = work / f"case_{k}"
            shutil.rmtree(case, ignore_errors=True)
            shutil.copytree(work / "out/openfoam", case)
            for file, old, new in VARIANTS[name]:
                path = case / "system" / file
                text = path.read_text()
                if old not in text:
                    raise SystemExit(f"{path} has no `{old}`")
                path.write_text(text.replace(old, new))
            solved = foam.solve(case)
            row = {"layers": layers, "name": name, **solved, **{k: float(v) for k, v in poiseuille.measure(case, report).items()}}
            rows.append(row)
            print(row, flush=True)
    return {"rows": rows, "checks": []}
