//! Common core of refraction and Fresnel's equations: `eta_t cos_t` in double-double precision.
//!
//! With p = eta_i cos_i and q = eta_t cos_t, Snell's law reads q² = p² - delta, delta = (eta_i - eta_t)(eta_i + eta_t).
//! All other results follow from sums and differences of p and q, and of eta_t p and eta_i q: the amplitudes are (p -
//! q)/(p + q) and (eta_t² cos_i - eta_i q)/(eta_t² cos_i + eta_i q), the refracted direction is (eta_i d + delta/(p +
//! q) n)/eta_t. The differences cancel: at the critical angle, between media that nearly match, at Brewster's angle.
//! They are therefore taken in double-double arithmetic (Dekker, "A floating-point technique for extending the
//! available precision", 1971; Knuth's two-sum), without fused multiply-add so that all instruction sets give equal
//! bits and lanes vectorise. So near the critical angle that even these digits cancel, q² is summed exactly.

use glam::DVec3;

use super::polarised::Polarised;

/// Factor that splits 53 bits into 26 and 26: 2^27 + 1 (Veltkamp).
const SPLITTER: f64 = 134_217_729.0;

/// Smallest ratio of q² to p² at which double-double precision suffices: its rounding errors are a few 2^-104 of p², so
/// below this ratio q² has less than 55 correct bits.
const CRITICAL: f64 = 1.0 / (1u64 << 46) as f64;

/// Light that hits the boundary of two dielectrics at a given angle.
#[derive(Clone, Copy)]
pub(super) struct DielectricInterface {
    cos_i: f64,
    eta_i: f64,
    eta_t: f64,
    /// Value of (eta_i - eta_t)(eta_i + eta_t).
    delta: f64,
    /// Value of eta_i cos_i.
    p: Double,
    /// Value of eta_t cos_t, zero for total reflection.
    q: Double,
    /// True if nothing is transmitted: beyond the critical angle, or for light that runs inside the boundary.
    pub(super) total: bool,
}

impl DielectricInterface {
    /// Creates the interface; `cos_i` is at least 0 (a rounded excess over 1 is clamped), both indices are positive.
    #[inline(always)]
    pub(super) fn new(cos_i: f64, eta_i: f64, eta_t: f64) -> DielectricInterface {
        let (interface, is_critical) = DielectricInterface::away_from_critical(cos_i, eta_i, eta_t);
        if is_critical {
            interface.recompute_near_critical()
        } else {
            interface
        }
    }

    /// Creates the interface without branches. Also returns whether it is too near the critical angle for this
    /// precision; [`DielectricInterface::new`] then refines it.
    #[inline(always)]
    pub(super) fn away_from_critical(cos_i: f64, eta_i: f64, eta_t: f64) -> (DielectricInterface, bool) {
        // Compute q² = p² - delta in double-double precision
        let cos_i = if cos_i > 1.0 { 1.0 } else { cos_i };
        let p = two_product(eta_i, cos_i);
        let p_square = product(p, p);
        let delta = product(two_sum(eta_i, -eta_t), two_sum(eta_i, eta_t));
        let difference = two_sum(p_square.0, -delta.0);
        let low = difference.1 + (p_square.1 - delta.1);
        let q_square = difference.0 + low;
        // A NaN must not be treated as a refracted ray.
        let total = !(q_square > 0.0);
        let interface = DielectricInterface {
            cos_i,
            eta_i,
            eta_t,
            delta: delta.0 + delta.1,
            p,
            q: if total {
                (0.0, 0.0)
            } else {
                square_root(q_square, (difference.0, low))
            },
            total,
        };
        (interface, q_square.abs() <= CRITICAL * p_square.0)
    }

    /// Returns the interface with q² computed from p² - delta without any rounding except for that of the result.
    #[cold]
    #[inline(never)]
    fn recompute_near_critical(self) -> DielectricInterface {
        let (p, difference_of_indices, both) = (
            self.p,
            two_sum(self.eta_i, -self.eta_t),
            two_sum(self.eta_i, self.eta_t),
        );
        // Expand p² - delta into products of two floats
        let factors = [
            (p.0, p.0),
            (2.0 * p.0, p.1),
            (p.1, p.1),
            (-difference_of_indices.0, both.0),
            (-difference_of_indices.0, both.1),
            (-difference_of_indices.1, both.0),
            (-difference_of_indices.1, both.1),
        ];
        // Split each product into value and error, and sum exactly
        let mut terms = [0.0; 14];
        for (pair, (a, b)) in terms.chunks_exact_mut(2).zip(factors) {
            (pair[0], pair[1]) = two_product(a, b);
        }
        let q_square = exact_sum(terms);
        // Classify by the sign of the exact sum and take its root
        let total = !(q_square.0 > 0.0);
        DielectricInterface {
            q: if total {
                (0.0, 0.0)
            } else {
                square_root(q_square.0, q_square)
            },
            total,
            ..self
        }
    }

    /// Returns the cosine of the refracted ray with the normal; 0 for total reflection.
    #[inline(always)]
    pub(super) fn cos_t(&self) -> f64 {
        self.q.0 / self.eta_t
    }

    /// Returns eta_t times the counterparts of p and q for light polarised in the plane of incidence: eta_t² cos_i and
    /// eta_i q.
    #[inline(always)]
    fn in_plane(&self) -> [Double; 2] {
        let square = two_product(self.eta_t, self.eta_t);
        [
            product(square, (self.cos_i, 0.0)),
            product((self.eta_i, 0.0), self.q),
        ]
    }

    /// Returns the reflected over incident power; 1 for total reflection.
    #[inline(always)]
    pub(super) fn reflectance(&self) -> Polarised {
        let [a, b] = self.in_plane();
        Polarised {
            s: self.squared_amplitude(self.p, self.q),
            p: self.squared_amplitude(a, b),
        }
    }

    /// Returns the squared amplitude ((a - b)/(a + b))².
    #[inline(always)]
    fn squared_amplitude(&self, a: Double, b: Double) -> f64 {
        let amplitude = sum(a, (-b.0, -b.1)) / sum(a, b);
        // Between equal media not even the last digit may remain.
        let share = if self.delta == 0.0 {
            0.0
        } else {
            amplitude * amplitude
        };
        if self.total { 1.0 } else { share }
    }

    /// Returns the transmitted over incident power, not by subtraction; 0 for total reflection.
    #[inline(always)]
    pub(super) fn transmittance(&self) -> Polarised {
        let through = 4.0 * self.p.0 * self.q.0;
        let [a, b] = self.in_plane();
        let s = sum(self.p, self.q);
        let p = sum(a, b) / self.eta_t;
        Polarised {
            s: if self.total { 0.0 } else { through / (s * s) },
            p: if self.total { 0.0 } else { through / (p * p) },
        }
    }

    /// Returns the refracted direction of the unit direction `d`, where `n` is the unit normal that faces it;
    /// meaningless if `total`.
    #[inline(always)]
    pub(super) fn refract(&self, d: DVec3, n: DVec3) -> DVec3 {
        (self.eta_i * d + (self.delta / (self.p.0 + self.q.0)) * n) / self.eta_t
    }
}

/// Returns the cosine of the angle between the direction `d` and the normal `n`, and `n` flipped so that it faces `d`.
#[inline(always)]
pub(super) fn face_forward(d: DVec3, n: DVec3) -> (f64, DVec3) {
    let cos = -d.dot(n);
    (cos.abs(), 1f64.copysign(cos) * n)
}

/// Double-double number: the unevaluated sum of a rounded number and its rounding error.
type Double = (f64, f64);

/// Returns a + b without error (Knuth's two-sum).
#[inline(always)]
fn two_sum(a: f64, b: f64) -> Double {
    let sum = a + b;
    let b_part = sum - a;
    (sum, (a - (sum - b_part)) + (b - b_part))
}

/// Returns the nearest float to a sum and the nearest float to the remainder, both of the exact sum (Shewchuk,
/// "Adaptive Precision Floating-Point Arithmetic", 1997: the components grow by one term at a time and never overlap).
fn exact_sum<const N: usize>(terms: [f64; N]) -> Double {
    let mut parts = [0.0; N];
    for (count, term) in terms.into_iter().enumerate() {
        let mut carried = term;
        for part in &mut parts[..count] {
            (carried, *part) = two_sum(carried, *part);
        }
        parts[count] = carried;
    }
    parts.iter().fold((0.0, 0.0), |sum, &part| {
        let (high, low) = two_sum(sum.0, part);
        (high, low + sum.1)
    })
}

/// Returns a b without error, unless it over- or underflows.
#[inline(always)]
fn two_product(a: f64, b: f64) -> Double {
    let product = a * b;
    let (a_high, a_low) = split(a);
    let (b_high, b_low) = split(b);
    let error = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low;
    (product, error)
}

/// Returns the nearest float to the sum of two double-double numbers, or a neighbour of it.
#[inline(always)]
fn sum(a: Double, b: Double) -> f64 {
    let (high, low) = two_sum(a.0, b.0);
    high + (low + (a.1 + b.1))
}

/// Returns the square root of a positive double-double number, whose nearest float is `nearest`: one Newton step from
/// the root of that float.
#[inline(always)]
fn square_root(nearest: f64, x: Double) -> Double {
    let root = nearest.sqrt();
    let square = two_product(root, root);
    let rest = ((x.0 - square.0) - square.1) + x.1;
    let low = 0.5 * rest / root;
    // Renormalise, so that the first component is the nearest float.
    let high = root + low;
    (high, low - (high - root))
}

/// Splits a float into two halves of at most 26 bits (Veltkamp).
#[inline(always)]
fn split(a: f64) -> Double {
    let scaled = SPLITTER * a;
    let high = scaled - (scaled - a);
    (high, a - high)
}

/// Returns the product of two double-double numbers, with a relative error of a few 2^-106.
#[inline(always)]
fn product(a: Double, b: Double) -> Double {
    let (high, low) = two_product(a.0, b.0);
    (high, low + (a.0 * b.1 + a.1 * b.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn product_keeps_the_rounding_error() {
        // (1 + 2^-30)² = 1 + 2^-29 + 2^-60, whose last term does not fit into 53 bits.
        let a = 1.0 + 2f64.powi(-30);
        assert_eq!(two_product(a, a), (1.0 + 2f64.powi(-29), 2f64.powi(-60)));
    }

    #[test]
    fn sum_keeps_the_rounding_error() {
        assert_eq!(two_sum(1.0, 2f64.powi(-60)), (1.0, 2f64.powi(-60)));
        assert_eq!(two_sum(2f64.powi(-60), -1.0), (-1.0, 2f64.powi(-60)));
    }

    #[test]
    fn exact_sum_survives_double_cancellation() {
        let tiny = 2f64.powi(-140);
        let sum = exact_sum([
            1.0,
            2f64.powi(-70),
            tiny,
            -1.0,
            -2f64.powi(-70),
            tiny * 2f64.powi(-60),
        ]);
        assert_eq!(sum, (tiny, tiny * 2f64.powi(-60)));
    }

    #[test]
    fn an_angle_at_which_doubles_cancel_too_is_refracted_to_the_last_places() {
        // Exact result for these numbers, by rational arithmetic: cos_t = 4.184753292508398e-11.
        let cos_t =
            DielectricInterface::new(6.124812217946641e-2, 1.6918398083634327, 1.6886634999132542).cos_t();
        assert!(
            (cos_t - 4.184753292508398e-11).abs() <= 2.0 * f64::EPSILON * cos_t,
            "{cos_t:e}"
        );
    }

    #[test]
    fn nan_is_never_refracted() {
        assert!(DielectricInterface::new(f64::NAN, 1.0, 1.5).total);
    }
}
