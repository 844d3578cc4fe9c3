//! Test oracle for shapes: the interval of a line inside a slightly enlarged or shrunk shape, to 106 bits.
//!
//! A result is correct if it is the exact one for a surface moved by no more than rounding explains: the interval
//! inside the smaller shape must be reported, and a reported interval must be inside the larger one. That covers misses
//! and tangents without special cases. The oracle uses the plain formulas (no shifted origin, no cross products).

use glam::DVec3;

use super::HalfSpace;
use crate::numeric::DoubleDouble;

/// Point or vector of double-double numbers.
pub(crate) type DoubleDouble3 = [DoubleDouble; 3];

/// Converts a vector to double-double numbers.
pub(crate) fn double_double3(v: DVec3) -> DoubleDouble3 {
    v.to_array().map(DoubleDouble::of)
}

/// Returns the dot product in double-double precision.
pub(crate) fn dot(a: DoubleDouble3, b: DoubleDouble3) -> DoubleDouble {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the point of the line at `t`, in double-double precision.
pub(crate) fn at(o: DVec3, d: DVec3, t: DoubleDouble) -> DoubleDouble3 {
    let (o, d) = (double_double3(o), double_double3(d));
    [0, 1, 2].map(|k| o[k] + t * d[k])
}

/// Returns the faces of a dodecahedron whose inscribed sphere has a radius of 3/4.
pub(crate) fn dodecahedron() -> Vec<HalfSpace> {
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    let mut all = Vec::new();
    for (a, b) in [(1.0, golden), (1.0, -golden), (-1.0, golden), (-1.0, -golden)] {
        for n in [
            DVec3::new(0.0, a, b),
            DVec3::new(a, b, 0.0),
            DVec3::new(b, 0.0, a),
        ] {
            all.push(HalfSpace {
                n: n.normalize(),
                h: 0.75,
            });
        }
    }
    all
}

/// Disjoint intervals of the ray parameter in ascending order.
pub(crate) type Intervals = Vec<[DoubleDouble; 2]>;

const ALWAYS: [DoubleDouble; 2] = [
    DoubleDouble::of(f64::NEG_INFINITY),
    DoubleDouble::of(f64::INFINITY),
];

/// Returns the intervals of the line in xᵀ Q x <= 0 about `center`, where `q` is the upper triangle row by row.
pub(crate) fn inside_quadric(q: &[f64; 10], center: DVec3, o: DVec3, d: DVec3) -> Intervals {
    const ENTRY: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]];
    let form = |u: [DoubleDouble; 4], v: [DoubleDouble; 4]| {
        let mut sum = DoubleDouble::of(0.0);
        for (i, row) in ENTRY.iter().enumerate() {
            for (j, entry) in row.iter().enumerate() {
                // Skip zero coefficients, which most are.
                if q[*entry] != 0.0 {
                    sum = sum + DoubleDouble::of(q[*entry]) * u[i] * v[j];
                }
            }
        }
        sum
    };
    // Form the quadratic in homogeneous coordinates
    let (o, d, center) = (double_double3(o), double_double3(d), double_double3(center));
    let o = [0, 1, 2].map(|k| o[k] - center[k]);
    let (one, zero) = (DoubleDouble::of(1.0), DoubleDouble::of(0.0));
    let (o, d) = ([o[0], o[1], o[2], one], [d[0], d[1], d[2], zero]);
    let (a, b, c) = (form(d, d), -form(o, d), form(o, o));
    let discriminant = b * b - a * c;
    // Handle a linear or constant equation
    if a == zero {
        return if b == zero {
            if c <= zero { vec![ALWAYS] } else { vec![] }
        } else {
            let root = c / (b + b);
            if b > zero {
                vec![[root, ALWAYS[1]]]
            } else {
                vec![[ALWAYS[0], root]]
            }
        };
    }
    if discriminant < zero {
        return if a < zero { vec![ALWAYS] } else { vec![] };
    }
    // Compute both roots without cancellation
    let root = discriminant.sqrt();
    let q = if b < zero { b - root } else { b + root };
    let (t0, t1) = if q == zero { (zero, zero) } else { (c / q, q / a) };
    let (t0, t1) = if t0 <= t1 { (t0, t1) } else { (t1, t0) };
    if a > zero {
        vec![[t0, t1]]
    } else {
        vec![[ALWAYS[0], t0], [t1, ALWAYS[1]]]
    }
}

/// Returns the part of `intervals` with n · x <= h.
pub(crate) fn cut(intervals: Intervals, n: DVec3, h: f64, o: DVec3, d: DVec3) -> Intervals {
    // Skip the exact test if f64 shows that nothing is cut
    if intervals.iter().all(|interval| is_uncut(interval, n, h, o, d)) {
        return intervals;
    }
    // Clip with the half-line inside the plane
    let slope = dot(double_double3(n), double_double3(d));
    let room = DoubleDouble::of(h) - dot(double_double3(n), double_double3(o));
    let zero = DoubleDouble::of(0.0);
    let [mut low, mut high] = ALWAYS;
    if slope == zero {
        if room < zero {
            return vec![];
        }
    } else if slope > zero {
        high = room / slope;
    } else {
        low = room / slope;
    }
    let clipped = intervals
        .into_iter()
        .map(|[a, b]| [if a < low { low } else { a }, if b > high { high } else { b }]);
    clipped.filter(|[a, b]| a <= b).collect()
}

/// Error bound of a point's height over a plane in f64, relative to the sizes of its terms: eight products and sums of
/// 2^-53 each, and as much again.
const HEIGHT_ERROR: f64 = 8.0 * f64::EPSILON;

/// Returns whether both ends of an interval are below a plane by more than rounding, as determined in f64.
fn is_uncut(interval: &[DoubleDouble; 2], n: DVec3, h: f64, o: DVec3, d: DVec3) -> bool {
    interval.iter().all(|end| {
        let p = o + end.nearest() * d;
        let size = n.abs().dot(o.abs() + end.nearest().abs() * d.abs()) + h.abs();
        // Comparisons with NaN are false.
        n.dot(p) < h - HEIGHT_ERROR * size
    })
}

/// Number of initial samples of a line through a torus, refined near the surface.
const SAMPLES: usize = 96;
/// Sample spacing, relative to the tube's radius, within which the distance has at most one extremum.
const FINEST: f64 = 1.0 / 32.0;

/// Returns the intervals of the line inside the torus of tube radius `r + delta`, by sampling, extrema and bisection.
/// Samples are denser near the surface: the distance changes no faster than the position.
pub(crate) fn inside_torus(r: f64, delta: f64, o: DVec3, d: DVec3) -> Intervals {
    let (middle, half) = (-o.dot(d) / d.length_squared(), 2.0 / d.length());
    let depth = |t: f64| {
        let p = o + t * d;
        (p.x.hypot(p.y) - 1.0).hypot(p.z) - r
    };
    // Sample the distance adaptively along the line
    let sample = |k: usize| middle + half * (2.0 * k as f64 / SAMPLES as f64 - 1.0);
    let mut samples = vec![sample(0)];
    // Right ends of the intervals that remain to be sampled, the next one last.
    let mut ahead: Vec<f64> = (1..=SAMPLES).rev().map(sample).collect();
    let unsure = delta.abs() * 8.0;
    while let Some(&right) = ahead.last() {
        let left = samples[samples.len() - 1];
        let length = (right - left) * d.length();
        let is_far = depth(left).abs() + depth(right).abs() > length + unsure;
        let between = 0.5 * (left + right);
        if is_far || length <= FINEST * r || !(left < between && between < right) {
            samples.push(right);
            ahead.pop();
        } else {
            ahead.push(between);
        }
    }
    // Insert the extrema between the samples
    let mut positions = samples.clone();
    for around in samples.windows(3) {
        let [before, here, after] = [0, 1, 2].map(|k| depth(around[k]));
        if (here - before) * (after - here) <= 0.0 {
            let sign = if here <= before { 1.0 } else { -1.0 };
            positions.push(lowest(|t| sign * depth(t), around[0], around[2]));
        }
    }
    positions.sort_by(f64::total_cmp);
    // Bisect between points on different sides, in double-double precision
    let radius = DoubleDouble::of(r) + DoubleDouble::of(delta);
    let is_inside = |t: DoubleDouble| {
        let p = at(o, d, t);
        let across = p[0] * p[0] + p[1] * p[1];
        let k = across + p[2] * p[2] + DoubleDouble::of(1.0) - radius * radius;
        k * k <= DoubleDouble::of(4.0) * across
    };
    let mut ends = Vec::new();
    for pair in positions.windows(2) {
        let (mut a, mut b) = (DoubleDouble::of(pair[0]), DoubleDouble::of(pair[1]));
        let first = is_inside(a);
        if first != is_inside(b) {
            for _ in 0..110 {
                let m = DoubleDouble::of(0.5) * (a + b);
                if is_inside(m) == first { a = m } else { b = m }
            }
            ends.push(a);
        }
    }
    ends.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect()
}

/// First intersection of a ray with a torus, as far as it is certain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum FirstCrossing {
    /// Miss for every allowed displacement of its surface.
    Nowhere,
    /// Hit between these two parameters for every allowed displacement of the surface; before the first the ray is not
    /// near it.
    Between(f64, f64),
}

/// Largest number of marching steps: a ray that grazes the surface takes many.
const MARCH_STEPS: usize = 256;

/// Returns the first hit of a ray that starts well away from the surface of a torus of tube radius `r`, in or out, by
/// sphere tracing (Hart, "Sphere tracing", 1996), up to where it is within `share` of the parameter: for all surfaces
/// that are moved by `delta` or less. The distances are off by less than half of `delta`. Returns `None` if that is
/// inconclusive, as for a ray that grazes.
pub(crate) fn first_crossing_of_torus(
    r: f64,
    delta: f64,
    (o, d): (DVec3, DVec3),
    share: f64,
) -> Option<FirstCrossing> {
    let depth = |t: f64| {
        let p = o + t * d;
        let across = (p.x * p.x + p.y * p.y).sqrt() - 1.0;
        (across * across + p.z * p.z).sqrt() - r
    };
    let side = depth(0.0).signum();
    let free = |t: f64| side * depth(t);
    let length = d.length();
    // Parameter beyond which the ray has left the bounding sphere of the torus.
    let end = (o.length() + 1.0 + r + 2.0 * delta) / length;
    let mut t = 0.0;
    // March by the distance to the surface, less its error
    for _ in 0..MARCH_STEPS {
        let distance = free(t);
        // Near the surface, bracket the hit
        if distance <= 4.0 * delta {
            let past = t * (1.0 + share);
            let is_at_start = t == 0.0;
            let is_past = free(past) < -4.0 * delta;
            return (is_past && !is_at_start).then_some(FirstCrossing::Between(t, past));
        }
        t += (distance - 2.0 * delta) / length;
        // Beyond the bounding sphere the ray misses
        if t > end {
            return Some(FirstCrossing::Nowhere);
        }
    }
    None
}

/// Returns the position of the minimum of `f`, which has one between `a` and `b`, by golden-section search.
fn lowest(f: impl Fn(f64) -> f64, mut a: f64, mut b: f64) -> f64 {
    for _ in 0..80 {
        let (left, right) = (a + 0.382 * (b - a), a + 0.618 * (b - a));
        if f(left) <= f(right) { b = right } else { a = left }
    }
    0.5 * (a + b)
}

/// Returns the interval of the whole line.
pub(crate) fn whole_line() -> Intervals {
    vec![ALWAYS]
}

/// Returns whether all intervals of `inner` are within intervals of `outer`.
#[cfg(test)]
pub(crate) fn is_within(inner: &[[DoubleDouble; 2]], outer: &[[DoubleDouble; 2]]) -> bool {
    let covered = |i: &[DoubleDouble; 2]| outer.iter().any(|o| o[0] <= i[0] && i[1] <= o[1]);
    inner.iter().all(covered)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    #[test]
    fn the_textbook_ray_is_inside_the_unit_sphere_between_its_two_roots() {
        let sphere = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, -1.0];
        let found = inside_quadric(
            &sphere,
            DVec3::ZERO,
            DVec3::new(3.0, 2.0, 3.0),
            DVec3::new(-3.0, -2.0, -3.0),
        );
        assert!((found[0][0].nearest() - 0.786_799_283_644_389_6).abs() < 1e-15);
        assert!((found[0][1].nearest() - 1.213_200_716_355_610_4).abs() < 1e-15);
    }

    #[test]
    fn two_short_crossings_of_a_thin_tube_that_lie_side_by_side_are_both_found() {
        // Roots of the quartic to 50 digits: 0.999890987492, 1.00000411635, 1.00055844557, 1.00192016807.
        let o = [8.674982e1f32, -4.919767e1, 8.179927e0].map(f64::from);
        let d = [-8.620179e1f32, 5.002434e1, -8.174167e0].map(f64::from);
        let found = inside_torus(0.01, 0.0, DVec3::from_array(o), DVec3::from_array(d));
        let exact = [
            [0.999_890_987_492, 1.000_004_116_35],
            [1.000_558_445_57, 1.001_920_168_07],
        ];
        assert_eq!(found.len(), 2);
        for (found, exact) in found.iter().flatten().zip(exact.as_flattened()) {
            assert!((found.nearest() - exact).abs() < 1e-11, "{found:?} for {exact}");
        }
    }

    #[test]
    fn a_march_to_a_torus_brackets_what_bisection_finds() {
        let mut random = SplitMix64::new(7, 0);
        let (mut crossed, mut missed) = (0, 0);
        for number in 0..3000 {
            // Aim a random ray near the tube
            let r = random.choose(&[0.5, 0.1, 0.01]);
            let delta = 1e-12;
            let o = random.choose(&[0.3, 2.0, 100.0]) * random.direction();
            let around = random.direction().with_z(0.0).normalize_or_zero();
            let d = around + 1.2 * r * random.in_cube() - o;
            // Find the first hit by bisection
            let ends = |delta: f64| {
                let inside = inside_torus(r, delta, o, d);
                let mut ends = inside.into_iter().flatten().map(DoubleDouble::nearest);
                ends.find(|&t| t >= 0.0)
            };
            // Bracket the first hit by marching
            match first_crossing_of_torus(r, delta, (o, d), 1e-9) {
                Some(FirstCrossing::Between(low, high)) => {
                    crossed += 1;
                    for end in [-delta, delta].map(ends) {
                        assert!(end.is_some_and(|t| low <= t && t <= high), "{number}: {end:?}");
                    }
                }
                Some(FirstCrossing::Nowhere) => {
                    missed += 1;
                    assert_eq!([-delta, delta].map(ends), [None; 2], "{number}");
                }
                None => {}
            }
        }
        assert!(crossed > 2000 && missed > 200, "{crossed} {missed}");
    }
}
