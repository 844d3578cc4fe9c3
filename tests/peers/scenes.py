"""The scenes: what every renderer is given.

All but the Cornell box are lit by one light without extent, directly only, before a background of one colour. The filter
is a box of one pixel. Coordinates are glTF's: y is up, lengths are metres.
"""

import subprocess
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

from peers import gltf, options

MESH_TRIANGLES = 2_000_000


@dataclass
class Camera:
    """A pinhole camera; `fov` is the full angle in degrees of the height, and of the width too: images are square."""

    origin: list
    target: list
    fov: float


@dataclass
class Light:
    """A light without extent.

    `kind` is `point`, with a position and candela, or `directional`, with the direction in which light travels and lux.
    """

    kind: str
    vector: list
    intensity: float


@dataclass
class Sphere:
    """A sphere of the analytic scene: `diffuse` and `reflection` are Whitted's kd times the colour, and ks."""

    center: list
    radius: float
    diffuse: list
    reflection: float


@dataclass
class Scene:
    """One scene and its settings."""

    name: str
    camera: Camera
    # None if emissive surfaces light the scene, also by way of other surfaces.
    light: Light | None
    size: int
    about: str
    peers: list  # Those that can express the scene
    model: Path | None = None
    spheres: list = field(default_factory=list)
    # Colours of the checkerboard, from the origin on.
    checks: list = field(default_factory=list)
    background: list = field(default_factory=lambda: [0.0, 0.0, 0.0])
    depth: int = 0
    # Displayed errors at which times are measured.
    targets: list = field(default_factory=list)
    # References have this many times the samples of a renderer's usual ones.
    reference_factor: int = 1

    @property
    def interreflects(self):
        """Returns whether light that surfaces reflect diffusely lights others."""
        return self.light is None


class Missing(Exception):
    """A scene whose file is not here."""


def prepare(name, chosen, folder):
    """Returns a scene, with its model written into the folder."""
    make = {
        "mesh": mesh,
        "damaged_helmet": damaged_helmet,
        "flight_helmet": flight_helmet,
        "analytic": analytic,
        "cornell_box": cornell_box,
    }[name]
    return make(chosen, folder)


def mesh(chosen, folder):
    """Returns a bumpy sphere of 2 million triangles above a ground, both of matte material."""
    made = chosen.mesh or folder / "bumpy_sphere.glb"
    if not made.exists():
        tool = ["cargo", "run", "--release", "--example", "tools", "--", "bumpy-sphere"]
        subprocess.run([*tool, "--triangles", str(MESH_TRIANGLES), str(made)], cwd=options.REPOSITORY, check=True)
    model = folder / "mesh.glb"
    gltf.write_glb(gltf.matte(gltf.plain(gltf.read(made))), model)
    return Scene(
        "mesh",
        Camera([1.1, 1.3, 3.9], [0.05, -0.12, 0.0], 45.0),
        Light("point", [2.6, 3.6, 3.2], 75.0),
        chosen.size,
        "2 million triangles, matte, one point light",
        # Blender's glTF importer, in Python, would take most of the time.
        ["mitsuba", "f3d"],
        model,
        targets=[0.01, 0.004, 0.002],
    )


def helmet(chosen, folder, file, **settings):
    """Returns a scene around a model of Khronos, as its authors textured it."""
    source = chosen.assets / file
    if not source.exists():
        raise Missing(f"{source} is not here")
    model = folder / f"{settings['name']}.glb"
    gltf.write_glb(gltf.plain(gltf.read(source)), model)
    return Scene(size=chosen.size, peers=["mitsuba", "cycles", "f3d"], model=model, **settings)


def damaged_helmet(chosen, folder):
    """Returns DamagedHelmet: 15 thousand triangles, three textures of 2048x2048."""
    return helmet(
        chosen,
        folder,
        "DamagedHelmet.glb",
        name="damaged_helmet",
        camera=Camera([1.2, 0.5, 2.5], [0.0, -0.12, 0.0], 45.0),
        light=Light("directional", [-0.3, -0.6, -1.0], 8.0),
        about="15 thousand triangles, three 2048x2048 textures, rough metal, one directional light",
    )


def flight_helmet(chosen, folder):
    """Returns FlightHelmet: 95 thousand triangles, fifteen textures."""
    return helmet(
        chosen,
        folder,
        "FlightHelmet/FlightHelmet.gltf",
        name="flight_helmet",
        camera=Camera([0.4, 0.5, 0.85], [-0.01, 0.36, 0.0], 45.0),
        light=Light("directional", [-0.3, -0.6, -1.0], 8.0),
        about="95 thousand triangles, 15 textures, one directional light",
    )


def analytic(chosen, _folder):
    """Returns matte and mirroring spheres over a checkerboard, as in Whitted's paper of 1980, without its glass."""
    return Scene(
        "analytic",
        Camera([0.3, 1.6, 5.6], [0.2, 0.9, 0.0], 36.0),
        Light("directional", [-0.55, -1.0, -0.62], 1.0),
        # POV-Ray's reference would take most of the time.
        chosen.size // 2,
        "an endless checkerboard and three spheres, two of which mirror, one directional light, 5 reflections",
        ["povray"],
        spheres=[
            Sphere([0.95, 0.85, -0.4], 0.8, [0.06, 0.07, 0.08], 0.75),
            Sphere([-0.55, 1.25, 0.9], 0.7, [0.1, 0.1, 0.1], 0.6),
            Sphere([0.2, 0.55, -2.6], 0.55, [0.1, 0.3, 0.7], 0.0),
        ],
        checks=[[0.69, 0.013, 0.006], [0.92, 0.67, 0.01]],
        background=[0.25, 0.45, 0.75],
        depth=5,
        targets=[0.01, 0.004],
    )


def cornell_box(chosen, folder):
    """Returns the Cornell box of `scenes/`, whose surfaces light each other."""
    with open(options.REPOSITORY / "scenes/cornell_box.toml", "rb") as file:
        described = tomllib.load(file)
    polygons = [
        gltf.Polygons(shape["vertices"], shape["faces"], described["material"][surface["material"]])
        for surface in described["object"]
        for shape in [surface["shape"]["mesh"]]
    ]
    model = folder / "cornell_box.glb"
    gltf.write_glb(gltf.of_polygons(polygons), model)
    camera = described["camera"]
    return Scene(
        "cornell_box",
        Camera(camera["from"], camera["at"], camera["fov"]),
        None,
        # Noise, and not edges, is what takes the time.
        chosen.size // 4,
        "32 triangles, matte, one emissive square, interreflection",
        ["mitsuba", "cycles"],
        model,
        targets=[0.02, 0.01],
        reference_factor=8,
    )
