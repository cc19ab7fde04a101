#!/bin/sh
# The paper's evaluation: validation/paper/run.sh [MASK...]; PYTHON names an interpreter that has the packages already.
set -e
cd "$(dirname "$0")/../.."
cargo build --release --example mask_to_surface
if [ -z "$PYTHON" ]; then
    python3 -m venv target/validation/venv
    target/validation/venv/bin/pip install --quiet vtk numpy SimpleITK
    PYTHON=target/validation/venv/bin/python
fi
exec "$PYTHON" validation/paper/run.py "$@"
