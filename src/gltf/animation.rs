//! Animations: where nodes stand at a moment.
//!
//! Every channel moves one property of one node by a sampler: times, values, and how to go from one to the next (glTF 2.0,
//! appendix C): by steps, straight (rotations along the shortest arc), or by a cubic spline through values with tangents.
//! Before the first time a property has the first value, behind the last the last.

use std::collections::HashMap;

use glam::{DAffine3, DQuat, DVec3};
use gltf::json;
use gltf::json::animation::{Interpolation, Property};
use gltf::json::validation::Checked;

use super::document::Document;
use super::error::EXPORT_AGAIN;
use super::{GltfError, node};
use crate::scene::Animation;

/// A moment of an animation.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// Name or number of the animation; all of them at once if none is said.
    pub animation: Option<String>,
    /// Seconds from its beginning.
    pub seconds: f64,
}

/// What an animation changes of a node's place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Moved {
    translation: Option<DVec3>,
    rotation: Option<DQuat>,
    scale: Option<DVec3>,
}

impl Moved {
    /// The place of a node to its parent: its own, but for what is moved.
    pub(super) fn transform(&self, node: &json::Node) -> DAffine3 {
        let own = node::parts(node);
        DAffine3::from_scale_rotation_translation(
            self.scale.unwrap_or(own.scale),
            self.rotation.unwrap_or(own.rotation),
            self.translation.unwrap_or(own.translation),
        )
    }
}

impl Document {
    /// What a pose moves, by the numbers of nodes.
    pub(super) fn moved(
        &self,
        pose: &Pose,
        warnings: &mut Vec<String>,
    ) -> Result<HashMap<usize, Moved>, GltfError> {
        let mut moved = HashMap::new();
        for number in self.animations_of(pose, warnings)? {
            for channel in 0..self.root.animations[number].channels.len() {
                self.add_channel((number, channel), pose.seconds, &mut moved, warnings)?;
            }
        }
        Ok(moved)
    }

    /// The numbers of the animations that a pose is of.
    fn animations_of(&self, pose: &Pose, warnings: &mut Vec<String>) -> Result<Vec<usize>, GltfError> {
        let animations = &self.root.animations;
        if animations.is_empty() {
            warnings.push("there are no animations: it is the same at all times".into());
            return Ok(Vec::new());
        }
        let Some(wish) = &pose.animation else {
            return Ok((0..animations.len()).collect());
        };
        let named = animations
            .iter()
            .position(|animation| animation.name.as_ref() == Some(wish));
        let number = named.or_else(|| {
            wish.parse()
                .ok()
                .filter(|&number: &usize| number < animations.len())
        });
        number.map(|number| vec![number]).ok_or_else(|| {
            let known: Vec<String> = (0..animations.len())
                .map(|number| format!("{number} `{}`", self.animation_name(number)))
                .collect();
            let fault = format!("is not there: there are {}", known.join(", "));
            self.fault(format!("animation `{wish}`"), fault, "name one of them")
        })
    }

    fn animation_name(&self, number: usize) -> String {
        let name = self.root.animations[number].name.clone();
        name.filter(|name| !name.is_empty())
            .unwrap_or_else(|| number.to_string())
    }

    fn add_channel(
        &self,
        (animation, channel): (usize, usize),
        seconds: f64,
        moved: &mut HashMap<usize, Moved>,
        warnings: &mut Vec<String>,
    ) -> Result<(), GltfError> {
        let channel = &self.root.animations[animation].channels[channel];
        let node = channel.target.node.value();
        if node >= self.root.nodes.len() {
            return Err(self.missing("node", node, self.root.nodes.len()));
        }
        let item = || format!("animation `{}`", self.animation_name(animation));
        let Checked::Valid(property) = channel.target.path else {
            return Err(self.fault(
                item(),
                "moves a property that glTF 2.0 does not have",
                EXPORT_AGAIN,
            ));
        };
        if property == Property::MorphTargetWeights {
            warnings.push(format!("{} has morph targets, which were ignored", item()));
            return Ok(());
        }
        if self.root.nodes[node].matrix.is_some() {
            let remedy = "give the node translation, rotation and scale";
            return Err(self.fault(
                item(),
                format!("moves {}, which has a matrix", self.node_item(node)),
                remedy,
            ));
        }
        let curve = self.curve(animation, channel.sampler.value(), property)?;
        let place = moved.entry(node).or_insert_with(Moved::default);
        match property {
            Property::Translation => place.translation = Some(vector(curve.at(seconds))),
            Property::Scale => place.scale = Some(vector(curve.at(seconds))),
            _ => place.rotation = Some(curve.rotation_at(seconds)),
        }
        Ok(())
    }

    /// A sampler, as numbers.
    fn curve(&self, animation: usize, sampler: usize, property: Property) -> Result<Curve, GltfError> {
        let samplers = &self.root.animations[animation].samplers;
        let item = || {
            format!(
                "sampler {sampler} of animation `{}`",
                self.animation_name(animation)
            )
        };
        let form = samplers
            .get(sampler)
            .ok_or_else(|| self.missing("sampler", sampler, samplers.len()))?;
        let Checked::Valid(interpolation) = form.interpolation else {
            let fault = "goes from key to key in a way that glTF 2.0 does not have";
            return Err(self.fault(item(), fault, EXPORT_AGAIN));
        };
        let times = self.accessor(form.input.value())?.vectors::<1>()?;
        let times: Vec<f64> = times.iter().map(|&[time]| f64::from(time)).collect();
        let values: Vec<[f64; 4]> = if property == Property::Rotation {
            let values = self.accessor(form.output.value())?.vectors::<4>()?;
            values.iter().map(|value| value.map(f64::from)).collect()
        } else {
            let values = self.accessor(form.output.value())?.vectors::<3>()?;
            values
                .iter()
                .map(|&[x, y, z]| [x, y, z, 0.0].map(f64::from))
                .collect()
        };
        let is_ordered = times.windows(2).all(|pair| pair[0] < pair[1]);
        let is_finite = times
            .iter()
            .chain(values.iter().flatten())
            .all(|number| number.is_finite());
        if times.is_empty() || !is_ordered || !is_finite {
            let fault = "has no times, or times that do not grow, or numbers that are not finite";
            return Err(self.fault(item(), fault, EXPORT_AGAIN));
        }
        let per_key = if interpolation == Interpolation::CubicSpline {
            3
        } else {
            1
        };
        if values.len() != per_key * times.len() {
            let fault = format!("has {} values for {} times", values.len(), times.len());
            return Err(self.fault(item(), fault, EXPORT_AGAIN));
        }
        Ok(Curve {
            interpolation,
            times,
            values,
        })
    }

    /// The file's animations, for people.
    pub(super) fn animations(&self) -> Result<Vec<Animation>, GltfError> {
        let info = |number: usize| {
            let animation = &self.root.animations[number];
            let mut seconds = [f64::INFINITY, f64::NEG_INFINITY];
            for sampler in &animation.samplers {
                for [time] in self
                    .accessor(sampler.input.value())?
                    .vectors::<1>()?
                    .iter()
                    .copied()
                {
                    seconds = [seconds[0].min(time.into()), seconds[1].max(time.into())];
                }
            }
            Ok(Animation {
                name: self.animation_name(number),
                seconds,
                channels: animation.channels.len(),
            })
        };
        (0..self.root.animations.len()).map(info).collect()
    }
}

fn vector([x, y, z, _]: [f64; 4]) -> DVec3 {
    DVec3::new(x, y, z)
}

/// The values of a property over time: one for each time, or three, of which the first and the last are tangents.
#[derive(Debug)]
struct Curve {
    interpolation: Interpolation,
    /// At least one; they grow.
    times: Vec<f64>,
    values: Vec<[f64; 4]>,
}

impl Curve {
    /// The key before a time, and how far it is to the next, from 0 to 1; nothing where the curve stands still.
    fn between(&self, seconds: f64) -> Result<(usize, f64), usize> {
        let next = self.times.partition_point(|&time| time <= seconds);
        if next == 0 {
            return Err(0);
        }
        let Some(end) = self.times.get(next) else {
            return Err(next - 1);
        };
        let start = self.times[next - 1];
        Ok((next - 1, (seconds - start) / (end - start)))
    }

    fn value(&self, key: usize) -> [f64; 4] {
        match self.interpolation {
            Interpolation::CubicSpline => self.values[3 * key + 1],
            _ => self.values[key],
        }
    }

    fn at(&self, seconds: f64) -> [f64; 4] {
        let (key, u) = match self.between(seconds) {
            Ok(place) => place,
            Err(key) => return self.value(key),
        };
        let (a, b) = (self.value(key), self.value(key + 1));
        match self.interpolation {
            Interpolation::Step => a,
            Interpolation::Linear => std::array::from_fn(|i| a[i] + (b[i] - a[i]) * u),
            Interpolation::CubicSpline => {
                let length = self.times[key + 1] - self.times[key];
                let (out, into) = (self.values[3 * key + 2], self.values[3 * key + 3]);
                let (u2, u3) = (u * u, u * u * u);
                std::array::from_fn(|i| {
                    (2.0 * u3 - 3.0 * u2 + 1.0) * a[i]
                        + length * (u3 - 2.0 * u2 + u) * out[i]
                        + (3.0 * u2 - 2.0 * u3) * b[i]
                        + length * (u3 - u2) * into[i]
                })
            }
        }
    }

    fn rotation_at(&self, seconds: f64) -> DQuat {
        let quaternion = |value: [f64; 4]| node::rotation(DQuat::from_array(value));
        match (self.interpolation, self.between(seconds)) {
            (Interpolation::Linear, Ok((key, u))) => {
                let [a, b] = [self.value(key), self.value(key + 1)].map(quaternion);
                // glam takes the shorter of both arcs.
                a.slerp(b, u)
            }
            _ => quaternion(self.at(seconds)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(interpolation: Interpolation, times: &[f64], values: &[[f64; 4]]) -> Curve {
        Curve {
            interpolation,
            times: times.to_vec(),
            values: values.to_vec(),
        }
    }

    fn x(value: f64) -> [f64; 4] {
        [value, 0.0, 0.0, 0.0]
    }

    #[test]
    fn steps_wait_lines_go_and_both_stop_at_the_ends() {
        let times = [1.0, 2.0, 4.0];
        let values = [x(10.0), x(20.0), x(40.0)];
        let at = |interpolation, seconds| curve(interpolation, &times, &values).at(seconds)[0];
        let steps = [0.0, 1.5, 2.0, 3.9, 4.0, 9.0].map(|seconds| at(Interpolation::Step, seconds));
        assert_eq!(steps, [10.0, 10.0, 20.0, 20.0, 40.0, 40.0]);
        let lines = [0.0, 1.5, 2.0, 3.0, 4.0, 9.0].map(|seconds| at(Interpolation::Linear, seconds));
        assert_eq!(lines, [10.0, 15.0, 20.0, 30.0, 40.0, 40.0]);
    }

    #[test]
    fn a_spline_takes_its_tangents_times_the_step() {
        // From 0 to 1 in 2 s, leaving at 3 a second and arriving at -1: in the middle 1/2 + 2 (3 - -1) / 8.
        let values = [x(0.0), x(0.0), x(3.0), x(-1.0), x(1.0), x(0.0)];
        let spline = curve(Interpolation::CubicSpline, &[0.0, 2.0], &values);
        assert_eq!(
            [-1.0, 0.0, 1.0, 2.0, 3.0].map(|t| spline.at(t)[0]),
            [0.0, 0.0, 1.5, 1.0, 1.0]
        );
    }

    #[test]
    fn rotations_take_the_shorter_way_and_are_made_unit() {
        let quarter = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
        // Twice as long, and the other of the two quaternions of that rotation.
        let other = (quarter * -2.0).to_array();
        let turns = curve(Interpolation::Linear, &[0.0, 1.0], &[[0.0, 0.0, 0.0, 1.0], other]);
        let half = turns.rotation_at(0.5);
        let expected = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_4);
        assert!(half.dot(expected).abs() > 1.0 - 4.0 * f64::EPSILON, "{half}");
    }
}
