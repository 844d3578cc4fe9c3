//! From a glTF 2.0 file to a scene.
//!
//! Files are mapped, not read: packed vertices and 32-bit indices stay where the file has them, so that a large `.glb`
//! is never copied. Everything else is converted in parallel. Nothing in a file is trusted: offsets, counts, indices
//! and numbers are checked before use, and what is wrong is said in one sentence with the file, the item and a remedy.
//!
//! Read are triangles (lists, strips, fans), node transforms, metallic-roughness materials with their textures (PNG,
//! JPEG), vertex colours, tangents, cameras and the extensions listed in `document.rs`. Where a normal map has no
//! tangents they are made by MikkTSpace. Meshes are shown as their morph targets and skins have them, and animations at a
//! moment ([`LoadOptions::pose`]). Points and lines are skipped, each with a warning. Both sides of every surface are
//! shown, whether `doubleSided` or not: a ray tracer that culled back faces would lose the far sides of mirrors and the
//! exits of glass.
//!
//! A file without a camera gets one that frames its bounds: 45 degrees high, seen from the front, slightly right and
//! above. A file without lights gets white sunlight of ¾ π lux from behind the camera's left shoulder and surroundings
//! of radiance 0.25; a file with lights has black surroundings.

mod accessor;
mod animation;
mod animation_sampler;
mod buffer;
mod camera_light;
mod deformation;
mod document;
mod error;
mod extension;
mod image;
mod material;
mod medium;
mod mmap;
mod node;
mod primitive;
mod skin;
mod texture_slot;

use std::collections::HashMap;
use std::path::Path;

use glam::DMat3;

pub use animation::Pose;
pub(crate) use camera_light::framing_camera;
pub use error::GltfError;
pub(crate) use primitive::dropped_sentence;

use crate::numeric::Bounds;
use crate::parallel;
use crate::scene::{Background, EffectSet, Geometry, ImageCache, Instance, Normalisation, Scene};
use crate::shading::fold_constant_textures;
use deformation::Deformation;
use document::Document;
use material::Materials;
use node::PlacedNode;
use primitive::{PrimitiveId, ReadPrimitive};

/// Limits on what a file may ask for.
#[derive(Clone, Debug)]
pub struct LoadOptions {
    /// Texels of all images together; each takes 4 bytes.
    pub max_texels: u64,
    /// Effects that nobody will simulate: images that only they look at stay in their files ([`Texels::Unread`]).
    ///
    /// [`Texels::Unread`]: crate::scene::Texels::Unread
    pub without: EffectSet,
    /// At which moment of which animation; `None` as the file places things without any.
    pub pose: Option<Pose>,
    /// Images that need not be decoded again.
    pub image_cache: ImageCache,
}

impl LoadOptions {
    /// 4 GiB of decoded images.
    pub const DEFAULT_MAX_TEXELS: u64 = 1 << 30;
}

impl Default for LoadOptions {
    fn default() -> LoadOptions {
        LoadOptions {
            max_texels: LoadOptions::DEFAULT_MAX_TEXELS,
            without: EffectSet::NONE,
            pose: None,
            image_cache: ImageCache::default(),
        }
    }
}

/// Loads a `.glb` or `.gltf` file as a normalised scene that [`Scene::validate`] accepts.
///
/// The file stays mapped as long as the scene lives: nobody may shorten or rewrite it meanwhile. Where bytes
/// are missing the system ends the process, and changed indices are no longer checked. (Replacing the file by a new one
/// of its name does no harm.)
///
/// # Errors
/// A file that is not readable, not glTF 2.0, needs an unknown extension, refers to what it does not hold, or leaves
/// no triangle to render.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene, GltfError> {
    let (document, scene, bounds) = read(path, options)?;
    document.finish(scene, bounds)
}

/// Loads a file as a part of another scene: in its own coordinates, with the cameras and lights that it has and no
/// others, and not yet validated. What [`load`] says of files and errors holds.
pub(crate) fn load_part(path: &Path, options: &LoadOptions) -> Result<Scene, GltfError> {
    let (document, scene, _) = read(path, options)?;
    if scene.instances.is_empty() {
        return Err(document.empty(&scene.warnings));
    }
    Ok(scene)
}

/// The file's scene in its own coordinates, and the bounds of its geometries.
fn read(path: &Path, options: &LoadOptions) -> Result<(Document, Scene, Vec<Bounds>), GltfError> {
    let mut scene = Scene::default();
    let document = Document::open(path, &mut scene.warnings)?;
    let moved = match &options.pose {
        None => HashMap::new(),
        Some(pose) => document.moved(pose, &mut scene.warnings)?,
    };
    // A file whose animations nobody asks for may have them as it likes.
    scene.animations = document.animations().unwrap_or_default();
    let mut nodes = document.placed_nodes(&moved)?;
    let deformations = document.deform(&mut nodes, &moved)?;
    let primitives = document.read_used_primitives(&nodes, &deformations)?;
    let (bounds, image_numbers) = document.place_primitives(&nodes, primitives, &mut scene)?;
    let wanted = scene.images_for(options.without);
    scene.images = document.read_images(&image_numbers, &wanted, options)?;
    for node in &nodes {
        scene
            .cameras
            .extend(document.camera_at(node, &mut scene.warnings)?);
        scene.lights.extend(document.light_at(node, &mut scene.warnings)?);
    }
    Ok((document, scene, bounds))
}

/// The primitives that the scene's nodes use, each read once.
type UsedPrimitives = HashMap<PrimitiveId, ReadPrimitive>;

impl Document {
    /// Reads, in parallel, every primitive that a node shows.
    fn read_used_primitives(
        &self,
        nodes: &[PlacedNode],
        deformations: &[Deformation],
    ) -> Result<UsedPrimitives, GltfError> {
        let mut ids = Vec::new();
        for node in nodes {
            ids.extend(self.primitives_at(node)?);
        }
        ids.sort_unstable();
        ids.dedup();
        let read = parallel::try_map(ids.len(), &|index| self.read_primitive(ids[index], deformations))?;
        Ok(ids.into_iter().zip(read).collect())
    }

    /// The primitives of a node's mesh.
    fn primitives_at(
        &self,
        node: &PlacedNode,
    ) -> Result<impl Iterator<Item = PrimitiveId> + use<>, GltfError> {
        let meshes = &self.root.meshes;
        let mesh = self.root.nodes[node.number].mesh.map(|m| m.value());
        let primitive_count = match mesh {
            None => 0,
            Some(number) => meshes
                .get(number)
                .ok_or_else(|| self.missing("mesh", number, meshes.len()))?
                .primitives
                .len(),
        };
        let mesh = mesh.unwrap_or_default();
        let deformation = node.deformed.map(|deformed| deformed.deformation);
        Ok((0..primitive_count).map(move |primitive| PrimitiveId {
            mesh,
            primitive,
            deformation,
        }))
    }

    /// Makes geometries, instances, materials and textures. Returns the bounds of the geometries in their object
    /// spaces, and the numbers of the images that the textures need.
    fn place_primitives(
        &self,
        nodes: &[PlacedNode],
        mut primitives: UsedPrimitives,
        scene: &mut Scene,
    ) -> Result<(Vec<Bounds>, Vec<usize>), GltfError> {
        let mut materials = Materials::new(self);
        let mut bounds = Vec::new();
        let mut placed: HashMap<PrimitiveId, Option<(u32, u32)>> = HashMap::new();
        for node in nodes {
            for id in self.primitives_at(node)? {
                let place = match placed.get(&id) {
                    Some(&place) => place,
                    None => {
                        let place = match primitives.remove(&id) {
                            Some(read) => self.add_geometry(id, read, &mut materials, &mut bounds, scene)?,
                            None => None,
                        };
                        placed.insert(id, place);
                        place
                    }
                };
                if let Some((geometry, material)) = place {
                    scene.instances.extend(self.instance(
                        node,
                        id,
                        [geometry, material],
                        &mut scene.warnings,
                    )?);
                }
            }
        }
        scene.materials = materials.materials;
        scene.textures = materials.textures;
        scene.warnings.append(&mut materials.warnings);
        Ok((bounds, materials.images))
    }

    /// Geometry and material of a primitive, `None` if nothing of it can be hit.
    fn add_geometry(
        &self,
        id: PrimitiveId,
        read: ReadPrimitive,
        materials: &mut Materials,
        bounds: &mut Vec<Bounds>,
        scene: &mut Scene,
    ) -> Result<Option<(u32, u32)>, GltfError> {
        scene.warnings.extend(read.warnings);
        if read.mesh.triangles.is_empty() {
            return Ok(None);
        }
        let sets = &read.mesh.tex_coords;
        let has_set = |set: u32| sets.get(set as usize).is_some_and(|s| !s.is_empty());
        let number = self.primitive(id).material.map(|m| m.value());
        let material = materials.index_of(number, has_set)?;
        let geometry = scene.geometries.len() as u32;
        scene.geometries.push(Geometry::Mesh(read.mesh));
        bounds.push(read.bounds);
        Ok(Some((geometry, material)))
    }

    /// One primitive at one node; `None` where the node is scaled to nothing, which is how files hide things.
    fn instance(
        &self,
        node: &PlacedNode,
        id: PrimitiveId,
        [geometry, material]: [u32; 2],
        warnings: &mut Vec<String>,
    ) -> Result<Option<Instance>, GltfError> {
        let mut name = self.node_name(node.number);
        if self.root.meshes[id.mesh].primitives.len() > 1 {
            name = format!("{name} primitive {}", id.primitive);
        }
        let world_from_mesh = node.world_from_mesh();
        if world_from_mesh.matrix3 == DMat3::ZERO {
            warnings.push(format!("{name} is scaled to nothing and was skipped"));
            return Ok(None);
        }
        match Instance::new(name, geometry, material, world_from_mesh) {
            Ok(instance) => Ok(Some(instance)),
            Err(singular) => {
                let fault = format!("cannot be placed, {singular}");
                Err(self.fault(
                    self.node_item(node.number),
                    fault,
                    "give it a scale other than zero",
                ))
            }
        }
    }

    /// Places everything well, bakes what stands once, and supplies camera and light where the file has none.
    fn finish(&self, mut scene: Scene, mut bounds: Vec<Bounds>) -> Result<Scene, GltfError> {
        if scene.instances.is_empty() {
            return Err(self.empty(&scene.warnings));
        }
        let normalisation = Normalisation::fitting(&scene.bounds_from(&bounds));
        let stays = normalisation.is_identity() && scene.instances.iter().all(Instance::is_identity);
        if !stays {
            scene.apply_normalisation(normalisation);
            scene.normalise_object_spaces(&bounds);
            for (name, dropped) in scene.bake_single_uses() {
                scene
                    .warnings
                    .push(format!("{name} {}", dropped_sentence(dropped)));
            }
            scene.remove_empty_meshes();
            if scene.instances.is_empty() {
                return Err(self.empty(&scene.warnings));
            }
            bounds = scene.geometries.iter().map(Geometry::bounds).collect();
        }
        if scene.cameras.is_empty() {
            let camera = camera_light::framing_camera(&scene.bounds_from(&bounds));
            scene.cameras.push(camera);
        }
        if scene.lights.is_empty() {
            scene.lights.push(camera_light::default_light(&scene.cameras[0]));
            scene.ambient = camera_light::DEFAULT_AMBIENT;
            scene.background = Background::Uniform(camera_light::DEFAULT_AMBIENT);
        }
        shorten(&mut scene.warnings);
        match scene.validate_structure(&bounds) {
            Ok(()) => {
                fold_constant_textures(&mut scene);
                Ok(scene)
            }
            Err(source) => Err(GltfError::Scene {
                file: self.file.clone(),
                source,
            }),
        }
    }

    fn empty(&self, warnings: &[String]) -> GltfError {
        let fault = match warnings {
            [] => "no node of its scene has a mesh".into(),
            [only] => only.clone(),
            [first, rest @ ..] => format!("{first}; and {} more warnings", rest.len()),
        };
        GltfError::Empty {
            file: self.file.clone(),
            fault,
        }
    }
}

/// Keeps the warnings of a file with ten thousand odd nodes readable.
fn shorten(warnings: &mut Vec<String>) {
    const MAX_WARNINGS: usize = 100;
    let rest = warnings.len().saturating_sub(MAX_WARNINGS);
    warnings.truncate(MAX_WARNINGS);
    if rest > 0 {
        warnings.push(format!("{rest} more warnings were left out"));
    }
}
