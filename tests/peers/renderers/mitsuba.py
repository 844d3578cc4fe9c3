"""Mitsuba 3, in its variant that compiles kernels by LLVM, with the integrators `direct` and, for interreflection, `path`."""

import io
import json
import os
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from peers import error, gltf, install
from peers.renderers import Renderer, Timing
from peers.session import Session

# Ends the name of a sampler whose process finds no compiled kernels on disk.
NOTHING_COMPILED = ", nothing compiled"
WORKER = Path(__file__).resolve().parents[1] / "workers/mitsuba_worker.py"


class Mitsuba(Renderer):
    """A process that keeps the scene for errors and render phases, and new ones for whole processes."""

    name = "mitsuba"
    equal_samplers = ["independent", "independent" + NOTHING_COMPILED]
    reference_sampler = "multijitter"
    reference_spp = 288

    def __init__(self, chosen):
        self.library = install.newest_llvm()
        self.python = install.environment(chosen.environments / "mitsuba", ["mitsuba", "numpy"])
        self.variables = {**os.environ, "DRJIT_LIBLLVM_PATH": self.library}
        self.session = None

    def versions(self):
        """Returns the versions of Mitsuba, of its compiler and of LLVM."""
        return {**self.session.ready["versions"], "LLVM": Path(self.library).name}

    def samplers(self):
        """Returns all samplers that Mitsuba has."""
        return ["independent", "stratified", "multijitter", "orthogonal", "ldsampler"]

    def ladder(self, sampler):
        """Returns numbers of samples that the sampler takes as they are; few where the error is sure to follow a power."""
        return {
            "independent": [1, 4, 9, 16, 36, 64, 144, 288],
            "stratified": [1, 4, 9, 16, 25, 36, 49, 64, 81, 100, 121, 144],
            "multijitter": [1, 2, 4, 6, 9, 12, 16, 20, 25, 30, 36, 49, 64, 81, 100, 121, 144],
            "orthogonal": [4, 9, 25, 49, 121],
            "ldsampler": [4, 16, 64],
        }[sampler]

    def open(self, scene, folder):
        """Writes the meshes as PLY and the textures with one channel a file, and starts the worker."""
        self.folder = folder / "mitsuba"
        self.folder.mkdir(parents=True, exist_ok=True)
        meshes = list(enumerate(gltf.meshes(gltf.read(scene.model))))
        described = {
            "camera": vars(scene.camera),
            "light": scene.light and vars(scene.light),
            "size": scene.size,
            "meshes": [self.write_mesh(gltf.read(scene.model), mesh, f"{scene.name}_{number}") for number, mesh in meshes],
        }
        self.scene_file = self.folder / f"{scene.name}.json"
        self.scene_file.write_text(json.dumps(described))
        self.session = self.start(self.variables)

    def start(self, variables):
        """Starts a worker with the scene."""
        return Session([str(self.python), str(WORKER), str(self.scene_file)], variables)

    def write_mesh(self, source, mesh, name):
        """Writes one mesh and its textures; returns the worker's description."""
        described = {"ply": str(self.folder / f"{name}.ply"), "emission": gltf.emission(mesh.material)}
        write_ply(mesh, described["ply"])
        factors = mesh.material.get("pbrMetallicRoughness", {})
        if "baseColorTexture" not in factors:
            return {**described, "color": factors.get("baseColorFactor", [1, 1, 1])[:3]}

        def picture(slot):
            return Image.open(io.BytesIO(gltf.image_bytes(source, slot))).convert("RGB")

        packed = picture(factors["metallicRoughnessTexture"]).split()
        red, green, blue = picture(mesh.material["normalTexture"]).split()
        # glTF's v runs down and its bitangents up; Mitsuba's bitangents follow v
        normal = Image.merge("RGB", [red, green.point(lambda value: 255 - value), blue])
        for key, image in [
            ("base_color", picture(factors["baseColorTexture"])),
            ("roughness", packed[1]),
            ("metallic", packed[2]),
            ("normal", normal),
        ]:
            described[key] = str(self.folder / f"{name}_{key}.png")
            image.save(described[key], compress_level=1)
        return described

    def process(self, scene, setting):
        """Returns the seconds until the first image is written, and those of a second render, with kernels compiled."""
        sampler, _, is_first = setting.sampler.partition(NOTHING_COMPILED)
        request = {"sampler": sampler, "spp": setting.spp, "seed": 0}
        with tempfile.TemporaryDirectory() as home:
            # Compiled kernels are kept in the home folder
            session = self.start({**self.variables, "HOME": home} if is_first else self.variables)
            first = session.render(**request, output=str(self.folder / "image.png"))
            render = session.render(**request)["seconds"]
            session.close()
        return Timing(first["since_start"], first["processor"], render)

    def image(self, scene, setting, seed=0):
        """Returns the image that the worker saves."""
        output = self.folder / "image.npy"
        sampler = setting.sampler.removesuffix(NOTHING_COMPILED)
        self.session.render(sampler=sampler, spp=setting.spp, seed=seed, output=str(output))
        return error.read(output)

    def render_seconds(self, scene, setting):
        """Returns the seconds of a render whose kernels `image` compiled."""
        return self.session.render(sampler=setting.sampler, spp=setting.spp, seed=0)["seconds"]

    def close(self):
        """Ends the worker."""
        self.session.close()


def write_ply(mesh, path):
    """Writes a mesh as binary PLY."""
    names = ["x", "y", "z", "nx", "ny", "nz"] + (["u", "v"] if mesh.uv is not None else [])
    columns = [mesh.positions, mesh.normals] + ([mesh.uv] if mesh.uv is not None else [])
    vertices = np.hstack(columns).astype("<f4")
    faces = np.empty(len(mesh.triangles), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, mesh.triangles
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in names]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    with open(path, "wb") as file:
        file.write("\n".join(header).encode())
        file.write(vertices.tobytes())
        file.write(faces.tobytes())
