//! Shading of packets of sixteen points: light sampling, textures, the Phong and Whitted model, and glTF's
//! metallic-roughness model.
//!
//! The code is branch-free arithmetic on lanes, so that it vectorises; results that a lane does not need are multiplied
//! by zero.

mod anisotropic_lobe;
mod diffuse;
mod environment;
mod ggx;
mod layer;
mod lobe_albedo;
mod material;
mod metallic_roughness;
pub mod normal_map;
mod phong;
mod punctual_light;
pub mod ray_cone;
mod sheen;
mod special_lobe;
mod subsurface_entry;
#[cfg(test)]
mod tests;
mod texture;
mod thin_film;

pub use diffuse::diffuse_weights;
pub use environment::{
    EnvironmentError, EnvironmentLanes, EnvironmentMap, EnvironmentSample, EnvironmentSamples,
};
pub use ggx::{Ggx, LobeSample};
pub use layer::LayerLanes;
pub use lobe_albedo::LobeAlbedo;
pub use material::{ExtendedMaterialLanes, MaterialPacket};
pub use metallic_roughness::{diffuse_transmission, direct, direct_combined, direct_of, mirror};
pub use phong::phong_direct;
pub use punctual_light::{PunctualSample, sample_punctual_light};
pub use sheen::SheenLanes;
pub use subsurface_entry::transmitted_irradiance;
pub use texture::{Footprint, TexturePoint, TextureSet, fold_constant_textures};
pub(crate) use texture::{LookupMethod, PacketLookup, PatternPacket, UvPacket};
pub use thin_film::{ThinFilm, ThinFilmLanes};

pub use crate::scene::{
    AreaLight, AreaLightError, DiskLight, LightSample, MeshLight, QuadLight, ShapeLight, SphereLight,
};
