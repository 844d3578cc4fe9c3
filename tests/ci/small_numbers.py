#!/usr/bin/env python3
"""Fails if a number below a thousandth stands in src without being listed here.

A fixed tolerance of, say, 1e-4 is wrong for scenes of a millimetre and of a million metres: what counts as small has to
be derived from the values at hand, as a bound on their rounding. So every small number of the sources is listed below
with the reason why it is no tolerance, and a new one fails until it is. Tests, comments, strings and `src/verify`
(hard cases and how right their answers must be; no image depends on them) are not read.

    tests/ci/small_numbers.py
"""

import re
import sys
from pathlib import Path

LIMIT = 1e-3
SOURCES = Path(__file__).resolve().parents[2] / "src"
LEFT_OUT = "verify/"

# The file under src, the number as written, and what it is.
ALLOWED = [
    ("accel/hit_compare.rs", "5.960_464_477_539_063e-8", "2^-24, the rounding of f32, of values at hand"),
    ("accel/bsp/error_bounds.rs", "5.960_464_5e-8", "2^-24, the rounding of f32, of values at hand"),
    ("accel/bsp/error_bounds.rs", "7.888_609e-31", "2^-100, whose reciprocal f32 still holds"),
    ("accel/embree/query/ray_packet.rs", "1e-17", "Embree's own limit of direction components"),
    ("accel/extents/hull.rs", "1e-5", "of the map's own scale"),
    ("accel/extents/guard.rs", "1.972_152_3e-31", "2^-102, whose reciprocal f32 still holds"),
    ("accel/native/group/decide.rs", "1e-9", "of the products at hand: more than f64 rounds, and no leak in 10^7 rays"),
    ("accel/native/group/edges.rs", "5e-7", "8 · 2^-24, rounded up, of values at hand"),
    ("accel/native/group/edges.rs", "1e-6", "16 · 2^-24, rounded up, of values at hand"),
    ("accel/native/group/frustum.rs", "1e-30", "a depth whose reciprocal f32 still holds"),
    ("accel/native/group/leaf.rs", "2e-6", "32 · 2^-24, rounded up, of values at hand"),
    ("accel/native/group/leaf.rs", "1e-30", "a depth whose reciprocal f32 still holds"),
    ("accel/native/group/start.rs", "1e-6", "16 · 2^-24, rounded up, of values at hand"),
    ("render/adaptive/target.rs", "1e-6", "the least target that the command line takes"),
    ("bench/times.rs", "1e-6", "rays in millions"),
    ("cost/knob.rs", "1e-7", "a place of a knob that shows what such offsets do"),
    ("cost/knob.rs", "1e-5", "a place of a knob that shows what such offsets do"),
    ("image/tone_operator.rs", "0.000_090_537", "a coefficient of a published fit"),
    ("image/tone_operator.rs", "1e-10", "of white: far below the curve's darkest, 2^-12.5"),
    ("numeric/animated_transform.rs", "1e-9", "an iteration's step, of a matrix whose scale was taken out"),
    ("numeric/lane_math.rs", "7.915_349_942_898_145e-4", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "3.479_331_075_960_212e-5", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "1.984_126_982_985_795e-4", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "2.755_731_370_707_007e-6", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "2.505_076_025_340_686_3e-8", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "1.589_690_995_211_55e-10", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "2.480_158_728_947_673e-5", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "2.755_731_435_139_066_3e-7", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "2.087_572_321_298_175e-9", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "1.135_964_755_778_819_5e-11", "a coefficient of a minimax polynomial"),
    ("numeric/lane_math.rs", "6.077_100_506_506_192e-11", "the low part of π/2"),
    ("numeric/lane_math.rs", "1.908_214_929_270_587_7e-10", "the low part of ln 2"),
    ("numeric/spawn.rs", "1.788_139_4e-7", "3 · 2^-24, of values at hand"),
    ("numeric/spawn.rs", "5.960_464_5e-8", "2^-24, the rounding of f32, of values at hand"),
    ("numeric/double_double.rs", "2.319_046_813_846_299_6e-17", "the low part of ln 2"),
    ("optics/dispersion.rs", "1e-6", "square nanometres in square micrometres"),
    ("optics/subsurface/dipole.rs", "1e-15", "coefficients in the unit of the scene's size, under which nothing scatters"),
    ("optics/subsurface/fast_exp.rs", "1.428_606_8e-6", "the low part of ln 2"),
    ("optics/subsurface/presets.rs", "0.0002", "a measured coefficient"),
    ("processor_time.rs", "1e-9", "nanoseconds in seconds"),
    ("report/text/bench.rs", "1e-6", "rays in millions"),
    ("scene/environment/sky.rs", "0.0008", "a coefficient of a published model"),
    ("scene/environment/sky.rs", "0.0004", "a coefficient of a published model"),
    ("shape/torus.rs", "1.1e-8", "√2^-53, of a torus of radius 1"),
    ("volume/optical_depth.rs", "1.908_214_929_270_587_7e-10", "the low part of ln 2"),
    ("volume/march.rs", "1e-7", "the default of a setting: the share of light that a march may lose"),
    ("shading/sheen.rs", "0.0006", "an albedo of a table of integrals"),
    ("shading/sheen.rs", "0.0001", "an albedo of a table of integrals"),
    ("shading/sheen.rs", "0.0005", "an albedo of a table of integrals"),
    ("shading/thin_film.rs", "5.4856e-13", "a published sensitivity of the eye"),
    ("shading/thin_film.rs", "4.4201e-13", "a published sensitivity of the eye"),
    ("shading/thin_film.rs", "5.2481e-13", "a published sensitivity of the eye"),
    ("shading/thin_film.rs", "9.7470e-14", "a published sensitivity of the eye"),
    ("shading/thin_film.rs", "1.0685e-7", "the published integral of a sensitivity"),
    ("shading/thin_film.rs", "1e-9", "metres per nanometre"),
]

# A number that is not a part of a name, a field or a longer number.
NUMBER = re.compile(r"(?<![\w.])\d[\d_]*(?:\.[\d_]+)?(?:e[+-]?\d+)?")
STRING = re.compile(r'"(?:\\.|[^"\\])*"')
TEST_MODULE = re.compile(r"#\[cfg\(test\)\]\n(?:pub\(\w+\) )?mod tests\b")


def small_numbers(line):
    """Returns the positive numbers of a line of Rust below LIMIT, as written, without their type."""
    code = STRING.sub('""', line).split("//")[0]
    numbers = (match.rstrip("_") for match in NUMBER.findall(code))
    return [number for number in numbers if 0 < float(number.replace("_", "")) < LIMIT]


def is_test_module(path):
    """Tells whether a file holds tests alone, by its name or by the attribute at its `mod` line."""
    if path.name == "tests.rs":
        return True
    parent = path.with_name("mod.rs")
    declared = re.compile(r"#\[cfg\(test\)\]\n(?:pub\(\w+\) )?mod %s;" % path.stem)
    return parent.exists() and bool(declared.search(parent.read_text()))


def check_self():
    """Checks that small numbers are found however they are written."""
    assert small_numbers("if x < 1e-4 { 0.000_5 }") == ["1e-4", "0.000_5"]
    assert small_numbers("const E: f32 = 1e-6_f32;") == ["1e-6"]
    assert small_numbers("x1e * 0.5 + 3.0 - 0.0 + a.0 * 1e-3 // 1e-9") == []
    assert small_numbers('warn("less than 1e-4", 2e-4)') == ["2e-4"]


def main():
    check_self()
    files = [path for path in sorted(SOURCES.rglob("*.rs")) if not is_test_module(path)]
    assert len(files) > 100, f"only {len(files)} files were read"
    missing = {(file, number) for file, number, _ in ALLOWED}
    known = set(missing)
    unknown = []
    for path in files:
        name = path.relative_to(SOURCES).as_posix()
        if name.startswith(LEFT_OUT):
            continue
        code = TEST_MODULE.split(path.read_text())[0]
        for at, line in enumerate(code.splitlines(), start=1):
            for number in small_numbers(line):
                missing.discard((name, number))
                if (name, number) not in known:
                    unknown.append(f"src/{name}:{at}: {number}")
    for line in unknown:
        print(f"{line}: derive it from the values at hand, or list it in {Path(__file__).name} with the reason")
    for file, number in sorted(missing):
        print(f"src/{file}: {number} is listed in {Path(__file__).name} and no longer there")
    if unknown or missing:
        sys.exit(1)
    print(f"{len(known)} small numbers in {len(files)} files, each with its reason")


if __name__ == "__main__":
    main()
