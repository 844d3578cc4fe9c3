#!/usr/bin/env bash
# Tells whether effects which a scene does not call for cost anything by being there: builds whit whole and without the code
# of all effects but shadows and mirrors, and has tests/it/cli/disabled_effect_cost.rs count their instructions. With
# `--bare` it also builds whit without the code of any effect, as the slow tier does. Needs valgrind.
#
#     tests/ci/disabled_effects.sh [--bare]
#
# Each is built in one codegen unit. Release builds have four, and which function lies in which of them, and so what
# is inlined where, changes with the code that is left out: by up to 0.4 % of the instructions, which is more than what is
# looked for here.
set -euo pipefail
cd "$(dirname "$0")/../.."

built=${CARGO_TARGET_DIR:-target}/release
builds=$(mktemp -d)
trap 'rm -rf "$builds"' EXIT

# In a folder of its own, where nobody finds a program that leaves effects out. What whit stands on is taken over.
build() { # NAME EFFECTS
    mkdir "$builds/$1.target"
    cp -a "$built" "$builds/$1.target"
    WHIT_WITHOUT=$2 CARGO_TARGET_DIR="$builds/$1.target" \
        cargo build --release --quiet --config 'profile.release.package.whit.codegen-units = 1'
    mv "$builds/$1.target/release/whit" "$builds/$1"
    rm -rf "$builds/$1.target"
}

cargo build --release --quiet
# The names as `whit info` prints them, all but those given.
all=$("$built/whit" info scenes/first_light.gltf | sed -n 's/^effect *\([a-z-]*\) .*/\1/p')
# Side by side: each keeps one core busy.
build whole "" &
whole=$!
build mirrors "$(grep -vx -e shadow -e reflection <<<"$all" | paste -sd,)"
wait "$whole"
export WHIT_WHOLE=$builds/whole WHIT_MIRRORS=$builds/mirrors
if [ "${1:-}" = --bare ]; then
    build bare "$(paste -sd, <<<"$all")"
    export WHIT_BARE=$builds/bare
fi
cargo test --test it disabled_effect_cost -- --nocapture
