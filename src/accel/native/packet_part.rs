//! Parts of packets: as many rays as a register holds.

use crate::accel::RayPacket;
use crate::mesh::simd::lanes;
use crate::numeric::{Lanes, Lanes3};

/// Returns `N` lanes: those of that part of a packet.
#[inline(always)]
pub(super) fn part_of<T, const N: usize>(row: &Lanes<T>, part: usize) -> &[T; N] {
    &row.as_chunks::<N>().0[part]
}

/// Returns `N` lanes of each axis.
#[inline(always)]
pub(super) fn axes_of<const N: usize>([x, y, z]: &Lanes3<f32>, part: usize) -> [[f32; N]; 3] {
    [*part_of(x, part), *part_of(y, part), *part_of(z, part)]
}

/// Returns the bits of each lane.
#[inline(always)]
pub(super) fn bits_of<const N: usize>(values: &[f32; N]) -> [u32; N] {
    let mut out = [0; N];
    for lane in 0..N {
        out[lane] = values[lane].to_bits();
    }
    out
}

/// Hits of the rays of a part.
pub(super) struct PartHits<const N: usize> {
    /// Mask of the rays with hits.
    pub(super) mask: u32,
    pub(super) t: [f32; N],
    pub(super) u: [f32; N],
    pub(super) v: [f32; N],
    /// Running indices of the triangles hit.
    pub(super) numbers: [u32; N],
}

impl<const N: usize> PartHits<N> {
    /// Writes the hits into that part of a packet. The instances become 0: they follow from the numbers.
    #[inline(always)]
    pub(super) fn write(&self, packet: &mut RayPacket, part: usize) {
        write_lanes(self.mask, &mut packet.t_far, part, &self.t);
        write_lanes(self.mask, &mut packet.u, part, &self.u);
        write_lanes(self.mask, &mut packet.v, part, &self.v);
        write_lanes(self.mask, &mut packet.primitive, part, &self.numbers);
        write_lanes(self.mask, &mut packet.instance, part, &[0; N]);
    }
}

/// Replaces the lanes of a mask in that part of a packet.
#[inline(always)]
pub(super) fn write_lanes<T: Copy, const N: usize>(
    mask: u32,
    row: &mut Lanes<T>,
    part: usize,
    values: &[T; N],
) {
    let row = &mut row.as_chunks_mut::<N>().0[part];
    if mask == u32::MAX >> (u32::BITS as usize - N) {
        *row = *values;
        return;
    }
    // Else one by one: a store of eight lanes by a mask takes five times as long as a whole one on Zen 3
    for lane in lanes(mask) {
        row[lane % N] = values[lane % N];
    }
}
