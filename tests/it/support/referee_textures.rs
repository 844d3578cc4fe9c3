//! Tests of the reference tracer's textures and shapes, with known values or values computed by hand.

use glam::{DAffine3, DVec3};
use whit::scene::{MaterialInput, Pattern, Procedural, Space, TextureBinding, TextureUse, UvTransform};
use whit::shape::{Cone as ConeShape, Cylinder, Shape, Torus};

use super::approx::{Approx, Approx3, ROUNDING};
use super::cones::{Cone, uv_of};
use super::hits::{Doubt, Ray};
use super::normals::{bend_toward_viewer, bumped, frame_of_chart, frame_of_tangent, mapped};
use super::patterns::{gradient, second_share};
use super::shapes::{Chart, chart, contains, faces};

/// Of what a few operations compute.
const HAND: f64 = 32.0 * ROUNDING;

fn ray(origin: [f64; 3], direction: [f64; 3]) -> Ray {
    Ray {
        origin: Approx3::exact(origin),
        direction: Approx3::exact(direction),
        t_near: Approx::ZERO,
        t_far: f64::INFINITY,
        leaves: None,
        cone: Cone::NONE,
    }
}

fn procedural(pattern: Pattern) -> Procedural {
    Procedural {
        pattern,
        colors: [[0.0; 4], [1.0; 4]],
        space: Space::Object,
        scale: [1.0; 3],
    }
}

/// The share of the second colour at a point, over a footprint with these axes.
fn share(pattern: Pattern, p: [f64; 3], axes: [[f64; 3]; 2]) -> f64 {
    second_share(&procedural(pattern), Approx3::exact(p), axes.map(Approx3::exact)).value
}

const SHARP: [[f64; 3]; 2] = [[0.0; 3]; 2];

fn is_near(a: Approx3, b: [f64; 3]) -> bool {
    (a.value() - DVec3::from(b)).abs().max_element() < HAND
}

#[test]
fn noise_matches_perlins_reference_value() {
    let noise = share(Pattern::Noise { octaves: 1 }, [157.0 / 50.0, 42.0, 7.0], SHARP);
    assert!((2.0 * noise - 1.0 - 0.136_919_958_784_000_12).abs() < 1e-14);
}

#[test]
fn patterns_have_their_defined_values_and_means() {
    assert_eq!(share(Pattern::Checker, [0.5, 0.5, 0.5], SHARP), 0.0);
    assert_eq!(share(Pattern::Checker, [0.5, -0.5, 0.5], SHARP), 1.0);
    // From x = ½ to 2: half a unit of the first square, one of the second.
    let wide = [[1.5, 0.0, 0.0], [1.5, 0.0, 0.0]];
    let mean = share(Pattern::Checker, [1.25, 0.5, 0.5], [wide[0], [0.0; 3]]);
    assert!((mean - 2.0 / 3.0).abs() < 1e-9, "{mean}");
    // From -½ to ½: half of it 0, and ¼ on average of the other half.
    let ramp = share(Pattern::Gradient, [0.0; 3], [[0.0; 3], [1.0, 0.0, 0.0]]);
    assert!((ramp - 0.125).abs() < 1e-12, "{ramp}");
    // sin 2π/12 = ½; over a third of a wave its mean is sinc 1/3 of it.
    let straight = Pattern::Marble {
        octaves: 1,
        turbulence: 0.0,
    };
    assert!((share(straight, [1.0 / 12.0, 0.0, 0.0], SHARP) - 0.75).abs() < 1e-12);
    let damped = share(
        straight,
        [1.0 / 12.0, 0.0, 0.0],
        [[0.0; 3], [1.0 / 3.0, 0.0, 0.0]],
    );
    let sinc = (std::f64::consts::PI / 3.0).sin() / (std::f64::consts::PI / 3.0);
    assert!((damped - 0.5 - 0.25 * sinc).abs() < 1e-12);
    // Rings of radius 1 around z, dark in the middle.
    let rings = Pattern::Wood { turbulence: 0.0 };
    assert!((share(rings, [0.3, 0.4, 9.0], SHARP) - 1.0).abs() < 1e-12);
}

#[test]
fn slope_of_a_wave_is_its_cosine() {
    let straight = Pattern::Marble {
        octaves: 1,
        turbulence: 0.0,
    };
    let slope = gradient(&procedural(straight), Approx3::exact([0.1, 0.2, 0.3]));
    let exact = std::f64::consts::PI * (0.2 * std::f64::consts::PI).cos();
    assert!((slope.x.value - exact).abs() < slope.x.error.max(1e-8) && slope.y.value == 0.0);
}

#[test]
fn torus_has_four_crossings_excluding_the_ray_origin() {
    let torus = &faces(&Shape::Torus(Torus { minor_radius: 0.25 }))[0];
    let across = ray([-3.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
    for (root, t) in [1.75, 2.25, 3.75, 4.25].into_iter().enumerate() {
        let (found, slack) = torus.crossing(&across, root as u32, None).unwrap();
        assert!((found.value - t).abs() < 1e-12 && slack > 1.0, "{found:?}");
    }
    // Over the tube at a height of 0.3, 0.05 beside it.
    let beside = ray([-3.0, 0.0, 0.3], [1.0, 0.0, 0.0]);
    assert!((0..4).all(|root| {
        torus
            .crossing(&beside, root, None)
            .is_none_or(|(_, slack)| slack < -1.0)
    }));
    let left = super::hits::Left {
        instance: 0,
        primitive: 0,
        is_passed: false,
    };
    let inside = ray([0.75, 0.0, 0.0], [-1.0, 0.0, 0.0]);
    let crossings: Vec<f64> = (0..4)
        .filter_map(|root| torus.crossing(&inside, root, Some(left)))
        .filter(|(t, slack)| *slack > 0.0 && t.value >= 0.0)
        .map(|(t, _)| t.value)
        .collect();
    assert!(
        crossings.len() == 2 && (crossings[0] - 1.5).abs() < 1e-9 && (crossings[1] - 2.0).abs() < 1e-9,
        "{crossings:?}"
    );
}

#[test]
fn cylinder_and_cone_are_hit_at_walls_and_caps() {
    let cylinder = faces(&Shape::Cylinder(Cylinder { capped: true }));
    let slanted = ray([-2.0, 0.0, 0.5], [1.0, 0.0, 0.0]);
    let (t, _) = cylinder[0].crossing(&slanted, 0, None).unwrap();
    assert!((t.value - 1.0).abs() < HAND);
    let down = ray([0.3, 0.0, 4.0], [0.0, 0.0, -2.0]);
    let (t, slack) = cylinder[1].crossing(&down, 0, None).unwrap();
    assert!(t.value == 1.5 && slack > 1.0);
    // At z = 0 the cone's radius is ½.
    let cone = Shape::Cone(ConeShape { capped: true });
    let level = ray([-2.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
    for (root, t) in [(0, 1.5), (1, 2.5)] {
        let (found, _) = faces(&cone)[0].crossing(&level, root, None).unwrap();
        assert!((found.value - t).abs() < HAND, "{found:?}");
    }
    assert!(contains(&cone, DVec3::new(0.4, 0.0, 0.0)) && !contains(&cone, DVec3::new(0.6, 0.0, 0.0)));
    let p = faces(&cone)[0].point(&DAffine3::from_scale(DVec3::splat(2.0)), &level, 1.75);
    assert!(is_near(p, [-0.5, 0.0, 0.0]), "{p:?}");
}

#[test]
fn texture_coordinates_grow_along_their_derivatives() {
    let sphere = Shape::Sphere(whit::shape::Sphere::UNIT);
    let at = |shape: &Shape, part: u32, p: DVec3| chart(shape, part, Approx3::exact(p));
    let h = 1e-5;
    for (shape, part, p) in [
        (&sphere, 0, DVec3::new(0.48, 0.6, 0.64)),
        (&Shape::Cube, 2, DVec3::new(0.3, -1.0, 0.4)),
        (&Shape::Cube, 1, DVec3::new(1.0, 0.2, -0.7)),
        (
            &Shape::Torus(Torus { minor_radius: 0.5 }),
            0,
            DVec3::new(0.96, 1.12, 0.3),
        ),
    ] {
        let here = at(shape, part, p);
        for axis in 0..2 {
            let step = here.derivatives[axis].value();
            let there = at(shape, part, p + h * step);
            let change = [0, 1].map(|i| (there.uv[i].value - here.uv[i].value) / h);
            let off = (change[axis] - 1.0).abs() + change[1 - axis].abs();
            assert!(off < 1e-3, "{shape:?} {axis}: {change:?}");
        }
    }
}

#[test]
fn normal_maps_bend_normals_as_defined() {
    let n = Approx3::exact(DVec3::Z);
    let texel = Approx3::exact([0.8, 0.5, 0.9]);
    let layer = TextureBinding {
        parameter: MaterialInput::Normal,
        texture: TextureUse::new(0),
        strength: 2.0,
    };
    let frame = frame_of_tangent(n, Approx3::exact([3.0, 0.0, 1.0]), 1.0);
    // (0.6, 0, 0.8) has the slope ¾, and twice that is 1.5.
    let bent = mapped(n, frame, texel, &layer).value();
    assert!((bent.x / bent.z - 1.5).abs() < HAND && bent.y.abs() < HAND);
    // v goes down in the image, so that up is -dp/dv.
    let down = Chart {
        uv: [Approx::ZERO; 2],
        derivatives: [DVec3::X, -DVec3::Y].map(Approx3::exact),
    };
    let [right, up] = frame_of_chart(n, &down, &UvTransform::IDENTITY);
    assert!(is_near(right, [1.0, 0.0, 0.0]) && is_near(up, [0.0, 1.0, 0.0]));
    // Raised by 0.75 along x: the normal of the slope is (-0.6, 0, 0.8).
    let bent = bumped(n, &down, [Approx::exact(0.75), Approx::ZERO]);
    assert!(is_near(bent, [-0.6, 0.0, 0.8]), "{bent:?}");
    let kept = bend_toward_viewer(bent, n, n, &mut Doubt::NONE.clone());
    assert!(is_near(kept, [-0.6, 0.0, 0.8]));
    // The viewer's image of a normal that lies flat is below the surface: it comes to 0.01 above.
    let wo = Approx3::exact([0.8, 0.0, 0.6]);
    let flat = bend_toward_viewer(Approx3::exact(-DVec3::X), n, wo, &mut Doubt::NONE.clone()).value();
    let image = 2.0 * flat.dot(wo.value()) * flat - wo.value();
    assert!((image.z - 0.01).abs() < HAND, "{image}");
}

#[test]
fn oblique_cone_footprint_is_stretched_by_the_cosine() {
    let cone = Cone {
        width: Approx::exact(0.1),
        spread: Approx::exact(0.01),
    };
    assert!((cone.after(Approx::exact(10.0)).width.value - 0.2).abs() < HAND);
    let d = Approx3::exact([0.6, 0.0, -0.8]);
    let [longer, shorter] = cone.footprint(d, Approx3::exact(DVec3::Z));
    assert!(is_near(longer, [0.125, 0.0, 0.0]) && (shorter.value().length() - 0.1).abs() < HAND);
    // A convex mirror of radius 5 has its focus 2.5 behind it.
    let mirrored = cone.mirrored(Approx::exact(0.2));
    assert!((mirrored.spread.value - 0.01 - 0.1 / 2.5).abs() < HAND);
    let uv = uv_of(
        Approx3::exact([1.0, 3.0, 0.0]),
        [DVec3::X * 2.0, DVec3::new(1.0, 1.0, 0.0)].map(Approx3::exact),
    );
    assert!((uv[0].value + 1.0).abs() < HAND && (uv[1].value - 3.0).abs() < HAND);
}
