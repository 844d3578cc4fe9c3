//! Lobe of glTF's metallic-roughness model in the reference tracer, with bounds of its error.

use whit::shading::LobeAlbedo;

use super::approx::{Approx, Approx3};

/// Parameters of glTF's metallic-roughness lobe.
#[derive(Clone, Copy)]
pub struct Gltf {
    /// Albedo of the diffuse lobe.
    pub c_diff: Approx3,
    /// Reflectance at normal incidence.
    pub f0: Approx3,
    /// Reflectance at grazing incidence.
    pub f90: Approx,
    /// Width alpha, the square of the roughness.
    pub alpha: Approx,
    /// Albedo of the lobe towards the viewer, without the reflectance.
    pub albedo: LobeAlbedo<Approx>,
}

impl Gltf {
    /// Returns Schlick's Fresnel term for all channels.
    pub fn fresnel(&self, cos: Approx) -> Approx3 {
        let rest = (1.0 - cos.abs()).positive_part();
        let fifth = rest.squared().squared() * rest;
        self.f0 + (Approx3::splat(self.f90) - self.f0) * fifth
    }

    /// Returns the factor of multiple scattering between microfacets (Turquin, 2019).
    fn raised(&self) -> Approx3 {
        Approx3::ONE + self.f0 * self.albedo.loss
    }

    /// Returns the fraction of uniform light that the lobe reflects to the viewer.
    pub fn specular_albedo(&self) -> Approx3 {
        let grazing = Approx3::splat(self.f90 * self.albedo.grazing);
        (self.f0 * self.albedo.normal + grazing) * self.raised()
    }

    /// Returns the fraction of light from `wi` that is reflected to the viewer: glTF 2.0, Appendix B, with multiple
    /// scattering, and with diffuse light less the albedo of the lobe where that is larger than the Fresnel term.
    pub fn lobe(&self, ns: Approx3, wo: Approx3, wi: Approx3) -> Approx3 {
        let h = (wi + wo).normalize();
        let f = self.fresnel(wo.dot(h));
        let pi = Approx::rounded(std::f64::consts::PI);
        let taken = f.max(self.specular_albedo());
        let diffuse = (Approx3::ONE - taken) * self.c_diff * (Approx::ONE / pi);
        if self.alpha.value == 0.0 {
            return diffuse;
        }
        let a2 = self.alpha.squared();
        let [n_h, n_l, n_v] = [h, wi, wo].map(|w| ns.dot(w));
        // (N·H)²(α² - 1) + 1, with 1 - (N·H)² as |N×H|²: the error bound of the difference would exceed sharp
        // highlights.
        let across = ns.cross(h);
        let width = across.dot(across) + a2 * n_h.squared();
        // The peak, where the width is α², is the maximum; even f32 computes it to a few roundings.
        let peak = Approx::ONE / (pi * a2);
        let d = (a2 / (pi * width.squared())).known_within(0.0, peak.value + 8.0 * peak.error);
        let smith = |cos: Approx| cos.abs() + (a2 + (1.0 - a2) * cos.squared()).sqrt();
        let v = Approx::ONE / (smith(n_l) * smith(n_v));
        diffuse + f * self.raised() * (d * v)
    }
}

/// Returns the albedo of the lobe at a cosine and a roughness that are known within bounds.
///
/// The terms of the fits are correlated, so that the bounds of their operations would add up to many times the error: the
/// fits are evaluated at the ends of both intervals instead.
pub fn lobe_albedo(cos: Approx, roughness: Approx) -> LobeAlbedo<Approx> {
    // Largest errors of the fits in f32, of 20 million random points 2.3e-6 for the loss and 4.8e-7 for the albedos
    const LOSS: f64 = 4e-6;
    const ALBEDO: f64 = 1e-6;
    let at = |cos_side: f64, roughness_side: f64| {
        let cos = (cos.value + cos_side * cos.error).clamp(f64::from(f32::MIN_POSITIVE), 1.0);
        let roughness = (roughness.value + roughness_side * roughness.error).clamp(0.0, 1.0);
        LobeAlbedo::evaluate(cos, roughness)
    };
    let middle = at(0.0, 0.0);
    let ends = [at(-1.0, -1.0), at(-1.0, 1.0), at(1.0, -1.0), at(1.0, 1.0)];
    // The fits are smooth, and the intervals are small: a quarter more than the largest difference covers extrema within
    let known = |of: fn(&LobeAlbedo<f64>) -> f64, fit: f64| {
        let differences = ends.iter().map(|end| (of(end) - of(&middle)).abs());
        Approx {
            value: of(&middle),
            error: fit + 1.25 * differences.fold(0.0, f64::max),
        }
    };
    LobeAlbedo {
        normal: known(|albedo| albedo.normal, ALBEDO),
        grazing: known(|albedo| albedo.grazing, ALBEDO),
        loss: known(|albedo| albedo.loss, LOSS),
    }
}
