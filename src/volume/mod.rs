//! Volume rendering of smoke, fire, fog and scans: colour C(P) and opacity alpha(P) on 3-D grids, ray-marched front to
//! back.
//! A [`Volume`] is a [`Grid`] with trilinear interpolation, placed by any affine map of the cube [-1, 1]³, and a
//! [`Transfer`] function from its values to colour, opacity and emission; [`Fog`] is a homogeneous medium that fills
//! all space. A [`March`] integrates a ray segment through any number of volumes, overlapping or not, in steps
//! t0 + i · h, and returns the radiance that they add and the transmittance to the background. The segment ends at
//! surfaces, so these may lie inside a volume. Empty space is skipped, which changes no bit of the result.
//! these may lie inside a volume. Empty space is skipped, which changes no bit of the result.
//!
//! Flames whose temperature has a grid of its own are a second volume at the same position: one without opacity.
//!
//! Radiative model of a sample: radiance changes along a step of optical depth tau by exp(-tau), and a source S
//! contributes S (1 - exp(-tau)) / tau. In a medium that is constant along the step this is exact, so that the step
//! size does not matter there (N. Max, "Optical models for direct volume rendering", 1995).

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
mod ray_segment;
pub mod read;
mod sample_batch;
mod steps;
mod transfer_function;
mod transmittance;

#[cfg(test)]
mod tests;

pub use deferred_lighting::{Lighting, PointLanes};
pub use empty_space_skip::SkipEmpty;
pub use fog::Fog;
pub use grid::{Grid, GridSamples};
pub use macrocells::MacrocellGrid;
pub use march::{March, Marched};
pub use optical_depth::{opacity, optical_depth, transmittance_of};
pub use ray_segment::RaySegment;
pub use transfer_function::{Thickness, Transfer, TransferNode};

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::numeric::{Bounds, SingularMatrix, inverse};

/// Input of [`Volume::new`]: grids, transfer function, transform and step.
#[derive(Clone, Debug)]
pub struct VolumeDescription {
    /// Scalar field that the transfer function maps to the medium's properties.
    pub density: Arc<Grid>,
    /// Linear RGB grids, of any sizes, that the transfer function's colour is multiplied by: C(P).
    pub color: Option<Arc<[Grid; 3]>>,
    /// Map from grid values to the medium's properties.
    pub transfer: Transfer,
    /// Affine map of the cube [-1, 1]³ that the grids fill.
    pub world_from_cube: DAffine3,
    /// Length of a ray-marching step in world units; half the shortest edge of a voxel if absent.
    pub step: Option<f64>,
}

/// Placed volume, ready for ray marching.
#[derive(Clone, Debug)]
pub struct Volume {
    name: Arc<str>,
    density: Arc<Grid>,
    color: Option<Arc<[Grid; 3]>>,
    transfer: Transfer,
    empty: MacrocellGrid,
    world_from_cube: DAffine3,
    cube_from_world: DAffine3,
    /// Affine map to voxel coordinates, where the grid's samples lie at the integers.
    voxel_from_cube: DAffine3,
    step: f64,
}

/// Reasons to reject a volume. Each message is one sentence: the fault, its location and the remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum VolumeError {
    /// Number of samples that does not fill the grid.
    #[error(
        "a grid of {size:?} samples has {count} values: give the product of the three sizes, at least one"
    )]
    Size {
        /// Numbers of samples along x, y, z.
        size: [usize; 3],
        /// Number of samples given.
        count: usize,
    },
    /// Sample that is NaN or infinite.
    #[error(
        "the sample {at:?} (x, y, z from 0) of a grid is not finite: replace NaN and infinity by numbers"
    )]
    NotFinite {
        /// Indices of the first such sample, along x, y, z.
        at: [usize; 3],
    },
    /// Transfer-function node with an invalid value.
    #[error(
        "node {node} (from 0) of the transfer function {fault}: give rising values, opacities from 0 to 1, and the rest not negative"
    )]
    Transfer {
        /// Index of the node, counted from 0.
        node: usize,
        /// Description of the fault, as the predicate of a sentence.
        fault: &'static str,
    },
    /// Reference length of opacities that is not positive and finite.
    #[error("the opacity refers to a length of {reference}: give a positive length")]
    Reference {
        /// Reference length as the caller gave it.
        reference: f64,
    },
    /// Transform that flattens the volume, so that it has no inverse.
    #[error("a volume's transform cannot be inverted ({0}): use scales that are not 0")]
    Placement(#[from] SingularMatrix),
    /// Step that is not finite, or so short that a march would not end in reasonable time.
    #[error(
        "a step of {step} through a volume of diameter {diameter}: give a positive step of at least {least:.1e}"
    )]
    Step {
        /// Step as given, in world units.
        step: f64,
        /// Diameter of the placed volume, in world units.
        diameter: f64,
        /// Shortest step that is accepted, in world units.
        least: f64,
    },
    /// Fog with an invalid parameter.
    #[error(
        "fog {fault}: give numbers that are not negative, an extinction where it emits, and a longer step"
    )]
    Fog {
        /// Description of the fault, as the predicate of a sentence.
        fault: &'static str,
    },
}

/// Largest number of steps through a volume's diameter: a ray of 2^26 steps takes about a second.
const MAX_STEPS: f64 = (1u64 << 26) as f64;

impl Volume {
    /// Checks and places a volume, and builds its macrocell grid for empty-space skipping.
    pub fn new(description: VolumeDescription) -> Result<Volume, VolumeError> {
        let VolumeDescription {
            density,
            color,
            transfer,
            world_from_cube,
            step,
        } = description;
        // Invert transform; fails if it is singular
        let cube_from_world = inverse(&world_from_cube)?;
        // Choose step from the voxel size and bound it by the diameter
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
        // Precompute macrocells and the map to voxel coordinates
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

    /// Returns the volume under a name that messages use.
    #[must_use]
    pub fn named(self, name: impl Into<Arc<str>>) -> Volume {
        Volume {
            name: name.into(),
            ..self
        }
    }

    /// Returns the name that messages use.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the volume in coordinates that are `scale`, a power of two, times as large, its cube placed by
    /// `world_from_cube`. Extinction and emission per unit of length are divided by `scale`.
    pub(crate) fn rescaled(&self, scale: f64, world_from_cube: DAffine3) -> Result<Volume, VolumeError> {
        Ok(Volume {
            transfer: self.transfer.rescaled(scale),
            cube_from_world: inverse(&world_from_cube)?,
            world_from_cube,
            step: self.step * scale,
            ..self.clone()
        })
    }

    /// Returns the affine map of the cube [-1, 1]³ that the grids fill.
    pub fn world_from_cube(&self) -> &DAffine3 {
        &self.world_from_cube
    }

    /// Returns the numbers of samples along x, y, z.
    pub fn size(&self) -> [usize; 3] {
        self.density.size()
    }

    /// Returns whether the volume neither attenuates nor emits light anywhere.
    pub fn is_clear(&self) -> bool {
        self.empty.share() == 1.0
    }

    /// Returns the axis-aligned bounding box in world space.
    pub fn bounds(&self) -> Bounds {
        let cube = Bounds {
            min: -DVec3::ONE,
            max: DVec3::ONE,
        };
        cube.transformed(&self.world_from_cube)
    }

    /// Returns the volume with its step length multiplied by `factor`, but not so short that its diameter takes more
    /// than `MAX_STEPS` steps.
    #[must_use]
    pub(crate) fn with_steps(self, factor: f64) -> Volume {
        let diameter = 2.0 * DVec3::from_array(axis_lengths(&self.world_from_cube)).length();
        Volume {
            step: (factor * self.step).max(diameter / MAX_STEPS),
            ..self
        }
    }

    /// Returns the length of a ray-marching step in world units.
    pub fn step(&self) -> f64 {
        self.step
    }

    /// Returns the macrocell grid that empty-space skipping uses.
    pub fn empty_space(&self) -> &MacrocellGrid {
        &self.empty
    }

    /// Returns the bytes of memory that the grids take; shared grids count each time.
    pub fn memory(&self) -> usize {
        let colors = self.color.iter().flat_map(|color| color.iter());
        self.density.memory() + colors.map(Grid::memory).sum::<usize>()
    }
}

/// Returns the affine map of the cube [-1, 1]³ to the box [0, 1]³.
fn box_from_cube() -> DAffine3 {
    DAffine3::from_translation(DVec3::splat(0.5)) * DAffine3::from_scale(DVec3::splat(0.5))
}

/// Returns the lengths of the images of the three unit axes.
fn axis_lengths(map: &DAffine3) -> [f64; 3] {
    [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis].map(DVec3::length)
}

/// Returns the shortest edge of a voxel in world units.
fn shortest_edge(grid: &Grid, world_from_cube: &DAffine3) -> f64 {
    let axes = axis_lengths(world_from_cube);
    let size = grid.size();
    // The cube has edges of length 2, divided among the voxels
    (0..3)
        .map(|axis| 2.0 * axes[axis] / size[axis] as f64)
        .fold(f64::INFINITY, f64::min)
}
