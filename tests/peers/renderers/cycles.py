"""Blender's Cycles, through the Python module `bpy`."""

import json
from pathlib import Path

from peers import error, install
from peers.renderers import Renderer, Timing
from peers.session import Session

WORKER = Path(__file__).resolve().parents[1] / "workers/cycles_worker.py"
# Libraries that `bpy` loads and does not bring.
LIBRARIES = [
    *["libx11-6", "libxrender1", "libxxf86vm1", "libxfixes3", "libxi6", "libxkbcommon0"],
    *["libsm6", "libice6", "libgl1", "libegl1"],
]


class Cycles(Renderer):
    """A process that keeps the scene for errors and render phases, and new ones for whole processes."""

    name = "cycles"
    equal_samplers = ["TABULATED_SOBOL"]
    reference_sampler = "TABULATED_SOBOL"
    reference_spp = 128

    def __init__(self, chosen):
        install.debian(LIBRARIES)
        self.python = install.environment(chosen.environments / "cycles", ["bpy"])
        self.session = None

    def versions(self):
        """Returns the version of Blender."""
        return self.session.ready["versions"]

    def samplers(self):
        """Returns the patterns that Cycles has."""
        return ["TABULATED_SOBOL", "BLUE_NOISE"]

    def ladder(self, _sampler):
        """Returns samples per pixel."""
        return [1, 4, 8, 16, 32, 64, 128, 256, 512]

    def open(self, scene, folder):
        """Writes the description and starts the worker, which imports the glTF file itself."""
        self.folder = folder / "cycles"
        self.folder.mkdir(parents=True, exist_ok=True)
        described = {
            "model": str(scene.model),
            "camera": vars(scene.camera),
            "light": scene.light and vars(scene.light),
            "size": scene.size,
        }
        self.scene_file = self.folder / f"{scene.name}.json"
        self.scene_file.write_text(json.dumps(described))
        self.session = self.start()

    def start(self):
        """Starts a worker with the scene."""
        return Session([str(self.python), str(WORKER), str(self.scene_file)])

    def process(self, scene, setting):
        """Returns the seconds until the image is written, and those of the render call, which builds and reads textures."""
        session = self.start()
        output = str(self.folder / "image.png")
        reply = session.render(sampler=setting.sampler, spp=setting.spp, seed=0, output=output)
        session.close()
        return Timing(reply["since_start"], reply["processor"], reply["seconds"])

    def image(self, scene, setting, seed=0):
        """Returns the image of an EXR."""
        output = self.folder / "image.exr"
        self.session.render(sampler=setting.sampler, spp=setting.spp, seed=seed, output=str(output))
        return error.read(output)

    def render_seconds(self, scene, setting):
        """Returns the seconds of a render that keeps what an earlier one has built."""
        return self.session.render(sampler=setting.sampler, spp=setting.spp, seed=0)["seconds"]

    def close(self):
        """Ends the worker."""
        self.session.close()
