//! Volumes: smoke, fire, fog and scans, as colour C(P) and opacity alpha(P) over 3-D arrays, marched front to back.
//!
//! A [`Volume`] is a [`Grid`] with trilinear interpolation, placed by any affine map of the cube [-1, 1]³, and a
//! [`Transfer`] function from its numbers to colour, opacity and emission; [`Fog`] is the same at every point of space.
//! A [`March`] takes a stretch of a ray through any number of them, overlapping or not, in steps t0 + i h, and says what
//! light they add and what share of the light behind them is left. The stretch ends at surfaces, so these may lie inside.
//! Empty space is leapt over, which changes no bit of the answer.
//!
//! Flames whose temperature has an array of its own are a second volume in the same place: one without opacity.
//!
//! What a sample is: light changes along a step of depth tau by exp(-tau), and a source S is seen as
//! S (1 - exp(-tau)) / tau. In matter that does not change along the step this is exact, so that the size of the step
//! does not matter there (N. Max, "Optical models for direct volume rendering", 1995).

pub mod cloud;
pub mod composite;
mod deferred_lighting;
mod empty_space_skip;
mod fog;
mod grid;
mod macrocells;
mod march;
mod optical_depth;
mod ray_intervals;
pub mod read;
mod sample_batch;
mod steps;
mod transfer_function;
mod transmittance;

#[cfg(test)]
mod tests;

pub use fog::Fog;
pub use grid::{Grid, Samples};
pub use macrocells::MacrocellGrid;
pub use march::{Lighting, March, Marched, PointLanes, RaySegment, SkipEmpty};
pub use optical_depth::{opacity, optical_depth, transmittance_of};
pub use transfer_function::{Thickness, Transfer, TransferNode};

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::numeric::{Bounds, SingularMatrix, inverse};

/// What a volume is made from.
#[derive(Clone, Debug)]
pub struct VolumeDescription {
    /// The numbers that the transfer function turns into matter.
    pub density: Arc<Grid>,
    /// Linear red, green and blue that the transfer function's colour is multiplied by: C(P). Of any sizes.
    pub color: Option<Arc<[Grid; 3]>>,
    /// What the numbers mean.
    pub transfer: Transfer,
    /// Places the cube [-1, 1]³ that the grids fill.
    pub world_from_cube: DAffine3,
    /// Length of a step in world units; half the shortest edge of a voxel if absent.
    pub step: Option<f64>,
}

/// A placed volume, ready to be marched through.
#[derive(Clone, Debug)]
pub struct Volume {
    name: Arc<str>,
    density: Arc<Grid>,
    color: Option<Arc<[Grid; 3]>>,
    transfer: Transfer,
    empty: MacrocellGrid,
    world_from_cube: DAffine3,
    cube_from_world: DAffine3,
    /// To where the grid's samples lie at the integers.
    voxel_from_cube: DAffine3,
    step: f64,
}

/// What can be wrong with a volume. One sentence: what, where, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum VolumeError {
    /// The samples do not fill the grid.
    #[error(
        "a grid of {size:?} samples is given {count}: give as many as the product of the three, and at least one"
    )]
    Size {
        /// Samples along x, y, z.
        size: [usize; 3],
        /// Samples given.
        count: usize,
    },
    /// A sample is NaN or infinite.
    #[error(
        "the sample {at:?} (x, y, z from 0) of a grid is not finite: replace NaN and infinity by numbers"
    )]
    NotFinite {
        /// The first such sample.
        at: [usize; 3],
    },
    /// A transfer function has a node without meaning.
    #[error(
        "node {node} (from 0) of the transfer function {fault}: give rising values, opacities from 0 to 1, and the rest not negative"
    )]
    Transfer {
        /// Counted from 0.
        node: usize,
        /// What is wrong.
        fault: &'static str,
    },
    /// The length that opacities hold over has no meaning.
    #[error("opacity over a length of {reference}: give a positive length")]
    Reference {
        /// As given.
        reference: f64,
    },
    /// The placement flattens the volume.
    #[error("a volume's transform cannot be undone ({0}): use scales that are not 0")]
    Placement(#[from] SingularMatrix),
    /// The step has no meaning, or a march would never end.
    #[error(
        "a step of {step} through a volume of diameter {diameter}: give a positive step of at least {least:.1e}"
    )]
    Step {
        /// As given.
        step: f64,
        /// Of the placed volume.
        diameter: f64,
        /// The shortest one.
        least: f64,
    },
    /// A fog's numbers have no meaning.
    #[error(
        "fog {fault}: give numbers that are not negative, an extinction to what glows, and a longer step"
    )]
    Fog {
        /// What is wrong.
        fault: &'static str,
    },
}

/// Steps through a volume's diameter at most: a ray of 2^26 takes about a second.
const MAX_STEPS: f64 = (1u64 << 26) as f64;

impl Volume {
    /// Checks and places a volume, and finds its empty space.
    pub fn new(description: VolumeDescription) -> Result<Volume, VolumeError> {
        let VolumeDescription {
            density,
            color,
            transfer,
            world_from_cube,
            step,
        } = description;
        let cube_from_world = inverse(&world_from_cube)?;
        let step = step.unwrap_or_else(|| 0.5 * shortest_edge(&density, &world_from_cube));
        let diameter = 2.0 * DVec3::from_array(axis_lengths(&world_from_cube)).length();
        let least = diameter / MAX_STEPS;
        if !(step >= least && step.is_finite()) {
            return Err(VolumeError::Step {
                step,
                diameter,
                least,
            });
        }
        Ok(Volume {
            name: "".into(),
            empty: MacrocellGrid::new(&density, &transfer),
            voxel_from_cube: density.voxel_from_box() * box_from_cube(),
            density,
            color,
            transfer,
            world_from_cube,
            cube_from_world,
            step,
        })
    }

    /// The same under a name that messages call it.
    #[must_use]
    pub fn named(self, name: impl Into<Arc<str>>) -> Volume {
        Volume {
            name: name.into(),
            ..self
        }
    }

    /// What messages call it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same in coordinates that are `scale`, a power of two, times as large, its cube placed by `world_from_cube`:
    /// what lies in a unit of length changes with the unit.
    pub fn rescaled(&self, scale: f64, world_from_cube: DAffine3) -> Result<Volume, VolumeError> {
        Ok(Volume {
            transfer: self.transfer.rescaled(scale),
            cube_from_world: inverse(&world_from_cube)?,
            world_from_cube,
            step: self.step * scale,
            ..self.clone()
        })
    }

    /// Places the cube [-1, 1]³ that the grids fill.
    pub fn world_from_cube(&self) -> &DAffine3 {
        &self.world_from_cube
    }

    /// Samples along x, y, z.
    pub fn size(&self) -> [usize; 3] {
        self.density.size()
    }

    /// Whether it neither takes light away nor sends any out, anywhere.
    pub fn is_clear(&self) -> bool {
        self.empty.share() == 1.0
    }

    /// The box around it in the world.
    pub fn bounds(&self) -> Bounds {
        let cube = Bounds {
            min: -DVec3::ONE,
            max: DVec3::ONE,
        };
        cube.transformed(&self.world_from_cube)
    }

    /// The same marched through in steps that are `factor` times as long, but not so short that a march would never end.
    #[must_use]
    pub fn with_steps(self, factor: f64) -> Volume {
        let diameter = 2.0 * DVec3::from_array(axis_lengths(&self.world_from_cube)).length();
        Volume {
            step: (factor * self.step).max(diameter / MAX_STEPS),
            ..self
        }
    }

    /// Length of a step in world units.
    pub fn step(&self) -> f64 {
        self.step
    }

    /// The space in it that is leapt over.
    pub fn empty_space(&self) -> &MacrocellGrid {
        &self.empty
    }

    /// Bytes of memory that its grids take; those that are shared count each time.
    pub fn memory(&self) -> usize {
        let colors = self.color.iter().flat_map(|color| color.iter());
        self.density.memory() + colors.map(Grid::memory).sum::<usize>()
    }
}

/// The cube [-1, 1]³ as the box [0, 1]³.
fn box_from_cube() -> DAffine3 {
    DAffine3::from_translation(DVec3::splat(0.5)) * DAffine3::from_scale(DVec3::splat(0.5))
}

fn axis_lengths(map: &DAffine3) -> [f64; 3] {
    [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis].map(DVec3::length)
}

/// The shortest edge of a voxel in the world.
fn shortest_edge(grid: &Grid, world_from_cube: &DAffine3) -> f64 {
    let axes = axis_lengths(world_from_cube);
    let size = grid.size();
    (0..3)
        .map(|axis| 2.0 * axes[axis] / size[axis] as f64)
        .fold(f64::INFINITY, f64::min)
}
