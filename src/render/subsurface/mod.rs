//! Subsurface scattering: the diffuse reflection of a surface is replaced by light that enters the object anywhere
//! and leaves it at the hit.
//!
//! Before the first wave, every such object is covered with points ([`points`]), and the irradiance that enters at
//! each of them is computed with the shadow rays of surfaces ([`receive`]): from lights of every kind, the
//! environment map and the ambient light, with all occlusion and transparent shadows. An octree over the points
//! ([`IrradianceTree`]) then gives the radiant exitance at every hit. Specular reflection is handled at the surface
//! as usual. Light that one object or mirror sends to another does not enter.
//!
//! [`IrradianceTree`]: crate::optics::subsurface::IrradianceTree

mod exitance;
mod forecast;
mod objects;
mod points;
mod receive;
mod scatter;

pub use forecast::subsurface_bytes;
pub(super) use objects::SubsurfaceObjects;
pub use objects::SubsurfaceStats;
