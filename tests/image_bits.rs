//! Pictures that must have the same bits with every Embree, once its instruction set is pinned.
//!
//! The sums below were made with Embree 3.13.5; the same tests run against Embree 4. A change of the shading or of the
//! spawn points changes them: look at the pictures, then take over what the failing test prints.

#![cfg(feature = "embree")]

#[path = "common"]
mod common {
    #![allow(dead_code, unreachable_pub, reason = "this program uses a part of it")]

    pub mod meshes;
    pub mod wave_scenes;
}

use std::path::Path;
use std::sync::atomic::AtomicBool;

use common::wave_scenes;
use whit::accel::{AccelOptions, Backend, build};
use whit::gltf::{LoadOptions, load};
use whit::image::LinearImage;
use whit::render::{Monitor, RenderSettings, render};
use whit::scene::Scene;

/// Present in every x86-64 processor of the last ten years, and as fast as wider ones for most scenes.
const ISA: &str = "avx2";

/// Each scene's name and the sum of its picture's bits.
const SUMS: [(&str, u64); 6] = [
    ("lamps", 0x7838_0936_3383_2c5d),
    ("facing mirrors", 0x674a_6f01_2077_7be7),
    ("placements", 0xffc5_3c62_1892_544a),
    ("textures", 0x6b35_5e15_c4f4_4b19),
    ("inside", 0x19dc_db33_5a05_affe),
    ("first light", 0x9afe_8cf7_c5df_63e5),
];

fn scene(name: &str) -> Scene {
    match name {
        "lamps" => wave_scenes::lamps().scene,
        "facing mirrors" => wave_scenes::facing_mirrors().scene,
        "placements" => wave_scenes::placements().scene,
        "textures" => wave_scenes::textures().scene,
        "inside" => wave_scenes::inside().scene,
        _ => {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/first_light.gltf");
            load(&path, &LoadOptions::default()).unwrap()
        }
    }
}

fn picture(scene: &Scene) -> LinearImage {
    let options = AccelOptions {
        isa: Some(ISA.into()),
        ..AccelOptions::default()
    };
    let accel = build(scene, Backend::Embree, &options).unwrap();
    let settings = RenderSettings {
        width: 160,
        height: 120,
        spp: 4,
        depth: 4,
        ..RenderSettings::default()
    };
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
    };
    render(scene, &scene.cameras[0], &*accel, &settings, &monitor)
        .unwrap()
        .image
}

/// FNV-1a (Fowler, Noll, Vo) over the bits of all channels.
fn sum_of_bits(image: &LinearImage) -> u64 {
    let bytes = image
        .pixels
        .iter()
        .flatten()
        .flat_map(|channel| channel.to_bits().to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |sum, byte| {
        (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

#[test]
fn six_pictures_have_the_bits_that_they_have_with_every_embree() {
    if !is_x86_feature_detected!("avx2") {
        eprintln!("skipped: this processor has no AVX2");
        return;
    }
    let found: Vec<(&str, u64)> = SUMS
        .iter()
        .map(|&(name, _)| (name, sum_of_bits(&picture(&scene(name)))))
        .collect();
    for (name, sum) in &found {
        println!("    (\"{name}\", {sum:#018x}),");
    }
    assert_eq!(found, SUMS);
}
