#!/usr/bin/env bash
# Tells whether effects which a scene does not call for cost anything by being there: builds whit whole, without the code of
# all effects but shadows and mirrors, and without that of all effects, and has tests/absence.rs count their instructions.
# Needs valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."

program=${CARGO_TARGET_DIR:-target}/release/whit
builds=$(mktemp -d)
finish() {
    # Nobody is to find a program there that leaves effects out. Cargo knows what it built last, and builds anew.
    if [ -e "$builds/whole" ]; then cp "$builds/whole" "$program"; fi
    rm -rf "$builds"
}
trap finish EXIT

build() {
    WHIT_WITHOUT=$2 cargo build --release --quiet
    cp "$program" "$builds/$1"
}

cargo build --release --quiet
cp "$program" "$builds/whole"
# The names as `whit info` prints them, all but those given.
all=$("$builds/whole" info scenes/first_light.gltf | sed -n 's/^effect *\([a-z-]*\) .*/\1/p')
build bare "$(paste -sd, <<<"$all")"
build mirrors "$(grep -vx -e shadow -e reflection <<<"$all" | paste -sd,)"
WHIT_WHOLE=$builds/whole WHIT_MIRRORS=$builds/mirrors WHIT_BARE=$builds/bare \
    cargo test --test absence -- --nocapture
