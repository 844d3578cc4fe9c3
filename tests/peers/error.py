"""Displayed error of an image, and reading what renderers write.

An image is an array of height x width x 3 linear radiances, top row first.
"""

import math
import re
from pathlib import Path

import numpy as np


def displayed(image):
    """Returns the values on a screen: clipped to 0 to 1, then through the sRGB curve."""
    clipped = np.clip(image, 0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * np.maximum(clipped, 1e-9) ** (1 / 2.4) - 0.055)


def rmse(image, reference):
    """Returns the root mean square difference of displayed values, over pixels and channels."""
    return float(np.sqrt(np.mean((displayed(image) - displayed(reference)) ** 2)))


def read(path):
    """Returns the image of an EXR, a NumPy array or a 16-bit PPM of sRGB values."""
    path = Path(path)
    if path.suffix == ".npy":
        return np.load(path).astype(np.float32)[..., :3]
    if path.suffix == ".ppm":
        return read_ppm(path)
    import OpenEXR

    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    return np.stack([np.asarray(channels[name].pixels, np.float32) for name in "RGB"], -1)


def read_ppm(path):
    """Returns the radiances of a PPM whose values are sRGB."""
    data = path.read_bytes()
    # Comments may stand between the four words of the head
    words = re.sub(rb"#[^\n]*\n", b"", data[:1000]).split(maxsplit=4)
    kind, width, height, largest = words[:4]
    width, height, largest = int(width), int(height), int(largest)
    if kind != b"P6":
        raise ValueError(f"{path} is no binary PPM")
    samples = np.frombuffer(data[-width * height * 3 * (2 if largest > 255 else 1) :], ">u2" if largest > 255 else "u1")
    value = samples.reshape(height, width, 3) / largest
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


def at_error(points, target):
    """Returns the seconds at which the error reaches the target, or None if no point does.

    `points` are pairs of error and seconds in the order of growing effort. Between the last point above the target and
    the first below it, the seconds follow a power of the error. A first point below the target gives its own seconds.

    >>> at_error([(0.04, 1.0), (0.01, 4.0)], 0.02)
    2.0
    """
    for at, (error, seconds) in enumerate(points):
        if error > target:
            continue
        if at == 0:
            return seconds
        error_before, seconds_before = points[at - 1]
        share = math.log(error_before / target) / math.log(error_before / error)
        return seconds_before * (seconds / seconds_before) ** share
    return None
