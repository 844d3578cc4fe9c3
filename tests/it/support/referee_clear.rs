//! Tests of the reference tracer's transmission: images small enough to be computed by hand.

use glam::{DAffine3, DVec3};
use whit::optics::{Absorption, Dispersion};
use whit::scene::{
    AlphaMode, Background, Geometry, LightKind, Material, Medium, MediumKind, Model, Phong, Scene,
};
use whit::shape::{Shape, Sphere};

use super::approx::{Approx, Approx3, ROUNDING};
use super::bodies::{Bodies, Incidence};
use super::hits::Doubt;
use super::meshes::{Shading, ball, cube, inverted, prism, rectangle};
use super::textbook::{Request, reference_image};
use super::wave_scenes::{add_geometry, add_material, camera, light, matte, moved, perspective, place};

/// Tolerance of a few f32 roundings: those of the camera ray move the hit.
const HAND: f64 = 64.0 * ROUNDING;

fn seen(scene: &Scene, depth: u32) -> DVec3 {
    let request = Request {
        width: 1,
        height: 1,
        spp: 1,
        depth,
        weight_cutoff: 0.0,
        wavelengths: 1,
    };
    reference_image(scene, &scene.cameras[0], request)[0]
        .radiance
        .value()
}

fn assert_close(found: DVec3, expected: [f64; 3]) {
    let off = (found - DVec3::from(expected)).abs().max_element();
    assert!(off < HAND, "{found} is not {expected:?}");
}

/// Returns a dielectric with Fresnel's equations and absorption `sigma_a`, without emission.
fn glass(sigma_a: f64) -> Material {
    Material {
        model: Model::Phong(Phong {
            ambient: [0.0; 3],
            diffuse: [0.0; 3],
            reflection: [1.0; 3],
            transmission: [1.0; 3],
            fresnel: true,
            ..Phong::DEFAULT
        }),
        interior: Some(Medium {
            ior: Dispersion::Constant(1.5),
            absorption: Absorption {
                sigma_a: [sigma_a; 3],
            },
            priority: 0,
            kind: MediumKind::Solid,
        }),
        ..Material::default()
    }
}

/// Returns a cube of side 2 seen head-on from (0, 0, 5) against white.
fn cube_before_white(material: Material) -> Scene {
    let mut scene = Scene::default();
    let material = add_material(&mut scene, material);
    let cube = add_geometry(&mut scene, Geometry::Mesh(cube()));
    place(&mut scene, cube, material, moved(0.3, 0.1, 0.0));
    let mut camera = camera([0.0, 0.0, 5.0], [0.0; 3], perspective(0.1));
    camera.world_from_camera = moved(0.0, 0.0, 5.0);
    scene.cameras = vec![camera];
    scene.background = Background::Uniform([1.0; 3]);
    scene
}

#[test]
fn clear_cube_shows_white_minus_truncated_light() {
    // R = 0.04: reflected 0.04, and 0.96² (1 + R² + R⁴ + ...) through or back. Depth 2 sees 0.04 + 0.96².
    assert_close(seen(&cube_before_white(glass(0.0)), 2), [0.04 + 0.9216; 3]);
    assert_close(seen(&cube_before_white(glass(0.0)), 40), [1.0; 3]);
    // Two metres of it.
    let left = (-0.5f64).exp();
    assert_close(
        seen(&cube_before_white(glass(0.25)), 2),
        [0.04 + 0.9216 * left; 3],
    );
}

#[test]
fn constant_coefficients_and_thin_panes_split_light_as_stated() {
    let mut constant = glass(0.0);
    let Model::Phong(model) = &mut constant.model else {
        unreachable!()
    };
    (model.reflection, model.transmission, model.fresnel) = ([0.125; 3], [0.5; 3], false);
    // kr + kt².
    assert_close(seen(&cube_before_white(constant), 2), [0.375; 3]);
    let mut pane = glass(3.0);
    pane.interior.as_mut().unwrap().kind = MediumKind::ThinSlab;
    // Of each of two panes 12/13 pass and 1/13 is reflected: 1/13 + (12/13)², nothing absorbed.
    assert_close(seen(&cube_before_white(pane), 2), [1.0 / 13.0 + 144.0 / 169.0; 3]);
}

#[test]
fn half_covering_cube_hides_half_of_the_background() {
    let half = Material {
        base_color: [0.0, 0.0, 0.0, 0.5],
        alpha: AlphaMode::Blend,
        ..matte([0.0; 3], 1.0)
    };
    // Front and back.
    assert_close(seen(&cube_before_white(half.clone()), 0), [0.25; 3]);
    let cut = |cutoff: f32| Material {
        alpha: AlphaMode::Mask(cutoff),
        ..half.clone()
    };
    assert_close(seen(&cube_before_white(cut(0.51)), 0), [1.0; 3]);
    assert_close(seen(&cube_before_white(cut(0.5)), 0), [0.0; 3]);
}

#[test]
fn light_behind_glass_is_attenuated() {
    // Add a wall behind the light's position, which is seen past a cube that stands between the wall and the sun alone.
    let mut scene = Scene::default();
    let chalk = add_material(
        &mut scene,
        Material {
            model: Model::Phong(Phong::DEFAULT),
            ..matte([1.0; 3], 1.0)
        },
    );
    let clear = add_material(&mut scene, glass(0.25));
    let wall = add_geometry(&mut scene, Geometry::Mesh(rectangle(9.0, 9.0)));
    let cube = add_geometry(&mut scene, Geometry::Mesh(cube()));
    place(&mut scene, wall, chalk, moved(0.3, 0.1, -2.0));
    let to_light = DVec3::Z;
    scene.lights = vec![light([1.0; 3], LightKind::Directional { to_light })];
    let mut camera = camera([0.0, 0.0, 5.0], [0.0; 3], perspective(0.1));
    camera.world_from_camera = moved(0.0, 0.0, -0.5);
    scene.cameras = vec![camera];
    assert_close(seen(&scene, 0), [1.0; 3]);
    place(&mut scene, cube, clear, moved(0.3, 0.1, 1.0));
    assert_close(seen(&scene, 0), [0.9216 * (-0.5f64).exp(); 3]);
}

#[test]
fn ray_at_60_degrees_refracts_to_28_444937_degrees() {
    let (sin, cos) = 60.0f64.to_radians().sin_cos();
    let incidence = Incidence::new(Approx3::exact([sin, -cos, 0.0]), Approx3::exact([0.0, 1.0, 0.0]));
    let mut doubt = Doubt::NONE;
    let etas = [1.0, 1.0 / 0.55].map(Approx::exact);
    let bent = incidence.refracted(etas, &mut doubt).unwrap().value();
    assert!((bent.x.atan2(-bent.y).to_degrees() - 28.444937144).abs() < 1e-8);
    // Air to glass at 60°: 0.08918671.
    let etas = [1.0, 1.5].map(Approx::exact);
    let division = incidence.at_boundary(etas, &mut doubt);
    assert!((division.reflectance.value - 0.089_186_71).abs() < 1e-8);
    assert!((division.transmittance.value - (1.0 - 0.089_186_71)).abs() < 1e-8);
    // And from glass to air, where the critical angle is 41.8°, all is reflected.
    let etas = [1.5, 1.0].map(Approx::exact);
    assert!(incidence.refracted(etas, &mut doubt).is_none());
    assert!(incidence.at_boundary(etas, &mut doubt).is_total);
}

#[test]
fn interiors_at_a_point_follow_winding_numbers() {
    let mut scene = Scene::default();
    let [a, b] = [0, 1].map(|priority| {
        let mut material = glass(0.0);
        material.interior.as_mut().unwrap().priority = priority;
        add_material(&mut scene, material)
    });
    let sphere = add_geometry(&mut scene, Geometry::Shape(Shape::Sphere(Sphere::UNIT)));
    let hollow = add_geometry(&mut scene, Geometry::Mesh(inverted(ball(1, Shading::Flat))));
    let prism = add_geometry(&mut scene, Geometry::Mesh(prism()));
    // A hollow ball of `a`, and of `b` a prism in the hollow and a mirrored one across the wall.
    place(&mut scene, sphere, a, DAffine3::IDENTITY);
    place(&mut scene, hollow, a, DAffine3::from_scale(DVec3::splat(0.7)));
    place(&mut scene, prism, b, DAffine3::from_scale(DVec3::splat(0.2)));
    place(
        &mut scene,
        prism,
        b,
        moved(0.95, 0.0, 0.0) * DAffine3::from_scale(DVec3::new(-0.2, 0.2, 0.2)),
    );
    let present = |x: f64, y: f64| Bodies::around(&scene, DVec3::new(x, y, 0.0)).present(&scene);
    assert_eq!(present(0.0, 0.9), Some(a));
    assert_eq!(present(0.0, 0.5), None);
    assert_eq!(present(0.0, 0.0), Some(b));
    assert_eq!(present(0.95, 0.0), Some(b));
    assert_eq!(present(1.03, 0.0), Some(b));
    assert_eq!(present(2.0, 0.0), None);
}
