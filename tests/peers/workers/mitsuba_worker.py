"""Renders a scene with Mitsuba 3 on request: see ../session.py.

    python mitsuba_worker.py scene.json    (scene.json: see ../renderers/mitsuba.py)
"""

import json
import sys
import time

import drjit as dr
import mitsuba as mi
import numpy as np

THREADS = 2
# A wavefront of more samples per pixel fills the memory.
PASS_SPP = 144
# Edges of the longest path, as whit's 16 bounces and its ray to the light.
DEPTH = 18


def reply(**values):
    print("@@" + json.dumps(values), flush=True)


def texture(path, raw):
    return {"type": "bitmap", "filename": path, "raw": raw}


def bsdf(mesh):
    if "base_color" not in mesh:
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": mesh["color"]}}
    surface = {
        "type": "principled",
        "base_color": texture(mesh["base_color"], False),
        "roughness": texture(mesh["roughness"], True),
        "metallic": texture(mesh["metallic"], True),
        "specular": 0.5,
    }
    return {"type": "normalmap", "normalmap": texture(mesh["normal"], True), "bsdf": surface}


def light(described):
    intensity = {"type": "rgb", "value": [described["intensity"]] * 3}
    if described["kind"] == "point":
        return {"type": "point", "position": described["vector"], "intensity": intensity}
    return {"type": "directional", "direction": described["vector"], "irradiance": intensity}


def sensor(scene, sampler):
    camera = scene["camera"]
    film = {
        "type": "hdrfilm",
        "width": scene["size"],
        "height": scene["size"],
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    to_world = mi.ScalarTransform4f().look_at(camera["origin"], camera["target"], [0, 1, 0])
    return mi.load_dict(
        {
            "type": "perspective",
            "to_world": to_world,
            "fov": camera["fov"],
            "fov_axis": "y",
            "film": film,
            "sampler": {"type": sampler},
        }
    )


def main():
    dr.set_thread_count(THREADS)
    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    with open(sys.argv[1]) as file:
        described = json.load(file)
    parts = {"type": "scene"}
    if described["light"]:
        parts["light"] = light(described["light"])
    for number, mesh in enumerate(described["meshes"]):
        parts[f"mesh_{number}"] = {
            "type": "ply",
            "filename": mesh["ply"],
            "material": {"type": "twosided", "bsdf": bsdf(mesh)},
        }
        if any(mesh["emission"]):
            radiance = {"type": "rgb", "value": mesh["emission"]}
            parts[f"mesh_{number}"]["emitter"] = {"type": "area", "radiance": radiance}
    scene = mi.load_dict(parts)
    if described["light"]:
        # The light has no extent: rays sampled from a material would never meet it.
        integrator = mi.load_dict({"type": "direct", "hide_emitters": True, "emitter_samples": 1, "bsdf_samples": 0})
    else:
        integrator = mi.load_dict({"type": "path", "max_depth": DEPTH})
    sensors = {}
    reply(versions={"mitsuba": mi.__version__, "drjit": dr.__version__})

    for line in sys.stdin:
        request = json.loads(line)
        sampler = request["sampler"]
        if sampler not in sensors:
            sensors[sampler] = sensor(described, sampler)
        passes = -(-request["spp"] // PASS_SPP)
        started = time.perf_counter()
        image = 0
        for number in range(passes):
            image = image + mi.render(
                scene,
                sensor=sensors[sampler],
                integrator=integrator,
                spp=request["spp"] // passes,
                seed=request["seed"] * 100_000 + number,
            )
            dr.eval(image)
            dr.sync_thread()
        image = image / passes
        seconds = time.perf_counter() - started
        output = request.get("output")
        if output and output.endswith(".npy"):
            np.save(output, np.array(image))
        elif output:
            mi.util.write_bitmap(output, image, write_async=False)
        reply(seconds=seconds, spp=sensors[sampler].sampler().sample_count() * passes)


main()
