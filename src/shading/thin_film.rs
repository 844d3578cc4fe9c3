//! Reflectance of a thin film on a surface (glTF's `KHR_materials_iridescence`).
//!
//! Light that a film reflects at its two faces interferes, which colours it. L. Belcour and P. Barla, "A Practical
//! Extension to Microfacet Theory for the Modeling of Varying Iridescence" (SIGGRAPH 2017), integrate the spectrum
//! in closed form: the sensitivities of an observer are Gaussians of the wave number, and each order of interference is
//! their Fourier transform at the optical path difference. As the extension prescribes, the reflectances of both faces
//! are Schlick's, polarisation is left out, phases shift by 0 or π, and the first two orders count. The base is a
//! dielectric of the index that gives its reflectance at normal incidence.

use std::f64::consts::{PI, TAU};

use multiversion::multiversion;

use crate::numeric::lane_math::{exp, sin_cos};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Thin film on a base, between air and the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinFilm {
    /// Index of refraction of the film, at least 1.
    pub ior: f64,
    /// Thickness of the film in nanometres.
    pub thickness: f64,
}

/// Gaussian of a sensitivity: its height, its mean in radians per metre, and its variance.
type Gaussian = [f64; 3];

/// Gaussians of the CIE's sensitivities x, y and z; x has a second one.
const SENSITIVITIES: [Gaussian; 3] = [
    [5.4856e-13, 1.6810e6, 4.3278e9],
    [4.4201e-13, 1.7953e6, 9.3046e9],
    [5.2481e-13, 2.2084e6, 6.6121e9],
];
const SECOND_X: Gaussian = [9.7470e-14, 2.2399e6, 4.5282e9];

/// Integral of y, which normalises the sensitivities.
const INTEGRAL: f64 = 1.0685e-7;

/// Linear RGB of ITU-R BT.709 from CIE XYZ, row by row.
const RGB_FROM_XYZ: [[f64; 3]; 3] = [
    [3.240_454_2, -1.537_138_5, -0.498_531_4],
    [-0.969_266, 1.876_010_8, 0.041_556],
    [0.055_643_4, -0.204_025_9, 1.057_225_2],
];

impl ThinFilm {
    /// Returns the reflectance, linear RGB, of a film on a base of the reflectance `f0` at normal incidence, for light at
    /// `cosine` to the normal, from 0 to 1. It is within [0, 1].
    #[inline(always)]
    pub fn reflectance(&self, cosine: f64, f0: [f64; 3]) -> [f64; 3] {
        /// Thickness below which a film fades to none, in nanometres.
        const FADING: f64 = 0.03;
        /// Largest product of both reflectances, which keeps the series finite.
        const MAX_PRODUCT: f64 = 0.9999;
        // Fade out a film without thickness
        let t = (self.thickness / FADING).clamp(0.0, 1.0);
        let ior = 1.0 + (self.ior - 1.0) * t * t * (3.0 - 2.0 * t);
        // Refract into the film
        let cos_inside = (1.0 - (1.0 - cosine * cosine) / (ior * ior)).max(0.0).sqrt();
        let first = schlick(normal_reflectance(ior, 1.0), cosine);
        let passed = 1.0 - first;
        let difference = 2.0 * ior * self.thickness * 1e-9 * cos_inside;
        // Loops instead of closures, which are not inlined into code for wider instruction sets
        let (mut shift, mut product, mut order, mut reflectance) = ([0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]);
        for c in 0..3 {
            // Find the second face's reflectance and its phase
            let index = index_of(f0[c]);
            let second = schlick(normal_reflectance(index, ior), cos_inside);
            shift[c] = if index < ior { TAU } else { PI };
            // Add the light that enters the film and leaves it again
            product[c] = (first * second).min(MAX_PRODUCT);
            let inner = passed * passed * second / (1.0 - product[c]);
            order[c] = inner - passed;
            reflectance[c] = first + inner;
        }
        // Sum the orders of interference
        for m in [1.0, 2.0] {
            let sensitivity = sensitivity(m * difference, [m * shift[0], m * shift[1], m * shift[2]]);
            for c in 0..3 {
                order[c] *= product[c].sqrt();
                reflectance[c] += 2.0 * order[c] * sensitivity[c];
            }
        }
        for value in &mut reflectance {
            *value = value.clamp(0.0, 1.0);
        }
        reflectance
    }
}

/// Films in sixteen lanes, each on a base of its own.
pub struct ThinFilmLanes<'a> {
    /// Indices of refraction of the films.
    pub ior: &'a Lanes<f32>,
    /// Thicknesses of the films in nanometres.
    pub thickness: &'a Lanes<f32>,
    /// Reflectances of the bases at normal incidence.
    pub f0: Lanes3<f32>,
}

impl ThinFilmLanes<'_> {
    /// Returns the reflectances for light at `cosine` to the normals: see [`ThinFilm::reflectance`].
    pub fn reflectance(&self, cosine: &Lanes<f32>) -> Lanes3<f32> {
        let mut reflectance = [[0.0; LANES]; 3];
        reflectance_lanes(self, cosine, &mut reflectance);
        reflectance
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn reflectance_lanes(films: &ThinFilmLanes, cosine: &Lanes<f32>, reflectance: &mut Lanes3<f32>) {
    for l in 0..LANES {
        let film = ThinFilm {
            ior: films.ior[l].into(),
            thickness: films.thickness[l].into(),
        };
        let f0 = [
            films.f0[0][l].into(),
            films.f0[1][l].into(),
            films.f0[2][l].into(),
        ];
        let [r, g, b] = film.reflectance(cosine[l].clamp(0.0, 1.0).into(), f0);
        (reflectance[0][l], reflectance[1][l], reflectance[2][l]) = (r as f32, g as f32, b as f32);
    }
}

/// Returns the reflectance at normal incidence between two media.
#[inline(always)]
fn normal_reflectance(inside: f64, outside: f64) -> f64 {
    let ratio = (inside - outside) / (inside + outside);
    ratio * ratio
}

/// Returns the index of refraction of the dielectric with this reflectance at normal incidence in air.
#[inline(always)]
fn index_of(f0: f64) -> f64 {
    /// Largest reflectance, whose index is finite.
    const MAX: f64 = 0.9999;
    let root = f0.clamp(0.0, MAX).sqrt();
    (1.0 + root) / (1.0 - root)
}

#[inline(always)]
fn schlick(f0: f64, cosine: f64) -> f64 {
    let left = 1.0 - cosine;
    let squared = left * left;
    f0 + (1.0 - f0) * (squared * squared * left)
}

/// Returns the transform of the observer's sensitivities at an optical path difference in metres, with a phase shift for
/// each of the three sensitivities, as linear RGB.
#[inline(always)]
fn sensitivity(difference: f64, shift: [f64; 3]) -> [f64; 3] {
    let phase = TAU * difference;
    let mut xyz = [0.0; 3];
    for c in 0..3 {
        xyz[c] = transform(SENSITIVITIES[c], phase, shift[c]);
    }
    xyz[0] += transform(SECOND_X, phase, shift[0]);
    // Convert the three sensitivities to linear RGB
    let mut rgb = [0.0; 3];
    for c in 0..3 {
        let row = RGB_FROM_XYZ[c];
        rgb[c] = row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2];
    }
    rgb
}

/// Evaluates the transform of one Gaussian, with a phase shift.
#[inline(always)]
fn transform([height, mean, variance]: Gaussian, phase: f64, shift: f64) -> f64 {
    let [_, cosine] = sin_cos(mean * phase + shift);
    height * (TAU * variance).sqrt() * cosine * exp(-variance * phase * phase) / INTEGRAL
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    /// Evaluates the formulas as the extension writes them, for one channel's pair of base reflectance and phase shift.
    fn specified(film: &ThinFilm, cosine: f64, f0: [f64; 3]) -> [f64; 3] {
        // Reflect at both faces
        let inside = (1.0 - (1.0 - cosine * cosine) / film.ior.powi(2)).sqrt();
        let fresnel = |f0: f64, cosine: f64| f0 + (1.0 - f0) * (1.0 - cosine).powf(5.0);
        let r0 = |to: f64, from: f64| ((to - from) / (to + from)).powf(2.0);
        let r12 = fresnel(r0(film.ior, 1.0), cosine);
        let base = f0.map(|f0| (1.0 + f0.sqrt()) / (1.0 - f0.sqrt()));
        let r23 = base.map(|base| fresnel(r0(base, film.ior), inside));
        // Shift phases by π where the index rises
        let phi = base.map(|base| PI + if base < film.ior { PI } else { 0.0 });
        let path = 2.0 * film.ior * film.thickness * 1e-9 * inside;
        // Integrate over the spectrum
        let sensed = |path: f64, shift: [f64; 3]| {
            let phase = 2.0 * PI * path;
            let wave = |value: f64, position: f64, variance: f64, shift: f64| {
                value
                    * (2.0 * PI * variance).sqrt()
                    * (position * phase + shift).cos()
                    * (-phase.powi(2) * variance).exp()
            };
            let x = wave(5.4856e-13, 1.6810e6, 4.3278e9, shift[0])
                + wave(9.7470e-14, 2.2399e6, 4.5282e9, shift[0]);
            let y = wave(4.4201e-13, 1.7953e6, 9.3046e9, shift[1]);
            let z = wave(5.2481e-13, 2.2084e6, 6.6121e9, shift[2]);
            RGB_FROM_XYZ.map(|m| (m[0] * x + m[1] * y + m[2] * z) / 1.0685e-7)
        };
        // Sum two orders of interference
        let t121 = (1.0 - r12).powi(2);
        let [one, two] = [1.0, 2.0].map(|m| sensed(m * path, phi.map(|phi| m * phi)));
        std::array::from_fn(|c| {
            // Without the extension's smallest product, 1e-5, which adds light where the base is like the film
            let r123 = (r12 * r23[c]).min(0.9999);
            let rs = t121 * r23[c] / (1.0 - r123);
            let c1 = (rs - (1.0 - r12)) * r123.sqrt();
            let sum = r12 + rs + 2.0 * c1 * one[c] + 2.0 * c1 * r123.sqrt() * two[c];
            sum.clamp(0.0, 1.0)
        })
    }

    #[test]
    fn reflectance_is_that_of_the_extension() {
        let mut random = SplitMix64::new(0, 3);
        for _ in 0..10_000 {
            let film = ThinFilm {
                ior: random.within(1.1, 2.5),
                thickness: random.within(1.0, 2000.0),
            };
            // Compare at any angle and reflectance
            let f0 = [0; 3].map(|_| random.within(0.02, 0.98));
            let cosine = random.unit();
            let (found, expected) = (film.reflectance(cosine, f0), specified(&film, cosine, f0));
            for c in 0..3 {
                assert!(
                    (found[c] - expected[c]).abs() < 1e-9,
                    "{film:?} {cosine} {f0:?}: {found:?} {expected:?}"
                );
            }
        }
    }

    #[test]
    fn sixteen_films_have_the_bits_of_single_ones() {
        let mut random = SplitMix64::new(1, 3);
        for _ in 0..100 {
            let mut lanes =
                |low, high| -> Lanes<f32> { std::array::from_fn(|_| random.within(low, high) as f32) };
            let (ior, thickness, cosine) = (lanes(1.0, 2.5), lanes(0.0, 1000.0), lanes(0.0, 1.0));
            let films = ThinFilmLanes {
                ior: &ior,
                thickness: &thickness,
                f0: [0; 3].map(|_| lanes(0.0, 1.0)),
            };
            let found = films.reflectance(&cosine);
            for l in 0..LANES {
                let film = ThinFilm {
                    ior: ior[l].into(),
                    thickness: thickness[l].into(),
                };
                let single = film.reflectance(cosine[l].into(), films.f0.map(|f0| f0[l].into()));
                assert_eq!(found.map(|channel| channel[l]), single.map(|x| x as f32));
            }
        }
    }

    #[test]
    fn thick_films_reflect_the_sum_of_all_orders_without_interference() {
        let film = ThinFilm {
            ior: 1.4,
            thickness: 1e5,
        };
        // Indices 1, 1.4 and 2
        let (first, second) = ((0.4f64 / 2.4).powi(2), (0.6f64 / 3.4).powi(2));
        let sum = first + (1.0 - first).powi(2) * second / (1.0 - first * second);
        let base = (1.0f64 / 3.0).powi(2);
        assert!((film.reflectance(1.0, [base; 3])[1] - sum).abs() < 1e-6);
    }

    #[test]
    fn film_without_thickness_reflects_as_its_base() {
        let film = ThinFilm {
            ior: 1.8,
            thickness: 0.0,
        };
        for f0 in [0.04, 0.3, 0.9] {
            assert!((film.reflectance(1.0, [f0; 3])[0] - f0).abs() < 1e-12);
        }
    }
}
