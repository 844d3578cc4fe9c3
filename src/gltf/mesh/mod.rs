//! Conversion of glTF primitives to triangle meshes and point clouds.

pub(super) mod deformation;
mod draco;
mod points;
pub(super) mod primitive_id;
mod skin;

use gltf::json;
use json::mesh::{Mode, Semantic};
use json::validation::Checked;

use crate::buffer::Buffer;
use crate::gltf::GltfError;
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;
use crate::gltf::mesh::deformation::{Deformation, Deformer};
use crate::gltf::mesh::primitive_id::PrimitiveId;
use crate::mesh::Mesh;
use crate::numeric::Bounds;
use crate::parallel;
use crate::scene::{Geometry, mesh_cleanup};

/// A converted primitive: a mesh without bad indices or unusable triangles, or a point cloud; possibly empty.
pub(in crate::gltf) struct ReadPrimitive {
    pub(in crate::gltf) geometry: Geometry,
    pub(in crate::gltf) bounds: Bounds,
    /// Texture coordinate set for which tangents are to be computed, as the file has none that can be used.
    pub(in crate::gltf) missing_tangents: Option<usize>,
    pub(in crate::gltf) warnings: Vec<String>,
}

impl GltfDocument {
    /// Reads one primitive in its object space, with its deformation from `deformations` applied. Points get the diameter
    /// `point_size`, if it is given.
    pub(in crate::gltf) fn read_primitive(
        &self,
        id: PrimitiveId,
        deformations: &[Deformation],
        point_size: Option<f64>,
    ) -> Result<ReadPrimitive, GltfError> {
        PrimitiveReader {
            document: self,
            id,
            deformer: None,
            deformation: id.deformation.and_then(|number| deformations.get(number)),
            missing_tangents: None,
            warnings: Vec::new(),
        }
        .read(point_size)
    }
}

struct PrimitiveReader<'a> {
    document: &'a GltfDocument,
    id: PrimitiveId,
    deformation: Option<&'a Deformation>,
    /// Deformation of this primitive's vertices, once their number is known.
    deformer: Option<Deformer>,
    missing_tangents: Option<usize>,
    warnings: Vec<String>,
}

impl PrimitiveReader<'_> {
    fn read(mut self, point_size: Option<f64>) -> Result<ReadPrimitive, GltfError> {
        let mut mesh = Mesh::default();
        let primitive = self.document.primitive(self.id);
        // Read the positions, unless the primitive is made of lines
        let Checked::Valid(mode) = primitive.mode else {
            return Err(self.fault("has a mode that glTF does not define".into()));
        };
        let is_lines = matches!(mode, Mode::Lines | Mode::LineLoop | Mode::LineStrip);
        match self.attribute(Semantic::Positions) {
            None => self.warn("has no positions and was skipped"),
            Some(_) if is_lines => self.warn("is made of lines and was skipped"),
            Some(accessor) => mesh.positions = self.document.accessor(accessor)?.vectors()?,
        }
        if mesh.positions.is_empty() {
            return Ok(self.finish(Geometry::Mesh(mesh), Bounds::EMPTY));
        }
        // Apply morph targets and the skin
        if let Some(deformation) = self.deformation {
            let deformer = self
                .document
                .deformer(self.id, deformation, mesh.positions.len())?;
            mesh.positions = deformer.positions(&mesh.positions);
            self.deformer = Some(deformer);
        }
        if mode == Mode::Points {
            let cloud = self.points(mesh.positions, point_size)?;
            let bounds = cloud.bounds();
            return Ok(self.finish(Geometry::Points(cloud), bounds));
        }
        // Read the triangles and remove unusable ones
        mesh.triangles = self.triangles(mode, mesh.positions.len())?;
        if let Some(deformer) = &self.deformer {
            mesh.triangles = deformer.triangles(mesh.triangles);
        }
        let bounds = self.discard_unusable(&mut mesh)?;
        // Read the attributes that the material needs
        self.read_attributes(&mut mesh)?;
        Ok(self.finish(Geometry::Mesh(mesh), bounds))
    }

    fn finish(self, geometry: Geometry, bounds: Bounds) -> ReadPrimitive {
        ReadPrimitive {
            geometry,
            bounds,
            missing_tangents: self.missing_tangents,
            warnings: self.warnings,
        }
    }

    fn triangles(&mut self, mode: Mode, vertex_count: usize) -> Result<Buffer<[u32; 3]>, GltfError> {
        // Surplus vertices are a warning only
        let count_fault = |count: usize| match mode {
            Mode::Triangles => !count.is_multiple_of(3),
            _ => count < 3,
        };
        let indices = self.document.primitive(self.id).indices;
        // Without indices consecutive vertices make the triangles
        let Some(indices) = indices else {
            let Ok(count) = u32::try_from(vertex_count) else {
                return Err(self.fault("has more than 2^32 vertices".into()));
            };
            if count_fault(vertex_count) {
                self.warn("has leftover vertices that form no triangle");
            }
            return Ok(assemble(mode, vertex_count, |i| i as u32 % count));
        };
        // Share the indices of a triangle list with the file
        let accessor = self.document.accessor(indices.value())?;
        if count_fault(accessor.count()) {
            self.warn("has leftover indices that form no triangle");
        }
        if let Some(triangles) = accessor.shared_triangles().filter(|_| mode == Mode::Triangles) {
            return Ok(triangles);
        }
        let indices = accessor.indices()?;
        if mode == Mode::Triangles || !self.document.has_primitive_restart() {
            return Ok(assemble(mode, indices.len(), |i| indices[i]));
        }
        // Assemble the strips or fans between restart indices
        let restart = accessor.largest_index();
        let runs = indices.split(|&index| index == restart);
        let triangles = runs.flat_map(|run| assemble(mode, run.len(), |i| run[i]).to_vec());
        Ok(Buffer::from(triangles.collect::<Vec<_>>()))
    }

    /// Checks the indices and removes unusable triangles. A mesh without faults keeps its arrays.
    fn discard_unusable(&mut self, mesh: &mut Mesh) -> Result<Bounds, GltfError> {
        let found = mesh_cleanup::scan(mesh).map_err(|bad| {
            let count = mesh.positions.len();
            self.fault(format!(
                "has in triangle {} the index {}, but {count} vertices",
                bad.triangle, bad.vertex
            ))
        })?;
        if found.unusable > 0 {
            let dropped = mesh_cleanup::drop_unusable(mesh);
            self.warn(&dropped.to_string());
        }
        mesh_cleanup::clear_non_finite_positions(mesh);
        Ok(found.bounds)
    }

    fn read_attributes(&mut self, mesh: &mut Mesh) -> Result<(), GltfError> {
        if mesh.triangles.is_empty() {
            return Ok(());
        }
        let vertex_count = mesh.positions.len();
        // Read normals and vertex colours
        if let Some(accessor) = self.attribute(Semantic::Normals) {
            let normals = self.vectors::<3>(accessor, vertex_count, "normals")?;
            let normals = match &self.deformer {
                None => normals,
                Some(deformer) => deformer.normals(&normals),
            };
            mesh.normals = self.unit_normals(normals, &mesh.triangles);
        }
        if let Some(accessor) = self.attribute(Semantic::Colors(0)) {
            mesh.colors = Some(self.colors(accessor, vertex_count)?);
        }
        // Read the texture coordinate sets that the textures of the material and its tangents use
        let material = self.document.material_number(self.id);
        let tangent_set = self.document.tangent_set(material)?;
        let mut sets = self.document.texture_coordinate_sets(material)?;
        sets.extend(tangent_set.filter(|set| !sets.contains(set)));
        for set in sets {
            // Exporters write few sets; a large set number would only waste memory on empty arrays.
            const MAX_SETS: u32 = 64;
            let Some(accessor) = self
                .attribute(Semantic::TexCoords(set))
                .filter(|_| set < MAX_SETS)
            else {
                continue;
            };
            let values = self.vectors::<2>(accessor, vertex_count, "texture coordinates")?;
            mesh.tex_coords
                .resize_with(mesh.tex_coords.len().max(set as usize + 1), Buffer::default);
            mesh.tex_coords[set as usize] = self.finite(values, "texture coordinates");
        }
        // Read tangents for normal maps and anisotropy
        match tangent_set {
            Some(set) => self.read_tangents(mesh, set as usize),
            None => Ok(()),
        }
    }

    /// Reads tangents for normal maps and anisotropy, or has them computed from a texture coordinate set, if the mesh has
    /// it.
    fn read_tangents(&mut self, mesh: &mut Mesh, set: usize) -> Result<(), GltfError> {
        // Tangents without normals are to be ignored (glTF 2.0, 3.7.2.1).
        let accessor = self.attribute(Semantic::Tangents);
        if let Some(accessor) = accessor.filter(|_| mesh.normals.is_some()) {
            let tangents = self.vectors::<4>(accessor, mesh.positions.len(), "tangents")?;
            let tangents = match &self.deformer {
                None => tangents,
                Some(deformer) => deformer.tangents(&tangents),
            };
            mesh.tangents = self.unit_tangents(tangents, &mesh.triangles);
        }
        // Absent or unusable ones are computed once all primitives are read, if there are coordinates
        let has_set = mesh.tex_coords.get(set).is_some_and(|set| !set.is_empty());
        self.missing_tangents = (mesh.tangents.is_none() && has_set).then_some(set);
        Ok(())
    }

    fn colors(&mut self, accessor: usize, vertex_count: usize) -> Result<Buffer<[f32; 4]>, GltfError> {
        if !self.document.accessor(accessor)?.is_triple() {
            let colors = self.vectors::<4>(accessor, vertex_count, "colours")?;
            return Ok(self.finite(colors, "colours"));
        }
        // Extend RGB by an opaque alpha
        let colors = self.vectors::<3>(accessor, vertex_count, "colours")?;
        let colors = self.finite(colors, "colours");
        let opaque = |[r, g, b]: [f32; 3]| [r, g, b, 1.0];
        let opaque = parallel::generate(colors.len(), |vertex| opaque(colors[vertex]));
        Ok(Buffer::from(opaque))
    }

    /// Returns an attribute with one value per vertex.
    fn vectors<const N: usize>(
        &self,
        accessor: usize,
        vertex_count: usize,
        what: &str,
    ) -> Result<Buffer<[f32; N]>, GltfError>
    where
        [f32; N]: bytemuck::Pod,
    {
        let accessor = self.document.accessor(accessor)?;
        if accessor.count() != vertex_count {
            let fault = format!("has {} {what} for {vertex_count} vertices", accessor.count());
            return Err(self.fault(fault));
        }
        accessor.vectors()
    }

    /// Returns the values, with zero for those that are not finite.
    fn finite<const N: usize>(&mut self, values: Buffer<[f32; N]>, what: &str) -> Buffer<[f32; N]>
    where
        [f32; N]: bytemuck::Pod,
    {
        if mesh_cleanup::all_finite(bytemuck::cast_slice(&values)) {
            return values;
        }
        self.warn(&format!("has {what} that are not finite: replaced by zero"));
        let clear = |v: &[f32; N]| v.map(|x| if x.is_finite() { x } else { 0.0 });
        Buffer::from(values.iter().map(clear).collect::<Vec<_>>())
    }

    /// Returns normals of unit length; `None`, for flat shading, if a triangle uses one without a direction.
    fn unit_normals(
        &mut self,
        normals: Buffer<[f32; 3]>,
        triangles: &[[u32; 3]],
    ) -> Option<Buffer<[f32; 3]>> {
        let chunks: Vec<&[[f32; 3]]> = normals.chunks(CHUNK).collect();
        // Keep normals that are of unit length already
        if parallel::all(chunks.len(), &|i| chunks[i].iter().all(|&n| is_nearly_unit(n))) {
            return Some(normals);
        }
        let unit = parallel::generate(normals.len(), |vertex| unit_or_zero(normals[vertex]));
        let is_bad = |v: &u32| unit[*v as usize] == [0.0; 3];
        if triangles.iter().flatten().any(is_bad) {
            self.warn("has normals without a direction: it is shaded flat");
            return None;
        }
        Some(Buffer::from(unit))
    }

    /// Returns tangents of unit length with a handedness of 1 or -1; `None` if a triangle uses one without a direction.
    fn unit_tangents(
        &mut self,
        tangents: Buffer<[f32; 4]>,
        triangles: &[[u32; 3]],
    ) -> Option<Buffer<[f32; 4]>> {
        let is_sound = |&[x, y, z, w]: &[f32; 4]| is_nearly_unit([x, y, z]) && w.abs() == 1.0;
        let chunks: Vec<&[[f32; 4]]> = tangents.chunks(CHUNK).collect();
        // Keep tangents that are valid already
        if parallel::all(chunks.len(), &|i| chunks[i].iter().all(is_sound)) {
            return Some(tangents);
        }
        // Normalise the direction, and reduce the handedness to its sign
        let unit = |vertex: usize| {
            let [x, y, z, w] = tangents[vertex];
            let [x, y, z] = unit_or_zero([x, y, z]);
            [x, y, z, if w.is_nan() { 0.0 } else { w.signum() }]
        };
        let unit = parallel::generate(tangents.len(), unit);
        let is_bad = |v: &u32| unit[*v as usize][..3] == [0.0; 3] || unit[*v as usize][3] == 0.0;
        if triangles.iter().flatten().any(is_bad) {
            self.warn("has tangents without a direction: they are recomputed");
            return None;
        }
        Some(Buffer::from(unit))
    }

    fn attribute(&self, semantic: Semantic) -> Option<usize> {
        let attributes = &self.document.primitive(self.id).attributes;
        attributes
            .get(&Checked::Valid(semantic))
            .map(|index| index.value())
    }

    fn warn(&mut self, what: &str) {
        self.warnings
            .push(format!("{} {what}", self.document.primitive_item(self.id)));
    }

    fn fault(&self, fault: String) -> GltfError {
        self.document
            .fault(self.document.primitive_item(self.id), fault, EXPORT_AGAIN)
    }
}

/// Number of directions per parallel task.
const CHUNK: usize = 1 << 14;

/// Returns whether a direction may stay as it is: shading normalises after interpolation, so the rounding of 8-bit
/// directions is acceptable.
fn is_nearly_unit(n: [f32; 3]) -> bool {
    const TOLERANCE: f32 = 1.0 / 64.0;
    let square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    (square - 1.0).abs() <= TOLERANCE
}

/// Returns the direction normalised, or zero if it has none.
fn unit_or_zero(n: [f32; 3]) -> [f32; 3] {
    glam::DVec3::from_array(n.map(f64::from))
        .normalize_or_zero()
        .as_vec3()
        .to_array()
}

/// Returns the triangles of a list, strip or fan (glTF 2.0, section 3.7.2.1).
fn assemble(mode: Mode, index_count: usize, index: impl Fn(usize) -> u32 + Sync) -> Buffer<[u32; 3]> {
    // A strip or a fan has a triangle for each vertex after the second
    let count = match mode {
        Mode::Triangles => index_count / 3,
        _ => index_count.saturating_sub(2),
    };
    let corners = |i: usize| match mode {
        Mode::TriangleStrip => [i, i + 1 + i % 2, i + 2 - i % 2],
        Mode::TriangleFan => [i + 1, i + 2, 0],
        _ => [3 * i, 3 * i + 1, 3 * i + 2],
    };
    Buffer::from(parallel::generate(count, |i| corners(i).map(&index)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_keep_the_winding_order() {
        let identity = |i: usize| i as u32;
        let strip = assemble(Mode::TriangleStrip, 5, identity);
        assert_eq!(strip[..], [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        let fan = assemble(Mode::TriangleFan, 5, identity);
        assert_eq!(fan[..], [[1, 2, 0], [2, 3, 0], [3, 4, 0]]);
        assert_eq!(assemble(Mode::Triangles, 7, identity)[..], [[0, 1, 2], [3, 4, 5]]);
        assert!(assemble(Mode::TriangleFan, 1, identity).is_empty());
    }
}
