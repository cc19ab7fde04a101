#!/bin/sh
# Accuracy beside peers: validation/accuracy/run.sh [DATA [NAME...]]; PYTHON names an interpreter that has the packages already.
set -e
cd "$(dirname "$0")/../.."
cargo build --release --bin lumenmesh --example mask_to_surface --example random_phantoms
if [ -z "$PYTHON" ]; then
    python3 -m venv target/validation/venv
    target/validation/venv/bin/pip install --quiet vtk numpy SimpleITK
    PYTHON=target/validation/venv/bin/python
fi
exec "$PYTHON" validation/accuracy/run.py "$@"
