#!/usr/bin/env bash
# Tells whether effects which a scene does not call for cost anything by being there: builds whit whole, without the code of
# all effects but shadows, and without that of all effects, and has tests/absence.rs count their instructions. Needs
# valgrind.
set -euo pipefail
cd "$(dirname "$0")/.."

builds=$(mktemp -d)
trap 'rm -rf "$builds"' EXIT

build() {
    WHIT_WITHOUT=$2 cargo build --release --quiet
    cp "${CARGO_TARGET_DIR:-target}/release/whit" "$builds/$1"
}

# The names as `whit info` prints them, all but those given.
cargo build --release --quiet
cp "${CARGO_TARGET_DIR:-target}/release/whit" "$builds/whole"
all=$("$builds/whole" info scenes/first_light.gltf | sed -n 's/^effect *\([a-z-]*\) .*/\1/p')
build bare "$(paste -sd, <<<"$all")"
build shadow-only "$(grep -vx shadow <<<"$all" | paste -sd,)"
WHIT_WHOLE=$builds/whole WHIT_SHADOW_ONLY=$builds/shadow-only WHIT_BARE=$builds/bare \
    cargo test --test absence -- --nocapture
