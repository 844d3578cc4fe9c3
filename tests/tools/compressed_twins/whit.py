"""Renders and compares by whit."""

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from compressed_twins.install import run
from compressed_twins.tolerance import SIZE, SPP


@dataclass(frozen=True)
class Render:
    """What whit said of a file, and how long it took to load it; no seconds if it refused."""

    said: str
    load_seconds: float | None

    @property
    def is_done(self) -> bool:
        """Whether there is an image."""
        return self.load_seconds is not None


@dataclass(frozen=True)
class Whit:
    """The program under test."""

    program: Path

    def version(self) -> str:
        """Returns version, commit and features."""
        return "; ".join(line.strip() for line in run([str(self.program), "--version", "--verbose"]).splitlines())

    def can_load(self, model: Path) -> bool:
        """Returns whether whit loads the file."""
        return subprocess.run([self.program, "info", model], capture_output=True).returncode == 0

    def render(self, model: Path, image: Path) -> Render:
        """Renders to a PNG of 16 bits, whose rounding is far below every tolerance."""
        image.parent.mkdir(parents=True, exist_ok=True)
        stats = image.with_suffix(".json")
        command = [self.program, "render", model, "-o", image, "--size", f"{SIZE}x{SIZE}", "--spp", str(SPP)]
        command += ["--png-bits", "16", "--progress", "none", "--stats", stats]
        result = subprocess.run(command, capture_output=True, text=True)
        # Warnings and errors, without the paths of this run
        said = "; ".join(result.stderr.strip().replace(str(model), model.name).splitlines())
        if result.returncode:
            return Render(said or f"exit code {result.returncode} without a message", None)
        return Render(said, json.loads(stats.read_text())["seconds"]["load"])

    def rmse(self, reference: Path, image: Path) -> float:
        """Returns the RMSE of displayed values, and writes their difference as `NAME.difference.png`."""
        metrics, difference = image.with_suffix(".metrics.json"), image.with_suffix(".difference.png")
        command = ["compare", reference, image, "--json", metrics, "--difference", difference]
        run([str(self.program), *map(str, command)])
        return json.loads(metrics.read_text())["displayed"]["rmse"]
