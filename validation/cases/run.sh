#!/usr/bin/env bash
# The main job on many masks: validation/cases/run.sh [--only NAME] [--set KEY=VALUE]... [MASK...]
set -euo pipefail
. "$(dirname "$0")/../../scripts/lib.sh"
build_tools
cd "$here"
cargo build --release --quiet
exec python3 validation/cases/run.py "$@"
