//! Soft and fuzzy light by the samples that a render uses: does it converge to what is known in closed form?

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use whit::image::LinearImage;
use whit::optics;
use whit::render::{Pattern, Purpose, sample_2d};
use whit::shading::{AreaLight, EnvironmentMap, Ggx, MeshLight, QuadLight, SphereLight};

/// Sample `sample` of pixel `pixel` in a row of them.
fn sobol(pixel: u32, sample: u32, purpose: Purpose) -> [f64; 2] {
    sample_2d(Pattern::Sobol, [pixel, 17], sample, 1, purpose)
}

/// Numbers that have nothing to do with each other: one sample of each pixel.
fn unrelated(number: u32) -> [f64; 2] {
    sample_2d(
        Pattern::Sobol,
        [number % 1024, number / 1024],
        0,
        1,
        Purpose::LIGHT,
    )
}

/// Mean and standard error.
fn statistics(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0) / count).sqrt())
}

/// The mean of `pixels` pixels of `spp` samples, and its standard error from how the pixels differ.
fn estimate(pixels: u32, spp: u32, purpose: Purpose, value: impl Fn([f64; 2]) -> f64) -> (f64, f64) {
    let of_pixel = |pixel| (0..spp).map(|s| value(sobol(pixel, s, purpose))).sum::<f64>() / f64::from(spp);
    let pixels: Vec<f64> = (0..pixels).map(of_pixel).collect();
    statistics(&pixels)
}

/// A sphere light over the edge x = 0, z = `EDGE` of a roof that covers x < 0; what is lit lies on z = 0.
const EDGE: f64 = 1.0;
const LIGHT: DVec3 = DVec3::new(0.0, 0.0, 4.0);
const LIGHT_RADIUS: f64 = 0.5;

/// Returns the part of the light's solid angle that is seen from (x, 0, 0): a cap of angular radius ρ cut by the great circle of
/// the plane through the point and the edge, at the angle δ from the cap's middle.
///
/// The cut-off piece is a sector less two right-angled triangles: π - 2β - 2φ cos ρ with cos φ = tan δ / tan ρ and
/// sin β = sin δ / sin ρ (spherical excess). For a small ρ it is the segment of a disk.
fn visible_part(x: f64) -> f64 {
    let p = DVec3::new(x, 0.0, 0.0);
    let to_light = LIGHT - p;
    let rho = (LIGHT_RADIUS / to_light.length()).asin();
    // Normal of the plane through the edge, towards the open side.
    let open = DVec3::new(EDGE, 0.0, x).normalize();
    let delta = to_light.normalize().dot(open).asin();
    if delta.abs() >= rho {
        return if delta > 0.0 { 1.0 } else { 0.0 };
    }
    let beta = (delta.abs().sin() / rho.sin()).asin();
    let phi = (delta.abs().tan() / rho.tan()).acos();
    let piece = (PI - 2.0 * beta - 2.0 * phi * rho.cos()) / (TAU * (1.0 - rho.cos()));
    if delta > 0.0 { 1.0 - piece } else { piece }
}

/// Returns whether the way from (x, 0, 0) to `target` passes the roof on its open side.
fn passes(x: f64, target: DVec3) -> bool {
    x + (target.x - x) * EDGE / target.z >= 0.0
}

/// Root mean square error over the penumbra's points and 16 pixels each.
fn penumbra_error(light: &AreaLight, spp: u32, point: impl Fn(u32, u32) -> [f64; 2]) -> f64 {
    let mut squares = 0.0;
    let mut count = 0.0;
    for step in 0..40 {
        let x = -0.22 + 0.44 * f64::from(step) / 39.0;
        for pixel in 0..16 {
            let p = DVec3::new(x, 0.0, 0.0);
            let seen = (0..spp)
                .filter(|&s| passes(x, light.sample(p, point(pixel + 16 * step, s)).unwrap().position))
                .count();
            squares += (seen as f64 / f64::from(spp) - visible_part(x)).powi(2);
            count += 1.0;
        }
    }
    (squares / count).sqrt()
}

#[test]
fn sphere_light_soft_shadow_converges_to_the_cut_cap() {
    let light = AreaLight::Sphere(SphereLight::new(LIGHT, LIGHT_RADIUS).unwrap());
    // Half is seen from under the light and the edge, all and nothing outside of the penumbra.
    assert!((visible_part(0.0) - 0.5).abs() < 1e-12);
    assert_eq!((visible_part(-0.2), visible_part(0.2)), (0.0, 1.0));
    let errors = [16, 64, 256, 1024, 4096]
        .map(|spp| penumbra_error(&light, spp, |pixel, s| sobol(pixel, s, Purpose::LIGHT)));
    println!("errors at 16, 64, 256, 1024, 4096 samples: {errors:.5?}");
    // A smooth edge across a scrambled net: N^(-3/4) (A. Owen, 1997), 4^(-3/4) = 0.354 a step; random points have 0.5.
    for pair in errors.windows(2) {
        assert!(pair[1] < 0.42 * pair[0], "{errors:?}");
    }
    assert!(errors[4] < 1e-3, "{errors:?}");
}

#[test]
fn owen_scrambled_shadows_are_far_less_noisy_than_random_ones() {
    let light = AreaLight::Sphere(SphereLight::new(LIGHT, LIGHT_RADIUS).unwrap());
    let scrambled = penumbra_error(&light, 64, |pixel, s| sobol(pixel, s, Purpose::LIGHT));
    let random = penumbra_error(&light, 64, |pixel, s| unrelated(64 * pixel + s));
    println!("error at 64 samples: {scrambled:.4} scrambled, {random:.4} random");
    assert!(random > 2.5 * scrambled, "{random} {scrambled}");
}

#[test]
fn rectangle_light_and_its_mesh_light_a_floor_equally() {
    let (u, v) = (DVec3::Y, 0.6 * DVec3::Z);
    let center = DVec3::new(2.0, 0.5, 1.0);
    let corner = |x: f64, y: f64| center + x * u + y * v;
    let [a, b, c, d] = [
        corner(-1.0, -1.0),
        corner(1.0, -1.0),
        corner(1.0, 1.0),
        corner(-1.0, 1.0),
    ];
    let window = AreaLight::Quad(QuadLight::new(center, u, v).unwrap());
    let mesh = AreaLight::Mesh(MeshLight::new([[a, b, c], [a, c, d]]).unwrap());
    let [(window, window_error), (mesh, mesh_error)] = [window, mesh].map(|light| {
        estimate(64, 256, Purpose::LIGHT, |u| {
            light
                .sample(DVec3::ZERO, u)
                .map_or(0.0, |s| s.direction.z.max(0.0) / s.pdf)
        })
    });
    let error = window_error.hypot(mesh_error);
    assert!((window - mesh).abs() < 3.0 * error, "{window} {mesh} ± {error}");
    assert!(error < 1e-3 * window);
}

const ROUGHNESSES: [f64; 7] = [0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0];
const ANGLES: [f64; 6] = [0.0, 20.0, 45.0, 60.0, 75.0, 85.0];

fn at(degrees: f64) -> DVec3 {
    let (sin, cos) = degrees.to_radians().sin_cos();
    DVec3::new(sin, 0.0, cos)
}

/// Mean and variance over the visible microfacets of `lobe` of what their rays bring, by quadrature: ∫ D(m) G1(o) (o·m)
/// / (n·o) value(m) dm, with tan² = alpha² x / (1 - x) and 1 - x = (1 - y)².
fn furnace(lobe: &Ggx, alpha: f64, wo: DVec3, value: impl Fn(DVec3) -> f64) -> (f64, f64) {
    const CELLS: u32 = 1000;
    let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(CELLS);
    let [mut first, mut second] = [0.0; 2];
    for (i, j) in (0..CELLS).flat_map(|i| (0..CELLS).map(move |j| (i, j))) {
        let (y, turn) = (middle(i), TAU * middle(j));
        let tan = alpha * (y * (2.0 - y)).sqrt() / (1.0 - y);
        let cos = tan.hypot(1.0).recip();
        let m = DVec3::new(tan * cos * turn.cos(), tan * cos * turn.sin(), cos);
        let cosine = wo.dot(m);
        if cosine > 0.0 {
            // D cos dm is 2 (1 - y) dy dφ / 2π.
            let share = 2.0 * (1.0 - y) * cosine / cos;
            let value = value(m);
            first += share * value;
            second += share * value * value;
        }
    }
    let scale = lobe.smith_g1(wo) / wo.z / f64::from(CELLS * CELLS);
    let mean = scale * first;
    (mean, (scale * second - mean * mean).max(0.0))
}

/// Samples in a furnace: so many pixels of so many samples each.
const FURNACE: [u32; 2] = [256, 256];

/// The mean of `value` over the samples of a furnace, and how many standard errors of as many unrelated samples it is
/// from `exact`, as (mean, variance). That error is from the exact variance: few or no samples show the rare
/// microfacets whose light is lost, so their own spread would be no measure.
fn off_by(exact: (f64, f64), value: impl Fn([f64; 2]) -> f64) -> (f64, f64) {
    let [pixels, spp] = FURNACE;
    let (found, _) = estimate(pixels, spp, Purpose::LOBE, value);
    // The quadrature's own error: with 384 steps it already sums the visible density to 1 within 2e-6.
    let error = (exact.1 / f64::from(pixels * spp)).sqrt().max(2e-6);
    (found, (found - exact.0).abs() / error)
}

#[test]
fn white_furnace_shows_lobe_albedo_within_three_standard_errors() {
    let mut worst: f64 = 0.0;
    for roughness in ROUGHNESSES {
        let lobe = Ggx::from_roughness(roughness);
        for degrees in ANGLES {
            let wo = at(degrees);
            let exact = furnace(&lobe, roughness * roughness, wo, |m| {
                let wi = optics::reflect(-wo, m);
                if wi.z > 0.0 { lobe.smith_g1(wi) } else { 0.0 }
            });
            let (found, off) = off_by(exact, |u| lobe.sample_reflection(wo, u).map_or(0.0, |s| s.weight));
            println!(
                "roughness {roughness}, {degrees} degrees: {found:.6}, exactly {:.6}, off by {off:.2}",
                exact.0
            );
            assert!(
                off < 3.0,
                "{roughness} {degrees}: {found}, not {exact:?}, off by {off}"
            );
            assert!(found <= 1.0);
            worst = worst.max(off);
        }
    }
    println!(
        "reflection: {worst:.2} standard errors at worst of {} cases",
        ROUGHNESSES.len() * ANGLES.len()
    );
}

#[test]
fn rough_glass_in_white_furnace_conserves_energy() {
    check_rough_glass(&[1.5, 1.0 / 1.5]);
}

#[test]
#[ignore = "slow: a third refractive index"]
fn rough_diamond_in_white_furnace_conserves_energy() {
    check_rough_glass(&[2.4]);
}

fn check_rough_glass(etas: &[f64]) {
    let mut worst: f64 = 0.0;
    for (eta, roughness) in etas.iter().flat_map(|&eta| ROUGHNESSES.map(|r| (eta, r))) {
        let lobe = Ggx::from_roughness(roughness);
        for degrees in ANGLES {
            let wo = at(degrees);
            let shares = |m: DVec3| optics::dielectric(wo.dot(m).max(0.0), 1.0, eta);
            let exact = furnace(&lobe, roughness * roughness, wo, |m| {
                match optics::refract(-wo, m, 1.0, eta) {
                    Some(through) if through.direction.z < 0.0 => {
                        shares(m).transmittance.mean() * lobe.smith_g1(through.direction)
                    }
                    _ => 0.0,
                }
            });
            let (transmitted, off) = off_by(exact, |u| {
                lobe.sample_transmission(wo, eta, u)
                    .map_or(0.0, |s| s.weight * shares(s.m).transmittance.mean())
            });
            assert!(
                off < 3.0,
                "{eta} {roughness} {degrees}: {transmitted}, not {exact:?}, off by {off}"
            );
            worst = worst.max(off);
            let (reflected, _) = estimate(FURNACE[0], FURNACE[1], Purpose::LOBE, |u| {
                lobe.sample_reflection(wo, u)
                    .map_or(0.0, |s| s.weight * shares(s.m).reflectance.mean())
            });
            // Of one microfacet's light at most all goes on: true of every sample, so of the means.
            assert!(
                transmitted + reflected <= 1.0 + 1e-12,
                "{eta} {roughness} {degrees}"
            );
            // A nearly smooth boundary loses nearly nothing.
            if roughness <= 0.1 && degrees <= 45.0 {
                assert!(transmitted + reflected > 0.995, "{eta} {roughness} {degrees}");
            }
        }
    }
    println!("refraction: {worst:.2} standard errors at worst");
}

/// A clear sky, brighter towards the horizon, over dark ground, with a sun of half a degree that is 50,000 times as
/// bright.
fn sun_and_sky(width: u32, height: u32) -> LinearImage {
    let sun = DVec3::new(0.5, 0.6, -0.4).normalize();
    let texel = |i: u32| {
        let (x, y) = (f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
        let ((sin, cos), (sin_turn, cos_turn)) = (
            (PI * y / f64::from(height)).sin_cos(),
            (TAU * (x / f64::from(width) - 0.5)).sin_cos(),
        );
        let direction = DVec3::new(sin * sin_turn, cos, -sin * cos_turn);
        if direction.dot(sun) > (0.5f64.to_radians()).cos() {
            [50_000.0, 45_000.0, 40_000.0]
        } else if cos > 0.0 {
            let haze = (1.0 - cos).powi(4) as f32;
            [0.3 + haze, 0.6 + haze, 1.2 + haze]
        } else {
            [0.1, 0.08, 0.06]
        }
    };
    LinearImage {
        width,
        height,
        pixels: (0..width * height).map(texel).collect(),
    }
}

#[test]
fn importance_sampling_cuts_sky_map_variance_to_a_tenth() {
    let map = EnvironmentMap::new(sun_and_sky(512, 256), 0.4).unwrap();
    let rays = 65_536;
    let green = |radiance: [f32; 3]| f64::from(radiance[1]);
    let by_importance: Vec<f64> = (0..rays)
        .map(|i| {
            map.sample(unrelated(i))
                .map_or(0.0, |s| green(s.radiance) * s.direction.y.max(0.0) / s.pdf)
        })
        .collect();
    let uniformly: Vec<f64> = (0..rays)
        .map(|i| {
            let d = whit::numeric::warp::direction(2.0 * unrelated(i)[0], unrelated(i)[1]);
            // Its axis is z; the floor's normal is y.
            let d = DVec3::new(d.x, d.z, d.y);
            green(map.radiance(d)) * d.y.max(0.0) * 2.0 * TAU
        })
        .collect();
    let (exact, cells) = (irradiance(&map, 4000), 4000);
    let (found, error) = statistics(&by_importance);
    let (_, uniform_error) = statistics(&uniformly);
    let ratio = (uniform_error / error).powi(2);
    println!(
        "irradiance {found:.3} ± {error:.3}, by {cells}² cells {exact:.3}; variance {ratio:.0} times lower"
    );
    assert!(
        (found - exact).abs() < 3.0 * error,
        "{found} ± {error}, not {exact}"
    );
    assert!(ratio > 10.0, "{ratio}");
}

/// Green irradiance of a floor by the midpoint rule over the upper hemisphere.
fn irradiance(map: &EnvironmentMap, cells: u32) -> f64 {
    let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(cells);
    let mut sum = 0.0;
    for i in 0..cells / 4 {
        let (sin, cos) = (0.5 * PI * middle(4 * i + 1)).sin_cos();
        for j in 0..cells {
            let (sin_turn, cos_turn) = (TAU * middle(j)).sin_cos();
            let radiance = map.radiance(DVec3::new(sin * cos_turn, cos, sin * sin_turn));
            sum += f64::from(radiance[1]) * cos * sin;
        }
    }
    sum * 0.5 * PI / f64::from(cells / 4) * TAU / f64::from(cells)
}

#[test]
fn sampled_direction_histogram_matches_the_density() {
    // Wide lights on dim ground, no cell so empty that its count would not be nearly normal.
    let pixels = (0..32 * 16).map(|i| {
        if i % 37 < 5 || i / 32 == 9 {
            [8.0, 4.0, 1.0]
        } else {
            [0.5, 0.5, 1.0]
        }
    });
    let image = LinearImage {
        width: 32,
        height: 16,
        pixels: pixels.collect(),
    };
    let map = EnvironmentMap::new(image, 1.0).unwrap();
    let (columns, rows, draws) = (16usize, 12usize, 200_000u32);
    let bin = |d: DVec3| {
        let column = ((d.z.atan2(d.x) / TAU + 0.5) * columns as f64) as usize % columns;
        // Equal solid angles.
        let row = ((0.5 - 0.5 * d.y) * rows as f64) as usize;
        row.min(rows - 1) * columns + column
    };
    let mut counts = vec![0.0; columns * rows];
    for i in 0..draws {
        if let Some(sample) = map.sample(unrelated(i)) {
            counts[bin(sample.direction)] += 1.0;
        }
    }
    let mut expected = vec![0.0; columns * rows];
    let fine = 40u32;
    let (across, down) = (fine * columns as u32, fine * rows as u32);
    for i in 0..across * down {
        let turn = TAU * (f64::from(i % across) + 0.5) / f64::from(across);
        let y = 1.0 - 2.0 * (f64::from(i / across) + 0.5) / f64::from(down);
        let sin = (1.0 - y * y).sqrt();
        let direction = DVec3::new(sin * turn.cos(), y, sin * turn.sin());
        expected[bin(direction)] +=
            map.pdf(direction) * 2.0 * TAU / f64::from(across * down) * f64::from(draws);
    }
    let chi_squared: f64 = counts
        .iter()
        .zip(&expected)
        .map(|(c, e): (&f64, &f64)| (c - e).powi(2) / e)
        .sum();
    let freedom = (columns * rows - 1) as f64;
    println!("chi-square {chi_squared:.1} of {freedom} degrees of freedom");
    // Wilson and Hilferty: the cube root is normal; 3.1 standard deviations are a probability of one in a thousand.
    let spread = 2.0 / (9.0 * freedom);
    let score = ((chi_squared / freedom).cbrt() - (1.0 - spread)) / spread.sqrt();
    assert!(score.abs() < 3.1, "chi-square {chi_squared}, score {score}");
}
