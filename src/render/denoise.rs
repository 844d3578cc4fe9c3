//! Denoising of a rendering, guided by its layers of albedo and normals.

use super::aov::{AovKind, AovSet, Layer};
use super::{RenderSettings, Rendering};
use crate::image::{DenoiseError, DenoiseGuides, Denoiser};

/// Layers that guide a denoiser.
const GUIDES: [AovKind; 2] = [AovKind::Albedo, AovKind::Normal];

impl RenderSettings {
    /// Returns these settings with the layers that guide a denoiser; with different numbers of samples per pixel,
    /// which have no layers, they stay without.
    #[must_use]
    pub fn with_guides(self) -> RenderSettings {
        let layers = GUIDES.into_iter().fold(self.layers, AovSet::with);
        match self.adaptive.is_none() && self.edge_contrast.is_none() {
            true => RenderSettings { layers, ..self },
            false => self,
        }
    }
}

impl Rendering {
    /// Denoises the colours in place, guided by the layers of albedo and normals where it has both; then removes all
    /// layers of first hits that are not in `kept`. Its estimated error, if any, is that of the image before.
    ///
    /// # Errors
    ///
    /// If the denoiser fails.
    pub fn denoise(&mut self, denoiser: &Denoiser, kept: AovSet) -> Result<(), DenoiseError> {
        let guides = self.guides();
        denoiser.denoise(&mut self.image, guides.as_ref())?;
        let unwanted = GUIDES.into_iter().filter(|&kind| !kept.has(kind));
        let names: Vec<&str> = unwanted.flat_map(|kind| kind.names()).copied().collect();
        self.layers.retain(|layer| !names.contains(&layer.name.as_str()));
        Ok(())
    }

    /// Returns the guides, if all their layers are there.
    fn guides(&self) -> Option<DenoiseGuides> {
        let [albedo, normal] = GUIDES.map(|kind| {
            let find = |name: &str| self.layers.iter().find(|layer| layer.name == name);
            let layers: Option<Vec<&Layer>> = kind.names().iter().map(|name| find(name)).collect();
            layers.map(|layers| {
                let values = 0..self.image.pixels.len();
                values
                    .map(|pixel| std::array::from_fn(|channel| layers[channel].values[pixel]))
                    .collect()
            })
        });
        Some(DenoiseGuides {
            albedo: albedo?,
            normal: normal?,
        })
    }
}
