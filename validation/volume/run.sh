#!/bin/sh
# Our volume meshes beside those of other meshers on the same surfaces: validation/volume/run.sh [MASK...]
# PYTHON names an interpreter that has the packages already.
set -e
cd "$(dirname "$0")/../.."
cargo build --release --bin lumenmesh --example surface_to_volume
if [ -z "$PYTHON" ]; then
    python3 -m venv target/validation/volume-venv
    PYTHON=target/validation/volume-venv/bin/python
    for package in "meshio numpy" tetgen gmsh mmgpy pygalmesh; do
        # shellcheck disable=SC2086
        "$PYTHON" -m pip install --quiet $package || echo "SKIPPED: $package does not install here"
    done
fi
exec "$PYTHON" validation/volume/run.py "$@"
