//! Sixteen rays through one volume, set up together: where each goes through it, and the steps that may have matter.
//!
//! Shadow rays are short, so that as much is done for a ray as for its samples. Lanes do it for all at once, in the
//! arithmetic of a ray alone, which gives the same bits.

use std::ops::Range;

use glam::{DAffine3, DVec3};

use super::Volume;
use super::macrocells::{VoxelRay, clipped};
use super::march::{RaySegment, SkipEmpty};
use super::sample_batch::{CUBE, VolumeSegment};
use super::steps::Steps;
use crate::numeric::{LANES, Lanes, Lanes3};

/// Up to sixteen rays in world space.
pub(super) struct Rays {
    origin: Lanes3<f64>,
    direction: Lanes3<f64>,
    t_near: Lanes<f64>,
    t_far: Lanes<f64>,
    /// World units in one of t.
    unit: Lanes<f64>,
}

/// Their ways through one volume.
pub(super) struct VolumeSegments<'a> {
    volume: &'a Volume,
    /// Bit `l` says whether ray `l` meets it.
    pub(super) met: u16,
    /// In voxel space.
    origin: Lanes3<f64>,
    direction: Lanes3<f64>,
    inverse: Lanes3<f64>,
    enter: Lanes<f64>,
    leave: Lanes<f64>,
}

/// Their steps there.
pub(super) struct SegmentSteps {
    size: Lanes<f64>,
    /// How many there are, and the middle and the length of the last.
    cut: Lanes3<f64>,
    /// The numbers of the steps at the first and at the last matter; none if the latter is infinite.
    matter: [Lanes<f64>; 2],
}

impl Rays {
    /// Up to sixteen.
    #[inline(always)]
    pub(super) fn new(stretches: &[RaySegment]) -> Rays {
        let mut rays = Rays {
            origin: [[0.0; LANES]; 3],
            // Of the lanes without a ray, which have no length.
            direction: [[1.0; LANES]; 3],
            t_near: [0.0; LANES],
            t_far: [0.0; LANES],
            unit: [0.0; LANES],
        };
        for (l, stretch) in stretches.iter().take(LANES).enumerate() {
            for axis in 0..3 {
                rays.origin[axis][l] = stretch.origin[axis];
                rays.direction[axis][l] = stretch.direction[axis];
            }
            rays.t_near[l] = stretch.t_near;
            rays.t_far[l] = stretch.t_far;
        }
        let [x, y, z] = &rays.direction;
        for l in 0..LANES {
            rays.unit[l] = DVec3::new(x[l], y[l], z[l]).length();
        }
        rays
    }

    /// World units in one of t, along ray `l`.
    #[inline(always)]
    pub(super) fn unit(&self, l: usize) -> f64 {
        self.unit[l]
    }
}

impl<'a> VolumeSegments<'a> {
    /// Finds where `rays` enter and leave `volume`, as [`Volume::meet`] does.
    #[inline(always)]
    pub(super) fn new(volume: &'a Volume, rays: &Rays) -> VolumeSegments<'a> {
        let origin = mapped(&volume.cube_from_world, &rays.origin);
        let direction = turned(&volume.cube_from_world, &rays.direction);
        let inverse = inverses(&direction);
        let (mut enter, mut leave) = (rays.t_near, rays.t_far);
        for axis in 0..3 {
            for l in 0..LANES {
                let line = [origin[axis][l], direction[axis][l], inverse[axis][l]];
                [enter[l], leave[l]] = clipped([enter[l], leave[l]], line, CUBE);
            }
        }
        let mut met = 0;
        for l in 0..LANES {
            met |= u16::from((enter[l] < leave[l]) & (leave[l] < f64::INFINITY)) << l;
        }
        let direction = turned(&volume.voxel_from_cube, &direction);
        VolumeSegments {
            volume,
            met,
            origin: mapped(&volume.voxel_from_cube, &origin),
            inverse: inverses(&direction),
            direction,
            enter,
            leave,
        }
    }

    /// The way of ray `l`, which meets the volume.
    #[inline(always)]
    pub(super) fn met(&self, l: usize) -> VolumeSegment<'a> {
        let at = |lanes: &Lanes3<f64>| DVec3::new(lanes[0][l], lanes[1][l], lanes[2][l]);
        VolumeSegment {
            volume: self.volume,
            ray: VoxelRay::with_inverse(at(&self.origin), at(&self.direction), at(&self.inverse)),
            enter: self.enter[l],
            leave: self.leave[l],
        }
    }

    /// Cuts the ways into steps.
    #[inline(always)]
    pub(super) fn steps(&self, rays: &Rays) -> SegmentSteps {
        let mut steps = SegmentSteps {
            size: [0.0; LANES],
            cut: [[0.0; LANES]; 3],
            matter: [[0.0; LANES]; 2],
        };
        for l in 0..LANES {
            let size = self.volume.step / rays.unit[l];
            let cut = Steps::cut(self.enter[l], self.leave[l], size);
            steps.size[l] = size;
            for (row, number) in steps.cut.iter_mut().zip(cut) {
                row[l] = number;
            }
        }
        let [mut from, mut to] = [[f64::NEG_INFINITY; LANES], [f64::INFINITY; LANES]];
        let around = self.volume.empty.around_matter();
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
        for l in 0..LANES {
            let number = |t: f64| Steps::number(self.enter[l], steps.size[l], t);
            let is_any = from[l] <= to[l];
            steps.matter[0][l] = number(from[l]);
            steps.matter[1][l] = if is_any { number(to[l]) } else { f64::NEG_INFINITY };
        }
        steps
    }
}

impl SegmentSteps {
    /// Those of ray `l` of `ray_intervals`.
    #[inline(always)]
    pub(super) fn of(&self, courses: &VolumeSegments, l: usize) -> Steps {
        Steps::of_cut(courses.enter[l], self.size[l], self.cut.map(|row| row[l]))
    }

    /// Those of the `steps` of ray `l` outside which there is no matter.
    #[inline(always)]
    pub(super) fn range(&self, skip: SkipEmpty, steps: &Steps, l: usize) -> Range<u64> {
        let [first, last] = self.matter.map(|row| row[l]);
        match skip {
            SkipEmpty::Never => 0..steps.count,
            SkipEmpty::Leap if last == f64::NEG_INFINITY => 0..0,
            SkipEmpty::Leap => steps.around(first as u64, last as u64),
        }
    }
}

/// Points under an affine map.
#[inline(always)]
fn mapped(map: &DAffine3, points: &Lanes3<f64>) -> Lanes3<f64> {
    let mut mapped = turned(map, points);
    for axis in 0..3 {
        for l in 0..LANES {
            mapped[axis][l] += map.translation[axis];
        }
    }
    mapped
}

/// Directions under an affine map.
#[inline(always)]
fn turned(map: &DAffine3, [x, y, z]: &Lanes3<f64>) -> Lanes3<f64> {
    let matrix = &map.matrix3;
    let mut turned = [[0.0; LANES]; 3];
    for axis in 0..3 {
        let [a, b, c] = [matrix.x_axis[axis], matrix.y_axis[axis], matrix.z_axis[axis]];
        for l in 0..LANES {
            turned[axis][l] = a * x[l] + b * y[l] + c * z[l];
        }
    }
    turned
}

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
