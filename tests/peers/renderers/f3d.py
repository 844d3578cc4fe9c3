"""f3d, a viewer that rasterises: it casts no shadows, so only its time and its image are reported."""

import os
import subprocess

from peers import install, session
from peers.renderers import Renderer, Timing


class F3d(Renderer):
    """A process for every image, on a virtual display."""

    name = "f3d"
    equal_samplers = ["viewer"]

    def __init__(self, _chosen):
        install.debian(["f3d", "xvfb", "xauth", "libgl1-mesa-dri"])

    def versions(self):
        """Returns the version of Debian's package."""
        return {"f3d": install.version("f3d")}

    def open(self, scene, folder):
        """Starts a virtual display; f3d reads the glTF file itself."""
        self.folder = folder / "f3d"
        self.folder.mkdir(parents=True, exist_ok=True)
        command = ["Xvfb", "-displayfd", "1", "-screen", "0", f"{scene.size}x{scene.size}x24"]
        self.screen = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.display = f":{self.screen.stdout.readline().strip()}"

    def close(self):
        """Ends the display."""
        self.screen.terminate()
        self.screen.wait()

    def process(self, scene, setting):
        """Returns the seconds of the whole process beside a display that is running already."""
        camera, output = scene.camera, self.folder / f"{scene.name}.png"
        command = ["f3d", str(scene.model), f"--output={output}", f"--resolution={scene.size},{scene.size}", "--dry-run"]
        command += [f"--camera-position={text(camera.origin)}", f"--camera-focal-point={text(camera.target)}"]
        command += [f"--camera-view-angle={camera.fov}", "--camera-view-up=0,1,0", "--bg-color=0,0,0"]
        whole, processor, _ = session.run(command, {**os.environ, "DISPLAY": self.display})
        return Timing(whole, processor, None)


def text(values):
    """Returns numbers with commas between."""
    return ",".join(map(str, values))
