//! Numbers of secondary rays by type, which divide the time of a generation among categories.

use super::category::Category;

/// Numbers of rays of a generation by type; all others are mirror rays of all wavelengths from smooth surfaces.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::render) struct RayTypeCounts {
    /// Refracted rays of all wavelengths.
    pub(in crate::render) refracted: u64,
    /// Refracted rays of a single wavelength.
    pub(in crate::render) refracted_colors: u64,
    /// Mirror rays of a single wavelength.
    pub(in crate::render) mirrored_colors: u64,
    /// Rays into lobes of opaque surfaces, of all wavelengths.
    pub(in crate::render) rough_reflected: u64,
    /// Rays into lobes of transmissive surfaces, of all wavelengths.
    pub(in crate::render) rough_refracted: u64,
    /// Rays into any lobes, of a single wavelength.
    pub(in crate::render) rough_colors: u64,
    /// Rays from diffuse surfaces, of all wavelengths.
    pub(in crate::render) bounced: u64,
    /// Rays from diffuse surfaces, of a single wavelength.
    pub(in crate::render) bounced_colors: u64,
}

impl RayTypeCounts {
    /// Returns how many of the `rays` of the generation each account sent.
    pub(in crate::render) fn accounts(&self, rays: u64) -> [(Category, u64); 6] {
        // Rays without a counted type are mirror rays of all wavelengths.
        let colors = self.mirrored_colors + self.refracted_colors + self.rough_colors + self.bounced_colors;
        let rough = self.rough_reflected + self.rough_refracted;
        [
            (
                Category::Reflection,
                rays.saturating_sub(self.refracted + rough + self.bounced + colors),
            ),
            (Category::Refraction, self.refracted),
            (Category::RoughReflection, self.rough_reflected),
            (Category::RoughRefraction, self.rough_refracted),
            (Category::Dispersion, colors),
            (Category::Interreflection, self.bounced),
        ]
    }
}
