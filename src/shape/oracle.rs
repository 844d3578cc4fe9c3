//! The shapes' referee: numbers of 106 bits, and the part of a line inside a shape that is made a little larger or
//! smaller.
//!
//! An answer is right if it is the exact one for a surface moved by no more than rounding explains: what is inside the
//! smaller shape must be claimed, and what is claimed must be inside the larger one. That covers misses and tangents
//! without special cases. The referee's formulas are the plain ones (no shifted origin, no cross products).

use std::cmp::Ordering;
use std::ops::{Add, Div, Mul, Neg, Sub};

use glam::DVec3;

/// SplitMix64 (Steele, Lea and Flood, 2014).
pub(super) struct Random(u64);

impl Random {
    pub(super) fn new(seed: u64) -> Random {
        Random(seed)
    }

    pub(super) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub(super) fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// One of several values.
    pub(super) fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[(self.bits() % from.len() as u64) as usize]
    }

    /// Uniform in the cube [-1, 1)³.
    pub(super) fn in_cube(&mut self) -> DVec3 {
        2.0 * DVec3::new(self.unit(), self.unit(), self.unit()) - DVec3::ONE
    }

    /// A unit vector, uniform over the sphere.
    pub(super) fn direction(&mut self) -> DVec3 {
        loop {
            let v = self.in_cube();
            if v.length_squared() <= 1.0 && v != DVec3::ZERO {
                return v.normalize();
            }
        }
    }
}

/// An unevaluated sum of two numbers (Dekker, 1971): 106 bits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wide(f64, f64);

impl Wide {
    pub(super) fn of(x: f64) -> Wide {
        Wide(x, 0.0)
    }

    /// The sum, exact if |a| >= |b|.
    fn quick(a: f64, b: f64) -> Wide {
        let s = a + b;
        if s.is_finite() {
            Wide(s, b - (s - a))
        } else {
            Wide(s, 0.0)
        }
    }

    pub(super) fn sqrt(self) -> Wide {
        if self.0 <= 0.0 {
            return Wide::of(0.0);
        }
        let x = Wide::of(self.0.sqrt());
        // One Newton step doubles the digits.
        x + (self - x * x) / (x + x)
    }

    pub(super) fn nearest(self) -> f64 {
        self.0
    }
}

impl Add for Wide {
    type Output = Wide;
    fn add(self, other: Wide) -> Wide {
        let s = self.0 + other.0;
        let b = s - self.0;
        let error = (self.0 - (s - b)) + (other.0 - b);
        Wide::quick(s, error + (self.1 + other.1))
    }
}

impl Neg for Wide {
    type Output = Wide;
    fn neg(self) -> Wide {
        Wide(-self.0, -self.1)
    }
}

impl Sub for Wide {
    type Output = Wide;
    fn sub(self, other: Wide) -> Wide {
        self + -other
    }
}

impl Mul for Wide {
    type Output = Wide;
    fn mul(self, other: Wide) -> Wide {
        let p = self.0 * other.0;
        let error = self.0.mul_add(other.0, -p);
        Wide::quick(p, error + (self.0 * other.1 + self.1 * other.0))
    }
}

impl Div for Wide {
    type Output = Wide;
    fn div(self, other: Wide) -> Wide {
        let first = Wide::of(self.0 / other.0);
        let rest = self - first * other;
        let second = Wide::of(rest.0 / other.0);
        let rest = rest - second * other;
        first + second + Wide::of(rest.0 / other.0)
    }
}

impl PartialOrd for Wide {
    fn partial_cmp(&self, other: &Wide) -> Option<Ordering> {
        Some(self.0.partial_cmp(&other.0)?.then(self.1.partial_cmp(&other.1)?))
    }
}

/// A point or vector of wide numbers.
pub(super) type Wide3 = [Wide; 3];

pub(super) fn wide3(v: DVec3) -> Wide3 {
    v.to_array().map(Wide::of)
}

pub(super) fn dot(a: Wide3, b: Wide3) -> Wide {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The point at `t`.
pub(super) fn at(o: DVec3, d: DVec3, t: Wide) -> Wide3 {
    let (o, d) = (wide3(o), wide3(d));
    [0, 1, 2].map(|k| o[k] + t * d[k])
}

/// Disjoint intervals in ascending order.
pub(super) type Intervals = Vec<[Wide; 2]>;

const ALWAYS: [Wide; 2] = [Wide(f64::NEG_INFINITY, 0.0), Wide(f64::INFINITY, 0.0)];

/// Where the line is in xᵀ Q x <= 0 about `center`, `q` being the upper triangle row by row.
pub(super) fn inside_quadric(q: &[f64; 10], center: DVec3, o: DVec3, d: DVec3) -> Intervals {
    const PLACE: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]];
    let form = |u: [Wide; 4], v: [Wide; 4]| {
        let mut sum = Wide::of(0.0);
        for (i, row) in PLACE.iter().enumerate() {
            for (j, place) in row.iter().enumerate() {
                sum = sum + Wide::of(q[*place]) * u[i] * v[j];
            }
        }
        sum
    };
    let (o, d, center) = (wide3(o), wide3(d), wide3(center));
    let o = [0, 1, 2].map(|k| o[k] - center[k]);
    let (one, zero) = (Wide::of(1.0), Wide::of(0.0));
    let (o, d) = ([o[0], o[1], o[2], one], [d[0], d[1], d[2], zero]);
    let (a, b, c) = (form(d, d), -form(o, d), form(o, o));
    let discriminant = b * b - a * c;
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

/// The part of `intervals` with n · x <= h.
pub(super) fn cut(intervals: Intervals, n: DVec3, h: f64, o: DVec3, d: DVec3) -> Intervals {
    let slope = dot(wide3(n), wide3(d));
    let room = Wide::of(h) - dot(wide3(n), wide3(o));
    let zero = Wide::of(0.0);
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

/// The whole line.
pub(super) fn whole() -> Intervals {
    vec![ALWAYS]
}

/// Whether all of `inner` is within `outer`.
pub(super) fn is_within(inner: &[[Wide; 2]], outer: &[[Wide; 2]]) -> bool {
    let covered = |i: &[Wide; 2]| outer.iter().any(|o| o[0] <= i[0] && i[1] <= o[1]);
    inner.iter().all(covered)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_numbers_keep_what_a_float_drops() {
        let tiny = Wide::of(2f64.powi(-80));
        let one = Wide::of(1.0);
        assert_eq!((one + tiny) - one, tiny);
        // (1 + 2^-60)² - 1 - 2·2^-60 = 2^-120, beyond 106 bits: 0 up to 2^-105.
        let x = one + Wide::of(2f64.powi(-60));
        let rest = x * x - one - Wide::of(2f64.powi(-59));
        assert!(rest.nearest().abs() <= 2f64.powi(-105));
        let third = one / Wide::of(3.0);
        assert!((third * Wide::of(3.0) - one).nearest().abs() <= 2f64.powi(-104));
        let root = Wide::of(2.0).sqrt();
        assert!((root * root - Wide::of(2.0)).nearest().abs() <= 2f64.powi(-103));
    }

    #[test]
    fn the_lectures_ray_is_inside_the_unit_sphere_between_its_two_roots() {
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
}
