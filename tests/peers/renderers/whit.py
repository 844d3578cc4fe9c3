"""whit itself, as a process for every image."""

import json
import subprocess

from peers import error, options, session
from peers.renderers import Renderer, Setting, Timing

# The most samples that an adaptive pixel gets.
ADAPTIVE_SPP = 1024
# The displayed contrast with a neighbour from which a pixel takes all samples.
EDGE_CONTRAST = 0.03


class Whit(Renderer):
    """The program under test."""

    name = "whit"
    equal_samplers = ["default", "default, auto"]
    reference_sampler = "sobol"
    reference_spp = 512

    def __init__(self, chosen):
        self.program = chosen.whit
        if self.program is None:
            subprocess.run(["cargo", "build", "--release"], cwd=options.REPOSITORY, check=True)
            described = subprocess.run(
                ["cargo", "metadata", "--format-version", "1", "--no-deps"], cwd=options.REPOSITORY, capture_output=True
            )
            self.program = json.loads(described.stdout)["target_directory"] + "/release/whit"

    def versions(self):
        """Returns what `whit --version --verbose` says, commit included."""
        said = subprocess.run([self.program, "--version", "--verbose"], capture_output=True, text=True).stdout
        return {"whit": "; ".join(line.strip() for line in said.splitlines())}

    def samplers(self):
        """Returns the default pattern, uniform, adaptive and by contrast, by the default backend and by `auto`."""
        ways = ["default", "default, adaptive", "default, contrast"]
        return [*ways, *(way + ", auto" for way in ways)]

    def ladder(self, sampler):
        """Returns samples per pixel, or thresholds."""
        if "adaptive" in sampler:
            return [0.1, 0.05, 0.03, 0.02, 0.015, 0.01, 0.007, 0.005, 0.0035, 0.0025]
        return [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256]

    def open(self, scene, folder):
        """Writes the scene file."""
        self.folder = folder / "whit"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.scene_file = self.folder / f"{scene.name}.toml"
        self.scene_file.write_text(scene_text(scene))

    def command(self, setting, output, seed=0):
        """Returns the command that renders to this file."""
        pattern, *others = setting.sampler.split(", ")
        command = [str(self.program), "render", str(self.scene_file), "-o", str(output), "--quiet", "--seed", str(seed)]
        command += [] if pattern == "default" else ["--pattern", pattern]
        command += ["--backend", "auto"] if "auto" in others else []
        if "adaptive" in others:
            return [*command, "--spp", str(ADAPTIVE_SPP), "--adaptive", str(setting.amount)]
        command += ["--edge-contrast", str(EDGE_CONTRAST)] if "contrast" in others else []
        return [*command, "--spp", str(setting.spp)]

    def process(self, scene, setting):
        """Returns whit's timing; `--stats`, which costs a little, says what the render phase took."""
        stats = self.folder / "stats.json"
        whole, processor, _ = session.run([*self.command(setting, self.folder / "image.png"), "--stats", str(stats)])
        return Timing(whole, processor, json.loads(stats.read_text())["seconds"]["render"])

    def image(self, scene, setting, seed=0):
        """Returns the image of an EXR."""
        output = self.folder / "image.exr"
        session.run(self.command(setting, output, seed))
        return error.read(output)


def scene_text(scene):
    """Returns the scene as TOML."""
    text = f"""background = {scene.background}
ambient = 0

[output]
size = [{scene.size}, {scene.size}]
depth = {scene.depth}
filter = "box"

[camera]
from = {scene.camera.origin}
at = {scene.camera.target}
fov = {scene.camera.fov}
"""
    if scene.interreflects:
        return "interreflection = true\n" + text + f'\n[[object]]\ngltf = "{scene.model}"\nlamp = 1\n'
    light = {"point": "position", "directional": "direction"}[scene.light.kind]
    text += f"""
[[light]]
kind = "{scene.light.kind}"
{light} = {scene.light.vector}
intensity = {scene.light.intensity}
"""
    if scene.model:
        return text + f'\n[[object]]\ngltf = "{scene.model}"\n'
    return text + analytic_text(scene)


def analytic_text(scene):
    """Returns the checkerboard and the spheres, in the materials of Whitted's paper."""
    text = f"""
[texture.checks]
pattern = "checker"
space = "uv"
colors = {scene.checks}

[material.board]
model = "lecture"
base_color = {{ texture = "checks" }}
ambient = 0
diffuse = 1
specular = 0

[[object]]
shape = "plane"
transform = [{{ z-to = [0, 1, 0] }}]
material = "board"
"""
    for number, sphere in enumerate(scene.spheres):
        text += f"""
[material.sphere_{number}]
model = "lecture"
base_color = {sphere.diffuse}
ambient = 0
diffuse = 1
specular = 0
reflection = {sphere.reflection}

[[object]]
shape = {{ sphere = {{ center = {sphere.center}, radius = {sphere.radius} }} }}
material = "sphere_{number}"
"""
    return text
