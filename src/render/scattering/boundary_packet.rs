//! Smooth boundaries of solid dielectrics that sixteen rays hit at once, and the rays that they scatter.
//!
//! Media are looked up lane by lane; all arithmetic runs over lanes and has the bits of the functions for one ray in
//! [`super::dielectric`]. Where light disperses, the rays of all lanes at one wavelength form a packet. A few lanes are
//! left to the functions for one ray: thin walls, thin films, and rays that an interpolated normal would turn to the
//! wrong side of the surface.

use glam::DVec3;
use multiversion::multiversion;

use super::super::profile::Category;
use super::super::surface::{SurfacePacket, Surfaces, lane};
use super::super::wavefront::{PathState, PathStatePacket, RayWorkItem, ShadingState, TracedPacket};
use super::dielectric::{Tints, applies_fresnel};
use crate::numeric::{LANES, Lanes, Lanes3, Ray, offset_point, spawn_point};
use crate::optics::{DielectricLanes, InteriorStack, LINE_D, NestedInterior, dielectric_lanes, reflect};
use crate::scene::{Effect, MIRROR_ROUGHNESS};
use crate::shading::ray_cone::RayCone;

/// Rays that hit smooth boundaries of solids. Other lanes hold a ray along the normal, from one medium into the same.
struct IncidentRays<'a> {
    surfaces: &'a Surfaces,
    /// Path throughput at the hits.
    weight: &'a Lanes3<f32>,
    /// Unit directions of the rays.
    direction: Lanes3<f64>,
    /// Unit shading normals for reflection and refraction, on the sides of the rays.
    normal: Lanes3<f64>,
    /// Ray cones at the hits.
    cone: Lanes<RayCone>,
    /// True in lanes where Fresnel's equations apply.
    applies_fresnel: Lanes<bool>,
    /// Media on both sides.
    sides: Lanes<BoundarySides>,
    /// Optical properties at the current wavelengths.
    indices: BoundaryIndices,
    /// Reflection and refraction at the current wavelengths.
    interfaces: DielectricLanes,
    /// Weights of the reflected rays, summed over the wavelengths so far, relative to those of the incident rays.
    mirrored: Lanes3<f32>,
    /// True in lanes that are left to the functions for one ray.
    is_left: Lanes<bool>,
}

/// Media on both sides of a boundary.
#[derive(Clone, Copy)]
struct BoundarySides {
    /// Interior on the side of the incident ray; `None` for the background medium.
    before: Option<NestedInterior>,
    /// Interior behind the boundary.
    after: Option<NestedInterior>,
    /// Place of the wavelengths within their strata, where the boundary splits them.
    split: Option<f64>,
}

/// Optical properties of the boundaries for one wavelength in each lane.
struct BoundaryIndices {
    /// Wavelengths in nanometres; 0 for all wavelengths.
    wavelength: Lanes<f32>,
    /// RGB weights of the wavelengths.
    color: Lanes3<f32>,
    /// Indices of refraction on the sides of the incident rays.
    eta_i: Lanes<f64>,
    /// Indices of refraction behind the boundaries.
    eta_t: Lanes<f64>,
    /// True in lanes that send a ray of this wavelength.
    is_used: Lanes<bool>,
}

/// Rays that leave sixteen surfaces.
pub(in crate::render) struct BoundaryRays {
    /// Unit directions in world space.
    direction: Lanes3<f64>,
    /// Origins of the rays, on the sides of their directions.
    origin: Lanes3<f32>,
    /// Path throughput along the rays, linear RGB.
    weight: Lanes3<f32>,
    /// Ray cones behind the boundaries.
    cone: Lanes<RayCone>,
    /// Wavelengths in nanometres; 0 for all wavelengths.
    wavelength: Lanes<f32>,
    /// True in lanes that send a ray.
    is_sent: Lanes<bool>,
}

impl BoundaryRays {
    /// No rays in any lane.
    const NONE: BoundaryRays = BoundaryRays {
        direction: [[0.0; LANES]; 3],
        origin: [[0.0; LANES]; 3],
        weight: [[0.0; LANES]; 3],
        cone: [PathState::NONE.cone; LANES],
        wavelength: [0.0; LANES],
        is_sent: [false; LANES],
    };

    /// Sets ray and weight of `sent`, and the direction and the cone of its path, to those of lane `l`.
    #[inline(always)]
    fn write(&self, l: usize, sent: &mut RayWorkItem) {
        let direction = vector(&self.direction, l);
        sent.ray = Ray::new(lane(&self.origin, l), direction.as_vec3());
        sent.weight = [0, 1, 2].map(|c| self.weight[c][l]);
        if let Some(travel) = &mut sent.travel {
            travel.direction = direction;
            travel.cone = self.cone[l];
        }
    }
}

impl<'a> IncidentRays<'a> {
    /// Returns a packet without rays, of paths with the throughput `weight` at these surfaces.
    #[inline(always)]
    fn new(surfaces: &'a Surfaces, weight: &'a Lanes3<f32>) -> IncidentRays<'a> {
        let outside = BoundarySides {
            before: None,
            after: None,
            split: None,
        };
        IncidentRays {
            surfaces,
            weight,
            direction: [[0.0; LANES], [0.0; LANES], [-1.0; LANES]],
            normal: [[0.0; LANES], [0.0; LANES], [1.0; LANES]],
            cone: [PathState::NONE.cone; LANES],
            applies_fresnel: [true; LANES],
            sides: [outside; LANES],
            indices: BoundaryIndices {
                wavelength: [0.0; LANES],
                color: [[1.0; LANES]; 3],
                eta_i: [1.0; LANES],
                eta_t: [1.0; LANES],
                is_used: [false; LANES],
            },
            interfaces: DielectricLanes::NONE,
            mirrored: [[0.0; LANES]; 3],
            is_left: [false; LANES],
        }
    }
}

impl ShadingState<'_, '_> {
    /// Queues the reflected and refracted rays at smooth transmissive surfaces. Rough ones are handled in
    /// `refract_rough_rays`.
    pub(in crate::render) fn refract_rays(
        &mut self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &Surfaces,
    ) {
        let materials = &surfaces.materials;
        let refracts: Lanes<bool> = std::array::from_fn(|l| {
            // Weights of a single wavelength may be negative, so that the sum of the channels is not a valid test.
            let seen = traced.weight.iter().any(|channel| channel[l] != 0.0);
            surfaces.points.hit[l] && seen && materials.transmits(l) && !materials.has_lobe(l)
        });
        if refracts.contains(&true) {
            self.scatter_smoothly(traced, path_states, surfaces, &refracts);
        }
    }

    /// Queues the reflected and refracted rays of the lanes in `refracts`.
    #[inline(never)]
    fn scatter_smoothly(
        &mut self,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        surfaces: &Surfaces,
        refracts: &Lanes<bool>,
    ) {
        // Look up the media of each lane
        let mut incident = IncidentRays::new(surfaces, traced.weight);
        for l in (0..LANES).filter(|&l| refracts[l]) {
            self.gather_incident(&mut incident, traced, path_states, l);
        }
        // Refract at each wavelength, then reflect
        let is_split = incident.sides.iter().any(|sides| sides.split.is_some());
        let count = if is_split {
            self.frame.spectrum.weights().len()
        } else {
            1
        };
        let mut rays = std::mem::take(&mut self.boundary_rays);
        while rays.len() <= count {
            rays.push(BoundaryRays::NONE);
        }
        for number in 0..count {
            if is_split {
                self.set_indices(&mut incident, number);
            }
            refract_lanes(&mut incident, &mut rays[number]);
        }
        reflect_lanes(&incident, &mut rays[count]);
        // Queue the rays of each lane together
        for l in (0..LANES).filter(|&l| refracts[l]) {
            if incident.is_left[l] {
                self.cross(traced, path_states, surfaces, l);
            } else {
                let arrival = path_states.lane(l);
                let through = self.media_behind(&incident, traced.packet.instance[l], &arrival.media, l);
                self.send_scattered(traced, &arrival, (&through, &rays[..=count]), l);
            }
        }
        self.boundary_rays = rays;
    }

    /// Sets lane `l` of `incident`, or leaves it to the functions for one ray.
    #[inline(always)]
    fn gather_incident(
        &self,
        incident: &mut IncidentRays,
        traced: &TracedPacket,
        path_states: PathStatePacket,
        l: usize,
    ) {
        let frame = self.frame;
        let (points, materials) = (&incident.surfaces.points, &incident.surfaces.materials);
        let surface = frame.crossed_surface(traced.packet.instance[l], points.front[l]);
        let has_film = frame.effects().has(Effect::Iridescence) && materials.extended.film[l] > 0.0;
        if surface.interior.is_none() || has_film {
            incident.is_left[l] = true;
            return;
        }
        // Set the ray and the normal
        let (direction, normal) = (
            path_states.direction(l),
            frame
                .surfaces
                .interface_normal(traced.packet, incident.surfaces, l),
        );
        for axis in 0..3 {
            incident.direction[axis][l] = direction[axis];
            incident.normal[axis][l] = normal[axis];
        }
        incident.cone[l] = frame.cone_at(traced, path_states, l);
        incident.applies_fresnel[l] = applies_fresnel(&surface.material.model);
        // Set the media, and split wavelengths only once, where either side is dispersive
        let media = path_states.media(l);
        let (before, after) = (media.current(), surface.after(&media));
        let wavelength = path_states.wavelength(l);
        let disperses = frame.effects().has(Effect::Dispersion)
            && wavelength == 0.0
            && (frame.disperses(before) || frame.disperses(after));
        incident.indices.is_used[l] = true;
        let split = disperses.then(|| {
            let offset = self.wavelength_offsets.get(traced.pixel[l] as usize);
            offset.copied().unwrap_or(0.5)
        });
        incident.sides[l] = BoundarySides { before, after, split };
        if disperses {
            return;
        }
        let nanometres = if wavelength > 0.0 {
            f64::from(wavelength)
        } else {
            LINE_D
        };
        incident.indices.wavelength[l] = wavelength;
        incident.indices.eta_i[l] = frame.ior(before, nanometres);
        incident.indices.eta_t[l] = frame.ior(after, nanometres);
    }

    /// Returns the interiors behind the boundary that `instance` forms in lane `l`, around a ray inside `media`.
    #[inline(always)]
    fn media_behind(
        &self,
        incident: &IncidentRays,
        instance: u32,
        media: &InteriorStack,
        l: usize,
    ) -> InteriorStack {
        if !self.frame.effects().has(Effect::NestedMedia) {
            // Paths keep one interior only
            let after = incident.sides[l].after;
            return after.map_or(InteriorStack::EMPTY, InteriorStack::of);
        }
        let from_outside = incident.surfaces.points.front[l];
        self.frame.crossed_surface(instance, from_outside).through(media)
    }

    /// Sets the indices of refraction of the lanes that split wavelengths to those of wavelength `number`.
    fn set_indices(&self, incident: &mut IncidentRays, number: usize) {
        let frame = self.frame;
        let color = frame.spectrum.weights()[number];
        for l in 0..LANES {
            let sides = &incident.sides[l];
            let Some(offset) = sides.split else {
                // Other lanes send one ray only
                incident.indices.is_used[l] &= number == 0;
                continue;
            };
            let wavelength = frame.spectrum.wavelength(number, offset);
            incident.indices.wavelength[l] = wavelength as f32;
            (0..3).for_each(|c| incident.indices.color[c][l] = color[c]);
            incident.indices.eta_i[l] = frame.ior(sides.before, wavelength);
            incident.indices.eta_t[l] = frame.ior(sides.after, wavelength);
        }
    }

    /// Queues the refracted rays of lane `l`, one per wavelength, and its reflected ray, the last of `rays`.
    #[inline(always)]
    fn send_scattered(
        &mut self,
        traced: &TracedPacket,
        arrival: &PathState,
        (through, rays): (&InteriorStack, &[BoundaryRays]),
        l: usize,
    ) {
        let Some((reflected, refracted)) = rays.split_last() else {
            return;
        };
        let has_caustics = self.frame.effects().has(Effect::Caustics);
        let mut sent = RayWorkItem {
            ray: traced.packet.ray(l),
            pixel: traced.pixel[l],
            weight: [0.0; 3],
            sender: Category::Refraction,
            travel: Some(PathState {
                depth: arrival.depth + 1,
                bent: true,
                media: *through,
                density: arrival.density_behind_boundary(),
                ..*arrival
            }),
        };
        // Queue the refracted rays
        for rays in refracted.iter().filter(|rays| rays.is_sent[l]) {
            rays.write(l, &mut sent);
            if let Some(travel) = &mut sent.travel {
                travel.wavelength = rays.wavelength[l];
            }
            self.send::<false>(&mut sent, 0);
        }
        // Queue the reflected ray
        if reflected.is_sent[l] {
            sent.sender = Category::Reflection;
            reflected.write(l, &mut sent);
            if let Some(travel) = &mut sent.travel {
                travel.wavelength = arrival.wavelength;
                travel.media = arrival.media;
                travel.density = arrival.density_behind_mirror(has_caustics);
            }
            self.send::<false>(&mut sent, 0);
        }
    }
}

/// Computes the refracted rays of one wavelength, and adds the weights of the reflected ones.
///
/// Lanes whose rays would not leave behind the surface are left to the functions for one ray.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn refract_lanes(incident: &mut IncidentRays, rays: &mut BoundaryRays) {
    let surfaces = incident.surfaces;
    let Surfaces {
        points, materials, ..
    } = surfaces;
    let IncidentRays {
        indices, interfaces, ..
    } = incident;
    dielectric_lanes(
        &incident.direction,
        &incident.normal,
        &indices.eta_i,
        &indices.eta_t,
        interfaces,
    );
    // Refract the rays
    let (mut cos_i, mut cos_t) = ([0.0; LANES], [0.0; LANES]);
    for l in 0..LANES {
        let (d, n) = (vector(&incident.direction, l), vector(&incident.normal, l));
        // Equal indices do not change the direction
        let is_straight = indices.eta_i[l] == indices.eta_t[l];
        let bent = vector(&interfaces.refracted, l);
        let direction = DVec3::new(
            if is_straight { d.x } else { bent.x },
            if is_straight { d.y } else { bent.y },
            if is_straight { d.z } else { bent.z },
        );
        for axis in 0..3 {
            rays.direction[axis][l] = direction[axis];
        }
        let cosine = -d.dot(n);
        let refracts = is_straight | !interfaces.total[l];
        let leaves = is_straight | (direction.dot(lane(&points.ng, l).as_dvec3()) < 0.0);
        incident.is_left[l] |= indices.is_used[l] & (!(cosine > 0.0) | (refracts & !leaves));
        rays.is_sent[l] = indices.is_used[l] & refracts;
        (cos_i[l], cos_t[l]) = (cosine.clamp(0.0, 1.0), direction.dot(n).abs());
    }
    // Refract their cones, in a loop of its own that becomes one over vectors
    for l in 0..LANES {
        let eta = indices.eta_t[l] / indices.eta_i[l];
        let cone = incident.cone[l].refracted(eta, [cos_i[l], cos_t[l]], surfaces.curvatures[l]);
        rays.cone[l] = cone.spread_by(0.0);
    }
    // Divide the throughput by Fresnel's equations
    for l in 0..LANES {
        let tints = Tints::in_lane(materials, &incident.applies_fresnel, l);
        let (mirrored, through) = tints.weights(interfaces.reflectance[l], interfaces.transmittance[l]);
        for c in 0..3 {
            let color = indices.color[c][l];
            let sum = incident.mirrored[c][l] + color * mirrored[c];
            let is_used = indices.is_used[l];
            incident.mirrored[c][l] = if is_used { sum } else { incident.mirrored[c][l] };
            rays.weight[c][l] = incident.weight[c][l] * color * through[c];
        }
    }
    rays.wavelength = indices.wavelength;
    spawn(points, rays);
}

/// Computes the reflected rays, with the weights that have been added up.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn reflect_lanes(incident: &IncidentRays, rays: &mut BoundaryRays) {
    let Surfaces {
        points, materials, ..
    } = incident.surfaces;
    let reflects = materials.effects.has(Effect::Reflection);
    for l in 0..LANES {
        let (d, n) = (vector(&incident.direction, l), vector(&incident.normal, l));
        let side = lane(&points.ng, l).as_dvec3();
        let (mirrored, at_side) = (reflect(d, n), reflect(d, side));
        // Take the geometric normal if the ray would enter the surface
        let leaves = mirrored.dot(side) > 0.0;
        for axis in 0..3 {
            rays.direction[axis][l] = if leaves { mirrored[axis] } else { at_side[axis] };
        }
        let cone = incident.cone[l].reflected(incident.surfaces.curvatures[l]);
        rays.cone[l] = cone.spread_by(0.0);
    }
    for l in 0..LANES {
        let is_smooth = materials.extended.is_phong[l] | (materials.roughness[l] <= MIRROR_ROUGHNESS);
        rays.is_sent[l] = is_smooth & reflects;
        for c in 0..3 {
            rays.weight[c][l] = incident.weight[c][l] * incident.mirrored[c][l];
        }
    }
    spawn(points, rays);
}

/// Sets the origins of rays that leave surfaces, each on the side of its direction.
#[inline(always)]
fn spawn(points: &SurfacePacket, rays: &mut BoundaryRays) {
    let mut sides = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let ng = lane(&points.ng, l).as_dvec3();
        let is_behind = vector(&rays.direction, l).dot(ng) < 0.0;
        for axis in 0..3 {
            sides[axis][l] = if is_behind { -ng[axis] } else { ng[axis] };
        }
    }
    // Use a fixed offset if the spawn policy has one
    if let Some(offset) = points.offset {
        for l in 0..LANES {
            let origin = offset_point(vector(&points.p, l), vector(&sides, l), offset);
            (0..3).for_each(|axis| rays.origin[axis][l] = origin[axis]);
        }
        return;
    }
    for l in 0..LANES {
        let origin = spawn_point(vector(&points.p, l), vector(&sides, l), points.error[l]);
        (0..3).for_each(|axis| rays.origin[axis][l] = origin[axis]);
    }
}

/// Returns lane `l` of vectors in structure-of-arrays form.
#[inline(always)]
fn vector(v: &Lanes3<f64>, l: usize) -> DVec3 {
    DVec3::new(v[0][l], v[1][l], v[2][l])
}

#[cfg(test)]
mod tests {
    use super::super::dielectric::SmoothInterface;
    use super::*;
    use crate::numeric::SplitMix64;
    use crate::optics::dielectric;
    use crate::scene::EffectSet;

    /// Cosines of incidence of the lanes: along the normal, at angles, grazing.
    const COSINES: [f64; 4] = [1.0, 0.8, 0.3, 1e-9];
    /// Indices of refraction of the lanes: into glass, out of it, within it.
    const ETAS: [[f64; 2]; 3] = [[1.0, 1.5], [1.5, 1.0], [1.5, 1.5]];

    /// Returns random surfaces of glass, of which one holds no numbers, and the normals by which they refract.
    fn random_surfaces(random: &mut SplitMix64) -> (Surfaces, Lanes<DVec3>) {
        let mut surfaces = Surfaces::new(EffectSet::NONE.with(Effect::Refraction).with(Effect::Reflection));
        let mut normals = [DVec3::Z; LANES];
        for l in 0..LANES {
            let ng = random.direction().as_vec3().normalize();
            // Every third normal is interpolated and far from that of the surface
            let tilt = if l % 3 == 0 { random.unit() } else { 0.0 };
            normals[l] = (ng.as_dvec3() + tilt * random.direction()).normalize();
            surfaces.curvatures[l] = random.within(-1.0, 1.0);
            surfaces.points.error[l] = random.within(0.0, 1e-6);
            surfaces.materials.roughness[l] = 0.0;
            surfaces.materials.extended.is_phong[l] = random.unit() < 0.5;
            for axis in 0..3 {
                surfaces.points.ng[axis][l] = ng[axis];
                surfaces.points.p[axis][l] = random.within(-2.0, 2.0);
                surfaces.materials.base_color[axis][l] = random.unit() as f32;
                surfaces.materials.extended.transmission[axis][l] = random.unit() as f32;
                surfaces.materials.extended.reflection[axis][l] = random.unit() as f32;
            }
        }
        surfaces.points.p[0][LANES - 1] = f64::NAN;
        (surfaces, normals)
    }

    /// Compares lane `l` of `rays` with the ray that one function at a time computes.
    fn assert_ray(incident: &IncidentRays, rays: &BoundaryRays, l: usize, direction: DVec3, share: [f32; 3]) {
        let points = &incident.surfaces.points;
        assert_eq!(vector(&rays.direction, l), direction);
        assert_eq!(
            [0, 1, 2].map(|c| rays.weight[c][l]),
            [0, 1, 2].map(|c| incident.weight[c][l] * share[c])
        );
        let ng = points.geometric_normal(l);
        let side = if direction.dot(ng) < 0.0 { -ng } else { ng };
        assert_eq!(lane(&rays.origin, l), points.leave(l, side));
    }

    #[test]
    fn every_lane_has_the_bits_of_the_functions_for_one_ray() {
        let mut random = SplitMix64::new(11, 0);
        let (mut left, mut total) = (0, 0);
        for case in 0..2000 {
            let (surfaces, normals) = random_surfaces(&mut random);
            let weight = [0, 1, 2].map(|_| std::array::from_fn(|_| random.within(-1.0, 1.0) as f32));
            let mut incident = IncidentRays::new(&surfaces, &weight);
            // The last lane sends no ray
            for l in 0..LANES - 1 {
                let cosine = COSINES[random.below(COSINES.len())];
                let n = normals[l];
                let along = (1.0 - cosine * cosine).sqrt() * n.any_orthonormal_vector();
                let d = (along - cosine * n).normalize();
                (0..3).for_each(|axis| incident.direction[axis][l] = d[axis]);
                (0..3).for_each(|axis| incident.normal[axis][l] = n[axis]);
                [incident.indices.eta_i[l], incident.indices.eta_t[l]] = ETAS[random.below(ETAS.len())];
                incident.applies_fresnel[l] = random.unit() < 0.8;
                incident.indices.is_used[l] = true;
                let [width, spread] = [random.unit(), random.unit()];
                incident.cone[l] = RayCone { width, spread };
            }
            let (mut refracted, mut reflected) = (BoundaryRays::NONE, BoundaryRays::NONE);
            refract_lanes(&mut incident, &mut refracted);
            reflect_lanes(&incident, &mut reflected);
            assert!(!refracted.is_sent[LANES - 1] && !incident.is_left[LANES - 1]);
            for l in (0..LANES - 1).filter(|&l| !incident.is_left[l]) {
                let bend = SmoothInterface {
                    d: vector(&incident.direction, l),
                    n: normals[l],
                    side: surfaces.points.geometric_normal(l),
                };
                let etas = [incident.indices.eta_i[l], incident.indices.eta_t[l]];
                let fresnel = dielectric(bend.cos_i(), etas[0], etas[1]);
                let tints = Tints::in_lane(&surfaces.materials, &incident.applies_fresnel, l);
                let (mirrored, through) =
                    tints.weights(fresnel.reflectance.mean(), fresnel.transmittance.mean());
                let cone = incident.cone[l];
                assert_ray(&incident, &reflected, l, bend.reflected(), mirrored);
                assert_eq!(reflected.cone[l], cone.reflected(surfaces.curvatures[l]));
                let Some(direction) = bend.refracted_into_solid(etas) else {
                    assert!(!refracted.is_sent[l], "case {case}");
                    total += 1;
                    continue;
                };
                assert!(refracted.is_sent[l], "case {case}");
                assert_ray(&incident, &refracted, l, direction, through);
                let cosines = [bend.cos_i(), direction.dot(bend.n).abs()];
                let expected = cone.refracted(etas[1] / etas[0], cosines, surfaces.curvatures[l]);
                assert_eq!(refracted.cone[l], expected, "case {case}");
            }
            left += incident.is_left.iter().filter(|&&is_left| is_left).count();
        }
        // Both kinds are among the cases, and hardly any lane is left to the functions for one ray
        assert!(total > 1000 && (1..2000).contains(&left), "{total} {left}");
    }
}
