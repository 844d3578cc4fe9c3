//! Thin translucent surface, such as a leaf, paper or a lampshade: it scatters light so much that the transmitted part
//! leaves as diffusely as the reflected part, and it is so thin that both leave where light arrived.
//!
//! Both lobes are Lambertian: f_r = reflectance / pi towards the side that light comes from and f_t = translucency / pi
//! towards the other. Energy is conserved if both together are at most 1.

use std::f64::consts::FRAC_1_PI;

/// Diffuse reflectance and transmittance of a thin surface, in linear red, green and blue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiffuseTransmission {
    reflectance: [f64; 3],
    translucency: [f64; 3],
}

impl DiffuseTransmission {
    /// Creates the surface that reflects the fraction `reflectance` and transmits the fraction `translucency` of the
    /// incident light, from either side.
    ///
    /// Negative numbers and NaN count as 0. In channels whose sum exceeds 1 both parts are divided by their sum.
    pub fn new(reflectance: [f64; 3], translucency: [f64; 3]) -> DiffuseTransmission {
        // Maps NaN to 0, and limits values so that the sum of two is finite.
        let part = |x: f64| if x > 0.0 { x.min(f64::MAX / 2.0) } else { 0.0 };
        let mut surface = DiffuseTransmission {
            reflectance: reflectance.map(part),
            translucency: translucency.map(part),
        };
        for c in 0..3 {
            let sum = surface.reflectance[c] + surface.translucency[c];
            if sum > 1.0 {
                surface.reflectance[c] /= sum;
                // Computed as a difference, because a rounded quotient might make the sum exceed 1.
                surface.translucency[c] = 1.0 - surface.reflectance[c];
            }
        }
        surface
    }

    /// Creates the surface of base colour `base` that transmits `factor` of the light not reflected specularly,
    /// coloured by `color` (KHR_materials_diffuse_transmission): reflectance (1 - factor) base, translucency factor
    /// color.
    pub fn from_diffuse_transmission(base: [f64; 3], factor: f64, color: [f64; 3]) -> DiffuseTransmission {
        DiffuseTransmission::new(base.map(|b| (1.0 - factor) * b), color.map(|c| factor * c))
    }

    /// Returns the reflected fraction of the incident light.
    pub fn reflectance(&self) -> [f64; 3] {
        self.reflectance
    }

    /// Returns the transmitted fraction of the incident light.
    pub fn translucency(&self) -> [f64; 3] {
        self.translucency
    }

    /// Returns the radiance towards the viewer over the irradiance from a light, per steradian: the reflected lobe if
    /// the viewer (`cos_o`) and the light (`cos_i`) are on the same side of the surface, else the transmitted one.
    pub fn scattering(&self, cos_o: f64, cos_i: f64) -> [f64; 3] {
        let lobe = if (cos_o < 0.0) == (cos_i < 0.0) {
            &self.reflectance
        } else {
            &self.translucency
        };
        lobe.map(|part| part * FRAC_1_PI)
    }

    /// Returns the radiant exitance of one side, per unit of area, when that side receives the irradiance `near` and
    /// the other side `far`.
    pub fn radiant_exitance(&self, near: [f64; 3], far: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|c| self.reflectance[c] * near[c] + self.translucency[c] * far[c])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_thin_surface_emits_more_than_it_receives() {
        let values = [
            0.0,
            0.1,
            1.0 / 3.0,
            0.7,
            1.0,
            3.7,
            1e300,
            f64::INFINITY,
            f64::NAN,
            -1.0,
        ];
        for r in values {
            for t in values {
                let surface = DiffuseTransmission::new([r, t, r], [t, r, 0.5]);
                let out = surface.radiant_exitance([1.0; 3], [1.0; 3]);
                assert!(
                    out.iter().all(|x| (0.0..=1.0).contains(x)),
                    "{r} {t}: {surface:?}"
                );
                let parts = surface.reflectance().into_iter().chain(surface.translucency());
                assert!(parts.into_iter().all(|x| (0.0..=1.0).contains(&x)), "{surface:?}");
            }
        }
    }

    #[test]
    fn excessive_diffuse_parts_are_scaled_proportionally() {
        let surface = DiffuseTransmission::new([0.25, 0.5, 3.0], [0.5, 0.5, 1.0]);
        assert_eq!(surface.reflectance(), [0.25, 0.5, 0.75]);
        assert_eq!(surface.translucency(), [0.5, 0.5, 0.25]);
    }

    #[test]
    fn the_lobes_sum_to_their_parts_over_the_hemispheres() {
        let surface = DiffuseTransmission::new([0.3; 3], [0.6; 3]);
        // Integral of f |cos| over a hemisphere: 2 pi times that of f cos over cos in (0, 1); the integrand is linear,
        // so the midpoint rule is exact.
        let over = |side: f64| {
            let middle = |k: i32| (f64::from(k) + 0.5) / 100.0;
            let sum: f64 = (0..100)
                .map(|k| surface.scattering(side * middle(k), 0.5)[0] * middle(k))
                .sum();
            2.0 * std::f64::consts::PI * sum / 100.0
        };
        assert!((over(1.0) - 0.3).abs() <= 1e-14);
        assert!((over(-1.0) - 0.6).abs() <= 1e-14);
        assert_eq!(surface.scattering(-0.5, -0.5), surface.scattering(0.5, 0.5));
    }

    #[test]
    fn a_thin_surface_lit_from_behind_shows_its_translucency() {
        let surface = DiffuseTransmission::from_diffuse_transmission([0.2, 0.8, 0.4], 0.25, [0.4, 1.0, 0.0]);
        assert_eq!(surface.radiant_exitance([0.0; 3], [2.0; 3]), [0.2, 0.5, 0.0]);
        // The front reflects 3/4 of the base colour.
        let front = surface.radiant_exitance([1.0; 3], [0.0; 3]);
        for c in 0..3 {
            assert!((front[c] - 0.75 * [0.2, 0.8, 0.4][c]).abs() <= f64::EPSILON);
        }
    }
}
