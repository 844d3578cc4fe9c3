//! Shading of layers above the bases of surfaces: a clear coat, and sheen below it.
//!
//! A layer is shaded as a surface of its own at the same points: with its own normals, with the part of the path
//! throughput that it reflects, and with shadow rays, mirror rays and lobe rays of its own.

use super::super::aov::LightSource;
use super::super::lighting::{LobeVariants, direct};
use super::super::profile::Category;
use super::super::surface::Surfaces;
use super::shading_state::ShadingState;
use super::traced_packet::{BatchInfo, TracedPacket};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Effect, EffectSet};
use crate::shading::LayerLanes;

impl ShadingState<'_, '_> {
    /// Shades the layers of the hits, and returns the path throughput that reaches the bases below them.
    #[inline(never)]
    pub(in crate::render) fn shade_layers(
        &mut self,
        effects: EffectSet,
        traced: &TracedPacket,
        surfaces: &Surfaces,
        stage: BatchInfo,
    ) -> Lanes3<f32> {
        let mut below = *traced.weight;
        let (Some(layers), Some(mut layer)) = (&surfaces.materials.layers, self.layer_surfaces.take()) else {
            return below;
        };
        // Shade the coats
        let coat = coat_weights(layers, surfaces);
        if coat.iter().any(|&weight| weight > 0.0) {
            let weight = scaled(&below, |l| coat[l]);
            below = scaled(&below, |l| 1.0 - coat[l]);
            layer.set_layer(
                surfaces,
                layers.coat_normal,
                layers.coat_surface(&surfaces.materials),
            );
            let traced = TracedPacket {
                weight: &weight,
                ..*traced
            };
            self.shade_coats(effects, &traced, &mut layer, stage);
        }
        // Shade the sheen
        if layers.has_sheen() {
            let cosines = surfaces.points.viewing_cosines();
            let is_hit = &surfaces.points.hit;
            let weight = scaled(&below, |l| if is_hit[l] { 1.0 } else { 0.0 });
            below = scaled(&below, |l| {
                if is_hit[l] {
                    layers.sheen.base_weight(cosines[l], l)
                } else {
                    1.0
                }
            });
            layer.set_layer(
                surfaces,
                surfaces.points.ns,
                layers.sheen_surface(&surfaces.materials),
            );
            let traced = TracedPacket {
                weight: &weight,
                ..*traced
            };
            self.shade_sheen(layers, &traced, &layer, stage);
        }
        self.layer_surfaces = Some(layer);
        below
    }

    /// Adds the light that coats reflect, and queues their rays.
    fn shade_coats(
        &mut self,
        effects: EffectSet,
        traced: &TracedPacket,
        coats: &mut Surfaces,
        stage: BatchInfo,
    ) {
        if effects.has(Effect::EnergyConservation) {
            direct::evaluate_lobe_albedo(coats);
        }
        if effects.has(Effect::Ambient) {
            let light = direct::AmbientTerms {
                ambient: self.frame.ambient,
                background: &[[0.0; LANES]; 3],
            };
            let radiance = direct::emitted_radiance(traced.packet, coats, traced.weight, &light);
            self.film.add(traced.pixel, &radiance, LightSource::Emission);
        }
        let variants = LobeVariants::default();
        let lit = direct::ShadingContext::of(traced, coats, &variants);
        self.sample_lights::<false>(traced, &lit, stage);
        self.meter.part(Category::Lighting);
        if effects.has(Effect::Reflection) {
            self.reflect::<false>(*traced, coats, stage);
        }
        if effects.has(Effect::RoughReflection) {
            self.reflect_roughly(traced, coats, stage);
            self.meter.part(Category::RoughReflection);
        }
    }

    /// Adds the light that the fibres of sheen reflect from lights, from the environment map, and from ambient light.
    fn shade_sheen(
        &mut self,
        layers: &LayerLanes,
        traced: &TracedPacket,
        fibres: &Surfaces,
        stage: BatchInfo,
    ) {
        // Add ambient light by the albedo
        let ambient = self.frame.ambient;
        if ambient != [0.0; 3] {
            let cosines = fibres.points.viewing_cosines();
            let mut radiance = [[0.0; LANES]; 3];
            for l in (0..LANES).filter(|&l| fibres.points.hit[l]) {
                let albedo = layers.sheen.albedo(cosines[l], l);
                for (channel, lanes) in radiance.iter_mut().enumerate() {
                    let reflected = ambient[channel] * layers.sheen.color[channel][l] * albedo;
                    lanes[l] = traced.weight[channel][l] * reflected;
                }
            }
            self.film.add(traced.pixel, &radiance, LightSource::Emission);
        }
        let variants = LobeVariants::default();
        let lit = direct::ShadingContext::of(traced, fibres, &variants);
        self.sample_lights::<false>(traced, &lit, stage);
        self.meter.part(Category::Lighting);
    }
}

/// Returns the fractions of light that the coats of the hits reflect. Light that leaves an interior crosses no coat.
fn coat_weights(layers: &LayerLanes, surfaces: &Surfaces) -> Lanes<f32> {
    let points = &surfaces.points;
    let weights = layers.coat_weights(&points.wo);
    std::array::from_fn(|l| {
        // Leave out lanes inside of a medium
        let is_inside = !points.front[l] && surfaces.materials.transmits(l);
        if points.hit[l] && !is_inside {
            weights[l]
        } else {
            0.0
        }
    })
}

/// Returns path throughputs scaled by one factor for each lane.
fn scaled(weight: &Lanes3<f32>, factor: impl Fn(usize) -> f32) -> Lanes3<f32> {
    let factors: Lanes<f32> = std::array::from_fn(factor);
    weight.map(|channel| std::array::from_fn(|l| channel[l] * factors[l]))
}
