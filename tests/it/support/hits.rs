//! Brute-force ray queries of the reference tracer, with the certainty of each result.
//!
//! Only the plain data of `whit` is used. Every result has a signed slack: the distance to the nearest other result in
//! units of the error that an f32 computation may have there. Below 1 another program may legitimately return another
//! result, and the tracer records a [`Doubt`].

use glam::{DAffine3, DMat3, DVec3, Vec3};
use whit::mesh::Mesh;
use whit::scene::{Geometry, Scene};
use whit::shape::Shape;

use super::approx::{Approx, Approx3, ROUNDING};
use super::cones::Cone;
use super::shapes::{self, Face};

/// Decisions at which an image may be discontinuous.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Decision {
    /// No decision was taken yet.
    Nothing,
    /// Nearest primitive of a camera or reflected ray: near an edge, or two at equal depth.
    Nearest,
    /// Occlusion of a shadow ray.
    Shadow,
    /// Side to which a normal points.
    Facing,
    /// Light or reflected ray above the horizon of the triangle.
    Horizon,
    /// Index of the texel that is read.
    Texel,
    /// Roughness threshold of mirror reflection.
    Mirror,
    /// Total internal reflection at a boundary.
    TotalReflection,
    /// Alpha test of a masked surface.
    Coverage,
    /// Cut-off of a path by its throughput.
    Cutoff,
    /// No discontinuity, but a value too badly conditioned for any bound.
    Value,
}

/// Least certain decision so far.
#[derive(Clone, Copy, Debug)]
pub struct Doubt {
    /// Distance to the nearest flip in units of the error bound; a flip is possible below 1.
    pub slack: f64,
    /// Decision that would flip.
    pub decision: Decision,
}

impl Doubt {
    pub const NONE: Doubt = Doubt {
        slack: f64::INFINITY,
        decision: Decision::Nothing,
    };

    /// Records a decision that depends on the sign of a number with this slack.
    pub fn note(&mut self, decision: Decision, slack: f64) {
        if slack.abs() < self.slack {
            *self = Doubt {
                slack: slack.abs(),
                decision,
            };
        }
    }

    /// Returns whether an f32 computation may have decided otherwise.
    pub fn may_flip(&self) -> bool {
        self.slack < 1.0
    }
}

/// Ray segment in world space.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: Approx3,
    pub direction: Approx3,
    pub t_near: Approx,
    pub t_far: f64,
    /// Surface that the ray starts on, which it cannot intersect at its origin.
    pub leaves: Option<Left>,
    /// Ray cone at the origin, for texture filtering.
    pub cone: Cone,
}

/// Surface on which a ray starts.
#[derive(Clone, Copy, Debug)]
pub struct Left {
    pub instance: u32,
    pub primitive: u32,
    /// True if the ray starts elsewhere and has passed straight through the surface, at its `t_near`.
    pub is_passed: bool,
}

impl Ray {
    /// Returns the ray continued behind a hit.
    pub fn beyond(self, found: &Found) -> Ray {
        Ray {
            t_near: found.t,
            leaves: Some(Left {
                is_passed: true,
                ..found.left()
            }),
            ..self
        }
    }
}

impl Found {
    /// Returns the hit as the surface on which a new ray starts.
    pub fn left(&self) -> Left {
        Left {
            instance: self.instance,
            primitive: self.primitive,
            is_passed: false,
        }
    }
}

/// Nearest hit of a ray.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    pub instance: u32,
    pub primitive: u32,
    pub t: Approx,
    /// Barycentric weight of the second corner.
    pub u: Approx,
    /// Barycentric weight of the third corner.
    pub v: Approx,
}

/// Possible hit with its certainty: negative slack means that it is surely missed.
struct Candidate {
    found: Found,
    slack: f64,
}

/// Scene prepared for brute-force queries.
pub struct World<'s> {
    pub scene: &'s Scene,
    /// Inverse transforms by instance; computed here, so that a wrong inverse in the scene is detected.
    pub object_from_world: Vec<DAffine3>,
    balls: Vec<Ball>,
    /// Faces of analytic shapes, by geometry.
    faces: Vec<Vec<Face>>,
}

/// Bounding sphere of a primitive in world space, for fast rejection.
struct Ball {
    instance: u32,
    primitive: u32,
    /// Index of the root among a primitive's crossings with a line.
    root: u32,
    center: DVec3,
    radius: f64,
    /// Factor by which the instance's transform and its inverse amplify rounding errors.
    condition: f64,
}

impl<'s> World<'s> {
    pub fn new(scene: &'s Scene) -> World<'s> {
        let faces: Vec<Vec<Face>> = scene.geometries.iter().map(faces).collect();
        let mut balls = Vec::new();
        for (index, instance) in scene.instances.iter().enumerate() {
            // Bound rounding errors by the condition number of the transform
            let map = instance.world_from_object();
            let condition = norm(&map.matrix3) * norm(&map.inverse().matrix3);
            let mut add = |(primitive, root): (u32, u32), center: DVec3, radius: f64| {
                balls.push(Ball {
                    instance: index as u32,
                    primitive,
                    root,
                    center,
                    radius,
                    condition,
                });
            };
            // Compute a bounding sphere for each triangle or face
            match &scene.geometries[instance.geometry as usize] {
                Geometry::Mesh(mesh) => {
                    for primitive in 0..mesh.triangles.len() as u32 {
                        let corners = corners(mesh, primitive).map(|p| map.transform_point3(p));
                        let center = (corners[0] + corners[1] + corners[2]) / 3.0;
                        let radius = corners.iter().fold(0.0, |r: f64, p| r.max(p.distance(center)));
                        add((primitive, 0), center, radius);
                    }
                }
                Geometry::Points(_) => panic!("the textbook has no point clouds"),
                Geometry::Shape(Shape::Sphere(sphere)) => {
                    let center = map.transform_point3(sphere.center);
                    add((0, 0), center, sphere.radius * norm(&map.matrix3));
                }
                Geometry::Shape(shape) => {
                    let (center, radius) = shapes::ball(shape);
                    let (center, radius) = (map.transform_point3(center), radius * norm(&map.matrix3));
                    for (part, face) in faces[instance.geometry as usize].iter().enumerate() {
                        (0..face.root_count()).for_each(|root| add((part as u32, root), center, radius));
                    }
                }
            }
        }
        // Invert the transforms in f64
        World {
            scene,
            object_from_world: scene
                .instances
                .iter()
                .map(|i| i.world_from_object().inverse())
                .collect(),
            balls,
            faces,
        }
    }

    /// Returns a face of an analytic shape.
    pub fn face(&self, geometry: u32, part: u32) -> &Face {
        &self.faces[geometry as usize][part as usize]
    }

    /// Returns the nearest hit; ties go to the first instance and primitive.
    pub fn nearest(&self, ray: &Ray, doubt: &mut Doubt) -> Option<Found> {
        let candidates: Vec<Candidate> = self.candidates(ray).filter(|c| c.slack > -1.0).collect();
        let hits = candidates.iter().filter(|c| c.slack > 0.0);
        let nearest = hits.reduce(|a, b| if b.found.t.value < a.found.t.value { b } else { a });
        for candidate in &candidates {
            let slack = match nearest {
                None => candidate.slack,
                Some(n) if std::ptr::eq(n, candidate) => candidate.slack,
                // Another candidate is relevant if it may be hit and may be nearer.
                Some(n) => {
                    let behind = candidate.found.t.value - n.found.t.value;
                    let depth = behind / (candidate.found.t.error + n.found.t.error);
                    let depth = if depth.is_nan() { 0.0 } else { depth };
                    if candidate.slack > 0.0 {
                        depth
                    } else {
                        depth.max(-candidate.slack)
                    }
                }
            };
            doubt.note(Decision::Nearest, slack);
        }
        nearest.map(|c| c.found)
    }

    /// Returns whether any primitive occludes the segment.
    pub fn blocked(&self, ray: &Ray, doubt: &mut Doubt) -> bool {
        let surest = self
            .candidates(ray)
            .fold(f64::NEG_INFINITY, |s, c| s.max(c.slack));
        doubt.note(Decision::Shadow, surest);
        surest > 0.0
    }

    /// Returns whether an instance that `stops` light surely occludes the segment.
    pub fn surely_blocked(&self, ray: &Ray, stops: impl Fn(u32) -> bool) -> bool {
        self.candidates(ray)
            .any(|c| c.slack > 1.0 && stops(c.found.instance))
    }

    /// Returns candidates for every primitive whose bounding sphere the ray may intersect.
    fn candidates(&self, ray: &Ray) -> impl Iterator<Item = Candidate> {
        let (origin, direction) = (ray.origin.value(), ray.direction.value());
        let length = direction.length();
        let (spread, drift) = (
            ray.origin.error().length(),
            ray.direction.error().length() / length,
        );
        let near = move |ball: &&Ball| {
            let to_center = ball.center - origin;
            let reach = to_center.length() + ball.radius;
            let margin = ball.condition * (spread + reach * (drift + 32.0 * ROUNDING));
            let along = to_center.dot(direction) / length;
            let aside = (to_center - along * direction / length).length();
            let radius = ball.radius + margin;
            aside <= radius && along >= -radius && along - radius <= ray.t_far * length
        };
        let ray = *ray;
        let balls = self.balls.iter().filter(near);
        balls.filter_map(move |ball| self.candidate(&ray, ball))
    }

    fn candidate(&self, ray: &Ray, ball: &Ball) -> Option<Candidate> {
        let (instance, primitive) = (ball.instance, ball.primitive);
        // Check whether the ray starts on this primitive
        let leaves = ray
            .leaves
            .filter(|left| (left.instance, left.primitive) == (instance, primitive));
        // Transform the ray to object space
        let placed = &self.scene.instances[instance as usize];
        let local = if placed.world_from_object() == DAffine3::IDENTITY {
            *ray
        } else {
            let map = &self.object_from_world[instance as usize];
            Ray {
                origin: transform_point(map, ray.origin),
                direction: transform_vector(&map.matrix3, ray.direction),
                ..*ray
            }
        };
        // Intersect the primitive
        let (weights, t) = match &self.scene.geometries[placed.geometry as usize] {
            // A ray that leaves a flat triangle cannot intersect it again.
            Geometry::Mesh(_) if leaves.is_some() => return None,
            Geometry::Mesh(mesh) => triangle(&local, corners(mesh, primitive))?,
            Geometry::Shape(Shape::Sphere(sphere)) => {
                let f = local.origin - Approx3::exact(sphere.center);
                sphere_root(&local, f, sphere.radius, leaves)?
            }
            Geometry::Points(_) => panic!("the textbook has no point clouds"),
            Geometry::Shape(_) => {
                let face = self.face(placed.geometry, primitive);
                let (t, slack) = face.crossing(&local, ball.root, leaves)?;
                (Weights::of_shape(slack), t)
            }
        };
        // Combine the slacks of the position and of the ray's interval
        let range = (t - ray.t_near).slack().min(below(t, ray.t_far));
        let found = Found {
            instance,
            primitive,
            t,
            u: weights.u,
            v: weights.v,
        };
        Some(Candidate {
            found,
            slack: weights.slack.min(range),
        })
    }
}

/// Returns the faces of a shape.
fn faces(geometry: &Geometry) -> Vec<Face> {
    match geometry {
        Geometry::Mesh(_) | Geometry::Points(_) => Vec::new(),
        Geometry::Shape(shape) => shapes::faces(shape),
    }
}

/// Returns the slack of `t` against an upper end that may be infinite.
fn below(t: Approx, end: f64) -> f64 {
    if end.is_finite() {
        (end - t).slack()
    } else {
        f64::INFINITY
    }
}

/// Position within a primitive, and certainty of being inside it.
struct Weights {
    u: Approx,
    v: Approx,
    slack: f64,
}

impl Weights {
    /// Returns weights without barycentrics, for analytic shapes.
    fn of_shape(slack: f64) -> Weights {
        Weights {
            u: Approx::ZERO,
            v: Approx::ZERO,
            slack,
        }
    }
}

/// Intersects a triangle in the ray's coordinates (Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT
/// 2013, without its rounding rules): the signs of three edge functions agree if the ray passes inside.
fn triangle(ray: &Ray, corners: [DVec3; 3]) -> Option<(Weights, Approx)> {
    let d = ray.direction;
    let steepest = d.value().abs().max_position();
    let axes = [(steepest + 1) % 3, (steepest + 2) % 3, steepest];
    let component = |v: Approx3, axis: usize| v.to_array()[axes[axis]];
    let shear = [0, 1].map(|axis| component(d, axis) / component(d, 2));
    let seen = corners.map(|corner| {
        let p = Approx3::exact(corner) - ray.origin;
        [0, 1].map(|axis| component(p, axis) - shear[axis] * component(p, 2))
    });
    let edge = |a: usize, b: usize| seen[a][0] * seen[b][1] - seen[a][1] * seen[b][0];
    let functions = [edge(1, 2), edge(2, 0), edge(0, 1)];
    let slack = inside(functions.map(Approx::slack));
    if slack <= -1.0 {
        return None;
    }
    let sum = functions[0] + functions[1] + functions[2];
    let [v0, e1, e2] = [corners[0], corners[1] - corners[0], corners[2] - corners[0]];
    let n = Approx3::rounded(e1).cross(Approx3::rounded(e2));
    let t = n.dot(Approx3::exact(v0) - ray.origin) / n.dot(d);
    let weights = Weights {
        u: functions[1] / sum,
        v: functions[2] / sum,
        slack,
    };
    Some((weights, t))
}

/// Returns the slack of three edge functions having one sign: the smallest magnitude if they agree, else the surest
/// contradiction.
fn inside(slacks: [f64; 3]) -> f64 {
    let smallest = slacks.iter().fold(f64::INFINITY, |a, &b| a.min(b));
    let largest = slacks.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
    if smallest >= 0.0 {
        smallest
    } else if largest <= 0.0 {
        -largest
    } else {
        -largest.min(-smallest)
    }
}

/// Solves |f + t d|² = r²: the nearer root within the interval, or the other root for a ray that starts on the sphere.
fn sphere_root(ray: &Ray, f: Approx3, radius: f64, leaves: Option<Left>) -> Option<(Weights, Approx)> {
    let d = ray.direction;
    let a = d.dot(d);
    let middle = -f.dot(d) / a;
    let root = |slack: f64, t: Approx| (Weights::of_shape(slack), t);
    let aside = f + d * middle;
    let inside = Approx::rounded(radius).squared() - aside.dot(aside);
    let half_chord = (inside / a).sqrt();
    match leaves {
        Some(Left { is_passed: false, .. }) => return Some(root(f64::INFINITY, middle + middle)),
        // The first root was passed: the second is ahead, and none after that.
        Some(_) if ray.t_near.value < middle.value => {
            return Some(root(f64::INFINITY, middle + half_chord));
        }
        Some(_) => return None,
        None => {}
    }
    let first = middle - half_chord;
    let t = if first.value >= ray.t_near.value {
        first
    } else {
        middle + half_chord
    };
    Some(root(inside.slack(), t))
}

/// Returns the three corners of a triangle in object space.
pub fn corners(mesh: &Mesh, primitive: u32) -> [DVec3; 3] {
    mesh.triangles[primitive as usize].map(|v| Vec3::from(mesh.positions[v as usize]).as_dvec3())
}

/// Returns an upper bound on the factor by which a map lengthens a vector (Frobenius norm).
pub fn norm(m: &DMat3) -> f64 {
    m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt()
}

pub fn transform_vector(m: &DMat3, v: Approx3) -> Approx3 {
    let column = |c: DVec3| Approx3::exact(c);
    column(m.x_axis) * v.x + column(m.y_axis) * v.y + column(m.z_axis) * v.z
}

pub fn transform_point(map: &DAffine3, p: Approx3) -> Approx3 {
    transform_vector(&map.matrix3, p) + Approx3::exact(map.translation)
}
