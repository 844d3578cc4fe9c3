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
    /// Surfaces without any layers.
    pub const NONE: LayerLanes = LayerLanes {
        coat: [0.0; LANES],
        coat_roughness: [0.0; LANES],
        coat_normal: [[0.0; LANES]; 3],
        sheen: SheenLanes::NONE,
    };

    /// Sets lane `l` to the factors of `material`; layers of absent effects stay away.
    pub fn set(&mut self, l: usize, material: &Material, effects: EffectSet) {
        // Set the coat
        let coat = material.coated().filter(|_| effects.has(Effect::Clearcoat));
        self.coat[l] = coat.map_or(0.0, |coat| coat.factor);
        self.coat_roughness[l] = coat.map_or(0.0, |coat| coat.roughness);
        // Set the sheen
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

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use glam::DVec3;

    use super::*;
    use crate::numeric::SplitMix64;
    use crate::scene::Clearcoat;
    use crate::shading::direct;

    /// Evaluates a coated white diffuse surface by `KHR_materials_clearcoat`: BRDF times cosine, over a base of
    /// Lambert's law.
    fn specified(coat: &Clearcoat, base: f64, [n, v, l]: [DVec3; 3]) -> f64 {
        // Evaluate the lobe of the coat
        let h = (v + l).normalize();
        let alpha = f64::from(coat.roughness).powi(2);
        let squared = alpha * alpha;
        let d = squared / (PI * (n.dot(h).powi(2) * (squared - 1.0) + 1.0).powi(2));
        let smith = |cos: f64| cos + (squared + (1.0 - squared) * cos * cos).sqrt();
        let lobe = d / (smith(n.dot(v)) * smith(n.dot(l)));
        // Blend by the reflectance towards the viewer
        let fresnel = 0.04 + 0.96 * (1.0 - n.dot(v)).powi(5);
        let weight = f64::from(coat.factor) * fresnel;
        base * (1.0 - weight) + lobe * n.dot(l) * weight
    }

    #[test]
    fn coated_surface_is_that_of_the_extension() {
        let mut random = SplitMix64::new(0, 11);
        let mut checked = 0;
        for _ in 0..10_000 {
            // Draw a coat and directions above the surface
            let coat = Clearcoat {
                factor: random.unit() as f32,
                roughness: random.within(0.1, 1.0) as f32,
            };
            let [n, v, l] = [0; 3].map(|_| random.direction().as_vec3().as_dvec3());
            if n.dot(v) < 0.02 || n.dot(l) < 0.02 {
                continue;
            }
            let lanes = |v: DVec3| v.to_array().map(|axis| [axis as f32; LANES]);
            // Fill the lanes of a packet
            let effects = EffectSet::NONE.with(Effect::Clearcoat);
            let mut base = MaterialPacket::of_effects(effects);
            let material = Material {
                clearcoat: Some(coat),
                ..Material::metallic_roughness([1.0; 3], 0.0, 1.0)
            };
            base.set(0, &material);
            let layers = base.layers.as_mut().unwrap();
            layers.coat_normal = lanes(n);
            let layers = layers.clone();
            // Sum the base and the coat by their weights
            let weight = f64::from(layers.coat_weights(&lanes(v))[0]);
            let reflected =
                |surface: &MaterialPacket| f64::from(direct(surface, &lanes(n), &lanes(v), &lanes(l))[0][0]);
            let below = reflected(&base);
            let found = below * (1.0 - weight) + reflected(&layers.coat_surface(&base)) * weight;
            let expected = specified(&coat, below, [n, v, l]);
            assert!(
                (found - expected).abs() <= 1e-4 * expected,
                "{coat:?}: {found}, not {expected}"
            );
            checked += 1;
        }
        assert!(checked > 2_000, "{checked}");
    }
}
