//! The renderer's waves against the referee's recursion, pixel by pixel; and the same bits however it is run.

use std::sync::atomic::AtomicBool;

use whit::accel::{self, AccelOptions, Backend};
use whit::image::LinearImage;
use whit::render::{Monitor, RenderSettings, render};
use whit::scene::Scene;

use crate::support::clear_scenes::{self, Division};
use crate::support::textbook::{Pixel, Request, picture};
use crate::support::texture_scenes::{self, Role};
use crate::support::verdict::{EXPLAINED_SHARE, assert_agree, backends, relative_bound};
use crate::support::wave_scenes::{self, WaveScene};

/// The bounds themselves must be worth something: in units of the picture's mean radiance, those of half, of 95 % and
/// of 99.5 % of the pixels are at most these. They are wide only in sharp highlights and behind several curved mirrors.
const USEFUL_BOUNDS: [(f64, f64); 3] = [(0.5, 2e-5), (0.95, 2e-3), (1.0 - EXPLAINED_SHARE, 0.1)];

/// The same of textures, small hits in a mirror among them, whose slopes part rays.
const USEFUL_TEXTURE_BOUNDS: [(f64, f64); 3] = [(0.5, 2e-5), (0.9, 1e-2), (0.95, 5e-2)];

/// The same of bodies of glass, behind whose curved boundaries rays part.
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
    let accel = accel::build(scene, backend, &AccelOptions::default()).unwrap();
    let settings = RenderSettings {
        width: request.width,
        height: request.height,
        spp: request.spp,
        depth: request.depth,
        weight_cutoff: request.weight_cutoff,
        wavelengths: request.wavelengths,
        ..RenderSettings::default()
    };
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
        tiles: None,
    };
    let rendering = render(scene, &scene.cameras[0], accel.as_ref(), &settings, &monitor);
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
    let referee = picture(scene, &scene.cameras[0], request);
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

/// The referee's own picture, rounded to f32, with `spoil` done to one pixel that `chosen` picks.
fn spoiled(chosen: fn(&Pixel) -> bool, spoil: fn(&Pixel) -> f32) -> (LinearImage, Vec<Pixel>) {
    let wave_scene = wave_scenes::facing_mirrors();
    let request = request(&wave_scene, 96, 64, 1);
    let referee = picture(&wave_scene.scene, &wave_scene.scene.cameras[0], request);
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

/// Just outside the bound of the green channel.
fn just_outside(pixel: &Pixel) -> f32 {
    (pixel.radiance.y.value + 1.01 * pixel.radiance.y.error) as f32
}

#[test]
#[should_panic(expected = "1 wrong pixels")]
fn one_certain_pixel_just_outside_its_bound_is_wrong() {
    let (image, referee) = spoiled(|p| p.doubt.slack > 1.0 && p.radiance.y.error > 1e-4, just_outside);
    assert_agree("spoiled", &image, &referee);
}

#[test]
#[should_panic(expected = "1 wrong pixels")]
fn a_pixel_that_is_no_number_is_wrong_even_in_doubt() {
    let (image, referee) = spoiled(|p| p.doubt.may_flip(), |_| f32::NAN);
    assert_agree("spoiled", &image, &referee);
}

#[test]
fn one_pixel_with_a_decision_in_doubt_may_differ() {
    let (image, referee) = spoiled(|p| p.doubt.may_flip(), |_| 7.0);
    assert_agree("spoiled", &image, &referee);
}

#[test]
fn lamps_are_as_the_textbook_has_them() {
    compare(&wave_scenes::lamps(), 96, 64, 1);
}

#[test]
fn facing_mirrors_are_as_the_textbook_has_them() {
    compare(&wave_scenes::facing_mirrors(), 96, 64, 1);
}

#[test]
fn placements_are_as_the_textbook_has_them() {
    compare(&wave_scenes::placements(), 96, 64, 1);
}

#[test]
fn textures_are_as_the_textbook_has_them() {
    compare(&wave_scenes::textures(), 96, 64, 1);
}

/// Every kind of texture in this role, on meshes and shapes, seen directly and in a mirror.
fn compare_gallery(role: Role) {
    println!("{role:?}");
    compare_within(USEFUL_TEXTURE_BOUNDS, &texture_scenes::gallery(role), (96, 64, 1));
}

#[test]
fn textures_of_colour_are_as_the_textbook_has_them() {
    compare_gallery(Role::BaseColor);
    compare_gallery(Role::Emission);
    compare_gallery(Role::Lecture);
    compare_gallery(Role::Specular);
}

#[test]
fn textures_of_roughness_are_as_the_textbook_has_them() {
    compare_gallery(Role::Roughness);
    compare_gallery(Role::Packed);
}

#[test]
fn textures_of_coverage_are_as_the_textbook_has_them() {
    compare_gallery(Role::Mask);
    compare_gallery(Role::Blend);
}

#[test]
fn normal_and_bump_maps_are_as_the_textbook_has_them() {
    compare_gallery(Role::Normal);
    compare_gallery(Role::Bump);
    compare_gallery(Role::NormalAndBump);
}

#[test]
fn the_inside_of_a_sphere_is_as_the_textbook_has_it() {
    compare(&wave_scenes::inside(), 96, 64, 1);
}

#[test]
fn the_lectures_materials_are_as_the_textbook_has_them() {
    compare(&clear_scenes::blackboard(), 40, 30, 1);
}

#[test]
fn paperweights_are_as_the_textbook_has_them() {
    compare_clear(&clear_scenes::paperweights(Division::Fresnel));
}

#[test]
fn paperweights_without_fresnel_are_as_the_textbook_has_them() {
    compare_clear(&clear_scenes::paperweights(Division::Constant));
}

#[test]
fn ice_in_water_in_glass_is_as_the_textbook_has_it() {
    compare_clear(&clear_scenes::tumbler());
}

#[test]
fn the_view_from_under_water_is_as_the_textbook_has_it() {
    compare_clear(&clear_scenes::pool());
}

#[test]
fn cut_out_and_partial_layers_are_as_the_textbook_has_them() {
    compare_clear(&clear_scenes::veils());
}

#[test]
fn prisms_part_colours_as_the_textbook_does() {
    compare_clear(&clear_scenes::prisms());
}

#[test]
fn panes_behind_a_window_are_as_the_textbook_has_them() {
    compare_clear(&clear_scenes::window());
}

#[test]
fn any_number_of_samples_is_the_mean_that_the_textbook_takes() {
    // Packets of sixteen hold 16, 4 or 1 pixels by the number of samples: both ends of each, and one beyond.
    for spp in [1, 3, 4, 16, 17] {
        compare(&wave_scenes::placements(), 24, 16, spp);
        compare(&wave_scenes::inside(), 24, 16, spp);
    }
}

#[test]
fn sizes_that_no_tile_divides_lose_no_pixel() {
    for (width, height) in [(1, 1), (17, 3), (33, 65), (1, 40)] {
        compare(&wave_scenes::lamps(), width, height, 1);
    }
}

#[test]
fn depth_and_cut_off_end_paths_where_the_textbook_does() {
    for depth in [0, 1, 7] {
        let wave_scene = WaveScene {
            depth,
            ..wave_scenes::facing_mirrors()
        };
        compare(&wave_scene, 32, 24, 1);
    }
}

#[test]
fn more_samples_come_nearer_to_a_fine_picture() {
    // Against 256 samples a pixel, the root mean square error of 16 is less than half of that of 1: were the samples
    // random it would be a quarter.
    let wave_scene = wave_scenes::lamps();
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
fn any_number_of_threads_gives_the_same_bits_every_time() {
    assert_bits_stay(3);
}

#[test]
#[ignore = "slow: more runs"]
fn any_number_of_threads_gives_the_same_bits_in_thirty_runs() {
    assert_bits_stay(30);
}

/// Asserts that so many renders by each number of threads have the same bits.
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
fn a_cancelled_render_gives_no_picture() {
    let wave_scene = wave_scenes::lamps();
    let accel = accel::build(&wave_scene.scene, Backend::Bsp, &AccelOptions::default()).unwrap();
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(true),
        tiles: None,
    };
    let settings = RenderSettings::default();
    let camera = &wave_scene.scene.cameras[0];
    assert!(render(&wave_scene.scene, camera, accel.as_ref(), &settings, &monitor).is_none());
}
