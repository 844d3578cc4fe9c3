#!/usr/bin/env python3
"""Holds `whit compare` against the reference programs of FLIP and SSIM, on public pictures.

Needs `pip install flip-evaluator scikit-image OpenEXR pillow`; the pictures are those that come with scikit-image: a
photograph with noise (for whose SSIM the authors of IPOL article 2017/171 published 0.35796), compressed, blurred and
moved ones, and the two sides of a stereo pair of the Middlebury benchmark.

    tests/tools/reference_metrics.py target/release/whit
"""

import io
import json
import os
import subprocess
import sys
import tempfile

import flip_evaluator
import numpy as np
import OpenEXR
import skimage.data
from PIL import Image
from skimage.filters import gaussian
from skimage.metrics import structural_similarity

LUMA = np.array([0.299, 0.587, 0.114])


def colored(picture):
    return np.repeat(picture[..., None], 3, 2) if picture.ndim == 2 else picture[..., :3]


def compressed(picture, quality):
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=quality)
    return np.array(Image.open(file))


def bundled(name):
    return colored(np.array(Image.open(os.path.join(os.path.dirname(skimage.data.__file__), name))))


def pairs():
    # The noise of scikit-image's own test against IPOL.
    np.random.seed(5)
    camera = skimage.data.camera()
    noisy = np.clip(camera + 20.0 * np.random.randn(*camera.shape), 0, 255).astype(np.uint8)
    astronaut, coffee, cat = skimage.data.astronaut(), skimage.data.coffee(), skimage.data.chelsea()
    blurred = (255.0 * gaussian(coffee, 2, channel_axis=2) + 0.5).astype(np.uint8)
    return {
        "camera, noise": (colored(camera), colored(noisy)),
        "astronaut, JPEG": (astronaut, compressed(astronaut, 20)),
        "coffee, blurred": (coffee, blurred),
        "motorcycle, stereo": (bundled("motorcycle_left.png"), bundled("motorcycle_right.png")),
        "cat, moved": (cat, np.roll(cat, 1, 1)),
    }


def radiance(picture):
    """Eight powers of two for the 256 codes."""
    return np.exp2(picture.astype(np.float32) / 32 - 4).astype(np.float32)


def write_exr(path, picture):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": picture}) as file:
        file.write(path)


def compare(whit, reference, picture, folder):
    report = os.path.join(folder, "report.json")
    subprocess.run([whit, "compare", reference, picture, "--json", report], check=True, stdout=subprocess.DEVNULL)
    with open(report) as file:
        return json.load(file)


def main(whit):
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        path = lambda name: os.path.join(folder, name)
        for name, (reference, picture) in pairs().items():
            Image.fromarray(reference).save(path("a.png"))
            Image.fromarray(picture).save(path("b.png"))
            write_exr(path("a.exr"), radiance(reference))
            write_exr(path("b.exr"), radiance(picture))
            shown = compare(whit, path("a.png"), path("b.png"), folder)
            lit = compare(whit, path("a.exr"), path("b.exr"), folder)
            unit = lambda codes: (codes / 255).astype(np.float32)
            flip = flip_evaluator.evaluate(unit(reference), unit(picture), "LDR", applyMagma=False)[1]
            hdr = flip_evaluator.evaluate(radiance(reference), radiance(picture), "HDR", applyMagma=False)[1]
            ssim = structural_similarity(
                reference @ LUMA,
                picture @ LUMA,
                data_range=255,
                gaussian_weights=True,
                sigma=1.5,
                use_sample_covariance=False,
            )
            for metric, ours, theirs in [
                ("FLIP", shown["flip"], flip),
                ("HDR-FLIP", lit["flip_hdr"], hdr),
                ("SSIM", shown["ssim"], ssim),
            ]:
                print(f"{name:20}{metric:10}{ours:.9f} {theirs:.9f} {ours - theirs:+.1e}")
                worst = max(worst, abs(ours - theirs))
    return 0 if worst < 1e-4 else 1


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1]))
