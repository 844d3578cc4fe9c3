#!/usr/bin/env python3
"""Lists three faults of compiled SIMD kernels.

Calls of what is compiled for the lowest instruction set: closures and methods of arrays and iterators that the compiler no
longer inlines. One in a hot loop once made texture look-ups take twice as long, and one in the look-up of environment maps
three times. Where it finds one, write a loop in place of the closure, or a function with `#[inline(always)]`.

Scatters: the compiler vectorised a loop over three axes in place of that over sixteen lanes inside it. One once took a fifth
of the time of packets through small trees. Where it finds one, write a function for one axis, and call it three times.

Gathers: the same with loads in place of stores. One made the choice of a traversal take three times as long.

    cargo build --release && tests/ci/kernel_calls.py [PROGRAM]

PROGRAM is target/release/whit by default. Needs objdump (Debian: binutils). Fails if any fault is not in ALLOWED below. Run it
after a change to kernels: what is inlined depends on the compiler too, so CI does not.
"""

import os
import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]

# Functions that are compiled for several instruction sets.
KERNEL = re.compile(r"_avx512|_avx2_|::[vV][34]::V[34]::vectorize")
# What was meant to be inlined into them.
SMALL = re.compile(r"core::array::|\{\{closure\}\}|core::ops::function::|core::iter::")
# Parts of names of callers and callees that may stay, with the reason.
ALLOWED = [
    ("::first_hits::add", "core::array::", "AOVs are computed once per pixel sample"),
    ("::sum_depths", "core::array::", "once for each ray through a volume"),
    ("::vectorize", "core::array::", "once for each group of rays"),
    ("::vectorize", "core::iter::", "the BSP's builder, once per node"),
    ("::vectorize", "::bsp::", "shapes and instanced meshes, ray by ray"),
    ("::vectorize", "core::ops::function::", "the same, through a reference"),
    ("::evaluate_textures", "::packet_lookup::fetch::", "levels of mipmaps, lane by lane"),
    ("::special_direct", "scatter", "colours of thin films alone"),
    ("::procedural::sample_packet", "scatter", "colours of patterns, whose values take longer"),
    ("::sample_batch::sample", "scatter", "fields of volumes, whose values take longer"),
    ("::special_direct", "gather", "as above"),
    ("::procedural::sample_packet", "gather", "as above"),
    ("::sample_batch::sample", "gather", "as above, and voxels"),
    ("::sum_depths", "gather", "voxels, and crossings of a ray with volumes"),
    ("::sample_direct_", "gather", "a few lanes, where the compiler finds them masked"),
    ("::vectorize", "gather", "a child of the node of each ray"),
]


def calls(program):
    """Yields kernels with what they call directly, and with "scatter" or "gather" for each such instruction."""
    listing = subprocess.run(
        ["objdump", "--disassemble", "--no-show-raw-insn", "--demangle", program], capture_output=True, text=True, check=True
    )
    caller = ""
    for line in listing.stdout.splitlines():
        start = re.match(r"^[0-9a-f]+ <(.*)>:$", line)
        if start:
            caller = start[1]
        elif "call" in line and KERNEL.search(caller):
            callee = re.search(r"\bcall +[0-9a-f]+ <(.*)>$", line)
            if callee:
                yield caller, callee[1]
        elif KERNEL.search(caller):
            for instruction in ("scatter", "gather"):
                if re.search(rf"\bvp?{instruction}[dq]", line):
                    yield caller, instruction


def is_allowed(caller, callee):
    return any(of in caller and to in callee for of, to, _ in ALLOWED)


def main():
    target = os.environ.get("CARGO_TARGET_DIR", ROOT / "target")
    program = sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(target) / "release" / "whit"
    found = {
        (re.sub(r"_(avx512|avx2_).*", "", caller), callee)
        for caller, callee in calls(program)
        if (callee in ("scatter", "gather") or SMALL.search(callee) and not KERNEL.search(callee)) and not is_allowed(caller, callee)
    }
    for caller, callee in sorted(found):
        print(f"{caller}\n    {callee + 's' if callee in ('scatter', 'gather') else 'calls ' + callee}")
    print(f"{len(found)} calls of closures that are compiled for the lowest instruction set, scatters and gathers")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
