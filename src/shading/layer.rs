//! Layers above the base of sixteen surfaces: a clear coat over sheen.
//!
//! Each layer is shaded as a surface of its own at the same points, with the part of the light that it reflects as its
//! weight; what is below gets the rest. The coat (`KHR_materials_clearcoat`) reflects as the extension defines: with
//! Schlick's reflectance of index 1.5 at the angle between viewer and coat normal, and the lobe of its own roughness.

use super::material::{DEFAULT_F0, MaterialPacket};
use super::sheen::SheenLanes;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Effect, EffectSet, Material};

/// Layers of sixteen surfaces.
#[derive(Clone, Debug)]
pub struct LayerLanes {
    /// Coated fraction of the surfaces.
    pub coat: Lanes<f32>,
    /// Perceptual roughness of the coat.
    pub coat_roughness: Lanes<f32>,
    /// Unit shading normals of the coat, on the side of the viewer.
    pub coat_normal: Lanes3<f32>,
    /// Sheen under the coat.
    pub sheen: SheenLanes,
}

impl LayerLanes {
    /// Surfaces without layers.
    pub const NONE: LayerLanes = LayerLanes {
        coat: [0.0; LANES],
        coat_roughness: [0.0; LANES],
        coat_normal: [[0.0; LANES]; 3],
        sheen: SheenLanes::NONE,
    };

    /// Sets lane `l` to the factors of `material`; layers of absent effects stay away.
    pub fn set(&mut self, l: usize, material: &Material, effects: EffectSet) {
        let coat = material.coated().filter(|_| effects.has(Effect::Clearcoat));
        self.coat[l] = coat.map_or(0.0, |coat| coat.factor);
        self.coat_roughness[l] = coat.map_or(0.0, |coat| coat.roughness);
        let sheen = material.sheening().filter(|_| effects.has(Effect::Sheen));
        let color = sheen.map_or([0.0; 3], |sheen| sheen.color);
        (0..3).for_each(|c| self.sheen.color[c][l] = color[c]);
        self.sheen.roughness[l] = sheen.map_or(0.0, |sheen| sheen.roughness);
    }

    /// Returns the fraction of the light that the coat reflects to viewers along `wo`, in each lane.
    pub fn coat_weights(&self, wo: &Lanes3<f32>) -> Lanes<f32> {
        let cosines = cosines(&self.coat_normal, wo);
        std::array::from_fn(|l| {
            let rest = 1.0 - cosines[l];
            let squared = rest * rest;
            let fresnel = DEFAULT_F0 + (1.0 - DEFAULT_F0) * squared * squared * rest;
            self.coat[l] * fresnel
        })
    }

    /// Returns whether any lane has sheen.
    pub fn has_sheen(&self) -> bool {
        self.sheen.color.as_flattened().iter().any(|&c| c > 0.0)
    }

    /// Returns the surface of the coat: it reflects all light, as its weight is what it reflects. Its lobe is sampled by as
    /// many rays as that of the base.
    pub fn coat_surface(&self, base: &MaterialPacket) -> MaterialPacket {
        let mut surface = MaterialPacket {
            effects: base.effects,
            base_color: [[1.0; LANES]; 3],
            metallic: [1.0; LANES],
            roughness: self.coat_roughness,
            ..MaterialPacket::BLACK
        };
        surface.extended.rough_rays = base.extended.rough_rays;
        surface.extended.occlusion = base.extended.occlusion;
        surface
    }

    /// Returns the surface of the sheen.
    pub fn sheen_surface(&self, base: &MaterialPacket) -> MaterialPacket {
        MaterialPacket {
            effects: base.effects,
            sheen: Some(Box::new(self.sheen)),
            ..MaterialPacket::BLACK
        }
    }
}

/// Returns the cosines between unit vectors of sixteen lanes, in [0, 1].
pub(super) fn cosines(n: &Lanes3<f32>, wo: &Lanes3<f32>) -> Lanes<f32> {
    std::array::from_fn(|l| {
        let cosine = n[0][l] * wo[0][l] + n[1][l] * wo[1][l] + n[2][l] * wo[2][l];
        // Lanes that hit nothing may hold NaN, which `min` replaces and `clamp` would keep
        cosine.abs().min(1.0)
    })
}
