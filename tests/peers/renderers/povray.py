"""POV-Ray, for the analytic scene."""

import re

from peers import error, install, session
from peers.renderers import Renderer, Setting, Timing

THREADS = 2
# Subdivisions of a pixel in adaptive anti-aliasing: at most 2^3 a side.
ADAPTIVE_DEPTH = 3


class Povray(Renderer):
    """A process for every image."""

    name = "povray"
    equal_samplers = ["grid"]
    reference_sampler = "jittered grid"
    reference_spp = 512

    def __init__(self, _chosen):
        install.debian(["povray"])

    def versions(self):
        """Returns the version of Debian's package."""
        return {"POV-Ray": install.version("povray")}

    def samplers(self):
        """Returns the anti-aliasing methods."""
        return ["grid", "jittered grid", "adaptive"]

    def ladder(self, sampler):
        """Returns samples per pixel, or thresholds."""
        if sampler == "adaptive":
            return [0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005]
        return [1, 4, 9, 16, 25, 36, 49, 64, 100, 144, 196, 256]

    def open(self, scene, folder):
        """Writes the scene file."""
        self.folder = folder / "povray"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.scene_file = self.folder / f"{scene.name}.pov"
        self.scene_file.write_text(scene_text(scene))

    def command(self, scene, setting, output, form):
        """Returns the command that renders to this file."""
        command = ["povray", f"+I{self.scene_file}", f"+O{output}", f"+W{scene.size}", f"+H{scene.size}", f"+WT{THREADS}"]
        command += ["-D", "-V", form, "File_Gamma=sRGB"]
        if setting.sampler == "adaptive":
            return [*command, "+AM2", f"+A{setting.amount}", f"+R{ADAPTIVE_DEPTH}", "-J"]
        side = round(setting.amount**0.5)
        if side == 1:
            return [*command, "-A"]
        return [*command, "+AM1", "+A0.0", f"+R{side}", "+J1.0" if setting.sampler.startswith("jittered") else "-J"]

    def process(self, scene, setting):
        """Returns POV-Ray's timing; the render phase is its trace time."""
        whole, said = session.run(self.command(scene, setting, self.folder / "image.png", "+FN8"))
        phase = re.search(r"Trace Time:.*?\(([\d.]+) seconds\)", said)
        return Timing(whole, float(phase[1]))

    def image(self, scene, setting, seed=0):
        """Returns the image of a 16-bit PPM; POV-Ray's jitter has no seed, so another seed is a finer grid."""
        if seed:
            setting = Setting(setting.sampler, (round(setting.amount**0.5) + seed - 1) ** 2)
        output = self.folder / "image.ppm"
        session.run(self.command(scene, setting, output, "+FP16"))
        return error.read(output)


def vector(values):
    """Returns a vector in POV-Ray's words."""
    return f"<{', '.join(map(str, values))}>"


def scene_text(scene):
    """Returns the analytic scene; its camera's `right` makes the axes right-handed as glTF's are."""
    camera, light = scene.camera, scene.light
    text = f"""#version 3.7;
global_settings {{ assumed_gamma 1.0 max_trace_level {scene.depth + 1} ambient_light 0 }}
background {{ rgb {vector(scene.background)} }}
camera {{
  perspective location {vector(camera.origin)} right -x up y sky y angle {camera.fov} look_at {vector(camera.target)}
}}
light_source {{
  {vector([-1000 * axis for axis in light.vector])} rgb {light.intensity} parallel point_at <0, 0, 0>
}}
plane {{
  y, 0
  pigment {{ checker {" ".join(f"rgb {vector(color)}" for color in reversed(scene.checks))} translate <0, -0.5, 0> }}
  finish {{ ambient 0 diffuse 1 }}
}}
"""
    for sphere in scene.spheres:
        text += f"""sphere {{
  {vector(sphere.center)}, {sphere.radius}
  pigment {{ rgb {vector(sphere.diffuse)} }}
  finish {{ ambient 0 diffuse 1 reflection {sphere.reflection} }}
}}
"""
    return text
