"""POV-Ray, for the analytic scene."""

import re

from peers import error, install, session
from peers.renderers import Renderer, Setting, Timing

THREADS = 2
# POV-Ray's largest grid of samples in a pixel, a side.
MAX_SIDE = 9


class Povray(Renderer):
    """A process for every image."""

    name = "povray"
    equal_samplers = ["grid"]
    # Samples per pixel of the finer of two reference images.
    reference_spp = (3 * MAX_SIDE) ** 2

    def __init__(self, _chosen):
        install.debian(["povray"])

    def versions(self):
        """Returns the version of Debian's package."""
        return {"POV-Ray": install.version("povray")}

    def samplers(self):
        """Returns the kinds of grids; recursive anti-aliasing does not converge to the mean over the pixel."""
        return ["grid", "jittered grid"]

    def ladder(self, _sampler):
        """Returns samples per pixel."""
        return [side**2 for side in range(1, MAX_SIDE + 1)]

    def open(self, scene, folder):
        """Writes the scene file."""
        self.folder = folder / "povray"
        self.folder.mkdir(parents=True, exist_ok=True)
        self.scene_file = self.folder / f"{scene.name}.pov"
        self.scene_file.write_text(scene_text(scene))

    def command(self, size, setting, output, form):
        """Returns the command that renders to this file."""
        command = ["povray", f"+I{self.scene_file}", f"+O{output}", f"+W{size}", f"+H{size}", f"+WT{THREADS}"]
        command += ["-D", "-V", form, "File_Gamma=sRGB"]
        side = round(setting.amount**0.5)
        if side == 1:
            return [*command, "-A"]
        return [*command, "+AM1", "+A0.0", f"+R{side}", "+J1.0" if setting.sampler.startswith("jittered") else "-J"]

    def process(self, scene, setting):
        """Returns POV-Ray's timing; the render phase is its trace time."""
        whole, processor, said = session.run(self.command(scene.size, setting, self.folder / "image.png", "+FN8"))
        return Timing(whole, processor, float(re.search(r"Trace Time:.*?\(([\d.]+) seconds\)", said)[1]))

    def image(self, scene, setting, seed=0, scale=1):
        """Returns the image of a 16-bit PPM; with a scale, the means over as many pixels each way of a larger one."""
        output = self.folder / "image.ppm"
        session.run(self.command(scene.size * scale, setting, output, "+FP16"))
        image = error.read(output)
        return image.reshape(scene.size, scale, scene.size, scale, 3).mean((1, 3))

    def reference(self, scene, spp):
        """Returns the means over a larger image's pixels, and half its distance from those over a smaller one's.

        POV-Ray's jitter has no seed, and its grids end at 9 x 9.
        """
        scale = max(2, round(spp**0.5 / MAX_SIDE))
        setting = Setting("jittered grid", MAX_SIDE**2)
        smaller, larger = (self.image(scene, setting, scale=each) for each in [scale - 1, scale])
        return larger, error.rmse(smaller, larger) / 2


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
