//! Fraction of the light for each linear polarisation.

/// Fraction of the light for each linear polarisation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Polarised {
    /// Fraction for the electric field perpendicular to the plane of incidence.
    pub s: f64,
    /// Fraction for the electric field in the plane of incidence.
    pub p: f64,
}

impl Polarised {
    /// Returns the fraction of unpolarised light.
    #[inline(always)]
    pub fn mean(self) -> f64 {
        0.5 * (self.s + self.p)
    }
}
