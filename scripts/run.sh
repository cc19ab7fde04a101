#!/usr/bin/env bash
# Installs what is missing, builds lumenmesh and meshes the built-in aneurysm: scripts/run.sh [OUTPUT]
set -euo pipefail
. "$(dirname "$0")/lib.sh"
build_tools
cd "$here"
out=${1:-out}
say "building: some five minutes on two cores the first time"
cargo build --release --quiet
case_dir=$out/case
target/release/lumenmesh phantom aneurysm -o "$case_dir"
say "meshing $case_dir/case.yaml"
code=0
target/release/lumenmesh run "$case_dir/case.yaml" -o "$out/aneurysm" || code=$?
echo
echo "surface        $out/aneurysm/surface/lumen.vtp      (ParaView; also lumen.stl)"
echo "volume mesh    $out/aneurysm/volume/lumen.vtu"
echo "solver case    $out/aneurysm/openfoam               (./Allrun with Debian's openfoam)"
echo "report         $out/aneurysm/report.html"
exit $code
