//! Scattering at glossy surfaces and dielectric boundaries, and in volumes.

mod boundary;
mod dielectric;
mod glossy;
mod march_state;
mod microfacet;
mod volume;

pub(super) use dielectric::Tints;
pub(super) use march_state::MarchState;
