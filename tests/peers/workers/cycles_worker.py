"""Renders a scene with Blender's Cycles on request: see ../session.py.

    python cycles_worker.py scene.json    (scene.json: see ../renderers/cycles.py)
"""

import json
import math
import sys
import time

import bpy  # before its own modules: it makes them importable
import addon_utils
from mathutils import Matrix, Vector

THREADS = 2
# Bounces of a scene whose surfaces light each other, as whit's default.
INTERREFLECTIONS = 16
BOUNCES = ["max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces", "volume_bounces"]


def reply(**values):
    print("@@" + json.dumps(values), flush=True)


def blender(vector):
    """Returns a vector of glTF's axes in Blender's: z is up."""
    x, y, z = vector
    return Vector((x, -z, y))


def looking(origin, target):
    """Returns the transform of a camera or lamp, which looks along its own -z."""
    back = (origin - target).normalized()
    right = Vector((0, 0, 1)).cross(back).normalized()
    return Matrix.Translation(origin) @ Matrix((right, back.cross(right), back)).transposed().to_4x4()


def add_camera(scene, described):
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "VERTICAL"
    data.angle = math.radians(described["fov"])
    camera = bpy.data.objects.new("camera", data)
    camera.matrix_world = looking(blender(described["origin"]), blender(described["target"]))
    scene.collection.objects.link(camera)
    scene.camera = camera


def add_light(scene, described):
    vector = blender(described["vector"])
    if described["kind"] == "point":
        data = bpy.data.lights.new("light", "POINT")
        # Blender takes watts: candela times the full solid angle.
        data.energy = described["intensity"] * 4 * math.pi
        data.shadow_soft_size = 0
        place = Matrix.Translation(vector)
    else:
        data = bpy.data.lights.new("light", "SUN")
        data.energy = described["intensity"]
        data.angle = 0
        place = looking(-vector, Vector((0, 0, 0)))
    light = bpy.data.objects.new("light", data)
    light.matrix_world = place
    scene.collection.objects.link(light)


def settings(scene, size, bounce_count):
    """Sets the number of bounces, no clamping, no denoising, no adaptive sampling, and a box filter."""
    scene.render.engine = "CYCLES"
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.threads_mode = "FIXED"
    scene.render.threads = THREADS
    scene.render.use_persistent_data = True
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.render.dither_intensity = 0
    scene.view_settings.view_transform = "Standard"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type = "BOX"
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.light_sampling_threshold = 0
    cycles.use_light_tree = False
    for bounces in BOUNCES:
        setattr(cycles, bounces, bounce_count)
    # glTF's microfacets scatter once.
    for material in bpy.data.materials:
        for node in material.node_tree.nodes if material.node_tree else []:
            if node.type == "BSDF_PRINCIPLED":
                node.distribution = "GGX"


def render(scene, request):
    """Renders to a file, PNG or EXR, or to none; returns the seconds."""
    scene.cycles.sampling_pattern = request["sampler"]
    scene.cycles.samples = request["spp"]
    scene.cycles.seed = request["seed"]
    output = request.get("output")
    image = scene.render.image_settings
    if output and output.endswith(".exr"):
        image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR", "32", "NONE"
    else:
        image.file_format, image.color_mode, image.color_depth = "PNG", "RGB", "8"
    scene.render.filepath = output or ""
    started = time.perf_counter()
    bpy.ops.render.render(write_still=bool(output))
    return time.perf_counter() - started


def main():
    with open(sys.argv[1]) as file:
        described = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for addon in ["io_scene_gltf2", "cycles"]:
        addon_utils.enable(addon)
    bpy.ops.import_scene.gltf(filepath=described["model"])
    scene = bpy.context.scene
    add_camera(scene, described["camera"])
    if described["light"]:
        add_light(scene, described["light"])
    settings(scene, described["size"], 0 if described["light"] else INTERREFLECTIONS)
    reply(versions={"bpy (Cycles)": bpy.app.version_string})
    for line in sys.stdin:
        reply(seconds=render(scene, json.loads(line)))


main()
