//! A scene's own rays through two ways of finding hits: what differs, and why it may.
//!
//! Whether a difference is a tie or wrong says [`agreement`]; what kind of place it is at says the nearer of the two
//! hits, or the one that only one of them has found.

use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use super::trial::describe;
use crate::accel::agreement::{self, Agreement};
use crate::accel::{Accel, Hit, LANES, RayOrder, RayPacket};
use crate::numeric::Ray;
use crate::scene::{Geometry, Scene};

/// What kind of place two answers differ at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Place {
    /// A parameter is no number.
    Nan,
    /// An analytic shape.
    Shape,
    /// Two triangles at the same distance, away from their edges: they lie in one plane, or cross there.
    Coplanar,
    /// A corner.
    Vertex,
    /// An edge.
    Edge,
    /// A triangle lower than 10^-4 of its longest edge.
    Sliver,
    /// A triangle seen at less than about half a degree to its plane.
    Grazing,
    /// A triangle more than 10^5 of its own lengths away.
    Far,
    /// Right at one end of the ray.
    End,
    /// None of these.
    Other,
}

impl Place {
    /// As a table has it.
    pub fn name(self) -> &'static str {
        match self {
            Place::Nan => "not a number",
            Place::Shape => "shape",
            Place::Coplanar => "coplanar",
            Place::Vertex => "vertex",
            Place::Edge => "edge",
            Place::Sliver => "sliver",
            Place::Grazing => "grazing",
            Place::Far => "far",
            Place::End => "end of ray",
            Place::Other => "elsewhere",
        }
    }
}

/// What a set of rays is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// What is hit first.
    Nearest,
    /// Whether anything is hit.
    Blocked,
}

/// How two answers to a set of rays compare.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Rays that were asked.
    pub rays: u64,
    /// Differences that rounding explains, by place.
    pub ties: BTreeMap<Place, u64>,
    /// Those that it does not.
    pub wrong: BTreeMap<Place, u64>,
    /// The first wrong one, to be asked again.
    pub example: Option<String>,
}

impl Comparison {
    /// How many are wrong.
    pub fn wrong_count(&self) -> u64 {
        self.wrong.values().sum()
    }

    /// How many are ties.
    pub fn tie_count(&self) -> u64 {
        self.ties.values().sum()
    }

    fn with(mut self, other: Comparison) -> Comparison {
        self.rays += other.rays;
        for (sums, counts) in [(&mut self.ties, other.ties), (&mut self.wrong, other.wrong)] {
            for (place, count) in counts {
                *sums.entry(place).or_default() += count;
            }
        }
        self.example = self.example.or(other.example);
        self
    }
}

/// Packets that go to a thread at once.
const CHUNK: usize = 256;

/// Compares what two structures over `scene` answer to all packets.
pub fn compare_all(
    scene: &Scene,
    accels: [&dyn Accel; 2],
    packets: &[RayPacket],
    question: Question,
) -> Comparison {
    let chunks: Vec<Comparison> = packets
        .par_chunks(CHUNK)
        .map(|chunk| compare_chunk(scene, accels, chunk, question))
        .collect();
    chunks.into_iter().fold(Comparison::default(), Comparison::with)
}

fn compare_chunk(
    scene: &Scene,
    accels: [&dyn Accel; 2],
    asked: &[RayPacket],
    question: Question,
) -> Comparison {
    let [a, b] = accels.map(|accel| {
        let mut packets = asked.to_vec();
        match question {
            Question::Nearest => accel.intersect(&mut packets, RayOrder::Incoherent),
            Question::Blocked => accel.occluded(&mut packets, RayOrder::Incoherent),
        }
        packets
    });
    let mut comparison = Comparison::default();
    for (number, packet) in asked.iter().enumerate() {
        for lane in (0..LANES).filter(|&lane| packet.is_active(lane)) {
            comparison.rays += 1;
            let ray = packet.ray(lane);
            let (agreement, hits) = match question {
                Question::Nearest => {
                    let hits = [a[number].hit(lane), b[number].hit(lane)];
                    (agreement::compare(scene, &ray, hits[0], hits[1]), hits)
                }
                Question::Blocked => {
                    let blocked = [a[number].is_blocked(lane), b[number].is_blocked(lane)];
                    shadow(scene, &ray, accels, blocked)
                }
            };
            let counts = match agreement {
                Agreement::Same => continue,
                Agreement::Tie => &mut comparison.ties,
                Agreement::Wrong => {
                    let answers = || format!("{}, but {}", describe(&ray, hits[0]), answer(hits[1]));
                    comparison.example.get_or_insert_with(answers);
                    &mut comparison.wrong
                }
            };
            *counts.entry(place(scene, &ray, hits)).or_default() += 1;
        }
    }
    comparison
}

fn answer(hit: Option<Hit>) -> String {
    hit.map_or("nothing".into(), |hit| {
        format!(
            "instance {} primitive {} at {:e}",
            hit.instance, hit.primitive, hit.t
        )
    })
}

/// Whether a shadow ray may be blocked or not as two structures tell, with their nearest hits: mostly these settle it;
/// else the whole scene is asked, which takes long.
fn shadow(
    scene: &Scene,
    ray: &Ray,
    accels: [&dyn Accel; 2],
    blocked: [bool; 2],
) -> (Agreement, [Option<Hit>; 2]) {
    if blocked[0] == blocked[1] {
        return (Agreement::Same, [None; 2]);
    }
    let hits = accels.map(|accel| {
        let mut packet = [RayPacket::EMPTY];
        packet[0].set(0, ray);
        accel.intersect(&mut packet, RayOrder::Incoherent);
        packet[0].hit(0)
    });
    let agreement = match agreement::compare(scene, ray, hits[0], hits[1]) {
        Agreement::Tie => Agreement::Tie,
        _ => agreement::compare_occlusion(scene, ray, blocked[0], blocked[1]),
    };
    (agreement, hits)
}

/// What is nearer to an edge than this share of the triangle's height above it is at the edge.
const AT_EDGE: f64 = 1.0 / 4096.0;
/// Sine of the angle to a plane below which a ray grazes it.
const GRAZING: f64 = 0.01;
/// Lower than this share of the longest edge a triangle is a sliver.
const SLIVER: f64 = 1e-4;
/// Lengths of a triangle from which on it is far.
const FAR: f64 = 1e5;
/// Parameters that differ by less than this share are the same.
const SAME_T: f64 = 1.0 / (1 << 18) as f64;

fn place(scene: &Scene, ray: &Ray, hits: [Option<Hit>; 2]) -> Place {
    if hits.iter().flatten().any(|hit| hit.t.is_nan()) {
        return Place::Nan;
    }
    let views: Vec<View> = hits
        .iter()
        .flatten()
        .filter_map(|hit| View::of(scene, ray, hit))
        .collect();
    if views.len() < hits.iter().flatten().count() {
        return Place::Shape;
    }
    let any = |of: fn(&View) -> bool| views.iter().any(of);
    let is_same = |a: f64, b: f64| (a - b).abs() <= SAME_T * a.abs().max(b.abs());
    let ends = [ray.t_near, ray.t_far].map(f64::from).into_iter();
    let ends: Vec<f64> = ends.filter(|end| end.is_finite()).collect();
    if any(|view| view.near_edges >= 2) {
        Place::Vertex
    } else if any(|view| view.near_edges == 1) {
        Place::Edge
    } else if any(|view| view.is_sliver) {
        Place::Sliver
    } else if any(|view| view.is_grazed) {
        Place::Grazing
    } else if views.len() == 2 && is_same(views[0].t, views[1].t) {
        Place::Coplanar
    } else if views
        .iter()
        .any(|view| ends.iter().any(|&end| is_same(view.t, end)))
    {
        Place::End
    } else if any(|view| view.is_far) {
        Place::Far
    } else {
        Place::Other
    }
}

/// How a ray sees a triangle that it is said to hit.
struct View {
    t: f64,
    /// Edges that it passes close to.
    near_edges: usize,
    is_sliver: bool,
    is_grazed: bool,
    is_far: bool,
}

impl View {
    /// `None` for a shape.
    fn of(scene: &Scene, ray: &Ray, hit: &Hit) -> Option<View> {
        let instance = scene.instances.get(hit.instance as usize)?;
        let Geometry::Mesh(mesh) = scene.geometries.get(instance.geometry as usize)? else {
            return None;
        };
        let pose = instance.pose(ray.time);
        let map = pose.world_from_object();
        let [a, b, c] = mesh.corners_f64(hit.primitive).map(|p| map.transform_point3(p));
        let d = ray.direction.as_dvec3();
        let n = (b - a).cross(c - a);
        let t = n.dot(a - ray.origin.as_dvec3()) / n.dot(d);
        let p = ray.at(t);
        // Each weight is the distance from an edge as a share of the height above it.
        let weight = |q: DVec3, r: DVec3| (q - p).cross(r - p).dot(n) / n.length_squared();
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        Some(View {
            t,
            near_edges: weights.iter().filter(|w| w.abs() < AT_EDGE).count(),
            is_sliver: n.length() < SLIVER * longest * longest,
            is_grazed: n.dot(d).abs() < GRAZING * n.length() * d.length(),
            is_far: t * d.length() > FAR * longest,
        })
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::meshes::{icosphere, scene};
    use super::*;
    use crate::accel::brute::BruteAccel;

    /// Loses every hit on one triangle.
    struct Holed<'s>(BruteAccel<'s>, u32);

    impl Accel for Holed<'_> {
        fn intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
            self.0.intersect(packets, order);
            for packet in packets {
                for lane in 0..LANES {
                    if packet.primitive[lane] == self.1 {
                        packet.forget_hit(lane);
                    }
                }
            }
        }

        fn occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
            self.0.occluded(packets, order);
        }

        fn report(&self) -> crate::accel::AccelReport {
            self.0.report()
        }
    }

    #[test]
    fn a_lost_triangle_is_wrong_in_its_middle_and_told_to_be_elsewhere() {
        let scene = scene(vec![Geometry::Mesh(icosphere(1))]);
        let Geometry::Mesh(mesh) = &scene.geometries[0] else {
            panic!("it is a mesh");
        };
        let brute = BruteAccel::new(&scene);
        let holed = Holed(BruteAccel::new(&scene), 7);
        let [a, b, c] = mesh.corners(7);
        let at = |target: Vec3| {
            let mut packet = RayPacket::EMPTY;
            packet.set(0, &Ray::new(Vec3::ZERO, target));
            compare_all(&scene, [&brute, &holed], &[packet], Question::Nearest)
        };
        let middle = at((a + b + c) / 3.0);
        assert_eq!(middle.wrong, BTreeMap::from([(Place::Other, 1)]));
        assert!(middle.example.is_some() && middle.ties.is_empty());
        // At the edge another triangle may have it: nothing, a tie, or this one's; never wrong elsewhere.
        let edge = at(0.5 * (a + b));
        assert!(!edge.wrong.contains_key(&Place::Other), "{edge:?}");
        assert_eq!(at(-(a + b + c)).rays, 1);
        assert_eq!(at(-(a + b + c)).wrong_count() + at(-(a + b + c)).tie_count(), 0);
    }
}
