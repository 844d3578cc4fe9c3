//! Objects with subsurface scattering, with the octree of their irradiance.

use std::f64::consts::PI;

use serde::Serialize;

use super::points::{self, IrradiancePoints};
use crate::optics::subsurface::{
    DEFAULT_SOLID_ANGLE, IrradianceSample, IrradianceTree, diffuse_transmittance,
};

/// Statistics of subsurface scattering.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SubsurfaceStats {
    /// Number of objects with subsurface scattering.
    pub bodies: usize,
    /// Number of points at which irradiance was computed: at most 2^21 for all objects together, except for rounding.
    pub samples: usize,
    /// Number of bytes of the trees.
    pub bytes: u64,
    /// Largest ratio of the spacing of points to the spacing that the material needs: light is blurred by this
    /// factor. 1 if there are enough points.
    pub coarseness: f64,
}

/// Objects of a scene with subsurface scattering, with their irradiance.
pub(in crate::render) struct SubsurfaceObjects {
    /// Objects with subsurface scattering, indexed by instance.
    pub(super) bodies: Vec<Option<Box<SubsurfaceObject>>>,
    pub(in crate::render) stats: SubsurfaceStats,
}

pub(super) struct SubsurfaceObject {
    pub(super) tree: IrradianceTree,
    /// Index of refraction of the interior.
    pub(super) eta: f64,
    /// Radiance that leaves where Fresnel's transmittance is 1, divided by the radiant exitance.
    pub(super) scale: f64,
}

impl SubsurfaceObject {
    pub(super) fn new(irradiance_points: &IrradiancePoints, irradiance: &[[f32; 3]]) -> SubsurfaceObject {
        let sample = |(point, &irradiance): (&points::IrradiancePoint, &[f32; 3])| IrradianceSample {
            position: point.position,
            area: point.area,
            irradiance,
        };
        let samples: Vec<IrradianceSample> = irradiance_points
            .points
            .iter()
            .zip(irradiance)
            .map(sample)
            .collect();
        let eta = irradiance_points.scattering.eta;
        SubsurfaceObject {
            tree: IrradianceTree::build(&samples, &irradiance_points.dipole, DEFAULT_SOLID_ANGLE),
            eta,
            scale: 1.0 / (PI * diffuse_transmittance(eta)),
        }
    }
}
