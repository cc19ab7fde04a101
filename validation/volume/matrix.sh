#!/usr/bin/env bash
# Every case at two sizes, with and without layers: validation/volume/matrix.sh [--only NAME] [--scale F] [--layers N] [MASK...]
set -euo pipefail
. "$(dirname "$0")/../../scripts/lib.sh"
build_tools
cd "$here"
cargo build --release --quiet
exec python3 validation/volume/matrix.py "$@"
