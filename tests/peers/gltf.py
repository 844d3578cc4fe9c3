"""Reads glTF files, takes out what renderers understand differently, and writes the rest as `.glb`."""

import json
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
JSON_CHUNK = 0x4E4F534A
BINARY_CHUNK = 0x004E4942
MAGIC = 0x46546C67


@dataclass
class Gltf:
    """A glTF file: its JSON, and the bytes of each buffer."""

    folder: Path
    json: dict
    buffers: list


@dataclass
class Mesh:
    """The triangles of one material in world space; `uv` may be None."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray | None
    triangles: np.ndarray
    material: dict


@dataclass
class Polygons:
    """Flat polygons of one material of a scene file."""

    vertices: list
    faces: list
    material: dict


def read(path):
    """Returns a `.glb`, or a `.gltf` with `.bin` files beside it."""
    data = path.read_bytes()
    if path.suffix != ".glb":
        text = json.loads(data)
        return Gltf(path.parent, text, [(path.parent / buffer["uri"]).read_bytes() for buffer in text["buffers"]])
    length = struct.unpack_from("<I", data, 12)[0]
    return Gltf(path.parent, json.loads(data[20 : 20 + length]), [memoryview(data)[28 + length :]])


def plain(gltf):
    """Returns a copy without emission, occlusion, transparency, lights and cameras, and without images for them."""
    text = json.loads(json.dumps(gltf.json))
    for material in text.get("materials", []):
        for key in ["emissiveTexture", "emissiveFactor", "occlusionTexture", "alphaMode", "alphaCutoff"]:
            material.pop(key, None)
        material["doubleSided"] = True
    for node in text["nodes"]:
        node.pop("camera", None)
        node.get("extensions", {}).pop("KHR_lights_punctual", None)
    for key in ["cameras", "extensions", "extensionsUsed", "extensionsRequired"]:
        text.pop(key, None)
    drop_unused_textures(text)
    return Gltf(gltf.folder, text, gltf.buffers)


def matte(gltf):
    """Returns a copy whose materials reflect diffusely only."""
    text = json.loads(json.dumps(gltf.json))
    for material in text["materials"]:
        factors = material.setdefault("pbrMetallicRoughness", {})
        factors.update(metallicFactor=0.0, roughnessFactor=1.0)
        material["extensions"] = {"KHR_materials_specular": {"specularFactor": 0.0}}
    text["extensionsUsed"] = ["KHR_materials_specular"]
    return Gltf(gltf.folder, text, gltf.buffers)


def of_polygons(objects):
    """Returns matte polygons, emissive ones included, as glTF, one mesh each."""
    text = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(objects)))}]}
    text["extensionsUsed"] = ["KHR_materials_specular", "KHR_materials_emissive_strength"]
    for key in ["nodes", "meshes", "materials", "accessors", "bufferViews"]:
        text[key] = []
    binary = bytearray()

    def add_accessor(array, kind):
        described = {"bufferView": len(text["bufferViews"]), "count": len(array), "type": kind}
        described["componentType"] = 5126 if array.dtype == np.float32 else 5125
        described |= {"min": array.min(0).reshape(-1).tolist(), "max": array.max(0).reshape(-1).tolist()}
        text["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        binary.extend(array.tobytes())
        text["accessors"].append(described)
        return len(text["accessors"]) - 1

    for number, made in enumerate(objects):
        # Give each polygon its own vertices, with its normal, and cut it into a fan
        corners = [np.array([made.vertices[at] for at in face], np.float32) for face in made.faces]
        normals = [np.cross(polygon[1] - polygon[0], polygon[2] - polygon[0]) for polygon in corners]
        starts = np.cumsum([0] + [len(polygon) for polygon in corners])
        fans = [start + at for start, face in zip(starts, made.faces) for k in range(2, len(face)) for at in (0, k - 1, k)]
        positions = np.vstack(corners)
        normals = np.vstack([[n / np.linalg.norm(n)] * len(polygon) for n, polygon in zip(normals, corners)])
        attributes = {
            "POSITION": add_accessor(positions, "VEC3"),
            "NORMAL": add_accessor(normals.astype(np.float32), "VEC3"),
        }
        indices = add_accessor(np.array(fans, np.uint32), "SCALAR")
        text["meshes"].append({"primitives": [{"attributes": attributes, "indices": indices, "material": number}]})
        text["nodes"].append({"mesh": number})
        text["materials"].append(polygon_material(made.material))
    text["buffers"] = [{"byteLength": len(binary)}]
    return Gltf(None, text, [bytes(binary)])


def polygon_material(described):
    """Returns a matte material of a scene file as glTF's."""
    color, emission = described["base_color"], described.get("emission", 0)
    factors = {"baseColorFactor": [*(color if color else [0, 0, 0]), 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0}
    material = {"pbrMetallicRoughness": factors, "extensions": {"KHR_materials_specular": {"specularFactor": 0.0}}}
    material["doubleSided"] = True
    if emission:
        strength = max(emission)
        material["emissiveFactor"] = [channel / strength for channel in emission]
        material["extensions"]["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
    return material


def emission(material):
    """Returns the radiance that a material emits."""
    extension = material.get("extensions", {}).get("KHR_materials_emissive_strength", {})
    return [channel * extension.get("emissiveStrength", 1) for channel in material.get("emissiveFactor", [0, 0, 0])]


def texture_slots(material):
    """Yields the texture references of a material that `plain` keeps."""
    for owner, key in [
        (material.get("pbrMetallicRoughness", {}), "baseColorTexture"),
        (material.get("pbrMetallicRoughness", {}), "metallicRoughnessTexture"),
        (material, "normalTexture"),
    ]:
        if key in owner:
            yield owner[key]


def drop_unused_textures(text):
    """Removes textures and images that no material refers to."""
    slots = [slot for material in text.get("materials", []) for slot in texture_slots(material)]
    keep_used(text, "textures", slots, "index")
    keep_used(text, "images", text.get("textures", []), "source")


def keep_used(text, key, owners, reference):
    """Reduces the list `key` to the entries that the owners' reference names, and renumbers the references."""
    used = sorted({owner[reference] for owner in owners})
    kept = [text[key][number] for number in used]
    for owner in owners:
        owner[reference] = used.index(owner[reference])
    text.pop(key, None)
    if kept:
        text[key] = kept


def write_glb(gltf, path):
    """Writes everything into one file, images included."""
    text = json.loads(json.dumps(gltf.json))
    binary, starts = bytearray(), []

    def append(data):
        binary.extend(b"\0" * (-len(binary) % 4))
        start = len(binary)
        binary.extend(data)
        return start

    for data in gltf.buffers:
        starts.append(append(data))
    for view in text["bufferViews"]:
        view["byteOffset"] = view.get("byteOffset", 0) + starts[view["buffer"]]
        view["buffer"] = 0
    for image in text.get("images", []):
        if "uri" in image:
            data = (gltf.folder / image.pop("uri")).read_bytes()
            text["bufferViews"].append({"buffer": 0, "byteOffset": append(data), "byteLength": len(data)})
            image["bufferView"] = len(text["bufferViews"]) - 1
            image["mimeType"] = "image/png" if data[:4] == b"\x89PNG" else "image/jpeg"
    binary.extend(b"\0" * (-len(binary) % 4))
    text["buffers"] = [{"byteLength": len(binary)}]
    body = json.dumps(text).encode()
    body += b" " * (-len(body) % 4)
    with open(path, "wb") as file:
        file.write(struct.pack("<III", MAGIC, 2, 28 + len(body) + len(binary)))
        file.write(struct.pack("<II", len(body), JSON_CHUNK) + body)
        file.write(struct.pack("<II", len(binary), BINARY_CHUNK))
        file.write(binary)


def image_bytes(gltf, texture):
    """Returns the encoded image of a texture reference."""
    image = gltf.json["images"][gltf.json["textures"][texture["index"]]["source"]]
    if "uri" in image:
        return (gltf.folder / image["uri"]).read_bytes()
    view = gltf.json["bufferViews"][image["bufferView"]]
    start = view.get("byteOffset", 0)
    return bytes(gltf.buffers[view["buffer"]][start : start + view["byteLength"]])


def accessor(gltf, number):
    """Returns an accessor as an array of one row per element."""
    described = gltf.json["accessors"][number]
    view = gltf.json["bufferViews"][described["bufferView"]]
    kind, width = np.dtype("<" + COMPONENTS[described["componentType"]]), WIDTHS[described["type"]]
    packed = kind.itemsize * width
    start = view.get("byteOffset", 0) + described.get("byteOffset", 0)
    strides = (view.get("byteStride", packed), kind.itemsize)
    return np.ndarray((described["count"], width), kind, gltf.buffers[view["buffer"]], start, strides).copy()


def node_matrix(node):
    """Returns the transform of a node."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", [0, 0, 0, 1])
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= node.get("scale", [1, 1, 1])
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def meshes(gltf):
    """Yields every triangle mesh of the scene in world space."""
    nodes = gltf.json["nodes"]
    waiting = [(number, np.eye(4)) for number in gltf.json["scenes"][gltf.json.get("scene", 0)]["nodes"]]
    while waiting:
        number, parent = waiting.pop(0)
        world = parent @ node_matrix(nodes[number])
        waiting += [(child, world) for child in nodes[number].get("children", [])]
        if "mesh" not in nodes[number]:
            continue
        for primitive in gltf.json["meshes"][nodes[number]["mesh"]]["primitives"]:
            attributes = primitive["attributes"]
            normals = accessor(gltf, attributes["NORMAL"]) @ np.linalg.inv(world[:3, :3])
            yield Mesh(
                (accessor(gltf, attributes["POSITION"]) @ world[:3, :3].T + world[:3, 3]).astype("f4"),
                (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype("f4"),
                accessor(gltf, attributes["TEXCOORD_0"]) if "TEXCOORD_0" in attributes else None,
                accessor(gltf, primitive["indices"]).reshape(-1, 3),
                gltf.json["materials"][primitive["material"]],
            )
