//! Transmittances of shadow-ray packets: the samples of all rays share one batch, so that sixteen are evaluated
//! together however few a ray has.
//!
//! The optical depths of a ray are summed in their order along it, so that other rays of the packet change no bit of
//! its result.

use std::ops::Range;

use multiversion::multiversion;

use super::empty_space_skip::StepWindow;
use super::march::{RaySegment, SkipEmpty};
use super::optical_depth::CompensatedSum;
use super::ray_intervals::{Rays, VolumeSegments};
use super::sample_batch::{ROOM, VolumeSegment, places};
use super::steps::Steps;
use super::{March, Volume};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Queue of samples of several rays through one volume that are evaluated sixteen at a time.
struct TransmittanceBatch<'a> {
    volume: Option<&'a Volume>,
    /// Positions in voxel space.
    places: [[f64; ROOM]; 3],
    /// Step lengths in world units.
    length: [f64; ROOM],
    /// Index of the ray that each sample belongs to.
    ray: [u8; ROOM],
    /// Number of pending samples: fewer than sixteen, except while a window is being added.
    filled: usize,
}

/// Optical depths of up to sixteen rays.
struct OpticalDepths<'a> {
    waiting: TransmittanceBatch<'a>,
    sums: [CompensatedSum; LANES],
    /// Optical depth of the cut-off, at which a ray's march stops.
    deepest: f64,
    sample_count: u64,
}

impl<'a> March<'a> {
    /// Computes [`March::transmittance`] of each of up to sixteen segments, into the first lanes of `left`; returns the
    /// number of samples taken.
    ///
    /// The results are bit-identical to those of single segments.
    pub fn transmittances(&mut self, stretches: &[RaySegment], left: &mut Lanes<f64>) -> u64 {
        let stretches = &stretches[..stretches.len().min(LANES)];
        // March all rays through at most one volume together
        let mut depths = OpticalDepths {
            waiting: TransmittanceBatch::EMPTY,
            sums: [CompensatedSum::default(); LANES],
            deepest: self.deepest,
            sample_count: 0,
        };
        let through_more = match self.fog {
            Some(_) => u16::MAX,
            None => follow_all(&mut depths, self.volumes, self.skip, stretches),
        };
        // March the rest one by one: rays through fog or several volumes
        for (l, stretch) in stretches.iter().enumerate() {
            if through_more >> l & 1 == 1 {
                self.meet(stretch);
                depths.sums[l] = self.depth(stretch, &mut depths.sample_count);
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
fn follow_all<'a>(
    depths: &mut OpticalDepths<'a>,
    volumes: &'a [Volume],
    skip: SkipEmpty,
    stretches: &[RaySegment],
) -> u16 {
    let rays = Rays::new(stretches);
    // Find rays that intersect more than one volume
    let (mut through_any, mut through_more) = (0, 0);
    if volumes.len() > 1 {
        for volume in volumes {
            let met = VolumeSegments::new(volume, &rays).met;
            through_more |= through_any & met;
            through_any |= met;
        }
    }
    // Process the rays of each volume in turn
    for volume in volumes {
        let courses = VolumeSegments::new(volume, &rays);
        let mut left = courses.met & !through_more;
        if left == 0 {
            continue;
        }
        let steps = courses.steps(&rays);
        // Pass through memory: a compiler that extracts single lanes from loops over all no longer vectorises these
        // loops.
        let (courses, steps) = std::hint::black_box((&courses, &steps));
        depths.waiting.volume = Some(volume);
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
            let own = steps.of(courses, l);
            let range = steps.range(skip, &own, l);
            depths.follow(&courses.met(l), skip, (&own, range, rays.unit(l)), l);
        }
        // Evaluate the rest before the next volume is bound
        depths.take();
    }
    through_more
}

impl<'a> OpticalDepths<'a> {
    /// Samples the steps in `range` of ray `l` through the one volume that it intersects; the last of them stay in the
    /// queue. `unit` is the number of world units per unit of t.
    #[inline(always)]
    fn follow(
        &mut self,
        met: &VolumeSegment<'a>,
        skip: SkipEmpty,
        (steps, range, unit): (&Steps, Range<u64>, f64),
        l: usize,
    ) {
        let met = std::slice::from_ref(met);
        let Range { start: mut i, end } = range;
        while i < end {
            let survey = StepWindow::new(met, skip, steps, i, end);
            self.waiting
                .push(&places(&met[0].ray, &survey.t), &survey, unit, l as u8);
            // Evaluate a full batch and stop at the cut-off
            if self.waiting.filled >= LANES {
                self.take();
                if self.sums[l].rounded() >= self.deepest {
                    return;
                }
            }
            i = survey.next;
        }
    }

    /// Evaluates the oldest sixteen of the pending samples, or all if there are fewer.
    #[inline(always)]
    fn take(&mut self) {
        let waiting = &mut self.waiting;
        let Some(volume) = waiting.volume.filter(|_| waiting.filled > 0) else {
            return;
        };
        // Compute the optical depths of the batch
        let (places, length) = waiting.batch();
        let density = volume.density.sample_lanes(&places);
        let depth = volume.transfer.depth_lanes(&density, &length);
        // Add each depth to the sum of its ray
        let count = waiting.filled.min(LANES);
        let mut ray = usize::from(waiting.ray[0]) % LANES;
        let mut sum = self.sums[ray];
        for l in 0..count {
            let whose = usize::from(waiting.ray[l]) % LANES;
            if whose != ray {
                self.sums[ray] = sum;
                ray = whose;
                sum = self.sums[ray];
            }
            // Ignore samples behind the one that ends a march, wherever a batch ends.
            if sum.rounded() < self.deepest {
                sum.add(depth[l]);
            }
        }
        self.sums[ray] = sum;
        self.sample_count += count as u64;
        waiting.shift();
    }
}

impl TransmittanceBatch<'_> {
    const EMPTY: TransmittanceBatch<'static> = TransmittanceBatch {
        volume: None,
        places: [[0.0; ROOM]; 3],
        length: [0.0; ROOM],
        ray: [0; ROOM],
        filled: 0,
    };

    /// Appends the wanted steps of `survey`, which lie at `places`, to the pending samples.
    #[inline(always)]
    fn push(&mut self, places: &Lanes3<f64>, survey: &StepWindow, unit: f64, ray: u8) {
        let mut length = survey.length;
        for l in 0..LANES {
            length[l] *= unit;
        }
        let from = self.filled % LANES;
        // Lanes beyond `wanted` are overwritten by the next call.
        for axis in 0..3 {
            self.places[axis][from..from + LANES].copy_from_slice(&places[axis]);
        }
        self.length[from..from + LANES].copy_from_slice(&length);
        self.ray[from..from + LANES].fill(ray);
        self.filled = from + survey.wanted;
    }

    /// Returns the positions and lengths of the oldest sixteen samples.
    #[inline(always)]
    fn batch(&self) -> (Lanes3<f64>, Lanes<f64>) {
        let mut places = [[0.0; LANES]; 3];
        for axis in 0..3 {
            places[axis].copy_from_slice(&self.places[axis][..LANES]);
        }
        let mut length = [0.0; LANES];
        length.copy_from_slice(&self.length[..LANES]);
        (places, length)
    }

    /// Removes the oldest sixteen samples.
    #[inline(always)]
    fn shift(&mut self) {
        for axis in 0..3 {
            self.places[axis].copy_within(LANES.., 0);
        }
        self.length.copy_within(LANES.., 0);
        self.ray.copy_within(LANES.., 0);
        self.filled = self.filled.saturating_sub(LANES);
    }
}
