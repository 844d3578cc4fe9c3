//! Soft light in whole renders: lights with an extent, environment maps and lenses against what is known in closed
//! form.
//!
//! Estimates are compared in standard errors, estimated from the spread of the pixels: their samples are independent.

use std::f64::consts::PI;

use crate::support::images::{add, estimate, render_image, settings};
use glam::{DAffine3, DMat3, DVec3};
use whit::accel::Backend;
use whit::image::LinearImage;
use whit::render::RenderSettings;
use whit::scene::{
    Aperture, AreaShape, Background, Camera, Effect, Geometry, Image, Lens, Light, LightKind, Material,
    Model, Phong, Projection, Scene, Texels,
};
use whit::shape::{Shape, Sphere};

/// Standard errors that an estimate may be off: of a hundred estimates none is likely to be.
const ERRORS: f64 = 4.0;
/// Relative error of single precision through a dozen operations.
const ROUNDING: f64 = 16.0 / 16_777_216.0;

fn matte() -> Material {
    Material {
        model: Model::Phong(Phong::DEFAULT),
        ..Material::default()
    }
}

/// Objects of one material each.
fn scene(objects: Vec<(Shape, Material, DAffine3)>, lights: Vec<Light>) -> Scene {
    let mut scene = Scene {
        lights,
        ..Scene::default()
    };
    for (shape, material, place) in objects {
        add(&mut scene, "object", Geometry::Shape(shape), material, place);
    }
    scene
}

fn area_light(shape: AreaShape, samples: u32) -> Light {
    Light {
        name: "lamp".into(),
        intensity: [2.0; 3],
        kind: LightKind::Area { shape, samples },
    }
}

/// A matte floor z = 0.
fn floor() -> (Shape, Material, DAffine3) {
    (Shape::Plane, matte(), DAffine3::IDENTITY)
}

/// Sees about one point of the floor, from a little above.
fn close_look() -> Camera {
    camera(
        DVec3::new(0.0, 0.0, 0.5),
        Projection::Orthographic {
            y_mag: 1e-6,
            x_mag: None,
        },
    )
}

fn camera(place: DVec3, projection: Projection) -> Camera {
    Camera {
        world_from_camera: DAffine3::from_translation(place),
        projection,
        ..Camera::default()
    }
}

fn assert_is_near(what: &str, image: &LinearImage, exact: f64) {
    let (found, error) = estimate(image);
    println!("{what}: {found:.6} ± {error:.6}, exactly {exact:.6}");
    assert!(
        (found - exact).abs() <= ERRORS * error + ROUNDING * exact,
        "{what}: {found} ± {error}, not {exact}"
    );
}

#[test]
fn area_light_irradiance_converges_to_closed_forms() {
    let high = DVec3::new(0.0, 0.0, 3.0);
    let (down_u, down_v) = (DVec3::Y, DVec3::X);
    // At a floor point under the middle, radiance 2. Sphere and disk: π L r² / d², d to the middle or to the rim. The
    // square of half sides 1: four times Lambert's corner rectangle, (a/√(a²+h²)) atan(b/√(a²+h²)) each way.
    let corner = 10f64.sqrt().recip() * (10f64.sqrt().recip()).atan();
    for (shape, exact) in [
        (
            AreaShape::Sphere {
                center: high,
                radius: 1.0,
            },
            2.0 * PI / 9.0,
        ),
        (
            AreaShape::Disk {
                center: high,
                half_u: down_u,
                half_v: down_v,
            },
            2.0 * PI / 10.0,
        ),
        (
            AreaShape::Quad {
                center: high,
                half_u: down_u,
                half_v: down_v,
            },
            2.0 * 4.0 * corner,
        ),
    ] {
        let scene = scene(vec![floor()], vec![area_light(shape, 1)]);
        let mut errors = Vec::new();
        for spp in [16, 256] {
            let image = render_image(&scene, &close_look(), Backend::Bsp, &settings(16, spp));
            assert_is_near(&format!("{shape:?}, {spp}"), &image, exact);
            errors.push(estimate(&image).1);
        }
        // Sixteen times the samples: a quarter of the error if they were unrelated; scrambled points do better.
        assert!(errors[1] < 0.25 * errors[0], "{errors:?}");
    }
}

#[test]
fn flat_lights_emit_to_their_front_only() {
    let shape = AreaShape::Quad {
        center: DVec3::new(0.0, 0.0, 3.0),
        half_u: DVec3::X,
        half_v: DVec3::Y,
    };
    let scene = scene(vec![floor()], vec![area_light(shape, 4)]);
    let image = render_image(&scene, &close_look(), Backend::Bsp, &settings(4, 4));
    assert!(image.pixels.iter().all(|pixel| *pixel == [0.0; 3]));
}

#[test]
fn penumbra_equals_that_of_a_cut_spherical_cap() {
    let (height, radius, above) = (4.0, 1.0, 2.0);
    for edge in [-0.3, 0.0, 0.2, 0.45] {
        // A wall at z = 2 over all x > edge, which the floor point sees up to the plane x = k z.
        let wall = DAffine3::from_translation(DVec3::new(edge + 50.0, 0.0, above))
            * DAffine3::from_scale(DVec3::splat(50.0));
        let shape = AreaShape::Sphere {
            center: DVec3::new(0.0, 0.0, height),
            radius,
        };
        let scene = scene(
            vec![floor(), (Shape::Quad, matte(), wall)],
            vec![area_light(shape, 1)],
        );
        // Nusselt: the irradiance is the radiance times the area of what is seen, put down from the unit sphere onto
        // the floor. The cap is a disk of radius s there; the plane's great circle is half an ellipse x = k / √(1 + k²)
        // √(1 - y²).
        let (k, s): (f64, f64) = (edge / above, radius / height);
        let flat = k / (1.0 + k * k).sqrt();
        let steps = 100_000;
        let area: f64 = (0..steps)
            .map(|i| {
                let y = s * (2.0 * (f64::from(i) + 0.5) / f64::from(steps) - 1.0);
                let half = (s * s - y * y).sqrt();
                half + (flat * (1.0 - y * y).sqrt()).clamp(-half, half)
            })
            .sum::<f64>()
            * 2.0
            * s
            / f64::from(steps);
        for backend in [Backend::Bsp, Backend::default()] {
            let image = render_image(&scene, &close_look(), backend, &settings(16, 64));
            assert_is_near(&format!("edge {edge} {backend}"), &image, 2.0 * area);
        }
    }
}

/// A uniform environment of radiance 1.
fn white() -> (Image, Background) {
    let image = Image {
        name: "white".into(),
        width: 8,
        height: 4,
        texels: Texels::Floats(vec![[1.0; 4]; 32].into()),
    };
    let background = Background::Environment {
        image: 0,
        rotation: 0.3,
        scale: 1.0,
        samples: 2,
    };
    (image, background)
}

#[test]
fn white_diffuse_and_mirror_balls_vanish_in_white_furnace() {
    let ball = |material: Material| {
        let sphere = Sphere {
            center: DVec3::ZERO,
            radius: 1.0,
        };
        let mut scene = scene(
            vec![(Shape::Sphere(sphere), material, DAffine3::IDENTITY)],
            vec![],
        );
        let (image, background) = white();
        scene.images = vec![image];
        scene.background = background;
        scene
    };
    let view = camera(
        DVec3::new(0.0, 0.0, 4.0),
        Projection::Orthographic {
            y_mag: 1.2,
            x_mag: None,
        },
    );
    // The Phong model's rd is π times the albedo.
    let scattering = Material {
        base_color: [PI.recip() as f32; 4],
        ..matte()
    };
    let image = render_image(&ball(scattering), &view, Backend::Bsp, &settings(24, 64));
    assert_is_near("matte", &image, 1.0);
    let mirror = Material::metallic_roughness([1.0; 3], 1.0, 0.0);
    let image = render_image(&ball(mirror), &view, Backend::Bsp, &settings(24, 4));
    for pixel in image.pixels.as_flattened() {
        assert!((f64::from(*pixel) - 1.0).abs() < ROUNDING, "{pixel}");
    }
}

/// A small emissive ball, straight ahead.
fn spark(distance: f64, radius: f64) -> Scene {
    let sphere = Sphere {
        center: DVec3::new(0.0, 0.0, -distance),
        radius,
    };
    let material = Material {
        model: Model::Unlit,
        ..Material::default()
    };
    scene(
        vec![(Shape::Sphere(sphere), material, DAffine3::IDENTITY)],
        vec![],
    )
}

#[test]
fn circle_of_confusion_follows_the_lens_formula() {
    let (lens_radius, focus, size): (f64, f64, u32) = (0.2, 4.0, 64);
    let half_height = 0.5;
    let mut view = camera(
        DVec3::ZERO,
        Projection::Perspective {
            y_fov: 2.0 * (half_height / focus).atan(),
            aspect: None,
        },
    );
    // In the plane of focus a pixel is so large.
    let pixel = 2.0 * half_height / f64::from(size);
    for distance in [3.0, 4.0, 8.0] {
        let ball = 0.005 * distance;
        let scene = spark(distance, ball);
        view.lens = Some(Lens::new(lens_radius, focus, Aperture::Disk).unwrap());
        let image = render_image(&scene, &view, Backend::Bsp, &settings(size, 256));
        // The circle of confusion, in the plane of focus: R |z - f| / z.
        let blur = lens_radius * (distance - focus).abs() / distance;
        let seen = ball * focus / distance;
        let (mut sum, mut second, mut farthest) = (0.0, 0.0, 0.0f64);
        for (index, value) in image.pixels.iter().enumerate() {
            let place = |i: u32| (f64::from(i) + 0.5) * pixel - half_height;
            let (x, y) = (place(index as u32 % size), place(index as u32 / size));
            let light = f64::from(value[1]);
            sum += light;
            second += light * (x * x + y * y);
            if light > 0.0 {
                farthest = farthest.max(x.hypot(y));
            }
        }
        // A disk's mean squared distance is half its squared radius; of the sum of independent ones the sum; a pixel's
        // is pixel²/6.
        let expected = 0.5 * (blur * blur + seen * seen) + pixel * pixel / 6.0;
        let found = second / sum;
        println!(
            "{distance}: mean square {found:.3e}, by the formula {expected:.3e}, farthest {farthest:.4} of {blur:.4}"
        );
        assert!(
            (found / expected - 1.0).abs() < 0.06,
            "{distance}: {found}, not {expected}"
        );
        assert!(
            farthest <= blur + seen + pixel,
            "{distance}: {farthest}, not {blur}"
        );
        assert!(farthest >= blur - pixel, "{distance}: {farthest}, not {blur}");
    }
}

/// Everything at once: three lights, a map, a lens, balls in each other's shadows.
fn everything() -> (Scene, Camera) {
    let ball = |x: f64, material: Material| {
        let sphere = Sphere {
            center: DVec3::new(x, 0.3 * x, 0.8),
            radius: 0.7,
        };
        (Shape::Sphere(sphere), material, DAffine3::IDENTITY)
    };
    let center = DVec3::new(1.0, 2.0, 4.0);
    let lights = vec![
        area_light(AreaShape::Sphere { center, radius: 0.5 }, 2),
        area_light(
            AreaShape::Quad {
                center: -center.with_z(-5.0),
                half_u: DVec3::Y,
                half_v: DVec3::X,
            },
            1,
        ),
    ];
    let glass = Material {
        interior: Some(whit::scene::Medium {
            ior: whit::optics::Dispersion::Constant(1.5),
            absorption: whit::optics::Absorption::NONE,
            priority: 0,
            kind: whit::scene::MediumKind::Solid,
        }),
        model: Model::MetallicRoughness(whit::scene::MetallicRoughness {
            metallic: 0.0,
            roughness: 0.0,
            transmission: 1.0,
            ..whit::scene::MetallicRoughness::DEFAULT
        }),
        ..Material::default()
    };
    let objects = vec![
        floor(),
        ball(-1.2, matte()),
        ball(0.4, glass),
        ball(2.0, Material::metallic_roughness([0.9, 0.7, 0.4], 1.0, 0.05)),
    ];
    let mut scene = scene(objects, lights);
    let (image, background) = white();
    scene.images = vec![image];
    scene.background = background;
    let axes = DMat3::from_rotation_x(0.9);
    let view = Camera {
        world_from_camera: DAffine3::from_mat3_translation(axes, DVec3::new(0.3, -5.0, 4.0)),
        lens: Some(
            Lens::new(
                0.1,
                6.0,
                Aperture::Polygon {
                    blades: 6,
                    rotation: 0.1,
                },
            )
            .unwrap(),
        ),
        ..camera(
            DVec3::ZERO,
            Projection::Perspective {
                y_fov: 0.7,
                aspect: None,
            },
        )
    };
    (scene, view)
}

#[test]
fn image_bits_do_not_depend_on_threads_or_sample_callback() {
    let (scene, view) = everything();
    for spp in [1, 4, 20] {
        let settings = settings(40, spp);
        let by = |threads: usize, settings: &RenderSettings| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.unwrap()
                .install(|| render_image(&scene, &view, Backend::Bsp, settings).pixels)
        };
        let one = by(1, &settings);
        assert!(one == by(3, &settings), "{spp}");
        let watched = RenderSettings {
            sample_aovs: true,
            ..settings
        };
        assert!(one == by(2, &watched), "{spp}");
    }
}

#[test]
fn backends_agree_on_soft_shadows() {
    let (scene, view) = everything();
    let settings = settings(40, 16);
    let [a, b] = [Backend::Bsp, Backend::default()].map(|b| render_image(&scene, &view, b, &settings).pixels);
    let differ = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).any(|c| (a[c] - b[c]).abs() > 1e-3 * (1.0 + a[c]));
    let different = a.iter().zip(&b).filter(|pair| differ(*pair)).count();
    // Where a ray just hits an edge or misses it, one sample of 16 is another's.
    println!("{different} of {} pixels differ", a.len());
    assert!(different * 50 <= a.len(), "{different} of {}", a.len());
}

#[test]
fn zero_lens_and_dark_lights_trace_no_rays() {
    let (mut scene, mut view) = everything();
    view.lens = Some(Lens::new(0.0, 6.0, Aperture::Disk).unwrap());
    for light in &mut scene.lights {
        light.intensity = [0.0; 3];
    }
    scene.background = Background::default();
    let plan = whit::render::Plan::new(&scene, &view, &whit::scene::EffectOverrides::default());
    for effect in [Effect::DepthOfField, Effect::AreaLight, Effect::Environment] {
        assert!(!plan.effects().has(effect), "{effect}");
    }
}
