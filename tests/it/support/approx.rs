//! Running error analysis: numbers with a bound on the error of an f32 computation.
//!
//! Running error analysis (Wilkinson; Higham, "Accuracy and Stability of Numerical Algorithms", 2nd ed., 3.3): the
//! value is computed in f64, together with a bound on the effect of uncertain inputs and of one f32 rounding per
//! operation. The bound thus follows the conditioning of every formula: it grows at the peak of a highlight, at a
//! silhouette and with every curved mirror, and stays at a few 2^-24 where the problem is well conditioned.

use std::ops::{Add, Div, Mul, Neg, Sub};

use glam::DVec3;

/// Unit roundoff of f32: the relative error of one rounding.
pub const ROUNDING: f64 = 1.0 / 16_777_216.0;

/// Error bound of an unknown number. It is finite, so that slacks of uncertain signs remain comparable.
const LOST: f64 = 1e30;

/// Error bound beyond which a value is regarded as unknown.
pub const HOPELESS: f64 = 1e6;

/// Number with a bound on the error of its f32 computation.
#[derive(Clone, Copy, Debug)]
pub struct Approx {
    /// Value of the reference computation, in f64.
    pub value: f64,
    /// Bound on the error of an f32 computation; huge if no bound can be given.
    pub error: f64,
}

impl Approx {
    pub const ZERO: Approx = Approx::exact(0.0);
    pub const ONE: Approx = Approx::exact(1.0);

    /// Creates a number that every implementation represents exactly.
    pub const fn exact(value: f64) -> Approx {
        Approx { value, error: 0.0 }
    }

    /// Creates a number that other implementations may round to f32.
    pub fn rounded(value: f64) -> Approx {
        Approx::computed(value, 0.0)
    }

    /// Creates the result of one more f32 operation on operands with the error `inherited`.
    fn computed(value: f64, inherited: f64) -> Approx {
        let error = (inherited + ROUNDING * value.abs()).min(LOST);
        if value.is_finite() && !error.is_nan() {
            Approx { value, error }
        } else {
            Approx {
                value: if value.is_finite() { value } else { 0.0 },
                error: LOST,
            }
        }
    }

    /// Returns the number with its error increased by `more`.
    pub fn widened(self, more: f64) -> Approx {
        Approx {
            error: self.error + more,
            ..self
        }
    }

    pub fn sqrt(self) -> Approx {
        let root = self.value.max(0.0).sqrt();
        let lowest = (self.value - self.error).max(0.0).sqrt();
        let inherited = if self.error == 0.0 {
            0.0
        } else {
            (self.error / (root + lowest)).min((self.value.max(0.0) + self.error).sqrt())
        };
        Approx::computed(root, inherited)
    }

    pub fn squared(self) -> Approx {
        self * self
    }

    pub fn abs(self) -> Approx {
        Approx {
            value: self.value.abs(),
            ..self
        }
    }

    /// Returns the number clamped to [`low`, `high`]: the error is 0 if it is surely outside.
    pub fn clamp(self, low: f64, high: f64) -> Approx {
        if self.value + self.error <= low {
            Approx::exact(low)
        } else if self.value - self.error >= high {
            Approx::exact(high)
        } else {
            Approx {
                value: self.value.clamp(low, high),
                ..self
            }
        }
    }

    /// Returns a number that is known to lie in [`low`, `high`].
    pub fn known_within(self, low: f64, high: f64) -> Approx {
        let value = self.value.clamp(low, high);
        Approx {
            value,
            error: self.error.min((value - low).max(high - value)),
        }
    }

    /// Returns the larger one of two numbers.
    pub fn max(self, b: Approx) -> Approx {
        let (larger, smaller) = if b.value > self.value {
            (b, self)
        } else {
            (self, b)
        };
        let is_certain = larger.value - larger.error >= smaller.value + smaller.error;
        Approx {
            error: if is_certain {
                larger.error
            } else {
                larger.error.max(smaller.error)
            },
            ..larger
        }
    }

    /// Returns the number if positive, else zero.
    pub fn positive_part(self) -> Approx {
        self.clamp(0.0, f64::INFINITY)
    }

    /// Returns the angle of the point (`x`, `self`) from +x towards +y, by C's `atan2`.
    pub fn atan2(self, x: Approx) -> Approx {
        let squared = self.value * self.value + x.value * x.value;
        let moved = self.value.abs() * x.error + x.value.abs() * self.error;
        Approx::computed(self.value.atan2(x.value), moved / squared)
    }

    /// Returns the exponential function of the number.
    pub fn exp(self) -> Approx {
        let value = self.value.exp();
        Approx::computed(value, value * self.error.exp_m1())
    }

    /// Returns the number, which is not negative, to a power that is at least 0.
    pub fn powf(self, exponent: f64) -> Approx {
        let at = |x: f64| x.max(0.0).powf(exponent);
        let value = at(self.value);
        let inherited = (at(self.value + self.error) - value).max(value - at(self.value - self.error));
        Approx::computed(value, inherited)
    }

    /// Returns the certainty of the sign: the value in units of its error bound. Beyond ±1 every f32 computation has
    /// the right sign.
    pub fn slack(self) -> f64 {
        if self.error == 0.0 {
            if self.value < 0.0 {
                f64::NEG_INFINITY
            } else {
                f64::INFINITY
            }
        } else {
            self.value / self.error
        }
    }
}

impl Add for Approx {
    type Output = Approx;
    fn add(self, b: Approx) -> Approx {
        Approx::computed(self.value + b.value, self.error + b.error)
    }
}

impl Sub for Approx {
    type Output = Approx;
    fn sub(self, b: Approx) -> Approx {
        self + -b
    }
}

impl Neg for Approx {
    type Output = Approx;
    fn neg(self) -> Approx {
        Approx {
            value: -self.value,
            ..self
        }
    }
}

impl Mul for Approx {
    type Output = Approx;
    fn mul(self, b: Approx) -> Approx {
        let inherited = self.value.abs() * b.error + b.value.abs() * self.error + self.error * b.error;
        Approx::computed(self.value * b.value, inherited)
    }
}

impl Mul<f64> for Approx {
    type Output = Approx;
    fn mul(self, b: f64) -> Approx {
        self * Approx::exact(b)
    }
}

impl Sub<Approx> for f64 {
    type Output = Approx;
    fn sub(self, b: Approx) -> Approx {
        Approx::exact(self) - b
    }
}

impl Div for Approx {
    type Output = Approx;
    fn div(self, b: Approx) -> Approx {
        let quotient = self.value / b.value;
        let certain = b.value.abs() - b.error;
        let inherited = if certain > 0.0 {
            (self.error + quotient.abs() * b.error) / certain
        } else {
            LOST
        };
        Approx::computed(quotient, inherited)
    }
}

/// Vector of three numbers: a point, a direction or a colour.
#[derive(Clone, Copy, Debug)]
pub struct Approx3 {
    pub x: Approx,
    pub y: Approx,
    pub z: Approx,
}

impl Approx3 {
    pub const ZERO: Approx3 = Approx3::splat(Approx::ZERO);
    pub const ONE: Approx3 = Approx3::splat(Approx::ONE);

    pub const fn splat(v: Approx) -> Approx3 {
        Approx3 { x: v, y: v, z: v }
    }

    pub fn exact(v: impl Into<DVec3>) -> Approx3 {
        let v = v.into();
        Approx3::from(v.to_array().map(Approx::exact))
    }

    pub fn rounded(v: impl Into<DVec3>) -> Approx3 {
        let v = v.into();
        Approx3::from(v.to_array().map(Approx::rounded))
    }

    pub fn exact_f32(v: [f32; 3]) -> Approx3 {
        Approx3::exact(v.map(f64::from))
    }

    pub fn value(self) -> DVec3 {
        DVec3::new(self.x.value, self.y.value, self.z.value)
    }

    pub fn error(self) -> DVec3 {
        DVec3::new(self.x.error, self.y.error, self.z.error)
    }

    pub fn widened(self, more: DVec3) -> Approx3 {
        Approx3 {
            x: self.x.widened(more.x),
            y: self.y.widened(more.y),
            z: self.z.widened(more.z),
        }
    }

    pub fn to_array(self) -> [Approx; 3] {
        [self.x, self.y, self.z]
    }

    pub fn dot(self, b: Approx3) -> Approx {
        self.x * b.x + self.y * b.y + self.z * b.z
    }

    pub fn cross(self, b: Approx3) -> Approx3 {
        Approx3 {
            x: self.y * b.z - self.z * b.y,
            y: self.z * b.x - self.x * b.z,
            z: self.x * b.y - self.y * b.x,
        }
    }

    pub fn length(self) -> Approx {
        self.dot(self).sqrt()
    }

    pub fn normalize(self) -> Approx3 {
        let length = self.length();
        Approx3::from(self.to_array().map(|v| v / length))
    }

    /// Returns the larger one of two vectors, component by component.
    pub fn max(self, b: Approx3) -> Approx3 {
        Approx3 {
            x: self.x.max(b.x),
            y: self.y.max(b.y),
            z: self.z.max(b.z),
        }
    }

    /// Returns the largest magnitude of the components.
    pub fn largest(self) -> Approx {
        Approx3::from(self.to_array().map(Approx::abs)).max_element()
    }

    /// Returns the component of the largest value.
    pub fn max_element(self) -> Approx {
        let largest = |a: Approx, b: Approx| if b.value > a.value { b } else { a };
        largest(largest(self.x, self.y), self.z)
    }
}

impl From<[Approx; 3]> for Approx3 {
    fn from([x, y, z]: [Approx; 3]) -> Approx3 {
        Approx3 { x, y, z }
    }
}

impl Add for Approx3 {
    type Output = Approx3;
    fn add(self, b: Approx3) -> Approx3 {
        Approx3 {
            x: self.x + b.x,
            y: self.y + b.y,
            z: self.z + b.z,
        }
    }
}

impl Sub for Approx3 {
    type Output = Approx3;
    fn sub(self, b: Approx3) -> Approx3 {
        self + -b
    }
}

impl Neg for Approx3 {
    type Output = Approx3;
    fn neg(self) -> Approx3 {
        Approx3 {
            x: -self.x,
            y: -self.y,
            z: -self.z,
        }
    }
}

/// Multiplies componentwise, as for colours.
impl Mul for Approx3 {
    type Output = Approx3;
    fn mul(self, b: Approx3) -> Approx3 {
        Approx3 {
            x: self.x * b.x,
            y: self.y * b.y,
            z: self.z * b.z,
        }
    }
}

impl Mul<Approx> for Approx3 {
    type Output = Approx3;
    fn mul(self, b: Approx) -> Approx3 {
        self * Approx3::splat(b)
    }
}
