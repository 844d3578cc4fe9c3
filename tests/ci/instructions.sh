#!/usr/bin/env bash
# Counts the instructions of a few small renders and benchmark loops and holds them against those of
# tests/ci/instructions.json: fails if any takes over 5 % more (`whit compare-stats`). Needs valgrind.
#
# After a change that is meant to cost something, or another version of the compiler,
#
#     tests/ci/instructions.sh --renew
#
# writes that file anew; commit it with the reason.
#
# What is counted is the work itself: the count of a short run is subtracted from that of a longer one, so that loading and
# building count in neither. There is one thread. Code is chosen by the processor: valgrind knows no AVX-512, so whit's own
# code takes AVX2, to which Embree is held too; without AVX2 there is nothing to compare with. Counts through
# another version of Embree have names of their own and are held against nothing until they are in the file.
set -euo pipefail
cd "$(dirname "$0")/../.."

base=tests/ci/instructions.json
program=${CARGO_TARGET_DIR:-target}/release/whit
if ! grep -qw avx2 /proc/cpuinfo 2>/dev/null; then
    echo "skipped: this processor has no AVX2, by whose instructions others are counted"
    exit 0
fi
cargo build --release --quiet
embree=$("$program" --version | sed -n 's/.*(\(Embree [0-9.]*\)).*/\1/p')
files=$(mktemp -d)
trap 'rm -rf "$files"' EXIT

# Instructions of a run of whit with these arguments.
count() {
    if ! valgrind --tool=cachegrind --cache-sim=no --cachegrind-out-file="$files/profile" "$program" "$@" \
        >"$files/said" 2>&1; then
        cat "$files/said" >&2
        return 1
    fi
    sed -n 's/^summary: *//p' "$files/profile"
}

# Adds a line: a name, then a flag with the smaller and the larger number that it takes, then all other arguments.
measure() {
    local name=$1 flag=$2 less=$3 more=$4 few many
    shift 4
    few=$(count "$@" "$flag" "$less")
    many=$(count "$@" "$flag" "$more")
    echo "$name: $((many - few)) instructions"
    lines+=("  \"$name\": $((many - few))")
}

lines=()
for scene in first_light.gltf sphereflake.toml glass_of_water.toml smoke.toml; do
    render=(render "scenes/$scene" -o "$files/picture.exr" --size 48x36 --threads 1 --quiet)
    measure "render ${scene%.*}, BSP" --spp 1 5 "${render[@]}" --backend bsp
    [ -z "$embree" ] || measure "render ${scene%.*}, $embree" --spp 1 5 "${render[@]}" --backend embree --isa avx2
done
measure "render first_light, native" --spp 1 5 render scenes/first_light.gltf -o "$files/picture.exr" --size 48x36 \
    --threads 1 --quiet --backend native
held=()
[ -z "$embree" ] || held=(--isa avx2)
all="native, BSP${embree:+ and $embree}"
measure "bench first_light, $all" --repeat 1 3 bench scenes/first_light.gltf --size 32x24 --threads 1 "${held[@]}"
measure "bench sweep, $all" --repeat 1 3 bench --sweep --most-triangles 1000 --size 32x24 --threads 1 "${held[@]}"

new=$files/instructions.json
{
    echo "{"
    (IFS=$'\n'; echo "${lines[*]}") | sed '$!s/$/,/'
    echo "}"
} >"$new"
if [ "${1:-}" = --renew ]; then
    cp "$new" "$base"
    echo "written to $base"
else
    "$program" compare-stats "$base" "$new" --max-regress 5%
fi
