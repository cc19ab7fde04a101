#!/bin/sh
# Proof by flow, with Debian's openfoam: validation/flow/run.sh [a] [b] [c] [d] [e] [s] [MASK for c]; a to e without arguments.
# PYTHON names an interpreter that has the packages of validation/flow/requirements.txt already.
set -e
cd "$(dirname "$0")/../.."
command -v simpleFoam >/dev/null || { echo "simpleFoam is missing: install Debian's package openfoam" >&2; exit 1; }
if [ -z "$LUMENMESH" ]; then
    cargo build --release --examples --bins
    LUMENMESH=target/release/lumenmesh
fi
export LUMENMESH
if [ -z "$PYTHON" ]; then
    python3 -m venv target/validation/venv
    target/validation/venv/bin/pip install --quiet -r validation/flow/requirements.txt
    PYTHON=target/validation/venv/bin/python
fi
exec "$PYTHON" validation/flow/run.py "$@"
