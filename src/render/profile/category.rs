//! Categories of the render profile, one of which every ray and every second is booked under.

use crate::scene::Effect;

/// Category of the profile: every ray and every second is booked under exactly one account.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Category {
    /// Generation of camera rays, and selection of pixels for adaptive sampling.
    Sampling,
    /// Camera rays, traced to their first hit.
    Camera,
    /// Shadow rays, up to the first surface that they hit.
    Shadow,
    /// Continuation of shadow rays behind the first surface, where light goes through surfaces, and their
    /// attenuation.
    TransparentShadow,
    /// Mirror reflection rays from smooth surfaces.
    Reflection,
    /// Refracted rays, and the computation of reflection and refraction at boundaries.
    Refraction,
    /// Rays into the lobes of opaque rough surfaces.
    RoughReflection,
    /// Rays into the lobes of transmissive rough surfaces, on either side of them.
    RoughRefraction,
    /// Rays of a single wavelength, of any kind.
    Dispersion,
    /// Absorption along rays inside media.
    Absorption,
    /// Samples along rays through smoke, fire and fog.
    Volume,
    /// Irradiance of objects with subsurface scattering, and the radiance that leaves them.
    Subsurface,
    /// Rays from diffuse surfaces, which find the light of other surfaces.
    Interreflection,
    /// Photons from lights by mirrors and refraction, and their light on diffuse surfaces.
    Caustics,
    /// Points, normals and materials of hits.
    Surface,
    /// Texture look-ups, and normals that they perturb.
    Texture,
    /// Unoccluded radiance of direct light.
    Lighting,
    /// Emission, ambient light and background.
    Surroundings,
    /// Sums of radiance, and the image made of them.
    Film,
    /// Preparation: surfaces, and rays that find the interiors around the camera.
    Other,
    /// Time in which threads have no work, mostly at the end of an image.
    Idle,
}

/// Number of accounts, including `idle`.
pub(in crate::render) const ACCOUNTS: usize = Category::ALL.len();

impl Category {
    /// All accounts, in the order of reports.
    pub const ALL: [Category; 21] = [
        Category::Sampling,
        Category::Camera,
        Category::Shadow,
        Category::TransparentShadow,
        Category::Reflection,
        Category::Refraction,
        Category::RoughReflection,
        Category::RoughRefraction,
        Category::Dispersion,
        Category::Absorption,
        Category::Volume,
        Category::Subsurface,
        Category::Interreflection,
        Category::Caustics,
        Category::Surface,
        Category::Texture,
        Category::Lighting,
        Category::Surroundings,
        Category::Film,
        Category::Other,
        Category::Idle,
    ];

    /// Returns the name in reports; the account of an effect has the name of the effect.
    pub const fn name(self) -> &'static str {
        match self {
            Category::Sampling => "sampling",
            Category::Camera => "camera",
            Category::Shadow => "shadow",
            Category::TransparentShadow => "transparent-shadow",
            Category::Reflection => "reflection",
            Category::Refraction => "refraction",
            Category::RoughReflection => "rough-reflection",
            Category::RoughRefraction => "rough-refraction",
            Category::Dispersion => "dispersion",
            Category::Absorption => "absorption",
            Category::Volume => "volume",
            Category::Subsurface => "subsurface",
            Category::Interreflection => "interreflection",
            Category::Caustics => "caustics",
            Category::Surface => "surface",
            Category::Texture => "texture",
            Category::Lighting => "lighting",
            Category::Surroundings => "surroundings",
            Category::Film => "film",
            Category::Other => "other",
            Category::Idle => "idle",
        }
    }

    /// Returns the account of an effect, if the effect has one of its own.
    pub fn of(effect: Effect) -> Option<Category> {
        Category::ALL
            .into_iter()
            .find(|account| account.name() == effect.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accounts_are_listed_at_their_index() {
        for (index, account) in Category::ALL.into_iter().enumerate() {
            assert_eq!(account as usize, index);
        }
        assert_eq!(Category::of(Effect::Dispersion), Some(Category::Dispersion));
        assert_eq!(Category::of(Effect::Occlusion), None);
    }
}
