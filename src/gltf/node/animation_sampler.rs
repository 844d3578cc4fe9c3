//! Interpolation of an animated property over time (glTF 2.0, appendix C).
//!
//! Between keyframes values change by steps, linearly (rotations along the shorter arc), or by a cubic spline through
//! values with tangents. Before the first time a property has the first value, after the last time the last.

use glam::DQuat;
use gltf::json::animation::Interpolation;

use crate::gltf::node::node_transform::rotation;

/// Keyframes and their interpolation.
#[derive(Debug)]
pub(in crate::gltf) struct AnimationSampler {
    pub(in crate::gltf) interpolation: Interpolation,
    /// Count of numbers per value.
    pub(in crate::gltf) width: usize,
    /// Times of the keyframes in seconds: at least one, and strictly increasing.
    pub(in crate::gltf) times: Vec<f64>,
    /// Values of the keyframes; for a spline three of each: its incoming tangent, its value and its outgoing tangent.
    pub(in crate::gltf) values: Vec<f64>,
}

/// Position of a time among the keyframes.
enum KeyPosition {
    /// A keyframe's own value: at its time, before the first or after the last.
    Key(usize),
    /// A fraction, from 0 to 1, of the interval between a keyframe and the next.
    Between(usize, f64),
}

impl AnimationSampler {
    /// Returns the number of values per keyframe: the value itself and its tangents.
    pub(in crate::gltf) fn values_per_key(interpolation: Interpolation) -> usize {
        if interpolation == Interpolation::CubicSpline {
            3
        } else {
            1
        }
    }

    /// Returns the value at a time.
    pub(in crate::gltf) fn at(&self, seconds: f64) -> Vec<f64> {
        match self.key_position(seconds) {
            KeyPosition::Key(key) => self.value(key).to_vec(),
            KeyPosition::Between(key, u) => self.between(key, u),
        }
    }

    /// Returns the rotation at a time, for a sampler of quaternions.
    pub(in crate::gltf) fn rotation_at(&self, seconds: f64) -> DQuat {
        match (self.interpolation, self.key_position(seconds)) {
            (Interpolation::Linear, KeyPosition::Between(key, u)) => {
                let [a, b] = [key, key + 1].map(|key| quaternion(self.value(key)));
                // glam's slerp takes the shorter of the two arcs.
                a.slerp(b, u)
            }
            _ => quaternion(&self.at(seconds)),
        }
    }

    fn key_position(&self, seconds: f64) -> KeyPosition {
        // Binary search for the first keyframe after the time
        let next = self.times.partition_point(|&time| time <= seconds);
        let Some(key) = next.checked_sub(1) else {
            return KeyPosition::Key(0);
        };
        let (start, Some(end)) = (self.times[key], self.times.get(next)) else {
            return KeyPosition::Key(key);
        };
        KeyPosition::Between(key, (seconds - start) / (end - start))
    }

    fn value(&self, key: usize) -> &[f64] {
        match self.interpolation {
            Interpolation::CubicSpline => self.numbers(3 * key + 1),
            _ => self.numbers(key),
        }
    }

    fn numbers(&self, index: usize) -> &[f64] {
        &self.values[index * self.width..][..self.width]
    }

    fn between(&self, key: usize, u: f64) -> Vec<f64> {
        let (a, b) = (self.value(key), self.value(key + 1));
        match self.interpolation {
            Interpolation::Step => a.to_vec(),
            Interpolation::Linear => a.iter().zip(b).map(|(a, b)| a + (b - a) * u).collect(),
            // Evaluate the cubic Hermite spline; tangents are per second
            Interpolation::CubicSpline => {
                let seconds = self.times[key + 1] - self.times[key];
                // Tangents out of this keyframe and into the next
                let (out, into) = (self.numbers(3 * key + 2), self.numbers(3 * key + 3));
                let (u2, u3) = (u * u, u * u * u);
                let value = |i: usize| {
                    (2.0 * u3 - 3.0 * u2 + 1.0) * a[i]
                        + seconds * (u3 - 2.0 * u2 + u) * out[i]
                        + (3.0 * u2 - 2.0 * u3) * b[i]
                        + seconds * (u3 - u2) * into[i]
                };
                (0..self.width).map(value).collect()
            }
        }
    }
}

/// Returns the rotation of a quaternion of four numbers.
fn quaternion(numbers: &[f64]) -> DQuat {
    rotation(DQuat::from_slice(numbers))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(interpolation: Interpolation, times: &[f64], values: &[f64]) -> AnimationSampler {
        AnimationSampler {
            interpolation,
            width: values.len() / times.len() / AnimationSampler::values_per_key(interpolation),
            times: times.to_vec(),
            values: values.to_vec(),
        }
    }

    #[test]
    fn step_and_linear_samplers_clamp_at_the_ends() {
        let at = |interpolation, seconds| {
            curve(interpolation, &[1.0, 2.0, 4.0], &[10.0, 20.0, 40.0]).at(seconds)[0]
        };
        let steps = [0.0, 1.5, 2.0, 3.9, 4.0, 9.0].map(|seconds| at(Interpolation::Step, seconds));
        assert_eq!(steps, [10.0, 10.0, 20.0, 20.0, 40.0, 40.0]);
        let lines = [0.0, 1.5, 2.0, 3.0, 4.0, 9.0].map(|seconds| at(Interpolation::Linear, seconds));
        assert_eq!(lines, [10.0, 15.0, 20.0, 30.0, 40.0, 40.0]);
    }

    #[test]
    fn spline_scales_its_tangents_by_the_time_step() {
        // From 0 to 1 in 2 s, leaving at 3 per second and arriving at -1: in the middle 1/2 + 2 (3 - -1) / 8.
        let spline = curve(
            Interpolation::CubicSpline,
            &[0.0, 2.0],
            &[0.0, 0.0, 3.0, -1.0, 1.0, 0.0],
        );
        assert_eq!(
            [-1.0, 0.0, 1.0, 2.0, 3.0].map(|t| spline.at(t)[0]),
            [0.0, 0.0, 1.5, 1.0, 1.0]
        );
    }

    #[test]
    fn vector_components_are_interpolated_separately() {
        let line = curve(Interpolation::Linear, &[0.0, 1.0], &[0.0, 8.0, 4.0, 16.0]);
        assert_eq!(line.at(0.25), [1.0, 10.0]);
    }

    #[test]
    fn rotations_take_the_shorter_arc_and_are_normalised() {
        let quarter = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
        // Twice as long, and the other of the two quaternions of that rotation.
        let other = (quarter * -2.0).to_array();
        let values = [[0.0, 0.0, 0.0, 1.0], other].concat();
        let half = curve(Interpolation::Linear, &[0.0, 1.0], &values).rotation_at(0.5);
        let expected = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_4);
        assert!(half.dot(expected).abs() > 1.0 - 4.0 * f64::EPSILON, "{half}");
    }
}
