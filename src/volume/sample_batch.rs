//! Batches of sixteen samples of one ray: positions, densities, medium properties, and their optical depth and opacity.
//!
//! Straight loops over lanes, compiled for several instruction sets: the arithmetic is identical in each, hence the
//! result is bit-identical.

use multiversion::multiversion;

use super::grid::Grid;
use super::macrocells::{VoxelRay, clipped};
use super::optical_depth::opacity;
use super::ray_segment::RaySegment;
use super::transfer_function::MediumSample;
use super::{Fog, Volume};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Segment of a ray inside a volume, `enter <= t <= leave`, with the ray in voxel space.
#[derive(Clone, Copy, Debug)]
pub(super) struct VolumeSegment<'a> {
    pub(super) volume: &'a Volume,
    pub(super) ray: VoxelRay,
    pub(super) enter: f64,
    pub(super) leave: f64,
}

/// Bounds of a volume's cube along each axis.
pub(super) const CUBE: [f64; 2] = [-1.0, 1.0];

/// Capacity of a [`PendingBatch`]: fewer than sixteen samples are pending when sixteen more arrive.
pub(super) const QUEUE_CAPACITY: usize = 2 * LANES;

/// Queue of samples of one ray that are evaluated sixteen at a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct PendingBatch {
    t: [f64; QUEUE_CAPACITY],
    /// Step lengths in world units.
    length: [f64; QUEUE_CAPACITY],
    pub(super) filled: usize,
}

/// Sixteen samples of one ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct SampleBatch {
    pub(super) t: Lanes<f64>,
    /// Step lengths in world units.
    pub(super) length: Lanes<f64>,
    /// Number of valid samples, which come first; the others have no meaning.
    pub(super) filled: usize,
}

impl Volume {
    /// Clips the ray segment to the volume and maps it to voxel space; `None` if they do not intersect.
    #[inline(always)]
    pub(super) fn intersect(&self, segment: &RaySegment) -> Option<VolumeSegment<'_>> {
        // Transform ray to the cube's space
        let origin = self.cube_from_world.transform_point3(segment.origin);
        let direction = self.cube_from_world.transform_vector3(segment.direction);
        let inverse = direction.recip();
        // Clip segment to the cube with the slab test
        let mut span = [segment.t_near, segment.t_far];
        for axis in 0..3 {
            span = clipped(span, [origin[axis], direction[axis], inverse[axis]], CUBE);
        }
        let [enter, leave] = span;
        if !(enter < leave && leave < f64::INFINITY) {
            return None;
        }
        // Map ray to voxel coordinates; t is unchanged by affine maps
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
        t: [0.0; QUEUE_CAPACITY],
        length: [0.0; QUEUE_CAPACITY],
        filled: 0,
    };

    /// Appends the first `count` of sixteen samples to the pending ones, which are fewer than sixteen.
    #[inline(always)]
    pub(super) fn push(&mut self, t: &Lanes<f64>, length: &Lanes<f64>, count: usize) {
        let from = self.filled % LANES;
        // Lanes beyond `count` are overwritten by the next call.
        self.t[from..from + LANES].copy_from_slice(t);
        self.length[from..from + LANES].copy_from_slice(length);
        self.filled = from + count;
    }

    /// Removes and returns the sixteen oldest samples, or all if there are fewer.
    pub(super) fn pop(&mut self) -> SampleBatch {
        // Copy the oldest samples
        let mut batch = SampleBatch {
            t: [0.0; LANES],
            length: [0.0; LANES],
            filled: self.filled.min(LANES),
        };
        batch.t.copy_from_slice(&self.t[..LANES]);
        batch.length.copy_from_slice(&self.length[..LANES]);
        // Shift the remaining samples to the front
        self.t.copy_within(LANES.., 0);
        self.length.copy_within(LANES.., 0);
        self.filled -= batch.filled;
        batch
    }
}

/// Optical properties of sixteen samples.
pub(super) struct ShadedSamples {
    pub(super) medium: MediumSample,
    /// Opacity 1 - exp(-depth) of each step.
    pub(super) alpha: Lanes<f64>,
    /// Factor (1 - exp(-depth)) / depth of the source term: emission attenuated by the step's own medium.
    pub(super) share: Lanes<f64>,
    /// Mask: bit `l` is set if sample `l` attenuates or emits light; the others contribute exactly nothing.
    pub(super) contributes: u16,
}

/// Samples all volumes and the fog at the positions of a batch.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma",
    "x86_64+sse4.2"
))]
pub(super) fn sample(segments: &[VolumeSegment], fog: Option<&Fog>, batch: &SampleBatch) -> ShadedSamples {
    // Sum the medium properties of all volumes
    let mut sum = MediumSample::NONE;
    for segment in segments {
        let volume = segment.volume;
        let points = points(&segment.ray, &batch.t);
        let density = volume.density.sample_lanes(&points);
        let mut medium = volume.transfer.medium_lanes(&density, &batch.length);
        if let Some(colors) = &volume.color {
            tint(&mut medium, &volume.density, colors, &points);
        }
        sum.add(&medium);
    }
    // Add the homogeneous fog
    if let Some(fog) = fog {
        sum.add(&fog_medium(fog, &batch.length));
    }
    // Convert optical depths to opacities
    let mut alpha = [0.0; LANES];
    let mut share = [0.0; LANES];
    let mut amount = [0.0; LANES];
    for l in 0..LANES {
        let depth = sum.depth[l];
        alpha[l] = opacity(depth);
        share[l] = if depth > 0.0 { alpha[l] / depth } else { 1.0 };
        let [red, green, blue] = [0, 1, 2].map(|channel| sum.emission[channel][l]);
        // Depth and emission are not negative, so the sum is 0 only if each is 0.
        amount[l] = depth + (red + green + blue);
    }
    // Collect the mask in a loop of its own, so that the one above vectorises
    let mut contributes = 0;
    for l in 0..LANES {
        contributes |= u16::from(amount[l] > 0.0) << l;
    }
    ShadedSamples {
        medium: sum,
        alpha,
        share,
        contributes,
    }
}

/// Returns the optical depths of a batch, without colours and emission, for shadow rays.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma",
    "x86_64+sse4.2"
))]
pub(super) fn sample_depth(segments: &[VolumeSegment], fog: Option<&Fog>, batch: &SampleBatch) -> Lanes<f64> {
    // Sum the optical depths of all volumes
    let mut sum = [0.0; LANES];
    for segment in segments {
        let volume = segment.volume;
        let density = volume.density.sample_lanes(&points(&segment.ray, &batch.t));
        let depth = volume.transfer.depth_lanes(&density, &batch.length);
        for l in 0..LANES {
            sum[l] += depth[l];
        }
    }
    // Add the homogeneous fog
    if let Some(fog) = fog {
        for l in 0..LANES {
            sum[l] += fog.extinction() * batch.length[l];
        }
    }
    sum
}

/// Returns the points of a ray at sixteen parameters, in voxel space.
#[inline(always)]
pub(super) fn points(ray: &VoxelRay, t: &Lanes<f64>) -> Lanes3<f64> {
    let mut points = [[0.0; LANES]; 3];
    for axis in 0..3 {
        for l in 0..LANES {
            points[axis][l] = ray.origin[axis] + t[l] * ray.direction[axis];
        }
    }
    points
}

/// Multiplies the scattering of a medium by the colour grids, which need not have the size of `density`.
#[inline(always)]
fn tint(medium: &mut MediumSample, density: &Grid, colors: &[Grid; 3], points: &Lanes3<f64>) {
    for (channel, color) in colors.iter().enumerate() {
        let mut there = *points;
        // Convert between voxel coordinates; samples lie at the voxels' centres
        for axis in 0..3 {
            let [from, to] = [density, color].map(|grid| grid.size()[axis] as f64);
            for l in 0..LANES {
                there[axis][l] = (there[axis][l] + 0.5) / from * to - 0.5;
            }
        }
        // Modulate scattering by the interpolated colour
        let color = color.sample_lanes(&there);
        for l in 0..LANES {
            medium.scattering[channel][l] *= color[l];
        }
    }
}

/// Returns the medium sample of homogeneous fog over steps of `length` world units.
#[inline(always)]
fn fog_medium(fog: &Fog, length: &Lanes<f64>) -> MediumSample {
    let mut medium = MediumSample::NONE;
    for l in 0..LANES {
        medium.depth[l] = fog.extinction() * length[l];
    }
    for channel in 0..3 {
        for l in 0..LANES {
            medium.scattering[channel][l] = fog.color()[channel] * medium.depth[l];
            medium.emission[channel][l] = fog.emission()[channel] * length[l];
        }
    }
    medium
}

impl MediumSample {
    /// Adds the depth, scattering and emission of `other`, as for media that overlap.
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
