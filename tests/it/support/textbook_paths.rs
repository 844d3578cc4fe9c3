//! Reference path tracer of diffuse light, as plainly as in the literature, in f64 over brute force.
//!
//! L = emission + Σ over visible point lights (albedo / π) I cos / d² + the mean over directions of 2 cos · albedo · L
//! (J. Kajiya, "The Rendering Equation", SIGGRAPH 1986). Directions are uniform over the hemisphere, paths end after a
//! fixed number of bounces, and emission counts only where a path hits it: there is no importance sampling, no
//! roulette and no sampling of area lights. Mirrors reflect by Schlick's formula. All surfaces have two sides.
//!
//! It shares no code with the renderer.

use std::f64::consts::{FRAC_1_PI, TAU};

use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Shape of an object, in world space.
#[derive(Clone, Copy, Debug)]
pub enum Primitive {
    Sphere {
        center: DVec3,
        radius: f64,
    },
    /// A rectangle whose half edges are at right angles.
    Rectangle {
        center: DVec3,
        half_u: DVec3,
        half_v: DVec3,
    },
    /// A plane without bounds, with a unit normal.
    Plane {
        point: DVec3,
        normal: DVec3,
    },
}

/// Reflection of an object, with linear RGB values.
#[derive(Clone, Copy, Debug)]
pub enum Reflection {
    /// Lambert's law with this albedo.
    Diffuse(DVec3),
    /// A smooth metal with this reflectance at normal incidence.
    Mirror(DVec3),
}

/// Object of a scene of the reference path tracer.
#[derive(Clone, Copy, Debug)]
pub struct PathObject {
    pub primitive: Primitive,
    pub reflection: Reflection,
    /// Emitted radiance of both sides.
    pub emission: DVec3,
    /// True if every diffuse surface has direct light of this object, also the last one of a path.
    pub is_area_light: bool,
}

/// Point light with the inverse-square law.
#[derive(Clone, Copy, Debug)]
pub struct PointSource {
    pub position: DVec3,
    pub intensity: DVec3,
}

/// Scene of the reference path tracer.
#[derive(Clone, Debug)]
pub struct PathScene {
    pub objects: Vec<PathObject>,
    pub point_lights: Vec<PointSource>,
    /// Radiance of rays that miss all objects.
    pub sky: DVec3,
    /// Largest number of diffuse reflections before the last hit of a path.
    pub bounces: u32,
    /// Largest number of mirror reflections of a path.
    pub mirror_steps: u32,
}

/// Pinhole camera with a square image.
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    pub eye: DVec3,
    /// Unit axes of the image: to the right, up and into the image.
    pub axes: [DVec3; 3],
    /// Half the edge of the window at the distance 1.
    pub half_size: f64,
}

/// Mean radiance of an image region, with its standard error per channel.
#[derive(Clone, Copy, Debug)]
pub struct RegionEstimate {
    pub mean: DVec3,
    pub error: DVec3,
}

/// Random numbers of one batch of paths: SplitMix64 (G. Steele et al., "Fast Splittable Pseudorandom Number
/// Generators", 2014).
pub struct PathRandom(u64);

/// Ray with a unit direction.
#[derive(Clone, Copy)]
struct PathRay {
    origin: DVec3,
    direction: DVec3,
    /// Object that the ray starts on, whose intersection at the origin does not count.
    leaves: Option<usize>,
}

/// Numbers of reflections that a path may still have.
#[derive(Clone, Copy)]
struct Remaining {
    bounces: u32,
    mirror_steps: u32,
}

/// Returns an object that reflects by Lambert's law.
pub fn diffuse(primitive: Primitive, albedo: [f64; 3]) -> PathObject {
    PathObject {
        primitive,
        reflection: Reflection::Diffuse(albedo.into()),
        emission: DVec3::ZERO,
        is_area_light: false,
    }
}

/// Returns a diffuse object with emission.
pub fn emissive(primitive: Primitive, albedo: [f64; 3], emission: [f64; 3]) -> PathObject {
    PathObject {
        emission: emission.into(),
        ..diffuse(primitive, albedo)
    }
}

/// Returns an emissive object that is an area light.
pub fn area_light(primitive: Primitive, albedo: [f64; 3], emission: [f64; 3]) -> PathObject {
    PathObject {
        is_area_light: true,
        ..emissive(primitive, albedo, emission)
    }
}

/// Returns a smooth metal with the reflectance `f0` at normal incidence.
pub fn mirror(primitive: Primitive, f0: [f64; 3]) -> PathObject {
    PathObject {
        reflection: Reflection::Mirror(f0.into()),
        ..diffuse(primitive, [0.0; 3])
    }
}

/// Returns a sphere as a primitive.
pub fn sphere(center: [f64; 3], radius: f64) -> Primitive {
    Primitive::Sphere {
        center: center.into(),
        radius,
    }
}

/// Returns a rectangle with these half edges.
pub fn rectangle(center: [f64; 3], half_u: DVec3, half_v: DVec3) -> Primitive {
    Primitive::Rectangle {
        center: center.into(),
        half_u,
        half_v,
    }
}

/// Returns the inner side of the box between `low` and `high` with the albedos of its faces: at small and large x, y
/// and z, in this order.
pub fn closed_box(low: DVec3, high: DVec3, albedos: [[f64; 3]; 6]) -> Vec<PathObject> {
    let (center, half) = (0.5 * (low + high), 0.5 * (high - low));
    let face = |index: usize| {
        let axis = index / 2;
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        let mut place = center;
        place[axis] = if index.is_multiple_of(2) {
            low[axis]
        } else {
            high[axis]
        };
        let face = rectangle(place.into(), half[u] * DVec3::AXES[u], half[v] * DVec3::AXES[v]);
        diffuse(face, albedos[index])
    };
    (0..6).map(face).collect()
}

impl PathRandom {
    /// Returns the generator of stream `stream`; streams are far apart.
    pub fn stream(stream: u64) -> PathRandom {
        PathRandom(mixed(stream.wrapping_add(1)))
    }

    /// Returns a number in [0, 1).
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        (mixed(self.0) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a unit vector of the hemisphere around `normal`, uniformly distributed, and its cosine.
    fn on_hemisphere(&mut self, normal: DVec3) -> (DVec3, f64) {
        // By Archimedes, heights on a sphere are uniform
        let z = 2.0 * self.next() - 1.0;
        let (sin, cos) = (TAU * self.next()).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        let direction = DVec3::new(radius * cos, radius * sin, z);
        let cosine = direction.dot(normal);
        (direction * cosine.signum(), cosine.abs())
    }
}

/// Mixes all bits of `state`, as SplitMix64 does.
fn mixed(state: u64) -> u64 {
    let state = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let state = (state ^ (state >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    state ^ (state >> 31)
}

impl Primitive {
    /// Returns the distance to the nearest intersection in front of the ray's origin, which lies on the primitive if
    /// `is_origin`.
    fn distance(&self, ray: &PathRay, is_origin: bool) -> Option<f64> {
        let (o, d) = (ray.origin, ray.direction);
        let t = match *self {
            Primitive::Sphere { center, radius } => {
                let (along, from) = ((center - o).dot(d), o - center);
                if is_origin {
                    // The other root: the product of both is 0
                    2.0 * along
                } else {
                    let half = (along * along - from.length_squared() + radius * radius).sqrt();
                    if along > half { along - half } else { along + half }
                }
            }
            _ if is_origin => return None,
            Primitive::Rectangle {
                center,
                half_u,
                half_v,
            } => {
                let normal = half_u.cross(half_v);
                let t = (center - o).dot(normal) / d.dot(normal);
                let p = o + t * d - center;
                let is_within = |half: DVec3| p.dot(half).abs() <= half.length_squared();
                if is_within(half_u) && is_within(half_v) {
                    t
                } else {
                    return None;
                }
            }
            Primitive::Plane { point, normal } => (point - o).dot(normal) / d.dot(normal),
        };
        // A root of a negative number and a division of 0 by 0 are NaN
        (t > 0.0 && t.is_finite()).then_some(t)
    }

    /// Returns a unit normal at `p`, on either side.
    fn normal(&self, p: DVec3) -> DVec3 {
        match *self {
            Primitive::Sphere { center, .. } => (p - center).normalize(),
            Primitive::Rectangle { half_u, half_v, .. } => half_u.cross(half_v).normalize(),
            Primitive::Plane { normal, .. } => normal,
        }
    }
}

impl Pinhole {
    /// Returns a camera at `eye` that looks at `target`, with +y upwards in the image.
    pub fn look_at(eye: DVec3, target: DVec3, half_size: f64) -> Pinhole {
        let forward = (target - eye).normalize();
        let right = forward.cross(DVec3::Y).normalize();
        Pinhole {
            eye,
            axes: [right, right.cross(forward), forward],
            half_size,
        }
    }

    /// Returns the ray through the image point `film`, in [0, 1]² from the top left corner.
    fn ray(&self, film: DVec2) -> PathRay {
        let [right, up, forward] = self.axes;
        let [x, y] = [2.0 * film.x - 1.0, 1.0 - 2.0 * film.y].map(|place| place * self.half_size);
        PathRay {
            origin: self.eye,
            direction: (forward + x * right + y * up).normalize(),
            leaves: None,
        }
    }
}

impl PathScene {
    /// Returns the estimates of `grid` by `grid` regions of the image, row by row from the top, from independent
    /// batches of paths.
    pub fn region_estimates(
        &self,
        camera: &Pinhole,
        grid: u32,
        batches: u32,
        paths: u32,
    ) -> Vec<RegionEstimate> {
        let mean_of_batch = |region: u32, batch: u32| {
            let mut random = PathRandom::stream(u64::from(region) << 32 | u64::from(batch));
            let sum: DVec3 = (0..paths)
                .map(|_| {
                    let within = DVec2::new(random.next(), random.next());
                    let corner = DVec2::new(f64::from(region % grid), f64::from(region / grid));
                    let ray = camera.ray((corner + within) / f64::from(grid));
                    self.radiance(&ray, self.whole_path(), &mut random)
                })
                .sum();
            sum / f64::from(paths)
        };
        (0..grid * grid)
            .into_par_iter()
            .map(|region| {
                let batches = (0..batches).into_par_iter();
                let means: Vec<DVec3> = batches.map(|batch| mean_of_batch(region, batch)).collect();
                RegionEstimate::of_batches(&means)
            })
            .collect()
    }

    /// Returns an estimate of the radiance at `eye` from `direction`, from `paths` paths.
    pub fn ray_estimate(&self, eye: DVec3, direction: DVec3, paths: u32) -> RegionEstimate {
        let ray = PathRay {
            origin: eye,
            direction: direction.normalize(),
            leaves: None,
        };
        let mut random = PathRandom::stream(0);
        let values: Vec<DVec3> = (0..paths)
            .map(|_| self.radiance(&ray, self.whole_path(), &mut random))
            .collect();
        RegionEstimate::of_batches(&values)
    }

    fn whole_path(&self) -> Remaining {
        Remaining {
            bounces: self.bounces,
            mirror_steps: self.mirror_steps,
        }
    }

    /// Returns an estimate of the radiance along a ray from a single path.
    fn radiance(&self, ray: &PathRay, remaining: Remaining, random: &mut PathRandom) -> DVec3 {
        let Some((hit, t)) = self.nearest(ray) else {
            return self.sky;
        };
        let object = &self.objects[hit];
        let p = ray.origin + t * ray.direction;
        let normal = object.primitive.normal(p);
        let normal = -normal * normal.dot(ray.direction).signum();
        let reflected = match object.reflection {
            Reflection::Mirror(f0) => {
                if remaining.mirror_steps == 0 {
                    return object.emission;
                }
                let cosine = -normal.dot(ray.direction);
                let next = PathRay {
                    origin: p,
                    direction: ray.direction + 2.0 * cosine * normal,
                    leaves: Some(hit),
                };
                let fresnel = f0 + (DVec3::ONE - f0) * (1.0 - cosine).powi(5);
                let remaining = Remaining {
                    mirror_steps: remaining.mirror_steps - 1,
                    ..remaining
                };
                fresnel * self.radiance(&next, remaining, random)
            }
            Reflection::Diffuse(albedo) => {
                let (direction, cosine) = random.on_hemisphere(normal);
                let next = PathRay {
                    origin: p,
                    direction,
                    leaves: Some(hit),
                };
                // The BRDF albedo / π over the density 1 / 2π
                let weight = 2.0 * cosine * albedo;
                let direct = albedo * FRAC_1_PI * self.irradiance(p, normal, hit);
                direct + weight * self.gathered(&next, remaining, random)
            }
        };
        object.emission + reflected
    }

    /// Returns an estimate of the radiance along a ray from a diffuse surface.
    fn gathered(&self, ray: &PathRay, remaining: Remaining, random: &mut PathRandom) -> DVec3 {
        if remaining.bounces > 0 {
            let remaining = Remaining {
                bounces: remaining.bounces - 1,
                ..remaining
            };
            return self.radiance(ray, remaining, random);
        }
        // Only direct light reaches the last surface
        match self.nearest(ray) {
            Some((hit, _)) if self.objects[hit].is_area_light => self.objects[hit].emission,
            _ => DVec3::ZERO,
        }
    }

    /// Returns the irradiance of a surface point by the point lights that it sees.
    fn irradiance(&self, p: DVec3, normal: DVec3, leaves: usize) -> DVec3 {
        let of_light = |light: &PointSource| {
            let distance = (light.position - p).length();
            let direction = (light.position - p) / distance;
            let shadow_ray = PathRay {
                origin: p,
                direction,
                leaves: Some(leaves),
            };
            let cosine = normal.dot(direction);
            let is_lit = cosine > 0.0 && self.nearest(&shadow_ray).is_none_or(|(_, t)| t > distance);
            if is_lit {
                light.intensity * (cosine / (distance * distance))
            } else {
                DVec3::ZERO
            }
        };
        self.point_lights.iter().map(of_light).sum()
    }

    /// Returns the object that the ray hits first, and the distance to it.
    fn nearest(&self, ray: &PathRay) -> Option<(usize, f64)> {
        let hits = self.objects.iter().enumerate().filter_map(|(index, object)| {
            let t = object.primitive.distance(ray, ray.leaves == Some(index))?;
            Some((index, t))
        });
        hits.min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

impl RegionEstimate {
    /// Returns the average of independent estimates.
    pub fn average(estimates: &[RegionEstimate]) -> RegionEstimate {
        let count = estimates.len() as f64;
        let squares = estimates.iter().map(|estimate| estimate.error * estimate.error);
        let error = squares.sum::<DVec3>() / (count * count);
        RegionEstimate {
            mean: estimates.iter().map(|estimate| estimate.mean).sum::<DVec3>() / count,
            error: DVec3::from(error.to_array().map(f64::sqrt)),
        }
    }

    /// Returns the mean of independent values and its standard error.
    pub fn of_batches(values: &[DVec3]) -> RegionEstimate {
        let count = values.len() as f64;
        let mean = values.iter().sum::<DVec3>() / count;
        let squares: DVec3 = values.iter().map(|&value| (value - mean) * (value - mean)).sum();
        let error = squares / (count * (count - 1.0));
        RegionEstimate {
            mean,
            error: DVec3::from(error.to_array().map(f64::sqrt)),
        }
    }
}
