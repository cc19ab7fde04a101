#!/bin/sh
# Remeshing beside its peers: validation/remeshing/run.sh [PHANTOM|MASK...]; PYTHON names an interpreter that has the
# packages of requirements.txt already. pygalmesh (CGAL) takes part where it can be built: it needs Debian's libcgal-dev
# and libeigen3-dev.
set -e
cd "$(dirname "$0")/../.."
cargo build --release
if [ -z "$PYTHON" ]; then
    python3 -m venv target/validation/venv
    target/validation/venv/bin/pip install --quiet -r validation/remeshing/requirements.txt
    target/validation/venv/bin/pip install --quiet pygalmesh || echo "CGAL is skipped: pygalmesh could not be built" >&2
    PYTHON=target/validation/venv/bin/python
fi
exec "$PYTHON" validation/remeshing/run.py "$@"
