//! Numbers of the tree's triangles by instance.

use crate::accel::LANES;
use crate::mesh::simd::{Floats, WideLevel};
use crate::numeric::Lanes;

/// Range of consecutive numbers of triangles in the tree that belong to one instance.
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleRun {
    /// Number of the first triangle.
    pub(super) first: u32,
    /// Number after that of the last triangle.
    pub(super) end: u32,
    /// Index of the instance in the scene.
    pub(super) instance: u32,
}

impl TriangleRun {
    /// Returns the run of a triangle's number.
    #[inline(always)]
    pub(super) fn of(runs: &[TriangleRun], number: u32) -> &TriangleRun {
        match runs {
            [only] => only,
            runs => &runs[runs.partition_point(|run| run.first <= number) - 1],
        }
    }

    /// Returns a mask of the numbers that are in the run.
    #[inline(always)]
    pub(super) fn contains(&self, sixteen: impl WideLevel<LANES>, numbers: &Lanes<u32>) -> u32 {
        // With the sign bit inverted, unsigned numbers order as signed ones do
        let flip = Floats::splat(sixteen, -0.0);
        let first = Floats::splat(sixteen, f32::from_bits(self.first)) ^ flip;
        let end = Floats::splat(sixteen, f32::from_bits(self.end)) ^ flip;
        let numbers = Floats::load(sixteen, bytemuck::cast_ref(numbers)) ^ flip;
        numbers.lt_i32(end).bits() & !numbers.lt_i32(first).bits()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::simd::{Scalar, SimdLevel};

    #[test]
    fn numbers_of_a_run_are_found_on_both_sides_of_the_sign_bit() {
        let run = TriangleRun {
            first: 0x7fff_fffe,
            end: 0x8000_0002,
            instance: 3,
        };
        let mut numbers = [0; LANES];
        numbers[1..7].copy_from_slice(&[
            0x7fff_fffd,
            0x7fff_fffe,
            0x7fff_ffff,
            0x8000_0000,
            0x8000_0001,
            0x8000_0002,
        ]);
        assert_eq!(run.contains(Scalar.sixteen(), &numbers), 0b0011_1100);
    }
}
