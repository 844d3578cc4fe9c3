//! How surfaces answer light: lights, textures, the lecture's equation and glTF's metallic-roughness model, sixteen
//! points at a time.
//!
//! Everything here is arithmetic on lanes without branches, so that it vectorises; what lanes do not need is masked by
//! a factor of zero.

mod area_light;
mod environment;
mod ggx;
mod material;
mod metallic_roughness;
pub mod normal_map;
mod phong;
mod punctual_light;
pub mod ray_cone;
mod subsurface_entry;
#[cfg(test)]
mod tests;
mod texture;

pub use area_light::{
    AreaLight, AreaLightError, DiskLight, LightSample, MeshLight, QuadLight, ShapeLight, SphereLight,
};
pub use environment::{EnvironmentError, EnvironmentMap, EnvironmentSample};
pub use ggx::{Ggx, LobeSample};
pub use material::{ExtendedMaterialLanes, MaterialPacket};
pub use metallic_roughness::{direct, direct_of, mirror, through};
pub use phong::phong_direct;
pub use punctual_light::{PunctualSample, illuminate};
pub use subsurface_entry::transmitted_irradiance;
pub use texture::{Footprint, TexturePoint, TextureSet, fold_constant_textures};
