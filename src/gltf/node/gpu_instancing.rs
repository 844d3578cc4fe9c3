//! Copies of a node's mesh: `EXT_mesh_gpu_instancing`.

use glam::{DAffine3, DQuat, DVec3};

use crate::buffer::Buffer;
use crate::gltf::GltfError;
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;
use crate::gltf::extension::{Corrections, Extension};
use crate::gltf::node::PlacedNode;
use crate::gltf::node::node_transform::rotation;

/// Name of the extension.
const NAME: &str = "EXT_mesh_gpu_instancing";

/// Place of one copy of a node's mesh.
pub(in crate::gltf) struct MeshPlacement {
    pub(in crate::gltf) node: usize,
    /// Number of the copy; `None` if the node places its mesh once.
    pub(in crate::gltf) copy: Option<usize>,
    pub(in crate::gltf) world_from_mesh: DAffine3,
}

impl GltfDocument {
    /// Returns the places of a node's mesh: one, or those that `EXT_mesh_gpu_instancing` lists. A deformed mesh is
    /// placed once, as the extension defines no copies of it.
    pub(in crate::gltf) fn placements(&self, node: &PlacedNode) -> Result<Vec<MeshPlacement>, GltfError> {
        let once = MeshPlacement {
            node: node.number,
            copy: None,
            world_from_mesh: node.world_from_mesh(),
        };
        if node.deformed.is_some() {
            return Ok(vec![once]);
        }
        let Some(transforms) = self.copies(node.number)? else {
            return Ok(vec![once]);
        };
        let placement = |(copy, node_from_mesh)| MeshPlacement {
            copy: Some(copy),
            world_from_mesh: node.world_from_node * node_from_mesh,
            ..once
        };
        Ok(transforms.into_iter().enumerate().map(placement).collect())
    }

    /// Returns the mesh-to-node transforms of the copies; `None` without the extension.
    fn copies(&self, node: usize) -> Result<Option<Vec<DAffine3>>, GltfError> {
        let extensions = self.root.nodes[node].extensions.as_ref().map(|e| &e.others);
        let mut corrections = Corrections::default();
        let instancing = Extension::of(extensions, NAME, &mut corrections);
        let attributes = instancing.nested("attributes", &mut corrections);
        if !attributes.is_present() {
            return Ok(None);
        }
        // Read the attributes that are there, all of the same length
        let index = |name, corrections: &mut Corrections| attributes.index(name, corrections);
        let translations = self.copy_attribute::<3>(index("TRANSLATION", &mut corrections))?;
        let rotations = self.copy_attribute::<4>(index("ROTATION", &mut corrections))?;
        let scales = self.copy_attribute::<3>(index("SCALE", &mut corrections))?;
        let counts = [
            translations.as_ref().map(|values| values.len()),
            rotations.as_ref().map(|values| values.len()),
            scales.as_ref().map(|values| values.len()),
        ];
        let mut counts = counts.into_iter().flatten();
        let Some(count) = counts.next() else {
            return Ok(None);
        };
        if counts.any(|other| other != count) || !corrections.names.is_empty() {
            let fault = format!("has attributes of {NAME} that are invalid or of different lengths");
            return Err(self.fault(self.node_item(node), fault, EXPORT_AGAIN));
        }
        // Compose each copy's scale, rotation and translation
        let vector = |values: &Option<Buffer<[f32; 3]>>, copy: usize, default: DVec3| {
            values
                .as_ref()
                .map_or(default, |values| DVec3::from_array(values[copy].map(f64::from)))
        };
        let transform = |copy: usize| {
            let turn = rotations.as_ref().map_or(DQuat::IDENTITY, |values| {
                rotation(DQuat::from_array(values[copy].map(f64::from)))
            });
            DAffine3::from_scale_rotation_translation(
                vector(&scales, copy, DVec3::ONE),
                turn,
                vector(&translations, copy, DVec3::ZERO),
            )
        };
        let transforms: Vec<DAffine3> = (0..count).map(transform).collect();
        match transforms.iter().all(|transform| transform.is_finite()) {
            true => Ok(Some(transforms)),
            false => {
                let fault = format!("has copies by {NAME} that are not finite");
                Err(self.fault(self.node_item(node), fault, EXPORT_AGAIN))
            }
        }
    }

    fn copy_attribute<const N: usize>(
        &self,
        accessor: Option<u32>,
    ) -> Result<Option<Buffer<[f32; N]>>, GltfError>
    where
        [f32; N]: bytemuck::Pod,
    {
        let read = |number: u32| self.accessor(number as usize)?.vectors();
        accessor.map(read).transpose()
    }
}
