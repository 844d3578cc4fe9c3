//! Indices of refraction that depend on the wavelength.
//!
//! Sellmeier's equation n² = 1 + sum B λ²/(λ² - C) is used with published coefficients for known glasses, Cauchy's n =
//! A + B/λ² where only an Abbe number is given (KHR_materials_dispersion). Cauchy's two terms are off by a few 1e-5 for
//! crown and by 4e-3 for dense flint glass at the violet end.

/// Fraunhofer's F line (hydrogen, blue), nanometres.
pub const LINE_F: f64 = 486.13;
/// Fraunhofer's d line (helium, yellow), nanometres.
pub const LINE_D: f64 = 587.56;
/// Fraunhofer's C line (hydrogen, red), nanometres.
pub const LINE_C: f64 = 656.27;

/// Index of refraction of a medium as a function of the wavelength.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dispersion {
    /// Index that is constant over all wavelengths.
    Constant(f64),
    /// Index by Cauchy's equation.
    Cauchy(Cauchy),
    /// Index by Sellmeier's equation.
    Sellmeier(Sellmeier),
}

impl Dispersion {
    /// Returns the index at `wavelength`, nanometres.
    #[inline(always)]
    pub fn ior(&self, wavelength: f64) -> f64 {
        match self {
            Dispersion::Constant(ior) => *ior,
            Dispersion::Cauchy(cauchy) => cauchy.ior(wavelength),
            Dispersion::Sellmeier(sellmeier) => sellmeier.ior(wavelength),
        }
    }

    /// Returns the principal dispersion n_F - n_C, a measure of how far colours spread.
    pub fn spread(&self) -> f64 {
        self.ior(LINE_F) - self.ior(LINE_C)
    }

    /// Returns the Abbe number (n_d - 1)/(n_F - n_C); infinite without dispersion.
    pub fn abbe_number(&self) -> f64 {
        (self.ior(LINE_D) - 1.0) / self.spread()
    }
}

/// Cauchy's equation n = a + b/λ², never below 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cauchy {
    /// Index in the limit of long wavelengths.
    pub a: f64,
    /// Coefficient of 1/λ², in square nanometres.
    pub b: f64,
}

impl Cauchy {
    /// Returns the equation with index `ior` at the d line and Abbe number `abbe`, which is positive and may be
    /// infinite.
    pub fn from_abbe(ior: f64, abbe: f64) -> Cauchy {
        let b = (ior - 1.0) / (abbe * (inverse_square(LINE_F) - inverse_square(LINE_C)));
        Cauchy {
            a: ior - b * inverse_square(LINE_D),
            b,
        }
    }

    /// Returns the equation of KHR_materials_dispersion: `ior` at the d line, `dispersion` = 20 / Abbe number, 0 for no
    /// dispersion.
    pub fn from_gltf(ior: f64, dispersion: f64) -> Cauchy {
        Cauchy::from_abbe(ior, 20.0 / dispersion)
    }

    /// Returns the index at `wavelength`, nanometres.
    #[inline(always)]
    pub fn ior(&self, wavelength: f64) -> f64 {
        (self.a + self.b / (wavelength * wavelength)).max(1.0)
    }
}

/// Returns 1/λ² for a wavelength in nanometres.
fn inverse_square(wavelength: f64) -> f64 {
    1.0 / (wavelength * wavelength)
}

/// Sellmeier's equation n² = 1 + sum B λ²/(λ² - C) of up to four terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sellmeier {
    /// Strengths of the resonances.
    pub b: [f64; 4],
    /// Squares of the resonance wavelengths, in square micrometres.
    pub c: [f64; 4],
}

impl Sellmeier {
    /// Borosilicate crown glass N-BK7 (Schott, optical glass data sheets).
    pub const BK7: Sellmeier = Sellmeier {
        b: [1.03961212, 0.231792344, 1.01046945, 0.0],
        c: [0.00600069867, 0.0200179144, 103.560653, 0.0],
    };
    /// Dense flint glass N-SF10 (Schott, optical glass data sheets).
    pub const N_SF10: Sellmeier = Sellmeier {
        b: [1.62153902, 0.256287842, 1.64447552, 0.0],
        c: [0.0122241457, 0.0595736775, 147.468793, 0.0],
    };
    /// Dense flint glass N-SF11 (Schott, optical glass data sheets).
    pub const N_SF11: Sellmeier = Sellmeier {
        b: [1.73759695, 0.313747346, 1.89878101, 0.0],
        c: [0.013188707, 0.0623068142, 155.23629, 0.0],
    };
    /// Fused silica at 20 °C (Malitson, J. Opt. Soc. Am. 55, 1965).
    pub const FUSED_SILICA: Sellmeier = Sellmeier {
        b: [0.6961663, 0.4079426, 0.8974794, 0.0],
        c: [
            0.0684043 * 0.0684043,
            0.1162414 * 0.1162414,
            9.896161 * 9.896161,
            0.0,
        ],
    };
    /// Distilled water at 20 °C (Daimon and Masumura, Applied Optics 46, 2007).
    pub const WATER: Sellmeier = Sellmeier {
        b: [0.5684027565, 0.1726177391, 0.02086189578, 0.1130748688],
        c: [0.005101829712, 0.01821153936, 0.02620722293, 10.69792721],
    };
    /// Diamond (Peter, Z. Phys. 15, 1923, as in the Handbook of Optics, 3rd ed., vol. 4).
    pub const DIAMOND: Sellmeier = Sellmeier {
        b: [4.3356, 0.3306, 0.0, 0.0],
        c: [0.1060 * 0.1060, 0.1750 * 0.1750, 0.0, 0.0],
    };

    /// Returns the index at `wavelength`, nanometres, which must lie between the resonances, as visible light does.
    #[inline(always)]
    pub fn ior(&self, wavelength: f64) -> f64 {
        // Convert square nanometres to square micrometres
        let square = wavelength * wavelength * 1e-6;
        let mut n_square = 1.0;
        for term in 0..self.b.len() {
            n_square += self.b[term] * square / (square - self.c[term]);
        }
        n_square.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half a unit of the last digit of a value printed with six decimals.
    const SIX_DECIMALS: f64 = 5e-7;

    /// Asserts the indices at seven spectral lines from violet to red.
    fn assert_indices(medium: Sellmeier, expected: [f64; 7]) {
        let lines = [404.66, 435.84, LINE_F, 546.07, LINE_D, LINE_C, 706.52];
        for (line, n) in lines.into_iter().zip(expected) {
            assert!(
                (medium.ior(line) - n).abs() <= SIX_DECIMALS * (1.0 + 1e-9),
                "{line} nm"
            );
        }
    }

    #[test]
    fn glasses_and_water_have_their_tabulated_indices() {
        assert_indices(
            Sellmeier::BK7,
            [
                1.530239, 1.526684, 1.522376, 1.518722, 1.516800, 1.514322, 1.512892,
            ],
        );
        assert_indices(
            Sellmeier::N_SF10,
            [
                1.775774, 1.761912, 1.746431, 1.734300, 1.728277, 1.720906, 1.716881,
            ],
        );
        assert_indices(
            Sellmeier::N_SF11,
            [
                1.842350, 1.825323, 1.806514, 1.791918, 1.784720, 1.775955, 1.771192,
            ],
        );
        assert_indices(
            Sellmeier::WATER,
            [
                1.343123, 1.340585, 1.337492, 1.334831, 1.333403, 1.331513, 1.330379,
            ],
        );
        assert!((Sellmeier::FUSED_SILICA.ior(LINE_D) - 1.458464).abs() <= SIX_DECIMALS);
        assert!((Sellmeier::DIAMOND.ior(LINE_D) - 2.41748).abs() <= 1e-5);
    }

    #[test]
    fn abbe_numbers_equal_catalogue_values() {
        for (medium, expected, half_digit) in [
            (Sellmeier::BK7, 64.166, 5e-4),
            (Sellmeier::N_SF10, 28.532, 5e-4),
            (Sellmeier::N_SF11, 25.680, 5e-4),
            (Sellmeier::FUSED_SILICA, 67.820, 5e-4),
            (Sellmeier::WATER, 55.76, 5e-3),
            (Sellmeier::DIAMOND, 55.30, 5e-3),
        ] {
            let found = Dispersion::Sellmeier(medium).abbe_number();
            assert!((found - expected).abs() <= half_digit, "{found}, not {expected}");
        }
    }

    #[test]
    fn an_equation_made_from_an_abbe_number_has_that_abbe_number() {
        for (ior, abbe) in [(1.5, 64.0), (1.78, 25.7), (2.4, 9.8)] {
            let cauchy = Dispersion::Cauchy(Cauchy::from_abbe(ior, abbe));
            assert!((cauchy.ior(LINE_D) - ior).abs() <= 2.0 * f64::EPSILON);
            // n_F - n_C is at least 7e-3, so two roundings of numbers below 4 give a relative error of 1.3e-13.
            assert!((cauchy.abbe_number() / abbe - 1.0).abs() < 2e-13);
        }
    }

    #[test]
    fn gltf_dispersion_is_the_extensions_formula_up_to_its_printed_constants() {
        for (ior, dispersion) in [(1.5, 0.33), (2.42, 0.36), (1.33, 1.0), (2.0, 2.04)] {
            for wavelength in [380.0, 450.0, 550.0, 650.0, 780.0] {
                let factor = (ior - 1.0) * dispersion / 20.0;
                let printed = ior + factor * (523655.0 / (wavelength * wavelength) - 1.5168);
                let found = Cauchy::from_gltf(ior, dispersion).ior(wavelength);
                // The constants are printed to within 0.5 and 0.00005.
                let bound = factor * (0.5 / (wavelength * wavelength) + 5e-5);
                assert!(
                    (found - printed.max(1.0)).abs() <= bound,
                    "{ior} {dispersion} {wavelength}"
                );
            }
        }
    }

    #[test]
    fn no_dispersion_is_one_index_for_all_wavelengths() {
        for wavelength in [380.0, 550.0, 780.0] {
            assert_eq!(Cauchy::from_gltf(1.5, 0.0).ior(wavelength), 1.5);
            assert_eq!(Dispersion::Constant(1.5).ior(wavelength), 1.5);
        }
        assert_eq!(Dispersion::Constant(1.5).spread(), 0.0);
        assert_eq!(Dispersion::Constant(1.5).abbe_number(), f64::INFINITY);
    }

    #[test]
    fn exaggerated_dispersion_never_takes_the_index_below_that_of_vacuum() {
        assert_eq!(Cauchy::from_gltf(1.05, 40.0).ior(780.0), 1.0);
    }

    #[test]
    fn two_terms_fit_crown_glass_well_and_flint_glass_badly() {
        let error = |glass: Sellmeier, wavelength| {
            // Fit Cauchy's equation through the glass's own F and C lines.
            let b =
                (glass.ior(LINE_F) - glass.ior(LINE_C)) / (inverse_square(LINE_F) - inverse_square(LINE_C));
            let a = glass.ior(LINE_F) - b * inverse_square(LINE_F);
            Cauchy { a, b }.ior(wavelength) - glass.ior(wavelength)
        };
        assert!((error(Sellmeier::BK7, LINE_D) + 5.3e-5).abs() < 1e-6);
        assert!((error(Sellmeier::BK7, 404.66) - 4.6e-5).abs() < 1e-6);
        assert!((error(Sellmeier::N_SF10, 404.66) + 4.3e-3).abs() < 1e-4);
    }
}
