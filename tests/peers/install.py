"""Installs what is measured: Python environments from PyPI, programs from Debian."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

# What the measuring program itself needs.
DRIVER_PACKAGES = ["numpy", "pillow", "OpenEXR"]


class Absent(Exception):
    """A renderer that can't be installed, with the reason."""


def driver_python(environments):
    """Returns the Python of the environment in which the measuring program runs."""
    return str(environment(environments / "driver", DRIVER_PACKAGES))


def environment(folder, packages):
    """Makes a Python environment with these packages of PyPI unless it is there; returns its interpreter."""
    python = folder / "bin/python"
    done = folder / "installed"
    if not done.exists() or done.read_text() != " ".join(packages):
        folder.parent.mkdir(parents=True, exist_ok=True)
        run([sys.executable, "-m", "venv", str(folder)])
        run([str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages])
        done.write_text(" ".join(packages))
    return python


def debian(packages):
    """Installs those of Debian's packages that are absent, as root."""
    missing = [package for package in packages if version(package) is None]
    if not missing:
        return
    if os.geteuid() != 0:
        raise Absent(f"install {' '.join(missing)}, or run as root")
    quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    run(["apt-get", "-qq", "update"], quiet)
    run(["apt-get", "-qq", "install", "-y", "--no-install-recommends", *missing], quiet)


def version(package):
    """Returns the version of an installed package of Debian, or None."""
    query = ["dpkg-query", "-W", "-f", "${db:Status-Status} ${Version}", package]
    if shutil.which("dpkg-query") is None:
        raise Absent("this is no Debian: dpkg-query is missing")
    state, _, number = subprocess.run(query, capture_output=True, text=True).stdout.partition(" ")
    return number if state == "installed" else None


def newest_llvm():
    """Installs the newest LLVM of this Debian; returns its library."""
    listed = subprocess.run(["apt-cache", "search", "--names-only", "^libllvm[0-9]+$"], capture_output=True, text=True)
    numbers = [int(line.split()[0].removeprefix("libllvm")) for line in listed.stdout.splitlines()]
    if not numbers:
        raise Absent("apt-cache knows no libllvm package: run apt-get update")
    debian([f"libllvm{max(numbers)}"])
    files = sorted(Path("/usr/lib").glob(f"*-linux-gnu/libLLVM-{max(numbers)}*.so*"))
    files += sorted(Path("/usr/lib").glob(f"*-linux-gnu/libLLVM.so.{max(numbers)}*"))
    if not files:
        raise Absent(f"libllvm{max(numbers)} has no library under /usr/lib")
    return str(files[0])


def run(command, variables=None):
    """Runs a command; its output becomes the reason if it fails."""
    result = subprocess.run(command, capture_output=True, text=True, env=variables)
    if result.returncode:
        said = (result.stderr or result.stdout).strip().splitlines()
        raise Absent(f"`{' '.join(command)}` failed: {said[-1] if said else 'no message'}")
