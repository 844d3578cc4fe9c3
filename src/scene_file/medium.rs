//! Media of scene files: named ones, and the coefficients of dispersion equations.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::optics::{Dispersion, Sellmeier};

/// Media with a known index of refraction, most of them by wavelength.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Glass {
    /// Schott's borosilicate crown glass N-BK7.
    Bk7,
    /// Schott's dense flint glass N-SF10.
    NSf10,
    /// Schott's denser flint glass N-SF11.
    NSf11,
    /// Fused silica at 20 °C.
    FusedSilica,
    /// Water at 20 °C.
    Water,
    /// Ice, of constant index.
    Ice,
    /// Diamond, of high dispersion.
    Diamond,
}

/// Index of refraction of ice at -7 °C at the d line (Warren and Brandt, J. Geophys. Res. 113, 2008).
const ICE_IOR: f64 = 1.31;

/// Coefficients of Sellmeier's equation.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SellmeierForm {
    /// Up to four strengths B.
    b: Vec<f64>,
    /// As many squares of wavelengths C, in square micrometres.
    c: Vec<f64>,
}

/// Coefficients of Cauchy's equation, n = a + b / λ².
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct CauchyForm {
    /// Coefficient a, the index of refraction for very long waves.
    pub(super) a: f64,
    /// Coefficient b in square micrometres.
    pub(super) b: f64,
}

impl Glass {
    /// Returns the index of refraction by wavelength.
    pub(super) fn dispersion(self) -> Dispersion {
        match self {
            Glass::Bk7 => Dispersion::Sellmeier(Sellmeier::BK7),
            Glass::NSf10 => Dispersion::Sellmeier(Sellmeier::N_SF10),
            Glass::NSf11 => Dispersion::Sellmeier(Sellmeier::N_SF11),
            Glass::FusedSilica => Dispersion::Sellmeier(Sellmeier::FUSED_SILICA),
            Glass::Water => Dispersion::Sellmeier(Sellmeier::WATER),
            Glass::Ice => Dispersion::Constant(ICE_IOR),
            Glass::Diamond => Dispersion::Sellmeier(Sellmeier::DIAMOND),
        }
    }
}

impl SellmeierForm {
    /// Returns the equation; an error if the numbers of its coefficients do not match.
    pub(super) fn sellmeier(&self) -> Result<Sellmeier, String> {
        let (mut b, mut c) = ([0.0; 4], [0.0; 4]);
        let count = self.b.len();
        if count != self.c.len() || !(1..=b.len()).contains(&count) {
            return Err("Sellmeier's equation has 1 to 4 terms: give as many `b` as `c`".into());
        }
        // Absent terms have a strength of 0
        b[..count].copy_from_slice(&self.b);
        c[..count].copy_from_slice(&self.c);
        Ok(Sellmeier { b, c })
    }
}
