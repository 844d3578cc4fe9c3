//! Deformed meshes: morph targets (glTF 2.0, section 3.7.2.2), then skins.
//!
//! Targets displace positions, normals and tangents by their weights; a skin then transforms them by its joints,
//! normals by the inverse transpose. All is computed in f64 and rounded to f32 once. A mesh with all weights zero and
//! no skin is not deformed, and its arrays stay as they are in the file.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use gltf::json;

use crate::buffer::Buffer;
use crate::gltf::GltfError;
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;
use crate::gltf::mesh::primitive_id::PrimitiveId;
use crate::gltf::mesh::skin::Joints;
use crate::gltf::node::node_transform::NodeOverride;
use crate::gltf::node::{Deformed, PlacedNode};
use crate::numeric;
use crate::parallel;

/// Deformation of the vertices of a mesh.
#[derive(Debug)]
pub(in crate::gltf) struct Deformation {
    /// Weights of the morph targets; empty if all are zero.
    weights: Vec<f64>,
    joints: Option<Arc<Joints>>,
}

/// A deformation prepared for the vertices of one primitive.
pub(in crate::gltf) struct Deformer {
    positions: Vec<Displacement>,
    normals: Vec<Displacement>,
    tangents: Vec<Displacement>,
    /// One map per vertex, for a skin.
    maps: Option<Vec<DAffine3>>,
    is_mirrored: bool,
}

/// Displacement vectors of a morph target, one per vertex, and its weight.
struct Displacement {
    weight: f64,
    vectors: Buffer<[f32; 3]>,
}

impl GltfDocument {
    /// Computes the distinct deformations of all meshes, and sets the `deformed` field of nodes that have one.
    pub(in crate::gltf) fn deform(
        &self,
        nodes: &mut [PlacedNode],
        moved: &HashMap<usize, NodeOverride>,
    ) -> Result<Vec<Deformation>, GltfError> {
        let joints = self.joints_of_skins(nodes)?;
        let mut deformations = Vec::new();
        let mut numbers: HashMap<(Vec<u64>, Option<usize>), usize> = HashMap::new();
        // Find the weights and the skin of the node's mesh
        for node in nodes {
            let weights = self.weights(node.number, moved)?;
            let skin = self.skin_of(node.number);
            if weights.is_empty() && skin.is_none() {
                continue;
            }
            // A skin replaces the node's own transform
            let joints = skin.and_then(|skin| joints.get(&skin)).cloned();
            let world_from_mesh = joints
                .as_ref()
                .map_or(node.world_from_node, |joints| joints.world_from_mesh);
            // Share equal deformations between nodes; NaN-free weights compare by their bits
            let bits = weights.iter().map(|weight| weight.to_bits()).collect();
            let deformation = *numbers.entry((bits, skin)).or_insert_with(|| {
                deformations.push(Deformation { weights, joints });
                deformations.len() - 1
            });
            node.deformed = Some(Deformed {
                deformation,
                world_from_mesh,
            });
        }
        Ok(deformations)
    }

    /// Returns the skin of a node that has a mesh.
    fn skin_of(&self, node: usize) -> Option<usize> {
        let node = &self.root.nodes[node];
        node.mesh?;
        node.skin.map(|skin| skin.value())
    }

    /// Returns the joints of every skin in use, by the skin's number.
    fn joints_of_skins(&self, nodes: &[PlacedNode]) -> Result<HashMap<usize, Arc<Joints>>, GltfError> {
        // List the skins in use, each once
        let mut skins: Vec<usize> = nodes
            .iter()
            .filter_map(|node| self.skin_of(node.number))
            .collect();
        skins.sort_unstable();
        skins.dedup();
        if skins.is_empty() {
            return Ok(HashMap::new());
        }
        // Index the world transforms by node number
        let world_transforms = nodes
            .iter()
            .map(|node| (node.number, node.world_from_node))
            .collect();
        skins
            .into_iter()
            .map(|skin| Ok((skin, Arc::new(self.joints(skin, &world_transforms)?))))
            .collect()
    }

    /// Returns the number of morph targets of a node's mesh.
    pub(in crate::gltf) fn target_count(&self, node: usize) -> usize {
        let mesh = self.root.nodes[node].mesh.map(|mesh| mesh.value());
        let primitives = mesh.and_then(|mesh| self.root.meshes.get(mesh));
        let primitives = primitives.iter().flat_map(|mesh| &mesh.primitives);
        // Primitives of a mesh should have equally many targets, but the file may be invalid
        let counts = primitives.map(|primitive| primitive.targets.as_ref().map_or(0, Vec::len));
        counts.max().unwrap_or(0)
    }

    /// Returns the weights of a node's targets: the animated ones, else the node's own, else its mesh's; empty if all
    /// are zero.
    fn weights(&self, node: usize, moved: &HashMap<usize, NodeOverride>) -> Result<Vec<f64>, GltfError> {
        let target_count = self.target_count(node);
        if target_count == 0 {
            return Ok(Vec::new());
        }
        let form = &self.root.nodes[node];
        let widened = |weights: &Vec<f32>| weights.iter().copied().map(f64::from).collect();
        let of_mesh = || self.root.meshes.get(form.mesh?.value())?.weights.as_ref();
        let own: Vec<f64> = form
            .weights
            .as_ref()
            .or_else(of_mesh)
            .map(widened)
            .unwrap_or_default();
        let animated = moved.get(&node).and_then(|moved| moved.weights.as_ref());
        // The file's own weights are checked even if the animation replaces them.
        for weights in [Some(&own), animated].into_iter().flatten() {
            self.check_weights(node, weights, target_count)?;
        }
        let weights = animated.cloned().unwrap_or(own);
        Ok(if weights.iter().all(|&weight| weight == 0.0) {
            Vec::new()
        } else {
            weights
        })
    }

    fn check_weights(&self, node: usize, weights: &[f64], target_count: usize) -> Result<(), GltfError> {
        let fault = if weights.iter().any(|weight| !weight.is_finite()) {
            "has weights of morph targets that are not finite".to_owned()
        } else if weights.len() > target_count {
            format!("has {} weights for {target_count} morph targets", weights.len())
        } else {
            return Ok(());
        };
        Err(self.fault(self.node_item(node), fault, EXPORT_AGAIN))
    }

    /// Reads the targets and the skin that a deformation needs of a primitive.
    pub(in crate::gltf) fn deformer(
        &self,
        id: PrimitiveId,
        deformation: &Deformation,
        vertex_count: usize,
    ) -> Result<Deformer, GltfError> {
        let targets = self.primitive(id).targets.as_deref().unwrap_or_default();
        let displacements = |of: fn(&json::mesh::MorphTarget) -> Option<usize>| {
            let used = targets.iter().zip(&deformation.weights);
            // Targets with weight zero are not read
            used.filter(|&(_, &weight)| weight != 0.0)
                .filter_map(|(target, &weight)| Some((of(target)?, weight)))
                .map(|(accessor, weight)| self.displacement(id, (accessor, weight), vertex_count))
                .collect::<Result<Vec<Displacement>, GltfError>>()
        };
        let joints = deformation.joints.as_deref();
        Ok(Deformer {
            positions: displacements(|target| target.positions.map(|index| index.value()))?,
            normals: displacements(|target| target.normals.map(|index| index.value()))?,
            tangents: displacements(|target| target.tangents.map(|index| index.value()))?,
            maps: joints
                .map(|joints| self.vertex_maps(id, joints, vertex_count))
                .transpose()?,
            is_mirrored: joints.is_some_and(Joints::are_mirrored),
        })
    }

    fn displacement(
        &self,
        id: PrimitiveId,
        (accessor, weight): (usize, f64),
        vertex_count: usize,
    ) -> Result<Displacement, GltfError> {
        let vectors = self.accessor(accessor)?.vectors()?;
        if vectors.len() != vertex_count {
            let fault = format!(
                "has a morph target of {} vertices for its {vertex_count}",
                vectors.len()
            );
            return Err(self.fault(self.primitive_item(id), fault, EXPORT_AGAIN));
        }
        Ok(Displacement { weight, vectors })
    }
}

impl Deformer {
    /// Returns the deformed positions.
    pub(in crate::gltf) fn positions(&self, positions: &[[f32; 3]]) -> Buffer<[f32; 3]> {
        mapped(positions, |vertex, position| {
            let p = displaced(&self.positions, vertex, position);
            let moved = self.map(vertex).map_or(p, |map| map.transform_point3(p));
            moved.as_vec3().to_array()
        })
    }

    /// Returns the triangles, with reversed winding if the skin mirrors, so that the front side stays the front side.
    pub(in crate::gltf) fn triangles(&self, triangles: Buffer<[u32; 3]>) -> Buffer<[u32; 3]> {
        if self.is_mirrored {
            mapped(&triangles, |_, [a, b, c]| [a, c, b])
        } else {
            triangles
        }
    }

    /// Returns the deformed normals: of unit length if a skin transforms them, and unchanged where it leaves them no
    /// direction.
    pub(in crate::gltf) fn normals(&self, normals: &[[f32; 3]]) -> Buffer<[f32; 3]> {
        mapped(normals, |vertex, normal| {
            let n = displaced(&self.normals, vertex, normal);
            let turned = match self.map(vertex) {
                None => n,
                Some(map) => numeric::transform_normal(&map.matrix3, n)
                    .try_normalize()
                    .unwrap_or(n),
            };
            turned.as_vec3().to_array()
        })
    }

    /// Returns the deformed tangents. Targets keep their handedness; a mirroring skin flips it, as normals stay
    /// outside.
    pub(in crate::gltf) fn tangents(&self, tangents: &[[f32; 4]]) -> Buffer<[f32; 4]> {
        let handedness = if self.is_mirrored { -1.0 } else { 1.0 };
        mapped(tangents, |vertex, [x, y, z, w]| {
            let t = displaced(&self.tangents, vertex, [x, y, z]);
            let turned = self.map(vertex).map_or(t, |map| map.matrix3 * t);
            turned.as_vec3().extend(w * handedness).to_array()
        })
    }

    fn map(&self, vertex: usize) -> Option<&DAffine3> {
        self.maps.as_ref().and_then(|maps| maps.get(vertex))
    }
}

/// Returns a vertex's vector with its weighted displacements added.
fn displaced(displacements: &[Displacement], vertex: usize, vector: [f32; 3]) -> DVec3 {
    let widened = |vector: [f32; 3]| DVec3::from_array(vector.map(f64::from));
    displacements.iter().fold(widened(vector), |sum, displacement| {
        sum + widened(displacement.vectors[vertex]) * displacement.weight
    })
}

/// Returns every element mapped, in parallel.
fn mapped<T: bytemuck::Pod + Send + Sync>(elements: &[T], map: impl Fn(usize, T) -> T + Sync) -> Buffer<T> {
    Buffer::from(parallel::generate(elements.len(), |i| map(i, elements[i])))
}
