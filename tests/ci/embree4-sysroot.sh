#!/usr/bin/env bash
# Sets up Embree 4 beside the system, so that whit can be tested against it on a Debian that has only Embree 3.
#
#   tests/ci/embree4-sysroot.sh DIR > embree4.env
#   . ./embree4.env
#   cargo test
#
# Takes Debian 13's packages from the system's own mirror, with package lists of its own under DIR: the system's apt is
# neither asked nor changed, and root is not needed. What to set goes to standard output, everything else to standard error.
#
# Exit codes: 0 done; 2 wrong usage; 3 the packages cannot be had here, and why.
set -euo pipefail

readonly SUITE=trixie
readonly TRIPLE=x86_64-linux-gnu
# Embree, what it links to, and the C and C++ libraries of the same release: the library asks for a newer libc than an
# older Debian has, and a libc works only with its own dynamic linker.
readonly PACKAGES=(libembree-dev libembree4-4 libtbb12 libc6 libstdc++6 libgcc-s1)

unavailable() {
  echo "Embree 4 cannot be had here: $1" >&2
  exit 3
}

# The first http(s) address among the system's apt sources, in either of the two forms they are written in.
mirror() {
  # Most systems lack some of these files, which is no failure.
  { cat /etc/apt/sources.list.d/*.sources /etc/apt/sources.list.d/*.list /etc/apt/sources.list 2>/dev/null || true; } |
    awk '/^(URIs:|deb )/ && !found { for (i = 2; i <= NF; i++) if ($i ~ /^https?:/) { found = $i; break } }
         END { print found }'
}

[ $# -eq 1 ] || { echo "usage: $0 DIR" >&2; exit 2; }
for tool in apt-get dpkg-deb awk; do
  command -v "$tool" >/dev/null || unavailable "$tool is missing, this needs a Debian system"
done
[ "$(dpkg --print-architecture)" = amd64 ] || unavailable "the packages are taken for amd64 only"
readonly KEYRING=/usr/share/keyrings/debian-archive-keyring.gpg
[ -r "$KEYRING" ] || unavailable "$KEYRING is missing, install debian-archive-keyring"
source_url=$(mirror)
[ -n "$source_url" ] || unavailable "no mirror is named under /etc/apt"

mkdir -p "$1"
dir=$(cd "$1" && pwd)
work=$(mktemp -d "$dir/apt.XXXXXX")
trap 'rm -rf "$work"' EXIT
mkdir -p "$work"/lists/partial "$work"/archives/partial "$work"/debs
echo "deb [signed-by=$KEYRING] $source_url $SUITE main" >"$work/sources.list"

apt_alone() {
  apt-get -qq \
    -o Dir::Etc::sourcelist="$work/sources.list" -o Dir::Etc::sourceparts=- \
    -o Dir::State="$work" -o Dir::State::lists="$work/lists" -o Dir::State::status=/dev/null \
    -o Dir::Cache="$work" -o Dir::Cache::archives="$work/archives" \
    -o APT::Sandbox::User="$(id -un)" -o Acquire::Languages=none "$@" >&2
}
apt_alone update || unavailable "$source_url has no usable $SUITE"
(cd "$work/debs" && apt_alone download "${PACKAGES[@]}") || unavailable "$SUITE lacks one of: ${PACKAGES[*]}"

rm -rf "$dir/root"
mkdir "$dir/root"
for package in "$work"/debs/*.deb; do
  dpkg-deb -x "$package" "$dir/root"
done

readonly PREFIX=$dir/root/usr
readonly LIBRARIES=$PREFIX/lib/$TRIPLE
readonly LOADER=$LIBRARIES/ld-linux-x86-64.so.2
[ -f "$PREFIX/include/embree4/rtcore.h" ] || unavailable "the packages of $SUITE hold no Embree 4 headers"
[ -f "$LOADER" ] || unavailable "the packages of $SUITE hold no dynamic linker at $LOADER"

# Programs that link Embree 4 start with the foreign dynamic linker and look for libraries here first. RPATH and not RUNPATH
# (--disable-new-dtags), because only RPATH holds for the libraries that Embree itself needs. A C compiler on PATH adds
# this and not RUSTFLAGS, so that build scripts go without, and nothing that does not link Embree is built anew.
mkdir -p "$dir/bin"
# Not the one of an earlier run, whose settings may be in force.
compiler=$(type -ap cc | grep -vxF "$dir/bin/cc" | head -n 1)
[ -n "$compiler" ] || unavailable "there is no C compiler"
cat >"$dir/bin/cc" <<CC
#!/usr/bin/env bash
for word in "\$@"; do
  if [ "\$word" = -lembree4 ]; then
    set -- "\$@" -Wl,--dynamic-linker=$LOADER -Wl,--disable-new-dtags,-rpath,$LIBRARIES -Wl,--allow-shlib-undefined
    break
  fi
done
exec $compiler "\$@"
CC
chmod +x "$dir/bin/cc"
echo "export EMBREE_DIR='$PREFIX'"
echo "export EMBREE_VERSION=4"
echo "export PATH='$dir/bin':\"\$PATH\""
echo "Embree 4 is in $dir: set what stands on standard output, then cargo test" >&2
