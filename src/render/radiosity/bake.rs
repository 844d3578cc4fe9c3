//! Baking: a radiosity solution as colours of the vertices of meshes.
//!
//! The colour of a vertex is the mean radiance of the elements around it that continue its surface: those of the same side
//! of the same object whose normals are within 30 degrees. Colours thus are smooth on floors and on spheres, and change at
//! the edges of a box. Sides that no light reaches, such as the inside of a solid, are left out.

use std::collections::HashMap;

use glam::Vec3;

use super::elements::ElementScene;
use super::result::{RadiositySolution, SideLight};
use crate::mesh::Mesh;

/// Cosine of the largest angle between normals of elements that share the colours of their vertices: 30 degrees.
const SMOOTH_COSINE: f32 = 0.866;
/// Largest number of elements around a vertex that are averaged: more take the time of their square.
const MAX_AROUND: usize = 64;
/// Fraction of the lit area without emission at whose radiance a colour is white; what is brighter is clipped.
const WHITE_FRACTION: f64 = 0.99;
/// Distance of the back from the front of a surface with two lit sides, as a fraction of the spacing of elements: too little
/// to see, and more than the rounding of coordinates.
const SIDE_GAP: f64 = 1.0 / 1024.0;

/// Meshes of all objects with the light on them as vertex colours.
#[derive(Debug)]
pub struct Bake {
    /// Meshes in world space, at most one for each side of an instance.
    pub meshes: Vec<BakedMesh>,
    /// Radiance whose colour is white, 1.
    pub white: f32,
    /// Fraction of the lit area that is brighter than white, at most 1 % besides emissive surfaces.
    pub clipped: f64,
}

/// One side of an object with vertex colours.
#[derive(Debug)]
pub struct BakedMesh {
    /// Name of the instance.
    pub name: String,
    /// Mesh in world space with normals and with colours from 0 to 1, counter-clockwise seen from the lit side.
    pub mesh: Mesh,
}

impl Bake {
    /// Bakes a solution for the elements that it was computed for.
    pub fn new(elements: &ElementScene, solution: &RadiositySolution) -> Bake {
        let white = white(elements, &solution.sides);
        let mut bake = Bake {
            meshes: Vec::new(),
            white,
            clipped: clipped(elements, &solution.sides, white),
        };
        // Bake each run of elements of an instance
        let all = elements.elements();
        let mut first = 0;
        while let Some(element) = all.get(first) {
            let instance = element.instance;
            let count = all[first..].partition_point(|element| element.instance == instance);
            let is_visible = |half: usize| {
                let sides = (first..first + count).map(|element| &solution.sides[2 * element + half]);
                sides
                    .clone()
                    .any(|side| side.visible > 0.0 && side.radiance != [0.0; 3])
            };
            // Keep the front of an object without light, so that it hides what is behind it
            let has_back = is_visible(1);
            let has_front = is_visible(0) || !has_back;
            for half in [has_front.then_some(0), has_back.then_some(1)]
                .into_iter()
                .flatten()
            {
                let gap = if half == 1 && has_front { SIDE_GAP } else { 0.0 };
                let side = BakedSide {
                    elements,
                    sides: &solution.sides,
                    half,
                    offset: gap * elements.spacing,
                };
                bake.meshes.push(BakedMesh {
                    name: elements.scene.instances[instance as usize].name.to_string(),
                    mesh: side.mesh(first..first + count, white),
                });
            }
            first += count;
        }
        bake
    }
}

/// Returns the largest channel of the radiance.
fn brightness(side: &SideLight) -> f32 {
    side.radiance.into_iter().fold(0.0, f32::max)
}

/// Returns the visible area of a side with its brightness, if it has any.
fn lit_area(elements: &ElementScene, number: usize, side: &SideLight) -> Option<(f32, f64)> {
    let area = f64::from(side.visible) * elements.elements()[number / 2].area;
    let bright = brightness(side);
    (area > 0.0 && bright > 0.0 && bright.is_finite()).then_some((bright, area))
}

/// Returns the radiance that is white: that of the brightest part of the area without emission, of all lit area if there is
/// no other, and 1 without light.
pub(super) fn white(elements: &ElementScene, sides: &[SideLight]) -> f32 {
    // Take the area without emission, else all of it
    let numbered = || sides.iter().enumerate();
    let reflecting = numbered().filter(|(_, side)| !side.is_emissive);
    let mut lit: Vec<(f32, f64)> = reflecting
        .filter_map(|(n, side)| lit_area(elements, n, side))
        .collect();
    if lit.is_empty() {
        lit = numbered()
            .filter_map(|(n, side)| lit_area(elements, n, side))
            .collect();
    }
    // Find the radiance below which the given fraction of the area is
    lit.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = lit.iter().map(|(_, area)| area).sum();
    let mut below = 0.0;
    let white = lit.iter().find(|(_, area)| {
        below += area;
        below >= WHITE_FRACTION * total
    });
    white.or(lit.last()).map_or(1.0, |&(bright, _)| bright)
}

/// Returns the fraction of the lit area that is brighter than white.
fn clipped(elements: &ElementScene, sides: &[SideLight], white: f32) -> f64 {
    let (mut above, mut total) = (0.0, 0.0);
    for (bright, area) in sides
        .iter()
        .enumerate()
        .filter_map(|(n, side)| lit_area(elements, n, side))
    {
        total += area;
        above += if bright > white { area } else { 0.0 };
    }
    if total > 0.0 { above / total } else { 0.0 }
}

/// One side of all elements.
struct BakedSide<'e> {
    elements: &'e ElementScene,
    sides: &'e [SideLight],
    /// 0 for the front, 1 for the back.
    half: usize,
    /// Distance by which the mesh is moved off the surface.
    offset: f64,
}

impl BakedSide<'_> {
    /// Returns the mesh of a range of elements.
    fn mesh(&self, range: std::ops::Range<usize>, white: f32) -> Mesh {
        // Find the elements around each position, on objects of one mesh, to the bit
        let corners: Vec<[Vec3; 3]> = range
            .clone()
            .map(|element| {
                self.elements
                    .corners(&self.elements.elements()[element])
                    .map(|p| p.as_vec3())
            })
            .collect();
        let mut around: HashMap<[u32; 3], Vec<usize>> = HashMap::new();
        for (element, corners) in range.clone().zip(&corners) {
            for corner in corners {
                around.entry(key(*corner)).or_default().push(element);
            }
        }
        // Average around each corner, and merge corners of equal bits
        let mut merged: HashMap<[u32; 9], u32> = HashMap::new();
        let (mut positions, mut normals, mut colors) = (Vec::new(), Vec::new(), Vec::new());
        let mut triangles = Vec::with_capacity(corners.len());
        for (element, corners) in range.zip(&corners) {
            let mut triangle = corners.map(|corner| {
                let neighbours = around.get(&key(corner)).map_or(&[][..], Vec::as_slice);
                let Shade { normal, color } = self.shade(element, neighbours, white);
                let position = corner + self.offset as f32 * normal;
                let bits = [position, normal, Vec3::from(color)].map(key);
                let bits: [u32; 9] = std::array::from_fn(|k| bits[k / 3][k % 3]);
                *merged.entry(bits).or_insert_with(|| {
                    positions.push(position.to_array());
                    normals.push(normal.to_array());
                    colors.push([color[0], color[1], color[2], 1.0]);
                    positions.len() as u32 - 1
                })
            });
            // List corners counter-clockwise seen from the lit side
            let [a, b, c] = *corners;
            if (b - a).cross(c - a).dot(self.normal(element)) < 0.0 {
                triangle.swap(1, 2);
            }
            triangles.push(triangle);
        }
        Mesh {
            positions: positions.into(),
            triangles: triangles.into(),
            normals: Some(normals.into()),
            colors: Some(colors.into()),
            ..Mesh::default()
        }
    }

    /// Returns the unit normal of an element on this side.
    fn normal(&self, element: usize) -> Vec3 {
        let facing = if self.half == 0 { 1.0 } else { -1.0 };
        facing * self.elements.elements()[element].normal
    }

    /// Returns the mean normal and colour of the elements around a corner that continue the surface of `element`.
    fn shade(&self, element: usize, around: &[usize], white: f32) -> Shade {
        // Leave out vertices of too many elements
        let own = self.normal(element);
        let (mut normal, mut radiance, mut total) = (Vec3::ZERO, [0.0f64; 3], 0.0f64);
        let alone = [element];
        let averaged = if around.len() > MAX_AROUND {
            &alone[..]
        } else {
            around
        };
        // Sum up over the elements that continue the surface, by visible area
        for &other in averaged {
            let facing = self.normal(other);
            if facing.dot(own) < SMOOTH_COSINE {
                continue;
            }
            let area = self.elements.elements()[other].area;
            let side = &self.sides[2 * other + self.half];
            let visible = f64::from(side.visible) * area;
            normal += facing * area as f32;
            total += visible;
            for (sum, channel) in radiance.iter_mut().zip(side.radiance) {
                *sum += visible * f64::from(channel);
            }
        }
        // Divide by the area, and by the radiance of white
        let share = if total > 0.0 {
            (total * f64::from(white)).recip()
        } else {
            0.0
        };
        Shade {
            normal: normal.try_normalize().unwrap_or(own),
            color: radiance.map(|sum| (share * sum).clamp(0.0, 1.0) as f32),
        }
    }
}

/// Shading of a corner of a triangle.
struct Shade {
    /// Unit normal in world space.
    normal: Vec3,
    /// Radiance relative to white, at most 1.
    color: [f32; 3],
}

/// Returns the bits of a vector, of which 0 and -0 are equal.
fn key(v: Vec3) -> [u32; 3] {
    v.to_array().map(|x| (x + 0.0).to_bits())
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3};

    use super::super::result::{EnergyBalance, RadiosityReport};
    use super::*;
    use crate::scene::{Geometry, Instance, Material, Scene};
    use crate::shape::Shape;

    /// Bakes a mirrored cube whose faces have the radiance of their numbers on the front and `back` behind it.
    fn baked_cube(back: f32) -> Bake {
        let place = DAffine3::from_scale(DVec3::new(-1.0, 2.0, 1.0));
        let scene = Scene {
            geometries: vec![Geometry::Shape(Shape::Cube)],
            instances: vec![Instance::new("cube", 0, 0, place).unwrap()],
            materials: vec![Material::default()],
            ..Scene::default()
        };
        let elements = ElementScene::new(scene, 1000).unwrap();
        let count = elements.elements().len();
        assert!((700..1500).contains(&count), "{count}");
        let face = |side: usize| {
            let n = elements.elements()[side / 2].normal;
            n.dot(Vec3::new(1.0, 2.0, 3.0)).abs() + f32::from(u8::from(n.min_element() < -0.5)) * 3.0
        };
        let side_light = |side: usize| SideLight {
            radiance: [if side.is_multiple_of(2) { face(side) } else { back }; 3],
            visible: 1.0,
            ..SideLight::default()
        };
        let solution = RadiositySolution {
            sides: (0..2 * count).map(side_light).collect(),
            report: RadiosityReport {
                elements: count,
                rays: 32,
                sweeps: 1,
                remaining: 0.0,
                has_converged: true,
                sampling_error: 0.0,
                energy: EnergyBalance::default(),
            },
        };
        Bake::new(&elements, &solution)
    }

    #[test]
    fn faces_of_a_box_keep_their_own_colours_up_to_the_edges() {
        let bake = baked_cube(0.0);
        assert_eq!(bake.meshes.len(), 1);
        assert_eq!(bake.white, 6.0);
        let mesh = &bake.meshes[0].mesh;
        let (normals, colors) = (mesh.normals.as_ref().unwrap(), mesh.colors.as_ref().unwrap());
        for (number, triangle) in (0u32..).zip(&*mesh.triangles) {
            let [a, b, c] = mesh.corners(number);
            let facing = (b - a).cross(c - a).normalize();
            // Fronts look outwards although the transform mirrors
            assert!(facing.dot(a) > 0.0);
            let radiance = facing.dot(Vec3::new(1.0, 2.0, 3.0)).abs()
                + if facing.min_element() < -0.5 { 3.0 } else { 0.0 };
            for &v in triangle {
                assert!((Vec3::from(normals[v as usize]) - facing).length() < 1e-6);
                assert!((colors[v as usize][0] - radiance / 6.0).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn lit_backs_are_meshes_of_their_own_that_face_the_other_way() {
        let bake = baked_cube(1.0);
        assert_eq!(bake.meshes.len(), 2);
        let mesh = &bake.meshes[1].mesh;
        for number in 0..mesh.triangles.len() as u32 {
            let [a, b, c] = mesh.corners(number);
            assert!((b - a).cross(c - a).dot(a) < 0.0);
        }
    }
}
