//! Sheen of glTF's `KHR_materials_sheen`: light scattered by fibres that stand up from a surface.
//!
//! The lobe is that of A. Conty Estevez and C. Kulla, "Production Friendly Microfacet Sheen BRDF" (2017), without a
//! Fresnel term: the distribution D = (2 + 1/α) sin(θ)^(1/α) / 2π of fibre normals, and the masking that they fitted,
//! with α = roughness². Below a roughness of 0.25 the fit of the masking reflects more light than arrives at grazing
//! angles; the lobe is divided by its albedo there.
//!
//! Light that the fibres do not reflect reaches the base, which is scaled by 1 - max(colour) E, where E is the albedo of white
//! fibres towards the viewer. E is interpolated in a table; the table holds numerical integrals, and between them E is
//! within 0.015 of its integral (0.002 on average).

use std::f64::consts::PI;

use crate::numeric::lane_math::{exp, ln};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Smallest roughness of fibres; a lobe of less is too narrow to be seen.
const MIN_ROUGHNESS: f32 = 0.1;

/// Number of columns and of rows of the table.
const STEPS: usize = 16;

/// Albedo E of white fibres. Rows are evenly spaced in roughness, from [`MIN_ROUGHNESS`] to 1; columns in the cube root of
/// the cosine to the viewer, from 0 to 1.
const ALBEDO: [[f32; 16]; 16] = [
    [
        1.9012, 1.9852, 2.1288, 1.9838, 1.6534, 1.2476, 0.8487, 0.5107, 0.2623, 0.1086, 0.0331, 0.0064,
        0.0006, 0.0, 0.0, 0.0,
    ],
    [
        1.2374, 1.2958, 1.4189, 1.3766, 1.2212, 1.0079, 0.7773, 0.5572, 0.366, 0.2149, 0.1085, 0.0442, 0.013,
        0.0023, 0.0001, 0.0,
    ],
    [
        0.9525, 0.9991, 1.107, 1.0965, 1.0035, 0.865, 0.7077, 0.5494, 0.4017, 0.2727, 0.168, 0.0905, 0.04,
        0.013, 0.0023, 0.0,
    ],
    [
        0.8045, 0.8449, 0.9441, 0.9476, 0.8839, 0.7821, 0.6626, 0.5386, 0.4185, 0.308, 0.2113, 0.1317,
        0.0714, 0.0316, 0.0092, 0.0005,
    ],
    [
        0.7225, 0.7594, 0.8541, 0.8655, 0.8179, 0.7365, 0.6385, 0.535, 0.4324, 0.3349, 0.2458, 0.1675,
        0.1027, 0.0543, 0.0214, 0.0028,
    ],
    [
        0.6782, 0.7131, 0.8062, 0.8228, 0.785, 0.7157, 0.6306, 0.5396, 0.4481, 0.3596, 0.2762, 0.2, 0.133,
        0.079, 0.0377, 0.0086,
    ],
    [
        0.6582, 0.6919, 0.7852, 0.806, 0.7743, 0.7124, 0.6351, 0.5518, 0.4674, 0.3847, 0.3053, 0.2307,
        0.1624, 0.1046, 0.0569, 0.0184,
    ],
    [
        0.6553, 0.6882, 0.7832, 0.8072, 0.7795, 0.7218, 0.6492, 0.5704, 0.4902, 0.411, 0.3341, 0.2604,
        0.1911, 0.1306, 0.078, 0.0318,
    ],
    [
        0.6648, 0.6972, 0.7945, 0.8212, 0.7959, 0.7406, 0.6703, 0.5938, 0.5159, 0.4386, 0.3629, 0.2895,
        0.2191, 0.1564, 0.1002, 0.0482,
    ],
    [
        0.6835, 0.7152, 0.815, 0.844, 0.8201, 0.7657, 0.6961, 0.6204, 0.5433, 0.4667, 0.3914, 0.3176, 0.2461,
        0.1815, 0.1225, 0.0663,
    ],
    [
        0.7082, 0.7391, 0.8412, 0.872, 0.8486, 0.794, 0.7242, 0.6483, 0.571, 0.4943, 0.4187, 0.3443, 0.2716,
        0.2054, 0.1443, 0.0852,
    ],
    [
        0.7355, 0.7652, 0.8692, 0.9012, 0.8777, 0.8225, 0.7517, 0.6751, 0.5972, 0.52, 0.4438, 0.3687, 0.2949,
        0.2274, 0.1649, 0.104,
    ],
    [
        0.7613, 0.7898, 0.8949, 0.9276, 0.9037, 0.8475, 0.7758, 0.6982, 0.6197, 0.542, 0.4654, 0.3897,
        0.3152, 0.247, 0.1836, 0.1218,
    ],
    [
        0.781, 0.8081, 0.9134, 0.9464, 0.9221, 0.8653, 0.7929, 0.715, 0.6363, 0.5586, 0.482, 0.4063, 0.3317,
        0.2634, 0.1999, 0.1381,
    ],
    [
        0.7893, 0.8151, 0.9197, 0.9527, 0.9284, 0.8718, 0.7998, 0.7225, 0.6445, 0.5677, 0.492, 0.4173,
        0.3435, 0.276, 0.2133, 0.1522,
    ],
    [
        0.781, 0.806, 0.909, 0.9417, 0.9183, 0.863, 0.7929, 0.7177, 0.6419, 0.5673, 0.4939, 0.4213, 0.3496,
        0.284, 0.2231, 0.1638,
    ],
];

/// Sheen of sixteen points.
#[derive(Clone, Copy, Debug)]
pub struct SheenLanes {
    /// Colour of the fibres, linear RGB.
    pub color: Lanes3<f32>,
    /// Perceptual roughness of the fibres.
    pub roughness: Lanes<f32>,
}

impl SheenLanes {
    /// Sheen of black fibres, which is none.
    pub const NONE: SheenLanes = SheenLanes {
        color: [[0.0; LANES]; 3],
        roughness: [0.0; LANES],
    };

    /// Returns the fraction of uniform light that white fibres in lane `l` reflect to a viewer at `cosine`, at most 1.
    pub fn albedo(&self, cosine: f32, l: usize) -> f32 {
        unbounded_albedo(cosine, self.roughness[l]).min(1.0)
    }

    /// Returns the fraction of light in lane `l` that the base reflects under the fibres, for a viewer at `cosine`.
    pub fn base_weight(&self, cosine: f32, l: usize) -> f32 {
        let largest = (0..3).map(|c| self.color[c][l]).fold(0.0, f32::max);
        1.0 - largest * self.albedo(cosine, l)
    }

    /// Returns the radiance reflected per unit of irradiance at normal incidence, BRDF times n·wi, at sixteen points.
    ///
    /// `ns`, `wo` and `wi` are unit vectors; lanes with n·wi <= 0 give zero.
    pub fn direct(&self, ns: &Lanes3<f32>, wo: &Lanes3<f32>, wi: &Lanes3<f32>) -> Lanes3<f32> {
        let mut reflected = [[0.0; LANES]; 3];
        for l in 0..LANES {
            let lane = |v: &Lanes3<f32>| glam::Vec3::new(v[0][l], v[1][l], v[2][l]).as_dvec3();
            // Compute cosines; lanes below the horizon stay black
            let (n, v, i) = (lane(ns), lane(wo), lane(wi));
            let (cos_v, cos_i) = (n.dot(v).abs().min(1.0), n.dot(i).min(1.0));
            if !(cos_i > 0.0 && cos_v > 0.0) {
                continue;
            }
            // Compute the squared sine of the half vector as that of the cross product
            let h = v + i;
            let squared_sine = (n.cross(h).length_squared() / h.length_squared()).min(1.0);
            // Evaluate the distribution of fibre normals
            let roughness = self.roughness[l].max(MIN_ROUGHNESS);
            let alpha = f64::from(roughness * roughness);
            let distribution = (2.0 + alpha.recip()) * power(squared_sine, 0.5 / alpha) / (2.0 * PI);
            // Mask and shadow, keeping the albedo within 1
            let visible = 1.0 + masking(cos_v, alpha) + masking(cos_i, alpha);
            let excess = f64::from(unbounded_albedo(cos_v as f32, roughness).max(1.0));
            let lobe = (distribution / (4.0 * cos_v * visible * excess)) as f32;
            for channel in 0..3 {
                reflected[channel][l] = self.color[channel][l] * lobe;
            }
        }
        reflected
    }
}

/// Returns x to the power y, for x in [0, 1].
fn power(x: f64, y: f64) -> f64 {
    if x > 0.0 { exp(y * ln(x)) } else { 0.0 }
}

/// Returns Λ, the masking of a direction at `cosine` to the normal.
fn masking(cosine: f64, alpha: f64) -> f64 {
    /// Value of a fitted curve at α = 1 and at α = 0, for each of its five parameters.
    const PARAMETERS: [[f64; 2]; 5] = [
        [21.5473, 25.3245],
        [3.82987, 3.32435],
        [0.19823, 0.16801],
        [-1.97760, -1.27393],
        [-4.32054, -4.85967],
    ];
    // Blend the parameters of the curve by alpha
    let blend = (1.0 - alpha) * (1.0 - alpha);
    let [a, b, c, d, e] = PARAMETERS.map(|[one, zero]| one * (1.0 - blend) + zero * blend);
    let curve = |x: f64| a / (1.0 + b * power(x, c)) + d * x + e;
    // Mirror the curve at a cosine of one half
    if cosine < 0.5 {
        exp(curve(cosine))
    } else {
        exp(2.0 * curve(0.5) - curve(1.0 - cosine))
    }
}

/// Interpolates E bilinearly in the table.
fn unbounded_albedo(cosine: f32, roughness: f32) -> f32 {
    // Find the cell of the table
    let last = (STEPS - 1) as f32;
    let column = last * cosine.clamp(0.0, 1.0).cbrt();
    let row = last * ((roughness - MIN_ROUGHNESS) / (1.0 - MIN_ROUGHNESS)).clamp(0.0, 1.0);
    let (i, j) = ((column as usize).min(STEPS - 2), (row as usize).min(STEPS - 2));
    let [s, t] = [column - i as f32, row - j as f32];
    // Interpolate along both axes
    let along = |row: &[f32; STEPS]| row[i] + s * (row[i + 1] - row[i]);
    let (low, high) = (along(&ALBEDO[j]), along(&ALBEDO[j + 1]));
    low + t * (high - low)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use glam::DVec3;

    use super::*;
    use crate::numeric::{SplitMix64, warp};

    fn lanes(v: DVec3) -> Lanes3<f32> {
        v.to_array().map(|axis| [axis as f32; LANES])
    }

    fn white(roughness: f32) -> SheenLanes {
        SheenLanes {
            color: [[1.0; LANES]; 3],
            roughness: [roughness; LANES],
        }
    }

    /// Evaluates BRDF times cosine by the formulas of the extension.
    fn specified(roughness: f32, wo: DVec3, wi: DVec3) -> f64 {
        let alpha = f64::from(roughness) * f64::from(roughness);
        // Evaluate the distribution
        let h = (wo + wi).normalize();
        let distribution = (2.0 + 1.0 / alpha) * (1.0 - h.z * h.z).powf(0.5 / alpha) / TAU;
        // Evaluate the masking by the fitted curve
        let mix = |x: f64, y: f64| {
            let t = (1.0 - alpha) * (1.0 - alpha);
            x * (1.0 - t) + y * t
        };
        let l = |x: f64| {
            mix(21.5473, 25.3245) / (1.0 + mix(3.82987, 3.32435) * x.powf(mix(0.19823, 0.16801)))
                + mix(-1.97760, -1.27393) * x
                + mix(-4.32054, -4.85967)
        };
        let lambda = |x: f64| match x < 0.5 {
            true => l(x).exp(),
            false => (2.0 * l(0.5) - l(1.0 - x)).exp(),
        };
        distribution / ((1.0 + lambda(wo.z) + lambda(wi.z)) * 4.0 * wo.z)
    }

    #[test]
    fn lobe_is_that_of_the_extension_where_it_keeps_energy() {
        let mut random = SplitMix64::new(0, 5);
        let mut checked = 0;
        for _ in 0..10_000 {
            // Draw directions and a roughness at which energy is kept
            let roughness = 0.3 + 0.7 * random.unit() as f32;
            let [wo, wi] = [0, 1].map(|_| warp::direction(random.unit(), random.unit()).as_vec3().as_dvec3());
            if wo.z < 0.01 || wi.z < 0.01 {
                continue;
            }
            // Compare in the frame of the normal
            let up = lanes(DVec3::Z);
            let found = f64::from(white(roughness).direct(&up, &lanes(wo), &lanes(wi))[1][7]);
            let expected = specified(roughness, wo, wi);
            let error = (found - expected).abs();
            assert!(
                error <= 1e-4 * expected + 1e-7,
                "{roughness} {wo} {wi}: {found}, not {expected}"
            );
            checked += 1;
        }
        assert!(checked > 9_000);
    }

    #[test]
    fn table_holds_the_integrals_of_the_lobe() {
        let mut random = SplitMix64::new(0, 7);
        let (mut largest, mut sum) = (0f64, 0.0);
        const POINTS: u32 = 40;
        for _ in 0..POINTS {
            // Draw a point of the table
            let roughness = 0.26 + 0.74 * random.unit() as f32;
            let cosine = 0.02 + 0.98 * random.unit();
            let wo = DVec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
            // Integrate over the hemisphere, more densely near the horizon
            const CELLS: u32 = 160;
            let mut integral = 0.0;
            for cell in 0..CELLS * CELLS {
                let [s, t] = [cell / CELLS, cell % CELLS].map(|i| (f64::from(i) + 0.5) / f64::from(CELLS));
                let z = s * s;
                let wi = warp::direction(1.0 - z, t);
                let wi = DVec3::new(wi.x, wi.y, wi.z.abs());
                integral += specified(roughness, wo, wi) * 2.0 * s;
            }
            // Compare the albedo with the integral
            let integral = TAU * integral / f64::from(CELLS * CELLS);
            let error = (f64::from(white(roughness).albedo(cosine as f32, 0)) - integral.min(1.0)).abs();
            assert!(error < 0.015, "{roughness} {cosine}: {error}, {integral}");
            largest = largest.max(error);
            sum += error;
        }
        assert!(
            largest > 0.0 && sum / f64::from(POINTS) < 0.004,
            "{largest} {sum}"
        );
    }

    #[test]
    fn lobe_is_reciprocal() {
        let mut random = SplitMix64::new(0, 9);
        for _ in 0..1000 {
            let roughness = 0.3 + 0.7 * random.unit() as f32;
            let [wo, wi] = [0, 1].map(|_| warp::direction(0.95 * random.unit(), random.unit()));
            // Exchange both directions
            let of = |from: DVec3, to: DVec3| {
                let lobe = white(roughness).direct(&lanes(DVec3::Z), &lanes(from), &lanes(to));
                f64::from(lobe[0][0]) / to.z
            };
            let (there, back) = (of(wo, wi), of(wi, wo));
            assert!((there - back).abs() <= 1e-4 * there + 1e-6, "{there} {back}");
        }
    }
}
