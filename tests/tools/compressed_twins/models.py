"""Models that twins are made of: the default ones, and what a file consists of."""

import hashlib
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

# Folders of files that are broken on purpose: the validator's suite, and normals of zero length, which Draco can't keep.
EXCLUDED = ["khronos-validator", "BoxBadNormals-glTF-Binary"]


@dataclass(frozen=True)
class Model:
    """A glTF file, and the name of its twins."""

    name: str
    path: Path


def named(paths: list[Path]) -> list[Model]:
    """Returns the models of these files, each file once, under names that differ."""
    models: dict[str, Model] = {}
    seen = set()
    for path in paths:
        digest = hashlib.sha256(path.read_bytes()).digest()
        if digest in seen:
            continue
        seen.add(digest)
        name, number = path.stem, 2
        while name in models:
            name, number = f"{path.stem}_{number}", number + 1
        models[name] = Model(name, path)
    return list(models.values())


def found(folders: list[Path]) -> list[Path]:
    """Returns the glTF files under these folders."""
    files = [file for folder in folders for file in sorted(folder.rglob("*")) if file.suffix in [".glb", ".gltf"]]
    return [file for file in files if not set(file.parts) & set(EXCLUDED)]


def document(path: Path) -> dict:
    """Returns the JSON of a .gltf or .glb file."""
    data = path.read_bytes()
    if data[:4] != b"glTF":
        return json.loads(data)
    # After the file's head of 12 bytes, the first chunk is the JSON, with its length and kind before it
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length])


def extensions(path: Path) -> set[str]:
    """Returns the names of the extensions that a file uses."""
    return set(document(path).get("extensionsUsed", []))


def bytes_of(path: Path) -> int:
    """Returns the size of a file together with the buffers and images that it refers to."""
    head = document(path)
    uris = {item.get("uri", "data:") for kind in ["buffers", "images"] for item in head.get(kind, [])}
    others = [path.parent / unquote(uri) for uri in uris if not uri.startswith("data:")]
    return sum(file.stat().st_size for file in [path, *others] if file.exists())
