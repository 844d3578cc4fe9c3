//! Naive implementations with well-known numerical defects, which the suite of hard cases must detect.
//!
//! Every formula is the textbook's, in f32 where a renderer might use it, with commonly copied fixed epsilons.

#![allow(unreachable_pub, reason = "a module of a test")]

use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DVec3, Vec3};
use whit::accel::{Accel, AccelReport, Coherence, Hit, LANES, RayPacket};
use whit::numeric::Ray;
use whit::optics::{Fresnel, Polarised, Refraction};
use whit::render::{Cancelled, Monitor, RenderSettings, Rendering};
use whit::scene::{Camera, Geometry, Scene};
use whit::shape::{Implicit, Shape, ShapeRay};
use whit::verify::Formulas;

/// Textbook formulas without numerical safeguards.
pub const FORMULAS: Formulas = Formulas {
    dielectric,
    refract,
    corrected_opacity: |alpha, ratio| 1.0 - (1.0 - alpha).powf(ratio),
    transmittance: |layer, count| {
        let share = 1.0 - (1.0 - (-layer as f32).exp());
        (0..count).fold(1.0, |left: f32, _| left * share).into()
    },
    march: |sigma, length, step| {
        let (mut t, mut seen, mut left) = (0.0f32, 0.0f32, 1.0f32);
        while t < length as f32 {
            let alpha = (sigma * step) as f32;
            seen += left * alpha;
            left *= 1.0 - alpha;
            t += step as f32;
        }
        [seen.into(), left.into()]
    },
    pixel_sum: |packet, count| {
        let samples = (0..count).flat_map(packet);
        samples.fold(0.0, |sum: f32, sample| sum + sample).into()
    },
    is_invertible: |map| map.matrix3.determinant().abs() > 1e-12,
    spawn_point: |p, _, _| p.as_vec3(),
    validate: |_| Ok(()),
    normalise: |_| (),
    render: careless_render,
};

/// Renders an image without interior priorities and truncates paths after three bounces, without a report.
fn careless_render(
    scene: &Scene,
    camera: &Camera,
    accel: &dyn Accel,
    settings: &RenderSettings,
    monitor: &Monitor,
) -> Result<Rendering, Cancelled> {
    let mut scene = scene.clone();
    for material in &mut scene.materials {
        if let Some(inside) = &mut material.interior {
            inside.priority = 0;
        }
    }
    let settings = RenderSettings {
        depth: settings.depth.min(3),
        ..*settings
    };
    let mut rendering = whit::render::render(scene.validate().unwrap(), camera, accel, &settings, monitor)?;
    rendering.ledger.max_lost_weight = 0.0;
    Ok(rendering)
}

/// Formulas with refraction in f32.
pub const SINGLE: Formulas = Formulas {
    refract: |d, n, eta_i, eta_t| {
        let [d, n] = [d, n].map(|v| v.as_vec3().as_dvec3());
        refract(d, n, f64::from(eta_i as f32), f64::from(eta_t as f32))
    },
    ..Formulas::RENDERER
};

/// Formulas that spawn rays at a fixed distance off the surface.
pub const FIXED_EPSILON: Formulas = Formulas {
    spawn_point: |p, ng, _| (p + 1e-4 * ng).as_vec3(),
    ..Formulas::RENDERER
};

/// Evaluates Fresnel's equations through sin_t, with the transmittance as one minus the reflectance.
fn dielectric(cos_i: f64, eta_i: f64, eta_t: f64) -> Fresnel {
    let sin_t = eta_i / eta_t * (1.0 - cos_i * cos_i).sqrt();
    let cos_t = (1.0 - sin_t * sin_t).max(0.0).sqrt();
    let square = |a: f64, b: f64| ((a - b) / (a + b)) * ((a - b) / (a + b));
    let reflectance = Polarised {
        s: square(eta_i * cos_i, eta_t * cos_t),
        p: square(eta_t * cos_i, eta_i * cos_t),
    };
    Fresnel {
        reflectance,
        transmittance: Polarised {
            s: 1.0 - reflectance.s,
            p: 1.0 - reflectance.p,
        },
        cos_t,
    }
}

fn refract(d: DVec3, n: DVec3, eta_i: f64, eta_t: f64) -> Option<Refraction> {
    let cos_i = -d.dot(n);
    let ratio = eta_i / eta_t;
    let square = 1.0 - ratio * ratio * (1.0 - cos_i * cos_i);
    (square > 0.0).then(|| Refraction {
        direction: ratio * d + (ratio * cos_i - square.sqrt()) * n,
        cos_t: square.sqrt(),
    })
}

/// Brute-force loop in f32 that does not validate its rays.
pub struct NaiveAccel<'s> {
    scene: &'s Scene,
    /// Relative enlargement of triangles, to close cracks.
    fat: f32,
}

/// Determinants below this are treated as zero.
const EPSILON: f32 = 1e-8;

impl<'s> NaiveAccel<'s> {
    pub fn new(scene: &'s Scene) -> NaiveAccel<'s> {
        NaiveAccel { scene, fat: 0.0 }
    }

    /// Creates a loop that enlarges each triangle by a fraction of its size.
    pub fn fat(scene: &'s Scene) -> NaiveAccel<'s> {
        NaiveAccel { scene, fat: 0.05 }
    }

    fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        for (index, instance) in self.scene.instances.iter().enumerate() {
            // Transform the ray to object space in f64, then round to f32
            let map = instance.object_from_world();
            let o = map.transform_point3(ray.origin.as_dvec3()).as_vec3();
            let d = map.transform_vector3(ray.direction.as_dvec3()).as_vec3();
            // Keep the nearest hit; later ones win ties
            let mut keep = |primitive: u32, t: f32| {
                if best.is_none_or(|best| t <= best.t) {
                    best = Some(Hit {
                        instance: index as u32,
                        primitive,
                        t,
                        u: 0.0,
                        v: 0.0,
                    });
                }
            };
            // Intersect the geometry
            match &self.scene.geometries[instance.geometry as usize] {
                Geometry::Mesh(mesh) => {
                    for primitive in 0..mesh.triangles.len() as u32 {
                        let corners = mesh.corners(primitive);
                        if !is_in_reach(corners, o, d) {
                            continue;
                        }
                        if let Some(t) = triangle(corners, o, d, self.fat) {
                            keep(primitive, t);
                        }
                    }
                }
                Geometry::Points(cloud) => {
                    for (point, &center) in (0..).zip(&cloud.positions[..]) {
                        if let Some(t) = sphere_root(center.into(), cloud.radius as f32, o, d) {
                            keep(point, t);
                        }
                    }
                }
                Geometry::Shape(Shape::Sphere(sphere)) => {
                    if let Some(t) = sphere_root(sphere.center.as_vec3(), sphere.radius as f32, o, d) {
                        keep(0, t);
                    }
                }
                Geometry::Shape(Shape::Cube) => {
                    if let Some(t) = cube(o, d) {
                        keep(0, t);
                    }
                }
                Geometry::Shape(shape) => {
                    // Normalise the direction in f32.
                    let unit = d.normalize();
                    let ray = ShapeRay::new(o.as_dvec3(), unit.as_dvec3());
                    if let Some(hit) = shape.intersect(&ray) {
                        keep(hit.part, hit.t as f32 / d.length());
                    }
                }
            }
        }
        best
    }
}

/// Tests the box around a triangle by the slab test, with the origin multiplied by the reciprocal direction once for
/// all boxes.
fn is_in_reach([a, b, c]: [Vec3; 3], o: Vec3, d: Vec3) -> bool {
    let inverse = d.recip();
    let start = o * inverse;
    let (low, high) = (
        a.min(b).min(c) * inverse - start,
        a.max(b).max(c) * inverse - start,
    );
    low.min(high).max_element() <= low.max(high).min_element()
}

/// Intersects by Möller and Trumbore's test with edges excluded on both sides.
fn triangle([a, b, c]: [Vec3; 3], o: Vec3, d: Vec3, fat: f32) -> Option<f32> {
    let (e1, e2) = (b - a, c - a);
    let p = d.cross(e2);
    let det = e1.dot(p);
    if det.abs() < EPSILON {
        return None;
    }
    let s = o - a;
    let u = s.dot(p) / det;
    let q = s.cross(e1);
    let v = d.dot(q) / det;
    let t = e2.dot(q) / det;
    (u > -fat && v > -fat && u + v < 1.0 + fat && t > 0.0).then_some(t)
}

/// Solves the sphere's quadratic with the discriminant b² - 4ac.
fn sphere_root(center: Vec3, radius: f32, o: Vec3, d: Vec3) -> Option<f32> {
    let f = o - center;
    let (a, b, c) = (d.dot(d), 2.0 * f.dot(d), f.dot(f) - radius * radius);
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return None;
    }
    let root = discriminant.sqrt();
    let near = (-b - root) / (2.0 * a);
    let far = (-b + root) / (2.0 * a);
    [near, far].into_iter().find(|&t| t > EPSILON)
}

/// Intersects a cube by reciprocal slabs, with 0 · ∞ unhandled.
fn cube(o: Vec3, d: Vec3) -> Option<f32> {
    let (mut near, mut far) = (f32::NEG_INFINITY, f32::INFINITY);
    for axis in 0..3 {
        let inverse = 1.0 / d[axis];
        let (a, b) = ((-1.0 - o[axis]) * inverse, (1.0 - o[axis]) * inverse);
        near = near.max(if d[axis] < 0.0 { b } else { a });
        far = far.min(if d[axis] < 0.0 { a } else { b });
    }
    if near > far || far < 0.0 {
        return None;
    }
    Some(if near >= 0.0 { near } else { far })
}

/// Backend whose results depend on the number of earlier queries.
pub struct FickleAccel<'s>(pub NaiveAccel<'s>);

/// Number of packets queried so far.
static QUERY_COUNT: AtomicU32 = AtomicU32::new(0);

impl Accel for FickleAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
        self.0.intersect(packets, order);
        for packet in packets {
            // Drop every fifth packet's hits.
            if QUERY_COUNT.fetch_add(1, Ordering::Relaxed).is_multiple_of(5) {
                (0..LANES).for_each(|lane| packet.clear_hit(lane));
            }
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
        self.0.occluded(packets, order);
    }

    fn report(&self) -> AccelReport {
        self.0.report()
    }
}

impl Accel for NaiveAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], _: Coherence) {
        for packet in packets {
            for lane in 0..LANES {
                if packet.is_active(lane)
                    && let Some(hit) = self.nearest(&packet.ray(lane))
                {
                    packet.set_hit(lane, &hit);
                }
            }
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], _: Coherence) {
        for packet in packets {
            for lane in 0..LANES {
                if packet.is_active(lane) && self.nearest(&packet.ray(lane)).is_some() {
                    packet.set_blocked(lane);
                }
            }
        }
    }

    fn report(&self) -> AccelReport {
        AccelReport::default()
    }
}
