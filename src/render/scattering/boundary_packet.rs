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
use crate::optics::{InteriorStack, LINE_D, NestedInterior, dielectric_lanes, reflect};
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
    cone: Lanes<RayCone>,
    /// True in lanes where Fresnel's equations apply.
    applies_fresnel: Lanes<bool>,
    /// Media on both sides.
    sides: Lanes<BoundarySides>,
    /// Interiors around the rays behind the boundaries.
    through: Lanes<InteriorStack>,
    indices: BoundaryIndices,
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
    origin: Lanes3<f32>,
    weight: Lanes3<f32>,
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
    /// Returns a packet without rays.
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
            through: [InteriorStack::EMPTY; LANES],
            indices: BoundaryIndices {
                wavelength: [0.0; LANES],
                color: [[1.0; LANES]; 3],
                eta_i: [1.0; LANES],
                eta_t: [1.0; LANES],
                is_used: [false; LANES],
            },
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
                self.send_scattered(
                    traced,
                    path_states.lane(l),
                    (&incident.through[l], &rays[..=count]),
                    l,
                );
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
        incident.through[l] = surface.through(&media);
        incident.indices.is_used[l] = true;
        if disperses {
            let offset = self.wavelength_offsets.get(traced.pixel[l] as usize);
            let split = Some(offset.copied().unwrap_or(0.5));
            incident.sides[l] = BoundarySides { before, after, split };
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
        arrival: PathState,
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
                ..arrival
            }),
        };
        // Queue the refracted rays
        for rays in refracted.iter().filter(|rays| rays.is_sent[l]) {
            rays.write(l, &mut sent);
            if let Some(travel) = &mut sent.travel {
                travel.wavelength = rays.wavelength[l];
            }
            self.send::<false>(&sent, 0);
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
            self.send::<false>(&sent, 0);
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
    let indices = &incident.indices;
    let Surfaces {
        points, materials, ..
    } = incident.surfaces;
    let interfaces = dielectric_lanes(
        &incident.direction,
        &incident.normal,
        &indices.eta_i,
        &indices.eta_t,
    );
    // Refract the rays and their cones
    for l in 0..LANES {
        let (d, n) = (vector(&incident.direction, l), vector(&incident.normal, l));
        let (eta_i, eta_t) = (indices.eta_i[l], indices.eta_t[l]);
        // Equal indices do not change the direction
        let is_straight = eta_i == eta_t;
        let mut direction = [0.0; 3];
        for axis in 0..3 {
            let bent = interfaces.refracted[axis][l];
            direction[axis] = if is_straight {
                incident.direction[axis][l]
            } else {
                bent
            };
            rays.direction[axis][l] = direction[axis];
        }
        let direction = DVec3::from_array(direction);
        let cos_i = -d.dot(n);
        let refracts = is_straight | !interfaces.total[l];
        let leaves = is_straight | (direction.dot(lane(&points.ng, l).as_dvec3()) < 0.0);
        incident.is_left[l] |= indices.is_used[l] & (!(cos_i > 0.0) | (refracts & !leaves));
        rays.is_sent[l] = indices.is_used[l] & refracts;
        let cosines = [cos_i.clamp(0.0, 1.0), direction.dot(n).abs()];
        let cone = incident.cone[l].refracted(eta_t / eta_i, cosines, incident.surfaces.curvatures[l]);
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
