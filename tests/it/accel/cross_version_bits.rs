//! Images that must have the same bits with every Embree, once its instruction set is pinned, and by the BSP.
//!
//! The sums below were made with Embree 3.13.5; the same tests run against Embree 4. A change of the shading or of the
//! spawn points changes them: look at the images, then take over what the failing test prints.

use crate::support::images;
use std::path::Path;

use crate::support::wave_scenes;
use whit::accel::{AccelOptions, Backend, build};
use whit::gltf::{LoadOptions, load};
use whit::image::LinearImage;
use whit::render::{Pattern, RenderSettings};
use whit::scene::Scene;

/// Present in every x86-64 processor of the last ten years, and as fast as wider ones for most scenes.
const ISA: &str = "avx2";

/// Each scene's name and the sum of its image's bits.
const SUMS: [(&str, u64); 6] = [
    ("lamps", 0x1b0d_8d9a_f498_8dc8),
    ("facing mirrors", 0xb215_5760_8926_16ec),
    ("placements", 0xb867_bfdb_ac4f_2ed0),
    ("textures", 0x8edf_3390_3772_37bc),
    ("inside", 0x770e_2219_f15d_3b31),
    ("first light", 0x40f7_4178_8fd6_7d8d),
];

fn scene(name: &str) -> Scene {
    match name {
        "lamps" => wave_scenes::lights_of_all_kinds().scene,
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

fn image(scene: &Scene, backend: Backend) -> LinearImage {
    let options = AccelOptions {
        isa: (backend == Backend::Embree).then(|| ISA.into()),
        ..AccelOptions::default()
    };
    let accel = build(scene.validate().unwrap(), backend, &options).unwrap();
    let settings = RenderSettings {
        width: 160,
        height: 120,
        spp: 4,
        pattern: Pattern::R2,
        depth: 4,
        ..RenderSettings::default()
    };
    images::rendered_with(scene, &*accel, &settings).image
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
fn six_images_are_bit_equal_for_all_embree_versions_and_bsp() {
    if !is_x86_feature_detected!("avx2") {
        eprintln!("skipped: this processor has no AVX2");
        return;
    }
    for backend in [Backend::Embree, Backend::Native, Backend::Bsp] {
        let found: Vec<(&str, u64)> = SUMS
            .iter()
            .map(|&(name, _)| (name, sum_of_bits(&image(&scene(name), backend))))
            .collect();
        for (name, sum) in &found {
            println!("    (\"{name}\", {sum:#018x}),");
        }
        assert_eq!(found, SUMS, "{backend}");
    }
}
