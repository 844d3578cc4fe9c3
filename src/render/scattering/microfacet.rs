//! Lobes of rough surfaces and their microfacets, which scatter rays like mirrors.

use std::f64::consts::TAU;

use glam::{DMat3, DVec3};

use super::boundary::Boundary;
use crate::optics::{reflect, refract};
use crate::scene::Effect;
use crate::shading::{Ggx, MaterialPacket};

/// Scattered ray, without its origin.
pub(in crate::render) struct ScatteredRay {
    /// Unit direction in world space.
    pub(in crate::render) direction: DVec3,
    /// Cosines of the angles of the incident and the scattered ray with the surface normal or a microfacet normal.
    pub(in crate::render) cosines: [f64; 2],
    /// Weight of the radiance along the ray, without Fresnel's factor and tints.
    pub(in crate::render) share: f32,
    /// Increase of the spread of the ray cone, from the width of the lobe.
    pub(in crate::render) spread: f64,
}

/// Lobe of a rough surface for one incident direction.
pub(in crate::render) struct GlossyLobe {
    pub(in crate::render) ggx: Ggx,
    /// Rotation from the shading frame, whose z axis is the normal, to world space.
    pub(in crate::render) world_from_lobe: DMat3,
    /// Unit vector to the origin of the incident ray, in the shading frame.
    pub(in crate::render) wo: DVec3,
    /// Unit geometric normal on the side of the incident ray, in world space.
    pub(in crate::render) side: DVec3,
    /// Number of microfacets that this hit samples.
    pub(in crate::render) of: u32,
    /// Number of microfacets that all samples of the pixel draw together.
    pub(in crate::render) of_pixel: f64,
}

/// Microfacet of a rough surface, which scatters like a mirror.
pub(in crate::render) struct Microfacet<'a> {
    lobe: &'a GlossyLobe,
    /// Unit normal of the microfacet, in the shading frame.
    m: DVec3,
}

impl GlossyLobe {
    /// Returns the lobe of a surface with this roughness and unit normal `n` for light towards `wo`; `None` if `wo`
    /// is below the surface.
    pub(in crate::render) fn new(roughness: f32, [n, side]: [DVec3; 2], wo: DVec3) -> Option<GlossyLobe> {
        let (t, b) = n.any_orthonormal_pair();
        let ggx = Ggx::from_roughness(f64::from(roughness));
        GlossyLobe::in_frame(ggx, DMat3::from_cols(t, b, n), side, wo)
    }

    /// Returns the lobe of lane `l` of surfaces with unit normals `n`, which may be anisotropic, for light towards `wo`;
    /// `None` if `wo` is below the surface.
    pub(in crate::render) fn of_material(
        materials: &MaterialPacket,
        l: usize,
        [n, side]: [DVec3; 2],
        wo: DVec3,
    ) -> Option<GlossyLobe> {
        let extended = &materials.extended;
        if materials.effects.has(Effect::Anisotropy) && extended.anisotropy[l] > 0.0 {
            // Align the frame with the direction of anisotropy
            let direction = extended.anisotropy_direction.map(|axis| f64::from(axis[l]));
            let direction = DVec3::from_array(direction);
            if let Some(t) = (direction - n * n.dot(direction)).try_normalize() {
                let ggx = Ggx::anisotropic(materials.alphas(l).map(f64::from));
                return GlossyLobe::in_frame(ggx, DMat3::from_cols(t, n.cross(t), n), side, wo);
            }
        }
        GlossyLobe::new(materials.roughness[l], [n, side], wo)
    }

    /// Returns a lobe by its rotation to world space; `None` if `wo` is below the surface.
    fn in_frame(ggx: Ggx, world_from_lobe: DMat3, side: DVec3, wo: DVec3) -> Option<GlossyLobe> {
        let wo = world_from_lobe.transpose() * wo;
        (wo.z > 0.0).then_some(GlossyLobe {
            ggx,
            world_from_lobe,
            wo,
            side,
            of: 1,
            of_pixel: 1.0,
        })
    }

    pub(in crate::render) fn microfacet(&self, u: [f64; 2]) -> Microfacet<'_> {
        Microfacet {
            lobe: self,
            m: self.ggx.sample_vndf(self.wo, u),
        }
    }

    /// Returns the ray along `wi`, which has the density `pdf` and is transmitted if `wi` is below the surface;
    /// `None` if it leaves on the wrong side of the geometric surface.
    fn scattered_ray(&self, wi: DVec3, cosines: [f64; 2], [visible, pdf]: [f64; 2]) -> Option<ScatteredRay> {
        let direction = self.world_from_lobe * wi;
        // With an interpolated normal, a direction may lie on the wrong side of the geometric surface.
        (direction.dot(self.side) * wi.z > 0.0).then(|| ScatteredRay {
            direction,
            cosines,
            share: (visible / f64::from(self.of)) as f32,
            spread: spread(pdf * self.of_pixel),
        })
    }
}

/// Returns the spread of a ray with `density` per steradian: the root of the solid angle that it stands for, at most
/// a hemisphere, as for the cone of a pixel.
///
/// For incidence along the normal, the centre of the lobe has the density 1 / (4 π alpha²), and a single ray the
/// spread 2 √π alpha.
#[inline(always)]
pub(super) fn spread(density: f64) -> f64 {
    density.sqrt().recip().min(TAU.sqrt())
}

impl Microfacet<'_> {
    /// Returns the cosine of the angle of incidence on the microfacet.
    pub(in crate::render) fn cos_i(&self) -> f64 {
        self.lobe.wo.dot(self.m).clamp(0.0, 1.0)
    }

    /// Returns the reflected ray, or `None` if it points into the surface.
    pub(in crate::render) fn reflected(&self) -> Option<ScatteredRay> {
        let GlossyLobe { ggx, wo, .. } = self.lobe;
        let wi = reflect(-wo, self.m);
        if !(wi.z > 0.0) {
            return None;
        }
        let weights = [ggx.smith_g1(wi), ggx.reflection_pdf(*wo, wi)];
        self.lobe.scattered_ray(wi, [self.cos_i(); 2], weights)
    }

    /// Returns the refracted ray, or `None` with total internal reflection or if the ray does not leave behind the
    /// surface.
    ///
    /// Behind a thin surface are its interior and its equally rough back side, which `KHR_materials_transmission`
    /// models by the mirrored lobe on the far side.
    pub(in crate::render) fn refracted(
        &self,
        boundary: &Boundary,
        [eta_i, eta_t]: [f64; 2],
    ) -> Option<ScatteredRay> {
        let GlossyLobe { ggx, wo, .. } = self.lobe;
        // Mirror the reflected lobe to the far side of a thin surface
        if boundary.is_thin_surface() {
            let mirrored = reflect(-wo, self.m);
            if !(mirrored.z > 0.0) {
                return None;
            }
            let weights = [ggx.smith_g1(mirrored), ggx.reflection_pdf(*wo, mirrored)];
            let wi = mirrored.with_z(-mirrored.z);
            return self.lobe.scattered_ray(wi, [self.cos_i(); 2], weights);
        }
        if eta_i == eta_t {
            // Without a change of index, roughness has no effect.
            return self
                .lobe
                .scattered_ray(-wo, [self.cos_i(); 2], [1.0, f64::INFINITY]);
        }
        // Refract at the microfacet
        let refraction = refract(-wo, self.m, eta_i, eta_t)?;
        let wi = refraction.direction;
        if !(wi.z < 0.0) {
            return None;
        }
        let pdf = ggx.transmission_pdf(*wo, wi, eta_t / eta_i);
        let cosines = [self.cos_i(), refraction.cos_t];
        self.lobe.scattered_ray(wi, cosines, [ggx.smith_g1(wi), pdf])
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    #[test]
    fn ray_width_covers_its_share_of_the_lobe() {
        let roughness = 0.25f32;
        let alpha = f64::from(roughness) * f64::from(roughness);
        let lobe = GlossyLobe {
            of: 4,
            of_pixel: 4.0 * 16.0,
            ..GlossyLobe::new(roughness, [DVec3::Z; 2], DVec3::Z).unwrap()
        };
        let middle = lobe.microfacet([0.0, 0.0]).reflected().unwrap();
        // One of 64 rays at the centre: 2 √π alpha over the root of 64.
        let expected = 2.0 * PI.sqrt() * alpha / 8.0;
        assert!(
            (middle.spread / expected - 1.0).abs() < 1e-12,
            "{}",
            middle.spread
        );
        assert_eq!((middle.direction, middle.share), (DVec3::Z, 0.25));
        // Far from the centre the density is low; a ray is never wider than a hemisphere.
        assert!(lobe.microfacet([0.0, 0.9]).reflected().unwrap().spread > middle.spread);
        assert_eq!(spread(0.0), TAU.sqrt());
    }
}
