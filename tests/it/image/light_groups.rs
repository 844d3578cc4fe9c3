//! Tests of light layers, by light and by effect: each kind adds up to the image, whose bits are unchanged.

use std::path::Path;

use crate::support::cli_program::{fails_with, whit};
use crate::support::images::{rendered, settings};
use crate::support::scene_folder;
use whit::accel::{self, AccelOptions, Backend};
use whit::image::rows::{ExrScanlineReader, Samples};
use whit::render::{AovKind, AovSet, LightAovs, Monitor, Parts, Region, RenderSettings, Rendering};
use whit::scene::Scene;

/// Scenes with several volumes and lights, glass, mirrors, textures, lobes and subsurface scattering.
const SCENES: [&str; 11] = [
    "glass_of_water.toml",
    "prism.toml",
    "smoke.toml",
    "fire.toml",
    "fog_beam.toml",
    "soft_shadows.toml",
    "textured.toml",
    "mirror_room.toml",
    "rough.toml",
    "foliage.toml",
    "wax.toml",
];

const BOTH: LightAovs = LightAovs {
    lights: true,
    effects: true,
};

fn with_light(size: u32) -> RenderSettings {
    RenderSettings {
        light_layers: BOTH,
        ..settings(size, 2)
    }
}

fn render(scene: &Scene, settings: &RenderSettings) -> Rendering {
    rendered(scene, &scene.cameras[0], settings)
}

fn values<'r>(rendering: &'r Rendering, name: &str) -> &'r [f32] {
    let mut layers = rendering.layers.iter();
    let layer = layers.find(|layer| layer.name == name);
    &layer.unwrap_or_else(|| panic!("no {name}")).values
}

/// Returns a bound on the difference of the sums of layers of one kind from `whole`; `magnitude` is the sum of their
/// absolute values.
///
/// Every layer is rounded to f32 once, and so is the image; volumes round each light's part of a ray and their sum.
fn bound(magnitude: f64, layers: usize) -> f64 {
    (layers + 2) as f64 * f64::from(f32::EPSILON) * magnitude
}

#[test]
fn light_layers_sum_to_the_unchanged_image() {
    for name in SCENES {
        let scene = scene_folder::named(name).scene;
        let plain = render(&scene, &settings(24, 2));
        let layered = render(&scene, &with_light(24));
        assert_eq!(plain.image.pixels, layered.image.pixels, "{name}");
        for kind in ["light.", "effect."] {
            for (channel, end) in [".R", ".G", ".B"].into_iter().enumerate() {
                let layers: Vec<&[f32]> = layered
                    .layers
                    .iter()
                    .filter(|layer| layer.name.starts_with(kind) && layer.name.ends_with(end))
                    .map(|layer| &layer.values[..])
                    .collect();
                for (index, pixel) in layered.image.pixels.iter().enumerate() {
                    let parts = layers.iter().map(|layer| f64::from(layer[index]));
                    let sum: f64 = parts.clone().sum();
                    let whole = f64::from(pixel[channel]);
                    let magnitude = parts.map(f64::abs).sum::<f64>() + whole.abs();
                    let off = (sum - whole).abs();
                    assert!(
                        off <= bound(magnitude, layers.len()),
                        "{name} {kind}{end} {index}: {sum} for {whole}"
                    );
                }
            }
        }
    }
}

#[test]
fn single_light_render_matches_its_layer() {
    for name in [
        "lecture_lighting.toml",
        "soft_shadows.toml",
        "fog_beam.toml",
        "glass_of_water.toml",
    ] {
        let scene = scene_folder::named(name).scene;
        let layered = render(&scene, &with_light(24));
        let count = scene.lights.len();
        assert!(count > 1, "{name}");
        let groups: Vec<_> = layered
            .layers
            .chunks(3)
            .filter(|layers| layers[0].name.starts_with("light."))
            .collect();
        for number in 0..count {
            let mut alone = scene.clone();
            // Keep the other lights in their slots without emission, so that the sample indices of lights are
            // unchanged.
            for (other, light) in alone.lights.iter_mut().enumerate() {
                if other != number {
                    light.intensity = [0.0; 3];
                }
            }
            let alone = render(&alone, &with_light(24));
            // The first layer is `light.emission`.
            for layer in groups[1 + number] {
                assert_eq!(values(&alone, &layer.name), layer.values, "{name} {}", layer.name);
            }
            let given = groups[1 + number].iter().flat_map(|layer| &layer.values);
            assert!(given.into_iter().any(|&value| value > 0.0), "{name} {number}");
        }
    }
}

#[test]
fn reflection_layer_is_black_without_mirrors() {
    let scene = scene_folder::named("whitted_1980.toml").scene;
    let seen = RenderSettings {
        layers: AovSet::NONE.with(AovKind::Ids),
        // Use one sample, so that a pixel sees one object.
        spp: 1,
        ..with_light(32)
    };
    let layered = render(&scene, &seen);
    let reflected = values(&layered, "effect.reflection.G");
    let refracted = values(&layered, "effect.refraction.G");
    let mut counts = [0; 3];
    for (pixel, &object) in values(&layered, "id.object").iter().enumerate() {
        let name = match object {
            -1.0 => "sky",
            _ => &scene.instances[object as usize].name,
        };
        match name {
            "mirror ball" => counts[0] += usize::from(reflected[pixel] > 0.0 && refracted[pixel] == 0.0),
            "glass ball" => counts[1] += usize::from(refracted[pixel] > 0.0),
            _ => {
                assert_eq!((reflected[pixel], refracted[pixel]), (0.0, 0.0), "{name} {pixel}");
                counts[2] += 1;
            }
        }
    }
    assert!(counts.iter().all(|&count| count > 0), "{counts:?}");
}

#[test]
fn direct_layer_matches_a_render_without_bounces() {
    let scene = scene_folder::named("whitted_1980.toml").scene;
    let no_steps = RenderSettings {
        depth: 0,
        ..settings(24, 2)
    };
    let (layered, direct) = (render(&scene, &with_light(24)), render(&scene, &no_steps));
    let green: Vec<f32> = direct.image.pixels.iter().map(|pixel| pixel[1]).collect();
    // Each value is rounded to f32 once, after sums whose order may differ.
    for (&layer, whole) in values(&layered, "effect.direct.G").iter().zip(green) {
        let off = (f64::from(layer) - f64::from(whole)).abs();
        assert!(off <= bound(f64::from(whole), 1), "{layer} for {whole}");
    }
}

#[test]
fn layers_of_a_region_match_the_full_image() {
    let (scene, settings) = (scene_folder::named("glass_of_water.toml").scene, with_light(48));
    let whole = render(&scene, &settings);
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let monitor = Monitor::default();
    let mut parts = Parts::new(
        (scene.validate().unwrap(), &scene.cameras[0]),
        &*accel,
        &settings,
        &monitor,
    )
    .unwrap();
    let region = Region {
        x: 10,
        y: 20,
        width: 30,
        height: 15,
    };
    let part = parts.region(&region, &monitor).unwrap();
    assert_eq!(part.layers.len(), whole.layers.len());
    for (layer, all) in part.layers.iter().zip(&whole.layers) {
        assert_eq!(layer.name, all.name);
        for (y, row) in layer.values.chunks(30).enumerate() {
            let start = (20 + y) * 48 + 10;
            assert_eq!(row, &all.values[start..start + 30], "{}", layer.name);
        }
    }
}

/// Returns the channels of a file, sorted by name.
fn channels(path: &Path, height: u32) -> Vec<(String, Vec<f32>)> {
    let mut reader = ExrScanlineReader::open(path).unwrap();
    let names: Vec<String> = reader
        .channels()
        .iter()
        .map(|channel| channel.name.clone())
        .collect();
    let floats = |samples| match samples {
        Samples::Floats(values) => values.into_owned(),
        Samples::Integers(_) => panic!("integers"),
    };
    let planes = reader.read_rows(0..height).unwrap().into_iter().map(floats);
    names.into_iter().zip(planes).collect()
}

#[test]
fn sharded_batches_write_the_same_light_layers() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/glass_of_water.toml");
    let folder = tempfile::tempdir().unwrap();
    let [alone, jobs, out] = ["alone.exr", "test.jobs.toml", "out"].map(|name| folder.path().join(name));
    // Write a job file that splits the image into bands
    let word = |path: &Path| path.display().to_string();
    let text = format!(
        "[[job]]\nscene = '{}'\nsplit = {{ bands = 2 }}\nimage = \"a.exr\"\n\
         settings = {{ size = \"24x70\", spp = 2, backend = \"bsp\", aov = \"lights,effects\" }}\n",
        scene.display()
    );
    std::fs::write(&jobs, text).unwrap();
    // Render once directly and once as a batch
    let fixed = "--size 24x70 --spp 2 --backend bsp --aov lights,effects --quiet";
    let (scene, image, jobs) = (word(&scene), word(&alone), word(&jobs));
    let rendered = ["render", &scene, "-o", &image]
        .into_iter()
        .chain(fixed.split(' '));
    let batched = ["batch", &jobs, "--out", &word(&out), "--quiet"];
    for run in [whit(&rendered.collect::<Vec<_>>()), whit(&batched)] {
        assert_eq!(run.code, 0, "{}", run.stderr);
    }
    // Compare both files
    let found = channels(&alone, 70);
    assert!(found == channels(&out.join("a.exr"), 70));
    let of = |name: &str| &found.iter().find(|(called, _)| called == name).unwrap().1;
    let layers: Vec<&Vec<f32>> = found
        .iter()
        .filter(|(name, _)| name.starts_with("light.") && name.ends_with(".G"))
        .map(|(_, values)| values)
        .collect();
    assert!(layers.len() > 2);
    // Check that the light layers add up to the image
    for (index, &whole) in of("G").iter().enumerate() {
        let sum: f64 = layers.iter().map(|layer| f64::from(layer[index])).sum();
        let off = (sum - f64::from(whole)).abs();
        assert!(off <= bound(sum, layers.len()), "{index}: {sum} for {whole}");
    }
}

#[test]
fn filters_reject_light_layers() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/prism.toml");
    let scene = scene.to_str().unwrap();
    let rest = ["-o", "unwritten.exr", "--filter", "mitchell", "--aov", "lights"];
    let arguments: Vec<&str> = ["render", scene].into_iter().chain(rest).collect();
    fails_with(2, "give `--filter box`", &arguments);
}
