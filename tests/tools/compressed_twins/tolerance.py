"""How far a twin's image may be from the plain model's, as the RMSE of displayed values (0 to 1)."""

import math
from dataclasses import dataclass

# Of whit's images in this comparison.
SIZE = 256
SPP = 16
# Share of the pixels that an edge of the geometry or of a texture crosses, and the difference across it: both are those
# of a model with much detail.
EDGE_SHARE = 0.05
EDGE_CONTRAST = 0.5
# Change of displayed values over a change of the normal in radians: 1 on matte surfaces, more in highlights.
NORMAL_GAIN = 2
# What rounding of 32-bit floats leaves: a few samples that fall beside an edge rather than on it.
ROUNDING = 0.002
# The difference of two decoders that both follow a lossy format: one 8-bit code.
DECODERS = 1 / 255


@dataclass(frozen=True)
class Loss:
    """What an encoder loses: the bits that are left of each attribute, and a texture's error in decibels."""

    position_bits: int | None = None
    texcoord_bits: int | None = None
    normal_bits: int | None = None
    texture_psnr: float | None = None

    def plain_tolerance(self) -> float:
        """Returns the largest RMSE between the images of the plain model and of the twin."""
        texture = 0 if self.texture_psnr is None else 10 ** (-self.texture_psnr / 20)
        return ROUNDING + edges(self.position_bits) + edges(self.texcoord_bits) + normals(self.normal_bits) + texture

    def decoded_tolerance(self) -> float:
        """Returns the largest RMSE between the images of the twin and of what the reference decoders make of it."""
        return ROUNDING + (0 if self.texture_psnr is None else DECODERS)


def edges(bits: int | None) -> float:
    """Returns the RMSE that edges cause if the image is as wide as the grid of these bits.

    An edge moves by half a step at most: `shift` pixels. Of the samples of a pixel on it, `shift * SPP` change sides on
    average: mostly none and seldom one, or all of a strip.
    """
    if bits is None:
        return 0
    shift = SIZE * 2.0 ** -(bits + 1)
    return EDGE_CONTRAST * math.sqrt(EDGE_SHARE * (shift / SPP + shift**2))


def normals(bits: int | None) -> float:
    """Returns the RMSE that rounded normals cause: each of two coordinates from -1 to 1 is half a step off."""
    return 0 if bits is None else NORMAL_GAIN * math.sqrt(2) * 2.0**-bits
