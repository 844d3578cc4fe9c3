//! Irradiance that enters a medium with subsurface scattering through its smooth boundary.

use crate::numeric::{LANES, Lanes3};
use crate::optics::dielectric;

/// Returns the fraction that smooth surfaces transmit from outside into media of index `eta`, per unit of area and of
/// irradiance at normal incidence: the Fresnel transmittance times n·wi, equal in all channels. Lanes with n·wi <= 0
/// give zero.
///
/// `ns` and `wi` are unit vectors.
#[inline(always)]
pub fn transmitted_irradiance(eta: f32, ns: &Lanes3<f32>, wi: &Lanes3<f32>) -> Lanes3<f32> {
    let mut entering = [0.0; LANES];
    for l in 0..LANES {
        let cosine = ns[0][l] * wi[0][l] + ns[1][l] * wi[1][l] + ns[2][l] * wi[2][l];
        if cosine > 0.0 {
            let cosine = f64::from(cosine.min(1.0));
            let fresnel = dielectric(cosine, 1.0, eta.into());
            entering[l] = (fresnel.transmittance.mean() * cosine) as f32;
        }
    }
    [entering; 3]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::subsurface::diffuse_transmittance;

    #[test]
    fn entry_transmittance_at_normal_incidence_and_below_horizon() {
        let lanes = |v: [f32; 3]| v.map(|axis| [axis; LANES]);
        let up = lanes([0.0, 0.0, 1.0]);
        // (0.5 / 2.5)² = 0.04.
        let head_on = transmitted_irradiance(1.5, &up, &up);
        assert!((head_on[1][3] - 0.96).abs() <= f32::EPSILON);
        assert_eq!(
            transmitted_irradiance(1.5, &up, &lanes([0.6, 0.0, -0.8])),
            [[0.0; LANES]; 3]
        );
        assert_eq!(
            transmitted_irradiance(1.0, &up, &lanes([0.6, 0.0, 0.8]))[0][0],
            0.8
        );
    }

    #[test]
    fn uniform_light_enters_by_the_diffuse_transmittance() {
        let up = [[0.0; LANES], [0.0; LANES], [1.0; LANES]];
        // Mean over the hemisphere, weighted by the cosine: 2 times the integral over c of T c.
        let mean: f64 = (0..1000)
            .map(|k| {
                let c = (f64::from(k) + 0.5) / 1000.0;
                let wi = [((1.0 - c * c).sqrt()) as f32, 0.0, c as f32];
                2.0 * f64::from(transmitted_irradiance(1.3, &up, &wi.map(|axis| [axis; LANES]))[0][0])
                    / 1000.0
            })
            .sum();
        // The published fit is off by 0.0006 of the internal reflectance, and squared indices magnify that.
        assert!(
            (mean - diffuse_transmittance(1.3)).abs() <= 0.0006 * 1.69,
            "{mean}"
        );
    }
}
