//! How surfaces answer light: lights, textures, the lecture's equation and glTF's metallic-roughness model, sixteen
//! points at a time.
//!
//! Everything here is arithmetic on lanes without branches, so that it vectorises; what lanes do not need is masked by
//! a factor of zero.

mod area_light;
mod entering;
mod environment;
mod ggx;
mod lecture;
mod light;
mod material;
mod metallic_roughness;
pub mod normal_map;
pub mod ray_cone;
#[cfg(test)]
mod tests;
mod texture;

pub use area_light::{
    AreaLight, AreaLightError, BodyLight, DiskLight, LightSample, MeshLight, QuadLight, SphereLight,
};
pub use entering::entering;
pub use environment::{EnvironmentError, EnvironmentMap, EnvironmentSample};
pub use ggx::{Ggx, LobeSample};
pub use lecture::lecture_direct;
pub use light::{Illumination, illuminate};
pub use material::{MaterialPacket, RichLanes};
pub use metallic_roughness::{direct, direct_of, mirror, through};
pub use texture::{Footprint, TexturePoint, TextureSet, fold_constant_textures};
