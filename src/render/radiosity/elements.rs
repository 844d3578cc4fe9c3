//! Elements: small triangles that cover the surfaces of a scene.
//!
//! Meshes and tessellated shapes are subdivided by bisecting the longest edge of a triangle until no edge exceeds a
//! spacing. Whether an edge is bisected depends on the edge alone, so that triangles beside each other keep common edges
//! and surfaces stay closed (M. C. Rivara, "Algorithms for refining triangular grids suitable for adaptive and multigrid
//! techniques", 1984). The refined meshes replace the geometries of the scene, so that a hit names its element: that of
//! its instance and its primitive.

use std::collections::HashMap;

use glam::{DAffine3, DVec3, Vec3};

use super::error::{MAX_ELEMENTS, RadiosityError};
use super::tessellation::tessellate;
use crate::mesh::Mesh;
use crate::scene::{AlphaMode, Geometry, Instance, Material, Model, Scene};

/// Mean area of the triangles of repeated bisection, in squares of the spacing: right isosceles triangles with
/// hypotenuses h between spacing/√2 and spacing have the area h²/4.
const MEAN_AREA: f64 = 3.0 / 16.0;

/// First element of an instance that has none.
const NO_ELEMENTS: u32 = u32::MAX;

/// Scene whose surfaces are covered with elements.
#[derive(Debug)]
pub struct ElementScene {
    /// Scene with the refined meshes, in the order of the instances of the original.
    pub scene: Scene,
    /// Longest edge of elements that are parts of larger triangles, in the units of the scene.
    pub spacing: f64,
    /// Warnings about what the solution leaves out, one sentence each.
    pub warnings: Vec<String>,
    /// Elements of all instances, in their order.
    pub(super) elements: Vec<SurfaceElement>,
    /// Number of the first element of each instance.
    first: Vec<u32>,
    /// Side of each instance that is inside of a closed surface: 0 for the front, 1 for the back.
    inside: Vec<Option<usize>>,
}

/// Triangle of uniform radiosity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceElement {
    /// Index of the instance in the scene.
    pub instance: u32,
    /// Number of the triangle in its mesh.
    pub primitive: u32,
    /// Area in world space.
    pub area: f64,
    /// Unit normal on the front in world space.
    pub normal: Vec3,
}

impl ElementScene {
    /// Covers a valid scene with about `wanted` elements. Triangles of meshes are not merged, so there may be more.
    ///
    /// # Errors
    /// If the scene has no surface of finite area, or takes more than [`MAX_ELEMENTS`].
    pub fn new(mut scene: Scene, wanted: usize) -> Result<ElementScene, RadiosityError> {
        // Choose the spacing by the area of coarse meshes
        let mut area = 0.0;
        let mut count = 0;
        for instance in &scene.instances {
            if let Some(mesh) = coarse_mesh(&scene, instance, f64::INFINITY) {
                count += mesh.triangles.len();
                check_count(count)?;
                let map = instance.world_from_object();
                let areas = (0..mesh.triangles.len()).map(|t| area_vector(&mesh, t as u32, &map).length());
                area += areas.filter(|area| area.is_finite()).sum::<f64>();
            }
        }
        let spacing = (area / (MEAN_AREA * wanted.max(1) as f64)).sqrt();
        if !(spacing > 0.0 && spacing < f64::INFINITY) {
            return Err(RadiosityError::NoSurface);
        }
        // Replace the geometry of each instance by a refined mesh
        let (mut elements, mut first) = (Vec::new(), Vec::new());
        let mut inside = Vec::new();
        for number in 0..scene.instances.len() {
            let refined = coarse_mesh(&scene, &scene.instances[number], spacing)
                .map(|mesh| refine(&mesh, &scene.instances[number], spacing, elements.len()))
                .transpose()?
                .filter(|mesh| !mesh.triangles.is_empty());
            let Some(mesh) = refined else {
                first.push(NO_ELEMENTS);
                inside.push(None);
                continue;
            };
            first.push(elements.len() as u32);
            inside.push(inner_side(&mesh));
            let geometry = scene.geometries.len() as u32;
            let instance = &mut scene.instances[number];
            instance.geometry = geometry;
            push_elements(&mut elements, number as u32, instance, &mesh);
            scene.geometries.push(Geometry::Mesh(mesh));
        }
        if elements.is_empty() {
            return Err(RadiosityError::NoSurface);
        }
        // Moving objects stand where their motion begins, where the elements are
        for instance in &mut scene.instances {
            let place = instance.world_from_object();
            if instance.is_moving() {
                instance
                    .place(place)
                    .map_err(|_| RadiosityError::Singular(instance.name.to_string()))?;
            }
        }
        let warnings = warnings(&scene, &first);
        Ok(ElementScene {
            scene,
            spacing,
            warnings,
            elements,
            first,
            inside,
        })
    }

    /// Returns the elements of all instances.
    pub fn elements(&self) -> &[SurfaceElement] {
        &self.elements
    }

    /// Returns the number of the element that a triangle of an instance is; `None` for an instance without elements.
    pub(super) fn element(&self, instance: u32, primitive: u32) -> Option<u32> {
        match self.first[instance as usize] {
            NO_ELEMENTS => None,
            first => Some(first + primitive),
        }
    }

    /// Returns the side of an instance that is inside of a closed surface, as in a solid: 0 for the front, 1 for the back.
    pub(super) fn inner_side(&self, instance: usize) -> Option<usize> {
        self.inside[instance]
    }

    /// Returns the mesh of an instance with elements.
    pub(super) fn mesh(&self, instance: u32) -> Option<&Mesh> {
        let geometry = self.scene.instances[instance as usize].geometry;
        match &self.scene.geometries[geometry as usize] {
            Geometry::Mesh(mesh) => Some(mesh),
            Geometry::Shape(_) | Geometry::Points(_) => None,
        }
    }

    /// Returns the corners of an element in world space.
    pub(super) fn corners(&self, element: &SurfaceElement) -> [DVec3; 3] {
        let map = self.scene.instances[element.instance as usize].world_from_object();
        let corners = self
            .mesh(element.instance)
            .map(|mesh| mesh.corners_f64(element.primitive));
        corners
            .unwrap_or([DVec3::ZERO; 3])
            .map(|p| map.transform_point3(p))
    }
}

/// Returns the mesh of an instance or of its shape, with edges of about `spacing` in world space on curved shapes.
fn coarse_mesh(scene: &Scene, instance: &Instance, spacing: f64) -> Option<Mesh> {
    match &scene.geometries[instance.geometry as usize] {
        // Flat triangles stand for smooth ones
        Geometry::Mesh(mesh) => Some(Mesh {
            normals: None,
            tangents: None,
            ..mesh.clone()
        }),
        Geometry::Shape(shape) => {
            let axes = instance.world_from_object().matrix3;
            let scale = (0..3).map(|axis| axes.col(axis).length()).fold(0.0, f64::max);
            tessellate(shape, spacing / scale)
        }
        Geometry::Points(_) => None,
    }
}

/// Returns an error if there are more elements than the limit.
fn check_count(count: usize) -> Result<(), RadiosityError> {
    match count > MAX_ELEMENTS {
        true => Err(RadiosityError::TooManyElements),
        false => Ok(()),
    }
}

/// Returns half the cross product of two edges of a triangle in world space: its length is the area.
fn area_vector(mesh: &Mesh, triangle: u32, map: &DAffine3) -> DVec3 {
    let [a, b, c] = mesh.corners_f64(triangle).map(|p| map.transform_point3(p));
    0.5 * (b - a).cross(c - a)
}

/// Adds the elements of an instance, one for each triangle of its mesh.
fn push_elements(elements: &mut Vec<SurfaceElement>, number: u32, instance: &Instance, mesh: &Mesh) {
    let map = instance.world_from_object();
    // Mirrored triangles have their corners clockwise when seen from the front
    let facing = if instance.is_mirrored() { -1.0 } else { 1.0 };
    for primitive in 0..mesh.triangles.len() as u32 {
        let across = facing * area_vector(mesh, primitive, &map);
        elements.push(SurfaceElement {
            instance: number,
            primitive,
            area: across.length(),
            normal: across.normalize_or_zero().as_vec3(),
        });
    }
}

/// Returns the inner side of a mesh if it is closed: every edge between two positions has as many triangles in one direction
/// as in the other. The inner side of a positive volume is the back.
fn inner_side(mesh: &Mesh) -> Option<usize> {
    let bits = |p: Vec3| p.to_array().map(|x| (x + 0.0).to_bits());
    let middle = mesh.bounds().center();
    let mut balance: HashMap<[[u32; 3]; 2], i32> = HashMap::new();
    let mut volume = 0.0;
    for triangle in 0..mesh.triangles.len() as u32 {
        let ends = mesh.corners(triangle).map(bits);
        // Count each edge under one name for both directions
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let is_ascending = ends[a] < ends[b];
            let name = if is_ascending {
                [ends[a], ends[b]]
            } else {
                [ends[b], ends[a]]
            };
            *balance.entry(name).or_default() += if is_ascending { 1 } else { -1 };
        }
        let [a, b, c] = mesh.corners_f64(triangle).map(|p| p - middle);
        volume += a.dot(b.cross(c));
    }
    let is_closed = balance.values().all(|&count| count == 0);
    match is_closed && volume != 0.0 {
        true => Some(usize::from(volume > 0.0)),
        false => None,
    }
}

/// Returns a mesh without edges over `spacing` in world space, where there are `before` elements of other meshes.
fn refine(mesh: &Mesh, instance: &Instance, spacing: f64, before: usize) -> Result<Mesh, RadiosityError> {
    // Bisect each triangle until its edges are short
    let map = instance.world_from_object();
    let mut refined = RefinedMesh::new(mesh);
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for number in 0..mesh.triangles.len() {
        let area = area_vector(mesh, number as u32, &map).length();
        // Leave out triangles that rounding has made lines
        if !(area > 0.0 && area < f64::INFINITY) {
            continue;
        }
        let mut pending = vec![mesh.triangles[number]];
        while let Some(triangle) = pending.pop() {
            check_count(before + triangles.len() + pending.len() + 1)?;
            match refined.bisected(triangle, &map, spacing) {
                Some(halves) => pending.extend(halves),
                None => triangles.push(triangle),
            }
        }
    }
    // Leave out halves that rounding has made lines
    let mut refined = refined.into_mesh(triangles);
    let has_area = |t: usize| area_vector(&refined, t as u32, &map).length() > 0.0;
    let kept: Vec<[u32; 3]> = (0..refined.triangles.len())
        .filter(|&t| has_area(t))
        .map(|t| refined.triangles[t])
        .collect();
    refined.triangles = kept.into();
    Ok(refined)
}

/// Vertices of a mesh during its refinement.
struct RefinedMesh {
    positions: Vec<[f32; 3]>,
    tex_coords: Vec<Vec<[f32; 2]>>,
    colors: Option<Vec<[f32; 4]>>,
    /// Vertices in the middle of edges, by the vertices at their ends in ascending order.
    midpoints: HashMap<[u32; 2], u32>,
}

impl RefinedMesh {
    /// Creates a copy of the vertices of a mesh.
    fn new(mesh: &Mesh) -> RefinedMesh {
        RefinedMesh {
            positions: mesh.positions.to_vec(),
            tex_coords: mesh.tex_coords.iter().map(|set| set.to_vec()).collect(),
            colors: mesh.colors.as_ref().map(|colors| colors.to_vec()),
            midpoints: HashMap::new(),
        }
    }

    /// Returns the two halves of a triangle at its longest edge, or `None` if no edge exceeds `spacing` in world space.
    fn bisected(&mut self, triangle: [u32; 3], map: &DAffine3, spacing: f64) -> Option<[[u32; 3]; 2]> {
        let point = |v: u32| Vec3::from(self.positions[v as usize]).as_dvec3();
        // Squares are symmetric in the ends of an edge, so that both of its triangles compute the same length
        let squared = |edge: usize| {
            let [a, b] = [triangle[edge], triangle[(edge + 1) % 3]].map(point);
            map.transform_vector3(b - a).length_squared()
        };
        let lengths = [0, 1, 2].map(squared);
        let longest = (0..3).max_by(|&a, &b| lengths[a].total_cmp(&lengths[b]))?;
        if !(lengths[longest] > spacing * spacing) {
            return None;
        }
        // Divide it from the middle of the edge to the corner across
        let [a, b, c] = [0, 1, 2].map(|k| triangle[(longest + k) % 3]);
        let middle = self.midpoint(a, b);
        // Edges of a few roundings cannot be divided
        let is_end = |v: u32| self.positions[v as usize] == self.positions[middle as usize];
        match is_end(a) || is_end(b) {
            true => None,
            false => Some([[a, middle, c], [middle, b, c]]),
        }
    }

    /// Returns the vertex in the middle between two others.
    fn midpoint(&mut self, a: u32, b: u32) -> u32 {
        let ends = [a.min(b), a.max(b)];
        if let Some(&middle) = self.midpoints.get(&ends) {
            return middle;
        }
        // Interpolate all data of the vertices
        let [low, high] = ends.map(|end| end as usize);
        push_mean(&mut self.positions, low, high);
        for set in &mut self.tex_coords {
            push_mean(set, low, high);
        }
        if let Some(colors) = &mut self.colors {
            push_mean(colors, low, high);
        }
        let middle = self.positions.len() as u32 - 1;
        self.midpoints.insert(ends, middle);
        middle
    }

    /// Returns the mesh of the vertices with these triangles.
    fn into_mesh(self, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh {
            positions: self.positions.into(),
            triangles: triangles.into(),
            normals: None,
            tangents: None,
            tex_coords: self.tex_coords.into_iter().map(Into::into).collect(),
            colors: self.colors.map(Into::into),
        }
    }
}

/// Adds the mean of two values, which does not depend on their order.
fn push_mean<const N: usize>(values: &mut Vec<[f32; N]>, a: usize, b: usize) {
    let mean = std::array::from_fn(|k| 0.5 * values[a][k] + 0.5 * values[b][k]);
    values.push(mean);
}

/// Returns warnings about objects without elements and about materials that are more than diffuse.
fn warnings(scene: &Scene, first: &[u32]) -> Vec<String> {
    // Name the first object without elements
    let mut warnings = Vec::new();
    let numbered = || scene.instances.iter().zip(first);
    let left_out: Vec<&Instance> = numbered()
        .filter(|&(_, &first)| first == NO_ELEMENTS)
        .map(|(instance, _)| instance)
        .collect();
    if let [instance, rest @ ..] = &left_out[..] {
        warnings.push(format!(
            "{} left out of the bake and black in it, because only meshes and bounded shapes other than quadrics have \
             elements: replace it by a mesh",
            subject(&instance.name, rest.len())
        ));
    }
    // Name the first object that looks different in images
    let special: Vec<&Instance> = numbered()
        .filter(|&(instance, &first)| {
            first != NO_ELEMENTS && !is_diffuse(&scene.materials[instance.material as usize])
        })
        .map(|(instance, _)| instance)
        .collect();
    if let [instance, rest @ ..] = &special[..] {
        warnings.push(format!(
            "{} baked with the diffuse reflection and the emission alone: mirrors, glass and gaps look opaque and dark, \
             and `whit render` shows them",
            subject(&instance.name, rest.len())
        ));
    }
    if !scene.volumes.is_empty() || scene.fog.is_some() {
        warnings.push("volumes and fog dim the light of lights, and nothing else in the bake".into());
    }
    warnings
}

/// Returns the subject of a sentence about an object and `others`, with its verb.
fn subject(name: &str, others: usize) -> String {
    match others {
        0 => format!("`{name}` is"),
        1 => format!("`{name}` and another object are"),
        _ => format!("`{name}` and {others} other objects are"),
    }
}

/// Returns whether a material has nothing that matters besides diffuse reflection and emission.
fn is_diffuse(material: &Material) -> bool {
    let reflects = match material.model {
        Model::MetallicRoughness(model) => model.metallic > 0.5,
        Model::Phong(phong) => phong.reflection != [0.0; 3],
        Model::Unlit => false,
    };
    let passes = material.transmits() || material.alpha != AlphaMode::Opaque;
    let scatters = material.subsurface.is_some() || material.translucency.is_some();
    !(reflects || passes || scatters)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{Shape, Sphere};

    /// Returns a scene of one instance with a default material.
    fn scene_of(geometry: Geometry, place: DAffine3) -> Scene {
        Scene {
            geometries: vec![geometry],
            instances: vec![Instance::new("object", 0, 0, place).unwrap()],
            materials: vec![Material::default()],
            ..Scene::default()
        }
    }

    #[test]
    fn refined_surfaces_stay_closed_and_have_short_edges() {
        let place = DAffine3::from_scale(DVec3::new(3.0, 1.0, -0.2));
        for shape in [Shape::Cube, Shape::Sphere(Sphere::UNIT)] {
            let elements = ElementScene::new(scene_of(Geometry::Shape(shape), place), 3000).unwrap();
            assert_eq!(elements.inner_side(0), Some(1));
            for element in elements.elements() {
                let corners = elements.corners(element).map(|p| p.as_vec3());
                for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                    assert!(corners[a].distance(corners[b]) <= elements.spacing as f32 * 1.000_001);
                }
                // Fronts look outwards although the transform mirrors
                assert!(element.normal.dot(corners[0]) > 0.0);
            }
        }
        // A disk is open
        let disk = scene_of(Geometry::Shape(Shape::Disk), place);
        assert_eq!(ElementScene::new(disk, 300).unwrap().inner_side(0), None);
    }

    #[test]
    fn meshes_of_triangles_without_area_or_of_too_many_are_refused() {
        let line = Mesh {
            positions: vec![[0.0; 3], [1.0; 3], [2.0; 3]].into(),
            triangles: vec![[0, 1, 2]].into(),
            ..Mesh::default()
        };
        let scene = scene_of(Geometry::Mesh(line), DAffine3::IDENTITY);
        assert_eq!(
            ElementScene::new(scene, 100).err(),
            Some(RadiosityError::NoSurface)
        );
        let many = Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].into(),
            triangles: vec![[0, 1, 2]; MAX_ELEMENTS + 1].into(),
            ..Mesh::default()
        };
        let scene = scene_of(Geometry::Mesh(many), DAffine3::IDENTITY);
        assert_eq!(
            ElementScene::new(scene, 100).err(),
            Some(RadiosityError::TooManyElements)
        );
    }
}
