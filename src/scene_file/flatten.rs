//! Flattening of object trees into instances in the world, in f64.

use std::collections::HashSet;
use std::path::Path;

use glam::{DAffine3, DMat3};

use super::SceneFileError;
use super::fault::file_error;
use super::object_tree::{EmissiveSettings, Node, ObjectKind, ObjectTree};
use super::placement::Copies;
use crate::numeric::{Bounds, MotionError};
use crate::scene::{
    AreaShape, Camera, CameraRequest, Geometry, Instance, Light, LightKind, Normalisation, Scene,
};
use crate::shading::fold_constant_textures;

/// State that an object inherits from the objects that contain it.
#[derive(Clone, Copy)]
struct Inherited {
    /// Object-to-world maps at the start and at the end of motions.
    world: [DAffine3; 2],
    material: u32,
    /// Flag for the import of lights from files and groups.
    lights: bool,
    cameras: bool,
}

impl Inherited {
    fn moves(&self) -> bool {
        self.world[0] != self.world[1]
    }
}

/// Adds the objects of `assembly` to the scene; `default_material` is that of objects without one.
pub(super) fn flatten(
    scene: &mut Scene,
    assembly: &ObjectTree,
    default_material: u32,
) -> Result<(), SceneFileError> {
    scene.instances.reserve(assembly.count as usize);
    let top = Inherited {
        world: [DAffine3::IDENTITY; 2],
        material: default_material,
        lights: true,
        cameras: true,
    };
    place_assembly(scene, assembly, top)
}

fn place_assembly(
    scene: &mut Scene,
    assembly: &ObjectTree,
    inherited: Inherited,
) -> Result<(), SceneFileError> {
    // Add lights, cameras and volumes
    if inherited.lights {
        let lights = assembly
            .lights
            .iter()
            .map(|light| transformed_light(light, &inherited.world[0]));
        scene.lights.extend(lights);
    }
    if inherited.cameras {
        let cameras = assembly.cameras.iter();
        scene
            .cameras
            .extend(cameras.filter_map(|camera| transformed_camera(camera, &inherited.world)));
    }
    place_volumes(scene, assembly, &inherited)?;
    // Add every copy of every object
    for node in &assembly.nodes {
        let count = node.copies.as_ref().map_or(1, Copies::count);
        for number in 0..count {
            let copy = node
                .copies
                .as_ref()
                .map_or(DAffine3::IDENTITY, |copies| copies.map(number));
            let inside = Inherited {
                // The object's own transforms apply first, then that of the copy, then those around
                world: [0, 1].map(|end| inherited.world[end] * copy * node.maps[end]),
                material: node.material.unwrap_or(inherited.material),
                lights: inherited.lights && node.lights,
                cameras: inherited.cameras && node.cameras,
            };
            place_node(scene, node, inside)?;
        }
    }
    Ok(())
}

/// Largest number of volumes of a scene: every ray is tested against each.
const MAX_VOLUMES: usize = 4096;

fn place_volumes(
    scene: &mut Scene,
    assembly: &ObjectTree,
    inherited: &Inherited,
) -> Result<(), SceneFileError> {
    for volume in &assembly.volumes {
        let fail = |sentence: String| volume.source.error_at(volume.span.clone(), sentence);
        // Volumes have one transform for all times
        if inherited.moves() {
            return Err(fail(
                "is part of something that moves, and volumes cannot move: remove the `transform_end`".into(),
            ));
        }
        if scene.volumes.len() == MAX_VOLUMES {
            return Err(fail(format!(
                "is one of more than {MAX_VOLUMES} volumes in all: make fewer copies"
            )));
        }
        let placed = volume
            .made
            .placed(&inherited.world[0])
            .map_err(|e| fail(e.to_string()))?;
        scene.volumes.push(placed);
    }
    Ok(())
}

fn place_node(scene: &mut Scene, node: &Node, inside: Inherited) -> Result<(), SceneFileError> {
    // Reject moving lights
    if let ObjectKind::ObjectTree(assembly) | ObjectKind::Import(assembly) = &node.what
        && inside.moves()
        && inside.lights
        && !assembly.lights.is_empty()
    {
        let sentence =
            "moves, and the lights that it imports cannot move: remove `lights` or its `transform_end`";
        return Err(node.source.error_at(node.span.clone(), sentence.into()));
    }
    let first = scene.instances.len();
    let lights = scene.lights.len();
    // Add the instances, then the lights on their emissive surfaces
    place_content(scene, node, inside)?;
    match &node.emissive {
        Some(emissive) => add_emissive_lights(scene, (node, emissive), (first, lights)),
        None => Ok(()),
    }
}

/// Adds lights to the emissive instances from index `first` on. Those that lights from index `lights` on already lie on
/// keep them. An instance that cannot be a light is an error if the object is that geometry itself, and a warning
/// otherwise.
fn add_emissive_lights(
    scene: &mut Scene,
    (node, emissive): (&Node, &EmissiveSettings),
    (first, lights): (usize, usize),
) -> Result<(), SceneFileError> {
    let fail = |sentence: String| node.source.error_at(emissive.span.clone(), sentence);
    // Skip instances that have a light already, and those without emission
    let taken: HashSet<u32> = scene.lights[lights..]
        .iter()
        .filter_map(Light::emissive_instance)
        .collect();
    let mut is_emissive = !taken.is_empty();
    for instance in first as u32..scene.instances.len() as u32 {
        let placed = &scene.instances[instance as usize];
        if taken.contains(&instance) || !scene.materials[placed.material as usize].is_emissive() {
            continue;
        }
        let name = placed.name.clone();
        is_emissive = true;
        let Err(fault) = scene.add_emissive_light(instance, emissive.samples) else {
            continue;
        };
        // Report an instance that cannot be a light
        if matches!(node.what, ObjectKind::Geometry(_)) {
            return Err(fail(format!("cannot be an area light, because {fault}")));
        }
        let warning = format!(
            "{name} of {} emits but lights nothing, because {fault}",
            node.name
        );
        if !scene.warnings.contains(&warning) {
            scene.warnings.push(warning);
        }
    }
    // An object without any emission is an error
    if is_emissive {
        return Ok(());
    }
    let sentence = "has `lamp`, but none of its surfaces emits light: give its material an `emission` over 0 or remove `lamp`";
    Err(fail(sentence.into()))
}

fn place_content(scene: &mut Scene, node: &Node, inside: Inherited) -> Result<(), SceneFileError> {
    match &node.what {
        ObjectKind::Geometry(geometry) => {
            let instance = Instance::moving(node.name.clone(), *geometry, inside.material, inside.world)
                .map_err(|e| {
                    let sentence = match e {
                        MotionError::Singular(e) => {
                            format!("with the transforms of all its groups, {e}: scale less extremely")
                        }
                        MotionError::Mirrored => format!("with the transforms of all its groups, {e}"),
                    };
                    node.source.error_at(node.span.clone(), sentence)
                })?;
            scene.instances.push(instance);
            Ok(())
        }
        ObjectKind::ObjectTree(assembly) => place_assembly(scene, assembly, inside),
        ObjectKind::Import(assembly) => match node.material {
            None => place_assembly(scene, assembly, inside),
            Some(_) => place_with_material(scene, assembly, inside),
        },
    }
}

/// Adds the objects of a glTF file with their materials replaced by the object's.
fn place_with_material(
    scene: &mut Scene,
    assembly: &ObjectTree,
    inside: Inherited,
) -> Result<(), SceneFileError> {
    let first = scene.instances.len();
    place_assembly(scene, assembly, inside)?;
    // Replace the materials of all instances that were just added
    for instance in &mut scene.instances[first..] {
        instance.material = inside.material;
    }
    Ok(())
}

/// Returns the light transformed by `world`. Its intensity and its range stay.
fn transformed_light(light: &Light, world: &DAffine3) -> Light {
    // A direction that the map collapses to zero is kept.
    let turned = |v| world.transform_vector3(v).try_normalize().unwrap_or(v);
    let kind = match light.kind {
        LightKind::Directional { to_light } => LightKind::Directional {
            to_light: turned(to_light),
        },
        LightKind::Point { position, falloff } => LightKind::Point {
            position: world.transform_point3(position),
            falloff,
        },
        LightKind::Spot {
            position,
            direction,
            cos_inner,
            cos_outer,
            falloff,
        } => LightKind::Spot {
            position: world.transform_point3(position),
            direction: turned(direction),
            cos_inner,
            cos_outer,
            falloff,
        },
        LightKind::Area { shape, samples } => LightKind::Area {
            shape: transformed_shape(shape, world),
            samples,
        },
    };
    Light {
        kind,
        ..light.clone()
    }
}

/// Returns the shape transformed by `world`: flat ones emit to the same side of the scene after mirroring, and a sphere
/// stays a sphere, of the volume that the map gives it.
fn transformed_shape(shape: AreaShape, world: &DAffine3) -> AreaShape {
    let at = |p| world.transform_point3(p);
    // A mirroring map exchanges u and v, so that u × v keeps its side
    let turned = |u, v| {
        let [u, v] = [u, v].map(|side| world.transform_vector3(side));
        if world.matrix3.determinant() < 0.0 {
            (v, u)
        } else {
            (u, v)
        }
    };
    match shape {
        AreaShape::Quad {
            center,
            half_u,
            half_v,
        } => {
            let (half_u, half_v) = turned(half_u, half_v);
            AreaShape::Quad {
                center: at(center),
                half_u,
                half_v,
            }
        }
        AreaShape::Disk {
            center,
            half_u,
            half_v,
        } => {
            let (half_u, half_v) = turned(half_u, half_v);
            AreaShape::Disk {
                center: at(center),
                half_u,
                half_v,
            }
        }
        AreaShape::Sphere { center, radius } => AreaShape::Sphere {
            center: at(center),
            radius: radius * world.matrix3.determinant().abs().cbrt(),
        },
        AreaShape::Object { .. } => shape,
    }
}

/// Returns the camera transformed by `world` without scale, shear and mirroring: the view axis keeps its direction, and
/// up is made orthogonal to it.
fn transformed_camera(camera: &Camera, world: &[DAffine3; 2]) -> Option<Camera> {
    let [start, end] = *world;
    // A camera at rest moves if something around it does
    let world_from_camera = rigid(&start, &camera.world_from_camera)?;
    let ending = rigid(
        &end,
        &camera.world_from_camera_end.unwrap_or(camera.world_from_camera),
    )?;
    Some(Camera {
        world_from_camera,
        world_from_camera_end: (ending != world_from_camera).then_some(ending),
        ..camera.clone()
    })
}

/// Returns the rigid transform of a camera under `world`; `None` if the view axis or up collapses to zero.
fn rigid(world: &DAffine3, world_from_camera: &DAffine3) -> Option<DAffine3> {
    if *world == DAffine3::IDENTITY {
        return Some(*world_from_camera);
    }
    // Orthonormalise the axes by Gram and Schmidt, the view axis first
    let map = *world * *world_from_camera;
    let back = map.matrix3.z_axis.try_normalize()?;
    let up = map.matrix3.y_axis;
    let up = (up - up.dot(back) * back).try_normalize()?;
    let axes = DMat3::from_cols(up.cross(back), up, back);
    Some(DAffine3::from_mat3_translation(axes, map.translation))
}

/// Finishes the scene: normalises it, bakes meshes of single instances, adds a camera if there is none, and validates
/// it.
pub(super) fn finish(mut scene: Scene, camera: &CameraRequest, path: &Path) -> Result<Scene, SceneFileError> {
    // Normalise the scene, and bake the transforms of meshes that are used once
    let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
    let around = scene.bounds_from(&bounds).union(scene.volume_bounds());
    scene.normalise_and_bake(Normalisation::fitting(&around), &bounds);
    if scene.instances.is_empty() && scene.volumes.is_empty() {
        return Err(file_error(
            path,
            "has only triangles without area: make its objects larger",
        ));
    }
    // Place the requested camera, or frame the scene if it has none
    if camera.placement.is_some() || scene.cameras.is_empty() {
        let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
        scene
            .place_cameras(camera, &bounds)
            .map_err(|error| match camera.placement {
                None => file_error(path, "has no camera and nothing finite to frame: add a [camera]"),
                Some(_) => file_error(path, format!("has no view: {error}")),
            })?;
    }
    // Validate the scene, then fold constant textures
    match scene.validate() {
        Ok(_) => {
            fold_constant_textures(&mut scene);
            scene.resolve_emissive_lights();
            Ok(scene)
        }
        Err(error) => Err(file_error(path, error.to_string())),
    }
}
