//! Tests of the reference tracer: images small enough to be computed by hand.

use glam::{DAffine3, DVec3, Vec3};
use whit::mesh::Mesh;
use whit::scene::{
    Background, Falloff, Filter, Geometry, Image, LightKind, Material, MaterialInput, Sampler, Scene, Texels,
    Texture, TextureBinding, TextureUse, Wrap,
};
use whit::shading::LobeAlbedo;
use whit::shape::{Shape, Sphere};

use super::approx::{Approx, Approx3, ROUNDING};
use super::cones::Cone;
use super::hits::{Decision, Doubt, Ray, World};
use super::meshes::{Shading, ball, rectangle};
use super::texels::srgb;
use super::textbook::{Pixel, Request, reference_image};
use super::wave_scenes::{
    add_geometry, add_material, camera, light, matte, metal, moved, perspective, place,
};

/// Request for an image of one pixel.
const SINGLE: Request = Request {
    width: 1,
    height: 1,
    spp: 1,
    depth: 0,
    weight_cutoff: 0.0,
    wavelengths: 1,
};

/// Tolerance: roundings of the camera ray to f32 move the hit, by a few 2^-24 of any result.
const HAND: f64 = 16.0 * ROUNDING;

fn pixel(scene: &Scene, request: Request) -> Pixel {
    reference_image(scene, &scene.cameras[0], request)[0]
}

fn assert_radiance(scene: &Scene, request: Request, expected: [f64; 3]) {
    let radiance = pixel(scene, request).radiance.value();
    let expected = DVec3::from(expected);
    let allowed = HAND * expected.max(DVec3::splat(ROUNDING));
    assert!(
        (radiance - expected).abs().cmple(allowed).all(),
        "{radiance} is not {expected}"
    );
}

/// Returns a square of side 2 in the plane z = 0, seen head-on from (0, 0, 2).
fn square_seen_from_two_metres(material: Material) -> Scene {
    let mut scene = Scene::default();
    let material = add_material(&mut scene, material);
    let square = add_geometry(&mut scene, Geometry::Mesh(rectangle(2.0, 2.0)));
    // Offset the square, so that the ray does not run along the diagonal.
    place(&mut scene, square, material, moved(0.3, 0.1, 0.0));
    scene.cameras = vec![head_on()];
    scene
}

fn head_on() -> whit::scene::Camera {
    let mut camera = camera([0.0, 0.0, 2.0], [0.0; 3], perspective(0.1));
    camera.world_from_camera = moved(0.0, 0.0, 2.0);
    camera
}

fn light_at(scene: &mut Scene, position: DVec3, candela: f32) {
    let kind = LightKind::Point {
        position,
        falloff: Falloff::PHYSICAL,
    };
    scene.lights.push(light([candela; 3], kind));
}

#[test]
fn white_dielectric_reflects_all_ambient_light() {
    let mut scene = Scene::default();
    let white = add_material(&mut scene, matte([1.0; 3], 1.0));
    let smooth = add_geometry(&mut scene, Geometry::Mesh(ball(2, Shading::Smooth)));
    place(&mut scene, smooth, white, DAffine3::IDENTITY);
    scene.ambient = [1.0; 3];
    scene.background = Background::Uniform([0.5; 3]);
    scene.cameras = vec![camera([0.3, 0.2, 4.0], [0.0; 3], perspective(0.7))];
    let request = Request {
        width: 16,
        height: 16,
        ..SINGLE
    };
    let (mut on, mut beside) = (0, 0);
    for pixel in reference_image(&scene, &scene.cameras[0], request) {
        // c_diff (1 - a) + a = 1, where a is the albedo of the lobe.
        let is_lit = (pixel.radiance.x.value - 1.0).abs() < HAND;
        let empty = pixel.radiance.x.value == 0.5;
        assert!(is_lit || empty, "{:?}", pixel.radiance);
        on += i32::from(is_lit);
        beside += i32::from(empty);
    }
    assert!(on > 50 && beside > 50, "{on} {beside}");
}

#[test]
fn white_furnace_hides_a_perfect_mirror() {
    let mut scene = Scene::default();
    let silver = add_material(&mut scene, metal([1.0; 3], 0.0));
    let sphere = add_geometry(&mut scene, Geometry::Shape(Shape::Sphere(Sphere::UNIT)));
    place(
        &mut scene,
        sphere,
        silver,
        DAffine3::from_scale(DVec3::new(1.0, 0.7, 0.9)),
    );
    scene.ambient = [1.0; 3];
    scene.background = Background::Uniform([1.0; 3]);
    scene.cameras = vec![camera([0.3, 0.2, 4.0], [0.0; 3], perspective(0.7))];
    let request = Request {
        width: 16,
        height: 16,
        depth: 1,
        ..SINGLE
    };
    for pixel in reference_image(&scene, &scene.cameras[0], request) {
        // f0 = 1, so Fs = 1 at every angle.
        assert!((pixel.radiance.value() - DVec3::ONE).abs().max_element() < HAND);
    }
}

#[test]
fn frontal_light_gives_only_lambert_on_a_polished_square() {
    // alpha = 0 leaves no lobe: (1 - F) base / π · I / d² with F = f0 = 0.04, I = 8π, d² = 4 and cos = 1.
    let mut scene = square_seen_from_two_metres(matte([1.0, 0.5, 0.25], 0.0));
    light_at(
        &mut scene,
        DVec3::new(0.0, 0.0, 2.0),
        (8.0 * std::f64::consts::PI) as f32,
    );
    assert_radiance(&scene, SINGLE, [1.92, 0.96, 0.48]);
}

#[test]
fn frontal_light_adds_the_specular_lobe_on_a_rough_square() {
    // alpha = 1: D = 1/π, V = 1/((1 + 1)(1 + 1)) = 1/4, F D V = 0.04/(4π) = 0.01/π, over an irradiance of 2π. Multiple
    // scattering raises it by 1 + 0.04 (1 - E) / E, about 1.09, as E = 0.307.
    let lobe = 0.02 * (1.0 + 0.04 * LobeAlbedo::evaluate(1.0, 1.0).loss);
    let mut scene = square_seen_from_two_metres(matte([1.0, 0.5, 0.25], 1.0));
    light_at(
        &mut scene,
        DVec3::new(0.0, 0.0, 2.0),
        (8.0 * std::f64::consts::PI) as f32,
    );
    assert_radiance(&scene, SINGLE, [1.92 + lobe, 0.96 + lobe, 0.48 + lobe]);
}

#[test]
fn light_at_45_degrees_gives_cosine_and_schlick_terms() {
    let mut scene = square_seen_from_two_metres(matte([1.0; 3], 0.0));
    light_at(&mut scene, DVec3::new(2.0, 0.0, 2.0), 1.0);
    // h halves the angle of 45°: V·H = cos 22.5°. d² = 8, cos 45°.
    let f = 0.04 + 0.96 * (1.0 - 22.5f64.to_radians().cos()).powi(5);
    let expected = (1.0 - f) / std::f64::consts::PI / 8.0 * 0.5f64.sqrt();
    assert_radiance(&scene, SINGLE, [expected; 3]);
}

#[test]
fn light_behind_a_surface_or_occluder_contributes_nothing() {
    let mut scene = square_seen_from_two_metres(matte([1.0; 3], 0.5));
    light_at(&mut scene, DVec3::new(0.0, 0.0, -2.0), 10.0);
    assert_radiance(&scene, SINGLE, [0.0; 3]);
    let mut scene = square_seen_from_two_metres(matte([1.0; 3], 0.5));
    light_at(&mut scene, DVec3::new(2.0, 0.0, 2.0), 10.0);
    assert!(pixel(&scene, SINGLE).radiance.x.value > 0.01);
    // Add a sphere around the middle of the shadow ray.
    let sphere = Geometry::Shape(Shape::Sphere(Sphere {
        center: DVec3::new(1.0, 0.0, 1.0),
        radius: 0.2,
    }));
    let sphere = add_geometry(&mut scene, sphere);
    place(&mut scene, sphere, 0, DAffine3::IDENTITY);
    assert_radiance(&scene, SINGLE, [0.0; 3]);
}

#[test]
fn spot_and_range_falloff_follow_gltf() {
    let mut scene = square_seen_from_two_metres(matte([1.0; 3], 0.0));
    let lit = |scene: &mut Scene, kind: LightKind| {
        scene.lights = vec![light([std::f32::consts::PI; 3], kind)];
        pixel(scene, SINGLE).radiance.x.value
    };
    let position = DVec3::new(0.0, 0.0, 2.0);
    let full = lit(
        &mut scene,
        LightKind::Point {
            position,
            falloff: Falloff::PHYSICAL,
        },
    );
    // d / range = 1/2: 1 - 1/16.
    let ranged = lit(
        &mut scene,
        LightKind::Point {
            position,
            falloff: Falloff::InverseSquare { range: Some(4.0) },
        },
    );
    assert!((ranged / full - 15.0 / 16.0).abs() < HAND);
    // cos 60° = 1/2 lies a quarter of the way from 0.4 to 0.8: 1/16.
    let spot = LightKind::Spot {
        position,
        direction: DVec3::new(0.75f64.sqrt(), 0.0, -0.5),
        cos_inner: 0.8,
        cos_outer: 0.4,
        falloff: Falloff::PHYSICAL,
    };
    assert!((lit(&mut scene, spot) / full - 1.0 / 16.0).abs() < HAND);
}

/// Returns a mirror at 45° in front of the camera that reflects an emissive wall at the right.
fn tilted_mirror() -> Scene {
    let mut scene = Scene::default();
    let copper = add_material(&mut scene, metal([1.0, 0.5, 0.25], 0.0));
    let emissive = add_material(
        &mut scene,
        Material {
            emission: [2.0, 4.0, 8.0],
            ..matte([0.0; 3], 1.0)
        },
    );
    let square = add_geometry(&mut scene, Geometry::Mesh(rectangle(2.0, 2.0)));
    let quarter = std::f64::consts::FRAC_PI_4;
    // The offsets keep the rays off the diagonals.
    place(
        &mut scene,
        square,
        copper,
        DAffine3::from_rotation_y(quarter) * moved(0.1, 0.3, 0.0),
    );
    place(
        &mut scene,
        square,
        emissive,
        moved(3.0, 0.2, 0.3) * DAffine3::from_rotation_y(-2.0 * quarter),
    );
    scene.cameras = vec![head_on()];
    scene
}

#[test]
fn mirror_at_45_degrees_shows_the_emissive_wall_times_fresnel() {
    let scene = tilted_mirror();
    let grazing = (1.0 - 0.5f64.sqrt()).powi(5);
    let fs = [1.0, 0.5, 0.25].map(|f0| f0 + (1.0 - f0) * grazing);
    let expected = [2.0 * fs[0], 4.0 * fs[1], 8.0 * fs[2]];
    assert_radiance(&scene, Request { depth: 1, ..SINGLE }, expected);
    assert_radiance(&scene, Request { depth: 0, ..SINGLE }, [0.0; 3]);
    // The largest throughput is 1, that of red.
    let cut = |weight_cutoff: f32| Request {
        depth: 1,
        weight_cutoff,
        ..SINGLE
    };
    assert_radiance(&scene, cut(0.99), expected);
    assert_radiance(&scene, cut(1.01), [0.0; 3]);
}

#[test]
fn wrap_modes_and_filters_read_the_texels_of_gltf() {
    // Two texels, red 255 and red 0, seen at u = 1.125, that is 2.25 texels.
    let seen = |wrap: Wrap, filter: Filter| {
        let mut scene = square_seen_from_two_metres(Material {
            emission: [1.0; 3],
            layers: vec![TextureBinding {
                parameter: MaterialInput::Emission,
                texture: TextureUse::new(0),
                strength: 1.0,
            }],
            ..matte([0.0; 3], 1.0)
        });
        let texels = vec![[255, 0, 0, 255], [0, 0, 0, 255]];
        scene.images = vec![Image {
            name: String::new(),
            width: 2,
            height: 1,
            texels: Texels::Bytes(texels.into()),
        }];
        let sampler = Sampler {
            wrap_u: wrap,
            wrap_v: wrap,
            filter,
        };
        scene.textures = vec![Texture::Image { image: 0, sampler }];
        let Geometry::Mesh(mesh) = &mut scene.geometries[0] else {
            unreachable!()
        };
        mesh.tex_coords = vec![vec![[1.125, 0.5]; 4].into()];
        pixel(&scene, SINGLE).radiance.x.value
    };
    assert_eq!(seen(Wrap::Repeat, Filter::Nearest), 1.0);
    assert_eq!(seen(Wrap::MirroredRepeat, Filter::Nearest), 0.0);
    assert_eq!(seen(Wrap::ClampToEdge, Filter::Nearest), 0.0);
    // 2.25 - 0.5 = 1.75: a quarter of texel 1 and three quarters of texel 2, which is red, black, black in turn.
    assert!((seen(Wrap::Repeat, Filter::Linear) - 0.75).abs() < HAND);
    assert_eq!(seen(Wrap::MirroredRepeat, Filter::Linear), 0.0);
    assert_eq!(seen(Wrap::ClampToEdge, Filter::Linear), 0.0);
}

#[test]
fn srgb_curve_is_continuous_and_ends_at_one() {
    assert_eq!(srgb(255), 1.0);
    // 10/255 = 0.0392 is on the line, 11/255 = 0.0431 on the power.
    assert_eq!(srgb(10), 10.0 / 255.0 / 12.92);
    assert!((srgb(11) - ((11.0f64 / 255.0 + 0.055) / 1.055).powf(2.4)).abs() < 1e-17);
    assert!((srgb(128) - 0.215_860_5).abs() < 1e-7);
}

#[test]
fn brute_force_is_doubtful_only_on_edges() {
    let mut scene = Scene::default();
    let chalk = add_material(&mut scene, matte([1.0; 3], 1.0));
    let triangle = Mesh {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].into(),
        triangles: vec![[0, 1, 2]].into(),
        ..Mesh::default()
    };
    let triangle = add_geometry(&mut scene, Geometry::Mesh(triangle));
    let placement = moved(10.0, 10.0, 0.0) * DAffine3::from_scale(DVec3::new(2.0, -1.0, 3.0));
    place(&mut scene, triangle, chalk, placement);
    let world = World::new(&scene);
    let query_at = |x: f64, y: f64| {
        let ray = Ray {
            origin: Approx3::exact([10.0 + x, 10.0 + y, 5.0]),
            direction: Approx3::exact([0.0, 0.0, -2.0]),
            t_near: Approx::ZERO,
            t_far: f64::INFINITY,
            leaves: None,
            cone: Cone::NONE,
        };
        let mut doubt = Doubt::NONE;
        (world.nearest(&ray, &mut doubt), doubt)
    };
    let (found, doubt) = query_at(0.5, -0.25);
    let found = found.unwrap();
    assert!(!doubt.may_flip());
    // The object's (0.25, 0.25), at 5 of a direction of length 2.
    assert_eq!([found.t, found.u, found.v].map(|a| a.value), [2.5, 0.25, 0.25]);
    let (missed, doubt) = query_at(0.5, 0.25);
    assert!(missed.is_none() && !doubt.may_flip());
    // At a distance of 10, f32 cannot resolve 1e-9.
    let (_, doubt) = query_at(0.3, -1e-9);
    assert_eq!((doubt.may_flip(), doubt.decision), (true, Decision::Nearest));
    let (found, doubt) = query_at(0.3, -1e-4);
    assert!(found.is_some() && !doubt.may_flip());
}

#[test]
fn error_bounds_contain_f32_results() {
    // Evaluate the lobe's peak at 1000 angles ever nearer to it, where it is worst conditioned.
    for step in 0..1000 {
        let angle = 0.5 * 0.99f64.powi(step);
        let (n, w) = (
            Vec3::new(0.0, 0.0, 1.0),
            Vec3::new(angle.sin() as f32, 0.1, angle.cos() as f32),
        );
        let h = w.normalize();
        let width = n.dot(h) * n.dot(h) * (0.01 - 1.0) + 1.0;
        let peak = 0.01 / (std::f32::consts::PI * width * width);
        let h = Approx3::exact(w.as_dvec3()).normalize();
        let cos = Approx3::exact(n.as_dvec3()).dot(h);
        let a2 = Approx::rounded(0.01);
        let width = cos.squared() * (a2 - Approx::ONE) + Approx::ONE;
        let bounded = a2 / (Approx::rounded(std::f64::consts::PI) * width.squared());
        let off = (f64::from(peak) - bounded.value).abs();
        assert!(
            off <= bounded.error,
            "angle {angle}: off by {off}, bound {}",
            bounded.error
        );
        assert!(bounded.error < 1e-3 * bounded.value, "angle {angle}: {bounded:?}");
    }
}
