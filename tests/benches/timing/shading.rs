//! Prices of shading: the time of a ray of a rough lobe, a point on an area light, a ray through dispersive glass and a
//! sample of a filtered texture, over that of the plainest which does the same.
//!
//! Scenes that are compared have the same shapes and camera, and differ in one property. They are rendered by turns, on
//! one thread. The price of a ray is the time that the render takes more than one without such rays, over their number:
//! it includes generating, tracing and shading them.

use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::LoadOptions;
use whit::render::{Monitor, RenderProfile, RenderSettings, render};
use whit::scene::Scene;
use whit::scene_file;

use crate::checkerboards;
use crate::ledgers::one_thread;
use crate::limits::Limits;
use crate::quartiles::Quartiles;

const ROUNDS: usize = 7;
const WIDTH: u32 = 320;
const SPP: u32 = 4;

/// The largest price of a lobe's ray, in mirror rays.
const MAX_LOBE: f64 = 3.0;
/// The largest price of a point on an area light with its shadow ray, in point lights.
const MAX_AREA_LIGHT: f64 = 2.0;
/// The largest price of a ray through dispersive glass, in rays through plain glass.
const MAX_DISPERSION: f64 = 1.5;
/// The largest time of a render of a mipmapped floor over that of a bilinear one.
const MAX_MIPMAP: f64 = 1.5;

/// A hundred balls on a floor, from which rays scatter in all directions.
fn balls(material: &str, light: &str) -> Scene {
    let mut text = format!(
        "background = 0.5\n\
         camera = {{ from = [0, 6, 9], at = [0, 0, 0], fov = 40 }}\n\
         [material.ball]\n{material}\n\
         [material.floor]\nbase_color = 0.5\nmetallic = 0\nroughness = 1\n\
         {light}\n\
         [[object]]\nshape = 'plane'\ntransform = [{{ z-to = [0, 1, 0] }}]\nmaterial = 'floor'\n"
    );
    for i in 0..100 {
        let (x, z) = (f64::from(i % 10) - 4.5, f64::from(i / 10) - 4.5);
        text += &format!(
            "[[object]]\nshape = {{ sphere = {{ center = [{x}, 0.45, {z}], radius = 0.4 }} }}\nmaterial = 'ball'\n"
        );
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("balls.toml");
    std::fs::write(&path, text).unwrap();
    let loaded = scene_file::load(&path, &LoadOptions::default());
    loaded.unwrap_or_else(|fault| panic!("{fault}")).scene
}

/// Returns the profiles of renders of the scenes, by turns: one vector per scene.
fn profiles<const N: usize>(scenes: [Scene; N]) -> [Vec<RenderProfile>; N] {
    let settings = RenderSettings {
        width: WIDTH,
        height: WIDTH / 4 * 3,
        spp: SPP,
        ledger: true,
        ..RenderSettings::default()
    };
    let build = |scene| accel::build(scene, Backend::default(), &AccelOptions::default()).unwrap();
    let accels = scenes.each_ref().map(|scene| build(scene.validate().unwrap()));
    let mut profiles = [const { Vec::new() }; N];
    for _ in 0..ROUNDS {
        for ((scene, accel), profiles) in scenes.iter().zip(&accels).zip(&mut profiles) {
            let (scene, camera) = (scene.validate().unwrap(), &scene.cameras[0]);
            let rendering = render(scene, camera, &**accel, &settings, &Monitor::default());
            profiles.push(rendering.unwrap().ledger);
        }
    }
    profiles
}

/// Returns the nanoseconds by which a render takes longer than one without some rays, per such ray.
fn price(with: &RenderProfile, without: &RenderProfile, rays: u64) -> f64 {
    1e9 * (with.seconds - without.seconds) / rays as f64
}

/// Prints a price and that of the plainest ray, and holds their ratio against a limit.
fn print(limits: &mut Limits, name: &str, pairs: impl Iterator<Item = [f64; 2]> + Clone, limit: f64) {
    let [price, plain] = [0, 1].map(|side| Quartiles::compute(pairs.clone().map(|pair| pair[side])));
    let ratio = Quartiles::compute(pairs.map(|[price, plain]| price / plain));
    let verdict = limits.at_most(ratio.median, limit);
    println!("{name}: {price:.0} ns over {plain:.0} ns, {ratio:.2}, {verdict}");
}

/// Renders all pairs of scenes, and prints the ratios of their prices.
pub(crate) fn run(limits: &mut Limits) {
    one_thread().install(|| {
        lobes(limits);
        area_lights(limits);
        dispersion(limits);
        mipmaps(limits);
    });
}

fn lobes(limits: &mut Limits) {
    let dull = "base_color = 0.5\nmetallic = 0\nroughness = 1";
    let mirror = "base_color = 0.9\nmetallic = 1\nroughness = 0";
    let rough = "base_color = 0.9\nmetallic = 1\nroughness = 0.3\nrough_rays = 4";
    let [dull, mirror, rough] = profiles([dull, mirror, rough].map(|material| balls(material, "")));
    let pairs = dull
        .iter()
        .zip(&mirror)
        .zip(&rough)
        .map(|((dull, mirror), rough)| {
            [
                price(rough, dull, rough.rough_rays()),
                price(mirror, dull, mirror.reflection_rays()),
            ]
        });
    print(limits, "lobe's ray over mirror ray", pairs, MAX_LOBE);
}

fn area_lights(limits: &mut Limits) {
    let dull = "base_color = 0.5\nmetallic = 0\nroughness = 1";
    let point = "[[light]]\nkind = 'point'\nposition = [0, 6, 3]\nintensity = 40";
    let area = "[[light]]\nkind = 'quad'\nposition = [0, 6, 3]\nu = [1, 0, 0]\nv = [0, 0, 1]\nintensity = 40\nsamples = 4";
    let [dark, point, area] = profiles(["", point, area].map(|light| balls(dull, light)));
    let pairs = dark.iter().zip(&point).zip(&area).map(|((dark, point), area)| {
        [
            price(area, dark, area.shadow_rays()),
            price(point, dark, point.shadow_rays()),
        ]
    });
    print(
        limits,
        "area light's point over point light",
        pairs,
        MAX_AREA_LIGHT,
    );
}

fn dispersion(limits: &mut Limits) {
    let dull = "base_color = 0.5\nmetallic = 0\nroughness = 1";
    let plain = "ior = 1.7\ntransmission = 1\nroughness = 0";
    let dispersive = "glass = 'n-sf10'\ntransmission = 1\nroughness = 0";
    let [dull, plain, dispersive] = profiles([dull, plain, dispersive].map(|material| balls(material, "")));
    let rays = |profile: &RenderProfile| profile.refraction_rays() + profile.reflection_rays();
    let pairs = dull
        .iter()
        .zip(&plain)
        .zip(&dispersive)
        .map(|((dull, plain), dispersive)| {
            [
                price(dispersive, dull, rays(dispersive)),
                price(plain, dull, rays(plain)),
            ]
        });
    print(
        limits,
        "ray in dispersive over one in plain glass",
        pairs,
        MAX_DISPERSION,
    );
}

fn mipmaps(limits: &mut Limits) {
    let linear = "image = 'fine.png'\nfilter = 'linear'";
    let [linear, mipmapped] = profiles(
        [linear, checkerboards::MIPMAPPED].map(|texture| checkerboards::scene(texture, checkerboards::EMPTY)),
    );
    let sample = |profile: &RenderProfile| 1e9 * profile.seconds / profile.camera_rays() as f64;
    let pairs = mipmapped
        .iter()
        .zip(&linear)
        .map(|(mipmapped, linear)| [sample(mipmapped), sample(linear)]);
    print(
        limits,
        "sample of a mipmapped over a bilinear floor",
        pairs,
        MAX_MIPMAP,
    );
}
