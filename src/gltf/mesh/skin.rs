//! Skins: joints that transform the vertices of a mesh (glTF 2.0, section 3.7.3).
//!
//! Each vertex is transformed by the weighted mean of its joints' maps, regardless of the mesh node's own transform.
//! The means are taken about a point near the mesh, so that a figure far from the world's origin keeps its shape in
//! f32.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DVec3};
use gltf::json;
use json::mesh::Semantic;
use json::validation::Checked;

use crate::buffer::Buffer;
use crate::gltf::GltfError;
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;
use crate::gltf::mesh::primitive_id::PrimitiveId;
use crate::parallel;

/// Number of vertices per parallel task.
const CHUNK: usize = 1 << 12;

/// The joint maps of a skin at one time.
#[derive(Debug, PartialEq)]
pub(in crate::gltf) struct Joints {
    /// Transform of the space that skinned vertices are in.
    pub(in crate::gltf) world_from_mesh: DAffine3,
    /// Maps from the bind space to the space of the skinned mesh, one per joint.
    mesh_from_bind: Vec<DAffine3>,
}

/// One set of joint numbers and weights, four per vertex.
struct Influences {
    joints: Buffer<[f32; 4]>,
    weights: Buffer<[f32; 4]>,
}

impl GltfDocument {
    /// Returns the joint maps of a skin; `world_transforms` are the world transforms of the scene's nodes.
    pub(in crate::gltf) fn joints(
        &self,
        skin: usize,
        world_transforms: &HashMap<usize, DAffine3>,
    ) -> Result<Joints, GltfError> {
        let skins = &self.root.skins;
        let Some(form) = skins.get(skin) else {
            return Err(self.missing("skin", skin, skins.len()));
        };
        // Compose each joint's world transform with its inverse bind matrix
        let binds = self.inverse_binds(skin, form)?;
        let mut world_from_bind = Vec::with_capacity(binds.len());
        for (joint, bind) in form.joints.iter().zip(binds) {
            let Some(world_from_joint) = world_transforms.get(&joint.value()) else {
                let fault = format!("has node {} as a joint, which the scene lacks", joint.value());
                return Err(self.fault(self.skin_item(skin), fault, EXPORT_AGAIN));
            };
            world_from_bind.push(*world_from_joint * bind);
        }
        // Move the origin to the first joint, for precision in f32
        let origin = world_from_bind
            .first()
            .map_or(DVec3::ZERO, |first| first.translation);
        for map in &mut world_from_bind {
            map.translation -= origin;
        }
        Ok(Joints {
            world_from_mesh: DAffine3::from_translation(origin),
            mesh_from_bind: world_from_bind,
        })
    }

    /// Returns one map per joint, from the bind space to the joint's space.
    fn inverse_binds(&self, skin: usize, form: &json::skin::Skin) -> Result<Vec<DAffine3>, GltfError> {
        let fault = |fault: String| Err(self.fault(self.skin_item(skin), fault, EXPORT_AGAIN));
        let joint_count = form.joints.len();
        if joint_count == 0 {
            return fault("has no joints".into());
        }
        let Some(accessor) = &form.inverse_bind_matrices else {
            return Ok(vec![DAffine3::IDENTITY; joint_count]);
        };
        let matrices = self.accessor(accessor.value())?.vectors::<16>()?;
        if matrices.len() < joint_count {
            return fault(format!(
                "has {} inverse bind matrices for {joint_count} joints",
                matrices.len()
            ));
        }
        let maps: Vec<DAffine3> = matrices.iter().take(joint_count).map(affine).collect();
        if !maps.iter().all(|map| map.is_finite()) {
            return fault("has inverse bind matrices that are not finite".into());
        }
        Ok(maps)
    }

    fn skin_item(&self, skin: usize) -> String {
        match self.root.skins.get(skin).and_then(|form| form.name.as_ref()) {
            Some(name) if !name.is_empty() => format!("skin {skin} `{name}`"),
            _ => format!("skin {skin}"),
        }
    }

    /// Returns the map of each vertex of a primitive.
    pub(in crate::gltf) fn vertex_maps(
        &self,
        id: PrimitiveId,
        joints: &Joints,
        vertex_count: usize,
    ) -> Result<Vec<DAffine3>, GltfError> {
        let sets = self.influences(id, vertex_count)?;
        let map = |vertex: usize| {
            let map = joints.mean_map(&sets, vertex);
            map.map_err(|fault| {
                let fault = format!("has at vertex {vertex} {fault}");
                self.fault(self.primitive_item(id), fault, EXPORT_AGAIN)
            })
        };
        let in_chunk = |chunk: usize| -> Result<Vec<DAffine3>, GltfError> {
            let first = chunk * CHUNK;
            (first..vertex_count.min(first + CHUNK)).map(map).collect()
        };
        Ok(parallel::try_map(vertex_count.div_ceil(CHUNK), &in_chunk)?.concat())
    }

    /// Returns all sets of joints and weights of a primitive: at least one.
    fn influences(&self, id: PrimitiveId, vertex_count: usize) -> Result<Vec<Influences>, GltfError> {
        let fault = |fault: String| Err(self.fault(self.primitive_item(id), fault, EXPORT_AGAIN));
        let attributes = &self.primitive(id).attributes;
        let number = |semantic| {
            attributes
                .get(&Checked::Valid(semantic))
                .map(|index| index.value())
        };
        let mut sets = Vec::new();
        for set in 0.. {
            // Every set needs both accessors; the first absent one ends the list
            let (joints, weights) = match (number(Semantic::Joints(set)), number(Semantic::Weights(set))) {
                (Some(joints), Some(weights)) => (joints, weights),
                (None, None) if set > 0 => break,
                _ => {
                    let sentence = format!("has a skin, but not both JOINTS_{set} and WEIGHTS_{set}");
                    return fault(sentence);
                }
            };
            // Check that every vertex has its joints and weights
            let joints = self.accessor(joints)?.vectors::<4>()?;
            let weights = self.accessor(weights)?.vectors::<4>()?;
            if joints.len() != vertex_count || weights.len() != vertex_count {
                return fault(format!(
                    "has joints for {} and weights for {} of {vertex_count} vertices",
                    joints.len(),
                    weights.len()
                ));
            }
            sets.push(Influences { joints, weights });
        }
        Ok(sets)
    }
}

impl Joints {
    /// Returns whether every joint map is mirroring.
    pub(in crate::gltf) fn are_mirrored(&self) -> bool {
        self.mesh_from_bind
            .iter()
            .all(|map| map.matrix3.determinant() < 0.0)
    }

    /// Returns the weighted mean of the maps of a vertex's joints, whatever the weights sum to; else their fault.
    fn mean_map(&self, sets: &[Influences], vertex: usize) -> Result<DAffine3, String> {
        let (mut matrix, mut translation, mut sum) = (DMat3::ZERO, DVec3::ZERO, 0.0);
        for set in sets {
            for (&joint, &weight) in set.joints[vertex].iter().zip(&set.weights[vertex]) {
                if weight == 0.0 {
                    // A joint with weight zero may have any number.
                    continue;
                }
                if !(weight > 0.0 && weight.is_finite()) {
                    return Err(format!("the weight {weight}"));
                }
                let Some(map) = self.map_of(joint) else {
                    return Err(self.missing_joint(joint));
                };
                let weight = f64::from(weight);
                matrix += map.matrix3 * weight;
                translation += map.translation * weight;
                sum += weight;
            }
        }
        // Normalise by the sum of the weights
        if sum == 0.0 {
            return self.unweighted_map(sets, vertex);
        }
        Ok(DAffine3::from_mat3_translation(
            matrix * sum.recip(),
            translation / sum,
        ))
    }

    /// Returns the map of a vertex whose weights are all zero: that of the first of its joints. Valid files have such
    /// vertices.
    fn unweighted_map(&self, sets: &[Influences], vertex: usize) -> Result<DAffine3, String> {
        let first = sets.first().map_or(0.0, |set| set.joints[vertex][0]);
        let map = self.map_of(first).copied();
        map.ok_or_else(|| self.missing_joint(first))
    }

    fn missing_joint(&self, joint: f32) -> String {
        let count = self.mesh_from_bind.len();
        format!("the joint {joint}, but its skin has {count}")
    }

    /// Returns the map of a joint, whose number is stored as a float.
    fn map_of(&self, joint: f32) -> Option<&DAffine3> {
        // The cast saturates, so a negative or fractional number must be rejected here
        let is_number = joint >= 0.0 && joint.fract() == 0.0;
        self.mesh_from_bind.get(joint as usize).filter(|_| is_number)
    }
}

/// Returns the affine map of a column-major matrix. Its last row has to be 0, 0, 0, 1 and is taken as that.
fn affine(matrix: &[f32; 16]) -> DAffine3 {
    let column = |c: usize| DVec3::from_array([4 * c, 4 * c + 1, 4 * c + 2].map(|i| f64::from(matrix[i])));
    DAffine3::from_mat3_translation(DMat3::from_cols(column(0), column(1), column(2)), column(3))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joints() -> Joints {
        Joints {
            world_from_mesh: DAffine3::IDENTITY,
            mesh_from_bind: vec![
                DAffine3::IDENTITY,
                DAffine3::from_translation(DVec3::new(8.0, 0.0, 0.0)),
                DAffine3::from_scale(DVec3::splat(2.0)),
            ],
        }
    }

    fn set(joints: [f32; 4], weights: [f32; 4]) -> Influences {
        Influences {
            joints: Buffer::from(vec![joints]),
            weights: Buffer::from(vec![weights]),
        }
    }

    #[test]
    fn weights_are_normalised_over_all_sets() {
        // 1 of 4 stays, 2 of 4 move by 8, 1 of 4 doubles: (1, 2, 3) (1 + 2 + 2) / 4 + (4, 0, 0).
        let sets = [
            set([0.0, 1.0, 9.0, 0.0], [0.5, 1.0, 0.0, 0.0]),
            set([2.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0]),
        ];
        let map = joints().mean_map(&sets, 0).unwrap();
        let moved = map.transform_point3(DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(moved, DVec3::new(1.25 + 4.0, 2.5, 3.75));
    }

    #[test]
    fn vertex_without_weights_follows_its_first_joint() {
        let map = joints()
            .mean_map(&[set([1.0, 2.0, 0.0, 0.0], [0.0; 4])], 0)
            .unwrap();
        assert_eq!(map.transform_point3(DVec3::ZERO), DVec3::new(8.0, 0.0, 0.0));
    }

    #[test]
    fn invalid_joints_and_weights_are_reported() {
        let fault = |joint, weight| {
            let set = set([joint, 0.0, 0.0, 0.0], [weight, 0.0, 0.0, 0.0]);
            joints().mean_map(&[set], 0).unwrap_err()
        };
        assert_eq!(fault(7.0, 0.0), "the joint 7, but its skin has 3");
        assert_eq!(fault(0.0, -0.5), "the weight -0.5");
        assert_eq!(fault(0.0, f32::NAN), "the weight NaN");
        assert_eq!(fault(3.0, 1.0), "the joint 3, but its skin has 3");
        for joint in [-1.0, 0.5, f32::NAN, f32::INFINITY] {
            assert!(fault(joint, 1.0).starts_with("the joint"), "{joint}");
        }
    }

    #[test]
    fn winding_flips_only_if_all_joints_mirror() {
        let mut joints = joints();
        assert!(!joints.are_mirrored());
        let mirror = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        joints.mesh_from_bind = vec![mirror; 2];
        assert!(joints.are_mirrored());
    }
}
