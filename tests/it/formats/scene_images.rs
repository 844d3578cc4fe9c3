//! Tests of images in scene files: meaning of texels for each parameter, radiance above 1, and files that cannot be
//! used.

use crate::support::images;
use std::fs;
use std::path::{Path, PathBuf};

use crate::support::cli_program::whit;
use image::{ExtendedColorType, ImageFormat};
use tempfile::TempDir;
use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::LoadOptions;
use whit::render::RenderSettings;
use whit::scene::{MaterialInput, Scene, Texels, Texture};
use whit::scene_file;

/// Temporary folder with 2 x 2 images of one colour.
struct Folder(TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a 16-bit PNG in which all codes but the last are equal, so that it is not an image of one colour.
    fn wide_png(&self, name: &str, code: u16) {
        let mut codes = [code; 12];
        codes[11] = code / 2;
        let bytes = bytemuck::cast_slice(&codes);
        image::save_buffer_with_format(
            self.path(name),
            bytes,
            2,
            2,
            ExtendedColorType::Rgb16,
            ImageFormat::Png,
        )
        .unwrap();
    }

    fn exr(&self, name: &str, color: [f32; 3]) {
        use exr::prelude::{Image, SpecificChannels, WritableImage};
        let [r, g, b] = color;
        let channels = SpecificChannels::rgb(move |_| (r, g, b));
        let image = Image::from_channels((2, 2), channels);
        image.write().to_file(self.path(name)).unwrap();
    }

    /// Writes the scene of a quad with these material lines, with the texture `t` of `image`.
    fn scene_text(&self, image: &str, material: &str) -> PathBuf {
        let text = format!(
            "[camera]\nfrom = [0, 0, 3]\nat = [0, 0, 0]\n[texture.t]\nimage = '{image}'\n[material.m]\n{material}\n\
             [[object]]\nshape = 'quad'\ntransform = [{{ scale = 9 }}]\nmaterial = 'm'\n"
        );
        let path = self.path("scene.toml");
        fs::write(&path, text).unwrap();
        path
    }

    fn load(&self, image: &str, material: &str) -> Scene {
        let path = self.scene_text(image, material);
        scene_file::load(&path, &LoadOptions::default())
            .unwrap_or_else(|error| panic!("{error}"))
            .scene
    }

    /// Asserts that `whit info` ends with 2 and one sentence that names the line and contains `words`.
    #[track_caller]
    fn refuses(&self, (image, material): (&str, &str), place: &str, words: &[&str]) {
        let path = self.scene_text(image, material);
        let run = whit(&["info", &path.display().to_string()]);
        let message = &run.stderr;
        assert_eq!((run.code, message.lines().count()), (2, 1), "{message}");
        for word in [&[place], words].concat() {
            assert!(message.contains(word), "`{word}` is not in {message}");
        }
    }
}

/// Returns the red channel of a parameter's first texel.
fn red(scene: &Scene, parameter: MaterialInput) -> f32 {
    let material = scene.materials.iter().find(|m| m.name == "m").unwrap();
    let layer = material.layers.iter().find(|l| l.parameter == parameter).unwrap();
    let Texture::Image { image, .. } = scene.textures[layer.texture.texture as usize] else {
        panic!("an image was given");
    };
    match &scene.images[image as usize].texels {
        Texels::Floats(texels) => texels[0][0],
        Texels::Bytes(texels) => f32::from(texels[0][0]) / 255.0,
        Texels::Unread => panic!("the image was not decoded"),
    }
}

/// Returns the pixel in the middle of an image of `scene`.
fn middle(scene: &Scene) -> [f32; 3] {
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let settings = RenderSettings {
        width: 3,
        height: 3,
        ..RenderSettings::default()
    };
    let rendering = images::rendered_with(scene, &*accel, &settings);
    rendering.image.pixel(1, 1)
}

#[test]
fn sixteen_bit_codes_are_srgb_for_colours_and_linear_otherwise() {
    let folder = Folder::new();
    folder.wide_png("a.png", 32_768);
    // Expected values: ((0.500008 + 0.055) / 1.055)^2.4, and the linear fraction.
    let (color, data) = (0.214_048, 32_768.0 / 65_535.0);
    for (key, parameter, expected) in [
        ("base_color", MaterialInput::BaseColor, color),
        ("emission", MaterialInput::Emission, color),
        ("specular_color", MaterialInput::SpecularColor, color),
        ("roughness", MaterialInput::Roughness, data),
        ("metallic", MaterialInput::Metallic, data),
        ("transmission", MaterialInput::Transmission, data),
        ("occlusion", MaterialInput::Occlusion, data),
        ("normal", MaterialInput::Normal, data),
        ("bump", MaterialInput::Bump, data),
    ] {
        let scene = folder.load("a.png", &format!("{key} = {{ texture = 't' }}"));
        let found = red(&scene, parameter);
        assert!((found - expected).abs() < 1e-6, "{key}: {found}, not {expected}");
        assert_eq!(scene.images.len(), 1);
    }
}

#[test]
fn image_used_as_colour_and_data_is_duplicated_only_if_needed() {
    let folder = Folder::new();
    let both = "base_color = { texture = 't' }\nroughness = { texture = 't' }";
    folder.wide_png("a.png", 32_768);
    let scene = folder.load("a.png", both);
    assert_eq!((scene.images.len(), scene.textures.len()), (2, 2));
    assert!((red(&scene, MaterialInput::BaseColor) - 0.214_048).abs() < 1e-6);
    assert!((red(&scene, MaterialInput::Roughness) - 0.500_008).abs() < 1e-6);
    folder.exr("a.exr", [0.25; 3]);
    assert_eq!(folder.load("a.exr", both).images.len(), 1);
    image::save_buffer(folder.path("b.png"), &[9; 12], 2, 2, ExtendedColorType::Rgb8).unwrap();
    assert_eq!(folder.load("b.png", both).images.len(), 1);
}

#[test]
fn float_image_can_exceed_white() {
    let folder = Folder::new();
    folder.exr("a.exr", [512.0, 0.25, 7.5]);
    let emission = "base_color = 0\nspecular = 0\nemission = { texture = 't', value = [1, 1, 2] }";
    assert_eq!(middle(&folder.load("a.exr", emission)), [512.0, 0.25, 15.0]);
    let unlit = "model = 'unlit'\nbase_color = { texture = 't' }";
    assert_eq!(middle(&folder.load("a.exr", unlit)), [512.0, 0.25, 7.5]);
    // Flat pixels of 128 / 256 * 2^(131 - 128) = 4, and half and a quarter of that.
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 2\n".to_vec();
    bytes.extend([128, 64, 32, 131].repeat(4));
    fs::write(folder.path("a.hdr"), bytes).unwrap();
    let emission = "base_color = 0\nspecular = 0\nemission = { texture = 't' }";
    assert_eq!(middle(&folder.load("a.hdr", emission)), [4.0, 2.0, 1.0]);
}

#[test]
fn unusable_images_are_reported_with_line_and_remedy() {
    let folder = Folder::new();
    let light = "emission = { texture = 't' }";
    let huge = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 30000 +X 2000000\n";
    fs::write(folder.path("huge.hdr"), huge).unwrap();
    let words = ["texture.t.image", "2000000 x 30000", "make the image smaller"];
    folder.refuses(("huge.hdr", light), "scene.toml:5:9:", &words);
    folder.exr("nan.exr", [0.0, f32::NAN, 0.0]);
    let words = [
        "texture.t.image",
        "nan.exr",
        "not finite",
        "without NaN and infinity",
    ];
    folder.refuses(("nan.exr", light), "scene.toml:5:9:", &words);
    folder.exr("a.exr", [1.0; 3]);
    let whole = fs::read(folder.path("a.exr")).unwrap();
    fs::write(folder.path("cut.exr"), &whole[..whole.len() / 2]).unwrap();
    let words = ["texture.t.image", "cannot be decoded", "PNG, JPEG, HDR or EXR"];
    folder.refuses(("cut.exr", light), "scene.toml:5:9:", &words);
    let cut = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 2\n\x01\x02";
    fs::write(folder.path("cut.hdr"), cut).unwrap();
    folder.refuses(("cut.hdr", light), "scene.toml:5:9:", &words);
}

#[test]
fn out_of_range_float_texels_are_rejected() {
    let folder = Folder::new();
    folder.exr("a.exr", [0.5, -0.25, 3.0]);
    for material in [
        "emission = { texture = 't' }",
        "model = 'unlit'\nbase_color = { texture = 't' }",
        "metallic_roughness = { texture = 't' }",
        "specular_color = { texture = 't' }",
    ] {
        let words = ["material.m", "a.exr", "holds -0.25", "within the range"];
        folder.refuses(("a.exr", material), "scene.toml:6:", &words);
    }
    folder.exr("b.exr", [3.0, 0.0, 0.0]);
    for material in [
        "base_color = { texture = 't' }",
        "roughness = { texture = 't' }",
        "model = 'lecture'\nreflection = { texture = 't' }",
    ] {
        folder.refuses(
            ("b.exr", material),
            "scene.toml:6:",
            &["holds 3", "outside [0, 1]"],
        );
    }
    // Only red is used for roughness; heights and normals may have any value.
    folder.load("a.exr", "roughness = { texture = 't' }");
    folder.load("a.exr", "bump = { texture = 't' }\nnormal = { texture = 't' }");
}

#[test]
fn float_images_count_four_times_against_the_texel_budget() {
    let folder = Folder::new();
    folder.exr("a.exr", [1.0; 3]);
    let path = folder.scene_text("a.exr", "emission = { texture = 't' }");
    let load = |max_texels: u64| {
        scene_file::load(
            Path::new(&path),
            &LoadOptions {
                max_texels,
                ..LoadOptions::default()
            },
        )
    };
    assert!(load(16).is_ok());
    let message = load(15).unwrap_err().to_string();
    assert!(
        message.contains("2 x 2 pixels of 16 bytes") && message.contains("left for images"),
        "{message}"
    );
}
