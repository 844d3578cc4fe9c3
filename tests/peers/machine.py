"""Describes the machine and the commit that was measured."""

import os
import platform
import subprocess
from pathlib import Path

from peers import options


def describe():
    """Returns processor, cores, memory, system, load and commit."""
    words = Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.split(": ", 1)[1] for line in words if line.startswith("model name")), platform.machine())
    kibibytes = next(int(line.split()[1]) for line in Path("/proc/meminfo").read_text().splitlines() if "MemTotal" in line)
    system = dict(line.split("=", 1) for line in Path("/etc/os-release").read_text().splitlines() if "=" in line)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=options.REPOSITORY, capture_output=True, text=True)
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "widest vectors": "AVX-512" if any("avx512f" in line for line in words) else "no AVX-512",
        "memory": f"{kibibytes / 2**20:.0f} GiB",
        "system": system.get("PRETTY_NAME", "").strip('"'),
        "load at the start": f"{os.getloadavg()[0]:.1f}",
        "commit": commit.stdout.strip(),
    }
