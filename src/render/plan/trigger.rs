//! Triggers of effects: one entry for every way in which a scene may need an effect.
//!
//! A trigger must fire wherever the effect could change a bit of the image; not firing elsewhere saves time.
//! `tests/it/scenes/effect_plan.rs` removes the triggers one by one and checks that an image changes each time.

use super::super::caustics::emits_photons;
use super::Facts;
use crate::optics::{Absorption, LINE_D};
use crate::scene::{
    AlphaMode, AreaShape, Background, Effect, Filter, Light, LightKind, MIRROR_ROUGHNESS, Material,
    MaterialInput, MetallicRoughness, Model, Phong, Texture,
};

/// Condition on a scene that needs an effect.
pub struct Trigger {
    /// Effect that the trigger switches on.
    pub effect: Effect,
    /// Name of the condition, for tests.
    pub name: &'static str,
    /// Function that returns the reason if the scene fulfils the condition.
    pub fires: fn(&Facts) -> Option<String>,
}

/// List of all triggers. An effect is on if one of its triggers fires.
pub const TRIGGERS: &[Trigger] = &[
    // Shadows
    trigger(Effect::Shadow, "a light that may be hidden", shadow),
    trigger(Effect::Shadow, "light from all directions", |facts| {
        environment(facts).map(|_| "the environment map may be hidden".into())
    }),
    trigger(Effect::TransparentShadow, "transmission", |facts| {
        any_casting(facts)?;
        facts.material(Material::transmits, |_| "transmits light".into())
    }),
    trigger(Effect::TransparentShadow, "partial coverage", |facts| {
        any_casting(facts)?;
        facts.material(
            |m| m.alpha != AlphaMode::Opaque,
            |_| "is partly transparent".into(),
        )
    }),
    // Reflection and refraction
    trigger(Effect::Reflection, "smooth", |facts| {
        facts.material(is_smooth, |m| match m.model {
            Model::MetallicRoughness(model) => format!("has roughness {}", model.roughness),
            _ => String::new(),
        })
    }),
    trigger(Effect::Reflection, "roughness texture", |facts| {
        facts.material(may_be_smooth, |_| "has a roughness texture".into())
    }),
    trigger(Effect::Reflection, "kr", |facts| {
        facts.material(
            |m| phong_of(m).is_some_and(|l| l.reflection != [0.0; 3]),
            |_| "reflects".into(),
        )
    }),
    trigger(Effect::Reflection, "total reflection", |facts| {
        facts.material(
            |m| m.transmits() && phong_of(m).is_some(),
            |_| "has total internal reflection".into(),
        )
    }),
    trigger(Effect::Refraction, "transmission", |facts| {
        facts.material(Material::transmits, |m| {
            format!("transmits light, index of refraction {:.3}", m.ior(LINE_D))
        })
    }),
    trigger(Effect::NestedMedia, "several media", nested),
    trigger(Effect::Dispersion, "index by wavelength", |facts| {
        facts.material(disperses, |m| {
            let spread = m.interior.map_or(0.0, |inside| inside.ior.spread());
            format!("refracts blue light more than red, index differs by {spread:.4}")
        })
    }),
    trigger(Effect::Absorption, "absorption", |facts| {
        facts.material(absorbs, |_| "absorbs light".into())
    }),
    // Textures and vertex attributes
    trigger(Effect::Texture, "a texture", |facts| {
        facts.layer(
            |layer| layer.effect() == Effect::Texture,
            |layer| format!("has a texture on {:?}", layer.parameter),
        )
    }),
    trigger(Effect::TextureFilter, "mip maps", |facts| {
        let scene = facts.scene;
        let is_mipmap = |texture: u32| matches!(&scene.textures[texture as usize], Texture::Image { sampler, .. } if sampler.filter == Filter::Mipmap);
        facts.layer(
            |layer| is_mipmap(layer.texture.texture),
            |_| "uses mip maps".into(),
        )
    }),
    trigger(Effect::TextureFilter, "a pattern", |facts| {
        let scene = facts.scene;
        let is_rule = |texture: u32| matches!(&scene.textures[texture as usize], Texture::Procedural(_));
        facts.layer(|layer| is_rule(layer.texture.texture), |_| "has a pattern".into())
    }),
    trigger(Effect::NormalMap, "normal map", |facts| {
        facts.layer(
            |layer| layer.parameter == MaterialInput::Normal,
            |_| "has a normal map".into(),
        )
    }),
    trigger(Effect::NormalMap, "bump map", |facts| {
        facts.layer(
            |layer| layer.parameter == MaterialInput::Bump,
            |_| "has a bump map".into(),
        )
    }),
    trigger(Effect::VertexColor, "colours", |facts| {
        if let Some((_, material)) = facts.meshes.iter().find(|(mesh, _)| mesh.colors.is_some()) {
            return Some(format!("a mesh of material `{material}` has vertex colours"));
        }
        let (_, material) = facts.clouds.iter().find(|(cloud, _)| cloud.colors.is_some())?;
        Some(format!(
            "a point cloud of material `{material}` has vertex colours"
        ))
    }),
    trigger(Effect::AlphaTest, "mask", |facts| {
        facts.material(
            |m| matches!(m.alpha, AlphaMode::Mask(_)),
            |_| "has an alpha mask".into(),
        )
    }),
    trigger(Effect::AlphaBlend, "blend", |facts| {
        facts.material(|m| m.alpha == AlphaMode::Blend, |_| "is alpha-blended".into())
    }),
    trigger(Effect::SmoothNormals, "normals", |facts| {
        let (_, material) = facts.meshes.iter().find(|(mesh, _)| mesh.normals.is_some())?;
        Some(format!("a mesh of material `{material}` has vertex normals"))
    }),
    // Material models
    trigger(Effect::Phong, "Phong model", |facts| {
        facts.material(|m| phong_of(m).is_some(), |_| "uses the Phong model".into())
    }),
    trigger(Effect::Phong, "unlit", |facts| {
        facts.material(|m| m.model == Model::Unlit, |_| "is unlit".into())
    }),
    trigger(Effect::Specular, "strength or colour", |facts| {
        let differs = |model: &MetallicRoughness| model.specular != 1.0 || model.specular_color != [1.0; 3];
        facts.material(
            |m| matches!(&m.model, Model::MetallicRoughness(model) if differs(model)),
            |_| "has a specular strength or colour".into(),
        )
    }),
    trigger(Effect::Specular, "index of refraction", |facts| {
        facts.material(
            |m| m.interior.is_some() && matches!(m.model, Model::MetallicRoughness(_)),
            |m| format!("has index of refraction {:.3}", m.ior(LINE_D)),
        )
    }),
    trigger(Effect::Specular, "texture", |facts| {
        let on = [MaterialInput::Specular, MaterialInput::SpecularColor];
        facts.layer(
            |layer| on.contains(&layer.parameter),
            |_| "has a specular texture".into(),
        )
    }),
    trigger(Effect::Occlusion, "occlusion map", |facts| {
        facts.layer(
            |layer| layer.parameter == MaterialInput::Occlusion && facts.scene.ambient != [0.0; 3],
            |_| "has an occlusion map".into(),
        )
    }),
    // Emission, background, volumes and lights
    trigger(Effect::Emission, "emission", |facts| {
        facts.material(|m| m.emission != [0.0; 3], |_| "emits light".into())
    }),
    trigger(Effect::Emission, "unlit", |facts| {
        facts.material(
            |m| m.model == Model::Unlit,
            |_| "emits light because it is unlit".into(),
        )
    }),
    trigger(Effect::Ambient, "ambient light", |facts| {
        let [r, g, b] = facts.scene.ambient;
        (facts.scene.ambient != [0.0; 3]).then(|| format!("ambient light {r}, {g}, {b}"))
    }),
    trigger(Effect::Background, "background", |facts| {
        (facts.scene.background != Background::default()).then(|| match facts.scene.background {
            Background::Uniform([r, g, b]) => format!("background {r}, {g}, {b}"),
            Background::Gradient { .. } => "the background is a gradient".into(),
            Background::Environment { .. } => "the background is an environment map".into(),
        })
    }),
    trigger(Effect::Volume, "a volume", |facts| {
        let mut filled = facts.scene.volumes.iter().filter(|volume| !volume.is_clear());
        let first = filled.next()?;
        Some(match filled.count() {
            0 => format!("volume `{}` is not empty", first.name()),
            more => format!("volume `{}` is not empty, nor are {more} more", first.name()),
        })
    }),
    trigger(Effect::Volume, "fog", |facts| {
        let fog = facts.scene.fog.filter(|_| facts.scene.has_fog())?;
        Some(format!("fog of extinction {}", fog.extinction()))
    }),
    trigger(Effect::DepthOfField, "a lens", |facts| {
        let radius = facts.camera.lens_radius();
        (radius > 0.0).then(|| format!("the camera's lens has a radius of {radius}"))
    }),
    trigger(Effect::AreaLight, "a light with an extent", |facts| {
        let light = soft_light(facts, |shape| !matches!(shape, AreaShape::Object { .. }))?;
        Some(format!("light `{}` has an extent", light.name))
    }),
    trigger(Effect::AreaLight, "an emissive object", |facts| {
        let light = soft_light(facts, |shape| matches!(shape, AreaShape::Object { .. }))?;
        Some(format!("object `{}` is an area light", light.name))
    }),
    trigger(Effect::Environment, "an environment map", environment),
    // Rough surfaces, motion and subsurface scattering
    trigger(Effect::RoughReflection, "rough rays", |facts| {
        // A texture may leave parts of the surface opaque.
        let is_opaque = |m: &Material| !m.transmits() || m.layer(MaterialInput::Transmission).is_some();
        let is_seen = |m: &Material| is_opaque(m) || has_rough_coat(m);
        facts.material(|m| is_seen(m) && m.rough_rays() > 0, |m| blurs(m, facts))
    }),
    trigger(Effect::RoughRefraction, "rough rays", |facts| {
        facts.material(|m| m.transmits() && m.rough_rays() > 0, |m| blurs(m, facts))
    }),
    trigger(Effect::MotionBlur, "an instance moves", |facts| {
        let mut moving = facts
            .scene
            .instances
            .iter()
            .filter(|instance| instance.is_moving());
        let first = moving.next()?;
        Some(match moving.count() {
            0 => format!("`{}` moves", first.name),
            more => format!("`{}` moves, and {more} more objects", first.name),
        })
    }),
    trigger(Effect::MotionBlur, "the camera moves", |facts| {
        let camera = facts.camera;
        camera.motion().map(|_| format!("camera `{}` moves", camera.name))
    }),
    trigger(Effect::Subsurface, "subsurface scattering", |facts| {
        facts.material(|m| m.scatters().is_some(), |_| "has subsurface scattering".into())
    }),
    trigger(Effect::Translucency, "translucency", |facts| {
        facts.material(
            |m| m.translucent().is_some(),
            |m| {
                let factor = m.translucent().map_or(0.0, |layer| layer.factor);
                format!("transmits {factor} of its diffuse light")
            },
        )
    }),
    trigger(Effect::EnergyConservation, "a rough lobe", |facts| {
        facts.material(
            |m| is_rough(m) && has_lobe_or_layer(m),
            |_| "has a rough lobe".into(),
        )
    }),
    trigger(Effect::EnergyConservation, "diffuse light", |facts| {
        facts.material(
            |m| is_diffuse(m) && has_lobe_or_layer(m),
            |_| "is diffuse under a reflection".into(),
        )
    }),
    // Layers and lobes of glTF's extensions
    trigger(Effect::Clearcoat, "clear coat", |facts| {
        facts.material(|m| m.coated().is_some(), |_| "has a clear coat".into())
    }),
    trigger(Effect::Sheen, "sheen", |facts| {
        facts.material(|m| m.sheening().is_some(), |_| "has sheen".into())
    }),
    trigger(Effect::Anisotropy, "anisotropy", |facts| {
        facts.material(
            |m| m.anisotropic().is_some(),
            |_| "has an anisotropic lobe".into(),
        )
    }),
    trigger(Effect::Iridescence, "iridescence", |facts| {
        facts.material(|m| m.iridescent().is_some(), |_| "has a thin film".into())
    }),
    // Light of requested effects
    trigger(Effect::Interreflection, "diffuse surfaces", |facts| {
        let requested = facts.scene.interreflection?;
        let reason = |_: &Material| {
            format!(
                "is diffuse, and up to {} bounces are requested",
                requested.bounces
            )
        };
        facts.material(is_matte, reason)
    }),
    trigger(Effect::Caustics, "mirrors and refraction", |facts| {
        let requested = facts.scene.caustics?;
        facts.material(is_matte, |_| String::new())?;
        facts.scene.lights.iter().find(|light| emits_photons(light))?;
        let reason = |_: &Material| {
            format!(
                "reflects or refracts sharply, and {} photons are requested",
                requested.photons
            )
        };
        facts.material(Material::is_sharp, reason)
    }),
];

/// Returns the reason why an effect is off without any active trigger.
pub(super) fn absence(effect: Effect, facts: &Facts) -> String {
    match effect {
        Effect::Shadow => match &facts.lights[..] {
            [] => "there are no lights".into(),
            [light, ..] => format!("no light may be hidden: {}", light.reason),
        },
        Effect::TransparentShadow => "nothing that transmits light is in front of a light".into(),
        Effect::Reflection => format!("no material has a roughness of {MIRROR_ROUGHNESS} or less"),
        Effect::Refraction => "no material transmits light".into(),
        Effect::NestedMedia => "no two materials are transparent media".into(),
        Effect::Dispersion => "no index of refraction varies with the wavelength".into(),
        Effect::Absorption => "no medium absorbs light".into(),
        Effect::Texture => "no parameter varies".into(),
        Effect::TextureFilter => "no texture is averaged".into(),
        Effect::NormalMap => "there are no normal or bump maps".into(),
        Effect::VertexColor => "no mesh and no point cloud has vertex colours".into(),
        Effect::AlphaTest => "no material is masked".into(),
        Effect::AlphaBlend => "no material is blended".into(),
        Effect::SmoothNormals => "no mesh has vertex normals".into(),
        Effect::Phong => "all materials are glTF's".into(),
        Effect::Specular => "all dielectrics reflect as glTF's default".into(),
        Effect::Occlusion => "there are no occlusion maps".into(),
        Effect::Emission => "nothing emits light".into(),
        Effect::Ambient => "there is no ambient light".into(),
        Effect::Background => "the background is black".into(),
        Effect::Volume => "there is no fog, and no volume with anything in it".into(),
        Effect::DepthOfField => "the camera is a pinhole".into(),
        Effect::AreaLight => "no active light has an extent, and no object is an area light".into(),
        Effect::Environment => "there is no environment map".into(),
        Effect::RoughReflection => "no rough opaque material requests rays".into(),
        Effect::RoughRefraction => "no rough transmissive material requests rays".into(),
        Effect::MotionBlur => "nothing moves".into(),
        Effect::Subsurface => "no material has subsurface scattering".into(),
        Effect::Translucency => "no material transmits diffuse light".into(),
        Effect::EnergyConservation => {
            "no material of glTF's model is rough, or diffuse under a reflection".into()
        }
        Effect::Clearcoat => "no material has a clear coat".into(),
        Effect::Sheen => "no material has sheen".into(),
        Effect::Anisotropy => "no lobe is anisotropic".into(),
        Effect::Iridescence => "no material has a thin film".into(),
        Effect::Interreflection if facts.scene.interreflection.is_none() => "it is not requested".into(),
        Effect::Interreflection => "no material is diffuse".into(),
        Effect::Caustics if facts.scene.caustics.is_none() => "they are not requested".into(),
        Effect::Caustics => {
            "nothing that reflects or refracts sharply is lit by a light that emits photons".into()
        }
    }
}

const fn trigger(effect: Effect, name: &'static str, fires: fn(&Facts) -> Option<String>) -> Trigger {
    Trigger { effect, name, fires }
}

fn shadow(facts: &Facts) -> Option<String> {
    let light = casting(facts)?;
    let of = facts.lights.len();
    let casting = facts.lights.iter().filter(|reach| reach.casts).count();
    let (name, reach) = (&facts.scene.lights[light].name, &facts.lights[light].reason);
    Some(format!(
        "{casting} of {of} lights may be hidden; light `{name}`: {reach}"
    ))
}

/// Returns the first emitting area light whose shape fulfils `is_such`.
fn soft_light<'s>(facts: &Facts<'s>, is_such: fn(&AreaShape) -> bool) -> Option<&'s Light> {
    let emits = |light: &&Light| light.intensity != [0.0; 3];
    let mut lights = facts.scene.lights.iter().filter(emits);
    lights.find(|light| matches!(&light.kind, LightKind::Area { shape, .. } if is_such(shape)))
}

/// Returns a reason naming the environment map, if one lights the scene.
fn environment(facts: &Facts) -> Option<String> {
    match facts.scene.background {
        Background::Environment {
            image,
            scale,
            samples,
            ..
        } if scale > 0.0 && samples > 0 => {
            let name = &facts.scene.images[image as usize].name;
            Some(format!("`{name}` lights the scene from all directions"))
        }
        _ => None,
    }
}

/// Returns `Some` if any light may be occluded.
fn any_casting(facts: &Facts) -> Option<()> {
    let by_light = casting(facts).map(|_| ());
    by_light.or_else(|| environment(facts).map(|_| ()))
}

/// Returns the index of the first light that may be occluded.
fn casting(facts: &Facts) -> Option<usize> {
    facts.lights.iter().position(|reach| reach.casts)
}

fn nested(facts: &Facts) -> Option<String> {
    let has_inside = |m: &&&Material| m.transmits() && m.interior.is_some_and(|inside| !inside.is_thin());
    let bodies: Vec<&&Material> = facts.materials.iter().filter(has_inside).collect();
    let [first, second, ..] = &bodies[..] else {
        return None;
    };
    Some(format!(
        "{} media may be nested, `{}` and `{}` among them",
        bodies.len(),
        first.name,
        second.name
    ))
}

fn phong_of(material: &Material) -> Option<&Phong> {
    match &material.model {
        Model::Phong(phong) => Some(phong),
        _ => None,
    }
}

/// Returns whether the material is glTF's and mirrors everywhere.
fn is_smooth(material: &Material) -> bool {
    let has_smooth_coat = material
        .coated()
        .is_some_and(|coat| coat.roughness <= MIRROR_ROUGHNESS);
    let is_smooth =
        matches!(&material.model, Model::MetallicRoughness(model) if model.roughness <= MIRROR_ROUGHNESS);
    is_smooth || has_smooth_coat
}

/// Returns whether a texture may make parts of the material mirror.
fn may_be_smooth(material: &Material) -> bool {
    material.may_mirror() && !is_smooth(material) && matches!(material.model, Model::MetallicRoughness(_))
}

/// Returns whether the material is glTF's and rough.
fn is_rough(material: &Material) -> bool {
    let is_rough = matches!(&material.model, Model::MetallicRoughness(model) if model.roughness > 0.0);
    // Anisotropy widens even a lobe of roughness 0
    is_rough || material.anisotropic().is_some() || has_rough_coat(material)
}

/// Returns whether the material is glTF's and reflects light by a lobe or a layer. A texture multiplies the factors, so it
/// cannot add a lobe.
fn has_lobe_or_layer(material: &Material) -> bool {
    let Model::MetallicRoughness(model) = &material.model else {
        return false;
    };
    let has_lobe = model.metallic > 0.0 || model.specular > 0.0 || material.iridescent().is_some();
    has_lobe || material.coated().is_some() || material.sheening().is_some()
}

/// Returns whether the material has a coat with a lobe, which is opaque over any base.
fn has_rough_coat(material: &Material) -> bool {
    material.coated().is_some_and(|coat| coat.roughness > 0.0)
}

/// Returns whether the material is glTF's and reflects diffuse light. A texture multiplies the factors, so it can only
/// make a surface less metallic and less transmissive.
fn is_diffuse(material: &Material) -> bool {
    let Model::MetallicRoughness(model) = &material.model else {
        return false;
    };
    let has = |inputs: &[MaterialInput]| inputs.iter().any(|&input| material.layer(input).is_some());
    let is_metal =
        model.metallic == 1.0 && !has(&[MaterialInput::Metallic, MaterialInput::MetallicRoughness]);
    let is_clear = model.transmission == 1.0 && !has(&[MaterialInput::Transmission]);
    !is_metal && !is_clear
}

/// Returns whether the material reflects or transmits diffuse light.
fn is_matte(material: &Material) -> bool {
    is_diffuse(material) || phong_of(material).is_some_and(|phong| phong.diffuse != [0.0; 3])
}

/// Returns the reason for rough rays: roughness and number of rays of a material. With an environment map one ray is the
/// default.
fn blurs(material: &Material, facts: &Facts) -> String {
    match (&material.model, material.rough_rays()) {
        (Model::MetallicRoughness(model), 1) if environment(facts).is_some() => format!(
            "has roughness {} and sends a ray, as an environment map lights it",
            model.roughness
        ),
        (Model::MetallicRoughness(model), 1) => format!("has roughness {} and sends a ray", model.roughness),
        (Model::MetallicRoughness(model), rays) => {
            format!("has roughness {} and sends {rays} rays", model.roughness)
        }
        _ => String::new(),
    }
}

fn disperses(material: &Material) -> bool {
    let varies = |inside: &crate::scene::Medium| inside.ior.spread() != 0.0 && !inside.is_thin();
    material.transmits() && material.interior.as_ref().is_some_and(varies)
}

fn absorbs(material: &Material) -> bool {
    let has_absorption =
        |inside: &crate::scene::Medium| inside.absorption != Absorption::NONE && !inside.is_thin();
    material.transmits() && material.interior.as_ref().is_some_and(has_absorption)
}
