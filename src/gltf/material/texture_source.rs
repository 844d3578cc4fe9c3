//! Image and sampler of each texture.

use gltf::json;
use json::texture::{MagFilter, MinFilter, WrappingMode};
use json::validation::Checked;

use crate::gltf::GltfError;
use crate::gltf::document::{GltfDocument, NO_IMAGE};
use crate::gltf::extension::{Corrections, Extension};
use crate::scene::{Filter, Sampler, Wrap};

impl GltfDocument {
    /// Returns a sampler of the file, or the default one.
    pub(super) fn sampler(&self, number: Option<usize>) -> Result<Sampler, GltfError> {
        let samplers = &self.root.samplers;
        let sampler = match number {
            None => &json::texture::Sampler::default(),
            Some(number) => samplers
                .get(number)
                .ok_or_else(|| self.missing("sampler", number, samplers.len()))?,
        };
        let wrap = |mode: &Checked<WrappingMode>| match mode {
            Checked::Valid(WrappingMode::ClampToEdge) => Wrap::ClampToEdge,
            Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::MirroredRepeat,
            _ => Wrap::Repeat,
        };
        let nearest_min = [
            MinFilter::Nearest,
            MinFilter::NearestMipmapNearest,
            MinFilter::NearestMipmapLinear,
        ];
        // Minification without mip maps selects bilinear filtering; a nearest magnification filter overrides it
        let filter = match (sampler.mag_filter, sampler.min_filter) {
            (Some(Checked::Valid(MagFilter::Nearest)), _) => Filter::Nearest,
            (None, Some(Checked::Valid(min))) if nearest_min.contains(&min) => Filter::Nearest,
            (_, Some(Checked::Valid(MinFilter::Nearest | MinFilter::Linear))) => Filter::Linear,
            _ => Filter::Mipmap,
        };
        Ok(Sampler {
            wrap_u: wrap(&sampler.wrap_s),
            wrap_v: wrap(&sampler.wrap_t),
            filter,
        })
    }
}

/// Returns the number of a texture's image: that of an extension whose format is decoded, else the texture's own; `None`
/// without both.
pub(super) fn image_of(texture: &json::Texture) -> Option<usize> {
    let extensions = texture.extensions.as_ref().map(|e| &e.others);
    let corrections = &mut Corrections::default();
    let mut source = |name| Extension::of(extensions, name, corrections).index("source", corrections);
    let webp = source("EXT_texture_webp");
    let basis = source("KHR_texture_basisu").filter(|_| cfg!(feature = "basisu"));
    let own = Some(texture.source.value()).filter(|&image| image != NO_IMAGE as usize);
    webp.or(basis).map(|image| image as usize).or(own)
}
