//! The figures of textbooks on optics, measured on light that the renderer traces through media.
//!
//! Expected values are closed forms written out here, or printed tables; nothing is taken from the code that traces
//! but coefficients of glasses.

use std::f64::consts::{FRAC_PI_3, LN_2, PI};

use glam::{DAffine3, DVec3};
use whit::accel::Backend;
use whit::optics::{Absorption, Dispersion, Sellmeier, SpectralSampler};
use whit::scene::{AlphaMode, Background, Geometry, Instance, Material, Medium, MediumKind, Model, Scene};

use crate::support::optical_bench::{Beam, Bench, backends, glass, ideal, prism, see_scene, slab, square};

/// Tolerance of values that the renderer rounds to f32 a few times: as weights, as radiance, in the image.
const FEW_ROUNDINGS: f64 = 8.0 * f32::EPSILON as f64;
/// Rays that are to be measured leave this far from an axis, in radians: to that f32 is relative.
const NEARLY_LEVEL: f64 = 1e-3;
/// Fraunhofer's lines h, g, F, e, d, C, r, in nanometres.
const LINES: [f64; 7] = [404.66, 435.84, 486.13, 546.07, 587.56, 656.27, 706.52];

/// The unit vector at `angle` radians from +x towards +y.
fn at(angle: f64) -> DVec3 {
    let (sin, cos) = angle.sin_cos();
    DVec3::new(cos, sin, 0.0)
}

fn angle_of(v: DVec3) -> f64 {
    v.y.atan2(v.x)
}

/// Fresnel's reflectances across and along the plane of incidence, by sines and tangents (Hecht, Optics, 4.6).
fn textbook_fresnel(i: f64, ratio: f64) -> [f64; 2] {
    if i == 0.0 {
        let r = (1.0 - ratio) / (1.0 + ratio);
        return [r * r; 2];
    }
    let t = (i.sin() / ratio).asin();
    [
        ((i - t).sin() / (i + t).sin()).powi(2),
        ((i - t).tan() / (i + t).tan()).powi(2),
    ]
}

/// A level interface, glass of index `ior` under it, whose three channels show the reflected light alone, the
/// transmitted alone, and both.
fn divided_by_color(ior: f64, backend: Backend) -> Bench {
    let mut material = glass(ior);
    material.base_color = [0.0, 1.0, 1.0, 1.0];
    if let Model::MetallicRoughness(model) = &mut material.model {
        model.specular_color = [1.0, 0.0, 1.0];
    }
    Bench {
        geometry: Geometry::Mesh(square()),
        place: DAffine3::from_scale(DVec3::new(100.0, 1.0, 100.0)),
        material,
        backend,
        depth: 1,
    }
}

const WHITE: Background = Background::Uniform([1.0; 3]);

/// A ray that comes down on the middle of the level interface at `i` radians from its normal.
fn from_above(i: f64) -> Beam {
    Beam::ray(DVec3::ZERO, DVec3::new(i.sin(), -i.cos(), 0.0), 1.0)
}

/// One that comes up to it from inside the glass.
fn from_below(i: f64) -> Beam {
    Beam::ray(DVec3::ZERO, DVec3::new(i.sin(), i.cos(), 0.0), 1.0)
}

#[test]
fn light_at_60_degrees_is_refracted_to_28_444937() {
    let expected = 28.444937144f64.to_radians();
    for backend in backends() {
        // The normal stands so that the refracted ray is nearly level.
        let inward = expected + NEARLY_LEVEL;
        let bench = Bench {
            geometry: Geometry::Mesh(square()),
            // The front looks against the normal of the way.
            place: DAffine3::from_rotation_z(inward + 0.5 * PI),
            material: ideal(Dispersion::Constant(1.0 / 0.55), 0.0),
            backend,
            depth: 1,
        };
        let exit = bench.exit(Beam::ray(DVec3::ZERO, at(inward - FRAC_PI_3), 3.0));
        let refracted = (inward - angle_of(exit)).to_degrees();
        assert!(
            (refracted - 28.444937144).abs() < 1e-8,
            "{backend:?}: {refracted}"
        );
        assert!(
            (exit.length() - 1.0).abs() < FEW_ROUNDINGS && exit.z.abs() < 1e-12,
            "{exit}"
        );
    }
}

/// The angle in degrees by which a prism of 60 degrees turns a ray that hits it at `i` radians, traced.
fn traced_deviation(n: f64, i: f64, backend: Backend) -> f64 {
    // Bodies turned by this let the ray of least deviation leave nearly level.
    let turn = i - 0.5 * FRAC_PI_3 + NEARLY_LEVEL;
    let (mesh, shape) = prism(FRAC_PI_3);
    let place = DAffine3::from_rotation_z(turn);
    let bench = Bench {
        geometry: Geometry::Mesh(mesh),
        place: place * shape,
        material: ideal(Dispersion::Constant(n), 0.0),
        backend,
        depth: 2,
    };
    // The middle of the left face, whose outward normal is at 150 degrees: light comes from the opposite, turned up by
    // i.
    let target = place.transform_point3(DVec3::new(-(0.5 * FRAC_PI_3).tan(), 0.0, 0.0));
    let incoming = turn - 0.5 * FRAC_PI_3 + i;
    let exit = bench.exit(Beam::ray(target, at(incoming), 3.0));
    assert!((exit.length() - 1.0).abs() < FEW_ROUNDINGS, "{exit}");
    (incoming - angle_of(exit)).to_degrees()
}

#[test]
fn prisms_deviate_every_line_by_its_minimum() {
    // Printed to four decimals.
    let bk7 = [39.8353, 39.5194, 39.1381, 38.8158, 38.6467, 38.4291, 38.3038];
    let sf10 = [65.2179, 63.5158, 61.6690, 60.2582, 59.5690, 58.7350, 58.2838];
    for (glass, table) in [(Sellmeier::BK7, bk7), (Sellmeier::N_SF10, sf10)] {
        for (line, printed) in LINES.into_iter().zip(table) {
            let n = glass.ior(line);
            let i = (0.5 * n).asin();
            let closed = (2.0 * (n * (0.5 * FRAC_PI_3).sin()).asin() - FRAC_PI_3).to_degrees();
            for backend in backends() {
                let traced = traced_deviation(n, i, backend);
                assert!(
                    (traced - closed).abs() < 1e-6,
                    "{line} nm, {backend:?}: {traced}, not {closed}"
                );
                assert!(
                    (traced - printed).abs() < 5.1e-5,
                    "{line} nm, {backend:?}: {traced}"
                );
            }
            let half_a_degree = 0.5f64.to_radians();
            for other in [i - half_a_degree, i + half_a_degree] {
                assert!(
                    traced_deviation(n, other, Backend::Bsp) > closed + 1e-3,
                    "{line} nm"
                );
            }
        }
    }
}

/// The angle in radians by which a prism of 60 degrees turns a ray, by Snell's law at its faces.
fn deviation_by_snell(n: f64, i: f64) -> f64 {
    let inside = FRAC_PI_3 - (i.sin() / n).asin();
    i + (n * inside.sin()).asin() - FRAC_PI_3
}

#[test]
fn flint_prism_disperses_white_light() {
    let i = (0.5 * Sellmeier::N_SF10.ior(587.56)).asin();
    // Yellow leaves at 0.4 radians above the horizon, and all colours above it.
    let turn = i - 0.5 * FRAC_PI_3 + 0.4;
    let incoming = turn - 0.5 * FRAC_PI_3 + i;
    let (mesh, shape) = prism(FRAC_PI_3);
    let place = DAffine3::from_rotation_z(turn);
    let target = place.transform_point3(DVec3::new(-(0.5 * FRAC_PI_3).tan(), 0.0, 0.0));
    for backend in backends() {
        let bench = Bench {
            geometry: Geometry::Mesh(mesh.clone()),
            place: place * shape,
            material: ideal(Dispersion::Sellmeier(Sellmeier::N_SF10), 0.0),
            backend,
            depth: 2,
        };
        let beam = Beam::ray(target, at(incoming), 3.0);
        let height = Background::Gradient {
            horizon: [0.0; 3],
            up: [1.0; 3],
            down: [0.0; 3],
        };
        let seen = bench.see(beam, height)[0];
        // Every wavelength leaves in its own direction and brings its own colour.
        let sampler = SpectralSampler::new(16);
        let mut expected = DVec3::ZERO;
        for (index, color) in sampler.weights().iter().enumerate() {
            let n = Sellmeier::N_SF10.ior(sampler.wavelength(index, 0.5));
            let angle = incoming - deviation_by_snell(n, i);
            expected += angle.sin() * DVec3::from(color.map(f64::from));
        }
        assert!(
            (seen - expected).abs().max_element() < 1e-6,
            "{backend:?}: {seen}, not {expected}"
        );
        // Red is turned least and blue most; what is turned more leaves lower.
        assert!(
            seen.x > seen.y + 0.005 && seen.y > seen.z + 0.02,
            "{backend:?}: {seen}"
        );
        // All wavelengths together are white.
        let white = bench.see(beam, WHITE)[0];
        assert!(
            (white - DVec3::ONE).abs().max_element() < FEW_ROUNDINGS,
            "{white}"
        );
    }
}

/// Angles in degrees between where light comes from and where it goes after `inner` reflections in a drop, over the
/// drop's half section.
fn bow_angles(n: f64, inner: u32, backend: Backend) -> Vec<f64> {
    let direction = DVec3::X;
    let beam = Beam {
        origin: -3.0 * direction + 0.5 * DVec3::Y,
        direction,
        across: DVec3::Y,
        half_width: 0.499,
        rays: 500,
    };
    // Rays that leave after exactly `inner` reflections are what one step more adds to the image.
    let material = ideal(Dispersion::Constant(n), 1.0);
    let up_to = |depth| Bench::sphere(material.clone(), backend, depth).leaving(beam);
    let (with, without) = (up_to(inner + 2), up_to(inner + 1));
    let pairs = with.into_iter().zip(without);
    pairs
        .map(|((all, share), (rest, rest_share))| {
            let exit = (all - rest) / (share - rest_share);
            assert!((share - rest_share - 1.0).abs() < FEW_ROUNDINGS);
            assert!((exit.length() - 1.0).abs() < 1e-5, "{exit}");
            let against = -direction;
            exit.cross(against).length().atan2(exit.dot(against)).to_degrees()
        })
        .collect()
}

#[test]
fn rainbows_appear_at_their_angles_from_the_antisolar_point() {
    // Lines F, d, C in water: indices, primary and secondary bow.
    let table = [
        (1.337492, 41.429, 52.061),
        (1.333403, 42.019, 50.996),
        (1.331513, 42.295, 50.500),
    ];
    for backend in backends() {
        for (n, primary, secondary) in table {
            // The primary bow is the largest angle after one reflection, the secondary the smallest after two.
            let one = bow_angles(n, 1, backend).into_iter().fold(0.0, f64::max);
            let two = bow_angles(n, 2, backend).into_iter().fold(180.0, f64::min);
            assert!((one - primary).abs() < 0.02, "{backend:?}, {n}: {one}");
            assert!((two - secondary).abs() < 0.02, "{backend:?}, {n}: {two}");
        }
    }
}

#[test]
fn air_to_glass_interface_matches_fresnel_table() {
    let table = [
        (0.0f64, 0.04),
        (30.0, 0.04152263),
        (45.0, 0.05023991),
        (56.309932, 0.07396450),
        (60.0, 0.08918671),
        (75.0, 0.25306056),
        (85.0, 0.61279965),
        (89.0, 0.90418495),
        (89.9, 0.98991188),
    ];
    for backend in backends() {
        let bench = divided_by_color(1.5, backend);
        for (degrees, printed) in table {
            let i = degrees.to_radians();
            let [s, p] = textbook_fresnel(i, 1.5);
            let seen = bench.see(from_above(i), WHITE)[0];
            assert_shares(seen, 0.5 * (s + p), &format!("{degrees} degrees, {backend:?}"));
            assert!(
                (seen.x - printed).abs() < 5.1e-9 + 1e-6 * printed,
                "{degrees}: {seen}"
            );
        }
    }
}

/// Holds the three channels of [`divided_by_color`] against a reflectance, to 1e-6 of each.
fn assert_shares(seen: DVec3, reflectance: f64, what: &str) {
    assert!(
        (seen.x / reflectance - 1.0).abs() < 1e-6,
        "{what}: {seen} reflected, not {reflectance}"
    );
    let through = 1.0 - reflectance;
    assert!(
        (seen.y / through - 1.0).abs() < 1e-6,
        "{what}: {seen} let through, not {through}"
    );
    assert!((seen.z - 1.0).abs() < 1e-6, "{what}: {seen}");
}

#[test]
fn glass_to_air_interface_matches_fresnel_table() {
    let table = [
        (30.0f64, 0.05519017),
        (40.0, 0.24529120),
        (41.0, 0.37975127),
        (41.8, 0.89077192),
    ];
    for backend in backends() {
        let bench = divided_by_color(1.5, backend);
        for (degrees, printed) in table {
            let i = degrees.to_radians();
            let [s, p] = textbook_fresnel(i, 1.0 / 1.5);
            let seen = bench.see(from_below(i), WHITE)[0];
            assert_shares(seen, 0.5 * (s + p), &format!("{degrees} degrees, {backend:?}"));
            assert!(
                (seen.x - printed).abs() < 5.1e-9 + 1e-6 * printed,
                "{degrees}: {seen}"
            );
        }
    }
}

#[test]
fn water_and_diamond_have_normal_reflectance_of_their_index() {
    for (n, printed) in [(1.33, 0.02005931), (2.42, 0.17239492)] {
        let seen = divided_by_color(n, Backend::Bsp).see(from_above(0.0), WHITE)[0];
        assert!((seen.x - printed).abs() < 5.1e-9 + 1e-6 * printed, "{n}: {seen}");
    }
}

#[test]
fn brewster_angle_has_perpendicular_rays_and_one_polarisation() {
    for (n, degrees) in [(1.5, 56.309932f64), (1.33, 53.061237), (2.42, 67.548454)] {
        let i = degrees.to_radians();
        for backend in backends() {
            let bench = divided_by_color(n, backend);
            let reflected = bench.see(from_above(i), WHITE)[0].x;
            // Reflected light climbs and transmitted light sinks: red of the one and green of the other.
            let sums = bench.divided(from_above(i));
            let [up, down] = [sums.x / reflected, sums.y / (1.0 - reflected)];
            // Complementary angles: sin² of one and of the other make 1. The angle is printed to 5e-7 degrees.
            assert!(
                (up * up + down * down - 1.0).abs() < 1e-6,
                "{n}, {backend:?}: {up} {down}"
            );
            // s-polarised light alone: (n² - 1)² / (n² + 1)².
            let s = ((n * n - 1.0) / (n * n + 1.0)).powi(2);
            assert!(
                (2.0 * reflected / s - 1.0).abs() < 1e-6,
                "{n}, {backend:?}: {reflected}"
            );
        }
    }
}

#[test]
fn no_light_leaves_beyond_the_critical_angle() {
    for (n, degrees) in [(1.5, 41.810315), (1.33, 48.753467), (2.42, 24.407469)] {
        for backend in backends() {
            let bench = divided_by_color(n, backend);
            // Printed to six decimals.
            let seen = |degrees: f64| bench.see(from_below(degrees.to_radians()), WHITE)[0];
            let (before, beyond) = (seen(degrees - 1e-6), seen(degrees + 1e-6));
            assert!(
                before.y > 1e-4 && before.x < 1.0 - 1e-4,
                "{n}, {backend:?}: {before}"
            );
            assert_eq!((beyond.x, beyond.y), (1.0, 0.0), "{n}, {backend:?}");
        }
    }
}

/// A slab with its upper face at y = 0, and a ray straight down on it.
fn plate(material: Material, thickness: f64, backend: Backend) -> Bench {
    Bench {
        geometry: Geometry::Mesh(slab()),
        place: DAffine3::from_scale(DVec3::new(4.0, thickness, 4.0)),
        material,
        backend,
        depth: 32,
    }
}

/// Off the diagonals, where two triangles share an edge.
const SPOT: DVec3 = DVec3::new(0.37, 0.0, 0.11);

fn absorbing(ior: f64, sigma_a: [f64; 3]) -> Material {
    let mut material = glass(ior);
    material.interior = Some(Medium {
        absorption: Absorption { sigma_a },
        ..material.interior.unwrap()
    });
    material
}

#[test]
fn glass_slab_and_thin_wall_transmit_twelve_thirteenths() {
    let mut thin = glass(1.5);
    thin.interior = Some(Medium {
        kind: MediumKind::ThinSlab,
        ..thin.interior.unwrap()
    });
    for backend in backends() {
        let wall = Bench {
            geometry: Geometry::Mesh(square()),
            ..plate(thin.clone(), 1.0, backend)
        };
        for bench in [plate(glass(1.5), 0.25, backend), wall] {
            let seen = bench.divided(Beam::ray(SPOT, DVec3::NEG_Y, 2.0));
            // R = 0.04: (1 - R) / (1 + R) through, 2 R / (1 + R) back.
            assert!((seen.y - 12.0 / 13.0).abs() < 1e-6, "{backend:?}: {seen}");
            assert!((seen.y - 0.923077).abs() < 1e-6, "{backend:?}: {seen}");
            assert!((seen.x - 1.0 / 13.0).abs() < 1e-6, "{backend:?}: {seen}");
            assert!((seen.z - 1.0).abs() < 1e-6, "{backend:?}: {seen}");
        }
    }
}

#[test]
fn thin_face_reflects_four_percent_and_transmits_the_rest() {
    let mut face = glass(1.5);
    face.interior = Some(Medium {
        kind: MediumKind::ThinFace,
        ..face.interior.unwrap()
    });
    for backend in backends() {
        let wall = Bench {
            geometry: Geometry::Mesh(square()),
            ..plate(face.clone(), 1.0, backend)
        };
        let seen = wall.divided(Beam::ray(SPOT, DVec3::NEG_Y, 2.0));
        // F = (0.5 / 2.5)² back, 1 - F through.
        assert!((seen.x - 0.04).abs() < 1e-6, "{backend:?}: {seen}");
        assert!((seen.y - 0.96).abs() < 1e-6, "{backend:?}: {seen}");
        assert!((seen.z - 1.0).abs() < 1e-6, "{backend:?}: {seen}");
    }
}

#[test]
fn slab_of_half_value_thickness_transmits_half() {
    // Each channel a half value of its own: half of red, a quarter of green, an eighth of blue.
    let thickness = 0.6;
    let sigma = LN_2 / thickness;
    let material = absorbing(1.0, [sigma, 2.0 * sigma, 3.0 * sigma]);
    // Rays start off the face by the bound on where it is, a dozen roundings of the slab's size, and miss that part of
    // the way.
    let per_halving = 1e-6 * DVec3::new(1.0, 2.0, 3.0);
    for backend in backends() {
        let bench = plate(material.clone(), thickness, backend);
        let straight = bench.see(Beam::ray(SPOT, DVec3::NEG_Y, 2.0), WHITE)[0];
        let off = (straight / DVec3::new(0.5, 0.25, 0.125) - 1.0).abs();
        assert!(off.cmplt(per_halving).all(), "{backend:?}: {straight}");
        let slanted = DVec3::new(FRAC_PI_3.sin(), -FRAC_PI_3.cos(), 0.0);
        let seen = bench.see(Beam::ray(SPOT, slanted, 2.0), WHITE)[0];
        let off = (seen / DVec3::new(0.25, 1.0 / 16.0, 1.0 / 64.0) - 1.0).abs();
        assert!(off.cmplt(2.0 * per_halving).all(), "{backend:?}: {seen}");
    }
}

#[test]
fn tinted_slab_equals_series_of_internal_reflections() {
    let thickness = 0.5;
    let material = absorbing(1.5, [0.5, 2.0, 0.0]);
    for backend in backends() {
        let seen =
            plate(material.clone(), thickness, backend).see(Beam::ray(SPOT, DVec3::NEG_Y, 2.0), WHITE)[0];
        let expected = [0.5, 2.0, 0.0].map(|sigma: f64| {
            let (r, a) = (0.04, (-sigma * thickness).exp());
            let through = (1.0 - r) * (1.0 - r) * a / (1.0 - r * r * a * a);
            r + through + through * r * a
        });
        let off = (seen - DVec3::from(expected)).abs().max_element();
        assert!(off < 1e-6, "{backend:?}: {seen}, not {expected:?}");
    }
}

#[test]
fn glass_ball_vanishes_in_white_furnace() {
    let depth = 64;
    for backend in backends() {
        let beam = Beam {
            origin: DVec3::new(-3.0, 0.0, 0.0),
            direction: DVec3::X,
            across: DVec3::new(0.0, 0.6, 0.8),
            half_width: 1.05,
            rays: 400,
        };
        let seen = Bench::sphere(glass(1.5), backend, depth).see(beam, WHITE);
        for (index, pixel) in (0..).zip(seen) {
            // All inner reflections of a ray are alike; those after the last step are not followed.
            let b = beam.offset(index).abs();
            let lost = if b < 1.0 {
                let [s, p] = textbook_fresnel(b.asin(), 1.5);
                let r = 0.5 * (s + p);
                (1.0 - r) * r.powi(depth as i32 - 1)
            } else {
                0.0
            };
            let off = (pixel + lost - DVec3::ONE).abs().max_element();
            assert!(off < 1e-5, "{backend:?}, {b}: {pixel}, {lost} lost");
        }
    }
}

/// Returns the radiance seen of two level squares, colours with their coverage, the first above the second, before `background`.
fn composited(layers: [[f32; 4]; 2], background: [f32; 3], backend: Backend) -> DVec3 {
    let layer = |base_color| Material {
        model: Model::Unlit,
        alpha: AlphaMode::Blend,
        base_color,
        ..Material::default()
    };
    let place = |index: u32| {
        let map = DAffine3::from_translation(-f64::from(index) * DVec3::Y);
        Instance::new("sheet", 0, index, map).unwrap()
    };
    let scene = Scene {
        geometries: vec![Geometry::Mesh(square())],
        instances: vec![place(0), place(1)],
        materials: layers.map(layer).to_vec(),
        background: Background::Uniform(background),
        ..Scene::default()
    };
    see_scene(&scene, Beam::ray(SPOT, DVec3::NEG_Y, 2.0), backend, 0)[0]
}

#[test]
fn blended_surfaces_cover_by_their_alpha() {
    let pink = |alpha| [1.0, 0.5, 0.5, alpha];
    let (red, blue, green) = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
    let with = |[r, g, b]: [f32; 3], alpha| [r, g, b, alpha];
    for backend in backends() {
        for (layers, expected) in [
            // 0.2 c + 0.8 (0.1 c + 0.9 background) = 0.28 c + 0.72 background, in either order.
            ([pink(0.2), pink(0.1)], DVec3::new(0.28, 0.86, 0.14)),
            ([pink(0.1), pink(0.2)], DVec3::new(0.28, 0.86, 0.14)),
            // 0.2 red, 0.8 * 0.1 blue; the other way round 0.1 blue, 0.9 * 0.2 red.
            ([with(red, 0.2), with(blue, 0.1)], DVec3::new(0.2, 0.72, 0.08)),
            ([with(blue, 0.1), with(red, 0.2)], DVec3::new(0.18, 0.72, 0.1)),
        ] {
            let seen = composited(layers, green, backend);
            assert!(
                (seen - expected).abs().max_element() < FEW_ROUNDINGS,
                "{backend:?}: {seen}, not {expected}"
            );
        }
    }
}
