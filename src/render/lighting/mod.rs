//! Direct light of all kinds of light sources, with shadow rays.

mod area_light;
mod area_light_sampler;
mod background;
mod chosen_light;
mod combined_sampling;
pub(super) mod direct;
mod emissive_mesh;
mod environment;
mod light_tree;
mod lobe_variants;
mod sample_index;
mod shadow_ray_end;
mod shared_lobes;
mod transparent_shadow;
mod visible_background;

pub(super) use area_light_sampler::{AreaLightSampler, area_lights};
pub(super) use combined_sampling::CombinedSampling;
pub(super) use direct::ShadingContext;
pub(super) use environment::Environment;
pub(super) use light_tree::{LightDivision, LightTree};
pub(super) use lobe_variants::LobeVariants;
pub(super) use sample_index::{PixelSample, SampleIndex};
pub(super) use transparent_shadow::attenuate_shadow_rays;
