//! Selection of the layers (AOVs) that are computed in addition to the colours of an image.
//!
//! Layers of first hits: every sample of a pixel uses the first surface that its camera ray hits; transparent
//! and partly covered (alpha) surfaces count as hits, volumes and fog do not. The value of a pixel is the
//! mean over the samples that hit a surface, with equal weights for any filter of the image; values of
//! Cryptomatte are fractions of all samples. Lengths and positions are in the coordinates of the scene file.

use super::super::film::STEPS;
use crate::image::ChannelKind;

/// Number of objects stored per pixel, those with the most samples; as many as Cryptomatte suggests.
pub(in crate::render) const RANKS: usize = 6;

/// Group of layers that are requested together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AovKind {
    /// `Z`: distance along the ray from its origin; infinite if no sample hit a surface.
    Depth,
    /// `normal.X`, `normal.Y`, `normal.Z`: unit shading normal in world space on the viewer's side. The mean of
    /// several is shorter than 1. 0 if no sample hit a surface.
    Normal,
    /// `albedo.R`, `albedo.G`, `albedo.B`: base colour with its textures and vertex colours, linear RGB; for
    /// materials of the Phong model, its diffuse part. 0 if no sample hit a surface.
    Albedo,
    /// `position.X`, `position.Y`, `position.Z`: hit point; 0 if no sample hit a surface.
    Position,
    /// `uv.U`, `uv.V`: first set of texture coordinates; 0 without one, or if no sample hit a surface.
    Uv,
    /// `id.object`, `id.material`, `id.primitive`: for the first sample that hit a surface, the index of the
    /// instance, of its material, and of the triangle of the mesh or the part of the shape, from 0; -1 if no sample
    /// did. Integers, exact up to 2^24.
    Ids,
    /// `motion.X`, `motion.Y`: motion vector in pixels, to the right and down, of surface points in the image from
    /// shutter open to shutter close, including camera motion; 0 if no sample hit a surface. Points that are behind
    /// the camera at either time count as static.
    Motion,
    /// `CryptoObject00.R` to `CryptoObject02.A`: alternately the Cryptomatte id of an instance name and the fraction
    /// of the pixel's samples that hit it first; six names, the largest fraction first. 0 for unused ranks. Samples
    /// without a hit belong to no fraction.
    CryptoObject,
    /// `CryptoMaterial00.R` to `CryptoMaterial02.A`: alternately the Cryptomatte id of a material name and its
    /// fraction of samples, like the layers of instance names.
    CryptoMaterial,
}

impl AovKind {
    /// All groups, in the order of their layers.
    pub const ALL: [AovKind; 9] = [
        AovKind::Depth,
        AovKind::Normal,
        AovKind::Albedo,
        AovKind::Position,
        AovKind::Uv,
        AovKind::Ids,
        AovKind::Motion,
        AovKind::CryptoObject,
        AovKind::CryptoMaterial,
    ];

    /// Returns the names of the layers in the group.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            AovKind::Depth => &["Z"],
            AovKind::Normal => &["normal.X", "normal.Y", "normal.Z"],
            AovKind::Albedo => &["albedo.R", "albedo.G", "albedo.B"],
            AovKind::Position => &["position.X", "position.Y", "position.Z"],
            AovKind::Uv => &["uv.U", "uv.V"],
            AovKind::Ids => &["id.object", "id.material", "id.primitive"],
            AovKind::Motion => &["motion.X", "motion.Y"],
            AovKind::CryptoObject => &CRYPTO_OBJECT,
            AovKind::CryptoMaterial => &CRYPTO_MATERIAL,
        }
    }

    /// Returns the Cryptomatte name of the group, if it is one of its layers.
    pub fn cryptomatte(self) -> Option<&'static str> {
        match self {
            AovKind::CryptoObject => Some("CryptoObject"),
            AovKind::CryptoMaterial => Some("CryptoMaterial"),
            _ => None,
        }
    }

    /// Returns whether the layers are means over the samples that hit a surface.
    pub(in crate::render) fn is_sum(self) -> bool {
        self != AovKind::Ids && self.cryptomatte().is_none()
    }

    /// Returns whether a file of half floats may round the layers.
    pub(in crate::render) fn rounding(self) -> ChannelKind {
        match self {
            AovKind::Albedo => ChannelKind::Color,
            _ => ChannelKind::Exact,
        }
    }
}

/// Channel names of Cryptomatte for instance names; four channels hold ids and coverages of two names.
const CRYPTO_OBJECT: [&str; 2 * RANKS] = [
    "CryptoObject00.R",
    "CryptoObject00.G",
    "CryptoObject00.B",
    "CryptoObject00.A",
    "CryptoObject01.R",
    "CryptoObject01.G",
    "CryptoObject01.B",
    "CryptoObject01.A",
    "CryptoObject02.R",
    "CryptoObject02.G",
    "CryptoObject02.B",
    "CryptoObject02.A",
];

/// Channel names of Cryptomatte for material names; four channels hold ids and coverages of two names.
const CRYPTO_MATERIAL: [&str; 2 * RANKS] = [
    "CryptoMaterial00.R",
    "CryptoMaterial00.G",
    "CryptoMaterial00.B",
    "CryptoMaterial00.A",
    "CryptoMaterial01.R",
    "CryptoMaterial01.G",
    "CryptoMaterial01.B",
    "CryptoMaterial01.A",
    "CryptoMaterial02.R",
    "CryptoMaterial02.G",
    "CryptoMaterial02.B",
    "CryptoMaterial02.A",
];

/// Set of groups of layers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AovSet(u16);

impl AovSet {
    /// Set without any layers.
    pub const NONE: AovSet = AovSet(0);

    /// Returns the set with `kind` added.
    #[must_use]
    pub fn with(self, kind: AovKind) -> AovSet {
        AovSet(self.0 | (1 << kind as u16))
    }

    /// Returns whether `kind` is in the set.
    #[inline(always)]
    pub fn has(self, kind: AovKind) -> bool {
        self.0 & (1 << kind as u16) != 0
    }

    /// Returns whether the set is empty.
    pub fn is_empty(self) -> bool {
        self == AovSet::NONE
    }

    /// Iterates over the groups of the set in their fixed order.
    pub fn kinds(self) -> impl Iterator<Item = AovKind> {
        AovKind::ALL.into_iter().filter(move |&kind| self.has(kind))
    }

    /// Returns the number of layers in the set.
    pub(crate) fn layer_count(self) -> usize {
        self.kinds().map(|kind| kind.names().len()).sum()
    }
}

impl FromIterator<AovKind> for AovSet {
    fn from_iter<I: IntoIterator<Item = AovKind>>(kinds: I) -> AovSet {
        kinds.into_iter().fold(AovSet::NONE, AovSet::with)
    }
}

/// Selection of the layers of light to compute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LightAovs {
    /// Layers `light.NAME.R`, `.G`, `.B` for each light: its direct light on surfaces and in volumes. Also
    /// `light.environment` for light of the environment map by shadow rays, `light.subsurface` for all light that
    /// leaves objects with subsurface scattering, and `light.emission` for all light seen without a shadow ray:
    /// emission, ambient light and background.
    pub lights: bool,
    /// Layers `effect.NAME.R`, `.G`, `.B` by the first step of the path from the camera, for the effects that are on:
    /// `effect.direct` for light seen without any, `effect.reflection` and so on.
    pub effects: bool,
}

impl LightAovs {
    /// Selection without any layers.
    pub const NONE: LightAovs = LightAovs {
        lights: false,
        effects: false,
    };

    /// Returns whether no layer is selected.
    pub fn is_empty(self) -> bool {
        self == LightAovs::NONE
    }

    /// Returns the largest number of planes (three channels each) for a scene with `light_count` lights.
    pub(in crate::render) fn max_planes(self, light_count: usize) -> usize {
        // Three more for emission, the environment and subsurface scattering.
        let lights = usize::from(self.lights) * (light_count + 3);
        lights + usize::from(self.effects) * (STEPS.len() + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn set_iterates_its_members_in_fixed_order() {
        let set: AovSet = [AovKind::Ids, AovKind::Depth].into_iter().collect();
        assert!(set.has(AovKind::Ids) && set.has(AovKind::Depth) && !set.has(AovKind::Uv));
        assert_eq!(set.kinds().collect::<Vec<_>>(), [AovKind::Depth, AovKind::Ids]);
        // `Z` and three ids.
        assert_eq!(set.layer_count(), 4);
        assert!(AovSet::NONE.is_empty() && !set.is_empty());
        let all: AovSet = AovKind::ALL.into_iter().collect();
        assert_eq!(all.layer_count(), 41);
    }

    #[test]
    fn cryptomatte_channels_begin_with_the_layer_name() {
        for kind in AovKind::ALL {
            let Some(called) = kind.cryptomatte() else {
                continue;
            };
            for (index, name) in kind.names().iter().enumerate() {
                // Four channels per layer of Cryptomatte.
                let channel = ["R", "G", "B", "A"][index % 4];
                assert_eq!(*name, format!("{called}0{}.{channel}", index / 4));
            }
        }
    }
}
