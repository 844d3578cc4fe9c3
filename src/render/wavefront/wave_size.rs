//! Number of camera packets in a wave.

use crate::scene::{Effect, EffectSet, Material, Scene};

/// Number of camera packets whose complete ray trees are traced before the next begin, which bounds the queues for
/// any number of samples. The number is smaller where lobes send many rays.
pub(in crate::render) const WAVE: usize = 64;
/// Greatest number, of scenes whose surfaces light each other: so many that the later generations of paths, most of which
/// have ended, fill their packets.
pub(in crate::render) const MAX_WAVE: usize = 4 * WAVE;

/// Returns the number of camera packets per wave: so few that their lobe rays are no more than the mirror rays of a
/// wave without lobes, but at least one.
pub(in crate::render) fn camera_packets(scene: &Scene, effects: EffectSet) -> usize {
    let wave = match effects.has(Effect::Interreflection) {
        true => MAX_WAVE,
        false => WAVE,
    };
    if !effects.has_lobes() {
        return wave;
    }
    // Materials that no instance uses do not count.
    let used = scene
        .instances
        .iter()
        .map(|instance| &scene.materials[instance.material as usize]);
    // A rough coat sends as many rays as the base below it
    let rays = |material: &Material| {
        let lobes = if material.coated().is_some() { 2 } else { 1 };
        lobes * material.rough_rays()
    };
    let max_rays = used.map(rays).max();
    (wave / max_rays.unwrap_or(0).max(1) as usize).max(1)
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::scene::{Geometry, Instance};
    use crate::shape::Shape;

    #[test]
    fn wave_size_is_divided_by_rays_per_lobe() {
        let effects = EffectSet::NONE.with(Effect::RoughReflection);
        let of = |rays: u32| {
            let mut material = Material::metallic_roughness([1.0; 3], 1.0, 0.5);
            if let crate::scene::Model::MetallicRoughness(model) = &mut material.model {
                model.rough_rays = rays;
            }
            Scene {
                geometries: vec![Geometry::Shape(Shape::Plane)],
                materials: vec![material],
                instances: vec![Instance::new("plane", 0, 0, DAffine3::IDENTITY).unwrap()],
                ..Scene::default()
            }
        };
        assert_eq!(camera_packets(&of(8), EffectSet::NONE), WAVE);
        for (rays, packets) in [(0, WAVE), (1, WAVE), (8, WAVE / 8), (200, 1)] {
            assert_eq!(camera_packets(&of(rays), effects), packets);
        }
    }
}
