//! Anisotropic GGX lobe, and its directional albedo by quadrature over visible microfacets.
//!
//! The albedo depends on both widths of the lobe, and on the angle and the azimuth of the viewer: too much for a fit.
//! The 64 points of Hammersley's set give it to 0.035 of itself, to 0.007 on average.

use std::f32::consts::TAU;
use std::sync::LazyLock;

use super::LobeAlbedo;
use super::material::MaterialPacket;

/// Anisotropic GGX lobe of one surface.
pub(super) struct AnisotropicLobe {
    /// Width alpha along the direction of anisotropy, and across it.
    pub(super) along: f32,
    pub(super) across: f32,
    /// Unit vectors of the surface along the direction of anisotropy, and across it.
    pub(super) tangent: [f32; 3],
    pub(super) bitangent: [f32; 3],
}

impl AnisotropicLobe {
    pub(super) fn of(material: &MaterialPacket, n: [f32; 3], l: usize) -> AnisotropicLobe {
        let [along, across] = material.alphas(l);
        let t = material.extended.anisotropy_direction.map(|axis| axis[l]);
        // Complete the frame by the normal
        let bitangent = [
            n[1] * t[2] - n[2] * t[1],
            n[2] * t[0] - n[0] * t[2],
            n[0] * t[1] - n[1] * t[0],
        ];
        AnisotropicLobe {
            along,
            across,
            tangent: t,
            bitangent,
        }
    }

    /// Returns the root of the product of both widths over πD, for the half vector `h` of any length, times its square.
    pub(super) fn denominator(&self, h: [f32; 3], n_dot_h: f32) -> f32 {
        let (t, b) = (dot(self.tangent, h), dot(self.bitangent, h));
        let aspect = self.across / self.along;
        t * t * aspect + b * b / aspect + self.along * self.across * n_dot_h * n_dot_h
    }

    /// Returns the root in Smith's masking of the direction `w`.
    pub(super) fn shadowing(&self, w: [f32; 3], n_dot_w: f32) -> f32 {
        let t = self.along * dot(self.tangent, w);
        let b = self.across * dot(self.bitangent, w);
        (t * t + b * b + n_dot_w * n_dot_w).sqrt()
    }
}

/// Number of microfacets of the quadrature.
const COUNT: usize = 64;

/// Point of the unit square, prepared for sampling microfacets.
struct QuadraturePoint {
    /// Cosine and sine of the azimuth.
    turn: [f32; 2],
    /// Second coordinate of the point.
    u: f32,
}

/// Points of Hammersley's set, with their first coordinate as an azimuth.
static POINTS: LazyLock<[QuadraturePoint; COUNT]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let reversed = (i as u32).reverse_bits() as f32 / 2f32.powi(32);
        let (sin, cos) = (TAU * (reversed + 0.5 / COUNT as f32)).sin_cos();
        QuadraturePoint {
            turn: [cos, sin],
            u: (i as f32 + 0.5) / COUNT as f32,
        }
    })
});

/// Returns the albedo of the lobe with the widths `alphas` along x and y towards the unit vector `wo`, whose z is along
/// the normal and positive. See [`super::Ggx::sample_vndf`] for the sampling.
pub(super) fn anisotropic_albedo([along, across]: [f32; 2], wo: [f32; 3]) -> LobeAlbedo<f32> {
    let [x, y, z] = wo;
    // Stretch space so that the microfacets form a hemisphere
    let stretched = [along * x, across * y, z];
    let scale = length(stretched).recip();
    let seen = stretched.map(|axis| axis * scale);
    let (mut albedo, mut grazing) = (0.0, 0.0);
    for point in POINTS.iter() {
        // Sample a visible microfacet and reflect the view direction at it
        let height = (1.0 - point.u) * (1.0 + seen[2]);
        let cap_z = height - seen[2];
        let sine = (1.0 - cap_z * cap_z).max(0.0).sqrt();
        let m = [
            along * (sine * point.turn[0] + seen[0]),
            across * (sine * point.turn[1] + seen[1]),
            height,
        ];
        let scale = length(m).recip();
        let m = m.map(|axis| axis * scale);
        let cosine = x * m[0] + y * m[1] + z * m[2];
        let wi: [f32; 3] = std::array::from_fn(|axis| 2.0 * cosine * m[axis] - wo[axis]);
        // Add the share of microfacets that are visible from there
        let root = length([along * wi[0], across * wi[1], wi[2]]);
        let visible = if wi[2] > 0.0 {
            2.0 * wi[2] / (wi[2] + root)
        } else {
            0.0
        };
        let rest = (1.0 - cosine).max(0.0);
        let squared = rest * rest;
        albedo += visible;
        grazing += visible * squared * squared * rest;
    }
    let [albedo, grazing] = [albedo, grazing].map(|sum| (sum / COUNT as f32).max(f32::MIN_POSITIVE));
    LobeAlbedo {
        normal: albedo - grazing,
        grazing,
        loss: (1.0 - albedo) / albedo,
    }
}

/// Returns the dot product of two vectors.
#[inline(always)]
pub(super) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length([x, y, z]: [f32; 3]) -> f32 {
    (x * x + y * y + z * z).sqrt()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::numeric::{SplitMix64, warp};
    use crate::shading::Ggx;

    #[test]
    fn albedo_is_that_of_the_sampled_lobe() {
        const STEPS: u32 = 96;
        let mut random = SplitMix64::new(0, 17);
        let (mut sum, count) = (0.0, 100);
        for _ in 0..count {
            // Draw a lobe and a viewer
            let across = random.unit().powi(2).max(0.003);
            let along = across + (1.0 - across) * random.unit();
            let wo = warp::direction(0.97 * random.unit(), random.unit());
            // Integrate over a fine grid of random numbers
            let lobe = Ggx::anisotropic([along, across]);
            let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(STEPS);
            let mut exact = [0.0; 2];
            for i in 0..STEPS * STEPS {
                let u = [middle(i % STEPS), middle(i / STEPS)];
                if let Some(sample) = lobe.sample_reflection(wo, u) {
                    exact[0] += sample.weight;
                    exact[1] += sample.weight * (1.0 - wo.dot(sample.m)).powi(5);
                }
            }
            let [albedo, grazing] = exact.map(|sum| sum / f64::from(STEPS * STEPS));
            let found = anisotropic_albedo(
                [along as f32, across as f32],
                DVec3::to_array(&wo).map(|x| x as f32),
            );
            // Compare the albedos
            let raised = albedo * (1.0 + f64::from(found.loss));
            assert!((raised - 1.0).abs() < 0.045, "{along} {across} {wo}: {raised}");
            assert!(
                (f64::from(found.grazing) - grazing).abs() < 0.01,
                "{along} {across} {wo}"
            );
            sum += (raised - 1.0).abs();
        }
        assert!(sum / f64::from(count) < 0.01, "{sum}");
    }
}
