#!/usr/bin/env bash
# A real Slurm cluster of three nodes on this machine makes a batch of 24 shards; a task is told that its time is nearly up,
# and one node's power is cut in the middle: both are started anew. What comes of it must have the bytes of a single
# machine's run.
#
# Needs root and Debian's packages of Slurm; without them it says so and ends well.
set -euo pipefail
cd "$(dirname "$0")/../.."

skip() { echo "skipped: $*"; exit 0; }
[ "$(id -u)" = 0 ] || skip "only root can start a cluster of its own"
unshare --pid --fork true 2>/dev/null || skip "no namespaces can be made here"

program=${CARGO_TARGET_DIR:-$PWD/target}/release/whit
[ -x "$program" ] || cargo build --release --quiet
folder=$(mktemp -d /tmp/whs.XXXX)
# The daemon that signs messages is nobody in particular, and its socket lies within.
chmod 755 "$folder"
export SLURM_BASE=$folder/c SLURM_NODES=3 SLURM_CPUS=2
trap 'tests/ci/slurm-down.sh >/dev/null 2>&1 || true; rm -rf "$folder"' EXIT
if ! said=$(tests/ci/slurm-up.sh 2>&1); then
    echo "$said" | tail -3
    skip "no cluster can be had here"
fi
. "$SLURM_BASE/env"

# Six frames in four pieces each: 24 shards, and the last piece of a frame puts it together.
cat >"$folder/film.jobs.toml" <<JOBS
[[job]]
scene = "$PWD/scenes/glass_of_water.toml"
frames = 6
turntable = {}
split = { bands = 2, shares = 2 }
settings = { size = "240x180", spp = 64, pattern = "sobol", isa = "avx2" }
image = "{frame}.exr"
JOBS
grep -qw avx2 /proc/cpuinfo || sed -i 's/, isa = "avx2"//' "$folder/film.jobs.toml"
if ! "$program" --version | grep -q "(Embree"; then sed -i 's/, isa = "avx2"//' "$folder/film.jobs.toml"; fi

"$program" batch "$folder/film.jobs.toml" --out "$folder/single" --quiet
"$program" batch "$folder/film.jobs.toml" --out "$folder/out" --slurm "$folder/film.sh" --shards 24 --threads 1 --quiet
# A node of this small cluster has no memory of its own to share out.
sed -i '/^#SBATCH --mem=/d' "$folder/film.sh"
grep -q '^#SBATCH --array=1-24$' "$folder/film.sh"
job=$(sbatch --parsable --chdir="$folder" --output="$folder/%a.log" "$folder/film.sh")

pieces() { find "$folder/out" -name '*.exr' | wc -l; }
within() { # SECONDS COMMAND...: until it holds
    local end=$((SECONDS + $1))
    shift
    until "$@"; do
        [ $SECONDS -lt $end ] || { echo "not within time: $*"; squeue; cat "$folder"/*.log; return 1; }
        sleep 0.2
    done
}
some_are_there() { [ "$(pieces)" -ge 4 ]; }
running() { squeue -h -j "$job" -t R -w n2 -o %i | tr '\n' ' '; }
# A controller that does not answer has not said that it is over.
is_over() { local left; left=$(squeue -h -j "$job" -o %i) && [ -z "$left" ]; }
node_is_busy() { [ -n "$(running)" ] || is_over; }

# Those that have run for a second or more.
late() {
    local task
    for task in $(squeue -h -j "$job" -t R -o '%i %M' | awk '$2 != "0:00" { print $1 }'); do
        scancel --signal=USR1 --batch "$task" 2>/dev/null || true
    done
    sleep 1
    grep -ls interrupted "$folder"/*.log >"$folder/late" || is_over
}

within 300 some_are_there
within 120 late
echo "told that their time is nearly up: tasks $(xargs -rn1 basename -s .log <"$folder/late" | xargs)"
within 120 node_is_busy
lost=$(running)
"$SLURM_BASE/kill-node" 2
scontrol update nodename=n2 state=down reason="power cut"
echo "power of n2 cut with ${lost:-nothing} running and $(pieces) files there"
sleep 3
"$SLURM_BASE/start-node" 2 || true
within 900 is_over
"$program" merge "$folder/out" --quiet
for picture in "$folder"/single/*.exr; do
    cmp "$picture" "$folder/out/$(basename "$picture")"
done
for log in $(cat "$folder/late"); do
    task=$(basename -s .log "$log")
    restarts=$(scontrol show job "${job}_$task" | grep -o 'Restarts=[0-9]*')
    [ "$restarts" != Restarts=0 ] || { echo "task $task was not put back"; exit 1; }
done
[ -s "$folder/late" ] || { echo "no task was told in time"; exit 1; }
[ "$(find "$folder/single" -maxdepth 1 -name '*.exr' | wc -l)" = 6 ]
echo "six frames by 24 shards on three nodes, one of them cut off, some tasks put back: the bytes of one machine"
