//! Light tree: choice of one of many lights, in proportion to an estimate of the light that it brings to a point.
//!
//! Surfaces behind a diffuse bounce contribute little each, so where there are many lights they sample one of them. Lights
//! are grouped in a binary tree by position, power and direction, and the choice descends it by chance (A. Conty Estévez and
//! C. Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", Proceedings of the ACM on Computer Graphics
//! and Interactive Techniques 1(2), 2018). The estimate of a group is its power over its squared distance, times a bound on
//! the cosine at the surface; a group whose cone of emission misses the point counts little. No estimate is zero, so the
//! choice is unbiased whatever the lights are.

use glam::{DQuat, DVec3};

use super::area_light_sampler::AreaLightSampler;
use crate::numeric::Bounds;
use crate::scene::{AreaShape, Effect, EffectSet, Falloff, Light, LightKind, Scene};

/// Greatest number of lights that every surface samples one by one. In a room of 40, choosing one takes 0.45 of the time of
/// all to equal error.
const FEW: usize = 32;
/// Least factor that directions have in an estimate: not zero, so that rounding leaves out no light that contributes, and
/// small, because samples of lights that do not contribute are lost.
const MIN_FACTOR: f64 = 1.0 / 64.0;
/// Depth from which on groups are halved, so that the tree does not become a list.
const BALANCED_DEPTH: usize = 48;

/// Lights of a scene that one tree holds, and the others, by number.
pub(in crate::render) struct LightDivision {
    pub(in crate::render) in_tree: Vec<u32>,
    pub(in crate::render) others: Vec<u32>,
}

impl LightDivision {
    /// Divides the lights of a scene; `None` if every surface samples them one by one.
    ///
    /// The tree holds no lights without a position, and none whose light does not fall with the square of the distance. It
    /// holds emissive objects only where no lobes share them ([`super::CombinedSampling`]), and none with caustics, whose
    /// photons represent each light apart.
    pub(in crate::render) fn of(scene: &Scene, effects: EffectSet) -> Option<LightDivision> {
        if !effects.has(Effect::Interreflection) || scene.caustics.is_some() {
            return None;
        }
        let is_in_tree = |light: &Light| match &light.kind {
            LightKind::Directional { .. } => false,
            LightKind::Point { falloff, .. } | LightKind::Spot { falloff, .. } => {
                matches!(falloff, Falloff::InverseSquare { .. })
            }
            LightKind::Area { shape, .. } => {
                effects.has(Effect::AreaLight)
                    && !(matches!(shape, AreaShape::Object { .. }) && effects.has(Effect::RoughReflection))
            }
        };
        let (in_tree, others): (Vec<u32>, Vec<u32>) =
            (0..scene.lights.len() as u32).partition(|&number| is_in_tree(&scene.lights[number as usize]));
        (in_tree.len() > FEW).then_some(LightDivision { in_tree, others })
    }
}

/// Light that a point has chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::render) struct ChosenLight {
    /// Number of the light in the scene.
    pub(in crate::render) number: u32,
    /// Probability of the choice, positive.
    pub(in crate::render) probability: f64,
}

/// Binary tree of lights.
pub(in crate::render) struct LightTree {
    /// Nodes in depth-first order: the first child follows its parent.
    nodes: Vec<LightNode>,
    /// Numbers of the lights that are not in the tree.
    pub(in crate::render) others: Vec<u32>,
}

/// One light or a group of lights.
#[derive(Clone, Copy)]
struct LightNode {
    /// Centre and squared radius of a sphere around the lights.
    center: DVec3,
    squared_radius: f64,
    emission: EmissionCone,
    /// Radiant intensity of all lights together.
    power: f64,
    link: LightLink,
}

/// Successor of a node of the light tree.
#[derive(Clone, Copy)]
enum LightLink {
    /// Index of the second child.
    Children(u32),
    /// Number of the only light.
    Light(u32),
}

/// Cone of the directions into which lights emit.
#[derive(Clone, Copy, Debug)]
struct EmissionCone {
    axis: DVec3,
    /// Cosine of the angle to the axis; -1 for all directions.
    cosine: f64,
}

impl EmissionCone {
    const ALL: EmissionCone = EmissionCone {
        axis: DVec3::Z,
        cosine: -1.0,
    };

    /// Returns a cone around both.
    fn union(self, other: EmissionCone) -> EmissionCone {
        if self.cosine <= -1.0 || other.cosine <= -1.0 {
            return EmissionCone::ALL;
        }
        // Keep the wider one if it contains the other
        let [wide, narrow] = match self.cosine <= other.cosine {
            true => [self, other],
            false => [other, self],
        };
        let angle = |cone: EmissionCone| cone.cosine.clamp(-1.0, 1.0).acos();
        let between = wide.axis.angle_between(narrow.axis);
        if between + angle(narrow) <= angle(wide) {
            return wide;
        }
        // Else turn its axis until both fit
        let half = 0.5 * (angle(wide) + between + angle(narrow));
        let across = wide.axis.cross(narrow.axis);
        if half >= std::f64::consts::PI || across.length_squared() == 0.0 {
            return EmissionCone::ALL;
        }
        EmissionCone {
            axis: DQuat::from_axis_angle(across.normalize(), half - angle(wide)) * wide.axis,
            cosine: half.cos(),
        }
    }
}

/// Bounds of one light or of a group.
#[derive(Clone, Copy)]
struct LightBounds {
    number: u32,
    bounds: Bounds,
    emission: EmissionCone,
    power: f64,
}

impl LightBounds {
    /// Returns the bounds of a light; `None` if it is dark.
    fn of(scene: &Scene, number: u32, sampler: Option<&AreaLightSampler>) -> Option<LightBounds> {
        let light = &scene.lights[number as usize];
        let intensity: f64 = light.intensity.iter().map(|&channel| f64::from(channel)).sum();
        let (bounds, emission, size) = match &light.kind {
            LightKind::Directional { .. } => return None,
            LightKind::Point { position, .. } => (Bounds::of_points([*position]), EmissionCone::ALL, 1.0),
            LightKind::Spot {
                position,
                direction,
                cos_outer,
                ..
            } => {
                let emission = EmissionCone {
                    axis: *direction,
                    cosine: *cos_outer,
                };
                (Bounds::of_points([*position]), emission, 1.0)
            }
            LightKind::Area { shape, .. } => {
                // Lights other than emissive objects and spheres emit from their front only
                let emission = match *shape {
                    AreaShape::Quad { half_u, half_v, .. } | AreaShape::Disk { half_u, half_v, .. } => {
                        let axis = half_u.cross(half_v).try_normalize();
                        axis.map_or(EmissionCone::ALL, |axis| EmissionCone { axis, cosine: 0.0 })
                    }
                    AreaShape::Sphere { .. } | AreaShape::Object { .. } => EmissionCone::ALL,
                };
                let of_object = || {
                    let instance = &scene.instances[light.emissive_instance()? as usize];
                    let geometry = &scene.geometries[instance.geometry as usize];
                    Some(instance.world_bounds(geometry, &geometry.bounds()))
                };
                (shape.bounds().or_else(of_object)?, emission, sampler?.area())
            }
        };
        let power = intensity * size;
        (power > 0.0 && power.is_finite()).then_some(LightBounds {
            number,
            bounds,
            emission,
            power,
        })
    }

    fn union(self, other: LightBounds) -> LightBounds {
        LightBounds {
            bounds: self.bounds.union(other.bounds),
            emission: self.emission.union(other.emission),
            power: self.power + other.power,
            ..self
        }
    }

    /// Returns the cost of a group: its power times its squared size and the part of all directions that it emits into.
    fn cost(&self) -> f64 {
        self.power * self.bounds.extent().length_squared() * (1.0 - self.emission.cosine)
    }
}

impl LightTree {
    /// Builds the tree of the lights of `division`; dark ones are left out. `samplers` are those of area lights.
    pub(in crate::render) fn build(
        scene: &Scene,
        division: LightDivision,
        samplers: &[Option<AreaLightSampler>],
    ) -> LightTree {
        let sampler = |number: u32| samplers.get(number as usize).and_then(Option::as_ref);
        let mut lights: Vec<LightBounds> = division
            .in_tree
            .iter()
            .filter_map(|&number| LightBounds::of(scene, number, sampler(number)))
            .collect();
        let mut tree = LightTree {
            nodes: Vec::with_capacity(2 * lights.len()),
            others: division.others,
        };
        if !lights.is_empty() {
            tree.add(&mut lights, 0);
        }
        tree
    }

    /// Returns the size of the tree in bytes.
    pub(in crate::render) fn byte_count(&self) -> usize {
        self.nodes.capacity() * size_of::<LightNode>() + self.others.capacity() * size_of::<u32>()
    }

    /// Appends the nodes of a group; returns its bounds.
    fn add(&mut self, lights: &mut [LightBounds], depth: usize) -> LightBounds {
        let place = self.nodes.len();
        if let [light] = lights {
            self.nodes
                .push(LightNode::of(light, LightLink::Light(light.number)));
            return *light;
        }
        // Reserve the place of the parent, then add its children
        self.nodes.push(LightNode::of(&lights[0], LightLink::Children(0)));
        let middle = divide(lights, depth);
        let (left, right) = lights.split_at_mut(middle);
        let left = self.add(left, depth + 1);
        let second = self.nodes.len() as u32;
        let group = left.union(self.add(right, depth + 1));
        self.nodes[place] = LightNode::of(&group, LightLink::Children(second));
        group
    }

    /// Chooses a light for the point `p` by the number `u` in [0, 1); `None` if all are dark. With a `normal`, lights
    /// below the surface are chosen rarely.
    pub(in crate::render) fn choose(
        &self,
        p: DVec3,
        normal: Option<DVec3>,
        mut u: f64,
    ) -> Option<ChosenLight> {
        let (mut index, mut probability) = (0, 1.0);
        loop {
            match self.nodes.get(index)?.link {
                LightLink::Light(number) => return Some(ChosenLight { number, probability }),
                LightLink::Children(second) => {
                    // Go to either child, and stretch its part of the range to the whole range
                    let share = self.first_share(index, p, normal);
                    if u < share {
                        (index, probability, u) = (index + 1, probability * share, u / share);
                    } else {
                        let rest = 1.0 - share;
                        (index, probability, u) = (second as usize, probability * rest, (u - share) / rest);
                    }
                    u = u.min(1.0f64.next_down());
                }
            }
        }
    }

    /// Returns the probability of the first child of a node.
    fn first_share(&self, index: usize, p: DVec3, normal: Option<DVec3>) -> f64 {
        let LightLink::Children(second) = self.nodes[index].link else {
            return 1.0;
        };
        let [a, b] = [index + 1, second as usize].map(|child| self.nodes[child].estimate(p, normal));
        let share = a / (a + b);
        // Estimates overflow at a point light itself
        if share > 0.0 && share < 1.0 { share } else { 0.5 }
    }
}

/// Sorts a group of two or more lights along an axis, and returns where to divide it.
fn divide(lights: &mut [LightBounds], depth: usize) -> usize {
    // Sort along the longest axis of the centres
    let centers = Bounds::of_points(lights.iter().map(|light| light.bounds.center()));
    let extent = centers.extent();
    let axis = (0..3).fold(0, |longest, axis| match extent[axis] > extent[longest] {
        true => axis,
        false => longest,
    });
    lights.sort_by(|a, b| a.bounds.center()[axis].total_cmp(&b.bounds.center()[axis]));
    let half = lights.len() / 2;
    if depth >= BALANCED_DEPTH || extent[axis] <= 0.0 {
        return half;
    }
    // Find the place of the least cost, from the costs of all groups on the right
    let mut right_costs = vec![0.0; lights.len()];
    let mut right: Option<LightBounds> = None;
    for index in (1..lights.len()).rev() {
        let group = right.map_or(lights[index], |group| lights[index].union(group));
        right_costs[index] = group.cost();
        right = Some(group);
    }
    let (mut best, mut least) = (half, f64::INFINITY);
    let mut left = lights[0];
    for index in 1..lights.len() {
        let cost = left.cost() + right_costs[index];
        if cost < least {
            (best, least) = (index, cost);
        }
        left = left.union(lights[index]);
    }
    best
}

impl LightNode {
    fn of(group: &LightBounds, link: LightLink) -> LightNode {
        LightNode {
            center: group.bounds.center(),
            squared_radius: 0.25 * group.bounds.extent().length_squared(),
            emission: group.emission,
            power: group.power,
            link,
        }
    }

    /// Returns the estimate of the light that the group brings to `p`, positive.
    fn estimate(&self, p: DVec3, normal: Option<DVec3>) -> f64 {
        let to_light = self.center - p;
        let squared = to_light.length_squared();
        // Within the sphere around it the light may come from anywhere
        if squared <= self.squared_radius {
            return self.power / self.squared_radius;
        }
        let toward = to_light / squared.sqrt();
        let cos_size = (1.0 - self.squared_radius / squared).max(0.0).sqrt();
        let at_surface = normal.map_or(1.0, |normal| nearest_cosine(normal.dot(toward), cos_size));
        let emitted = nearest_cosine(-self.emission.axis.dot(toward), cos_size);
        let is_emitted = emitted >= self.emission.cosine;
        let factor = at_surface.max(MIN_FACTOR) * if is_emitted { 1.0 } else { MIN_FACTOR };
        self.power * factor / squared
    }
}

/// Returns the greatest cosine to an axis of the directions of a cone, whose own direction has the cosine `middle`.
fn nearest_cosine(middle: f64, cos_size: f64) -> f64 {
    if middle >= cos_size {
        return 1.0;
    }
    let sine = |cosine: f64| (1.0 - cosine * cosine).max(0.0).sqrt();
    middle * cos_size + sine(middle) * sine(cos_size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;
    use crate::render::lighting::area_lights;

    /// Returns a scene of many lights of all kinds, some in the same place and some dark.
    fn many_lights(count: usize, random: &mut SplitMix64) -> Scene {
        let falloff = Falloff::InverseSquare { range: None };
        let lights = (0..count).map(|index| {
            let position = match index % 7 {
                6 => DVec3::ONE,
                _ => random.in_cube() * DVec3::new(10.0, 1.0, 4.0),
            };
            let kind = match index % 4 {
                0 => LightKind::Point { position, falloff },
                1 => LightKind::Spot {
                    position,
                    direction: random.direction(),
                    cos_inner: 0.9,
                    cos_outer: 0.8,
                    falloff,
                },
                2 => LightKind::Area {
                    shape: AreaShape::Quad {
                        center: position,
                        half_u: 0.1 * random.direction(),
                        half_v: 0.2 * random.direction(),
                    },
                    samples: 1,
                },
                _ => LightKind::Area {
                    shape: AreaShape::Sphere {
                        center: position,
                        radius: 0.1,
                    },
                    samples: 1,
                },
            };
            let is_dark = index % 5 == 4;
            Light {
                name: format!("light {index}"),
                intensity: [if is_dark {
                    0.0
                } else {
                    random.within(0.1, 10.0) as f32
                }; 3],
                kind,
            }
        });
        Scene {
            lights: lights.collect(),
            ..Scene::default()
        }
    }

    fn tree_of(scene: &Scene) -> LightTree {
        let effects = EffectSet::NONE
            .with(Effect::Interreflection)
            .with(Effect::AreaLight);
        let division = LightDivision::of(scene, effects).unwrap();
        LightTree::build(scene, division, &area_lights(scene, effects))
    }

    /// Adds the probabilities of the lights below a node, by number.
    fn probabilities(tree: &LightTree, index: usize, p: DVec3, share: f64, found: &mut Vec<(u32, f64)>) {
        match tree.nodes[index].link {
            LightLink::Light(number) => found.push((number, share)),
            LightLink::Children(second) => {
                let first = tree.first_share(index, p, Some(DVec3::Y));
                probabilities(tree, index + 1, p, share * first, found);
                probabilities(tree, second as usize, p, share * (1.0 - first), found);
            }
        }
    }

    #[test]
    fn every_bright_light_has_a_probability_with_which_it_is_chosen() {
        let mut random = SplitMix64::new(1, 1);
        for count in [42, 1000] {
            let scene = many_lights(count, &mut random);
            let tree = tree_of(&scene);
            for round in 0..20 {
                // Look from anywhere, also from the place of several lights
                let p = if round == 0 {
                    DVec3::ONE
                } else {
                    random.in_cube() * 12.0
                };
                let mut found = Vec::new();
                probabilities(&tree, 0, p, 1.0, &mut found);
                found.sort_unstable_by_key(|entry| entry.0);
                let bright = (0..count as u32).filter(|number| number % 5 != 4);
                assert!(found.iter().map(|entry| entry.0).eq(bright));
                assert!(found.iter().all(|entry| entry.1 > 0.0));
                let sum: f64 = found.iter().map(|entry| entry.1).sum();
                assert!((sum - 1.0).abs() < 1e-9, "{sum}");
                // Equal steps of the random number choose each light as often as its probability says
                let steps = 20_000;
                let mut counts = vec![0u32; count];
                for step in 0..steps {
                    let u = (f64::from(step) + 0.5) / f64::from(steps);
                    let chosen = tree.choose(p, Some(DVec3::Y), u).unwrap();
                    let expected = found.iter().find(|entry| entry.0 == chosen.number).unwrap().1;
                    assert!((chosen.probability - expected).abs() < 1e-12);
                    counts[chosen.number as usize] += 1;
                }
                for (number, probability) in found {
                    let share = f64::from(counts[number as usize]) / f64::from(steps);
                    // An interval holds its length over the step, one more or one less
                    assert!((share - probability).abs() <= 1.001 / f64::from(steps));
                }
            }
        }
    }

    #[test]
    fn near_bright_and_visible_lights_are_chosen_more_often() {
        let light = |x: f64, y: f64, intensity: f32| Light {
            name: String::new(),
            intensity: [intensity; 3],
            kind: LightKind::Point {
                position: DVec3::new(x, y, 0.0),
                falloff: Falloff::InverseSquare { range: None },
            },
        };
        // One light above the point in a row of lights below the horizon, and one of eight times the intensity
        let mut lights = vec![light(0.0, 1.0, 1.0), light(30.0, 1.0, 8.0)];
        lights.extend((0..40).map(|index| light(1.0 + f64::from(index), -2.0, 1.0)));
        let scene = Scene {
            lights,
            ..Scene::default()
        };
        let tree = tree_of(&scene);
        let share = |p: DVec3, number: u32| {
            let mut found = Vec::new();
            probabilities(&tree, 0, p, 1.0, &mut found);
            found.iter().find(|entry| entry.0 == number).unwrap().1
        };
        assert!(share(DVec3::ZERO, 0) > 0.5, "{}", share(DVec3::ZERO, 0));
        let beside = DVec3::new(30.0, 0.0, 0.0);
        assert!(share(beside, 1) > 0.5, "{}", share(beside, 1));
    }

    #[test]
    fn few_lights_directional_lights_and_shared_lights_are_not_divided() {
        let mut random = SplitMix64::new(2, 1);
        let interreflecting = EffectSet::NONE
            .with(Effect::Interreflection)
            .with(Effect::AreaLight);
        let divided = |scene: &Scene, effects| {
            LightDivision::of(scene, effects).map(|division| [division.in_tree.len(), division.others.len()])
        };
        let mut scene = many_lights(FEW, &mut random);
        assert_eq!(divided(&scene, interreflecting), None);
        scene = many_lights(FEW + 1, &mut random);
        assert_eq!(divided(&scene, interreflecting), Some([33, 0]));
        assert_eq!(divided(&scene, EffectSet::NONE), None);
        // Directional lights and lights that fall otherwise stay apart
        let [sun, old] = [
            LightKind::Directional { to_light: DVec3::Y },
            LightKind::Point {
                position: DVec3::ZERO,
                falloff: Falloff::Polynomial {
                    constant: 1.0,
                    linear: 0.0,
                    quadratic: 0.0,
                },
            },
        ]
        .map(|kind| Light {
            name: String::new(),
            intensity: [1.0; 3],
            kind,
        });
        scene.lights.extend([sun, old]);
        assert_eq!(divided(&scene, interreflecting), Some([33, 2]));
        scene.caustics = Some(crate::scene::Caustics::default());
        assert_eq!(divided(&scene, interreflecting), None);
    }
}
