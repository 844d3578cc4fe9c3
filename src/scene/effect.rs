//! Effects that a scene may need, sets of them, and user overrides of the set that the scene needs.

use std::fmt;
use std::str::FromStr;

use serde::{Serialize, Serializer};

/// A light-transport or shading effect that costs time only in scenes that need it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Effect {
    /// Occlusion of lights by objects.
    Shadow,
    /// Shadows coloured by the transmissive objects that cast them.
    TransparentShadow,
    /// Mirror reflection of the scene.
    Reflection,
    /// Transmission of light through interiors and thin walls.
    Refraction,
    /// Overlapping dielectrics, resolved by priority.
    NestedMedia,
    /// Index of refraction that depends on the wavelength.
    Dispersion,
    /// Absorption of light inside dielectrics.
    Absorption,
    /// Material inputs that vary by images and procedural patterns.
    Texture,
    /// Textures averaged over the footprint of the ray.
    TextureFilter,
    /// Normal maps and bump maps.
    NormalMap,
    /// Colours stored at the vertices of meshes.
    VertexColor,
    /// Surfaces with holes, cut out by an alpha threshold.
    AlphaTest,
    /// Surfaces that partly cover what is behind them.
    AlphaBlend,
    /// Shading normals interpolated over triangles.
    SmoothNormals,
    /// The illumination model of Phong and Whitted, and unlit surfaces.
    Phong,
    /// Dielectrics that reflect more, less or in other colours than glTF's default.
    Specular,
    /// Occlusion maps, which reduce the ambient light in crevices.
    Occlusion,
    /// Radiance emitted by surfaces.
    Emission,
    /// Constant ambient light from all directions.
    Ambient,
    /// A background that is visible behind everything.
    Background,
    /// Participating media: smoke, fire and fog.
    Volume,
    /// Blur of objects nearer or farther than the plane of focus.
    DepthOfField,
    /// Lights with an area, and their soft shadows.
    AreaLight,
    /// Light from an environment map.
    Environment,
    /// Blurred reflections in rough surfaces.
    RoughReflection,
    /// Blurred reflections and refractions at rough transmissive surfaces.
    RoughRefraction,
    /// Blur of objects that move while the shutter is open.
    MotionBlur,
    /// Subsurface scattering: light enters an interior and leaves elsewhere.
    Subsurface,
    /// Diffuse transmission through thin surfaces.
    Translucency,
    /// Multiple scattering between microfacets, and diffuse light less what the lobe takes.
    EnergyConservation,
    /// Clear coats: transparent layers of their own roughness.
    Clearcoat,
    /// Sheen of cloth, by its fibres.
    Sheen,
    /// Lobes that are wider along one direction of the surface, as of brushed metal.
    Anisotropy,
    /// Colours of thin films, by interference.
    Iridescence,
    /// Diffuse light from surfaces to other surfaces; simulated only on request.
    Interreflection,
    /// Light that mirrors and refracting bodies throw onto diffuse surfaces; simulated only on request.
    Caustics,
}

impl Effect {
    /// List of all effects in the order of reports.
    pub const ALL: [Effect; 36] = [
        Effect::Shadow,
        Effect::TransparentShadow,
        Effect::Reflection,
        Effect::Refraction,
        Effect::NestedMedia,
        Effect::Dispersion,
        Effect::Absorption,
        Effect::Texture,
        Effect::TextureFilter,
        Effect::NormalMap,
        Effect::VertexColor,
        Effect::AlphaTest,
        Effect::AlphaBlend,
        Effect::SmoothNormals,
        Effect::Phong,
        Effect::Specular,
        Effect::Occlusion,
        Effect::Emission,
        Effect::Ambient,
        Effect::Background,
        Effect::Volume,
        Effect::DepthOfField,
        Effect::AreaLight,
        Effect::Environment,
        Effect::RoughReflection,
        Effect::RoughRefraction,
        Effect::MotionBlur,
        Effect::Subsurface,
        Effect::Translucency,
        Effect::EnergyConservation,
        Effect::Clearcoat,
        Effect::Sheen,
        Effect::Anisotropy,
        Effect::Iridescence,
        Effect::Interreflection,
        Effect::Caustics,
    ];

    /// Returns the effect's name on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Effect::Shadow => "shadow",
            Effect::TransparentShadow => "transparent-shadow",
            Effect::Reflection => "reflection",
            Effect::Refraction => "refraction",
            Effect::NestedMedia => "nested-media",
            Effect::Dispersion => "dispersion",
            Effect::Absorption => "absorption",
            Effect::Texture => "texture",
            Effect::TextureFilter => "texture-filter",
            Effect::NormalMap => "normal-map",
            Effect::VertexColor => "vertex-color",
            Effect::AlphaTest => "alpha-test",
            Effect::AlphaBlend => "alpha-blend",
            Effect::SmoothNormals => "smooth-normals",
            Effect::Phong => "lecture",
            Effect::Specular => "specular",
            Effect::Occlusion => "occlusion",
            Effect::Emission => "emission",
            Effect::Ambient => "ambient",
            Effect::Background => "background",
            Effect::Volume => "volume",
            Effect::DepthOfField => "depth-of-field",
            Effect::AreaLight => "area-light",
            Effect::Environment => "environment",
            Effect::RoughReflection => "rough-reflection",
            Effect::RoughRefraction => "rough-refraction",
            Effect::MotionBlur => "motion-blur",
            Effect::Subsurface => "subsurface",
            Effect::Translucency => "translucency",
            Effect::EnergyConservation => "energy-conservation",
            Effect::Clearcoat => "clearcoat",
            Effect::Sheen => "sheen",
            Effect::Anisotropy => "anisotropy",
            Effect::Iridescence => "iridescence",
            Effect::Interreflection => "interreflection",
            Effect::Caustics => "caustics",
        }
    }

    /// Returns the effect without which this one does nothing.
    pub const fn needs(self) -> Option<Effect> {
        match self {
            Effect::TransparentShadow => Some(Effect::Shadow),
            Effect::NestedMedia | Effect::Dispersion | Effect::Absorption | Effect::RoughRefraction => {
                Some(Effect::Refraction)
            }
            _ => None,
        }
    }

    /// Returns a sentence fragment on how an image without this effect is wrong.
    pub(crate) const fn consequence(self) -> &'static str {
        match self {
            Effect::Shadow => "lights have no shadows",
            Effect::TransparentShadow => "transparent objects cast black shadows",
            Effect::Reflection => "mirrors reflect nothing",
            Effect::Refraction => "light that a surface transmits is lost",
            Effect::NestedMedia => "a ray that leaves one of several nested media is outside all of them",
            Effect::Dispersion => "all wavelengths refract like the d line",
            Effect::Absorption => "interiors absorb nothing",
            Effect::Texture => "parameters have the values of their factors everywhere",
            Effect::TextureFilter => "textures are sampled at points and may flicker",
            Effect::NormalMap => "surfaces are as smooth as their geometry",
            Effect::VertexColor => "vertex colours are white",
            Effect::AlphaTest => "surfaces have no holes",
            Effect::AlphaBlend => "surfaces cover everything behind them",
            Effect::SmoothNormals => "triangles are flat",
            Effect::Phong => "surfaces with the Phong model are not lit",
            Effect::Specular => "dielectrics reflect 4 %, the default of glTF",
            Effect::Occlusion => "crevices receive all of the ambient light",
            Effect::Emission => "no surface emits light",
            Effect::Ambient => "there is no ambient light",
            Effect::Background => "the background is black",
            Effect::Volume => "there is no smoke, fire or fog",
            Effect::DepthOfField => "everything is in focus",
            Effect::AreaLight => "area lights are dark, and emissive objects light nothing",
            Effect::Environment => "the environment map is visible but lights nothing",
            Effect::RoughReflection => {
                "rough surfaces reflect only lights, and smooth surfaces reflect sharply"
            }
            Effect::RoughRefraction => "what is seen through rough surfaces is sharp",
            Effect::MotionBlur => "everything stays at the start of its motion",
            Effect::Subsurface => {
                "materials with subsurface scattering are opaque paint of their base colour"
            }
            Effect::Translucency => "thin surfaces reflect all of their diffuse light",
            Effect::EnergyConservation => {
                "rough metals are too dark, and dielectrics too bright at grazing angles"
            }
            Effect::Clearcoat => "materials lack their clear coat",
            Effect::Sheen => "cloth lacks its sheen",
            Effect::Anisotropy => "highlights of brushed surfaces are round",
            Effect::Iridescence => "thin films have no colours",
            Effect::Interreflection => "surfaces do not light each other",
            Effect::Caustics => "mirrors and glass throw no light onto surfaces",
        }
    }

    const fn bit(self) -> u64 {
        1 << self as u8
    }
}

impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Serialize for Effect {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

/// A set of effects, one bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EffectSet(u64);

impl EffectSet {
    /// The empty set of effects.
    pub const NONE: EffectSet = EffectSet(0);

    /// The set of all effects.
    pub const ALL: EffectSet = EffectSet(u64::MAX);

    /// Effects that are simulated only on request, because any scene would have them.
    pub const ON_REQUEST: EffectSet = EffectSet::NONE
        .with(Effect::Interreflection)
        .with(Effect::Caustics);

    /// Effects that need no step of their own after a hit, beyond shadow rays and mirror rays.
    ///
    /// Scenes that need no others are shaded by code that is compiled for these only.
    pub(crate) const BASIC: EffectSet = EffectSet::NONE
        .with(Effect::Shadow)
        .with(Effect::Reflection)
        .with(Effect::Texture)
        .with(Effect::NormalMap)
        .with(Effect::VertexColor)
        .with(Effect::SmoothNormals)
        .with(Effect::Phong)
        .with(Effect::Specular)
        .with(Effect::Occlusion)
        .with(Effect::Emission)
        .with(Effect::Ambient)
        .with(Effect::Background)
        .with(Effect::EnergyConservation);

    /// Returns whether `effect` is in the set and was compiled.
    ///
    /// The environment variable `WHIT_WITHOUT` of the compiler names effects whose code is left out, separated by
    /// commas: for them this is `false` at compile time. The test that shows that an effect costs nothing in a scene
    /// that does not need it compiles with it.
    #[inline(always)]
    pub const fn has(self, effect: Effect) -> bool {
        COMPILED & self.0 & effect.bit() != 0
    }

    /// Returns the set with `effect` added.
    #[must_use]
    pub const fn with(self, effect: Effect) -> EffectSet {
        EffectSet(self.0 | effect.bit())
    }

    /// Returns the set with `effect` removed.
    #[must_use]
    pub const fn without(self, effect: Effect) -> EffectSet {
        EffectSet(self.0 & !effect.bit())
    }

    /// Returns the effects of this set that are not in `other`.
    #[must_use]
    pub const fn minus(self, other: EffectSet) -> EffectSet {
        EffectSet(self.0 & !other.0)
    }

    /// Returns the effects that are both in this set and in `other`.
    #[must_use]
    #[inline(always)]
    pub const fn within(self, other: EffectSet) -> EffectSet {
        EffectSet(self.0 & other.0)
    }

    /// Returns whether all compiled effects of this set are in `other`.
    #[inline(always)]
    pub(crate) const fn are_within(self, other: EffectSet) -> bool {
        COMPILED & self.0 & !other.0 == 0
    }

    /// Returns whether materials have more inputs than glTF's base colour, metalness, roughness and emission.
    #[inline(always)]
    pub(crate) const fn needs_full_material(self) -> bool {
        self.has(Effect::Phong)
            || self.has(Effect::Specular)
            || self.has(Effect::Refraction)
            || self.has(Effect::Occlusion)
            || self.has_lobes()
            || self.has(Effect::Subsurface)
            || self.has(Effect::Translucency)
            || self.has_layers()
            || self.has_special_lobes()
    }

    /// Returns whether lobes may be anisotropic or have thin films, which are evaluated by code of their own.
    #[inline(always)]
    pub(crate) const fn has_special_lobes(self) -> bool {
        self.has(Effect::Anisotropy) || self.has(Effect::Iridescence)
    }

    /// Returns whether materials have layers above their base, which are shaded as surfaces of their own.
    #[inline(always)]
    pub(crate) const fn has_layers(self) -> bool {
        self.has(Effect::Clearcoat) || self.has(Effect::Sheen)
    }

    /// Returns whether materials have no more than glTF's base colour, metalness and roughness, without emission or
    /// coverage.
    #[inline(always)]
    pub(crate) const fn has_basic_materials(self) -> bool {
        // Coverage needs the fourth channel of the base colour
        let covers = self.has(Effect::AlphaTest) || self.has(Effect::AlphaBlend);
        !(self.needs_full_material() || covers || self.has(Effect::Emission))
    }

    /// Returns whether each path counts its own bounces, because paths of one generation differ in them.
    #[inline(always)]
    pub(crate) const fn counts_bounces(self) -> bool {
        self.has_transmission() || self.has_random_paths()
    }

    /// Returns whether some paths continue at random and do not branch: from diffuse surfaces, or from lights.
    #[inline(always)]
    pub(crate) const fn has_random_paths(self) -> bool {
        self.has(Effect::Interreflection) || self.has(Effect::Caustics)
    }

    /// Returns whether light may continue behind some surfaces, by refraction or partial coverage.
    #[inline(always)]
    pub const fn has_transmission(self) -> bool {
        self.has(Effect::Refraction) || self.has(Effect::AlphaTest) || self.has(Effect::AlphaBlend)
    }

    /// Returns the first effect of the set by which light continues behind surfaces: refraction, alpha test or alpha
    /// blend.
    pub fn transmissive(self) -> Effect {
        let effects = [Effect::Refraction, Effect::AlphaTest];
        let first = effects.into_iter().find(|&effect| self.has(effect));
        first.unwrap_or(Effect::AlphaBlend)
    }

    /// Returns whether shading samples light at random: area lights, the environment, rough lobes or diffuse surfaces.
    #[inline(always)]
    pub(crate) const fn samples_light(self) -> bool {
        self.has(Effect::AreaLight)
            || self.has(Effect::Environment)
            || self.has_lobes()
            || self.has_random_paths()
    }

    /// Returns whether rough surfaces spawn rays into their lobes.
    #[inline(always)]
    pub const fn has_lobes(self) -> bool {
        self.has(Effect::RoughReflection) || self.has(Effect::RoughRefraction)
    }

    /// Returns whether each path carries its own ray cone for texture filtering, because cones differ between paths.
    #[inline(always)]
    pub(crate) const fn tracks_cones(self) -> bool {
        // Without scattering, all cones are those of camera rays
        let differ = self.has(Effect::Reflection) || self.counts_bounces() || self.has_lobes();
        self.has(Effect::TextureFilter) && differ
    }

    /// Returns whether any radiance is visible without a light: emission, ambient light or background.
    #[inline(always)]
    pub(crate) const fn has_unlit_radiance(self) -> bool {
        self.has(Effect::Emission) || self.has(Effect::Ambient) || self.has(Effect::Background)
    }

    /// Iterates over the effects of the set, in the order of reports.
    pub fn iter(self) -> impl Iterator<Item = Effect> {
        Effect::ALL.into_iter().filter(move |&effect| self.has(effect))
    }
}

impl FromIterator<Effect> for EffectSet {
    fn from_iter<I: IntoIterator<Item = Effect>>(effects: I) -> EffectSet {
        effects.into_iter().fold(EffectSet::NONE, EffectSet::with)
    }
}

/// The effects that are compiled into the program, as bits.
const COMPILED: u64 = match option_env!("WHIT_WITHOUT") {
    Some(names) => !bits_of(names.as_bytes()),
    None => u64::MAX,
};

/// Returns the bits of the effects in a comma-separated list of names. Panics at compile time on an unknown name.
const fn bits_of(list: &[u8]) -> u64 {
    let mut bits = 0;
    let mut start = 0;
    // Find the end of the next name
    while start < list.len() {
        let mut end = start;
        while end < list.len() && list[end] != b',' {
            end += 1;
        }
        // Set the bit of the effect with this name
        let mut known = false;
        let mut e = 0;
        while e < Effect::ALL.len() {
            if is_at(Effect::ALL[e].name().as_bytes(), list, start, end) {
                bits |= Effect::ALL[e].bit();
                known = true;
            }
            e += 1;
        }
        assert!(known, "WHIT_WITHOUT names an effect that does not exist");
        start = end + 1;
    }
    bits
}

const fn is_at(name: &[u8], list: &[u8], start: usize, end: usize) -> bool {
    if name.len() != end - start {
        return false;
    }
    let mut i = 0;
    while i < name.len() {
        if name[i] != list[start + i] {
            return false;
        }
        i += 1;
    }
    true
}

/// A user's changes to the effects that a scene needs: `+x,-y`, or `all`.
///
/// `all` adds every effect that a scene needs or not, which changes no image. It does not add those that are simulated
/// only on request.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EffectOverrides {
    /// Effects that are simulated although the scene does not need them.
    pub added: EffectSet,
    /// Effects that are left out although the scene needs them.
    pub removed: EffectSet,
}

impl EffectOverrides {
    /// Simulation of all effects, needed or not, but those that are simulated only on request.
    pub const ALL: EffectOverrides = EffectOverrides {
        added: EffectSet::ALL.minus(EffectSet::ON_REQUEST),
        removed: EffectSet::NONE,
    };
}

impl FromStr for EffectOverrides {
    type Err = String;

    fn from_str(list: &str) -> Result<EffectOverrides, String> {
        let mut overrides = EffectOverrides::default();
        for item in list.split(',') {
            if item == "all" {
                overrides.added = EffectOverrides::ALL.added;
                continue;
            }
            // Look the effect up by its name
            let by_name = |name: &str| Effect::ALL.into_iter().find(|effect| effect.name() == name);
            let unknown = || {
                let names: Vec<&str> = Effect::ALL.iter().map(|effect| effect.name()).collect();
                format!(
                    "`{item}` is not an effect: write `all`, or +NAME and -NAME of {}",
                    names.join(", ")
                )
            };
            match (item.strip_prefix('+'), item.strip_prefix('-')) {
                (Some(name), _) => overrides.added = overrides.added.with(by_name(name).ok_or_else(unknown)?),
                (_, Some(name)) => {
                    overrides.removed = overrides.removed.with(by_name(name).ok_or_else(unknown)?);
                }
                _ => return Err(unknown()),
            }
        }
        // A removal wins over an addition, so `all,-shadow` is all but shadows
        overrides.added = overrides.added.minus(overrides.removed);
        Ok(overrides)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effect_list_is_complete_and_in_order() {
        for (index, effect) in Effect::ALL.into_iter().enumerate() {
            assert_eq!(effect as usize, index);
        }
        let names: std::collections::HashSet<&str> = Effect::ALL.iter().map(|effect| effect.name()).collect();
        assert_eq!(names.len(), Effect::ALL.len());
    }

    #[test]
    fn effect_sets_hold_their_members() {
        let set: EffectSet = [Effect::Shadow, Effect::Texture].into_iter().collect();
        assert!(set.has(Effect::Shadow) && set.has(Effect::Texture) && !set.has(Effect::Ambient));
        assert_eq!(
            set.without(Effect::Shadow).iter().collect::<Vec<_>>(),
            [Effect::Texture]
        );
        assert_eq!(set.minus(set), EffectSet::NONE);
        assert_eq!(EffectSet::ALL.iter().count(), Effect::ALL.len());
    }

    #[test]
    fn overrides_are_parsed_and_invalid_ones_rejected() {
        let overrides: EffectOverrides = "+dispersion,-shadow".parse().unwrap();
        assert_eq!(overrides.added.iter().collect::<Vec<_>>(), [Effect::Dispersion]);
        assert_eq!(overrides.removed.iter().collect::<Vec<_>>(), [Effect::Shadow]);
        let overrides: EffectOverrides = "all,-shadow".parse().unwrap();
        assert_eq!(overrides.added.iter().count(), Effect::ALL.len() - 3);
        assert!(!overrides.added.has(Effect::Interreflection));
        for wrong in ["", "shadow", "+shade", "+", "all,"] {
            let message = wrong.parse::<EffectOverrides>().unwrap_err();
            assert!(message.contains("is not an effect"), "{wrong}: {message}");
        }
    }

    #[test]
    fn effect_names_in_the_compiler_environment_are_parsed() {
        assert_eq!(bits_of(b"shadow"), Effect::Shadow.bit());
        assert_eq!(
            bits_of(b"texture,ambient"),
            Effect::Texture.bit() | Effect::Ambient.bit()
        );
        assert_eq!(bits_of(b""), 0);
    }
}
