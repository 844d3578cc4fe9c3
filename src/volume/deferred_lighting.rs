//! Deferred lighting of volume samples: samples of one ray are queued, and the in-scattered light is computed for
//! sixteen at a time.
//!
//! Only samples that contribute are queued: lights are evaluated for whole batches of points that scatter light,
//! however much of the march is empty. Once lit, samples are composited in their order along the ray.

use super::composite::Composite;
use super::ray_segment::RaySegment;
use super::sample_batch::{QUEUE_CAPACITY, ShadedSamples};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Sixteen points along a ray, for lighting.
#[derive(Clone, Copy, Debug)]
pub struct PointLanes {
    /// Positions in world space.
    pub points: Lanes3<f64>,
    /// Mask: bit `l` is set if lane `l` scatters light; the other lanes are ignored.
    pub active: u16,
}

/// Callback for in-scattering at sixteen points of a ray: returns the linear RGB radiance that a medium of albedo 1
/// scatters to the viewer. For a light of irradiance E that is E times the phase function, which is 1 / (4 pi) for
/// isotropic scattering.
pub type Lighting<'l> = &'l mut dyn FnMut(&PointLanes) -> Lanes3<f64>;

/// Queue of samples with their optical properties, nearest first.
#[derive(Clone, Debug)]
pub(super) struct PendingSamples {
    /// One row a property, as numbered by [`T`] and the constants after it.
    rows: [[f64; QUEUE_CAPACITY]; ROWS],
    /// Number of pending samples: fewer than sixteen, except while more are being added.
    filled: usize,
}

/// Number of properties of a sample: ray parameter, alpha, share, and three channels each of scattering and emission.
const ROWS: usize = 9;
const T: usize = 0;
const ALPHA: usize = 1;
const SHARE: usize = 2;
const SCATTERING: usize = 3;
const EMISSION: usize = 6;

impl PendingSamples {
    /// Queue without pending samples.
    pub(super) const NONE: PendingSamples = PendingSamples {
        rows: [[0.0; QUEUE_CAPACITY]; ROWS],
        filled: 0,
    };

    /// Returns whether no samples are pending.
    pub(super) fn is_empty(&self) -> bool {
        self.filled == 0
    }

    /// Returns whether there are enough samples for a full batch of lighting.
    #[inline(always)]
    pub(super) fn is_full(&self) -> bool {
        self.filled >= LANES
    }

    /// Appends those of the first `count` samples that contribute to the pending ones, which are fewer than sixteen.
    #[inline(always)]
    pub(super) fn push(&mut self, t: &Lanes<f64>, seen: &ShadedSamples, count: usize) {
        // Collect the rows of the batch
        let from = self.filled % LANES;
        let [red, green, blue] = &seen.medium.scattering;
        let [red_sent, green_sent, blue_sent] = &seen.medium.emission;
        let rows: [&Lanes<f64>; ROWS] = [
            t,
            &seen.alpha,
            &seen.share,
            red,
            green,
            blue,
            red_sent,
            green_sent,
            blue_sent,
        ];
        // Copy whole rows if all samples contribute
        let mut left = u32::from(seen.contributes) & ((1 << count) - 1);
        if left.count_ones() as usize == count {
            // Lanes beyond `count` are overwritten by the next call.
            for (own, row) in self.rows.iter_mut().zip(rows) {
                own[from..from + LANES].copy_from_slice(row);
            }
            self.filled = from + count;
            return;
        }
        // Otherwise append the contributing samples one by one
        self.filled = from;
        while left != 0 {
            let l = left.trailing_zeros() as usize % LANES;
            let to = self.filled % QUEUE_CAPACITY;
            for (own, row) in self.rows.iter_mut().zip(rows) {
                own[to] = row[l];
            }
            self.filled += 1;
            left &= left - 1;
        }
    }

    /// Lights the oldest sixteen samples, or all, of the ray along `segment`, and composites them behind the earlier
    /// ones.
    pub(super) fn composite(
        &mut self,
        segment: &RaySegment,
        light: Option<&mut Lighting>,
        composite: &mut Composite,
    ) {
        // Add direct lighting
        let count = self.filled.min(LANES);
        if let Some(light) = light {
            self.shade(segment, light, count);
        }
        // Composite the samples in order along the ray
        let rows = &self.rows;
        for l in 0..count {
            let source = |c: usize| rows[SHARE][l] * (rows[SCATTERING + c][l] + rows[EMISSION + c][l]);
            composite.add([source(0), source(1), source(2)], rows[ALPHA][l]);
        }
        // Remove them from the queue
        self.filled -= count;
        if self.filled > 0 {
            for row in &mut self.rows {
                row.copy_within(LANES.., 0);
            }
        }
    }

    /// Multiplies scattering by the in-scattered light, at those of the first `count` samples that scatter any.
    fn shade(&mut self, segment: &RaySegment, light: &mut Lighting, count: usize) {
        // Find the samples that scatter
        let mut active = 0;
        for l in 0..count {
            let scatters = (0..3).any(|channel| self.rows[SCATTERING + channel][l] > 0.0);
            active |= u16::from(scatters) << l;
        }
        if active == 0 {
            return;
        }
        // Compute their positions
        let mut points = [[0.0; LANES]; 3];
        for axis in 0..3 {
            for l in 0..LANES {
                points[axis][l] = segment.origin[axis] + self.rows[T][l] * segment.direction[axis];
            }
        }
        // Evaluate the lights and modulate the scattering
        let arriving = light(&PointLanes { points, active });
        for channel in 0..3 {
            for l in 0..LANES {
                if active >> l & 1 == 1 {
                    self.rows[SCATTERING + channel][l] *= arriving[channel][l];
                }
            }
        }
    }
}
