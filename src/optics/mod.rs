//! What light does where media meet and inside them: Snell's law, Fresnel's equations, dispersion, absorption, nesting,
//! scattering.
//!
//! Pure functions of f64 numbers; nothing here knows what a scene is. Wavelengths are in nanometres and measured in
//! vacuum, angles in radians, absorption is per unit of length. An index of refraction is called `eta_i` on the side
//! light comes from and `eta_t` on the side it goes to.

mod absorption;
mod conductor;
mod dispersion;
mod fresnel;
mod interface;
mod lanes;
mod leaf;
mod media;
mod snell;
mod spectrum;
pub mod subsurface;
mod thin_slab;

pub use absorption::Absorption;
pub use conductor::{Conductor, conductor};
pub use dispersion::{Cauchy, Dispersion, LINE_C, LINE_D, LINE_F, Sellmeier};
pub use fresnel::{Fresnel, Polarised, dielectric};
pub use lanes::{DielectricLanes, dielectric_lanes};
pub use leaf::Leaf;
pub use media::{Body, Crossing, MEDIA_CAPACITY, MediaStack, Passage};
pub use snell::{Refraction, brewster_angle, critical_angle, ior_from_speed, reflect, refract};
pub use spectrum::{
    LINEAR_SRGB_FROM_XYZ, MAX_WAVELENGTH, MIN_WAVELENGTH, SpectralSampler, color_matching, linear_srgb,
};
pub use thin_slab::{ThinSlab, thin_slab};
