#!/usr/bin/env bash
# Every export of many masks through somebody else's reader: validation/exports/run.sh [--only NAME] [--set KEY=VALUE]... [MASK...]
# PYTHON names an interpreter that has the packages of tests/requirements.txt already.
set -euo pipefail
. "$(dirname "$0")/../../scripts/lib.sh"
build_tools
cd "$here"
cargo build --release --quiet --bins --examples
if [ -z "${PYTHON:-}" ]; then
    python3 -m venv target/validation/venv
    target/validation/venv/bin/pip install --quiet -r tests/requirements.txt
    PYTHON=target/validation/venv/bin/python
fi
exec "$PYTHON" validation/exports/run.py "$@"
