//! Subsurface scattering: light that enters a medium, is scattered within and leaves elsewhere, as in milk, skin,
//! marble and wax.
//!
//! The dipole (H. W. Jensen, S. Marschner, M. Levoy, P. Hanrahan, "A practical model for subsurface light transport",
//! SIGGRAPH 2001) gives the fraction of the light entering at one point that leaves at another; it depends on their
//! distance alone. Two passes use it (H. W. Jensen, J. Buhler, "A rapid hierarchical rendering technique for
//! translucent materials", SIGGRAPH 2002): [`surface_samples`] and [`lattice_samples`] spread points over the surface,
//! for which the caller computes the irradiance, and an [`IrradianceTree`] over them returns the radiant exitance
//! anywhere.
//!
//! Lengths are in the space that positions are given in; coefficients are per unit of that length. Published
//! coefficients ([`SubsurfacePreset`]) are per millimetre: [`Scattering::scaled`] converts them. Irradiance is the
//! transmitted one, that is the incident irradiance times the Fresnel transmittance. The exitance is distributed over
//! directions by the Fresnel transmittance: radiance towards `wo` is the radiant exitance / pi times the transmittance
//! in that direction over [`diffuse_transmittance`], its mean. Single scattering is not included.

mod dipole;
mod fast_exp;
mod hierarchical;
mod mesh_samples;
mod octree;
mod presets;
mod scattering;
mod shape_samples;

pub use dipole::Dipole;
pub use mesh_samples::{MAX_SAMPLES, SurfaceSample, SurfaceSamples, surface_samples};
pub use octree::{DEFAULT_SOLID_ANGLE, IrradianceSample, IrradianceTree};
pub use presets::SubsurfacePreset;
pub use scattering::{
    ETA_RANGE, Scattering, ScatteringError, diffuse_fresnel_reflectance, diffuse_transmittance,
};
pub use shape_samples::lattice_samples;
