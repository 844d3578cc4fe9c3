//! Ray-volume intervals of packets: sixteen rays are clipped to one volume, and the steps that may be non-empty are
//! found.
//!
//! Shadow rays are short, so that the set-up of a ray costs as much as its samples. Lanes do it for all rays at once,
//! in the arithmetic of the single ray, which gives identical bits.

use std::ops::Range;

use glam::{DAffine3, DVec3};

use super::Volume;
use super::empty_space_skip::SkipEmpty;
use super::macrocells::{VoxelRay, clipped};
use super::ray_segment::RaySegment;
use super::sample_batch::{CUBE, VolumeSegment};
use super::steps::Steps;
use crate::numeric::{LANES, Lanes, Lanes3};

/// Packet of up to sixteen rays in world space.
pub(super) struct Rays {
    origin: Lanes3<f64>,
    direction: Lanes3<f64>,
    t_near: Lanes<f64>,
    t_far: Lanes<f64>,
    /// Length of the direction: world units per unit of t.
    unit: Lanes<f64>,
}

/// Segments of a packet's rays inside one volume.
pub(super) struct VolumeSegments<'a> {
    volume: &'a Volume,
    /// Mask: bit `l` is set if ray `l` intersects the volume.
    pub(super) hit_mask: u16,
    /// Origins in voxel space.
    origin: Lanes3<f64>,
    direction: Lanes3<f64>,
    inverse: Lanes3<f64>,
    enter: Lanes<f64>,
    leave: Lanes<f64>,
}

/// Ray-marching steps of a packet's rays in one volume.
pub(super) struct SegmentSteps {
    size: Lanes<f64>,
    /// Number of steps of each ray, and the middle and the length of the last step.
    cut: Lanes3<f64>,
    /// Indices of the steps at the first and the last non-empty point; there are none if the latter is -infinity.
    occupied_steps: [Lanes<f64>; 2],
}

impl Rays {
    /// Converts up to sixteen ray segments to lanes.
    #[inline(always)]
    pub(super) fn new(segments: &[RaySegment]) -> Rays {
        let mut rays = Rays {
            origin: [[0.0; LANES]; 3],
            // Lanes without a ray have zero length; any direction does.
            direction: [[1.0; LANES]; 3],
            t_near: [0.0; LANES],
            t_far: [0.0; LANES],
            unit: [0.0; LANES],
        };
        // Transpose segments to structure-of-arrays
        for (l, segment) in segments.iter().take(LANES).enumerate() {
            for axis in 0..3 {
                rays.origin[axis][l] = segment.origin[axis];
                rays.direction[axis][l] = segment.direction[axis];
            }
            rays.t_near[l] = segment.t_near;
            rays.t_far[l] = segment.t_far;
        }
        // Compute the length of each direction
        let [x, y, z] = &rays.direction;
        for l in 0..LANES {
            rays.unit[l] = DVec3::new(x[l], y[l], z[l]).length();
        }
        rays
    }

    /// Returns the world units per unit of t along ray `l`.
    #[inline(always)]
    pub(super) fn unit(&self, l: usize) -> f64 {
        self.unit[l]
    }
}

impl<'a> VolumeSegments<'a> {
    /// Clips `rays` to `volume`, with the arithmetic of [`Volume::intersect`].
    #[inline(always)]
    pub(super) fn new(volume: &'a Volume, rays: &Rays) -> VolumeSegments<'a> {
        // Transform rays to the cube's space
        let origin = transformed_points(&volume.cube_from_world, &rays.origin);
        let direction = transformed_vectors(&volume.cube_from_world, &rays.direction);
        let inverse = inverses(&direction);
        // Clip segments to the cube with the slab test
        let (mut enter, mut leave) = (rays.t_near, rays.t_far);
        for axis in 0..3 {
            for l in 0..LANES {
                let line = [origin[axis][l], direction[axis][l], inverse[axis][l]];
                [enter[l], leave[l]] = clipped([enter[l], leave[l]], line, CUBE);
            }
        }
        // Collect the mask of rays that intersect the volume
        let mut hit_mask = 0;
        for l in 0..LANES {
            hit_mask |= u16::from((enter[l] < leave[l]) & (leave[l] < f64::INFINITY)) << l;
        }
        // Map rays to voxel coordinates
        let direction = transformed_vectors(&volume.voxel_from_cube, &direction);
        VolumeSegments {
            volume,
            hit_mask,
            origin: transformed_points(&volume.voxel_from_cube, &origin),
            inverse: inverses(&direction),
            direction,
            enter,
            leave,
        }
    }

    /// Returns the segment of ray `l`, which must intersect the volume.
    #[inline(always)]
    pub(super) fn segment(&self, l: usize) -> VolumeSegment<'a> {
        let at = |lanes: &Lanes3<f64>| DVec3::new(lanes[0][l], lanes[1][l], lanes[2][l]);
        VolumeSegment {
            volume: self.volume,
            ray: VoxelRay::with_inverse(at(&self.origin), at(&self.direction), at(&self.inverse)),
            enter: self.enter[l],
            leave: self.leave[l],
        }
    }

    /// Divides the segments into steps, and finds the steps that overlap the box around non-empty voxels.
    #[inline(always)]
    pub(super) fn steps(&self, rays: &Rays) -> SegmentSteps {
        let mut steps = SegmentSteps {
            size: [0.0; LANES],
            cut: [[0.0; LANES]; 3],
            occupied_steps: [[0.0; LANES]; 2],
        };
        // Divide each segment into steps
        for l in 0..LANES {
            let size = self.volume.step / rays.unit[l];
            let cut = Steps::cut(self.enter[l], self.leave[l], size);
            steps.size[l] = size;
            for (row, number) in steps.cut.iter_mut().zip(cut) {
                row[l] = number;
            }
        }
        // Clip rays to the box around non-empty voxels
        let [mut from, mut to] = [[f64::NEG_INFINITY; LANES], [f64::INFINITY; LANES]];
        let around = self.volume.empty.occupied_bounds();
        for axis in 0..3 {
            let sides = around.map(|corner| corner[axis]);
            for l in 0..LANES {
                let line = [
                    self.origin[axis][l],
                    self.direction[axis][l],
                    self.inverse[axis][l],
                ];
                [from[l], to[l]] = clipped([from[l], to[l]], line, sides);
            }
        }
        // Convert parameters of that box to step indices
        for l in 0..LANES {
            let number = |t: f64| Steps::number(self.enter[l], steps.size[l], t);
            let is_any = from[l] <= to[l];
            steps.occupied_steps[0][l] = number(from[l]);
            steps.occupied_steps[1][l] = if is_any { number(to[l]) } else { f64::NEG_INFINITY };
        }
        steps
    }
}

impl SegmentSteps {
    /// Returns the steps of ray `l` of `volume_segments`.
    #[inline(always)]
    pub(super) fn of(&self, volume_segments: &VolumeSegments, l: usize) -> Steps {
        Steps::of_cut(volume_segments.enter[l], self.size[l], self.cut.map(|row| row[l]))
    }

    /// Returns the range of the `steps` of ray `l` outside which all samples are empty.
    #[inline(always)]
    pub(super) fn range(&self, skip: SkipEmpty, steps: &Steps, l: usize) -> Range<u64> {
        let [first, last] = self.occupied_steps.map(|row| row[l]);
        match skip {
            SkipEmpty::Never => 0..steps.count,
            SkipEmpty::Leap if last == f64::NEG_INFINITY => 0..0,
            SkipEmpty::Leap => steps.around(first as u64, last as u64),
        }
    }
}

/// Transforms points by an affine map.
#[inline(always)]
fn transformed_points(map: &DAffine3, points: &Lanes3<f64>) -> Lanes3<f64> {
    let mut transformed_points = transformed_vectors(map, points);
    for axis in 0..3 {
        for l in 0..LANES {
            transformed_points[axis][l] += map.translation[axis];
        }
    }
    transformed_points
}

/// Transforms vectors by the linear part of an affine map.
#[inline(always)]
fn transformed_vectors(map: &DAffine3, [x, y, z]: &Lanes3<f64>) -> Lanes3<f64> {
    let matrix = &map.matrix3;
    let mut transformed_vectors = [[0.0; LANES]; 3];
    for axis in 0..3 {
        let [a, b, c] = [matrix.x_axis[axis], matrix.y_axis[axis], matrix.z_axis[axis]];
        for l in 0..LANES {
            transformed_vectors[axis][l] = a * x[l] + b * y[l] + c * z[l];
        }
    }
    transformed_vectors
}

/// Returns the reciprocals of the components.
#[inline(always)]
fn inverses(direction: &Lanes3<f64>) -> Lanes3<f64> {
    let mut inverse = [[0.0; LANES]; 3];
    for axis in 0..3 {
        for l in 0..LANES {
            inverse[axis][l] = 1.0 / direction[axis][l];
        }
    }
    inverse
}
