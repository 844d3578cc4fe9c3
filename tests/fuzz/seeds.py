#!/usr/bin/env python3
"""Builds the start corpus of the fuzz targets, and a dictionary of words for each that reads text.

    tests/fuzz/seeds.py [FOLDER...]

Inputs come from the repository's `scenes`, from `../shared/assets` beside the repository if it is there, and from the
folders given: files are taken as they are, images, meshopt streams and Draco streams out of glTF files. What no file shows
is written by this script. Corpora go to `tests/fuzz/corpus/TARGET`, dictionaries to `tests/fuzz/corpus/TARGET.dict`.
"""

import base64
import gzip
import hashlib
import json
import pathlib
import re
import struct
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CORPUS = HERE / "corpus"
# Largest input in bytes; the length that `run.sh` lets inputs grow to is the double.
MAX_BYTES = 32 << 10
# Largest number of inputs from files for a target.
MAX_FILES = 400

MODES = ["ATTRIBUTES", "TRIANGLES", "INDICES"]
FILTERS = ["NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"]
EXTENSIONS = ["EXT_meshopt_compression", "KHR_meshopt_compression"]
DRACO = "KHR_draco_mesh_compression"
COMPONENT_COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
KEY = "0123456789abcdef" * 4
counts = {}


def add(target, data):
    """Adds an input to a target's corpus, under the hash of its bytes."""
    if isinstance(data, str):
        data = data.encode()
    if len(data) > MAX_BYTES or counts.get(target, 0) >= MAX_FILES:
        return
    folder = CORPUS / target
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / hashlib.sha1(data).hexdigest()
    counts[target] = counts.get(target, 0) + (not path.exists())
    path.write_bytes(data)


def write_dictionary(target, words):
    """Writes a dictionary of words in libFuzzer's format."""
    words = sorted({word for word in words if word.isascii() and word.isprintable() and 1 < len(word) < 64})
    quoted = (word.replace("\\", "\\\\").replace('"', '\\"') for word in words)
    (CORPUS / f"{target}.dict").write_text("".join(f'"{word}"\n' for word in quoted))


def parse_glb(data):
    """Returns the document of a binary glTF file and the contents of its binary chunk."""
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def make_glb(document, binary):
    """Returns a binary glTF file."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def read_uri(uri, folder):
    """Returns the bytes of a data URI or of a file."""
    if uri.startswith("data:"):
        kind, _, content = uri.partition(",")
        return base64.b64decode(content) if kind.endswith("base64") else content.encode()
    return (folder / uri).read_bytes()


def data_uri(data):
    """Returns bytes as a data URI."""
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode()


def add_gltf(path):
    """Adds a glTF file as JSON with data URIs and as a binary file, and what it holds."""
    data = path.read_bytes()
    if path.suffix == ".glb":
        add("glb", data)
    document, binary = parse_glb(data) if path.suffix == ".glb" else (json.loads(data), b"")
    # Gather the buffers; one without data is that of a decoder's result
    buffers = []
    for number, buffer in enumerate(document.get("buffers", [])):
        if "uri" in buffer:
            buffers.append(read_uri(buffer["uri"], path.parent))
        else:
            buffers.append(binary if number == 0 else b"")
    for image in document.get("images", []):
        if "uri" in image:
            image["uri"] = data_uri(read_uri(image["uri"], path.parent))
    add_streams(document, buffers)
    # Write all in one file of either kind
    joined = json.loads(json.dumps(document))
    if len(buffers) == 1:
        joined["buffers"][0].pop("uri", None)
        add("glb", make_glb(joined, buffers[0]))
    for buffer, content in zip(document.get("buffers", []), buffers):
        if content:
            buffer["uri"] = data_uri(content)
    add("gltf", json.dumps(document, separators=(",", ":")))


def add_streams(document, buffers):
    """Adds the images and the compressed streams of a glTF document."""
    views = document.get("bufferViews", [])

    def bytes_of(view):
        start = view.get("byteOffset", 0)
        return buffers[view["buffer"]][start : start + view["byteLength"]]

    for image in document.get("images", []):
        if "bufferView" in image:
            add("image", bytes_of(views[image["bufferView"]]))
        else:
            add("image", read_uri(image["uri"], None))
    for view in views:
        for version, name in enumerate(EXTENSIONS):
            stream = view.get("extensions", {}).get(name)
            if stream:
                mode, filter_ = MODES.index(stream["mode"]), FILTERS.index(stream.get("filter", "NONE"))
                header = struct.pack("<4BI", mode, filter_, stream["byteStride"], version, stream["count"])
                add("meshopt", header + bytes_of(stream))
    accessors = document.get("accessors", [])
    for primitive in (p for mesh in document.get("meshes", []) for p in mesh["primitives"]):
        stream = primitive.get("extensions", {}).get(DRACO)
        if stream:
            names = ["POSITION", "NORMAL", "TEXCOORD_0", "COLOR_0"]
            ids = bytes(stream["attributes"].get(name, 255) & 255 for name in names)
            points = accessors[primitive["attributes"]["POSITION"]]["count"]
            header = struct.pack("<2I", points, accessors[primitive["indices"]]["count"])
            add("draco", header + ids + bytes_of(views[stream["bufferView"]]))


def exr(channels, size, attributes=(), origin=(0, 0), display=None):
    """Returns an uncompressed EXR file of scan lines: `channels` are names with types, 0 for u32, 1 half, 2 float."""

    def attribute(name, kind, value):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(value)) + value

    def box(corner, extent):
        return struct.pack("<4i", *corner, corner[0] + extent[0] - 1, corner[1] + extent[1] - 1)

    listed = b"".join(name.encode() + b"\0" + struct.pack("<iIii", kind, 0, 1, 1) for name, kind in channels)
    header = struct.pack("<II", 20000630, 2)
    header += attribute("channels", "chlist", listed + b"\0")
    header += attribute("compression", "compression", b"\0")
    header += attribute("dataWindow", "box2i", box(origin, size))
    header += attribute("displayWindow", "box2i", box((0, 0), display or size))
    header += attribute("lineOrder", "lineOrder", b"\0")
    header += attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    header += attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0))
    header += attribute("screenWindowWidth", "float", struct.pack("<f", 1))
    for name, text in attributes:
        header += attribute(name, "string", text.encode())
    header += b"\0"
    row = b"".join(bytes([n % 60]) * (size[0] * (2 if kind == 1 else 4)) for n, (_, kind) in enumerate(channels, 1))
    first = len(header) + 8 * size[1]
    offsets = [first + y * (8 + len(row)) for y in range(size[1])]
    lines = (struct.pack("<iI", origin[1] + y, len(row)) + row for y in range(size[1]))
    return header + struct.pack(f"<{size[1]}Q", *offsets) + b"".join(lines)


def add_exr_files():
    """Adds EXR images, and pieces of frames."""
    colors = [("B", 2), ("G", 2), ("R", 2)]
    for channels in [colors, [("A", 1), ("B", 1), ("G", 1), ("R", 1)], [("Y", 2)], [("a.X", 0), ("b", 1)]]:
        for target in ["image", "exr"]:
            add(target, exr(channels, (3, 4), origin=(-1, 2), display=(8, 8)))
    sums = sorted(f"{name}.{half}" for half in ["high", "low"] for name in sum_names())
    for image in ["a.exr", "b/a.png"]:
        for shares, rows in [(1, (0, 4)), (1, (2, 2)), (2, (0, 4))]:
            frame = {
                "key": KEY, "number": 0, "image": image, "size": [2, 4], "spp": 16, "shares": shares,
                "exr": {"sample": "Half", "compression": "Piz"},
                "png": {"tone": {"exposure_ev": 0.5}, "bits": "Sixteen"},
                "notes": [["whit.plan", "shadow on"]],
            }  # fmt: skip
            notes = [("whit.frame", json.dumps(frame)), ("whit.colors", "R G B"), ("whit.samples", "8")]
            channels = colors + [("Z", 2)] if shares == 1 else [(name, 0) for name in sums]
            add("pieces", exr(channels, (2, rows[1]), notes, (0, rows[0]), (2, 4)))


def sum_names():
    """Returns the names of a piece's sums of samples."""
    return [f"radiance.{i}" for i in range(3)] + [f"weighted.{i}" for i in range(4)] + ["squares"]


def add_volumes():
    """Adds volumes of each format, encoding and number of axes."""
    numbers = bytes(range(48))
    text = " ".join(map(str, range(24))).encode()
    for sizes, axes in [("2 3 4", 3), ("3 2 2 2", 4), ("2 2 2 2", 4)]:
        for kind, encoding, data in [
            ("uint8", "raw", numbers),
            ("ushort", "gzip", gzip.compress(numbers, mtime=0)),
            ("float", "text", text),
            ("short", "raw\ndata file: data.raw\nline skip: 2\nbyte skip: -1", b""),
        ]:
            header = f"NRRD0004\ntype: {kind}\ndimension: {axes}\nsizes: {sizes}\nencoding: {encoding}\nendian: big\n"
            space = "space directions: (1,0,0) (0,1,0) (0,0,2)\nspace origin: (1,2,3)\nspacings: 1 1 2\n"
            add("volume", header.encode() + (space if axes == 3 else "").encode() + b"\n" + data)
    for kind in ["|u1", "<i2", ">f4", "<f8", "<f2"]:
        for shape in ["(2, 1, 2)", "(1, 2, 1, 3)"]:
            header = f"{{'descr': '{kind}', 'fortran_order': {'f' in kind}, 'shape': {shape}, }}".ljust(117) + "\n"
            add("volume", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + numbers)
    for element in range(5):
        add("volume", struct.pack("<4B3H", element, element % 2, 1 + element % 4, 1, 2, 1, 2) + numbers + numbers)


def add_texts():
    """Adds job files, settings, manifests, rays and checkpoints of studies."""
    example = re.search(r"```toml\n(.*?)```", (ROOT / "src/jobs/mod.rs").read_text(), re.S)[1]
    jobs = re.sub(r"(?m)^//! ?", "", example)
    add("jobs", re.sub(r'"[\w.]+\.(toml|glb)"', r'"a.\1"', jobs))
    for part in re.sub(r'"[\w.]+\.(toml|glb)"', r'"a.\1"', jobs).split("[[job]]")[1:]:
        add("jobs", "[[job]]" + part)
    for path in sorted((ROOT / "scenes").glob("*.jobs.toml")):
        add("jobs", re.sub(r'"[\w.]+\.(toml|glb)"', r'"a.\1"', path.read_text()))
    add("settings", "[settings]\nspp = 16\npattern = 'sobol'\nadaptive = 0.01\ndepth = 8\ncutoff = 0.001\n"
        "backend = 'bsp'\nmarch_step = 2.0\ntexture_filter = false\n")  # fmt: skip
    add("settings", "[settings]\nlight_samples = 4\n[measured]\nscene = 'a.toml'\nsize = [8, 8]\nthreads = 1\nconverged = true\n"
        "rmse = { value = 1.0, low = 0.5, high = 2.0 }\nseconds = { value = 1.0, low = 0.5, high = 2.0 }\n")  # fmt: skip
    done = {"frame": 0, "image": "a.png", "key": KEY, "bytes": 4, "seconds": 0.5, "samples": 1, "spp": 1, "by": "host 1"}
    for image in ["a.png", "b.png"]:
        add("manifest", json.dumps({**done, "image": image}))
    add("manifest", f"{json.dumps(done)}\n\n{json.dumps({**done, 'frame': 1})}\n{{\"frame\": 4, \"ima")
    ray = " ".join(["3f800000"] * 6 + ["00000000", "7f800000", "3e800000"])
    add("rays", f"whit rays 1\n# comment\nscene a.glb\nholds 2 12\nanswers Embree 3 | BSP\n"
        f"camera tie edge | {ray} | hit 0 12 40b3c1a2 | nothing\nshadow wrong nan | {ray} | free | blocked\n")  # fmt: skip
    head = {
        "size": [2, 1], "mosaic": None, "threads": 1, "target": None, "base_spp": 4, "reach": {"start": 0, "end": 1},
        "reference_spp": 16, "reference_count": 2, "stricter_spp": 16, "left": [], "blocks": [[1.0, 2.0]],
        "pixel_blocks": 1, "words": [{"spp": "4"}], "checksum": 7, "spent": 1.5,
    }  # fmt: skip
    add("study", b"whit study 1\n" + json.dumps(head).encode() + b"\n" + bytes(256))


def with_small_files(text):
    """Returns a scene file that names the files of the target in place of its own, and has clouds of few samples."""
    kinds = {"toml": "toml", "glb": "glb", "gltf": "glb", "npy": "nrrd", "nrrd": "nrrd"}
    text = re.sub(r'"[\w/.]+\.(toml|glb|gltf|npy|nrrd|png|jpg|exr|hdr)"', lambda name: f'"a.{kinds.get(name[1], "hdr")}"', text)
    return re.sub(r"(?m)^(cloud = .*size = )\[[^]]*\]", r"\1[8, 8, 8]", text)


def names_of(value):
    """Yields the names of members and the short strings of a JSON value."""
    if isinstance(value, dict):
        yield from value
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from names_of(item)
    elif isinstance(value, str):
        yield value


def main():
    assets = ROOT.parent / "shared/assets"
    folders = [ROOT / "scenes", ROOT / "tests/golden", *([assets] if assets.is_dir() else [])]
    folders += map(pathlib.Path, sys.argv[1:])
    words = set(EXTENSIONS + [DRACO])
    CORPUS.mkdir(exist_ok=True)
    # Small files first, as they are the fastest
    files = sorted((path for folder in folders for path in folder.rglob("*") if path.is_file()), key=lambda p: p.stat().st_size)
    for path in files:
        suffix = path.suffix.lower()
        if suffix in [".glb", ".gltf"] and path.stat().st_size < 8 * MAX_BYTES:
            try:
                add_gltf(path)
                document = parse_glb(path.read_bytes())[0] if suffix == ".glb" else json.loads(path.read_bytes())
                words.update(word for word in names_of(document) if re.fullmatch(r"[A-Za-z_0-9/]+", word))
            except (ValueError, OSError, LookupError, TypeError, AttributeError, struct.error):
                # Files that are invalid on purpose are inputs, too, as they are
                add(suffix[1:], path.read_bytes())
        elif suffix in [".png", ".jpg", ".jpeg", ".webp", ".hdr", ".exr"]:
            add("image", path.read_bytes())
            if suffix == ".exr":
                add("exr", path.read_bytes())
        elif suffix in [".nrrd", ".nhdr", ".npy"]:
            add("volume", path.read_bytes())
        elif suffix == ".toml" and not path.name.endswith(".jobs.toml"):
            add("scene_file", with_small_files(path.read_text()))
    add_exr_files()
    add_volumes()
    add_texts()
    # Dictionaries: names of glTF, of the schema of scene files, and of what this script writes
    for target in ["gltf", "glb"]:
        write_dictionary(target, words)
    schema = json.loads((ROOT / "scenes/schema.json").read_text())
    write_dictionary("scene_file", (word for word in names_of(schema) if re.fullmatch(r"[\w-]+", word)))
    for target in ["jobs", "settings", "manifest", "rays", "study", "volume", "pieces"]:
        texts = (path.read_bytes().decode("latin-1") for path in (CORPUS / target).iterdir())
        write_dictionary(target, (word for text in texts for word in re.findall(r"[A-Za-z_.]{3,}|\[\[\w+\]\]", text[:4096])))
    for target in sorted(counts):
        print(f"{target:12} {len(list((CORPUS / target).iterdir())):4} inputs")


if __name__ == "__main__":
    main()
