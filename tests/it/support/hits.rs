//! What a ray meets, by asking every primitive, and how sure that answer is.
//!
//! Nothing of `whit` but its plain data is used. Every answer carries a signed slack: the distance to the nearest
//! other answer in units of the error that an f32 computation may have there. Below 1 another program may honestly
//! answer otherwise, and the textbook notes a [`Doubt`].

use glam::{DAffine3, DMat3, DVec3, Vec3};
use whit::mesh::Mesh;
use whit::scene::{Geometry, Scene};
use whit::shape::Shape;

use super::approx::{Approx, Approx3, ROUNDING};
use super::cones::Cone;
use super::shapes::{self, Face};

/// A decision on which a picture may jump.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Decision {
    /// None was taken yet.
    Nothing,
    /// Which primitive a camera or reflected ray meets: near an edge, or two at the same depth.
    Nearest,
    /// Whether a shadow ray is blocked.
    Shadow,
    /// To which side a normal points.
    Facing,
    /// Whether a light or a reflected ray is above the horizon of the triangle.
    Horizon,
    /// Which texel is read.
    Texel,
    /// Whether a surface is rough enough to be no mirror.
    Mirror,
    /// Whether a boundary reflects all light.
    TotalReflection,
    /// Whether a masked surface is there.
    Coverage,
    /// Whether a path weighs enough to be followed.
    Cutoff,
    /// No flip, but a value so badly conditioned that nothing can be promised.
    Value,
}

/// The least certain decision so far.
#[derive(Clone, Copy, Debug)]
pub struct Doubt {
    /// Distance to the nearest flip in units of the error bound; a flip is possible below 1.
    pub slack: f64,
    /// What would flip.
    pub decision: Decision,
}

impl Doubt {
    pub const NONE: Doubt = Doubt {
        slack: f64::INFINITY,
        decision: Decision::Nothing,
    };

    /// Notes a decision that hangs on the sign of a number with this slack.
    pub fn note(&mut self, decision: Decision, slack: f64) {
        if slack.abs() < self.slack {
            *self = Doubt {
                slack: slack.abs(),
                decision,
            };
        }
    }

    /// Whether an f32 computation may have decided otherwise.
    pub fn may_flip(&self) -> bool {
        self.slack < 1.0
    }
}

/// A ray segment in world space.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: Approx3,
    pub direction: Approx3,
    pub t_near: Approx,
    pub t_far: f64,
    /// The surface that the ray begins on, which it cannot meet at its start.
    pub leaves: Option<Left>,
    /// How wide it is at its origin, for textures.
    pub cone: Cone,
}

/// A surface on which a ray begins.
#[derive(Clone, Copy, Debug)]
pub struct Left {
    pub instance: u32,
    pub primitive: u32,
    /// Whether the ray starts elsewhere and has gone straight through it, at its `t_near`.
    pub is_passed: bool,
}

impl Ray {
    /// The same ray behind what it has met.
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
    /// As the surface on which a new ray begins.
    pub fn left(&self) -> Left {
        Left {
            instance: self.instance,
            primitive: self.primitive,
            is_passed: false,
        }
    }
}

/// The nearest thing that a ray meets.
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

/// One candidate's answer: what is found there if it is found, and how surely (negative: surely not).
struct Candidate {
    found: Found,
    slack: f64,
}

/// A scene ready for brute force.
pub struct World<'s> {
    pub scene: &'s Scene,
    /// By instance; computed here, so that a wrong inverse in the scene shows.
    pub object_from_world: Vec<DAffine3>,
    balls: Vec<Ball>,
    /// By geometry: the faces of analytic shapes.
    faces: Vec<Vec<Face>>,
}

/// A ball around a primitive, in world space, to pass over most of them quickly.
struct Ball {
    instance: u32,
    primitive: u32,
    /// Which of its crossings with a line.
    root: u32,
    center: DVec3,
    radius: f64,
    /// By how much the instance's map and back again enlarges rounding errors.
    condition: f64,
}

impl<'s> World<'s> {
    pub fn new(scene: &'s Scene) -> World<'s> {
        let faces: Vec<Vec<Face>> = scene.geometries.iter().map(faces).collect();
        let mut balls = Vec::new();
        for (index, instance) in scene.instances.iter().enumerate() {
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
            match &scene.geometries[instance.geometry as usize] {
                Geometry::Mesh(mesh) => {
                    for primitive in 0..mesh.triangles.len() as u32 {
                        let corners = corners(mesh, primitive).map(|p| map.transform_point3(p));
                        let center = (corners[0] + corners[1] + corners[2]) / 3.0;
                        let radius = corners.iter().fold(0.0, |r: f64, p| r.max(p.distance(center)));
                        add((primitive, 0), center, radius);
                    }
                }
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

    /// A face of an analytic shape.
    pub fn face(&self, geometry: u32, part: u32) -> &Face {
        &self.faces[geometry as usize][part as usize]
    }

    /// The nearest hit; ties go to the first instance and primitive.
    pub fn nearest(&self, ray: &Ray, doubt: &mut Doubt) -> Option<Found> {
        let candidates: Vec<Candidate> = self.candidates(ray).filter(|c| c.slack > -1.0).collect();
        let hits = candidates.iter().filter(|c| c.slack > 0.0);
        let nearest = hits.reduce(|a, b| if b.found.t.value < a.found.t.value { b } else { a });
        for candidate in &candidates {
            let slack = match nearest {
                None => candidate.slack,
                Some(n) if std::ptr::eq(n, candidate) => candidate.slack,
                // Another one matters if it may be met and may be nearer.
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

    /// Whether anything lies within the segment.
    pub fn blocked(&self, ray: &Ray, doubt: &mut Doubt) -> bool {
        let surest = self
            .candidates(ray)
            .fold(f64::NEG_INFINITY, |s, c| s.max(c.slack));
        doubt.note(Decision::Shadow, surest);
        surest > 0.0
    }

    /// Whether an instance that `stops` light lies within the segment beyond any doubt.
    pub fn surely_blocked(&self, ray: &Ray, stops: impl Fn(u32) -> bool) -> bool {
        self.candidates(ray)
            .any(|c| c.slack > 1.0 && stops(c.found.instance))
    }

    /// Every primitive that the ray may come near.
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
        let leaves = ray
            .leaves
            .filter(|left| (left.instance, left.primitive) == (instance, primitive));
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
        let (weights, t) = match &self.scene.geometries[placed.geometry as usize] {
            // A flat triangle is never met again by a ray that leaves it.
            Geometry::Mesh(_) if leaves.is_some() => return None,
            Geometry::Mesh(mesh) => triangle(&local, corners(mesh, primitive))?,
            Geometry::Shape(Shape::Sphere(sphere)) => {
                let f = local.origin - Approx3::exact(sphere.center);
                sphere_root(&local, f, sphere.radius, leaves)?
            }
            Geometry::Shape(_) => {
                let face = self.face(placed.geometry, primitive);
                let (t, slack) = face.crossing(&local, ball.root, leaves)?;
                (Weights::of_shape(slack), t)
            }
        };
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

/// The faces of a shape.
fn faces(geometry: &Geometry) -> Vec<Face> {
    match geometry {
        Geometry::Mesh(_) => Vec::new(),
        Geometry::Shape(shape) => shapes::faces(shape),
    }
}

/// Slack of `t` against an upper end that may be infinite.
fn below(t: Approx, end: f64) -> f64 {
    if end.is_finite() {
        (end - t).slack()
    } else {
        f64::INFINITY
    }
}

/// Where within a primitive, and how surely within it.
struct Weights {
    u: Approx,
    v: Approx,
    slack: f64,
}

impl Weights {
    /// Shapes have none.
    fn of_shape(slack: f64) -> Weights {
        Weights {
            u: Approx::ZERO,
            v: Approx::ZERO,
            slack,
        }
    }
}

/// The triangle's corners as seen along the ray (Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT
/// 2013, without its rounding tricks): three edge functions whose signs agree where the ray passes inside.
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

/// How surely three edge functions have one sign: by the least sure of them where they do, else by the surest
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

/// The sphere |f + t d|² = r²: the nearer root within the interval, or the other root for a ray that begins on it.
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
        // Passed at its first root: the second is ahead, and none after that.
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

/// The three corners of a triangle in object space.
pub fn corners(mesh: &Mesh, primitive: u32) -> [DVec3; 3] {
    mesh.triangles[primitive as usize].map(|v| Vec3::from(mesh.positions[v as usize]).as_dvec3())
}

/// The norm by which a map can lengthen a vector, bounded from above (Frobenius).
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
