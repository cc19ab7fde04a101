#!/usr/bin/env bash
# Installs what the tests need and runs them all: scripts/test.sh [arguments of cargo test]
set -euo pipefail
. "$(dirname "$0")/lib.sh"
build_tools
debian openfoam
cd "$here"
LUMENMESH_PYTHON=$(python_env tests/requirements.txt)
export LUMENMESH_PYTHON
say "running the tests"
cargo test --workspace --quiet "$@"
