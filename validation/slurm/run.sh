#!/usr/bin/env bash
# Twenty random vessel trees as a cohort: with `lumenmesh batch` (killed half-way and resumed), through Snakemake on a real
# SLURM of one node (cancelled half-way and resumed), and one by one; all three must give the same bytes.
# validation/slurm/run.sh [FOLDER]: needs root and a Debian machine without a SLURM of its own; loopback only.
# LUMENMESH names another program. Writes validation/results/cohort/README.md.
set -euo pipefail
. "$(dirname "$0")/../../scripts/lib.sh"
cd "$here"
work=${1:-$(mktemp -d)}
program=${LUMENMESH:-$here/target/release/lumenmesh}
trees=${TREES:-20}
set_scale=${SCALE:-2.5}
[ "$(id -u)" -eq 0 ] || { echo "SKIPPED: starting a SLURM needs root" >&2; exit 77; }
debian slurm-wlm munge
snakemake=${SNAKEMAKE:-}
if [ -z "$snakemake" ]; then
  python_env "$here/validation/slurm/requirements.txt" >/dev/null
  snakemake=$here/.venv/bin/snakemake
fi
mkdir -p "$work"

say "the cases"
names=()
for n in $(seq 1 "$trees"); do
  suffix=""
  [ $((n % 4)) -eq 0 ] && suffix=-anisotropic
  [ $((n % 5)) -eq 0 ] && suffix=-oblique
  names+=("tree-$n$suffix")
  [ -f "$work/cases/tree-$n$suffix/case.yaml" ] || "$program" phantom "tree-$n$suffix" -o "$work/cases/tree-$n$suffix" >/dev/null
done
inputs=("${names[@]/#/$work/cases/}")
inputs=("${inputs[@]/%//case.yaml}")

say "one by one"
start=$SECONDS
for n in "${names[@]}"; do
  [ -f "$work/single/$n/report.json" ] && continue
  "$program" run "$work/cases/$n/case.yaml" -o "$work/single/$n" --quiet --set "surface.scale=$set_scale" || [ $? -eq 6 ]
done
single=$((SECONDS - start))

# done_in FOLDER: cases that are done.
done_in() { find "$1" -mindepth 2 -maxdepth 2 -name report.json 2>/dev/null | wc -l; }
# wait_for FOLDER N PID: until N cases are done or the process has ended.
wait_for() { while [ "$(done_in "$1")" -lt "$2" ] && kill -0 "$3" 2>/dev/null; do sleep 0.5; done; }

say "lumenmesh batch, killed half-way"
batch=("$program" batch "${inputs[@]}" -o "$work/local" --jobs 2 --set "surface.scale=$set_scale")
rm -rf "$work/local"
"${batch[@]}" >"$work/local.log" 2>&1 &
pid=$!
wait_for "$work/local" $((trees / 2)) $pid
kill -KILL $pid
wait $pid 2>/dev/null || true
local_killed=$(done_in "$work/local")
say "resumed after $local_killed cases"
start=$SECONDS
"${batch[@]}" >>"$work/local.log" 2>&1 || [ $? -le 6 ]
local_kept=$(grep -c '(kept)' "$work/local.log" || true)

say "SLURM on this machine"
host=$(hostname -s)
state=$work/slurm
mkdir -p "$state/state" "$state/spool" /etc/slurm /run/munge /var/log/munge
cat >/etc/slurm/slurm.conf <<CONF
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
ReturnToService=2
SlurmctldPidFile=$state/slurmctld.pid
SlurmdPidFile=$state/slurmd.pid
SlurmctldLogFile=$state/slurmctld.log
SlurmdLogFile=$state/slurmd.log
StateSaveLocation=$state/state
SlurmdSpoolDir=$state/spool
MinJobAge=3600
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=8000
PartitionName=all Nodes=$host Default=YES State=UP
CONF
chown munge: /run/munge /var/log/munge /etc/munge /var/lib/munge 2>/dev/null || true
runuser -u munge -- munged --force
slurmctld
slurmd
cleanup() {
  for p in "$state/slurmd.pid" "$state/slurmctld.pid" /run/munge/munged.pid; do
    [ -f "$p" ] && kill "$(cat "$p")" 2>/dev/null || true
  done
}
trap cleanup EXIT
for _ in $(seq 60); do
  sinfo -h -o %T 2>/dev/null | grep -q idle && break
  sleep 0.5
done
srun -n1 hostname >/dev/null
sinfo

# No accounting database: the executor asks squeue, which keeps ended jobs for MinJobAge.
flow=("$snakemake" -s scripts/cohort/Snakefile --profile scripts/cohort/slurm --slurm-status-command squeue
  --slurm-init-seconds-before-status-checks 5 --seconds-between-status-checks 5
  --jobs 2 --latency-wait 10 --directory "$work/snake"
  --config "cases=$work/cases/*/case.yaml" "out=$work/cluster" "lumenmesh=$program" "set=surface.scale=$set_scale" threads=1 mem_mb=1500)
rm -rf "$work/cluster" "$work/snake"
mkdir -p "$work/snake"
say "Snakemake on SLURM, cancelled half-way"
"${flow[@]}" >"$work/cluster.log" 2>&1 &
pid=$!
wait_for "$work/cluster" $((trees / 2)) $pid
# One job is killed as a node failure would, then the workflow itself.
scancel "$(squeue -h -t R -o %i | head -1)" || true
kill -KILL $pid
wait $pid 2>/dev/null || true
scancel --user=root || true
sleep 3
cluster_killed=$(find "$work/cluster" -maxdepth 1 -name '*.exit' | wc -l)
say "resumed after $cluster_killed cases"
"${flow[@]}" --unlock >/dev/null 2>&1 || true
"${flow[@]}" >>"$work/cluster.log" 2>&1

say "compared"
compare() {
  local same=0
  for n in "${names[@]}"; do
    if diff -rq -x report.json -x report.html -x lumenmesh.log -x .lumenmesh "$work/single/$n" "$1/$n" >>"$work/diff.log"; then
      same=$((same + 1))
    fi
  done
  echo $same
}
: >"$work/diff.log"
local_same=$(compare "$work/local")
cluster_same=$(compare "$work/cluster")
met=$(grep -cE ',met( with warnings)?,' "$work/cluster/cohort.csv" || true)
out=validation/results/cohort
mkdir -p "$out"
{
  echo "# A cohort on one machine and on SLURM"
  echo "\`validation/slurm/run.sh\`: $trees random trees (every fourth anisotropic, every fifth oblique), \`surface.scale\` $set_scale."
  echo
  echo "| way | done when killed | kept on resuming | results | identical to single runs |"
  echo "|---|---|---|---|---|"
  echo "| \`lumenmesh batch --jobs 2\`, killed with SIGKILL | $local_killed | $local_kept | $(done_in "$work/local") | $local_same |"
  echo "| Snakemake, SLURM $(sinfo --version | cut -d' ' -f2) on one node, one job cancelled, then killed | $cluster_killed | $cluster_killed | $(done_in "$work/cluster") | $cluster_same |"
  echo
  echo "All hard gates met: $met of $trees. Compared: every file but report.json, report.html and lumenmesh.log, which hold times."
} >"$out/README.md"
printf "\n![The top of cohort.html](cohort.png)\n" >>"$out/README.md"
cat "$out/README.md"
cat "$work/diff.log"
[ "$local_same" -eq "$trees" ] && [ "$cluster_same" -eq "$trees" ]
