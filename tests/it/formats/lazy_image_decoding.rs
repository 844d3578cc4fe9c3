//! Tests of lazy image decoding: images that nothing uses are not decoded, so that faults in their pixels are not
//! reported. Faults of used images are reported, and so are wrong names and types.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::cli_program::{fails_with, whit};
use whit::gltf::{self, LoadOptions};
use whit::render::Plan;
use whit::scene::{BuiltInEnvironment, Effect, EffectOverrides, EffectSet, Scene, Texels};
use whit::scene_file;

/// Creates a folder with the first bytes of a PNG and of an HDR file, without their pixels.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in [("globe.png", 100), ("sky.hdr", 90)] {
        let source = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("scenes/textures")
            .join(name);
        let whole = fs::read(source).unwrap();
        fs::write(folder.path().join(format!("torn_{name}")), &whole[..bytes]).unwrap();
    }
    folder
}

fn without(effects: &[Effect]) -> LoadOptions {
    LoadOptions {
        without: effects.iter().copied().collect(),
        ..LoadOptions::default()
    }
}

/// Writes a scene file with a sphere of `material` and the lines `more`.
fn scene_file(folder: &Path, material: &str, more: &str) -> PathBuf {
    let path = folder.join("scene.toml");
    let text = format!(
        "{more}\n[texture.torn]\nimage = 'torn_globe.png'\n[material.ball]\n{material}\n\
         [[object]]\nshape = 'sphere'\nmaterial = 'ball'\n"
    );
    fs::write(&path, text).unwrap();
    path
}

fn load(path: &Path, options: &LoadOptions) -> Result<Scene, String> {
    match path.extension().is_some_and(|e| e == "toml") {
        true => scene_file::load(path, options)
            .map(|loaded| loaded.scene)
            .map_err(|e| e.to_string()),
        false => gltf::load(path, options).map_err(|e| e.to_string()),
    }
}

fn is_refused(path: &Path, options: &LoadOptions) {
    let message = load(path, options).expect_err("the image is looked at");
    assert!(message.contains("torn_"), "{message}");
}

/// Returns the scene, whose only image must not have been decoded.
fn unread(path: &Path, options: &LoadOptions) -> Scene {
    let scene = load(path, options).unwrap_or_else(|message| panic!("{message}"));
    // The default light of a glTF file may have a map of its own
    let studio = BuiltInEnvironment::Studio.name();
    let mut of_file = scene.images.iter().filter(|image| image.name != studio);
    assert!(of_file.all(|image| image.texels == Texels::Unread));
    scene
}

#[test]
fn images_of_absent_effects_are_not_decoded() {
    let folder = folder();
    let base = scene_file(folder.path(), "base_color = { texture = 'torn' }", "");
    is_refused(&base, &LoadOptions::default());
    is_refused(&base, &without(&[Effect::NormalMap]));
    let scene = unread(&base, &without(&[Effect::Texture]));
    assert_eq!((scene.images[0].width, scene.images[0].height), (256, 128));
    // The plan still includes the effects that the scene requires.
    let overrides = EffectOverrides {
        added: EffectSet::NONE,
        removed: EffectSet::NONE.with(Effect::Texture),
    };
    let plan = Plan::new(&scene, &scene.cameras[0], &overrides);
    let decision = &plan.decisions[Effect::Texture as usize];
    assert!(
        decision.overridden && decision.reason.contains("BaseColor"),
        "{decision}"
    );
    let bump = scene_file(folder.path(), "bump = { texture = 'torn', strength = 0.1 }", "");
    is_refused(&bump, &without(&[Effect::Texture]));
    unread(&bump, &without(&[Effect::NormalMap]));
}

#[test]
fn images_without_factor_or_object_are_not_decoded() {
    let folder = folder();
    for material in [
        "emission = { texture = 'torn', value = 0 }",
        "bump = { texture = 'torn', strength = 0 }",
        "base_color = { texture = 'torn', value = [0, 0, 0] }",
        "metallic = { texture = 'torn', value = 0 }",
        "model = 'lecture'\nreflection = { texture = 'torn', value = 0 }",
        "roughness = 1",
        "roughness = 1\n[material.nowhere]\nbase_color = { texture = 'torn' }",
    ] {
        let path = scene_file(folder.path(), material, "");
        let scene = unread(&path, &LoadOptions::default());
        assert_eq!(scene.images.len(), 1, "{material}");
    }
}

#[test]
fn unused_environment_is_not_decoded() {
    let folder = folder();
    let more = "background = { environment = 'torn_sky.hdr' }";
    let path = scene_file(folder.path(), "roughness = 1", more);
    is_refused(&path, &without(&[Effect::Environment]));
    is_refused(&path, &without(&[Effect::Background]));
    unread(&path, &without(&[Effect::Environment, Effect::Background]));
}

#[test]
fn names_and_kinds_are_always_checked() {
    let folder = folder();
    let path = scene_file(folder.path(), "roughness = 1", "");
    fs::write(folder.path().join("torn_globe.png"), "not an image").unwrap();
    is_refused(&path, &LoadOptions::default());
    fs::remove_file(folder.path().join("torn_globe.png")).unwrap();
    is_refused(&path, &LoadOptions::default());
}

/// Writes a glTF triangle whose material has `members`, with texture 0 of the truncated image.
fn gltf_file(folder: &Path, members: &str) -> PathBuf {
    let floats: [f32; 15] = [
        0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, // positions
        0.0, 0.0, 1.0, 0.0, 0.0, 1.0, // texture coordinates
    ];
    let bytes: Vec<u8> = floats.iter().flat_map(|x| x.to_le_bytes()).collect();
    fs::write(folder.join("triangle.bin"), bytes).unwrap();
    let text = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "TEXCOORD_0": 1}}, "material": 0}}]}}],
        "buffers": [{{"uri": "triangle.bin", "byteLength": 60}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 36}}, {{"buffer": 0, "byteOffset": 36, "byteLength": 24}}],
        "accessors": [
          {{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}},
          {{"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"}}],
        "images": [{{"uri": "torn_globe.png"}}], "textures": [{{"source": 0}}],
        "materials": [{{{members}}}]}}"#
    );
    let path = folder.join("scene.gltf");
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn gltf_images_are_skipped_for_the_same_reasons() {
    let folder = folder();
    let normal = |scale: u32| format!(r#""normalTexture": {{"index": 0, "scale": {scale}}}"#);
    let path = gltf_file(folder.path(), &normal(1));
    is_refused(&path, &LoadOptions::default());
    is_refused(&path, &without(&[Effect::Texture]));
    unread(&path, &without(&[Effect::NormalMap]));
    let nothing = [
        normal(0),
        r#""emissiveTexture": {"index": 0}"#.into(),
        r#""pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [0, 0, 0, 1]}"#.into(),
        r#""pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 0}"#
            .into(),
    ];
    for members in nothing {
        unread(&gltf_file(folder.path(), &members), &LoadOptions::default());
    }
    let faded = r#""alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [0, 0, 0, 1]}"#;
    is_refused(&gltf_file(folder.path(), faded), &LoadOptions::default());
}

#[test]
fn render_without_textures_does_not_need_images() {
    let folder = folder();
    let scene = scene_file(folder.path(), "base_color = { texture = 'torn' }", "ambient = 1");
    let scene = scene.display().to_string();
    let image = folder.path().join("a.png").display().to_string();
    let flags = ["render", &scene, "-o", &image, "--size", "8x8"];
    fails_with(2, "torn_globe.png", &flags);
    let run = whit(&[&flags[..], &["--effects=-texture"]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stderr.contains("texture off: switched off"), "{}", run.stderr);
    let info = whit(&["info", &scene, "--effects=-texture"]);
    assert_eq!(info.code, 0, "{}", info.stderr);
}
