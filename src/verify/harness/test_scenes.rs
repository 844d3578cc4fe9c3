//! Twelve procedural test scenes of all kinds, including cases that are hard for spatial trees.

use glam::{DAffine3, DQuat, DVec3};

use super::cylinder_mesh::cylinder;
use super::terrain_mesh::terrain;
use super::test_meshes::{self, convex_solids, icosphere, lattice_cube, rings, scene};
use crate::mesh::{Mesh, PointCloud};
use crate::numeric::SplitMix64;
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::{Shape, Torus};

/// Number of test scenes.
pub(in crate::verify) const COUNT: usize = 12;

/// Returns test scene `number` of [`COUNT`], a few units large, about the origin; it passes validation.
pub(in crate::verify) fn test_scene(number: usize) -> Scene {
    let random = &mut SplitMix64::new(0x37041d, number as u64);
    match number % COUNT {
        0 => scene(vec![Geometry::Mesh(icosphere(4))]),
        1 => scene(vec![Geometry::Mesh(bumpy())]),
        2 => scene(vec![Geometry::Mesh(lattice_cube(12))]),
        3 => scene(vec![Geometry::Mesh(soup(random, |random| {
            let size = 10f64.powf(random.within(-4.0, 0.3));
            [0; 3].map(|_| size * random.in_cube())
        }))]),
        4 => scene(vec![Geometry::Mesh(soup(random, |random| {
            // Use aspect ratios up to ten thousand
            let (along, height) = (random.direction(), 10f64.powf(random.within(-4.0, -2.0)));
            [DVec3::ZERO, along, 0.4 * along + height * random.direction()]
        }))]),
        5 => with_instances(
            scene(vec![
                Geometry::Mesh(icosphere(3)),
                Geometry::Mesh(lattice_cube(3)),
            ]),
            random,
        ),
        6 => {
            let mut geometries = solids();
            geometries.push(Geometry::Points(points(random)));
            with_instances(scene(geometries), random)
        }
        7 => moving(
            scene(vec![
                Geometry::Mesh(icosphere(3)),
                Geometry::Shape(Shape::Cube),
                Geometry::Points(points(random)),
            ]),
            random,
        ),
        8 => with_instances(on_a_floor(), random),
        9 => scene(vec![Geometry::Mesh(terrain(1))]),
        10 => scene(
            (1..5)
                .map(|size| Geometry::Mesh(cylinder([f64::from(size), 2.0])))
                .collect(),
        ),
        _ => scene(vec![
            Geometry::Mesh(bumpy()),
            Geometry::Mesh(bumpy()),
            Geometry::Mesh(icosphere(2)),
        ]),
    }
}

fn bumpy() -> Mesh {
    rings(40, DVec3::ZERO, |theta, phi| {
        2.0 + 0.2 * (20.0 * theta).sin() * (15.0 * phi).sin()
    })
}

/// Number of triangles of a mesh that share no vertices.
const SOUP: u32 = 512;

/// Returns a mesh of triangles that `triangle` makes about the origin, translated at random.
fn soup(random: &mut SplitMix64, triangle: impl Fn(&mut SplitMix64) -> [DVec3; 3]) -> Mesh {
    let mut moved = || {
        let place = 2.0 * random.in_cube();
        triangle(random).map(|corner| place + corner)
    };
    test_meshes::soup(&(0..SOUP).map(|_| moved()).collect::<Vec<_>>())
}

/// Returns one shape of each closed kind and a disk.
fn solids() -> Vec<Geometry> {
    let mut shapes = convex_solids();
    shapes.extend([Shape::Torus(Torus { minor_radius: 0.3 }), Shape::Disk]);
    shapes.into_iter().map(Geometry::Shape).collect()
}

/// Number of points of a cloud.
const POINTS: u32 = 64;

/// Returns a cloud of overlapping points.
fn points(random: &mut SplitMix64) -> PointCloud {
    let positions = (0..POINTS).map(|_| (1.5 * random.in_cube()).as_vec3().to_array());
    PointCloud {
        positions: positions.collect::<Vec<_>>().into(),
        radius: 0.25,
        colors: None,
    }
}

/// Returns a scene of a mesh, a cube and an infinite plane.
fn on_a_floor() -> Scene {
    let mut scene = scene(vec![Geometry::Mesh(icosphere(3)), Geometry::Shape(Shape::Cube)]);
    scene.geometries.push(Geometry::Shape(Shape::Plane));
    let floor = DAffine3::from_translation(DVec3::new(0.0, 0.0, -3.0));
    scene.instances.extend(Instance::new("floor", 2, 0, floor));
    scene
}

/// Number of additional instances in a scene.
const EXTRA_INSTANCES: u32 = 24;

fn place(random: &mut SplitMix64) -> DAffine3 {
    // Random rotation, with independent and partly mirroring scale
    let turn = DQuat::from_axis_angle(random.direction(), random.within(0.0, 3.0));
    let mut scale = || random.within(0.2, 1.0) * random.choose(&[1.0, -1.0]);
    let scale = DVec3::new(scale(), scale(), scale());
    DAffine3::from_scale_rotation_translation(scale, turn, 4.0 * random.in_cube())
}

/// Adds transformed instances of all bounded geometries, rotated, mirrored and stretched.
fn with_instances(mut scene: Scene, random: &mut SplitMix64) -> Scene {
    // Infinite planes come last, and are not instanced again
    let count = scene
        .geometries
        .iter()
        .filter(|geometry| !geometry.is_unbounded())
        .count();
    for number in 0..EXTRA_INSTANCES {
        let geometry = number % count as u32;
        scene
            .instances
            .extend(Instance::new("", geometry, 0, place(random)));
    }
    scene
}

/// Adds moving instances of all geometries, each between two transforms.
fn moving(mut scene: Scene, random: &mut SplitMix64) -> Scene {
    let count = scene.geometries.len() as u32;
    for number in 0..EXTRA_INSTANCES {
        let start = place(random);
        let turn = DQuat::from_axis_angle(random.direction(), random.within(0.0, 1.0));
        let step = DAffine3::from_rotation_translation(turn, 0.5 * random.in_cube());
        scene
            .instances
            .extend(Instance::moving("", number % count, 0, [start, step * start]));
    }
    scene
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn test_scenes_are_valid_and_a_few_units_large() {
        for number in 0..COUNT {
            let scene = test_scene(number);
            scene.validate().unwrap();
            assert!(!scene.instances.is_empty());
            let extent = scene.bounds().extent().max_element();
            assert!((1.0..=64.0).contains(&extent), "{number}: {extent}");
        }
    }
}
