//! Light that enters a body, is scattered within and leaves elsewhere: milk, skin, marble, wax.
//!
//! The dipole (H. W. Jensen, S. Marschner, M. Levoy, P. Hanrahan, "A practical model for subsurface light transport",
//! SIGGRAPH 2001) tells how much of what enters at one point leaves at another; it depends on their distance alone. Two
//! passes use it (H. W. Jensen, J. Buhler, "A rapid hierarchical rendering technique for translucent materials",
//! SIGGRAPH 2002): [`surface_samples`] and [`lattice_samples`] spread points over the body for which somebody works out
//! the irradiance, and an [`IrradianceTree`] over them answers what leaves anywhere.
//!
//! Lengths are those of the space that positions are given in; coefficients are per unit of that length, published ones
//! ([`SubsurfacePreset`]) per millimetre: [`Scattering::scaled`] goes from one to the other. Irradiance is what gets
//! through the surface, so what arrives times Fresnel's transmittance. What leaves is spread over directions as
//! Fresnel's transmittance has it: radiance towards `wo` is the radiant exitance / pi times the transmittance in that
//! direction over [`diffuse_transmittance`], its mean. Light that is scattered only once is no part of it.

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
pub use scattering::{Scattering, ScatteringError, diffuse_fresnel_reflectance, diffuse_transmittance};
pub use shape_samples::lattice_samples;
