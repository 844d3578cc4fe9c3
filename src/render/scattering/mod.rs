//! Scattering at diffuse and glossy surfaces, at dielectric boundaries, and in volumes.

mod bounce;
mod boundary;
mod boundary_packet;
mod dielectric;
mod glossy;
mod lobe_packet;
mod lobe_rays;
mod march_state;
mod microfacet;
mod volume;

pub(super) use bounce::cosine_directions;
pub(super) use boundary_packet::BoundaryRays;
pub(super) use dielectric::Tints;
pub(super) use lobe_rays::LobeRays;
pub(super) use march_state::MarchState;
