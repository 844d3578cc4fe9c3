//! Why each kind of secondary ray is traced or not, as the scene tells it.

use crate::optics::LINE_D;
use crate::scene::{AlphaMode, MIRROR_ROUGHNESS, Model, Scene};

/// Why shadow rays are asked, or why none are.
pub fn shadow_reason(scene: &Scene) -> String {
    match scene.lights.len() {
        0 => "no lights".into(),
        1 => "1 light".into(),
        n => format!("{n} lights"),
    }
}

/// Why reflected rays are followed, or why none are.
pub fn reflection_reason(scene: &Scene) -> String {
    let mut mirrors = scene.materials.iter().filter(|material| material.may_mirror());
    let Some(first) = mirrors.next() else {
        return format!("no material has a roughness of {MIRROR_ROUGHNESS} or less");
    };
    let reason = match first.model {
        Model::MetallicRoughness(model) if model.roughness <= MIRROR_ROUGHNESS => {
            format!("material `{}` has roughness {}", first.name, model.roughness)
        }
        Model::Lecture(lecture) if lecture.reflection != [0.0; 3] => {
            format!("material `{}` reflects", first.name)
        }
        _ => format!("material `{}` has a roughness texture", first.name),
    };
    match mirrors.count() {
        0 => reason,
        more => format!("{reason}, and {more} more may be as smooth"),
    }
}

/// Why rays are followed through surfaces, or why none are.
pub fn refraction_reason(scene: &Scene) -> String {
    let transparent = scene.materials.iter().find(|material| material.transmits());
    let covering = scene.materials.iter().find(|m| m.alpha != AlphaMode::Opaque);
    match (transparent, covering) {
        (Some(material), _) => {
            let ior = material.ior(LINE_D);
            format!(
                "material `{}` lets light through, index of refraction {ior:.3}",
                material.name
            )
        }
        (None, Some(material)) => format!("material `{}` is only partly there", material.name),
        (None, None) => "no material lets light through".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Material;

    #[test]
    fn reasons_name_the_lights_and_mirrors_of_the_scene() {
        let mut scene = Scene::default();
        assert_eq!(shadow_reason(&scene), "no lights");
        assert_eq!(
            reflection_reason(&scene),
            "no material has a roughness of 0.1 or less"
        );
        let smooth = |name: &str, roughness| Material {
            name: name.into(),
            ..Material::metallic_roughness([1.0; 3], 1.0, roughness)
        };
        scene.materials = vec![Material::default(), smooth("chrome", 0.05)];
        assert_eq!(reflection_reason(&scene), "material `chrome` has roughness 0.05");
        scene.materials.push(smooth("glass", 0.0));
        assert_eq!(
            reflection_reason(&scene),
            "material `chrome` has roughness 0.05, and 1 more may be as smooth"
        );
    }
}
