#!/usr/bin/env bash
# Damages sound files of every format that is read, CASES times each (default 100 000), within 4 GB of address space:
# validation/fuzz/run.sh [CASES]. Writes validation/results/fuzz/README.md.
set -euo pipefail
. "$(dirname "$0")/../../scripts/lib.sh"
build_tools
cd "$here"
cases=${1:-100000}
cargo test --release --test damaged_files --no-run
log=$(mktemp)
trap 'rm -f "$log"' EXIT
start=$SECONDS
# `ulimit -v` makes an allocation of an announced size fail where it would otherwise only be reserved.
(ulimit -v 4000000; LUMENMESH_FUZZ_CASES=$cases cargo test --release --test damaged_files -- --nocapture --test-threads 1) | tee "$log"
out=validation/results/fuzz
mkdir -p "$out"
{
  echo "# Damaged files"
  echo "\`validation/fuzz/run.sh $cases\`: every sound file damaged $cases times (bytes changed, cut, inserted, removed, moved; numbers"
  echo "replaced by 0, -1, 2³², 2⁶⁴-1, 1e308, nan, …), read, and where it reads, measured as \`lumenmesh check\` does. No panic; the whole"
  echo "run within 4 GB of address space. Memory is the highest of the process so far."
  echo
  echo "| format | bytes | damaged | refused with a sentence | memory (MB) |"
  echo "|---|---|---|---|---|"
  grep -oE '\| [A-Za-z-].*\|$' "$log" | LC_ALL=C sort
} >"$out/README.md"
echo "$((SECONDS - start)) s; $out/README.md"
