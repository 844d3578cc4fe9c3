//! Compares the wavefront renderer with the recursive reference tracer pixel by pixel, and checks that its bits do
//! not depend on the number of threads.

use std::sync::atomic::AtomicBool;

use whit::accel::{self, AccelOptions, Backend};
use whit::image::LinearImage;
use whit::render::{Monitor, Pattern, RenderSettings, render};
use whit::scene::Scene;

use crate::support::clear_scenes::{self, Division};
use crate::support::textbook::{Pixel, Request, reference_image};
use crate::support::texture_scenes::{self, Role};
use crate::support::verdict::{EXPLAINED_SHARE, assert_agree, backends, relative_bound};
use crate::support::wave_scenes::{self, WaveScene};

/// Limits on the error bounds, so that the comparison is meaningful: in units of the mean radiance of the image, the
/// bounds of 50 %, 95 % and 99.5 % of the pixels. They are wide only in sharp highlights and behind several curved
/// mirrors.
const USEFUL_BOUNDS: [(f64, f64); 3] = [(0.5, 4e-5), (0.95, 2e-3), (1.0 - EXPLAINED_SHARE, 0.1)];

/// Limits on the error bounds of textured scenes, which include reflections in bump-mapped mirrors.
const USEFUL_TEXTURE_BOUNDS: [(f64, f64); 3] = [(0.5, 2e-5), (0.9, 1.2e-2), (0.95, 5e-2)];

/// Limits on the error bounds of glass objects, whose curved boundaries spread rays.
const USEFUL_CLEAR_BOUNDS: [(f64, f64); 3] = [(0.4, 2e-5), (0.5, 1e-4), (0.65, 1e-3)];

fn request(wave_scene: &WaveScene, width: u32, height: u32, spp: u32) -> Request {
    Request {
        width,
        height,
        spp,
        depth: wave_scene.depth,
        weight_cutoff: 1.0 / 512.0,
        wavelengths: 4,
    }
}

fn rendered(scene: &Scene, backend: Backend, request: Request) -> LinearImage {
    let accel = accel::build(scene.validate().unwrap(), backend, &AccelOptions::default()).unwrap();
    let settings = RenderSettings {
        width: request.width,
        height: request.height,
        spp: request.spp,
        // The reference knows this pattern only
        pattern: Pattern::R2,
        depth: request.depth,
        weight_cutoff: request.weight_cutoff,
        wavelengths: request.wavelengths,
        ..RenderSettings::default()
    };
    let monitor = Monitor::default();
    let rendering = render(
        scene.validate().unwrap(),
        &scene.cameras[0],
        accel.as_ref(),
        &settings,
        &monitor,
    );
    rendering.unwrap().image
}

fn compare(wave_scene: &WaveScene, width: u32, height: u32, spp: u32) {
    compare_within(USEFUL_BOUNDS, wave_scene, (width, height, spp));
}

fn compare_clear(wave_scene: &WaveScene) {
    compare_within(USEFUL_CLEAR_BOUNDS, wave_scene, (40, 30, 1));
}

fn compare_within(useful: [(f64, f64); 3], wave_scene: &WaveScene, (width, height, spp): (u32, u32, u32)) {
    let request = request(wave_scene, width, height, spp);
    let scene = &wave_scene.scene;
    scene.validate().unwrap();
    let referee = reference_image(scene, &scene.cameras[0], request);
    for (share, useful) in useful {
        let bound = relative_bound(&referee, share);
        println!(
            "{}: relative bound for {share} of the pixels {bound:.1e}",
            wave_scene.name
        );
        assert!(
            bound <= useful,
            "{}: {bound} for {share} of the pixels",
            wave_scene.name
        );
    }
    for backend in backends() {
        let image = rendered(scene, backend, request);
        assert_eq!((image.width, image.height), (width, height));
        let what = format!("{} {width}x{height} {spp} spp {backend}", wave_scene.name);
        assert_agree(&what, &image, &referee);
    }
}

/// Returns the reference image, rounded to f32, with one pixel that satisfies `chosen` replaced by `spoil`.
fn spoiled(chosen: fn(&Pixel) -> bool, spoil: fn(&Pixel) -> f32) -> (LinearImage, Vec<Pixel>) {
    let wave_scene = wave_scenes::facing_mirrors();
    let request = request(&wave_scene, 96, 64, 1);
    let referee = reference_image(&wave_scene.scene, &wave_scene.scene.cameras[0], request);
    let mut pixels: Vec<[f32; 3]> = referee
        .iter()
        .map(|p| p.radiance.value().as_vec3().to_array())
        .collect();
    let index = referee.iter().position(chosen).unwrap();
    pixels[index][1] = spoil(&referee[index]);
    let (width, height) = (request.width, request.height);
    (
        LinearImage {
            width,
            height,
            pixels,
        },
        referee,
    )
}

/// Returns a value just outside the bound of the green channel.
fn just_outside(pixel: &Pixel) -> f32 {
    (pixel.radiance.y.value + 1.01 * pixel.radiance.y.error) as f32
}

#[test]
#[should_panic(expected = "1 wrong pixels")]
fn certain_pixel_outside_its_bound_fails() {
    let (image, referee) = spoiled(|p| p.doubt.slack > 1.0 && p.radiance.y.error > 1e-4, just_outside);
    assert_agree("spoiled", &image, &referee);
}

#[test]
#[should_panic(expected = "1 wrong pixels")]
fn nan_pixel_fails_even_if_doubtful() {
    let (image, referee) = spoiled(|p| p.doubt.may_flip(), |_| f32::NAN);
    assert_agree("spoiled", &image, &referee);
}

#[test]
fn doubtful_pixel_may_differ() {
    let (image, referee) = spoiled(|p| p.doubt.may_flip(), |_| 7.0);
    assert_agree("spoiled", &image, &referee);
}

#[test]
fn lights_match_the_reference() {
    compare(&wave_scenes::lights_of_all_kinds(), 96, 64, 1);
}

#[test]
fn facing_mirrors_match_the_reference() {
    compare(&wave_scenes::facing_mirrors(), 96, 64, 1);
}

#[test]
fn transforms_match_the_reference() {
    compare(&wave_scenes::placements(), 96, 64, 1);
}

#[test]
fn textures_match_the_reference() {
    compare(&wave_scenes::textures(), 96, 64, 1);
}

/// Compares every kind of texture in this role, on meshes and shapes, seen directly and in a mirror.
fn compare_gallery(role: Role) {
    println!("{role:?}");
    compare_within(USEFUL_TEXTURE_BOUNDS, &texture_scenes::gallery(role), (96, 64, 1));
}

#[test]
fn colour_textures_match_the_reference() {
    compare_gallery(Role::BaseColor);
    compare_gallery(Role::Emission);
    compare_gallery(Role::Phong);
    compare_gallery(Role::Specular);
}

#[test]
fn roughness_textures_match_the_reference() {
    compare_gallery(Role::Roughness);
    compare_gallery(Role::Packed);
}

#[test]
fn coverage_textures_match_the_reference() {
    compare_gallery(Role::Mask);
    compare_gallery(Role::Blend);
}

#[test]
fn normal_and_bump_maps_match_the_reference() {
    compare_gallery(Role::Normal);
    compare_gallery(Role::Bump);
    compare_gallery(Role::NormalAndBump);
}

#[test]
fn inside_of_a_sphere_matches_the_reference() {
    compare(&wave_scenes::inside(), 96, 64, 1);
}

#[test]
fn phong_materials_match_the_reference() {
    compare(&clear_scenes::blackboard(), 40, 30, 1);
}

#[test]
fn paperweights_match_the_reference() {
    compare_clear(&clear_scenes::paperweights(Division::Fresnel));
}

#[test]
fn paperweights_without_fresnel_match_the_reference() {
    compare_clear(&clear_scenes::paperweights(Division::Constant));
}

#[test]
fn ice_in_water_in_glass_matches_the_reference() {
    compare_clear(&clear_scenes::tumbler());
}

#[test]
fn underwater_view_matches_the_reference() {
    compare_clear(&clear_scenes::pool());
}

#[test]
fn alpha_masked_and_blended_layers_match_the_reference() {
    compare_clear(&clear_scenes::veils());
}

#[test]
fn prism_dispersion_matches_the_reference() {
    compare_clear(&clear_scenes::prisms());
}

#[test]
fn panes_behind_a_window_match_the_reference() {
    compare_clear(&clear_scenes::window());
}

#[test]
fn sample_mean_matches_the_reference() {
    // A packet of sixteen holds 16, 4 or 1 pixels, depending on the number of samples: test both ends of each range.
    for spp in [1, 3, 4, 16, 17] {
        compare(&wave_scenes::placements(), 24, 16, spp);
        compare(&wave_scenes::inside(), 24, 16, spp);
    }
}

#[test]
fn sizes_not_divisible_by_tiles_lose_no_pixel() {
    for (width, height) in [(1, 1), (17, 3), (33, 65), (1, 40)] {
        compare(&wave_scenes::lights_of_all_kinds(), width, height, 1);
    }
}

#[test]
fn depth_and_cutoff_end_paths_like_the_reference() {
    for depth in [0, 1, 7] {
        let wave_scene = WaveScene {
            depth,
            ..wave_scenes::facing_mirrors()
        };
        compare(&wave_scene, 32, 24, 1);
    }
}

#[test]
fn more_samples_approach_a_converged_image() {
    // Against 256 samples per pixel, 16 samples have less than half of the root mean square error of 1 sample; with
    // random samples the ratio would be a quarter.
    let wave_scene = wave_scenes::lights_of_all_kinds();
    let of = |spp: u32| rendered(&wave_scene.scene, Backend::Bsp, request(&wave_scene, 24, 16, spp)).pixels;
    let fine = of(256);
    let error = |pixels: Vec<[f32; 3]>| {
        let squares = pixels
            .iter()
            .zip(&fine)
            .map(|(a, b)| f64::from(a[0] - b[0]).powi(2));
        squares.sum::<f64>().sqrt()
    };
    let (rough, better) = (error(of(1)), error(of(16)));
    assert!(better < 0.5 * rough, "1 spp: {rough}, 16 spp: {better}");
}

#[test]
fn bits_do_not_depend_on_thread_count() {
    assert_bits_stay(3);
}

#[test]
#[ignore = "slow: more runs"]
fn bits_do_not_depend_on_thread_count_in_thirty_runs() {
    assert_bits_stay(30);
}

/// Asserts that this many renders with each number of threads have the same bits.
fn assert_bits_stay(run_count: usize) {
    let bits = |image: LinearImage| {
        image
            .pixels
            .concat()
            .iter()
            .map(|v| v.to_bits())
            .collect::<Vec<u32>>()
    };
    for wave_scene in [
        wave_scenes::facing_mirrors(),
        wave_scenes::textures(),
        clear_scenes::prisms(),
        clear_scenes::window(),
    ] {
        let request = request(&wave_scene, 70, 50, 3);
        for backend in backends().into_iter().filter(|&b| b != Backend::Brute) {
            let mut first = None;
            for threads in [1, 2, 7] {
                let pool = rayon::ThreadPoolBuilder::new()
                    .num_threads(threads)
                    .build()
                    .unwrap();
                for run in 0..run_count {
                    let image = pool.install(|| rendered(&wave_scene.scene, backend, request));
                    let bits = bits(image);
                    let same = *first.get_or_insert_with(|| bits.clone()) == bits;
                    assert!(same, "{} {backend} {threads} threads, run {run}", wave_scene.name);
                }
            }
        }
    }
}

#[test]
fn cancelled_render_returns_no_image() {
    let wave_scene = wave_scenes::lights_of_all_kinds();
    let accel = accel::build(
        wave_scene.scene.validate().unwrap(),
        Backend::Bsp,
        &AccelOptions::default(),
    )
    .unwrap();
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(true),
        tiles: None,
    };
    let settings = RenderSettings::default();
    let camera = &wave_scene.scene.cameras[0];
    assert!(
        render(
            wave_scene.scene.validate().unwrap(),
            camera,
            accel.as_ref(),
            &settings,
            &monitor
        )
        .is_err()
    );
}
