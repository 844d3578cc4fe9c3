//! SIMD direct lighting and emission: background and emitted radiance, shadow rays, and mirror directions.
//!
//! Each function is compiled for several instruction sets and selected at run time. None contracts a multiplication
//! and an addition, so all give the same bits.

use multiversion::multiversion;

use super::super::surface::{SurfacePacket, Surfaces};
use super::super::wavefront::TracedPacket;
use super::lobe_variants::{LobeVariants, without_sampled_lobes};
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Effect, EffectSet, Light, LightKind};
use crate::shading::{
    MaterialPacket, diffuse_transmission, direct_combined, mirror, phong_direct, sample_punctual_light,
    transmitted_irradiance,
};

/// Surface interactions to be lit, with the throughput of their rays.
#[derive(Clone, Copy)]
pub(in crate::render) struct ShadingContext<'a> {
    pub(in crate::render) points: &'a SurfacePacket,
    pub(in crate::render) materials: &'a MaterialPacket,
    /// Path throughput of the rays that hit the surfaces.
    pub(in crate::render) weight: &'a Lanes3<f32>,
    /// Materials for lights that rays can hit.
    pub(in crate::render) variants: &'a LobeVariants,
}

impl<'a> ShadingContext<'a> {
    /// Returns the surface interactions of a traced packet.
    #[inline(always)]
    pub(in crate::render) fn of(
        traced: &TracedPacket<'a>,
        surfaces: &'a Surfaces,
        variants: &'a LobeVariants,
    ) -> ShadingContext<'a> {
        ShadingContext {
            points: &surfaces.points,
            materials: &surfaces.materials,
            weight: traced.weight,
            variants,
        }
    }

    /// Returns the surfaces with the materials for lights that rays can hit: without the lobes that secondary rays sample.
    pub(in crate::render) fn without_sampled_lobes(&self) -> ShadingContext<'a> {
        let materials = self.materials;
        ShadingContext {
            materials: self
                .variants
                .without
                .get_or_init(|| without_sampled_lobes(materials)),
            ..*self
        }
    }
}

/// Incident light at sixteen surfaces from sampled points or directions; zero where `irradiance` is 0.
pub(in crate::render) struct IncidentLight {
    /// Unit vectors towards the light.
    pub(in crate::render) wi: Lanes3<f32>,
    /// Irradiance on a surface that faces the light, linear RGB.
    pub(in crate::render) irradiance: Lanes3<f32>,
    /// Sampled light points; `None` if the light is infinitely far away.
    pub(in crate::render) from: Option<Lanes3<f64>>,
    /// Numbers of lobe rays over the densities of light samples, where both are combined
    /// ([`crate::shading::direct_combined`]).
    pub(in crate::render) lobe_ratios: Option<Lanes<f32>>,
}

impl IncidentLight {
    /// Incident light of zero at all surfaces.
    pub(in crate::render) const NONE: IncidentLight = IncidentLight {
        wi: [[0.0; LANES]; 3],
        irradiance: [[0.0; LANES]; 3],
        from: None,
        lobe_ratios: None,
    };
}

/// Mirror reflection rays of sixteen surfaces.
pub(in crate::render) struct ReflectedRays {
    /// Unit directions of the reflected rays.
    pub(in crate::render) direction: Lanes3<f32>,
    /// Throughput along the whole path, zero for surfaces that are not mirrors.
    pub(in crate::render) weight: Lanes3<f32>,
    /// True if the ray leaves the surface; with an interpolated normal, the reflected direction may point into it.
    pub(in crate::render) leaves: Lanes<bool>,
}

/// Radiance terms that need no light sampling: ambient and background.
pub(in crate::render) struct AmbientTerms<'a> {
    /// Ambient radiance that surfaces receive from all directions, linear RGB.
    pub(in crate::render) ambient: [f32; 3],
    /// Background radiance along each ray.
    pub(in crate::render) background: &'a Lanes3<f32>,
}

/// Returns the weighted background radiance of lanes that missed the scene.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(in crate::render) fn background_radiance(
    packet: &RayPacket,
    weight: &Lanes3<f32>,
    background: &Lanes3<f32>,
) -> Lanes3<f32> {
    let mut share = [0.0; LANES];
    for l in 0..LANES {
        let missed = (packet.active[l] != 0) & (packet.instance[l] == NO_HIT);
        share[l] = if missed { 1.0 } else { 0.0 };
    }
    let mut radiance = [[0.0; LANES]; 3];
    for channel in 0..3 {
        for l in 0..LANES {
            radiance[channel][l] = weight[channel][l] * background[channel][l] * share[l];
        }
    }
    radiance
}

/// Sets the albedos of the GGX lobes of the surfaces, towards the origins of their rays.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(in crate::render) fn evaluate_lobe_albedo(surfaces: &mut Surfaces) {
    let points = &surfaces.points;
    surfaces.materials.set_view(&points.ns, &points.wo);
}

/// Returns the weighted emission and ambient radiance of hits, and the weighted background of misses.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(in crate::render) fn emitted_radiance(
    packet: &RayPacket,
    surfaces: &Surfaces,
    weight: &Lanes3<f32>,
    light: &AmbientTerms,
) -> Lanes3<f32> {
    let emitted_radiance = if surfaces.materials.effects.has(Effect::Interreflection) {
        surfaces.materials.emission_and_lobes(light.ambient)
    } else {
        surfaces.materials.ambient(light.ambient)
    };
    let (mut share, mut hit) = ([0.0; LANES], [0.0; LANES]);
    for l in 0..LANES {
        share[l] = if packet.active[l] != 0 { 1.0 } else { 0.0 };
        hit[l] = if surfaces.points.hit[l] { 1.0 } else { 0.0 };
    }
    let mut radiance = [[0.0; LANES]; 3];
    for channel in 0..3 {
        for l in 0..LANES {
            let seen = emitted_radiance[channel][l] * hit[l] + light.background[channel][l] * (1.0 - hit[l]);
            radiance[channel][l] = weight[channel][l] * seen * share[l];
        }
    }
    radiance
}

/// Function with the arguments and the result of [`sample_direct`].
pub(in crate::render) type SampleDirect =
    fn(&Light, &ShadingContext, &mut RayPacket, &mut Lanes3<f32>) -> bool;

/// Returns the function that [`sample_direct`] calls for surfaces with these effects. Chosen once for a scene, it costs no
/// test for each packet.
pub(in crate::render) fn sample_direct_for(effects: EffectSet) -> SampleDirect {
    if effects.needs_full_material() {
        sample_direct_full
    } else {
        sample_direct_basic
    }
}

/// Fills the shadow-ray packet for `light` and the unoccluded reflected radiance. Returns whether any lane is active.
///
/// A lane is inactive where the light is behind the surface or nothing would be reflected.
#[inline(always)]
pub(in crate::render) fn sample_direct(
    light: &Light,
    lit: &ShadingContext,
    shadow_rays: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    if lit.materials.effects.needs_full_material() {
        sample_direct_full(light, lit, shadow_rays, radiance)
    } else {
        sample_direct_basic(light, lit, shadow_rays, radiance)
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn sample_direct_full(
    light: &Light,
    lit: &ShadingContext,
    shadow_rays: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    sample_direct_lanes::<true>(light, lit, shadow_rays, radiance)
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn sample_direct_basic(
    light: &Light,
    lit: &ShadingContext,
    shadow_rays: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    sample_direct_lanes::<false>(light, lit, shadow_rays, radiance)
}

#[inline(always)]
fn sample_direct_lanes<const EXTENDED: bool>(
    light: &Light,
    lit: &ShadingContext,
    shadow_rays: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    // Evaluate the incident light
    let surfaces = lit.points;
    let arriving = sample_punctual_light(light, &surfaces.p);
    let irradiance = |channel: usize, l: usize| light.intensity[channel] * arriving.attenuation[l];
    // Evaluate the reflected radiance and activate its lanes
    let directions = SampledDirections {
        wi: &arriving.wi,
        lobe_ratios: None,
    };
    let any = fill_shadow_rays::<EXTENDED>(lit, directions, irradiance, (&mut *shadow_rays, radiance));
    // Aim shadow rays at the light
    match light.kind {
        // Area lights are sampled point by point.
        LightKind::Area { .. } => return false,
        LightKind::Directional { .. } => aim_along(&arriving.wi, shadow_rays),
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => {
            aim_at(&position.to_array().map(|axis| [axis; LANES]), shadow_rays);
        }
    }
    any
}

/// Fills the shadow-ray packet for sampled light points or directions, and the unoccluded reflected radiance. Returns
/// whether any lane is active.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(in crate::render) fn sample_direct_area(
    arrivals: &IncidentLight,
    lit: &ShadingContext,
    shadow_rays: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    let irradiance = |channel: usize, l: usize| arrivals.irradiance[channel][l];
    let light = SampledDirections {
        wi: &arrivals.wi,
        lobe_ratios: arrivals.lobe_ratios.as_ref(),
    };
    let any = if lit.materials.effects.needs_full_material() {
        fill_shadow_rays::<true>(lit, light, irradiance, (&mut *shadow_rays, radiance))
    } else {
        fill_shadow_rays::<false>(lit, light, irradiance, (&mut *shadow_rays, radiance))
    };
    match &arrivals.from {
        None => aim_along(&arrivals.wi, shadow_rays),
        Some(from) => aim_at(from, shadow_rays),
    }
    any
}

/// Directions to lights from sixteen surfaces.
#[derive(Clone, Copy)]
struct SampledDirections<'a> {
    /// Unit vectors towards the light.
    wi: &'a Lanes3<f32>,
    /// Ratios as in [`IncidentLight::lobe_ratios`].
    lobe_ratios: Option<&'a Lanes<f32>>,
}

/// Evaluates the light reflected from sampled directions and sets the origins of the shadow rays. Returns whether any
/// lane is active.
#[inline(always)]
fn fill_shadow_rays<const EXTENDED: bool>(
    lit: &ShadingContext,
    light: SampledDirections,
    irradiance: impl Fn(usize, usize) -> f32,
    (shadow_rays, radiance): (&mut RayPacket, &mut Lanes3<f32>),
) -> bool {
    shadow_rays.origin = lit.points.origin;
    let any = eval_direct::<EXTENDED>(lit, light, irradiance, (&mut *shadow_rays, radiance));
    if EXTENDED {
        start_behind(lit, light.wi, shadow_rays);
    }
    any
}

/// Evaluates the weighted BSDF for sampled directions; a lane's shadow ray is active where the result is not zero.
/// Returns whether any lane is active.
#[inline(always)]
fn eval_direct<const EXTENDED: bool>(
    lit: &ShadingContext,
    light: SampledDirections,
    irradiance: impl Fn(usize, usize) -> f32,
    (shadow_rays, radiance): (&mut RayPacket, &mut Lanes3<f32>),
) -> bool {
    let SampledDirections { wi, lobe_ratios } = light;
    let surfaces = lit.points;
    let effects = if EXTENDED {
        lit.materials.effects
    } else {
        EffectSet::NONE
    };
    // Evaluate the BSDF, or the transmitted irradiance of a subsurface material, or a layer of sheen
    let materials = lit.materials;
    let mut reflected = match (materials.entry_ior, &materials.sheen) {
        (Some(eta), _) if effects.has(Effect::Subsurface) => transmitted_irradiance(eta, &surfaces.ns, wi),
        (_, Some(sheen)) if effects.has(Effect::Sheen) => sheen.direct(&surfaces.ns, &surfaces.wo, wi),
        _ => direct_combined::<EXTENDED>(materials, &surfaces.ns, &surfaces.wo, wi, lobe_ratios),
    };
    // Replace lanes of the Phong model
    if effects.has(Effect::Phong) {
        let phong = phong_direct(lit.materials, &surfaces.ns, &surfaces.wo, wi);
        for channel in 0..3 {
            for l in 0..LANES {
                let is_phong = lit.materials.extended.is_phong[l];
                reflected[channel][l] = if is_phong {
                    phong[channel][l]
                } else {
                    reflected[channel][l]
                };
            }
        }
    }
    // Use diffuse transmission where light is behind a thin surface
    let has_thin_surfaces = effects.has(Effect::Translucency);
    if has_thin_surfaces {
        let diffuse_transmission = diffuse_transmission(lit.materials, &surfaces.ns, &surfaces.wo, wi);
        for channel in 0..3 {
            for l in 0..LANES {
                let is_behind = above(surfaces, wi, l) < 0.0;
                let here = reflected[channel][l];
                reflected[channel][l] = if is_behind {
                    diffuse_transmission[channel][l]
                } else {
                    here
                };
            }
        }
    }
    // Multiply by irradiance and path throughput
    let mut any = 0;
    for l in 0..LANES {
        let above = above(surfaces, wi, l);
        let is_behind = has_thin_surfaces && (above < 0.0) & lit.materials.is_thin_surface(l);
        let reaches = surfaces.hit[l] & ((above > 0.0) | is_behind);
        let mut largest = 0.0f32;
        for channel in 0..3 {
            let value = lit.weight[channel][l] * (reflected[channel][l] * irradiance(channel, l));
            radiance[channel][l] = if reaches { value } else { 0.0 };
            largest = largest.max(radiance[channel][l].abs());
        }
        let active = -i32::from(largest > 0.0);
        shadow_rays.active[l] = active;
        any |= active;
    }
    any != 0
}

/// Returns the cosine of the angle between `wi` and the geometric normal.
#[inline(always)]
fn above(surfaces: &SurfacePacket, wi: &Lanes3<f32>, l: usize) -> f32 {
    let mut above = 0.0;
    for axis in 0..3 {
        above += surfaces.ng[axis][l] * wi[axis][l];
    }
    above
}

/// Moves the origins of shadow rays to the far side of thin surfaces that are lit from there.
#[inline(always)]
fn start_behind(lit: &ShadingContext, wi: &Lanes3<f32>, shadow_rays: &mut RayPacket) {
    let surfaces = lit.points;
    if !lit.materials.effects.has(Effect::Translucency) {
        return;
    }
    for l in 0..LANES {
        if (shadow_rays.active[l] != 0) & (above(surfaces, wi, l) < 0.0) {
            let origin = surfaces.leave(l, -surfaces.geometric_normal(l));
            (0..3).for_each(|axis| shadow_rays.origin[axis][l] = origin[axis]);
        }
    }
}

/// Aims shadow rays along directions, with infinite length.
#[inline(always)]
pub(in crate::render) fn aim_along(wi: &Lanes3<f32>, shadow_rays: &mut RayPacket) {
    shadow_rays.direction = *wi;
    shadow_rays.t_far = [f32::INFINITY; LANES];
}

/// Aims shadow rays at points, which are at t = 1 exactly, so that nothing behind them can occlude.
#[inline(always)]
pub(in crate::render) fn aim_at(points: &Lanes3<f64>, shadow_rays: &mut RayPacket) {
    // Subtract in f64 from the rounded origin, so that the ray ends at the point
    for axis in 0..3 {
        for l in 0..LANES {
            shadow_rays.direction[axis][l] =
                (points[axis][l] - f64::from(shadow_rays.origin[axis][l])) as f32;
        }
    }
    shadow_rays.t_far = [1.0; LANES];
}

/// Sets the radiance of lanes whose shadow rays are occluded to zero.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(in crate::render) fn block(shadow_rays: &RayPacket, radiance: &mut Lanes3<f32>) {
    for channel in radiance {
        for l in 0..LANES {
            channel[l] = if shadow_rays.t_far[l] == f32::NEG_INFINITY {
                0.0
            } else {
                channel[l]
            };
        }
    }
}

/// Returns the mirror reflection rays of the surfaces, with their path throughput.
#[inline(always)]
pub(in crate::render) fn reflection(lit: &ShadingContext) -> ReflectedRays {
    if lit.materials.effects.needs_full_material() {
        reflection_full(lit)
    } else {
        reflection_basic(lit)
    }
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn reflection_full(lit: &ShadingContext) -> ReflectedRays {
    reflection_of::<true>(lit)
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn reflection_basic(lit: &ShadingContext) -> ReflectedRays {
    reflection_of::<false>(lit)
}

#[inline(always)]
fn reflection_of<const EXTENDED: bool>(lit: &ShadingContext) -> ReflectedRays {
    let surfaces = lit.points;
    let (direction, mut reflectance) = mirror::<EXTENDED>(lit.materials, &surfaces.ns, &surfaces.wo);
    let mut leaves = [false; LANES];
    for l in 0..LANES {
        let mut above = 0.0;
        for axis in 0..3 {
            above += surfaces.ng[axis][l] * direction[axis][l];
        }
        leaves[l] = above > 0.0;
        // Transmissive surfaces divide light by Fresnel's equations in `refract_rays`.
        let divides = EXTENDED && lit.materials.effects.has(Effect::Refraction) & lit.materials.transmits(l);
        for channel in 0..3 {
            let weight = if divides { 0.0 } else { lit.weight[channel][l] };
            reflectance[channel][l] *= weight;
        }
    }
    ReflectedRays {
        direction,
        weight: reflectance,
        leaves,
    }
}
