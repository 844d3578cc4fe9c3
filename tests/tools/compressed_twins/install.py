"""Installs the encoders from npm, in the versions that the report names."""

import json
import os
import shutil
import subprocess
from pathlib import Path

# Pinned, so that results of two runs differ by whit alone. The decoders come with `@gltf-transform/cli`.
PACKAGES = {
    "@gltf-transform/cli": "4.5.1",
    "gltfpack": "1.3.0",
    "gltf-pipeline": "4.3.1",
    "ktx2-encoder": "0.6.0",
}
HERE = Path(__file__).resolve().parent


class Failed(Exception):
    """A program that failed, with what it said last."""


def encoders(folder: Path) -> None:
    """Installs the packages into the folder unless they are there."""
    wanted = json.dumps({"private": True, "dependencies": PACKAGES}, indent=1)
    folder.mkdir(parents=True, exist_ok=True)
    done = folder / "installed.json"
    if not done.exists() or done.read_text() != wanted:
        if shutil.which("npm") is None:
            raise Failed("npm is missing: install Node.js 20 or later")
        (folder / "package.json").write_text(wanted)
        run(["npm", "install", "--prefix", str(folder), "--no-audit", "--no-fund"])
        done.write_text(wanted)
    # Node resolves packages from where a module lies
    for module in HERE.glob("*.mjs"):
        shutil.copy(module, folder)


def run(command: list[str], variables: dict[str, str] | None = None) -> str:
    """Runs a program to its end; returns its output."""
    environment = {**os.environ, "NO_COLOR": "1", **(variables or {})}
    result = subprocess.run(command, capture_output=True, text=True, errors="replace", env=environment)
    if result.returncode:
        said = (result.stderr or result.stdout).strip().splitlines()
        raise Failed(said[-1].strip() if said else f"`{' '.join(command)}` failed without a message")
    return result.stdout
