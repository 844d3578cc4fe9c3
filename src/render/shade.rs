//! The lane arithmetic between hits and the next rays: surroundings, glow, shadow rays, mirror rays.
//!
//! Each function is compiled for several instruction sets and chosen at run time; none contracts a multiply and an add,
//! so all give the same bits.

use std::cell::OnceCell;

use multiversion::multiversion;

use super::outcome::Traced;
use super::soft::Arrivals;
use super::surface::{SurfacePacket, Surfaces};
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Effect, EffectSet, Light, LightKind};
use crate::shading::{
    MaterialPacket, direct_of, illuminate, mirror, phong_direct, through, transmitted_irradiance,
};

/// Surfaces to light, and the rays that found them.
#[derive(Clone, Copy)]
pub(super) struct Lit<'a> {
    pub(super) points: &'a SurfacePacket,
    pub(super) materials: &'a MaterialPacket,
    /// Weights of the rays that found the surfaces.
    pub(super) weight: &'a Lanes3<f32>,
    /// The materials as they answer light that they see as well, from when that is first asked for.
    pub(super) without_seen_lobes: &'a OnceCell<MaterialPacket>,
}

impl<'a> Lit<'a> {
    /// Those that a traced packet has met.
    #[inline(always)]
    pub(super) fn of(
        traced: &Traced<'a>,
        surfaces: &'a Surfaces,
        without_seen_lobes: &'a OnceCell<MaterialPacket>,
    ) -> Lit<'a> {
        Lit {
            points: &surfaces.points,
            materials: &surfaces.materials,
            weight: traced.weight,
            without_seen_lobes,
        }
    }
}

/// The mirror rays of sixteen surfaces.
pub(super) struct Mirrored {
    /// Unit directions.
    pub(super) direction: Lanes3<f32>,
    /// Weights along the whole path, zero for surfaces that are no mirrors.
    pub(super) weight: Lanes3<f32>,
    /// Whether the ray leaves the surface rather than entering it, which an interpolated normal may ask for.
    pub(super) leaves: Lanes<bool>,
}

/// Light that no lamp causes.
pub(super) struct Uncaused<'a> {
    /// What surfaces get from all around.
    pub(super) ambient: [f32; 3],
    /// What is seen behind everything.
    pub(super) background: &'a Lanes3<f32>,
}

/// What the lanes that hit nothing bring home.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn surroundings(
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

/// What needs no light: emission and the ambient term where something was hit, the surroundings elsewhere.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn glow(
    packet: &RayPacket,
    surfaces: &Surfaces,
    weight: &Lanes3<f32>,
    light: &Uncaused,
) -> Lanes3<f32> {
    let glow = surfaces.materials.ambient(light.ambient);
    let (mut share, mut hit) = ([0.0; LANES], [0.0; LANES]);
    for l in 0..LANES {
        share[l] = if packet.active[l] != 0 { 1.0 } else { 0.0 };
        hit[l] = if surfaces.points.hit[l] { 1.0 } else { 0.0 };
    }
    let mut radiance = [[0.0; LANES]; 3];
    for channel in 0..3 {
        for l in 0..LANES {
            let seen = glow[channel][l] * hit[l] + light.background[channel][l] * (1.0 - hit[l]);
            radiance[channel][l] = weight[channel][l] * seen * share[l];
        }
    }
    radiance
}

/// Makes the shadow rays to one light and the radiance that arrives where they meet nothing. Returns whether there is
/// any.
///
/// A lane has no shadow ray where the light is behind the surface or nothing would be reflected.
#[inline(always)]
pub(super) fn sample_direct(
    light: &Light,
    lit: &Lit,
    shadow_rays: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    if lit.materials.effects.is_rich() {
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
    lit: &Lit,
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
    lit: &Lit,
    shadow_rays: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    sample_direct_lanes::<false>(light, lit, shadow_rays, radiance)
}

#[inline(always)]
fn sample_direct_lanes<const RICH: bool>(
    light: &Light,
    lit: &Lit,
    shadow_rays: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    let surfaces = lit.points;
    let arriving = illuminate(light, &surfaces.p);
    let irradiance = |channel: usize, l: usize| light.intensity[channel] * arriving.attenuation[l];
    let any = fill_shadow_rays::<RICH>(lit, &arriving.wi, irradiance, (&mut *shadow_rays, radiance));
    match light.kind {
        // Points of it are asked one by one.
        LightKind::Area { .. } => return false,
        LightKind::Directional { .. } => aim_along(&arriving.wi, shadow_rays),
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => {
            aim_at(&position.to_array().map(|axis| [axis; LANES]), shadow_rays);
        }
    }
    any
}

/// Makes the shadow rays to points of a light, or along directions, and the radiance that arrives where they meet
/// nothing. Returns whether there is any.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn sample_direct_area(
    arrivals: &Arrivals,
    lit: &Lit,
    shadow_rays: &mut RayPacket,
    radiance: &mut Lanes3<f32>,
) -> bool {
    let irradiance = |channel: usize, l: usize| arrivals.irradiance[channel][l];
    let any = if lit.materials.effects.is_rich() {
        fill_shadow_rays::<true>(lit, &arrivals.wi, irradiance, (&mut *shadow_rays, radiance))
    } else {
        fill_shadow_rays::<false>(lit, &arrivals.wi, irradiance, (&mut *shadow_rays, radiance))
    };
    match &arrivals.from {
        None => aim_along(&arrivals.wi, shadow_rays),
        Some(from) => aim_at(from, shadow_rays),
    }
    any
}

/// What surfaces make of the light that comes from `wi`, and where the shadow rays to it start. Returns whether there is
/// any.
#[inline(always)]
fn fill_shadow_rays<const RICH: bool>(
    lit: &Lit,
    wi: &Lanes3<f32>,
    irradiance: impl Fn(usize, usize) -> f32,
    (shadow_rays, radiance): (&mut RayPacket, &mut Lanes3<f32>),
) -> bool {
    shadow_rays.origin = lit.points.origin;
    let any = answer::<RICH>(lit, wi, irradiance, (&mut *shadow_rays, radiance));
    if RICH {
        start_behind(lit, wi, shadow_rays);
    }
    any
}

/// What surfaces make of the light that comes from `wi`; a lane's shadow ray is active where that is anything.
#[inline(always)]
fn answer<const RICH: bool>(
    lit: &Lit,
    wi: &Lanes3<f32>,
    irradiance: impl Fn(usize, usize) -> f32,
    (shadow_rays, radiance): (&mut RayPacket, &mut Lanes3<f32>),
) -> bool {
    let surfaces = lit.points;
    let effects = if RICH {
        lit.materials.effects
    } else {
        EffectSet::NONE
    };
    let mut reflected = match lit.materials.enters {
        Some(eta) if effects.has(Effect::Subsurface) => transmitted_irradiance(eta, &surfaces.ns, wi),
        _ => direct_of::<RICH>(lit.materials, &surfaces.ns, &surfaces.wo, wi),
    };
    if effects.has(Effect::Lecture) {
        let lecture = phong_direct(lit.materials, &surfaces.ns, &surfaces.wo, wi);
        for channel in 0..3 {
            for l in 0..LANES {
                let is_lecture = lit.materials.rich.is_lecture[l];
                reflected[channel][l] = if is_lecture {
                    lecture[channel][l]
                } else {
                    reflected[channel][l]
                };
            }
        }
    }
    let has_sheets = effects.has(Effect::Translucency);
    if has_sheets {
        let through = through(lit.materials, &surfaces.ns, &surfaces.wo, wi);
        for channel in 0..3 {
            for l in 0..LANES {
                let is_behind = above(surfaces, wi, l) < 0.0;
                let here = reflected[channel][l];
                reflected[channel][l] = if is_behind { through[channel][l] } else { here };
            }
        }
    }
    let mut any = 0;
    for l in 0..LANES {
        let above = above(surfaces, wi, l);
        let is_behind = has_sheets && (above < 0.0) & lit.materials.is_sheet(l);
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

/// How far above the surface `wi` points, as a cosine.
#[inline(always)]
fn above(surfaces: &SurfacePacket, wi: &Lanes3<f32>, l: usize) -> f32 {
    let mut above = 0.0;
    for axis in 0..3 {
        above += surfaces.ng[axis][l] * wi[axis][l];
    }
    above
}

/// Lets shadow rays start on the other side of sheets whose light is there.
#[inline(always)]
fn start_behind(lit: &Lit, wi: &Lanes3<f32>, shadow_rays: &mut RayPacket) {
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

/// Shadow rays that go on for ever.
#[inline(always)]
fn aim_along(wi: &Lanes3<f32>, shadow_rays: &mut RayPacket) {
    shadow_rays.direction = *wi;
    shadow_rays.t_far = [f32::INFINITY; LANES];
}

/// Shadow rays that end at points: those are at t = 1 exactly, so nothing behind them can block.
#[inline(always)]
fn aim_at(points: &Lanes3<f64>, shadow_rays: &mut RayPacket) {
    for axis in 0..3 {
        for l in 0..LANES {
            shadow_rays.direction[axis][l] =
                (points[axis][l] - f64::from(shadow_rays.origin[axis][l])) as f32;
        }
    }
    shadow_rays.t_far = [1.0; LANES];
}

/// Takes the light from the lanes whose shadow rays were blocked.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn block(shadow_rays: &RayPacket, radiance: &mut Lanes3<f32>) {
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

/// The mirror rays of the surfaces, with the weights that they would carry.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn reflection(lit: &Lit) -> Mirrored {
    if lit.materials.effects.is_rich() {
        reflection_of::<true>(lit)
    } else {
        reflection_of::<false>(lit)
    }
}

#[inline(always)]
fn reflection_of<const RICH: bool>(lit: &Lit) -> Mirrored {
    let surfaces = lit.points;
    let (direction, mut reflectance) = mirror::<RICH>(lit.materials, &surfaces.ns, &surfaces.wo);
    let mut leaves = [false; LANES];
    for l in 0..LANES {
        let mut above = 0.0;
        for axis in 0..3 {
            above += surfaces.ng[axis][l] * direction[axis][l];
        }
        leaves[l] = above > 0.0;
        // What lets light through is divided by Fresnel's equations elsewhere.
        let divides = RICH && lit.materials.effects.has(Effect::Refraction) & lit.materials.transmits(l);
        for channel in 0..3 {
            let weight = if divides { 0.0 } else { lit.weight[channel][l] };
            reflectance[channel][l] *= weight;
        }
    }
    Mirrored {
        direction,
        weight: reflectance,
        leaves,
    }
}
