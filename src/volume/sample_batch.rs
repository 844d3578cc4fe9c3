//! Sixteen samples of one ray at once: places, densities, matter, and what it does to light.
//!
//! Straight loops over lanes, compiled for several instruction sets: the same arithmetic in each, hence the same bits.

use multiversion::multiversion;

use super::grid::Grid;
use super::macrocells::{VoxelRay, clipped};
use super::march::RaySegment;
use super::optical_depth::opacity;
use super::transfer_function::MediumSample;
use super::{Fog, Volume};
use crate::numeric::{LANES, Lanes, Lanes3};

/// A volume that a ray goes through.
#[derive(Clone, Copy, Debug)]
pub(super) struct VolumeSegment<'a> {
    pub(super) volume: &'a Volume,
    pub(super) ray: VoxelRay,
    pub(super) enter: f64,
    pub(super) leave: f64,
}

/// Where the cube of a volume lies along each axis.
pub(super) const CUBE: [f64; 2] = [-1.0, 1.0];

/// Less than a batch may wait when sixteen more come.
pub(super) const ROOM: usize = 2 * LANES;

/// Samples of one ray that wait to be taken together.
#[derive(Clone, Copy, Debug)]
pub(super) struct PendingBatch {
    t: [f64; ROOM],
    /// In world units.
    length: [f64; ROOM],
    pub(super) filled: usize,
}

/// Sixteen samples of one ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Batch {
    pub(super) t: Lanes<f64>,
    /// In world units.
    pub(super) length: Lanes<f64>,
    /// Those before it are samples; the others have no meaning.
    pub(super) filled: usize,
}

impl Volume {
    /// The ray in voxel space and the stretch of it inside the volume, if there is one.
    #[inline(always)]
    pub(super) fn meet(&self, stretch: &RaySegment) -> Option<VolumeSegment<'_>> {
        let origin = self.cube_from_world.transform_point3(stretch.origin);
        let direction = self.cube_from_world.transform_vector3(stretch.direction);
        let inverse = direction.recip();
        let mut span = [stretch.t_near, stretch.t_far];
        for axis in 0..3 {
            span = clipped(span, [origin[axis], direction[axis], inverse[axis]], CUBE);
        }
        let [enter, leave] = span;
        if !(enter < leave && leave < f64::INFINITY) {
            return None;
        }
        Some(VolumeSegment {
            volume: self,
            ray: VoxelRay::new(
                self.voxel_from_cube.transform_point3(origin),
                self.voxel_from_cube.transform_vector3(direction),
            ),
            enter,
            leave,
        })
    }
}

impl PendingBatch {
    pub(super) const NONE: PendingBatch = PendingBatch {
        t: [0.0; ROOM],
        length: [0.0; ROOM],
        filled: 0,
    };

    /// Puts the first `count` of sixteen samples to those that wait, which are fewer than sixteen.
    #[inline(always)]
    pub(super) fn push(&mut self, t: &Lanes<f64>, length: &Lanes<f64>, count: usize) {
        let from = self.filled % LANES;
        // What is copied in excess is written over by what comes next.
        self.t[from..from + LANES].copy_from_slice(t);
        self.length[from..from + LANES].copy_from_slice(length);
        self.filled = from + count;
    }

    /// The sixteen that have waited longest, or all.
    pub(super) fn pop(&mut self) -> Batch {
        let mut batch = Batch {
            t: [0.0; LANES],
            length: [0.0; LANES],
            filled: self.filled.min(LANES),
        };
        batch.t.copy_from_slice(&self.t[..LANES]);
        batch.length.copy_from_slice(&self.length[..LANES]);
        self.t.copy_within(LANES.., 0);
        self.length.copy_within(LANES.., 0);
        self.filled -= batch.filled;
        batch
    }
}

/// What sixteen samples show.
pub(super) struct ShadedSamples {
    pub(super) matter: MediumSample,
    /// 1 - exp(-depth).
    pub(super) alpha: Lanes<f64>,
    /// (1 - exp(-depth)) / depth: how much of the source is seen through its own matter.
    pub(super) share: Lanes<f64>,
    /// Bit `l` says whether sample `l` takes or sends light; the others add exactly nothing.
    pub(super) adds: u16,
}

/// Samples all volumes and fog at the places of a batch.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma",
    "x86_64+sse4.2"
))]
pub(super) fn sample(met: &[VolumeSegment], fog: Option<&Fog>, batch: &Batch) -> ShadedSamples {
    let mut sum = MediumSample::NONE;
    for met in met {
        let volume = met.volume;
        let places = places(&met.ray, &batch.t);
        let density = volume.density.sample_lanes(&places);
        let mut matter = volume.transfer.matter_lanes(&density, &batch.length);
        if let Some(colors) = &volume.color {
            tint(&mut matter, &volume.density, colors, &places);
        }
        sum.add(&matter);
    }
    if let Some(fog) = fog {
        sum.add(&fog_matter(fog, &batch.length));
    }
    let mut alpha = [0.0; LANES];
    let mut share = [0.0; LANES];
    let mut amount = [0.0; LANES];
    for l in 0..LANES {
        let depth = sum.depth[l];
        alpha[l] = opacity(depth);
        share[l] = if depth > 0.0 { alpha[l] / depth } else { 1.0 };
        let [red, green, blue] = [0, 1, 2].map(|channel| sum.emission[channel][l]);
        // None is negative.
        amount[l] = depth + (red + green + blue);
    }
    let mut adds = 0;
    for l in 0..LANES {
        adds |= u16::from(amount[l] > 0.0) << l;
    }
    ShadedSamples {
        matter: sum,
        alpha,
        share,
        adds,
    }
}

/// The optical depths alone.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma",
    "x86_64+sse4.2"
))]
pub(super) fn sample_depth(met: &[VolumeSegment], fog: Option<&Fog>, batch: &Batch) -> Lanes<f64> {
    let mut sum = [0.0; LANES];
    for met in met {
        let volume = met.volume;
        let density = volume.density.sample_lanes(&places(&met.ray, &batch.t));
        let depth = volume.transfer.depth_lanes(&density, &batch.length);
        for l in 0..LANES {
            sum[l] += depth[l];
        }
    }
    if let Some(fog) = fog {
        for l in 0..LANES {
            sum[l] += fog.extinction() * batch.length[l];
        }
    }
    sum
}

/// Sixteen points of a ray.
#[inline(always)]
pub(super) fn places(ray: &VoxelRay, t: &Lanes<f64>) -> Lanes3<f64> {
    let mut places = [[0.0; LANES]; 3];
    for axis in 0..3 {
        for l in 0..LANES {
            places[axis][l] = ray.origin[axis] + t[l] * ray.direction[axis];
        }
    }
    places
}

/// Multiplies the colour of matter by that of grids, which need not be of the size of `density`.
#[inline(always)]
fn tint(matter: &mut MediumSample, density: &Grid, colors: &[Grid; 3], places: &Lanes3<f64>) {
    for (channel, color) in colors.iter().enumerate() {
        let mut there = *places;
        for axis in 0..3 {
            let [from, to] = [density, color].map(|grid| grid.size()[axis] as f64);
            for l in 0..LANES {
                there[axis][l] = (there[axis][l] + 0.5) / from * to - 0.5;
            }
        }
        let color = color.sample_lanes(&there);
        for l in 0..LANES {
            matter.scattering[channel][l] *= color[l];
        }
    }
}

#[inline(always)]
fn fog_matter(fog: &Fog, length: &Lanes<f64>) -> MediumSample {
    let mut matter = MediumSample::NONE;
    for l in 0..LANES {
        matter.depth[l] = fog.extinction() * length[l];
    }
    for channel in 0..3 {
        for l in 0..LANES {
            matter.scattering[channel][l] = fog.color()[channel] * matter.depth[l];
            matter.emission[channel][l] = fog.emission()[channel] * length[l];
        }
    }
    matter
}

impl MediumSample {
    #[inline(always)]
    fn add(&mut self, other: &MediumSample) {
        for l in 0..LANES {
            self.depth[l] += other.depth[l];
        }
        for channel in 0..3 {
            for l in 0..LANES {
                self.scattering[channel][l] += other.scattering[channel][l];
                self.emission[channel][l] += other.emission[channel][l];
            }
        }
    }
}
