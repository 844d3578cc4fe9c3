//! Transmittances of shadow-ray packets: the samples of all rays share one batch, so that sixteen are evaluated
//! together however few a ray has.
//!
//! The optical depths of a ray are summed in their order along it, so that other rays of the packet change no bit of
//! its result.

use std::ops::Range;

use multiversion::multiversion;

use super::empty_space_skip::{SkipEmpty, StepWindow};
use super::optical_depth::CompensatedSum;
use super::ray_intervals::{Rays, VolumeSegments};
use super::ray_segment::RaySegment;
use super::sample_batch::{QUEUE_CAPACITY, VolumeSegment, points};
use super::steps::Steps;
use super::{March, Volume};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Queue of samples of several rays through one volume that are evaluated sixteen at a time.
struct TransmittanceBatch<'a> {
    volume: Option<&'a Volume>,
    /// Positions in voxel space.
    points: [[f64; QUEUE_CAPACITY]; 3],
    /// Step lengths in world units.
    length: [f64; QUEUE_CAPACITY],
    /// Index of the ray that each sample belongs to.
    ray: [u8; QUEUE_CAPACITY],
    /// Number of pending samples: fewer than sixteen, except while a window is being added.
    filled: usize,
}

/// Optical depths of up to sixteen rays.
struct OpticalDepths<'a> {
    pending: TransmittanceBatch<'a>,
    sums: [CompensatedSum; LANES],
    /// Optical depth of the cut-off, at which a ray's march stops.
    cutoff_depth: f64,
    sample_count: u64,
}

impl<'a> March<'a> {
    /// Computes [`March::transmittance`] of each of up to sixteen segments, into the first lanes of `left`; returns the
    /// number of samples taken.
    ///
    /// The results are bit-identical to those of single segments.
    pub fn transmittances(&mut self, segments: &[RaySegment], left: &mut Lanes<f64>) -> u64 {
        let segments = &segments[..segments.len().min(LANES)];
        // March all rays through at most one volume together
        let mut depths = OpticalDepths {
            pending: TransmittanceBatch::EMPTY,
            sums: [CompensatedSum::default(); LANES],
            cutoff_depth: self.cutoff_depth,
            sample_count: 0,
        };
        let through_more = match self.fog {
            None => sum_depths(&mut depths, self.volumes, self.skip, segments),
            Some(fog) if self.volumes.is_empty() => {
                for (sum, segment) in depths.sums.iter_mut().zip(segments) {
                    // Add the closed form; a segment without length has no depth
                    if segment.t_near < segment.t_far {
                        let length = (segment.t_far - segment.t_near) * segment.direction.length();
                        sum.add(fog.depth(length));
                    }
                }
                0
            }
            Some(_) => u16::MAX,
        };
        // March the rest one by one: rays through fog or several volumes
        for (l, segment) in segments.iter().enumerate() {
            if through_more >> l & 1 == 1 {
                self.intersect(segment);
                depths.sums[l] = self.depth(segment, &mut depths.sample_count);
            }
            left[l] = depths.sums[l].transmittance();
        }
        depths.sample_count
    }
}

/// Sums the samples of all rays that intersect at most one volume. Bit `l` of the result is set if ray `l` intersects
/// more.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma",
    "x86_64+sse4.2"
))]
fn sum_depths<'a>(
    depths: &mut OpticalDepths<'a>,
    volumes: &'a [Volume],
    skip: SkipEmpty,
    segments: &[RaySegment],
) -> u16 {
    let rays = Rays::new(segments);
    // Find rays that intersect more than one volume
    let (mut through_any, mut through_more) = (0, 0);
    if volumes.len() > 1 {
        for volume in volumes {
            let hit_mask = VolumeSegments::new(volume, &rays).hit_mask;
            through_more |= through_any & hit_mask;
            through_any |= hit_mask;
        }
    }
    // Process the rays of each volume in turn
    for volume in volumes {
        let volume_segments = VolumeSegments::new(volume, &rays);
        let mut left = volume_segments.hit_mask & !through_more;
        if left == 0 {
            continue;
        }
        let steps = volume_segments.steps(&rays);
        // Pass through memory: a compiler that extracts single lanes from loops over all no longer vectorises these
        // loops.
        let (volume_segments, steps) = std::hint::black_box((&volume_segments, &steps));
        depths.pending.volume = Some(volume);
        // Disable skipping where no block is empty
        let skip = if volume.empty.share() == 0.0 {
            SkipEmpty::Never
        } else {
            skip
        };
        // Queue the samples of each ray
        while left != 0 {
            let l = left.trailing_zeros() as usize % LANES;
            left &= left - 1;
            let own = steps.of(volume_segments, l);
            let range = steps.range(skip, &own, l);
            depths.sum_ray(&volume_segments.segment(l), skip, (&own, range, rays.unit(l)), l);
        }
        // Evaluate the rest before the next volume is bound
        depths.evaluate_batch();
    }
    through_more
}

impl<'a> OpticalDepths<'a> {
    /// Samples the steps in `range` of ray `l` through the one volume that it intersects; the last of them stay in the
    /// queue. `unit` is the number of world units per unit of t.
    #[inline(always)]
    fn sum_ray(
        &mut self,
        segment: &VolumeSegment<'a>,
        skip: SkipEmpty,
        (steps, range, unit): (&Steps, Range<u64>, f64),
        l: usize,
    ) {
        let segments = std::slice::from_ref(segment);
        let Range { start: mut i, end } = range;
        while i < end {
            let window = StepWindow::new(segments, skip, steps, i, end);
            self.pending
                .push(&points(&segments[0].ray, &window.t), &window, unit, l as u8);
            // Evaluate a full batch and stop at the cut-off
            if self.pending.filled >= LANES {
                self.evaluate_batch();
                if self.sums[l].rounded() >= self.cutoff_depth {
                    return;
                }
            }
            i = window.next;
        }
    }

    /// Evaluates the oldest sixteen of the pending samples, or all if there are fewer.
    #[inline(always)]
    fn evaluate_batch(&mut self) {
        let pending = &mut self.pending;
        let Some(volume) = pending.volume.filter(|_| pending.filled > 0) else {
            return;
        };
        // Compute the optical depths of the batch
        let (points, length) = pending.batch();
        let density = volume.density.sample_lanes(&points);
        let depth = volume.transfer.depth_lanes(&density, &length);
        // Add each depth to the sum of its ray
        let count = pending.filled.min(LANES);
        let mut ray = usize::from(pending.ray[0]) % LANES;
        let mut sum = self.sums[ray];
        for l in 0..count {
            let whose = usize::from(pending.ray[l]) % LANES;
            if whose != ray {
                self.sums[ray] = sum;
                ray = whose;
                sum = self.sums[ray];
            }
            // Ignore samples behind the one that ends a march, wherever a batch ends.
            if sum.rounded() < self.cutoff_depth {
                sum.add(depth[l]);
            }
        }
        self.sums[ray] = sum;
        self.sample_count += count as u64;
        pending.shift();
    }
}

impl TransmittanceBatch<'_> {
    const EMPTY: TransmittanceBatch<'static> = TransmittanceBatch {
        volume: None,
        points: [[0.0; QUEUE_CAPACITY]; 3],
        length: [0.0; QUEUE_CAPACITY],
        ray: [0; QUEUE_CAPACITY],
        filled: 0,
    };

    /// Appends the wanted steps of `window`, which lie at `points`, to the pending samples.
    #[inline(always)]
    fn push(&mut self, points: &Lanes3<f64>, window: &StepWindow, unit: f64, ray: u8) {
        let mut length = window.length;
        for l in 0..LANES {
            length[l] *= unit;
        }
        let from = self.filled % LANES;
        // Lanes beyond `wanted` are overwritten by the next call.
        for axis in 0..3 {
            self.points[axis][from..from + LANES].copy_from_slice(&points[axis]);
        }
        self.length[from..from + LANES].copy_from_slice(&length);
        self.ray[from..from + LANES].fill(ray);
        self.filled = from + window.wanted;
    }

    /// Returns the positions and lengths of the oldest sixteen samples.
    #[inline(always)]
    fn batch(&self) -> (Lanes3<f64>, Lanes<f64>) {
        let mut points = [[0.0; LANES]; 3];
        for axis in 0..3 {
            points[axis].copy_from_slice(&self.points[axis][..LANES]);
        }
        let mut length = [0.0; LANES];
        length.copy_from_slice(&self.length[..LANES]);
        (points, length)
    }

    /// Removes the oldest sixteen samples.
    #[inline(always)]
    fn shift(&mut self) {
        for axis in 0..3 {
            self.points[axis].copy_within(LANES.., 0);
        }
        self.length.copy_within(LANES.., 0);
        self.ray.copy_within(LANES.., 0);
        self.filled = self.filled.saturating_sub(LANES);
    }
}
