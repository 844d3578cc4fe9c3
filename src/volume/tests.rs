//! Tests of complete marches against closed forms, against each other, and with empty-space skipping.

use super::cloud::{Cloud, CloudShape};
use super::*;
use crate::numeric::{LANES, Lanes3};

/// Unit roundoff of f64: bound on the relative error of one rounding.
const U: f64 = f64::EPSILON / 2.0;

fn node(value: f64, thickness: f64, color: [f64; 3], emission: [f64; 3]) -> TransferNode {
    TransferNode {
        value,
        thickness,
        color,
        emission,
    }
}

fn volume(grid: Grid, transfer: Transfer, world_from_cube: DAffine3, step: f64) -> Volume {
    Volume::new(VolumeDescription {
        density: Arc::new(grid),
        color: None,
        transfer,
        world_from_cube,
        step: Some(step),
    })
    .unwrap()
}

fn constant() -> Grid {
    Grid::new([3, 4, 5], GridSamples::Bytes(vec![1; 60])).unwrap()
}

/// Returns a homogeneous box over z in [from, to], x and y in [-1, 1].
fn slab([from, to]: [f64; 2], medium: TransferNode, thickness: Thickness, step: f64) -> Volume {
    let map = DAffine3::from_translation(DVec3::Z * 0.5 * (from + to))
        * DAffine3::from_scale(DVec3::new(1.0, 1.0, 0.5 * (to - from)));
    volume(
        constant(),
        Transfer::new(&[medium], thickness).unwrap(),
        map,
        step,
    )
}

/// Returns the segment along z from z = 0 to `t_far`.
fn along_z(t_far: f64) -> RaySegment {
    RaySegment {
        origin: DVec3::new(0.25, -0.5, 0.0),
        direction: DVec3::Z,
        t_near: 0.0,
        t_far,
    }
}

fn assert_near(got: [f64; 3], expected: [f64; 3], bound: f64) {
    for channel in 0..3 {
        assert!(
            (got[channel] - expected[channel]).abs() <= bound,
            "{got:?} {expected:?}"
        );
    }
}

fn over(marched: &Marched, background: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|c| marched.radiance[c] + marched.transmittance * background[c])
}

const PINK: [f64; 3] = [1.0, 0.5, 0.5];
const GREEN: [f64; 3] = [0.0, 1.0, 0.0];
const DARK: [f64; 3] = [0.0; 3];

#[test]
fn two_slabs_match_the_compositing_example_at_any_step() {
    for step in [1.0, 0.5, 0.3, 0.01] {
        let layer = |range, color, alpha| {
            slab(
                range,
                node(1.0, alpha, color, DARK),
                Thickness::OpacityOver(1.0),
                step,
            )
        };
        let bound = 1e-14 + 4.0 * U / step;
        let volumes = [layer([2.0, 3.0], PINK, 0.1), layer([1.0, 2.0], PINK, 0.2)];
        let marched = March::new(&volumes, None).radiance(&along_z(10.0), None);
        assert_near(over(&marched, GREEN), [0.28, 0.86, 0.14], bound);
        // Only the order along the ray is relevant, not that of the list.
        let volumes = [
            layer([2.0, 3.0], [0.0, 0.0, 1.0], 0.1),
            layer([1.0, 2.0], [1.0, 0.0, 0.0], 0.2),
        ];
        let marched = March::new(&volumes, None).radiance(&along_z(10.0), None);
        assert_near(over(&marched, GREEN), [0.2, 0.72, 0.08], bound);
    }
}

#[test]
fn homogeneous_slab_is_independent_of_the_step() {
    // Segment length 2, and steps around its integer fractions, down to a millionth of it.
    let medium = node(1.0, 1.7, PINK, [0.0, 0.3, 2.0]);
    let alpha = 1.0 - (-3.4f64).exp();
    let expected = [0, 1, 2].map(|c| alpha * (medium.color[c] + medium.emission[c] / 1.7));
    for count in [1.0f64, 2.0, 3.0, 7.0, 16.0, 17.0, 1000.0, 1e6] {
        for size in [
            2.0 / count,
            (2.0 / count).next_up(),
            (2.0 / count).next_down(),
            1.9 / count,
        ] {
            let volumes = [slab([1.0, 3.0], medium, Thickness::Extinction, size)];
            let marched = March::new(&volumes, None)
                .with_cutoff(0.0)
                .radiance(&along_z(9.0), None);
            assert_near(marched.radiance, expected, 1e-12);
            assert!((marched.transmittance - (1.0 - alpha)).abs() <= 1e-12, "{size}");
        }
    }
}

#[test]
fn transmittances_are_accurate_up_to_optical_depth_ten_thousand() {
    for tau in [0.0, 1e-12, 1e-3, 1.0, 30.0, 600.0, 1e4] {
        for count in [1.0, 10.0, 1e3, 1e5, 1e7] {
            if count == 1e7 && tau != 600.0 {
                continue;
            }
            let volumes = [slab(
                [1.0, 3.0],
                node(1.0, tau / 2.0, DARK, DARK),
                Thickness::Extinction,
                2.0 / count,
            )];
            let segment = along_z(f64::INFINITY);
            let mut march = March::new(&volumes, None).with_cutoff(0.0);
            let got = march.transmittance(&segment);
            let expected = (-tau).exp();
            assert!(
                (got - expected).abs() <= 1e-9 * (1.0 + tau) * expected,
                "{tau} {count} {got}"
            );
            if count < 1e6 {
                assert_eq!(march.radiance(&segment, None).transmittance, got);
            }
        }
    }
}

#[test]
fn linear_density_has_the_optical_depth_of_its_mean() {
    // Samples 0 and 4 at z = -1/2 and 1/2 of the cube: 0 below, a ramp, 4 above; over [-1, 1] the integral is 4.
    let grid = Grid::new([1, 1, 2], GridSamples::Bytes(vec![0, 4])).unwrap();
    let nodes = [node(0.0, 0.0, DARK, DARK), node(4.0, 4.0, DARK, DARK)];
    let transfer = Transfer::new(&nodes, Thickness::Extinction).unwrap();
    // Eight steps: no kink lies inside one, and the midpoint rule is exact for each.
    let volumes = [volume(grid, transfer, DAffine3::IDENTITY, 0.25)];
    let segment = RaySegment {
        origin: DVec3::new(0.0, 0.0, -5.0),
        ..along_z(f64::INFINITY)
    };
    let got = March::new(&volumes, None).transmittance(&segment);
    assert!((got.ln() + 4.0).abs() <= 64.0 * U);
}

#[test]
fn overlapping_volumes_add_their_extinction() {
    let red = node(1.0, 1.0, [1.0, 0.0, 0.0], DARK);
    let emissive = node(1.0, 0.0, DARK, [0.0, 0.0, 2.0]);
    let both = node(1.0, 1.0, [1.0, 0.0, 0.0], [0.0, 0.0, 2.0]);
    let [thin, fine] = [0.1, 0.03];
    let apart = [
        slab([1.0, 3.0], red, Thickness::Extinction, thin),
        slab([2.0, 4.0], emissive, Thickness::Extinction, fine),
    ];
    let cut = [
        slab([1.0, 2.0], red, Thickness::Extinction, thin),
        slab([2.0, 3.0], both, Thickness::Extinction, thin),
        slab([3.0, 4.0], emissive, Thickness::Extinction, thin),
    ];
    let [a, b] =
        [&apart[..], &cut[..]].map(|volumes| March::new(volumes, None).radiance(&along_z(9.0), None));
    assert_near(a.radiance, b.radiance, 1e-13);
    assert!((a.transmittance - b.transmittance).abs() <= 1e-14);
    // Red is 1 - exp(-2); blue is 2 exp(-1) (1 - exp(-1)) + 2 exp(-2).
    let e = (-1.0f64).exp();
    assert_near(
        a.radiance,
        [1.0 - e * e, 0.0, 2.0 * e * (1.0 - e) + 2.0 * e * e],
        1e-13,
    );
}

#[test]
fn results_do_not_depend_on_transform_direction_and_origin() {
    let turn = DAffine3::from_rotation_y(0.7) * DAffine3::from_rotation_x(-0.4);
    let map = DAffine3::from_translation(DVec3::new(30.0, -20.0, 5.0))
        * turn
        * DAffine3::from_scale(DVec3::new(3.0, -2.0, 0.5));
    let medium = [node(1.0, 0.8, PINK, DARK)];
    let transfer = Transfer::new(&medium, Thickness::Extinction).unwrap();
    let volumes = [volume(constant(), transfer, map, 0.07)];
    // Cross the slab along its own z, 1 thick: from outside, from inside, and ending inside.
    let direction = map.transform_vector3(DVec3::Z) * 2.0;
    let segment = |z: f64, t_far| RaySegment {
        origin: map.transform_point3(DVec3::new(0.3, 0.2, z)),
        direction: direction * 4.0,
        t_near: 0.0,
        t_far,
    };
    // One thickness is 1/4 of t.
    for (segment, length) in [
        (segment(-2.0, 10.0), 1.0),
        (segment(-0.5, 10.0), 0.75),
        (segment(-2.0, 0.125 + 0.25 / 4.0), 0.25),
        (segment(1.5, 10.0), 0.0),
        (segment(-2.0, 0.1), 0.0),
    ] {
        let got = March::new(&volumes, None).transmittance(&segment);
        assert!((got - (-0.8f64 * length).exp()).abs() <= 1e-13, "{length} {got}");
    }
}

#[test]
fn rays_outside_along_and_inside_get_correct_intervals() {
    let volumes = [slab(
        [1.0, 3.0],
        node(1.0, 1.0, PINK, DARK),
        Thickness::Extinction,
        0.1,
    )];
    let mut march = March::new(&volumes, None);
    let mut depth = |origin: DVec3, direction: DVec3, t_near, t_far| {
        let segment = RaySegment {
            origin,
            direction,
            t_near,
            t_far,
        };
        -march.transmittance(&segment).ln()
    };
    let near = |got: f64, expected: f64| (got - expected).abs() <= 1e-13;
    assert!(near(depth(DVec3::new(1.5, 0.0, 0.0), DVec3::Z, 0.0, 9.0), 0.0));
    assert!(near(depth(DVec3::new(-3.0, 0.0, 2.0), DVec3::X, 0.0, 9.0), 2.0));
    // A ray in the plane of a face counts as inside.
    assert!(near(depth(DVec3::new(-3.0, 1.0, 2.0), DVec3::X, 0.0, 9.0), 2.0));
    assert!(near(depth(DVec3::new(0.0, 0.0, 9.0), -DVec3::Z, 0.0, 99.0), 2.0));
    assert!(near(depth(DVec3::ZERO, DVec3::Z, 2.0, 2.5), 0.5));
    assert!(near(depth(DVec3::ZERO, DVec3::Z, 2.5, 2.0), 0.0));
    assert!(near(depth(DVec3::ZERO, DVec3::Z, f64::NAN, 9.0), 0.0));
    assert!(near(depth(DVec3::NAN, DVec3::Z, 0.0, 9.0), 0.0));
}

/// Returns smoke that emits light where it is dense.
fn smoke() -> [Volume; 1] {
    let nodes = [
        node(0.0, 0.0, [0.9; 3], DARK),
        node(0.3, 6.0, [0.7, 0.6, 0.5], DARK),
        node(0.5, 9.0, [0.2; 3], DARK),
        node(1.0, 20.0, [0.1; 3], [9.0, 3.0, 0.5]),
    ];
    let transfer = Transfer::new(&nodes, Thickness::Extinction).unwrap();
    let map = DAffine3::from_rotation_z(0.3) * DAffine3::from_scale(DVec3::new(1.0, 1.5, 0.8));
    [volume(Cloud::SMOKE.bake([64; 3]).unwrap(), transfer, map, 0.01)]
}

fn rays(count: u32) -> impl Iterator<Item = RaySegment> {
    // Fractions of Roberts's sequence determine start and target.
    let share = |i: u32, k: i32| (f64::from(i) * 1.167_303_978_261_418_7f64.powi(-k)).fract();
    (0..count).map(move |i| {
        let from = DVec3::new(share(i, 1), share(i, 2), share(i, 3)) - 0.5;
        let to = DVec3::new(share(i, 4), share(i, 5), 0.6 * share(i, 1)) * 1.6 - 0.8;
        let origin = from.normalize() * 4.0;
        RaySegment {
            origin,
            direction: to - origin,
            t_near: 0.0,
            t_far: f64::INFINITY,
        }
    })
}

#[test]
fn skipping_empty_space_changes_no_bit() {
    let smoke = smoke();
    let mut everywhere = March::new(&smoke, None).with_skip(SkipEmpty::Never);
    let mut leaping = March::new(&smoke, None);
    let (mut all, mut taken, mut seen) = (0, 0, 0);
    for segment in rays(2000) {
        let [a, b] = [&mut everywhere, &mut leaping].map(|march| march.radiance(&segment, None));
        assert_eq!((a.radiance, a.transmittance), (b.radiance, b.transmittance));
        assert_eq!(
            everywhere.transmittance(&segment),
            leaping.transmittance(&segment)
        );
        assert_eq!(a.transmittance, leaping.transmittance(&segment));
        all += a.sample_count;
        taken += b.sample_count;
        seen += u32::from(a.transmittance < 0.99);
    }
    assert!(3 * taken < all, "{taken} of {all}");
    assert!(seen > 200, "{seen}");
}

#[test]
fn skipping_empty_space_changes_no_bit_in_overlapping_volumes() {
    let [first] = smoke();
    let nodes = [node(0.0, 0.0, PINK, DARK), node(1.0, 1.0, PINK, DARK)];
    let puff = Cloud {
        shape: CloudShape::Puff,
        ..Cloud::SMOKE
    };
    let map = DAffine3::from_translation(DVec3::new(0.4, 0.1, 0.0)) * DAffine3::from_scale(DVec3::splat(0.7));
    let transfer = Transfer::new(&nodes, Thickness::OpacityOver(0.1)).unwrap();
    let second = volume(puff.bake([40; 3]).unwrap(), transfer, map, 0.02);
    let volumes = [first, second];
    let mut everywhere = March::new(&volumes, None).with_skip(SkipEmpty::Never);
    let mut leaping = March::new(&volumes, None);
    for segment in rays(1000) {
        let [a, b] = [&mut everywhere, &mut leaping].map(|march| march.radiance(&segment, None));
        assert_eq!((a.radiance, a.transmittance), (b.radiance, b.transmittance));
    }
}

/// Returns the transmittances of `segments`, computed one by one and together, and the number of samples of the
/// latter.
fn one_by_one_and_together(march: &mut March, segments: &[RaySegment]) -> ([f64; LANES], [f64; LANES], u64) {
    let mut single = [1.0; LANES];
    for (left, segment) in single.iter_mut().zip(segments) {
        *left = march.transmittance(segment);
    }
    let mut together = [1.0; LANES];
    let sample_count = march.transmittances(segments, &mut together);
    (single, together, sample_count)
}

#[test]
fn batched_samples_give_the_results_of_single_rays() {
    let [first] = smoke();
    // Build volumes that overlap, that do not, and fog
    let puff = |x: f64, alpha: f64| {
        let map =
            DAffine3::from_translation(DVec3::new(x, 0.1, 0.0)) * DAffine3::from_scale(DVec3::splat(0.7));
        let nodes = [node(0.0, 0.0, PINK, DARK), node(1.0, alpha, PINK, DARK)];
        let transfer = Transfer::new(&nodes, Thickness::OpacityOver(0.1)).unwrap();
        let grid = Cloud {
            shape: CloudShape::Puff,
            ..Cloud::SMOKE
        };
        volume(grid.bake([20; 3]).unwrap(), transfer, map, 0.02)
    };
    let volumes = [first, puff(0.4, 1.0), puff(2.0, 1.0)];
    let apart = [puff(-0.9, 0.2), puff(0.9, 0.7)];
    let fog = Fog::new(0.1, PINK, DARK, 0.2).unwrap();
    let segments: Vec<RaySegment> = rays(500).collect();
    // Compare for every combination of volumes, cut-off and skipping
    for (volumes, fog) in [
        (&volumes[..1], None),
        (&apart[..], None),
        (&volumes[..], None),
        (&volumes[..], Some(fog)),
    ] {
        for (cutoff, skip) in [
            (1e-7, SkipEmpty::Leap),
            (0.3, SkipEmpty::Leap),
            (1e-7, SkipEmpty::Never),
        ] {
            let mut march = March::new(volumes, fog).with_cutoff(cutoff).with_skip(skip);
            let mut darkened = 0;
            // Use packets of sixteen and fewer rays.
            for (i, segments) in segments.chunks(LANES).enumerate() {
                let count = segments.len().min(1 + 5 * i % LANES);
                let (single, together, _) = one_by_one_and_together(&mut march, &segments[..count]);
                assert_eq!(single, together, "{i}");
                darkened += single.iter().filter(|&&left| left < 0.9).count();
            }
            assert!(darkened > 20, "{darkened}");
        }
    }
}

#[test]
fn skipped_samples_are_not_counted() {
    let medium = node(1.0, 0.1, PINK, DARK);
    let volumes = [slab([1.0, 3.0], medium, Thickness::Extinction, 0.125)];
    let segments = [along_z(9.0), along_z(0.5), along_z(2.0)];
    // Expect 16 steps, none, and 8.
    let mut march = March::new(&volumes, None);
    assert_eq!(one_by_one_and_together(&mut march, &segments).2, 24);
    assert_eq!(march.radiance(&segments[2], None).sample_count, 8);
    let smoke = smoke();
    let segments: Vec<RaySegment> = rays(16).collect();
    let [all, leaping] = [SkipEmpty::Never, SkipEmpty::Leap].map(|skip| {
        let mut march = March::new(&smoke, None).with_skip(skip);
        one_by_one_and_together(&mut march, &segments).2
    });
    assert!(0 < leaping && 3 * leaping < all, "{leaping} of {all}");
}

#[test]
fn early_termination_keeps_its_bound() {
    let smoke = smoke();
    // Emission over extinction is at most 9 / 20, colour at most 0.9.
    let brightest = 0.9 + 0.45;
    for cutoff in [0.3, 1e-2, 1e-7] {
        let mut short = March::new(&smoke, None).with_cutoff(cutoff);
        let mut whole = March::new(&smoke, None).with_cutoff(0.0);
        let mut stopped = 0;
        for segment in rays(500) {
            let (a, b) = (short.radiance(&segment, None), whole.radiance(&segment, None));
            assert_near(a.radiance, b.radiance, cutoff * brightest);
            assert!((a.transmittance - b.transmittance).abs() <= cutoff);
            stopped += u32::from(a.sample_count < b.sample_count);
        }
        assert!(stopped > 0 || cutoff < 1e-3, "{cutoff}");
    }
}

#[test]
fn surface_inside_splits_the_march() {
    let volumes = [slab(
        [1.0, 3.0],
        node(1.0, 0.6, PINK, DARK),
        Thickness::Extinction,
        0.25,
    )];
    let mut march = March::new(&volumes, None);
    let whole = march.radiance(&along_z(9.0), None);
    for cut in [0.5, 1.1, 2.0, 2.9, 5.0] {
        let front = march.radiance(&along_z(cut), None);
        let back = march.radiance(
            &RaySegment {
                t_near: cut,
                ..along_z(9.0)
            },
            None,
        );
        assert_near(over(&front, over(&back, GREEN)), over(&whole, GREEN), 1e-14);
    }
}

#[test]
fn closed_form_fog_matches_marched_fog() {
    let fog = Fog::new(0.4, PINK, [0.1, 0.2, 0.0], 0.05).unwrap();
    let closed = March::new(&[], Some(fog)).radiance(&along_z(3.0), None);
    let alpha = 1.0 - (-1.2f64).exp();
    assert_near(closed.radiance, [alpha * 1.25, alpha * 1.0, alpha * 0.5], 1e-15);
    let mut white = |_: &PointLanes| [[1.0; LANES]; 3];
    for t_far in [3.0, f64::INFINITY] {
        let closed = March::new(&[], Some(fog)).radiance(&along_z(t_far), None);
        let marched = March::new(&[], Some(fog)).radiance(&along_z(t_far), Some(&mut white));
        // At infinity the march stops at the cut-off, 10^-7.
        let bound = if t_far == 3.0 { 1e-13 } else { 1.3e-7 };
        assert_near(marched.radiance, closed.radiance, bound);
        assert!(marched.sample_count > 0 && closed.sample_count == 0);
    }
}

#[test]
fn fog_continues_inside_and_between_volumes() {
    let fog = Fog::new(0.4, PINK, DARK, 0.1).unwrap();
    let medium = node(1.0, 1.0, GREEN, DARK);
    let volumes = [slab([1.0, 3.0], medium, Thickness::Extinction, 0.1)];
    let mut march = March::new(&volumes, Some(fog));
    let got = march.radiance(&along_z(4.0), None);
    assert!((got.transmittance - (-0.4f64 * 4.0 - 2.0).exp()).abs() <= 1e-14);
    assert_eq!(march.transmittance(&along_z(4.0)), got.transmittance);
    // The slab and its fog as one medium: extinction 1.4, mean colour.
    let mixed = [0, 1, 2].map(|c| (0.4 * PINK[c] + GREEN[c]) / 1.4);
    let mut composite = composite::Composite::CLEAR;
    fog.pass(1.0, &mut composite);
    composite.push(mixed, 1.0 - (-2.8f64).exp());
    fog.pass(1.0, &mut composite);
    assert_near(got.radiance, composite.color(), 1e-14);
}

#[test]
fn light_is_queried_only_where_the_medium_scatters() {
    let scattering = node(1.0, 1.0, [0.5; 3], [0.0, 0.0, 1.0]);
    let volumes = [
        slab([1.0, 2.0], scattering, Thickness::Extinction, 0.1),
        slab([3.0, 4.0], node(1.0, 1.0, DARK, DARK), Thickness::Extinction, 0.1),
    ];
    let mut light_queries = 0;
    let mut light = |at: &PointLanes| -> Lanes3<f64> {
        for l in (0..LANES).filter(|l| at.active >> l & 1 == 1) {
            let [x, y, z] = [0, 1, 2].map(|axis| at.points[axis][l]);
            assert_eq!((x, y), (0.25, -0.5));
            assert!((1.0..2.0).contains(&z));
            light_queries += 1;
        }
        [[4.0; LANES], [2.0; LANES], [0.0; LANES]]
    };
    let marched = March::new(&volumes, None).radiance(&along_z(9.0), Some(&mut light));
    // Colour times light, plus emission unchanged.
    let alpha = 1.0 - (-1.0f64).exp();
    assert_near(marched.radiance, [2.0 * alpha, alpha, alpha], 1e-14);
    assert_eq!((light_queries, marched.sample_count), (10, 20));
}

#[test]
fn colour_grids_tint_the_transfer_function() {
    // Two samples along z: red up to the first, green from the second, linear between.
    let channel = |samples: [u8; 2]| Grid::new([1, 1, 2], GridSamples::Bytes(samples.to_vec())).unwrap();
    let colors = [channel([1, 0]), channel([0, 1]), channel([0, 0])];
    let description = VolumeDescription {
        density: Arc::new(constant()),
        color: Some(Arc::new(colors)),
        transfer: Transfer::new(&[node(1.0, 1e-6, [0.5; 3], DARK)], Thickness::Extinction).unwrap(),
        world_from_cube: DAffine3::IDENTITY,
        step: Some(0.25),
    };
    let volumes = [Volume::new(description).unwrap()];
    let colors = |t_near, t_far| {
        let segment = RaySegment {
            origin: DVec3::NEG_Z,
            t_near,
            ..along_z(t_far)
        };
        March::new(&volumes, None).radiance(&segment, None).radiance
    };
    // Optically thin: radiance is 10^-6 per unit of length times the mean colour, up to second order.
    assert_near(colors(0.0, 0.5), [0.25e-6, 0.0, 0.0], 1e-12);
    assert_near(colors(1.5, 2.0), [0.0, 0.25e-6, 0.0], 1e-12);
    assert_near(colors(0.0, 2.0), [0.5e-6, 0.5e-6, 0.0], 1e-11);
}

#[test]
fn invalid_volumes_are_rejected() {
    let description = VolumeDescription {
        density: Arc::new(constant()),
        color: None,
        transfer: Transfer::opacity(PINK, 1.0).unwrap(),
        world_from_cube: DAffine3::IDENTITY,
        step: None,
    };
    let made = Volume::new(description.clone()).unwrap();
    // Half of the shortest edge, 2/5.
    assert_eq!(made.step(), 0.2);
    assert_eq!((made.bounds().min, made.bounds().max), (-DVec3::ONE, DVec3::ONE));
    // Try invalid steps
    for step in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9] {
        let step = Some(step);
        let error = Volume::new(VolumeDescription {
            step,
            ..description.clone()
        })
        .unwrap_err();
        assert!(matches!(error, VolumeError::Step { .. }));
    }
    // Try a transform that flattens the volume
    let world_from_cube = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
    let flat = VolumeDescription {
        world_from_cube,
        ..description
    };
    assert!(matches!(
        Volume::new(flat).unwrap_err(),
        VolumeError::Placement(_)
    ));
}
