//! Animations: transforms of nodes and weights of morph targets at a given time.
//!
//! Every channel animates one property of one node by a sampler of times and values, which `animation_sampler.rs`
//! interpolates.

use std::collections::HashMap;

use glam::DVec3;
use gltf::json;
use gltf::json::animation::Property;
use gltf::json::validation::Checked;

use crate::gltf::GltfError;
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;
use crate::gltf::node::animation_sampler::AnimationSampler;
use crate::gltf::node::node_transform::NodeOverride;
use crate::scene::Animation;

/// A time in an animation.
#[derive(Clone, Debug, PartialEq)]
pub struct AnimationTime {
    /// Name or number of the animation; all animations together if `None`.
    pub animation: Option<String>,
    /// Time in seconds from the beginning of the animation.
    pub seconds: f64,
}

impl GltfDocument {
    /// Evaluates the animations of a pose; returns the replaced properties by node number.
    pub(in crate::gltf) fn moved(
        &self,
        pose: &AnimationTime,
        warnings: &mut Vec<String>,
    ) -> Result<HashMap<usize, NodeOverride>, GltfError> {
        let mut moved = HashMap::new();
        for number in self.animations_of(pose, warnings)? {
            for channel in 0..self.root.animations[number].channels.len() {
                self.add_channel((number, channel), pose.seconds, &mut moved)?;
            }
        }
        Ok(moved)
    }

    /// Returns the numbers of the animations that a pose refers to.
    fn animations_of(
        &self,
        pose: &AnimationTime,
        warnings: &mut Vec<String>,
    ) -> Result<Vec<usize>, GltfError> {
        let animations = &self.root.animations;
        if animations.is_empty() {
            warnings.push("it has no animations: it is the same at all times".into());
            return Ok(Vec::new());
        }
        let Some(requested) = &pose.animation else {
            return Ok((0..animations.len()).collect());
        };
        // Find the animation by its name, else by its number
        let named = animations
            .iter()
            .position(|animation| animation.name.as_ref() == Some(requested));
        let number = named.or_else(|| {
            requested
                .parse()
                .ok()
                .filter(|&number: &usize| number < animations.len())
        });
        number.map(|number| vec![number]).ok_or_else(|| {
            let known: Vec<String> = (0..animations.len())
                .map(|number| format!("{number} `{}`", self.animation_name(number)))
                .collect();
            let fault = format!("does not exist: the file has {}", known.join(", "));
            self.fault(format!("animation `{requested}`"), fault, "name one of them")
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
        moved: &mut HashMap<usize, NodeOverride>,
    ) -> Result<(), GltfError> {
        let channel = &self.root.animations[animation].channels[channel];
        let (node, property) = self.target(animation, &channel.target)?;
        // Find the number of components of a value
        let width = match property {
            Property::Translation | Property::Scale => 3,
            Property::Rotation => 4,
            Property::MorphTargetWeights => self.target_count(node),
            // Evaluate the sampler at the pose's time
        };
        let curve = self.curve(animation, channel.sampler.value(), (property, width))?;
        let place = moved.entry(node).or_default();
        match property {
            Property::Translation => place.translation = Some(DVec3::from_slice(&curve.at(seconds))),
            Property::Scale => place.scale = Some(DVec3::from_slice(&curve.at(seconds))),
            Property::Rotation => place.rotation = Some(curve.rotation_at(seconds)),
            Property::MorphTargetWeights => place.weights = Some(curve.at(seconds)),
        }
        Ok(())
    }

    /// Returns the node and the property that a channel animates; an error if the property cannot be animated.
    fn target(
        &self,
        animation: usize,
        target: &json::animation::Target,
    ) -> Result<(usize, Property), GltfError> {
        let node = target.node.value();
        if node >= self.root.nodes.len() {
            return Err(self.missing("node", node, self.root.nodes.len()));
        }
        let fault = |fault: String, remedy| {
            let item = format!("animation `{}`", self.animation_name(animation));
            Err(self.fault(item, fault, remedy))
        };
        let item = self.node_item(node);
        match target.path {
            Checked::Invalid => fault(
                "animates a property that glTF 2.0 does not define".into(),
                EXPORT_AGAIN,
            ),
            Checked::Valid(Property::MorphTargetWeights) if self.target_count(node) == 0 => {
                fault(format!("morphs {item}, whose mesh has no targets"), EXPORT_AGAIN)
            }
            Checked::Valid(Property::MorphTargetWeights) => Ok((node, Property::MorphTargetWeights)),
            // glTF 2.0 forbids animating a node that has a matrix
            Checked::Valid(_) if self.root.nodes[node].matrix.is_some() => fault(
                format!("animates {item}, which has a matrix"),
                "give the node translation, rotation and scale",
            ),
            Checked::Valid(property) => Ok((node, property)),
        }
    }

    /// Reads a sampler with `width` numbers for each value of the property, and checks it.
    fn curve(
        &self,
        animation: usize,
        sampler: usize,
        (property, width): (Property, usize),
    ) -> Result<AnimationSampler, GltfError> {
        let samplers = &self.root.animations[animation].samplers;
        let name = self.animation_name(animation);
        let fault = |fault: String| {
            self.fault(
                format!("sampler {sampler} of animation `{name}`"),
                fault,
                EXPORT_AGAIN,
            )
        };
        let form = samplers
            .get(sampler)
            .ok_or_else(|| self.missing("sampler", sampler, samplers.len()))?;
        let Checked::Valid(interpolation) = form.interpolation else {
            return Err(fault("has an interpolation that glTF 2.0 does not define".into()));
        };
        // Read the times and the values
        let times = self.numbers::<1>(form.input.value())?;
        let values = match property {
            Property::Translation | Property::Scale => self.numbers::<3>(form.output.value())?,
            Property::Rotation => self.numbers::<4>(form.output.value())?,
            Property::MorphTargetWeights => self.numbers::<1>(form.output.value())?,
        };
        // Times must increase strictly, as the sampler is searched by time
        let is_ordered = times.windows(2).all(|pair| pair[0] < pair[1]);
        let is_finite = times.iter().chain(&values).all(|number| number.is_finite());
        if times.is_empty() || !is_ordered || !is_finite {
            return Err(fault(
                "has no times, or times that do not increase, or numbers that are not finite".into(),
            ));
        }
        // Check that every time has its values
        let values_per_key = AnimationSampler::values_per_key(interpolation);
        if Some(values.len()) != times.len().checked_mul(values_per_key * width) {
            return Err(fault(format!(
                "has {} numbers for {} times, where each needs {}",
                values.len(),
                times.len(),
                values_per_key * width
            )));
        }
        Ok(AnimationSampler {
            interpolation,
            width,
            times,
            values,
        })
    }

    /// Returns the numbers of an accessor of vectors, one after the other.
    fn numbers<const N: usize>(&self, accessor: usize) -> Result<Vec<f64>, GltfError>
    where
        [f32; N]: bytemuck::Pod,
    {
        let vectors = self.accessor(accessor)?.vectors::<N>()?;
        Ok(vectors.iter().flatten().copied().map(f64::from).collect())
    }

    /// Returns names, times and channel counts of the file's animations, for reports.
    pub(in crate::gltf) fn animations(&self) -> Result<Vec<Animation>, GltfError> {
        (0..self.root.animations.len())
            .map(|number| {
                let animation = &self.root.animations[number];
                let mut times = Vec::new();
                for sampler in &animation.samplers {
                    times.extend(self.numbers::<1>(sampler.input.value())?);
                }
                Ok(Animation {
                    name: self.animation_name(number),
                    seconds: [
                        times.iter().copied().reduce(f64::min).unwrap_or_default(),
                        times.iter().copied().reduce(f64::max).unwrap_or_default(),
                    ],
                    channels: animation.channels.len(),
                })
            })
            .collect()
    }
}
