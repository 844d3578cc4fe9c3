//! From assemblies to instances in the world, in f64.

use std::collections::HashSet;
use std::path::Path;

use glam::{DAffine3, DMat3};

use super::SceneFileError;
use super::assembly::{Assembly, Lamp, Node, What};
use super::fault::file_error;
use super::placement::Copies;
use crate::gltf::{dropped_sentence, framing_camera};
use crate::numeric::{Bounds, MotionError};
use crate::scene::{AreaShape, Camera, Geometry, Instance, Light, LightKind, Normalisation, Scene};
use crate::shading::fold_constant_textures;

/// What comes down to an object from those that it is in.
#[derive(Clone, Copy)]
struct Inherited {
    /// Where motions begin and where they end.
    world: [DAffine3; 2],
    material: u32,
    /// Whether lights and cameras come along.
    lights: bool,
    cameras: bool,
}

impl Inherited {
    fn moves(&self) -> bool {
        self.world[0] != self.world[1]
    }
}

/// Puts the objects of `assembly` into the scene; `default_material` goes to those that have none.
pub(super) fn flatten(
    scene: &mut Scene,
    assembly: &Assembly,
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
    assembly: &Assembly,
    inherited: Inherited,
) -> Result<(), SceneFileError> {
    if inherited.lights {
        let lights = assembly
            .lights
            .iter()
            .map(|light| moved_light(light, &inherited.world[0]));
        scene.lights.extend(lights);
    }
    if inherited.cameras {
        let cameras = assembly.cameras.iter();
        scene
            .cameras
            .extend(cameras.filter_map(|camera| moved_camera(camera, &inherited.world)));
    }
    place_volumes(scene, assembly, &inherited)?;
    for node in &assembly.nodes {
        let count = node.copies.as_ref().map_or(1, Copies::count);
        for number in 0..count {
            let copy = node
                .copies
                .as_ref()
                .map_or(DAffine3::IDENTITY, |copies| copies.map(number));
            let inside = Inherited {
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

/// Most volumes of a scene: every ray asks each.
const MAX_VOLUMES: usize = 4096;

fn place_volumes(
    scene: &mut Scene,
    assembly: &Assembly,
    inherited: &Inherited,
) -> Result<(), SceneFileError> {
    for volume in &assembly.volumes {
        let fail = |sentence: String| volume.source.error_at(volume.span.clone(), sentence);
        if inherited.moves() {
            return Err(fail(
                "is in something that moves, and volumes cannot: take away its `transform_end`".into(),
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
    if let What::Assembly(assembly) | What::Import(assembly) = &node.what
        && inside.moves()
        && inside.lights
        && !assembly.lights.is_empty()
    {
        let sentence =
            "moves, and the lights that come with it cannot: take away `lights` or its `transform_end`";
        return Err(node.source.error_at(node.span.clone(), sentence.into()));
    }
    let first = scene.instances.len();
    let lights = scene.lights.len();
    place_what(scene, node, inside)?;
    match &node.lamp {
        Some(lamp) => light_lamps(scene, (node, lamp), (first, lights)),
        None => Ok(()),
    }
}

/// Makes lamps of what shines among the instances from the first on; those that are lamps already, by lights from
/// `lights` on, stay what they are. What cannot be one is an error where it is the object itself, and else a warning.
fn light_lamps(
    scene: &mut Scene,
    (node, lamp): (&Node, &Lamp),
    (first, lights): (usize, usize),
) -> Result<(), SceneFileError> {
    let fail = |sentence: String| node.source.error_at(lamp.span.clone(), sentence);
    let taken: HashSet<u32> = scene.lights[lights..].iter().filter_map(Light::lamp).collect();
    let mut shines = !taken.is_empty();
    for instance in first as u32..scene.instances.len() as u32 {
        let placed = &scene.instances[instance as usize];
        if taken.contains(&instance) || !scene.materials[placed.material as usize].shines() {
            continue;
        }
        let name = placed.name.clone();
        shines = true;
        let Err(fault) = scene.add_emissive_light(instance, lamp.samples) else {
            continue;
        };
        if matches!(node.what, What::Geometry(_)) {
            return Err(fail(format!("cannot be a lamp, as {fault}")));
        }
        let warning = format!("{name} of {} only glows, as {fault}", node.name);
        if !scene.warnings.contains(&warning) {
            scene.warnings.push(warning);
        }
    }
    if shines {
        return Ok(());
    }
    let sentence =
        "is a lamp of which nothing shines: give its material an `emission` over 0 or take `lamp` away";
    Err(fail(sentence.into()))
}

fn place_what(scene: &mut Scene, node: &Node, inside: Inherited) -> Result<(), SceneFileError> {
    match &node.what {
        What::Geometry(geometry) => {
            let instance = Instance::moving(node.name.clone(), *geometry, inside.material, inside.world)
                .map_err(|e| {
                    let sentence = match e {
                        MotionError::Singular(e) => {
                            format!("with all that it is in, {e}: scale less extremely")
                        }
                        MotionError::Mirrored => format!("with all that it is in, {e}"),
                    };
                    node.source.error_at(node.span.clone(), sentence)
                })?;
            scene.instances.push(instance);
            Ok(())
        }
        What::Assembly(assembly) => place_assembly(scene, assembly, inside),
        What::Import(assembly) => match node.material {
            None => place_assembly(scene, assembly, inside),
            Some(_) => place_repainted(scene, assembly, inside),
        },
    }
}

/// A glTF file whose materials give way to the object's.
fn place_repainted(scene: &mut Scene, assembly: &Assembly, inside: Inherited) -> Result<(), SceneFileError> {
    let first = scene.instances.len();
    place_assembly(scene, assembly, inside)?;
    for instance in &mut scene.instances[first..] {
        instance.material = inside.material;
    }
    Ok(())
}

/// The light where `world` puts it. Its intensity and its range stay.
fn moved_light(light: &Light, world: &DAffine3) -> Light {
    // A direction that the map squeezes to nothing keeps its own.
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
            shape: moved_shape(shape, world),
            samples,
        },
    };
    Light {
        kind,
        ..light.clone()
    }
}

/// The shape where `world` puts it: flat ones shine to the same side of the scene after mirroring, and a sphere stays
/// one, of the volume that the map makes of it.
fn moved_shape(shape: AreaShape, world: &DAffine3) -> AreaShape {
    let at = |p| world.transform_point3(p);
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

/// The camera where `world` puts it, without scale, shear and mirroring: the view axis keeps its direction, up is made
/// orthogonal to it.
fn moved_camera(camera: &Camera, world: &[DAffine3; 2]) -> Option<Camera> {
    let [start, end] = *world;
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

/// The place of a camera in something that `world` places.
fn rigid(world: &DAffine3, world_from_camera: &DAffine3) -> Option<DAffine3> {
    if *world == DAffine3::IDENTITY {
        return Some(*world_from_camera);
    }
    let map = *world * *world_from_camera;
    let back = map.matrix3.z_axis.try_normalize()?;
    let up = map.matrix3.y_axis;
    let up = (up - up.dot(back) * back).try_normalize()?;
    let axes = DMat3::from_cols(up.cross(back), up, back);
    Some(DAffine3::from_mat3_translation(axes, map.translation))
}

/// Places everything well, bakes what stands once, and supplies a camera where there is none.
pub(super) fn finish(mut scene: Scene, path: &Path) -> Result<Scene, SceneFileError> {
    let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
    let around = scene.bounds_from(&bounds).union(scene.volume_bounds());
    scene.apply_normalisation(Normalisation::fitting(&around));
    scene.normalise_object_spaces(&bounds);
    for (name, dropped) in scene.bake_single_uses() {
        scene
            .warnings
            .push(format!("{name} {}", dropped_sentence(dropped)));
    }
    scene.remove_empty_meshes();
    if scene.instances.is_empty() && scene.volumes.is_empty() {
        return Err(file_error(
            path,
            "has only triangles without area: make its objects larger",
        ));
    }
    if scene.cameras.is_empty() {
        let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
        let finite = scene.bounds_from(&bounds).union(scene.volume_bounds());
        if finite.is_empty() {
            return Err(file_error(
                path,
                "has no camera and nothing finite to frame: add a [camera]",
            ));
        }
        scene.cameras.push(framing_camera(&finite));
    }
    match scene.validate() {
        Ok(()) => {
            fold_constant_textures(&mut scene);
            scene.resolve_emissive_lights();
            Ok(scene)
        }
        Err(error) => Err(file_error(path, error.to_string())),
    }
}
