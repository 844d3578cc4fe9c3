//! Writing of binary glTF files (`.glb`): meshes with vertex colours that viewers show without any light, and cameras.
//!
//! Materials are unlit (`KHR_materials_unlit`), so that viewers show the colours themselves. Colours are linear and have 16
//! bits (Khronos, glTF 2.0, section 3.7.2).

use std::io::{self, Write};

use glam::{DAffine3, DMat4};
use serde_json::{Value, json};

use crate::mesh::Mesh;
use crate::scene::{Camera, Projection};

/// OpenGL's number of 32-bit floats.
const FLOAT: u32 = 5126;
/// OpenGL's number of unsigned 16-bit integers.
const UNSIGNED_SHORT: u32 = 5123;
/// OpenGL's number of unsigned 32-bit integers.
const UNSIGNED_INT: u32 = 5125;
/// OpenGL's number of vertex data.
const ARRAY_BUFFER: u32 = 34962;
/// OpenGL's number of index data.
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
/// Distance of the near plane of a camera that has none, relative to the far end of the scene: glTF requires one.
const NEAR: f64 = 1.0 / 4096.0;

/// Content of a file of unlit meshes.
#[derive(Clone, Copy, Debug)]
pub struct UnlitScene<'a> {
    /// Names and meshes in world space, with normals and with linear colours from 0 to 1.
    pub meshes: &'a [(&'a str, &'a Mesh)],
    /// Cameras in world space.
    pub cameras: &'a [Camera],
    /// Map from world space to the space of the file: a scale and a translation.
    pub file_from_world: DAffine3,
    /// Width over height of images of the cameras, for parallel projections without a width.
    pub aspect: f64,
    /// Radiance whose colour is 1, which the file's `extras` state.
    pub white: f32,
}

/// Writes a scene as binary glTF.
///
/// # Errors
/// If `out` cannot be written to, or the file would exceed 4 gigabytes.
pub fn write_unlit(scene: &UnlitScene, out: &mut impl Write) -> io::Result<()> {
    // Add the meshes
    let mut document = GlbDocument::default();
    for (name, mesh) in scene.meshes {
        document.push_mesh(name, mesh, &scene.file_from_world);
    }
    // Place the near planes of cameras before everything
    let extent = scene.meshes.iter().map(|(_, mesh)| {
        let bounds = mesh.bounds();
        bounds.min.length().max(bounds.max.length())
    });
    let extent = extent.fold(0.0, f64::max);
    for camera in scene.cameras {
        document.push_camera(camera, scene, extent);
    }
    let json = document.json(scene.white).to_string();
    write_glb(&json, &document.binary, out)
}

/// Writes the binary glTF container of a JSON document and its binary buffer, each padded to a multiple of four bytes.
///
/// # Errors
/// If `out` cannot be written to, or the file would exceed 4 gigabytes.
pub fn write_glb(json: &str, binary: &[u8], out: &mut impl Write) -> io::Result<()> {
    // Compute the padded lengths
    let json_length = json.len().next_multiple_of(4);
    let binary_length = binary.len().next_multiple_of(4);
    let too_long = |_| io::Error::other("a binary glTF file holds at most 4 gigabytes");
    let total = u32::try_from(12 + 8 + json_length + 8 + binary_length).map_err(too_long)?;
    let word = |out: &mut dyn Write, number: u32| out.write_all(&number.to_le_bytes());
    // Write the header and the two chunks
    out.write_all(b"glTF")?;
    word(out, 2)?;
    word(out, total)?;
    word(out, json_length as u32)?;
    out.write_all(b"JSON")?;
    out.write_all(json.as_bytes())?;
    out.write_all(&b"   "[..json_length - json.len()])?;
    word(out, binary_length as u32)?;
    out.write_all(b"BIN\0")?;
    out.write_all(binary)?;
    out.write_all(&[0; 3][..binary_length - binary.len()])
}

/// Lists of a document, and its binary buffer.
#[derive(Default)]
struct GlbDocument {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    cameras: Vec<Value>,
    nodes: Vec<Value>,
}

impl GlbDocument {
    /// Adds a mesh with its node.
    fn push_mesh(&mut self, name: &str, mesh: &Mesh, file_from_world: &DAffine3) {
        if mesh.positions.is_empty() || mesh.triangles.is_empty() {
            return;
        }
        // Add the positions, whose limits glTF requires
        let placed = |p: &[f32; 3]| {
            let p = glam::Vec3::from(*p).as_dvec3();
            file_from_world.transform_point3(p).as_vec3().to_array()
        };
        let positions: Vec<[f32; 3]> = mesh.positions.iter().map(placed).collect();
        let bound = |of: fn(f32, f32) -> f32| {
            let fold = |bound: [f32; 3], p: &[f32; 3]| std::array::from_fn(|axis| of(bound[axis], p[axis]));
            positions.iter().fold(positions[0], fold)
        };
        let limits = json!({ "min": bound(f32::min), "max": bound(f32::max) });
        let mut attributes = json!({
            "POSITION": self.push_array(&positions, FLOAT, "VEC3", ARRAY_BUFFER, limits),
        });
        // Add normals and colours
        if let Some(normals) = &mesh.normals {
            attributes["NORMAL"] = self
                .push_array(normals, FLOAT, "VEC3", ARRAY_BUFFER, json!({}))
                .into();
        }
        if let Some(colors) = &mesh.colors {
            let unit = |x: f32| (f64::from(x.clamp(0.0, 1.0)) * f64::from(u16::MAX)).round() as u16;
            let colors: Vec<[u16; 4]> = colors.iter().map(|color| color.map(unit)).collect();
            let normalized = json!({ "normalized": true });
            attributes["COLOR_0"] = self
                .push_array(&colors, UNSIGNED_SHORT, "VEC4", ARRAY_BUFFER, normalized)
                .into();
        }
        // Add the triangles, and a node with the mesh
        let indices = mesh.triangles.as_flattened();
        let indices = self.push_array(indices, UNSIGNED_INT, "SCALAR", ELEMENT_ARRAY_BUFFER, json!({}));
        self.nodes
            .push(json!({ "name": name, "mesh": self.meshes.len() }));
        self.meshes.push(json!({
            "name": name,
            "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }],
        }));
    }

    /// Adds an array with its view and its accessor, and returns the number of the accessor. `extra` has further members of
    /// the accessor.
    fn push_array<T: bytemuck::Pod>(
        &mut self,
        values: &[T],
        component: u32,
        kind: &str,
        target: u32,
        mut extra: Value,
    ) -> usize {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        self.views.push(json!({
            "buffer": 0,
            "byteOffset": self.binary.len(),
            "byteLength": bytes.len(),
            "target": target,
        }));
        self.binary.extend_from_slice(bytes);
        extra["bufferView"] = (self.views.len() - 1).into();
        extra["componentType"] = component.into();
        extra["count"] = values.len().into();
        extra["type"] = kind.into();
        self.accessors.push(extra);
        self.accessors.len() - 1
    }

    /// Adds a camera with its node. `extent` is the distance of the scene's far end from the origin.
    fn push_camera(&mut self, camera: &Camera, scene: &UnlitScene, extent: f64) {
        // Choose near and far planes
        let scale = scene.file_from_world.matrix3.x_axis.x;
        let far = camera.world_from_camera.translation.length() + 2.0 * extent;
        let near = camera.z_near.max(NEAR * far) * scale;
        let is_bounded = camera.z_far.is_finite() && camera.z_far * scale > near;
        // Convert the projection
        let optics = match camera.projection {
            Projection::Perspective { y_fov, aspect } => perspective(y_fov, aspect, near),
            Projection::Window {
                half_width,
                half_height,
                distance,
            } => {
                let y_fov = 2.0 * (half_height / distance).atan();
                perspective(y_fov, Some(half_width / half_height), near)
            }
            Projection::Orthographic { y_mag, x_mag } => json!({
                "xmag": x_mag.unwrap_or(scene.aspect * y_mag) * scale,
                "ymag": y_mag * scale,
                "znear": camera.z_near * scale,
                "zfar": 2.0 * far * scale,
            }),
        };
        let kind = match camera.projection {
            Projection::Orthographic { .. } => "orthographic",
            Projection::Perspective { .. } | Projection::Window { .. } => "perspective",
        };
        let mut item = json!({ "name": camera.name, "type": kind });
        item[kind] = optics;
        if is_bounded {
            item[kind]["zfar"] = (camera.z_far * scale).into();
        }
        // Move the camera without scaling it
        let place = DAffine3 {
            translation: scene
                .file_from_world
                .transform_point3(camera.world_from_camera.translation),
            ..camera.world_from_camera
        };
        self.nodes.push(json!({
            "name": camera.name,
            "camera": self.cameras.len(),
            "matrix": DMat4::from(place).to_cols_array(),
        }));
        self.cameras.push(item);
    }

    /// Returns the document as JSON.
    fn json(&self, white: f32) -> Value {
        let mut document = json!({
            "asset": { "version": "2.0", "extras": { "white_radiance": white } },
            "extensionsUsed": ["KHR_materials_unlit"],
            "scene": 0,
            "scenes": [{ "nodes": (0..self.nodes.len()).collect::<Vec<_>>() }],
            "nodes": self.nodes,
            "materials": [{
                "name": "radiosity",
                "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 },
                "extensions": { "KHR_materials_unlit": {} },
            }],
            "meshes": self.meshes,
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{ "byteLength": self.binary.len() }],
        });
        // Lists must not be empty
        if !self.cameras.is_empty() {
            document["cameras"] = Value::Array(self.cameras.clone());
        }
        document
    }
}

/// Returns a camera's perspective, of this full vertical field of view.
fn perspective(y_fov: f64, aspect: Option<f64>, near: f64) -> Value {
    let mut perspective = json!({ "yfov": y_fov, "znear": near });
    if let Some(aspect) = aspect {
        perspective["aspectRatio"] = aspect.into();
    }
    perspective
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::scene::Normalisation;

    #[test]
    fn positions_and_cameras_are_in_the_space_of_the_file() {
        let mesh = Mesh {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].into(),
            triangles: vec![[0, 1, 2]].into(),
            colors: Some(vec![[0.0, 0.5, 2.0, 1.0]; 3].into()),
            ..Mesh::default()
        };
        let camera = Camera {
            world_from_camera: DAffine3::from_rotation_translation(
                DQuat::from_rotation_z(0.5),
                DVec3::new(0.0, 0.0, 2.0),
            ),
            ..Camera::default()
        };
        // The world is (p - center) / 4
        let normalisation = Normalisation {
            center: DVec3::new(100.0, 0.0, 0.0),
            scale: 0.25,
        };
        let content = UnlitScene {
            meshes: &[("triangle \"1\"", &mesh)],
            cameras: &[camera],
            file_from_world: normalisation.inverse_map(),
            aspect: 1.0,
            white: 2.5,
        };
        let mut bytes = Vec::new();
        write_unlit(&content, &mut bytes).unwrap();
        let word = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|k| bytes[at + k])) as usize;
        assert_eq!(word(8), bytes.len());
        let length = word(12);
        let document: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        assert_eq!(document["meshes"][0]["name"], "triangle \"1\"");
        assert_eq!(document["accessors"][0]["min"], json!([100.0, 0.0, 0.0]));
        assert_eq!(document["accessors"][0]["max"], json!([104.0, 4.0, 0.0]));
        assert_eq!(document["asset"]["extras"]["white_radiance"], 2.5);
        let matrix = &document["nodes"][1]["matrix"];
        assert_eq!([&matrix[12], &matrix[13], &matrix[14]], [100.0, 0.0, 8.0]);
        assert_eq!(matrix[0], 0.5f64.cos());
        // Colours follow the positions: 0, half of 65535 rounded up, and 65535
        let colors = 20 + length + 8 + 36;
        assert_eq!(
            bytes[colors..colors + 8],
            [0, 0, 0x00, 0x80, 0xff, 0xff, 0xff, 0xff]
        );
    }
}
