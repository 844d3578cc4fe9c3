//! Lobes of sixteen opaque surfaces at once, and the rays that they reflect.
//!
//! All functions give the bits of [`GlossyLobe`], which the lanes of anisotropic lobes come from.

use glam::DVec3;
use multiversion::multiversion;

use super::super::surface::{Surfaces, lane};
use super::lobe_rays::{LobeRayCounts, LobeRays};
use super::microfacet::{GlossyLobe, spread};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::optics::reflect;
use crate::scene::Effect;
use crate::shading::Ggx;

/// Lobes of sixteen surfaces, towards the origins of the rays that hit them.
pub(super) struct LobePacket<'a> {
    ggx: Lanes<Ggx>,
    /// Axes of the shading frames in world space: two tangents and the normal.
    axes: [Lanes3<f64>; 3],
    /// Unit vectors to the origins of the incident rays, in the shading frames.
    wo: Lanes3<f64>,
    /// Unit geometric normals on the sides of the incident rays, in world space.
    side: &'a Lanes3<f32>,
}

impl LobePacket<'_> {
    /// Returns the lobes of the surfaces.
    pub(super) fn of(surfaces: &Surfaces) -> LobePacket<'_> {
        let mut lobes = LobePacket {
            ggx: [Ggx::SMOOTH; LANES],
            axes: [[[0.0; LANES]; 3]; 3],
            wo: [[0.0; LANES]; 3],
            side: &surfaces.points.ng,
        };
        orient(surfaces, &mut lobes);
        // Replace those that are anisotropic, of which few scenes have any
        let (points, materials) = (&surfaces.points, &surfaces.materials);
        if materials.effects.has(Effect::Anisotropy) {
            for l in (0..LANES).filter(|&l| points.hit[l] && materials.extended.anisotropy[l] > 0.0) {
                let wo = lane(&points.wo, l).as_dvec3().normalize();
                let normals = [points.shading_normal(l), points.geometric_normal(l)];
                lobes.set(l, GlossyLobe::of_material(materials, l, normals, wo));
            }
        }
        lobes
    }

    fn set(&mut self, l: usize, lobe: Option<GlossyLobe>) {
        // A lobe below its surface reflects nothing
        let Some(lobe) = lobe else {
            self.wo[2][l] = 0.0;
            return;
        };
        self.ggx[l] = lobe.ggx;
        for axis in 0..3 {
            (0..3).for_each(|row| self.axes[axis][row][l] = lobe.world_from_lobe.col(axis)[row]);
            self.wo[axis][l] = lobe.wo[axis];
        }
    }

    /// Returns the rays that the microfacets reflect which the random pairs `u` select.
    pub(super) fn reflect(&self, u: &[Lanes<f64>; 2], counts: &LobeRayCounts) -> LobeRays {
        let mut rays = LobeRays::NONE;
        reflect_lanes(self, u, counts, &mut rays);
        rays
    }
}

/// Sets the isotropic lobes of the surfaces.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn orient(surfaces: &Surfaces, lobes: &mut LobePacket) {
    let points = &surfaces.points;
    for l in 0..LANES {
        // Build the shading frame around the normal
        let n = lane(&points.ns, l).as_dvec3().normalize();
        let wo = lane(&points.wo, l).as_dvec3().normalize();
        let (t, b) = n.any_orthonormal_pair();
        for (axis, vector) in [t, b, n].into_iter().enumerate() {
            for row in 0..3 {
                lobes.axes[axis][row][l] = vector[row];
            }
            lobes.wo[axis][l] = vector.dot(wo);
        }
        lobes.ggx[l] = Ggx::from_roughness(f64::from(surfaces.materials.roughness[l]));
    }
}

/// Compiles [`LobePacket::reflect`] for several instruction sets.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn reflect_lanes(lobes: &LobePacket, u: &[Lanes<f64>; 2], counts: &LobeRayCounts, rays: &mut LobeRays) {
    for l in 0..LANES {
        // Reflect at a microfacet
        let (ggx, wo) = (lobes.ggx[l], lane_f64(&lobes.wo, l));
        let m = ggx.sample_vndf(wo, [u[0][l], u[1][l]]);
        let wi = reflect(-wo, m);
        // Turn the ray to world space, where it may be on the wrong side of the geometric surface
        let [t, b, n] = [0, 1, 2].map(|axis| lane_f64(&lobes.axes[axis], l));
        let direction = t * wi.x + b * wi.y + n * wi.z;
        rays.leaves[l] = (wo.z > 0.0) & (wi.z > 0.0) & (direction.dot(lane(lobes.side, l).as_dvec3()) > 0.0);
        // Weight it by the masking of the light, and widen its cone by the lobe
        let pdf = ggx.reflection_pdf(wo, wi);
        let of = f64::from(counts.of[l]);
        rays.share[l] = (ggx.smith_g1(wi) / of) as f32;
        rays.spread[l] = spread(pdf * counts.of_pixel[l]);
        rays.density[l] = (pdf * of) as f32;
        rays.cos_i[l] = wo.dot(m).clamp(0.0, 1.0) as f32;
        for axis in 0..3 {
            rays.direction[axis][l] = direction[axis];
        }
    }
}

#[inline(always)]
fn lane_f64(vectors: &Lanes3<f64>, l: usize) -> DVec3 {
    DVec3::new(vectors[0][l], vectors[1][l], vectors[2][l])
}
