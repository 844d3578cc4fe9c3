//! Real roots of polynomials: quadratics in closed form without cancellation, quartics by bracketing.
//!
//! Between two neighbouring roots of its derivative a polynomial is monotone, so its signs at these points bracket its
//! roots without any radicals; each root is then found by Newton steps confined to a shrinking bracket.

/// Returns both roots of `a t² - 2 b t + c`, in ascending order, given `discriminant = b² - a c` in the form that
/// cancels least; NaN if there are none. For `a` zero, one root is infinite.
///
/// The roots are `c / q` with `q = b ± √(b² - a c)` of the larger magnitude, and `q / a`: neither subtracts nearly
/// equal numbers.
#[inline(always)]
pub fn quadratic_roots(a: f64, b: f64, c: f64, discriminant: f64) -> [f64; 2] {
    // The root of a negative number is NaN, and so is everything computed from it.
    let q = b + discriminant.sqrt().copysign(b);
    // If q is zero, so are b and a c: a double root at 0, unless the polynomial is constant.
    let double = (q == 0.0) & (a != 0.0);
    let t0 = if double { 0.0 } else { c / q };
    let t1 = if double { 0.0 } else { q / a };
    if t0 <= t1 { [t0, t1] } else { [t1, t0] }
}

/// Number of steps after which a bracket is narrow enough in any case: 53 bisections, and as many Newton steps between.
const STEP_LIMIT: usize = 106;

/// Calls `found` for the points of [`low`, `high`], in ascending order, at which the polynomial with the coefficients
/// `c` (constant term first) changes its sign from the previous one, `positive` at first. `found` returns whether to
/// continue.
///
/// Zero counts as positive, so a root at which the graph touches from above is none. Roots are within two ulps of the
/// larger end of the interval, for the polynomial as it is evaluated.
pub(crate) fn quartic_sign_changes(
    c: &[f64; 5],
    [low, high]: [f64; 2],
    positive: bool,
    found: impl FnMut(f64) -> bool,
) {
    // Find the extrema as sign changes of the derivative
    let mut extrema = Points::default();
    let derivative = [c[1], 2.0 * c[2], 3.0 * c[3], 4.0 * c[4]];
    let derivative_positive = value(&derivative, low).0 >= 0.0;
    cubic_sign_changes(&derivative, [low, high], derivative_positive, |x| extrema.push(x));
    sign_changes(c, &extrema, [low, high], positive, found);
}

/// Calls `found` for the sign changes of a cubic, as [`quartic_sign_changes`] does for a quartic.
pub(crate) fn cubic_sign_changes(
    c: &[f64; 4],
    [low, high]: [f64; 2],
    positive: bool,
    found: impl FnMut(f64) -> bool,
) {
    let mut extrema = Points::default();
    let (a, b) = (3.0 * c[3], -c[2]);
    for x in quadratic_roots(a, b, c[1], b * b - a * c[1]) {
        if low < x && x < high {
            extrema.push(x);
        }
    }
    sign_changes(c, &extrema, [low, high], positive, found);
}

/// List of up to three points in ascending order.
#[derive(Default)]
struct Points {
    values: [f64; 3],
    count: usize,
}

impl Points {
    fn push(&mut self, x: f64) -> bool {
        if let Some(slot) = self.values.get_mut(self.count) {
            *slot = x;
            self.count += 1;
        }
        true
    }
}

/// Searches each interval between neighbouring extrema, where the polynomial is monotone, for a sign change.
#[inline]
fn sign_changes<const N: usize>(
    c: &[f64; N],
    extrema: &Points,
    [low, high]: [f64; 2],
    mut positive: bool,
    mut found: impl FnMut(f64) -> bool,
) {
    let mut left = low;
    let mut left_positive = value(c, low).0 >= 0.0;
    let ends = extrema.values[..extrema.count].iter().copied().chain([high]);
    for right in ends {
        let right_positive = value(c, right).0 >= 0.0;
        if right_positive != left_positive && right_positive != positive {
            positive = right_positive;
            if !found(bracketed_root(c, left, right)) {
                return;
            }
        }
        (left, left_positive) = (right, right_positive);
    }
}

/// Returns the root of a polynomial that is monotone between `low` and `high` and has different signs there.
fn bracketed_root<const N: usize>(c: &[f64; N], low: f64, high: f64) -> f64 {
    let (mut low, mut high) = (low, high);
    let rising = value(c, high).0 >= 0.0;
    let resolution = 2.0 * f64::EPSILON * low.abs().max(high.abs());
    let mut x = 0.5 * (low + high);
    let mut last_step = high - low;
    for _ in 0..STEP_LIMIT {
        // Shrink the bracket to the side of the sign change
        let (f, slope) = value(c, x);
        if (f >= 0.0) == rising {
            high = x;
        } else {
            low = x;
        }
        let newton = x - f / slope;
        // Accept a Newton step that stays inside and is at most half the last step; else bisect
        let next = if low <= newton && newton <= high && (newton - x).abs() <= 0.5 * last_step {
            newton
        } else {
            0.5 * (low + high)
        };
        last_step = (next - x).abs();
        x = next;
        if last_step <= resolution {
            break;
        }
    }
    x
}

/// Returns a polynomial and its derivative at `x`, by Horner's scheme.
#[inline(always)]
fn value<const N: usize>(c: &[f64; N], x: f64) -> (f64, f64) {
    let (mut f, mut slope) = (0.0, 0.0);
    for k in (0..N).rev() {
        slope = slope * x + f;
        f = f * x + c[k];
    }
    (f, slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quartic(c: [f64; 5], range: [f64; 2], positive: bool) -> Vec<f64> {
        let mut roots = Vec::new();
        quartic_sign_changes(&c, range, positive, |x| {
            roots.push(x);
            true
        });
        roots
    }

    #[test]
    fn small_root_keeps_its_digits_beside_a_large_one() {
        // (t - 1e-9)(t - 1e9) = t² - (1e9 + 1e-9) t + 1.
        let b = 0.5 * (1e9 + 1e-9);
        let [t0, t1] = quadratic_roots(1.0, b, 1.0, b * b - 1.0);
        assert!((t0 - 1e-9).abs() <= 2.0 * f64::EPSILON * 1e-9);
        assert!((t1 - 1e9).abs() <= 2.0 * f64::EPSILON * 1e9);
    }

    #[test]
    fn degenerate_quadratics_have_one_or_no_finite_root() {
        // -2·2 t + 8 = 0 at t = 2.
        assert_eq!(quadratic_roots(0.0, 2.0, 8.0, 4.0), [2.0, f64::INFINITY]);
        assert_eq!(quadratic_roots(0.0, -2.0, 8.0, 4.0), [f64::NEG_INFINITY, -2.0]);
        assert!(!quadratic_roots(0.0, 0.0, 0.0, 0.0)[0].is_finite());
        assert!(quadratic_roots(1.0, 0.0, 1.0, -1.0)[0].is_nan());
        assert_eq!(quadratic_roots(1.0, 0.0, 0.0, 0.0), [0.0, 0.0]);
    }

    #[test]
    fn four_roots_are_found_in_order_and_accurately() {
        // (x + 2)(x + 1)(x - 1)(x - 3) = x⁴ - x³ - 7 x² + x + 6.
        let roots = quartic([6.0, 1.0, -7.0, -1.0, 1.0], [-10.0, 10.0], true);
        assert_eq!(roots.len(), 4);
        for (root, exact) in roots.iter().zip([-2.0, -1.0, 1.0, 3.0]) {
            assert!((root - exact).abs() <= 8.0 * f64::EPSILON, "{root} for {exact}");
        }
    }

    #[test]
    fn double_roots_and_the_known_first_sign_change_are_omitted() {
        // (x² - 1)² touches zero twice.
        assert!(quartic([1.0, 0.0, -2.0, 0.0, 1.0], [-3.0, 3.0], true).is_empty());
        // x² - 1 from inside: if the sign starts as positive, the change to positive at 1 is not reported.
        assert!(quartic([-1.0, 0.0, 1.0, 0.0, 0.0], [0.0, 3.0], true).is_empty());
        assert_eq!(quartic([-1.0, 0.0, 1.0, 0.0, 0.0], [0.0, 3.0], false).len(), 1);
    }

    #[test]
    fn root_search_stops_on_request() {
        let mut count = 0;
        quartic_sign_changes(&[6.0, 1.0, -7.0, -1.0, 1.0], [-10.0, 10.0], true, |_| {
            count += 1;
            false
        });
        assert_eq!(count, 1);
    }
}
