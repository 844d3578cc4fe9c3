//! Rays into the lobes of sixteen surfaces.

use crate::numeric::{LANES, Lanes, Lanes3};

/// Numbers of rays into the lobes of sixteen surfaces.
pub(super) struct LobeRayCounts {
    /// Number of rays that each hit sends into its lobe.
    pub(super) of: Lanes<u32>,
    /// Number of rays that all samples of the pixel send together.
    pub(super) of_pixel: Lanes<f64>,
}

/// Rays reflected at one microfacet of each of sixteen surfaces.
pub(in crate::render) struct LobeRays {
    /// Unit directions in world space.
    pub(super) direction: Lanes3<f64>,
    /// Cosines of the angles of incidence on the microfacets.
    pub(super) cos_i: Lanes<f32>,
    /// Weights of the radiance along the rays, without Fresnel's factor.
    pub(super) share: Lanes<f32>,
    /// Densities of the directions per steradian, times the numbers of rays into the lobes.
    pub(super) density: Lanes<f32>,
    /// Increases of the spreads of the ray cones, from the widths of the lobes.
    pub(super) spread: Lanes<f64>,
    /// True if the ray leaves on the right side of the surface.
    pub(super) leaves: Lanes<bool>,
}

impl LobeRays {
    /// No rays in any lane.
    pub(super) const NONE: LobeRays = LobeRays {
        direction: [[0.0; LANES]; 3],
        cos_i: [0.0; LANES],
        share: [0.0; LANES],
        density: [0.0; LANES],
        spread: [0.0; LANES],
        leaves: [false; LANES],
    };
}
