//! Meshes compressed with Draco: `KHR_draco_mesh_compression`.
//!
//! Every compressed mesh in use is decoded once, in parallel with the others, and its indices and attributes become the
//! contents of the accessors that its primitives name. All else then reads accessors as in any other file.

use std::collections::HashMap;

use draco_core::draco_types::DataType;
use draco_core::geometry_attribute::PointAttribute;
use draco_core::geometry_indices::PointIndex;
use draco_core::{DecodeLimits, DecoderBuffer, Mesh, MeshDecoder};
use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use json::mesh::Mode;
use json::validation::Checked;

use crate::gltf::GltfError;
use crate::gltf::buffer::bytes::DecodedAccessor;
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;
use crate::gltf::extension::{Corrections, Extension};
use crate::gltf::mesh::primitive_id::PrimitiveId;
use crate::gltf::node::PlacedNode;
use crate::parallel;

/// Name of the extension.
const NAME: &str = "KHR_draco_mesh_compression";

/// Accessors that one compressed mesh fills.
struct CompressedMesh {
    /// Primitive that names the mesh first, for messages.
    id: PrimitiveId,
    view: usize,
    /// Numbers of the accessors of indices.
    indices: Vec<usize>,
    attributes: Vec<CompressedAttribute>,
}

/// Attribute of a compressed mesh, and the accessor that it fills.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct CompressedAttribute {
    accessor: usize,
    /// Identity of the attribute within the compressed mesh.
    unique_id: u32,
}

impl GltfDocument {
    /// Decodes the compressed meshes of visible nodes.
    pub(in crate::gltf) fn decode_draco(&mut self, nodes: &[PlacedNode]) -> Result<(), GltfError> {
        let meshes = self.compressed_meshes(nodes)?;
        let decoded = parallel::try_map(meshes.len(), &|index| self.decode_mesh(&meshes[index]))?;
        self.decoded_accessors.extend(decoded.into_iter().flatten());
        Ok(())
    }

    /// Returns the compressed meshes of visible nodes, each once.
    fn compressed_meshes(&self, nodes: &[PlacedNode]) -> Result<Vec<CompressedMesh>, GltfError> {
        let mut ids = Vec::new();
        for node in nodes {
            ids.extend(self.primitives_at(node)?);
        }
        ids.sort_unstable();
        ids.dedup();
        // Gather the accessors by buffer view, which primitives may share
        let mut meshes: Vec<CompressedMesh> = Vec::new();
        let mut number_of_view: HashMap<usize, usize> = HashMap::new();
        for id in ids {
            let Some(mesh) = self.compressed_mesh(id)? else {
                continue;
            };
            match number_of_view.get(&mesh.view) {
                None => {
                    number_of_view.insert(mesh.view, meshes.len());
                    meshes.push(mesh);
                }
                Some(&known) => {
                    meshes[known].indices.extend(mesh.indices);
                    meshes[known].attributes.extend(mesh.attributes);
                }
            }
        }
        for mesh in &mut meshes {
            mesh.indices.sort_unstable();
            mesh.indices.dedup();
            mesh.attributes.sort_unstable();
            mesh.attributes.dedup();
        }
        Ok(meshes)
    }

    /// Returns the compressed mesh of a primitive; `None` if the primitive is not compressed.
    fn compressed_mesh(&self, id: PrimitiveId) -> Result<Option<CompressedMesh>, GltfError> {
        let primitive = self.primitive(id);
        let extensions = primitive.extensions.as_ref().map(|e| &e.others);
        let mut corrections = Corrections::default();
        let extension = Extension::of(extensions, NAME, &mut corrections);
        if !extension.is_present() {
            return Ok(None);
        }
        let view = extension.index("bufferView", &mut corrections);
        let (Some(view), Some(indices)) = (view, primitive.indices) else {
            return Err(self.bad_mesh(id, "names no buffer view or no indices"));
        };
        // Decoded meshes are lists of triangles
        if primitive.mode != Checked::Valid(Mode::Triangles) {
            return Err(self.bad_mesh(id, "is not a list of triangles"));
        }
        // Match the attributes by their names
        let unique_ids = extension.nested("attributes", &mut corrections);
        let mut attributes = Vec::new();
        for (semantic, accessor) in &primitive.attributes {
            let unique_id = unique_ids.named_index(&semantic.to_string());
            attributes.extend(unique_id.map(|unique_id| CompressedAttribute {
                accessor: accessor.value(),
                unique_id,
            }));
        }
        Ok(Some(CompressedMesh {
            id,
            view: view as usize,
            indices: vec![indices.value()],
            attributes,
        }))
    }

    /// Decodes a mesh to the contents of its accessors.
    fn decode_mesh(&self, source: &CompressedMesh) -> Result<Vec<(usize, DecodedAccessor)>, GltfError> {
        let bytes = self.view(source.view)?.bytes;
        let limits = DecodeLimits::default().with_max_decoded_bytes(MAX_DECODED_BYTES);
        let mut mesh = Mesh::new();
        let mut stream = DecoderBuffer::new(bytes).with_limits(limits);
        MeshDecoder::new()
            .decode(&mut stream, &mut mesh)
            .map_err(|error| self.bad_mesh(source.id, &format!("cannot be decoded ({error})")))?;
        // Extract the indices and the attributes that the primitives name
        let mut decoded = Vec::new();
        for &accessor in &source.indices {
            decoded.push((accessor, indices(&mesh)));
        }
        for attribute in &source.attributes {
            let Some(values) = mesh.attribute_by_unique_id(attribute.unique_id) else {
                let fault = format!("lacks the attribute with the identity {}", attribute.unique_id);
                return Err(self.bad_mesh(source.id, &fault));
            };
            match point_values(values, mesh.num_points()) {
                Some(contents) => decoded.push((attribute.accessor, contents)),
                None => {
                    return Err(
                        self.bad_mesh(source.id, "has an attribute of a type that glTF does not define")
                    );
                }
            }
        }
        Ok(decoded)
    }

    fn bad_mesh(&self, id: PrimitiveId, fault: &str) -> GltfError {
        let fault = format!("is compressed with Draco, but {fault}");
        self.fault(self.primitive_item(id), fault, EXPORT_AGAIN)
    }
}

/// Largest size in bytes of the attributes of one mesh, which a few bytes may state.
const MAX_DECODED_BYTES: u64 = 8 << 30;

/// Returns the triangles as indices of 32 bits.
fn indices(mesh: &Mesh) -> DecodedAccessor {
    let corners = mesh.faces().as_flattened();
    DecodedAccessor {
        bytes: corners.iter().flat_map(|corner| corner.0.to_le_bytes()).collect(),
        count: corners.len(),
        component: ComponentType::U32,
        type_: Type::Scalar,
    }
}

/// Returns the values of an attribute, one per point; `None` if glTF has no such type.
fn point_values(attribute: &PointAttribute, point_count: usize) -> Option<DecodedAccessor> {
    let component = match attribute.data_type() {
        DataType::Int8 => ComponentType::I8,
        DataType::Uint8 => ComponentType::U8,
        DataType::Int16 => ComponentType::I16,
        DataType::Uint16 => ComponentType::U16,
        DataType::Uint32 => ComponentType::U32,
        DataType::Float32 => ComponentType::F32,
        _ => return None,
    };
    let type_ = match attribute.num_components() {
        1 => Type::Scalar,
        2 => Type::Vec2,
        3 => Type::Vec3,
        4 => Type::Vec4,
        _ => return None,
    };
    // Copy the value of each point, or zeros where the stream gives none
    let size = usize::from(attribute.num_components()) * attribute.data_type().byte_length();
    let stride = usize::try_from(attribute.byte_stride()).ok()?;
    let values = attribute.buffer().data();
    let mut bytes = vec![0; point_count * size];
    for (point, element) in bytes.chunks_exact_mut(size).enumerate() {
        let index = attribute.mapped_index(PointIndex(point as u32)).0 as usize;
        let start = index.saturating_mul(stride);
        if let Some(value) = start.checked_add(size).and_then(|end| values.get(start..end)) {
            element.copy_from_slice(value);
        }
    }
    Some(DecodedAccessor {
        bytes,
        count: point_count,
        component,
        type_,
    })
}
