//! Objects whose emission lights the scene, against lights of the same extent and against closed forms.
//!
//! Estimates are compared in standard errors, estimated from the spread of the pixels: their samples are independent.

use std::f64::consts::PI;

use crate::support::emissive_scenes::{
    EMISSION, ERRORS, assert_is_near, ball, emissive_material, lambert, look_at, matte, skew, square,
    under_emissive_object, under_light, up,
};
use crate::support::images::{add, estimate, render_image, rendered_by, settings};
use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3Swizzles};
use whit::accel::{AccelOptions, Backend, Precision};
use whit::mesh::Mesh;
use whit::render::{Plan, RenderSettings};
use whit::scene::{
    AlphaMode, AreaShape, Camera, Effect, EffectOverrides, Encoding, Filter, Geometry, Image, Instance,
    Material, MaterialInput, Model, Phong, Sampler, Scene, Texels, Texture, TextureBinding, TextureUse, Wrap,
};
use whit::shape::{Cylinder, Shape, Sphere, Torus};
use whit::volume::Fog;

#[test]
fn emissive_square_mesh_matches_quad_light_and_lambert_formula() {
    for place in [up(3.0), skew()] {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| place.transform_point3(DVec3::new(x, y, 0.0)));
        let exact = lambert(&corners, f64::from(EMISSION));
        let [half_u, half_v] = [DVec3::X, DVec3::Y].map(|axis| place.transform_vector3(axis));
        let center = place.translation;
        let is_above = half_u.cross(half_v).dot(center) > 0.0;
        let (half_u, half_v) = if is_above {
            (half_v, half_u)
        } else {
            (half_u, half_v)
        };
        let light = under_light(
            AreaShape::Quad {
                center,
                half_u,
                half_v,
            },
            1,
        );
        let view = look_at(DVec3::ZERO, 1e-6);
        let sampled = render_image(&light, &view, Backend::Bsp, &settings(16, 64));
        assert_is_near("light", &sampled, exact);
        for (name, geometry) in [
            ("mesh", Geometry::Mesh(square())),
            ("quad", Geometry::Shape(Shape::Quad)),
        ] {
            let scene = under_emissive_object(geometry, place, 1);
            for backend in [Backend::Bsp, Backend::default()] {
                let image = render_image(&scene, &view, backend, &settings(16, 64));
                assert_is_near(&format!("{name} {backend}"), &image, exact);
            }
        }
        // Converged: 2^20 points.
        let scene = under_emissive_object(Geometry::Mesh(square()), place, 16);
        let image = render_image(&scene, &view, Backend::Bsp, &settings(16, 256));
        let (found, _) = estimate(&image);
        assert!((found / exact - 1.0).abs() < 1e-4, "{found}, not {exact}");
    }
}

#[test]
fn emissive_object_emits_on_both_sides_and_per_instance() {
    let exact = lambert(
        &[(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec3::new(x, y, 3.0)),
        f64::from(EMISSION),
    );
    let turned = up(3.0) * DAffine3::from_rotation_x(PI);
    let view = look_at(DVec3::ZERO, 1e-6);
    for place in [up(3.0), turned] {
        for shape in [Geometry::Mesh(square()), Geometry::Shape(Shape::Quad)] {
            let image = render_image(
                &under_emissive_object(shape, place, 1),
                &view,
                Backend::Bsp,
                &settings(16, 64),
            );
            assert_is_near("one side", &image, exact);
        }
    }
    // The second one looks at the floor from over the first one's back, shifted by its width.
    let mut twice = under_emissive_object(Geometry::Mesh(square()), up(3.0), 1);
    let beside = DAffine3::from_translation(DVec3::new(2.0, 0.0, 3.0))
        * DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    twice
        .instances
        .push(Instance::new("second", 1, 1, beside).unwrap());
    twice.add_emissive_light(2, 1).unwrap();
    let both = lambert(
        &[(-1.0, -1.0), (3.0, -1.0), (3.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec3::new(x, y, 3.0)),
        f64::from(EMISSION),
    );
    for backend in [Backend::Bsp, Backend::default()] {
        let image = render_image(&twice, &view, backend, &settings(16, 64));
        assert_is_near("twice", &image, both);
    }
}

#[test]
fn emissive_ball_mesh_matches_sphere_light() {
    let view = look_at(DVec3::ZERO, 1e-6);
    // π L (r / d)².
    let exact = PI * f64::from(EMISSION) / 9.0;
    let round = under_emissive_object(Geometry::Shape(Shape::Sphere(Sphere::UNIT)), up(3.0), 1);
    assert_is_near(
        "sphere",
        &render_image(&round, &view, Backend::Bsp, &settings(16, 64)),
        exact,
    );
    // The mesh's outline lies between the circles of radius 1 and cos² (π / 128): within 2 sin² of the disk.
    let rings: u32 = 64;
    let bound = 2.0 * (PI / f64::from(2 * rings)).sin().powi(2) * exact;
    for place in [
        up(3.0),
        up(3.0) * DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0)),
    ] {
        let scene = under_emissive_object(Geometry::Mesh(ball(rings)), place, 4);
        for backend in [Backend::Bsp, Backend::default()] {
            let image = render_image(&scene, &view, backend, &settings(16, 64));
            let (found, error) = estimate(&image);
            println!("mesh: {found:.6} ± {error:.6}, {exact:.6} - {bound:.6}");
            assert!(found <= exact + ERRORS * error && found >= exact - bound - ERRORS * error);
        }
    }
}

#[test]
fn emissive_shapes_light_like_their_meshes() {
    let view = look_at(DVec3::new(0.4, -0.3, 0.0), 1e-6);
    // The cube is the mesh of its six faces; of the others, closed forms.
    let cube = |place| {
        let corners = |n: DVec3| {
            let (u, v) = (n.zxy(), n.yzx());
            [-u - v, u - v, u + v, v - u].map(|side| DAffine3::transform_point3(&place, n + side))
        };
        let p = DVec3::new(0.4, -0.3, 0.0);
        [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z]
            .into_iter()
            .map(|n| {
                let corners = corners(n);
                let across = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
                let outward = across * across.dot(corners[0] - place.translation).signum();
                let is_seen = outward.dot(p - corners[0]) > 0.0;
                let seen = corners.map(|corner| corner - p);
                if is_seen {
                    lambert(&seen, f64::from(EMISSION))
                } else {
                    0.0
                }
            })
            .sum::<f64>()
    };
    // A sphere of half axes 2, 2, 1 over the point: the disk of its outline, of tan² = 4 / (25 - 1), has π L sin².
    let flat = DAffine3::from_translation(DVec3::new(0.4, -0.3, 5.0))
        * DAffine3::from_scale(DVec3::new(2.0, 2.0, -1.0));
    let ellipsoid = PI * f64::from(EMISSION) * 4.0 / 28.0;
    let bodies = [
        (Shape::Cube, up(3.5), cube(up(3.5))),
        (Shape::Cube, up(1.0) * skew(), cube(up(1.0) * skew())),
        (Shape::Sphere(Sphere::UNIT), flat, ellipsoid),
    ];
    for (shape, place, exact) in bodies {
        for backend in [Backend::Bsp, Backend::default()] {
            let scene = under_emissive_object(Geometry::Shape(shape.clone()), place, 4);
            let image = render_image(&scene, &view, backend, &settings(16, 64));
            assert_is_near(&format!("{shape:?}"), &image, exact);
        }
    }
}

#[test]
fn emissive_ring_and_its_mesh_light_equally() {
    let torus = Torus { minor_radius: 0.3 };
    let (around, along) = (48u32, 96u32);
    let at = |i: u32, j: u32| {
        let (sin, cos) = (2.0 * PI * f64::from(i % along) / f64::from(along)).sin_cos();
        let (sin_tube, cos_tube) = (2.0 * PI * f64::from(j % around) / f64::from(around)).sin_cos();
        let rho = 1.0 + torus.minor_radius * cos_tube;
        DVec3::new(rho * cos, rho * sin, torus.minor_radius * sin_tube)
            .as_vec3()
            .to_array()
    };
    let index = |i: u32, j: u32| i % along * around + j % around;
    let faces = (0..along).flat_map(|i| (0..around).map(move |j| (i, j)));
    let triangles = faces.flat_map(|(i, j)| {
        let [a, b, c, d] = [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)];
        [[a, b, c], [a, c, d]]
    });
    let mesh = Mesh {
        positions: (0..along)
            .flat_map(|i| (0..around).map(move |j| at(i, j)))
            .collect::<Vec<_>>()
            .into(),
        triangles: triangles.collect::<Vec<_>>().into(),
        ..Mesh::default()
    };
    let place = up(1.2) * DAffine3::from_rotation_x(0.9);
    let view = look_at(DVec3::new(0.2, 0.1, 0.0), 1e-6);
    let found = [Geometry::Shape(Shape::Torus(torus)), Geometry::Mesh(mesh)].map(|geometry| {
        let image = render_image(
            &under_emissive_object(geometry, place, 4),
            &view,
            Backend::Bsp,
            &settings(16, 64),
        );
        estimate(&image)
    });
    let [(a, a_error), (b, b_error)] = found;
    println!("torus {a:.5} ± {a_error:.5}, mesh {b:.5} ± {b_error:.5}");
    // The mesh is thinner by up to 1 - cos (π / 48) of its tube's radius.
    assert!((a - b).abs() <= ERRORS * a_error.hypot(b_error) + 3e-3 * a);
}

#[test]
fn emissive_objects_cast_soft_shadows_like_area_lights() {
    // A wall at half the height over all x > 0.1.
    let wall =
        DAffine3::from_translation(DVec3::new(50.1, 0.0, 2.0)) * DAffine3::from_scale(DVec3::splat(50.0));
    let (center, radius) = (DVec3::new(0.0, 0.0, 4.0), 1.0);
    let emissive = DAffine3::from_translation(center) * DAffine3::from_rotation_x(0.7);
    let mut light = under_light(AreaShape::Sphere { center, radius }, 2);
    let mut emissive = under_emissive_object(Geometry::Shape(Shape::Sphere(Sphere::UNIT)), emissive, 2);
    for scene in [&mut light, &mut emissive] {
        add(scene, "wall", Geometry::Shape(Shape::Quad), matte(), wall);
    }
    let view = look_at(DVec3::ZERO, 1.5);
    for backend in [Backend::Bsp, Backend::default()] {
        let [a, b] = [&light, &emissive].map(|scene| render_image(scene, &view, backend, &settings(48, 4)));
        // The same points of the same ball; a shadow ray that just hits the wall's edge may differ.
        let differ = a
            .pixels
            .iter()
            .zip(&b.pixels)
            .filter(|(a, b)| (a[1] - b[1]).abs() > 1e-5 * a[1]);
        let different = differ.count();
        let levels: std::collections::BTreeSet<u32> = a.pixels.iter().map(|p| (p[1] * 64.0) as u32).collect();
        println!("{different} pixels differ, {} levels of grey", levels.len());
        assert!(different <= 2 && levels.len() > 16);
        assert!(a.pixels.iter().any(|p| p[1] == 0.0));
    }
}

#[test]
fn emissive_object_never_occludes_its_own_samples() {
    // Seen from a floor under grazing angles, from near and far, at all sizes: the same bits as without shadows.
    let without_shadows: EffectOverrides = "-shadow".parse().unwrap();
    let with_shadows: EffectOverrides = "+shadow".parse().unwrap();
    for (size, offset) in [(1.0, 0.0), (1e-3, 1.0), (300.0, 0.0), (1.0, 500.0)] {
        for turn in [0.0, 0.4, PI / 2.0 - 1e-3] {
            let place = DAffine3::from_scale_rotation_translation(
                DVec3::new(size, -0.3 * size, size),
                DQuat::from_rotation_x(turn),
                DVec3::new(0.3 * size + offset, offset, 1.1 * size),
            );
            for geometry in [
                Geometry::Mesh(square()),
                Geometry::Shape(Shape::Quad),
                Geometry::Shape(Shape::Disk),
                Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
                Geometry::Shape(Shape::Cube),
                Geometry::Shape(Shape::Cylinder(Cylinder { capped: true })),
            ] {
                let mut scene = under_emissive_object(geometry, place, 2);
                // Twice, so that the mesh is no one's own.
                scene
                    .instances
                    .push(Instance::new("below", 1, 1, place * up(-1e4)).unwrap());
                for reach in [size, 100.0 * size] {
                    let view = look_at(DVec3::new(offset, offset, 0.0), reach);
                    for (backend, precision) in [
                        (Backend::Bsp, Precision::Robust),
                        (Backend::default(), Precision::Robust),
                        (Backend::default(), Precision::Fast),
                    ] {
                        let options = AccelOptions {
                            precision,
                            ..AccelOptions::default()
                        };
                        let [dark, bright] = [&with_shadows, &without_shadows].map(|&effects| {
                            let settings = RenderSettings {
                                effects,
                                ..settings(32, 2)
                            };
                            rendered_by(&scene, &view, (backend, &options), &settings).image
                        });
                        assert!(bright.pixels.iter().any(|p| p[1] > 0.0));
                        assert!(
                            dark.pixels == bright.pixels,
                            "{backend} {precision}, size {size}, at {offset}, turned by {turn}, seen over {reach}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn close_occluder_hides_emissive_object() {
    for distance in [1.0, 1e-3, 2e-5] {
        let mut scene = under_emissive_object(Geometry::Mesh(square()), up(3.0), 4);
        let screen = up(3.0 - distance) * DAffine3::from_scale(DVec3::splat(6.0));
        add(&mut scene, "screen", Geometry::Mesh(square()), matte(), screen);
        for backend in [Backend::Bsp, Backend::default()] {
            let image = render_image(&scene, &look_at(DVec3::ZERO, 4.0), backend, &settings(32, 4));
            assert!(
                image.pixels.iter().all(|p| *p == [0.0; 3]),
                "{distance} {backend}"
            );
        }
    }
}

#[test]
fn emission_is_counted_once_by_camera_and_mirrors() {
    let looking_up = Camera {
        world_from_camera: DAffine3::from_mat3_translation(DMat3::from_rotation_x(PI), DVec3::Z),
        ..look_at(DVec3::ZERO, 0.5)
    };
    let white_emitter = Material {
        base_color: [1.0; 4],
        ..emissive_material()
    };
    for geometry in [
        Geometry::Mesh(square()),
        Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
    ] {
        let mut scene = Scene::default();
        let emissive = add(&mut scene, "lamp", geometry, white_emitter.clone(), up(3.0));
        let without_light = render_image(&scene, &looking_up, Backend::Bsp, &settings(16, 4));
        scene.add_emissive_light(emissive, 4).unwrap();
        let lit = render_image(&scene, &looking_up, Backend::Bsp, &settings(16, 4));
        // A convex emissive object does not light itself.
        assert!(without_light.pixels == lit.pixels && lit.pixels.iter().all(|p| *p == [EMISSION; 3]));
        // A mirror below sees the same as without the light.
        let phong = Phong {
            diffuse: [0.0; 3],
            specular: [0.5; 3],
            reflection: [0.5; 3],
            ..Phong::DEFAULT
        };
        let mirrors = [
            Material::metallic_roughness([0.8; 3], 1.0, 0.05),
            Material {
                model: Model::Phong(phong),
                ..Material::default()
            },
        ];
        for mirror in mirrors {
            let mut scene = scene.clone();
            add(
                &mut scene,
                "mirror",
                Geometry::Shape(Shape::Plane),
                mirror,
                DAffine3::IDENTITY,
            );
            let view = look_at(DVec3::ZERO, 0.5);
            let lit = render_image(&scene, &view, Backend::Bsp, &settings(16, 4));
            scene.lights.clear();
            let without_light = render_image(&scene, &view, Backend::Bsp, &settings(16, 4));
            assert!(without_light.pixels == lit.pixels && lit.pixels.iter().all(|p| p[1] > 0.4));
        }
    }
}

#[test]
fn emissive_dome_lights_its_inside_from_all_directions() {
    // Whatever the point and its normal: E = π L.
    let exact = PI * f64::from(EMISSION);
    let place = DAffine3::from_scale(DVec3::splat(4.0));
    let view = look_at(DVec3::new(0.7, 0.3, 0.0), 1e-6);
    let round = under_emissive_object(Geometry::Shape(Shape::Sphere(Sphere::UNIT)), place, 4);
    assert_is_near(
        "sphere",
        &render_image(&round, &view, Backend::Bsp, &settings(16, 64)),
        exact,
    );
    let mesh = under_emissive_object(Geometry::Mesh(ball(16)), place, 4);
    assert_is_near(
        "mesh",
        &render_image(&mesh, &view, Backend::Bsp, &settings(16, 64)),
        exact,
    );
}

#[test]
fn emission_texture_scales_emitted_light() {
    let mut scene = under_emissive_object(Geometry::Mesh(square()), up(3.0), 1);
    // Four texels a side; the left half is white, the right half black.
    let texel = |i: u32| if i % 4 < 2 { [1.0; 4] } else { [0.0, 0.0, 0.0, 1.0] };
    scene.images.push(Image {
        name: "half".into(),
        width: 4,
        height: 4,
        texels: Texels::Floats((0..16).map(texel).collect::<Vec<_>>().into()),
    });
    scene.textures.push(Texture::Image {
        image: 0,
        sampler: Sampler {
            wrap_u: Wrap::ClampToEdge,
            wrap_v: Wrap::ClampToEdge,
            filter: Filter::Nearest,
        },
    });
    scene.materials[1].layers.push(TextureBinding {
        parameter: MaterialInput::Emission,
        texture: TextureUse::new(0),
        strength: 1.0,
    });
    assert_eq!(MaterialInput::Emission.encoding(), Encoding::Srgb);
    let left = [(-1.0, -1.0), (0.0, -1.0), (0.0, 1.0), (-1.0, 1.0)];
    let image = |place: DVec3| render_image(&scene, &look_at(place, 1e-6), Backend::Bsp, &settings(16, 64));
    for place in [DVec3::ZERO, DVec3::X, -2.0 * DVec3::X] {
        let exact = lambert(
            &left.map(|(x, y)| DVec3::new(x, y, 3.0) - place),
            f64::from(EMISSION),
        );
        assert_is_near("half", &image(place), exact);
    }
}

#[test]
fn fog_is_lit_equally_by_emissive_objects_and_lights() {
    let (center, radius) = (DVec3::new(0.0, 0.0, 4.0), 1.0);
    let mut light = under_light(AreaShape::Sphere { center, radius }, 1);
    let mut emissive = under_emissive_object(Geometry::Shape(Shape::Sphere(Sphere::UNIT)), up(4.0), 1);
    for scene in [&mut light, &mut emissive] {
        scene.fog = Some(Fog::new(0.3, [0.9; 3], [0.0; 3], 0.2).unwrap());
    }
    let view = look_at(DVec3::new(0.0, 0.0, 2.0), 2.0);
    let [a, b] = [&light, &emissive].map(|scene| render_image(scene, &view, Backend::Bsp, &settings(16, 4)));
    for (a, b) in a.pixels.iter().zip(&b.pixels) {
        assert!(a[1] > 0.0 && (a[1] - b[1]).abs() < 1e-4 * a[1], "{a:?} {b:?}");
    }
}

#[test]
fn image_bits_are_equal_for_one_two_and_seven_threads() {
    let mut scene = under_emissive_object(Geometry::Mesh(ball(8)), skew(), 2);
    let mirror = Material::metallic_roughness([0.9, 0.7, 0.4], 1.0, 0.05);
    let side =
        DAffine3::from_translation(DVec3::new(-1.0, 0.5, 0.6)) * DAffine3::from_scale(DVec3::splat(0.6));
    add(
        &mut scene,
        "mirror",
        Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
        mirror,
        side,
    );
    let view = look_at(DVec3::new(0.0, 0.0, 6.0), 3.0);
    let by = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.unwrap()
            .install(|| render_image(&scene, &view, Backend::Bsp, &settings(40, 3)).pixels)
    };
    let one = by(1);
    assert!(one == by(2) && one == by(7));
}

#[test]
fn plan_names_emissive_object_and_invalid_ones_are_rejected() {
    let scene = under_emissive_object(Geometry::Shape(Shape::Quad), up(3.0), 1);
    let view = look_at(DVec3::ZERO, 1.0);
    let plan = Plan::new(&scene, &view, &EffectOverrides::default());
    let decision = plan
        .decisions
        .iter()
        .find(|d| d.effect == Effect::AreaLight)
        .unwrap();
    assert!(decision.on);
    assert_eq!(decision.reason, "object `lamp` is an area light");
    // The emissive object is flat, and the floor does not occlude itself.
    assert!(!plan.effects().has(Effect::Shadow));
    let refused = |change: &dyn Fn(&mut Scene)| {
        let mut scene = scene.clone();
        scene.lights.clear();
        change(&mut scene);
        scene.add_emissive_light(1, 1).unwrap_err()
    };
    for (change, words) in [
        (
            &(|s: &mut Scene| s.materials[1].emission = [0.0; 3]) as &dyn Fn(&mut Scene),
            "has no emission",
        ),
        (&|s| s.materials[1].model = Model::Unlit, "has no emission"),
        (&|s| s.materials[1].alpha = AlphaMode::Blend, "transmits light"),
        (
            &|s| s.geometries[1] = Geometry::Shape(Shape::Plane),
            "a plane, polyhedron or quadric",
        ),
        (&|s| s.instances.truncate(1), "does not exist"),
    ] {
        let error = refused(change);
        assert!(error.contains(words), "{error}");
    }
    let mut bad = scene.clone();
    bad.geometries[1] = Geometry::Shape(Shape::Plane);
    assert!(
        bad.validate()
            .unwrap_err()
            .to_string()
            .contains("a plane, polyhedron or quadric")
    );
}
