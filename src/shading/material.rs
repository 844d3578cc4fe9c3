//! Materials of sixteen points: constant factors, which textures and vertex colours later multiply.

use super::{LayerLanes, LobeAlbedo, SheenLanes};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Effect, EffectSet, Material, MetallicRoughness, Model, Phong, Translucency};

/// Material parameters of sixteen points.
///
/// `extended` holds neutral values unless the effects need it.
#[derive(Clone, Debug)]
pub struct MaterialPacket {
    /// Effects whose parameters are written; parameters of other effects are neutral.
    pub effects: EffectSet,
    /// Base colour, linear RGB.
    pub base_color: Lanes3<f32>,
    /// Coverage of the surface in [0, 1]; 1 for opaque materials.
    pub alpha: Lanes<f32>,
    /// Emitted radiance, linear RGB.
    pub emission: Lanes3<f32>,
    /// Metalness: 0 for dielectrics, 1 for metals.
    pub metallic: Lanes<f32>,
    /// Perceptual roughness, 0 to 1.
    pub roughness: Lanes<f32>,
    /// Reflectance of the dielectric at normal incidence, before `specular_color` and `specular`.
    pub f0: Lanes<f32>,
    /// Albedo of the GGX lobe towards the viewer; [`LobeAlbedo::NONE`] without [`Effect::EnergyConservation`].
    pub lobe: LobeAlbedo<Lanes<f32>>,
    /// Parameters that only few materials use.
    pub extended: ExtendedMaterialLanes,
    /// Layers above the base; `None` unless an effect needs them.
    pub layers: Option<Box<LayerLanes>>,
    /// Sheen that is shaded instead of the model, set only where that layer is shaded.
    pub sheen: Option<Box<SheenLanes>>,
    /// Index of refraction of a scattering interior, set only where irradiance that enters it is computed.
    pub entry_ior: Option<f32>,
}

/// Rarely used material parameters of sixteen points.
#[derive(Clone, Debug)]
pub struct ExtendedMaterialLanes {
    /// Strength of the specular reflection of a dielectric.
    pub specular: Lanes<f32>,
    /// Specular colour of a dielectric; rsp in the Phong and Whitted model.
    pub specular_color: Lanes3<f32>,
    /// Transmitted fraction, linear RGB; kt in the Phong and Whitted model.
    pub transmission: Lanes3<f32>,
    /// Ambient occlusion: the fraction of the ambient light that arrives.
    pub occlusion: Lanes<f32>,
    /// True in lanes that are shaded by the Phong and Whitted model rather than glTF's. An unlit surface is one of that
    /// model with zero reflectance.
    pub is_phong: Lanes<bool>,
    /// Ambient reflectance ra of the Phong and Whitted model, linear RGB.
    pub ambient: Lanes3<f32>,
    /// Diffuse reflectance rd of the Phong and Whitted model, linear RGB.
    pub diffuse: Lanes3<f32>,
    /// Exponent f of the Phong highlight.
    pub exponent: Lanes<f32>,
    /// Mirror reflectance kr of the Phong and Whitted model, linear RGB.
    pub reflection: Lanes3<f32>,
    /// Number of rays into a rough lobe at the hit of a camera ray.
    pub rough_rays: Lanes<u32>,
    /// Fraction of the diffuse light that leaves where it arrived and on that side: less than 1 for thin surfaces, 0
    /// for interiors with subsurface scattering.
    pub same_side_diffuse: Lanes<f32>,
    /// Fraction of the diffuse light of a white thin surface that leaves on the other side, linear RGB.
    pub translucency: Lanes3<f32>,
    /// Strength of the anisotropy of the lobe.
    pub anisotropy: Lanes<f32>,
    /// Unit vectors of the surfaces along which an anisotropic lobe is wider, perpendicular to the shading normals.
    pub anisotropy_direction: Lanes3<f32>,
    /// Weight of a thin film's reflectance.
    pub film: Lanes<f32>,
    /// Index of refraction of the film.
    pub film_ior: Lanes<f32>,
    /// Thickness of the film in nanometres.
    pub film_thickness: Lanes<f32>,
    /// Reflectance of the film towards the viewer, linear RGB; set with `lobe`.
    pub film_reflectance: Lanes3<f32>,
}

/// Returns the reflectance of a dielectric at normal incidence in air.
fn f0_of(ior: f64) -> f32 {
    let ratio = (ior - 1.0) / (ior + 1.0);
    (ratio * ratio) as f32
}

/// Reflectance of glTF's default index of refraction, 1.5, written as the specification does.
pub(super) const DEFAULT_F0: f32 = 0.04;

impl MaterialPacket {
    /// Material that is black in all lanes.
    pub const BLACK: MaterialPacket = MaterialPacket {
        effects: EffectSet::NONE,
        base_color: [[0.0; LANES]; 3],
        layers: None,
        sheen: None,
        entry_ior: None,
        alpha: [1.0; LANES],
        emission: [[0.0; LANES]; 3],
        metallic: [0.0; LANES],
        roughness: [1.0; LANES],
        f0: [DEFAULT_F0; LANES],
        lobe: LobeAlbedo::NONE,
        extended: ExtendedMaterialLanes {
            specular: [1.0; LANES],
            specular_color: [[1.0; LANES]; 3],
            transmission: [[0.0; LANES]; 3],
            occlusion: [1.0; LANES],
            is_phong: [false; LANES],
            ambient: [[0.0; LANES]; 3],
            diffuse: [[0.0; LANES]; 3],
            exponent: [1.0; LANES],
            reflection: [[0.0; LANES]; 3],
            rough_rays: [0; LANES],
            same_side_diffuse: [1.0; LANES],
            translucency: [[0.0; LANES]; 3],
            anisotropy: [0.0; LANES],
            anisotropy_direction: [[0.0; LANES]; 3],
            film: [0.0; LANES],
            film_ior: [1.0; LANES],
            film_thickness: [0.0; LANES],
            film_reflectance: [[0.0; LANES]; 3],
        },
    };

    /// Returns neutral parameters for the effects of a scene.
    pub fn of_effects(effects: EffectSet) -> MaterialPacket {
        MaterialPacket {
            effects,
            layers: effects.has_layers().then(|| Box::new(LayerLanes::NONE)),
            ..MaterialPacket::BLACK
        }
    }

    /// Sets every lane to the factors of `material`.
    #[inline(always)]
    pub fn fill(&mut self, material: &Material) {
        if self.effects.has_basic_materials() {
            self.fill_of::<true>(material);
        } else {
            self.fill_of::<false>(material);
        }
    }

    /// Sets every lane; `BASIC` skips the optional effects at compile time.
    #[inline(always)]
    fn fill_of<const BASIC: bool>(&mut self, material: &Material) {
        let factors = Factors::of(material, self.effects);
        for l in 0..LANES {
            self.set_basic::<BASIC>(l, &factors);
        }
        if !BASIC && self.effects.needs_full_material() {
            for l in 0..LANES {
                self.set_extended(l, &factors);
            }
        }
    }

    /// Sets one lane to the factors of `material`.
    #[inline(always)]
    pub fn set(&mut self, l: usize, material: &Material) {
        self.set_of::<false>(l, material);
    }

    /// Sets the lanes for which `material` returns one to the factors of that material.
    #[inline(always)]
    pub fn set_lanes<'m>(&mut self, material: impl FnMut(usize) -> Option<&'m Material>) {
        if self.effects.has_basic_materials() {
            self.set_lanes_of::<true>(material);
        } else {
            self.set_lanes_of::<false>(material);
        }
    }

    /// Sets the lanes that have a material; `BASIC` skips the optional effects at compile time.
    #[inline(always)]
    fn set_lanes_of<'m, const BASIC: bool>(
        &mut self,
        mut material: impl FnMut(usize) -> Option<&'m Material>,
    ) {
        for l in 0..LANES {
            if let Some(material) = material(l) {
                self.set_of::<BASIC>(l, material);
            }
        }
    }

    /// Sets one lane to the factors of `material`. `BASIC` may be true only if [`EffectSet::has_basic_materials`] holds for the
    /// packet's effects.
    #[inline(always)]
    fn set_of<const BASIC: bool>(&mut self, l: usize, material: &Material) {
        let factors = Factors::of(material, self.effects);
        self.set_basic::<BASIC>(l, &factors);
        if !BASIC && self.effects.needs_full_material() {
            self.set_extended(l, &factors);
        }
    }

    /// Returns whether any lane may emit light; also true for lanes that a former packet has left.
    #[inline(always)]
    pub fn may_emit(&self) -> bool {
        let emission = self.emission.as_flattened();
        emission.iter().fold(0, |bits, value| bits | value.to_bits()) != 0
    }

    /// Returns whether the surface in lane `l` transmits light.
    #[inline(always)]
    pub fn transmits(&self, l: usize) -> bool {
        let transmission = &self.extended.transmission;
        transmission[0][l] + transmission[1][l] + transmission[2][l] > 0.0
    }

    /// Returns whether the surface in lane `l` gathers its environment by rays into a rough lobe, rather than by a
    /// mirror ray or not at all.
    #[inline(always)]
    pub fn has_lobe(&self, l: usize) -> bool {
        if !self.effects.has_lobes() {
            return false;
        }
        let effect = if self.effects.has(Effect::Refraction) && self.transmits(l) {
            Effect::RoughRefraction
        } else {
            Effect::RoughReflection
        };
        self.effects.has(effect) && self.extended.rough_rays[l] > 0 && self.roughness[l] > 0.0
    }

    /// Returns whether the surface in lane `l` is a thin surface with diffuse transmission.
    #[inline(always)]
    pub fn is_thin_surface(&self, l: usize) -> bool {
        let transmission = &self.extended.translucency;
        transmission[0][l] + transmission[1][l] + transmission[2][l] > 0.0
    }

    /// Sets the parameters that every packet has, in lane `l`.
    #[inline(always)]
    fn set_basic<const BASIC: bool>(&mut self, l: usize, factors: &Factors) {
        let material = factors.material;
        // Set colour and emission per channel
        let has_emission = !BASIC && self.effects.has(Effect::Emission);
        for channel in 0..3 {
            self.base_color[channel][l] = material.base_color[channel];
            self.emission[channel][l] = if has_emission {
                factors.emission[channel]
            } else {
                0.0
            };
        }
        // Set coverage, metalness, roughness and reflectance
        self.alpha[l] = if BASIC {
            1.0
        } else {
            self.coverage(material, material.base_color[3])
        };
        self.metallic[l] = factors.model.metallic;
        self.roughness[l] = factors.model.roughness;
        self.f0[l] = if BASIC { DEFAULT_F0 } else { factors.f0 };
    }

    /// Returns the coverage of a surface of `material` whose base colour has the alpha value `alpha`.
    #[inline(always)]
    pub fn coverage(&self, material: &Material, alpha: f32) -> f32 {
        if material.alpha.is_simulated(self.effects) {
            material.alpha.coverage(alpha)
        } else {
            1.0
        }
    }

    /// Sets the rarely used parameters in lane `l`, neutral where their effect is off.
    #[inline(always)]
    fn set_extended(&mut self, l: usize, factors: &Factors) {
        // Set the parameters that have one value per lane
        let is_specular = factors.is_phong || self.effects.has(Effect::Specular);
        let same_side_diffuse = self.same_side_fraction(factors);
        let has_translucency = self.effects.has(Effect::Translucency);
        let extended = &mut self.extended;
        let was_phong = extended.is_phong[l];
        extended.same_side_diffuse[l] = same_side_diffuse;
        extended.specular[l] = if is_specular { factors.model.specular } else { 1.0 };
        extended.occlusion[l] = 1.0;
        extended.rough_rays[l] = factors.model.rough_rays;
        if self.effects.has(Effect::Anisotropy) {
            let lobe = factors.material.anisotropic();
            extended.anisotropy[l] = lobe.map_or(0.0, |lobe| lobe.strength);
        }
        if self.effects.has(Effect::Iridescence) {
            let film = factors.material.iridescent();
            extended.film[l] = film.map_or(0.0, |film| film.factor);
            extended.film_ior[l] = film.map_or(1.0, |film| film.ior);
            extended.film_thickness[l] = film.map_or(0.0, |film| film.thickness[1]);
        }
        if let Some(layers) = &mut self.layers {
            layers.set(l, factors.material, self.effects);
        }
        // Set the parameters that have one value per colour channel
        for channel in 0..3 {
            extended.specular_color[channel][l] = if is_specular {
                factors.specular_color[channel]
            } else {
                1.0
            };
            extended.transmission[channel][l] = factors.transmission[channel];
            // Without the effect all lanes stay neutral
            if has_translucency {
                extended.translucency[channel][l] = factors.translucency[channel];
            }
        }
        // Set the parameters of the Phong model, which are neutral in lanes that have not had it
        if factors.is_phong | was_phong {
            extended.is_phong[l] = factors.is_phong;
            extended.exponent[l] = factors.phong.exponent;
            for channel in 0..3 {
                extended.ambient[channel][l] = factors.phong.ambient[channel];
                extended.diffuse[channel][l] = factors.phong.diffuse[channel];
                extended.reflection[channel][l] = factors.phong.reflection[channel];
            }
        }
    }

    /// Returns the fraction of the diffuse light that leaves where it arrived and on that side.
    #[inline(always)]
    fn same_side_fraction(&self, factors: &Factors) -> f32 {
        if self.effects.has(Effect::Subsurface) && factors.material.scatters().is_some() {
            0.0
        } else {
            factors.same_side_diffuse
        }
    }
}

/// Factors of a material in one form for both shading models.
struct Factors<'m> {
    material: &'m Material,
    model: &'m MetallicRoughness,
    phong: &'m Phong,
    is_phong: bool,
    f0: f32,
    emission: [f32; 3],
    specular_color: [f32; 3],
    transmission: [f32; 3],
    same_side_diffuse: f32,
    translucency: [f32; 3],
}

/// Parameters of the Phong and Whitted model for a surface with zero reflectance.
const UNLIT_PHONG: Phong = Phong {
    ambient: [0.0; 3],
    diffuse: [0.0; 3],
    ..Phong::DEFAULT
};

impl<'m> Factors<'m> {
    /// Returns the factors of `material`, neutral for `effects` that are off.
    #[inline(always)]
    fn of(material: &'m Material, effects: EffectSet) -> Factors<'m> {
        // Fill in the model that the material does not use with neutral values
        let (model, phong, is_phong) = match &material.model {
            Model::MetallicRoughness(model) => (model, &UNLIT_PHONG, false),
            Model::Phong(phong) => (&MetallicRoughness::DEFAULT, phong, true),
            Model::Unlit => (&MetallicRoughness::DEFAULT, &UNLIT_PHONG, true),
        };
        // Split the diffuse light between the two sides of a thin surface
        let thin = match effects.has(Effect::Translucency) {
            true => material.translucent(),
            false => None,
        };
        let diffuse_transmission = thin.map(Translucency::diffuse_transmission);
        Factors {
            material,
            model,
            phong,
            is_phong,
            f0: match &material.interior {
                Some(interior) if effects.has(Effect::Specular) => {
                    f0_of(interior.ior.ior(crate::optics::LINE_D))
                }
                _ => DEFAULT_F0,
            },
            emission: match material.model {
                Model::Unlit => [0, 1, 2].map(|channel| material.base_color[channel]),
                _ => material.emission,
            },
            specular_color: if is_phong {
                phong.specular
            } else {
                model.specular_color
            },
            transmission: if is_phong {
                phong.transmission
            } else {
                [model.transmission; 3]
            },
            // Textures multiply the base colour in later; the fraction is equal in all channels.
            same_side_diffuse: diffuse_transmission.map_or(1.0, |diffuse_transmission| {
                diffuse_transmission.reflectance()[0] as f32
            }),
            translucency: diffuse_transmission.map_or([0.0; 3], |diffuse_transmission| {
                diffuse_transmission.translucency().map(|x| x as f32)
            }),
        }
    }
}
