//! Optics at the boundaries of media and inside them: Snell's law, Fresnel's equations, dispersion, absorption, nested
//! dielectrics, subsurface scattering.
//!
//! All functions are pure functions of f64 numbers, independent of the scene. Wavelengths are in nanometres and
//! measured in vacuum, angles in radians, absorption is per unit of length. An index of refraction is called `eta_i` on
//! the incident side and `eta_t` on the transmitted side.

mod absorption;
mod conductor;
mod dielectric_interface;
mod dielectric_simd;
mod diffuse_transmission;
mod dispersion;
mod fresnel;
mod nested_dielectrics;
mod polarised;
mod snell;
mod spectrum;
pub mod subsurface;
mod thin_slab;

pub use absorption::Absorption;
pub use conductor::{Conductor, conductor};
pub use dielectric_simd::{DielectricLanes, dielectric_lanes};
pub use diffuse_transmission::DiffuseTransmission;
pub use dispersion::{Cauchy, Dispersion, LINE_C, LINE_D, LINE_F, Sellmeier};
pub use fresnel::{Fresnel, dielectric};
pub use nested_dielectrics::{
    BoundaryCrossing, BoundaryEvent, InteriorStack, MAX_NESTED_INTERIORS, NestedInterior,
};
pub use polarised::Polarised;
pub use snell::{Refraction, ior_from_speed, reflect, refract};
pub use spectrum::{
    LINEAR_SRGB_FROM_XYZ, MAX_WAVELENGTH, MIN_WAVELENGTH, SpectralSampler, color_matching, linear_srgb,
};
pub use thin_slab::{ThinSlab, thin_slab};
