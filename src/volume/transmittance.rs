//! Transmittances along many rays at once: the samples of all of them wait for each other in one batch, so that sixteen
//! are taken together however few a ray has.
//!
//! A ray's depths are summed in their order along it, so that its neighbours change no bit of what it finds.

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

/// Samples of several rays through one volume that wait to be taken together.
struct TransmittanceBatch<'a> {
    volume: Option<&'a Volume>,
    /// In voxel space.
    places: [[f64; ROOM]; 3],
    /// In world units.
    length: [f64; ROOM],
    /// Which ray each belongs to.
    ray: [u8; ROOM],
    /// Fewer than sixteen, but while a survey's are put to them.
    filled: usize,
}

/// What up to sixteen rays have met.
struct OpticalDepths<'a> {
    waiting: TransmittanceBatch<'a>,
    sums: [CompensatedSum; LANES],
    /// From which on nothing counts.
    deepest: f64,
    sample_count: u64,
}

impl<'a> March<'a> {
    /// [`March::transmittance`] of each of up to sixteen stretches, in the first lanes; returns how many samples were
    /// taken.
    ///
    /// The answers are the same to the last bit.
    pub fn transmittances(&mut self, stretches: &[RaySegment], left: &mut Lanes<f64>) -> u64 {
        let stretches = &stretches[..stretches.len().min(LANES)];
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

/// Takes the samples of all rays that meet one volume at most. Bit `l` of the answer says that ray `l` meets more.
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
    let (mut through_any, mut through_more) = (0, 0);
    if volumes.len() > 1 {
        for volume in volumes {
            let met = VolumeSegments::new(volume, &rays).met;
            through_more |= through_any & met;
            through_any |= met;
        }
    }
    for volume in volumes {
        let courses = VolumeSegments::new(volume, &rays);
        let mut left = courses.met & !through_more;
        if left == 0 {
            continue;
        }
        let steps = courses.steps(&rays);
        // Through memory: a compiler that takes single lanes out of loops over all no longer makes vectors of them.
        let (courses, steps) = std::hint::black_box((&courses, &steps));
        depths.waiting.volume = Some(volume);
        let skip = if volume.empty.share() == 0.0 {
            SkipEmpty::Never
        } else {
            skip
        };
        while left != 0 {
            let l = left.trailing_zeros() as usize % LANES;
            left &= left - 1;
            let own = steps.of(courses, l);
            let range = steps.range(skip, &own, l);
            depths.follow(&courses.met(l), skip, (&own, range, rays.unit(l)), l);
        }
        depths.take();
    }
    through_more
}

impl<'a> OpticalDepths<'a> {
    /// Takes the samples in `range` of the `steps` of ray `l` through the one volume that it meets, and lets the last of
    /// them wait; `unit` is that of t in the world.
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
            if self.waiting.filled >= LANES {
                self.take();
                if self.sums[l].rounded() >= self.deepest {
                    return;
                }
            }
            i = survey.next;
        }
    }

    /// Takes the first sixteen of the samples that wait, or all.
    #[inline(always)]
    fn take(&mut self) {
        let waiting = &mut self.waiting;
        let Some(volume) = waiting.volume.filter(|_| waiting.filled > 0) else {
            return;
        };
        let (places, length) = waiting.batch();
        let density = volume.density.sample_lanes(&places);
        let depth = volume.transfer.depth_lanes(&density, &length);
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
            // What lies behind the sample that ends a march does not count, wherever a batch ends.
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

    /// Puts the steps of `empty_space_skip` that are wanted, which lie at `places`, to the ones that wait.
    #[inline(always)]
    fn push(&mut self, places: &Lanes3<f64>, survey: &StepWindow, unit: f64, ray: u8) {
        let mut length = survey.length;
        for l in 0..LANES {
            length[l] *= unit;
        }
        let from = self.filled % LANES;
        // What is copied in excess is written over by what comes next.
        for axis in 0..3 {
            self.places[axis][from..from + LANES].copy_from_slice(&places[axis]);
        }
        self.length[from..from + LANES].copy_from_slice(&length);
        self.ray[from..from + LANES].fill(ray);
        self.filled = from + survey.wanted;
    }

    /// The first sixteen.
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

    /// Does away with the first sixteen.
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
