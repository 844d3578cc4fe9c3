//! Why each kind of secondary ray is traced or not, as the scene tells it.

use crate::scene::{Material, Scene};
use crate::shading::MIRROR_ROUGHNESS;

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
    let mirrors: Vec<&str> = scene
        .materials
        .iter()
        .filter(|material| may_mirror(material))
        .map(|material| material.name.as_str())
        .collect();
    match mirrors[..] {
        [] => format!("no material's roughness is {MIRROR_ROUGHNESS} or less"),
        [name] => format!("material `{name}` {MAY_MIRROR}"),
        [name, ..] => format!(
            "{} materials, `{name}` the first: each {MAY_MIRROR}",
            mirrors.len()
        ),
    }
}

/// What the mirrors of a scene have in common.
const MAY_MIRROR: &str = "may be smooth enough for a mirror";

/// As the renderer decides; a texture multiplies the factor, so it can only make a surface smoother.
fn may_mirror(material: &Material) -> bool {
    material.roughness <= MIRROR_ROUGHNESS || material.metallic_roughness_texture.is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_name_the_lights_and_mirrors_of_the_scene() {
        let mut scene = Scene::default();
        assert_eq!(shadow_reason(&scene), "no lights");
        assert!(reflection_reason(&scene).starts_with("no material's roughness is "));
        let mirror = |name: &str| Material {
            name: name.into(),
            roughness: 0.0,
            ..Material::default()
        };
        scene.materials = vec![Material::default(), mirror("chrome")];
        assert_eq!(
            reflection_reason(&scene),
            "material `chrome` may be smooth enough for a mirror"
        );
        scene.materials.push(mirror("glass"));
        assert_eq!(
            reflection_reason(&scene),
            "2 materials, `chrome` the first: each may be smooth enough for a mirror"
        );
    }
}
