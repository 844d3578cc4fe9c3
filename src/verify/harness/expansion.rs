//! Exact geometric predicates: signs of determinants without rounding.
//!
//! A number is an expansion, the exact sum of floats that do not overlap (Shewchuk, "Adaptive Precision Floating-Point
//! Arithmetic and Fast Robust Geometric Predicates", 1997). Differences and products of f32 numbers to the eighth
//! degree stay far within the exponent range of f64, so that nothing over- or underflows: predicates on f32 rays and
//! triangles have no error bound. Predicates first try f64 with an error bound, which mostly suffices.

use std::cmp::Ordering;

use glam::DVec3;

use crate::numeric::DoubleDouble;
use crate::shape::oracle::double_double3;

/// Floating-point expansion: an exact sum of floats, smallest first, without overlap.
#[derive(Clone, Debug, Default)]
pub(in crate::verify) struct Expansion(Vec<f64>);

impl Expansion {
    /// Converts a float to an expansion.
    pub(in crate::verify) fn of(x: f64) -> Expansion {
        Expansion(vec![x])
    }

    /// Returns a - b without rounding.
    pub(in crate::verify) fn difference(a: f64, b: f64) -> Expansion {
        let (sum, error) = two_sum(a, -b);
        Expansion(vec![error, sum])
    }

    /// Returns the sum of this number and a float (Shewchuk's GROW-EXPANSION).
    fn grow(mut self, x: f64) -> Expansion {
        let mut carried = x;
        for part in &mut self.0 {
            let (sum, error) = two_sum(carried, *part);
            *part = error;
            carried = sum;
        }
        self.0.push(carried);
        // Drop zeros, which would only lengthen later sums
        self.0.retain(|&part| part != 0.0);
        self
    }

    /// Returns the exact sum of two numbers.
    pub(in crate::verify) fn plus(self, other: &Expansion) -> Expansion {
        other.0.iter().fold(self, |sum, &x| sum.grow(x))
    }

    /// Returns the exact difference of two numbers.
    pub(in crate::verify) fn minus(self, other: &Expansion) -> Expansion {
        other.0.iter().fold(self, |sum, &x| sum.grow(-x))
    }

    /// Returns the exact product of two numbers.
    pub(in crate::verify) fn times(&self, other: &Expansion) -> Expansion {
        let mut product = Expansion::default();
        for &a in &self.0 {
            for &b in &other.0 {
                let high = a * b;
                // Add the product as its rounded value and the rounding error
                product = product.grow(a.mul_add(b, -high)).grow(high);
            }
        }
        product
    }

    /// Returns the sign: `Greater` for positive numbers.
    pub(in crate::verify) fn sign(&self) -> Ordering {
        // Components do not overlap, so the last one that is not zero outweighs all others.
        let last = self.0.iter().rev().find(|&&part| part != 0.0);
        last.map_or(Ordering::Equal, |part| part.total_cmp(&0.0))
    }

    /// Returns the number rounded to 106 bits.
    pub(in crate::verify) fn to_double_double(&self) -> DoubleDouble {
        self.0
            .iter()
            .fold(DoubleDouble::ZERO, |sum, &part| sum + DoubleDouble::of(part))
    }
}

/// Returns a + b and its rounding error (Knuth's TwoSum).
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_part = sum - a;
    (sum, (a - (sum - b_part)) + (b - b_part))
}

/// Vector of three expansions.
pub(super) type Expansion3 = [Expansion; 3];

/// Returns the vector a - b without rounding.
pub(in crate::verify) fn between(a: DVec3, b: DVec3) -> Expansion3 {
    [0, 1, 2].map(|k| Expansion::difference(a[k], b[k]))
}

/// Converts a vector of floats to expansions.
pub(super) fn expansion3(v: DVec3) -> Expansion3 {
    v.to_array().map(Expansion::of)
}

/// Returns the dot product a · b.
pub(in crate::verify) fn dot(a: &Expansion3, b: &Expansion3) -> Expansion {
    a[0].times(&b[0])
        .plus(&a[1].times(&b[1]))
        .plus(&a[2].times(&b[2]))
}

/// Returns the cross product a x b.
pub(in crate::verify) fn cross(a: &Expansion3, b: &Expansion3) -> Expansion3 {
    [0, 1, 2].map(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        a[i].times(&b[j]).minus(&a[j].times(&b[i]))
    })
}

/// Error bound of a determinant of three differences, as a share of its terms' absolute values: in roundings of 2^-53,
/// 1 for a difference in each of three factors, 3 for products, 4 for sums, and rounded up.
const DETERMINANT_ERROR: f64 = 16.0 / (1u64 << 53) as f64;

/// Returns the sign of `d · ((a - o) x (b - o))`, which is the side of the edge from `a` to `b` on which the line `o +
/// t d` passes. All coordinates must be f32 values.
pub(in crate::verify) fn side(o: DVec3, d: DVec3, [a, b]: [DVec3; 2]) -> Ordering {
    // Try f64 with its error bound
    let (p, q) = (a - o, b - o);
    let size = |p: DVec3, q: DVec3| {
        let minor = |i: usize, j: usize| p[i] * q[j] + p[j] * q[i];
        DVec3::new(minor(1, 2), minor(2, 0), minor(0, 1))
    };
    let determinant = d.dot(p.cross(q));
    if determinant.abs() > DETERMINANT_ERROR * d.abs().dot(size(p.abs(), q.abs())) {
        return determinant.total_cmp(&0.0);
    }
    // Decide by exact arithmetic
    dot(&expansion3(d), &cross(&between(a, o), &between(b, o))).sign()
}

/// Relative position of a line and a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SurfaceCrossing {
    /// Line that misses the triangle.
    Beside,
    /// Line through the interior of the triangle.
    Through,
    /// Line through an edge or a vertex of the triangle.
    Touching,
    /// Line in the plane of the triangle.
    Edgewise,
}

/// Classifies the line `o + t d` against a triangle. All coordinates must be f32 values.
pub(super) fn crossing(o: DVec3, d: DVec3, [a, b, c]: [DVec3; 3]) -> SurfaceCrossing {
    let sides = [[a, b], [b, c], [c, a]].map(|edge| side(o, d, edge));
    let has = |sign| sides.contains(&sign);
    match (has(Ordering::Less), has(Ordering::Greater), has(Ordering::Equal)) {
        (true, true, _) => SurfaceCrossing::Beside,
        (false, false, _) => SurfaceCrossing::Edgewise,
        (_, _, true) => SurfaceCrossing::Touching,
        (_, _, false) => SurfaceCrossing::Through,
    }
}

/// Returns the parameter at which the line `o + t d` intersects the plane of a triangle; NaN or infinite if the line is
/// parallel to the plane. All coordinates must be f32 values.
///
/// Its two determinants are correct to 2^-100 of their largest terms: a triangle 10^9 times as long as high, seen at
/// 10^-4 to its plane, leaves 55 of their bits.
pub(in crate::verify) fn parameter(o: DVec3, d: DVec3, [a, b, c]: [DVec3; 3]) -> DoubleDouble {
    let minus = |p: DVec3, q: DVec3| [0, 1, 2].map(|k| DoubleDouble::of(p[k]) - DoubleDouble::of(q[k]));
    let (e1, e2) = (minus(b, a), minus(c, a));
    let n = [0, 1, 2].map(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        e1[i] * e2[j] - e1[j] * e2[i]
    });
    let along = |v: [DoubleDouble; 3]| n[0] * v[0] + n[1] * v[1] + n[2] * v[2];
    along(minus(a, o)) / along(double_double3(d))
}

/// Returns `r² - |c - l|²` times `d · d`, where l is the point of the line `o + t d` closest to the sphere's centre c
/// and r is the radius: positive if the line intersects the sphere, zero if it is tangent.
pub(in crate::verify) fn discriminant(o: DVec3, d: DVec3, c: DVec3, r: f64) -> Expansion {
    let (f, d) = (between(o, c), expansion3(d));
    let moment = cross(&f, &d);
    let r = Expansion::of(r);
    dot(&d, &d).times(&r.times(&r)).minus(&dot(&moment, &moment))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    #[test]
    fn sum_keeps_terms_two_hundred_bits_smaller() {
        let tiny = 2f64.powi(-200);
        let sum = Expansion::of(1.0).plus(&Expansion::of(tiny));
        assert_eq!(
            sum.clone()
                .minus(&Expansion::of(1.0))
                .to_double_double()
                .nearest(),
            tiny
        );
        // (1 + x)² - 1 - 2 x = x².
        let rest = sum
            .times(&sum)
            .minus(&Expansion::of(1.0))
            .minus(&Expansion::of(2.0 * tiny));
        assert_eq!(rest.to_double_double().nearest(), tiny * tiny);
        assert_eq!(rest.minus(&Expansion::of(tiny * tiny)).sign(), Ordering::Equal);
    }

    #[test]
    fn line_one_rounding_beside_edge_is_on_that_side() {
        let (a, b) = (DVec3::new(-1.0, 0.0, 7.0), DVec3::new(1.0, 0.0, 7.0));
        for (y, sign) in [
            (0.0, Ordering::Equal),
            (1e-45, Ordering::Greater),
            (-1e-45, Ordering::Less),
        ] {
            let y = f64::from(y as f32);
            let o = DVec3::new(0.25, -y, 0.0);
            assert_eq!(side(o, DVec3::Z, [b, a]), sign, "{y:e}");
            assert_eq!(side(o, DVec3::Z, [a, b]), sign.reverse(), "{y:e}");
        }
    }

    #[test]
    fn signs_agree_with_integers() {
        let seed = 3;
        let mut random = SplitMix64::new(seed, 0);
        let mut counts = [0; 3];
        for _ in 0..20_000 {
            // Small coordinates, so that many determinants vanish, and i64 holds all of them
            let mut point = || [0; 3].map(|_| random.below(7) as i64 - 3);
            let [o, d, a, b] = [point(), point(), point(), point()];
            let minus = |p: [i64; 3]| [0, 1, 2].map(|k| p[k] - o[k]);
            let (p, q) = (minus(a), minus(b));
            let n = [0, 1, 2].map(|k| p[(k + 1) % 3] * q[(k + 2) % 3] - p[(k + 2) % 3] * q[(k + 1) % 3]);
            let expected = (d[0] * n[0] + d[1] * n[1] + d[2] * n[2]).cmp(&0);
            let [o, d, a, b] = [o, d, a, b].map(|v| DVec3::from_array(v.map(|x| x as f64)));
            assert_eq!(side(o, d, [a, b]), expected, "seed {seed}: {o} {d} {a} {b}");
            counts[(expected as i8 + 1) as usize] += 1;
        }
        assert!(counts.iter().all(|&count| count > 1000), "{counts:?}");
    }

    #[test]
    fn line_crosses_touches_misses_or_lies_in_triangle() {
        let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let from = |x, y| crossing(DVec3::new(x, y, -1.0), DVec3::Z, triangle);
        assert_eq!(from(0.25, 0.25), SurfaceCrossing::Through);
        assert_eq!(from(0.5, 0.5), SurfaceCrossing::Touching);
        assert_eq!(from(0.0, 0.0), SurfaceCrossing::Touching);
        assert_eq!(from(0.5, 0.5 + f64::from(f32::EPSILON)), SurfaceCrossing::Beside);
        assert_eq!(
            crossing(-DVec3::ONE.with_z(0.0), DVec3::X, triangle),
            SurfaceCrossing::Edgewise
        );
        assert_eq!(parameter(-DVec3::Z, DVec3::Z, triangle).nearest(), 1.0);
    }

    #[test]
    fn tangent_has_zero_discriminant_and_neighbours_have_either_sign() {
        let at = |x: f32| discriminant(DVec3::new(x.into(), 0.0, -5.0), DVec3::Z, DVec3::ZERO, 1.0).sign();
        assert_eq!(at(1.0), Ordering::Equal);
        assert_eq!(at(1f32.next_down()), Ordering::Greater);
        assert_eq!(at(1f32.next_up()), Ordering::Less);
    }
}
