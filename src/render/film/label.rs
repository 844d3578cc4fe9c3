//! Labels of rays on the film of a tile: the pixel, the sample within the wave, and the first step of the path.

use super::super::profile::Category;
use super::super::tile::TILE;
use super::super::wavefront::MAX_WAVE;
use crate::numeric::LANES;

/// Number of label bits for the pixel within the tile; the bits above hold the sample within the wave.
pub(in crate::render) const PIXEL_BITS: u32 = (TILE * TILE).ilog2();
const _: () =
    assert!(TILE * TILE == 1 << PIXEL_BITS && ((MAX_WAVE * LANES) << PIXEL_BITS) <= 1 << STEP_SHIFT);

/// Number of label bits below those of the first step: pixel and sample.
pub(in crate::render) const STEP_SHIFT: u32 = 22;

/// First steps of paths from the camera, in the order of their numbers in labels, from 1.
pub(in crate::render) const STEPS: [Category; 8] = [
    Category::Reflection,
    Category::Refraction,
    Category::RoughReflection,
    Category::RoughRefraction,
    Category::Dispersion,
    Category::Volume,
    Category::Subsurface,
    Category::Interreflection,
];

/// Returns the pixel of a label, within the tile.
#[inline(always)]
pub(in crate::render) fn pixel_of(label: u32) -> u32 {
    label & ((1 << PIXEL_BITS) - 1)
}

pub(in crate::render) fn number_of(step: Category) -> usize {
    STEPS.iter().position(|&s| s == step).map_or(0, |index| index + 1)
}

/// Returns the label with `step` as its first step, if it has none yet.
pub(in crate::render) fn with_step(label: u32, step: Category) -> u32 {
    match label >> STEP_SHIFT {
        0 => label | (number_of(step) as u32) << STEP_SHIFT,
        _ => label,
    }
}

/// Returns the label without its first step.
pub(in crate::render) fn without_step(label: u32) -> u32 {
    label & ((1 << STEP_SHIFT) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn label_keeps_pixel_sample_and_first_bounce() {
        let label = (1 << STEP_SHIFT) - 7;
        let mirrored = with_step(label, Category::Reflection);
        assert_ne!(mirrored, label);
        assert_eq!(with_step(mirrored, Category::Refraction), mirrored);
        assert_eq!(without_step(mirrored), label);
        assert_eq!(pixel_of(mirrored), pixel_of(label));
    }
}
