"""Kinds of twins: which encoder makes them by which flags, and what it loses."""

from dataclasses import dataclass
from pathlib import Path

from compressed_twins.tolerance import Loss


@dataclass(frozen=True)
class Kind:
    """A kind of twin."""

    name: str
    # Each entry is an encoder with its flags; the next one reads what it wrote
    steps: tuple[tuple[str, ...], ...]
    # Shows in the file that something was encoded; empty if any outcome is a twin
    extension: str
    loss: Loss

    @property
    def is_for_textures(self) -> bool:
        """Whether it differs from the plain model in textures only."""
        return self.extension in [WEBP, KTX2]

    def commands(self, environment: Path, source: Path, twin: Path) -> list[list[str]]:
        """Returns the commands that make the twin, in turn."""
        files = [source, *(twin.with_suffix(f".{number}.glb") for number in range(1, len(self.steps))), twin]
        return [command(environment, step, *files[at : at + 2]) for at, step in enumerate(self.steps)]


def command(environment: Path, step: tuple[str, ...], source: Path, output: Path) -> list[str]:
    """Returns the command of one encoder."""
    encoder, *flags = step
    program = str(environment / "node_modules/.bin" / encoder)
    if encoder == "gltf-transform":
        return [program, flags[0], str(source), str(output), *flags[1:]]
    if encoder == "ktx2.mjs":
        return ["node", str(environment / encoder), *flags, str(source), str(output)]
    return [program, "-i", str(source), "-o", str(output), *flags]


def transform(*flags: str) -> tuple[str, ...]:
    """Returns a step of `gltf-transform`."""
    return ("gltf-transform", *flags)


def pack(*flags: str) -> tuple[str, ...]:
    """Returns a step of `gltfpack`, which does not simplify by default; animations keep their keys."""
    return ("gltfpack", *flags, "-af", "0")


DRACO, WEBP, KTX2 = "KHR_draco_mesh_compression", "EXT_texture_webp", "KHR_texture_basisu"
QUANTIZED, INSTANCED = "KHR_mesh_quantization", "EXT_mesh_gpu_instancing"
EXT, KHR = "EXT_meshopt_compression", "KHR_meshopt_compression"

# Bits are the defaults that each encoder's help names.
TRANSFORM_LOSS = Loss(position_bits=14, texcoord_bits=12, normal_bits=10)
PIPELINE_LOSS = Loss(position_bits=11, texcoord_bits=10, normal_bits=8)
PACK_LOSS = Loss(position_bits=14, texcoord_bits=12, normal_bits=8)
# Simplification moves the surface by 1e-4 of a mesh's extent, as much as half a step of 12 bits does.
OPTIMIZED_LOSS = Loss(position_bits=12, texcoord_bits=12, normal_bits=10, texture_psnr=35)

KINDS = [
    Kind("draco", (transform("draco"),), DRACO, TRANSFORM_LOSS),
    Kind("draco-sequential", (transform("draco", "--method", "sequential"),), DRACO, TRANSFORM_LOSS),
    Kind("draco-pipeline", (("gltf-pipeline", "-b", "-d"),), DRACO, PIPELINE_LOSS),
    Kind("meshopt-ext", (pack("-c", "-ce", "ext"),), EXT, PACK_LOSS),
    Kind("meshopt-khr", (pack("-c", "-ce", "khr"),), KHR, PACK_LOSS),
    # Floats by the exponential filter: vectors share an exponent, and keep as many bits as integers would
    Kind("meshopt-floats", (pack("-cc", "-ce", "khr", "-vpf", "-vtf", "-vnf"),), KHR, PACK_LOSS),
    Kind("quantized", (transform("quantize"),), QUANTIZED, TRANSFORM_LOSS),
    # Exporters write equal meshes apart
    Kind("instanced", (transform("dedup"), transform("instance", "--min", "2")), INSTANCED, Loss()),
    Kind("instanced-quantized", (pack("-mi"),), INSTANCED, PACK_LOSS),
    # Typical peak signal-to-noise ratios of photographs at each encoder's default quality
    Kind("webp", (transform("webp"),), WEBP, Loss(texture_psnr=35)),
    Kind("webp-lossless", (transform("webp", "--lossless", "true"),), WEBP, Loss()),
    Kind("ktx2-uastc", (("ktx2.mjs", "uastc"),), KTX2, Loss(texture_psnr=40)),
    Kind("ktx2-etc1s", (("ktx2.mjs", "etc1s"),), KTX2, Loss(texture_psnr=28)),
    Kind("optimized", (transform("optimize"),), "", OPTIMIZED_LOSS),
]
