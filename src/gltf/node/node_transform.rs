//! Transforms of nodes: their parts, and the properties that animations replace.

use glam::{DAffine3, DQuat, DVec3};
use gltf::json;

/// Parts of a node's transform: scale, then rotation, then translation.
pub(in crate::gltf) struct TransformParts {
    pub(in crate::gltf) scale: DVec3,
    pub(in crate::gltf) rotation: DQuat,
    pub(in crate::gltf) translation: DVec3,
}

impl TransformParts {
    pub(in crate::gltf) fn transform(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }
}

/// Returns the node's own transform, in parts.
pub(in crate::gltf) fn parts(node: &json::Node) -> TransformParts {
    let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    TransformParts {
        scale: node.scale.map_or(DVec3::ONE, vector),
        rotation: node.rotation.map_or(DQuat::IDENTITY, |q| {
            rotation(DQuat::from_array(q.0.map(f64::from)))
        }),
        translation: node.translation.map_or(DVec3::ZERO, vector),
    }
}

/// Returns the rotation of a quaternion of any length; the identity if it has no valid direction.
pub(in crate::gltf) fn rotation(q: DQuat) -> DQuat {
    let length = q.length();
    if length > 0.0 && length.is_finite() {
        q * length.recip()
    } else {
        DQuat::IDENTITY
    }
}

/// Properties of a node that an animation replaces.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::gltf) struct NodeOverride {
    pub(in crate::gltf) translation: Option<DVec3>,
    pub(in crate::gltf) rotation: Option<DQuat>,
    pub(in crate::gltf) scale: Option<DVec3>,
    /// Weights of the morph targets of the node's mesh.
    pub(in crate::gltf) weights: Option<Vec<f64>>,
}

impl NodeOverride {
    /// Returns the node-to-parent transform: the node's own, with the animated properties replaced.
    pub(in crate::gltf) fn transform(&self, node: &json::Node) -> DAffine3 {
        // Properties without a channel keep the node's own values
        let own = parts(node);
        let moved = TransformParts {
            scale: self.scale.unwrap_or(own.scale),
            rotation: self.rotation.unwrap_or(own.rotation),
            translation: self.translation.unwrap_or(own.translation),
        };
        moved.transform()
    }
}
