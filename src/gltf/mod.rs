//! Import of glTF 2.0 files as scenes.
//!
//! Files are read once, in parallel: packed vertices and 32-bit indices stay where they were read to. Everything else is
//! converted or decoded in parallel. Nothing in a file is trusted: offsets, counts, indices and numbers are checked
//! before use, and a fault is reported in one sentence with the file, the item and a remedy.
//!
//! The import reads triangles (lists, strips, fans), points, node transforms, metallic-roughness materials with their
//! textures (PNG, JPEG, WebP), vertex colours, tangents, cameras and the extensions listed in `extension_support.rs`.
//! For a normal map without tangents they are computed by MikkTSpace. Morph targets and skins deform meshes, and
//! animations are evaluated at one time ([`LoadOptions::pose`]). Points are rendered as spheres
//! ([`LoadOptions::point_size`]); lines are skipped, with a warning. Both sides of every surface are rendered, whether
//! `doubleSided` or not: a ray tracer that culled back faces would lose the far sides of mirrors and the exits of
//! glass.
//!
//! A file without a camera gets one that frames its vertices: a vertical field of view of 45 degrees, from the front,
//! slightly from the right and above. A file without lights gets white sunlight of ¾ π lux from behind the camera's
//! left shoulder, and ambient light and a background of radiance 0.25; where a material shows reflections, the
//! background is a studio. A file with lights has a black background.

mod buffer;
mod document;
mod error;
mod extension;
mod extension_support;
mod material;
mod mesh;
mod node;
mod write;

use std::collections::HashMap;
use std::path::Path;

use glam::DMat3;

pub use error::GltfError;
pub use node::animation::AnimationTime;
pub use write::{UnlitScene, write_glb, write_unlit};

use crate::mesh::Mesh;
use crate::numeric::Bounds;
use crate::optics::subsurface::Dipole;
use crate::parallel;
use crate::scene::{CameraRequest, EffectSet, Geometry, ImageCache, Instance, Normalisation, Scene};
use crate::shading::fold_constant_textures;
use document::GltfDocument;
use material::Materials;
use material::image_source::ImageSource;
use mesh::ReadPrimitive;
use mesh::deformation::Deformation;
use mesh::primitive_id::PrimitiveId;
use node::PlacedNode;
use node::gpu_instancing::MeshPlacement;

/// Limits and options for loading a file.
///
/// Construct it with `..LoadOptions::default()`: further fields may be added.
#[derive(Clone, Debug)]
pub struct LoadOptions {
    /// Largest number of texels of all images together; each takes 4 bytes.
    pub max_texels: u64,
    /// Effects that will not be simulated: images that only they use stay in their files ([`Texels::Unread`]).
    ///
    /// [`Texels::Unread`]: crate::scene::Texels::Unread
    pub without: EffectSet,
    /// Time at which animations are evaluated; `None` for the transforms of the nodes themselves.
    pub pose: Option<AnimationTime>,
    /// Cache of images that are already decoded.
    pub image_cache: ImageCache,
    /// Name of the variant of the materials (`KHR_materials_variants`); `None` for the default look.
    pub variant: Option<String>,
    /// Treatment of files with extensions that are not fully implemented.
    pub unsupported: UnsupportedExtensions,
    /// Camera in place of those of the file.
    pub camera: CameraRequest,
    /// Light that a file without lights gets.
    pub default_light: DefaultLight,
    /// True if emissive objects are area lights.
    pub emissive_lights: bool,
    /// Diameter of the spheres as which points are rendered, in the units of their positions; `None` for a diameter by
    /// the density of each cloud.
    pub point_size: Option<f64>,
    /// True if buffers and images may be outside of the folder of the file, which a file of unknown origin could use to
    /// show other files.
    pub allows_outside: bool,
}

/// Treatment of files that use extensions which are ignored or approximated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnsupportedExtensions {
    /// The file is loaded, with a warning for each extension that is ignored.
    #[default]
    Warn,
    /// The file is refused.
    Refuse,
}

/// Light that a file without lights gets, with ambient light and a background.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DefaultLight {
    /// White sunlight from behind the camera's left shoulder, and grey ambient light and background.
    Sunlight,
    /// [`DefaultLight::Sunlight`], and where a material shows reflections, the map [`BuiltInEnvironment::Studio`] as
    /// background, which reflections show and which lights nothing else.
    ///
    /// [`BuiltInEnvironment::Studio`]: crate::scene::BuiltInEnvironment::Studio
    #[default]
    SunlightInStudio,
    /// No light, and a black background, which the caller replaces.
    None,
}

impl LoadOptions {
    /// Default limit, which is 4 GiB of decoded images.
    pub const DEFAULT_MAX_TEXELS: u64 = 1 << 30;
}

impl Default for LoadOptions {
    fn default() -> LoadOptions {
        LoadOptions {
            max_texels: LoadOptions::DEFAULT_MAX_TEXELS,
            without: EffectSet::NONE,
            pose: None,
            image_cache: ImageCache::default(),
            variant: None,
            unsupported: UnsupportedExtensions::default(),
            camera: CameraRequest::default(),
            default_light: DefaultLight::default(),
            emissive_lights: false,
            point_size: None,
            allows_outside: false,
        }
    }
}

/// Loads a `.glb` or `.gltf` file as a normalised scene that [`Scene::validate`] accepts.
///
/// # Errors
/// A file that is not readable, not glTF 2.0, needs an unknown extension, refers to what it does not hold, or leaves no
/// triangle or point to render.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Scene, GltfError> {
    let (document, scene, bounds) = read(path, options)?;
    document.finish(scene, bounds, options)
}

/// Loads a file as a part of another scene: in its own coordinates, with its own cameras and lights and no defaults,
/// and not validated yet. The conditions and errors of [`load`] apply.
pub(crate) fn load_part(path: &Path, options: &LoadOptions) -> Result<Scene, GltfError> {
    let (document, scene, _) = read(path, options)?;
    if scene.instances.is_empty() {
        return Err(document.empty(&scene.warnings));
    }
    Ok(scene)
}

/// Reads the file's scene in its own coordinates, and the bounds of its geometries.
fn read(path: &Path, options: &LoadOptions) -> Result<(GltfDocument, Scene, Vec<Bounds>), GltfError> {
    let mut scene = Scene::default();
    let mut document = GltfDocument::open(path, &mut scene.warnings)?;
    scene.extensions = document.extension_uses(options.unsupported, &mut scene.warnings)?;
    document.decode_views();
    document.allows_outside = options.allows_outside;
    // Choose the variant of the materials
    scene.variants = document.variants();
    if let Some(name) = &options.variant {
        document.choose_variant(name)?;
    }
    // Evaluate the animations
    let moved = match &options.pose {
        None => HashMap::new(),
        Some(pose) => document.moved(pose, &mut scene.warnings)?,
    };
    // Invalid animations are no error in a file that is loaded without a pose.
    scene.animations = document.animations().unwrap_or_default();
    // Flatten the nodes
    let mut nodes = document.placed_nodes(&moved)?;
    // Decode compressed meshes, then read the primitives
    document.decode_draco(&nodes)?;
    let deformations = document.deform(&mut nodes, &moved)?;
    let primitives = document.read_used_primitives(&nodes, &deformations, options.point_size)?;
    let PlacedPrimitives {
        bounds,
        image_sources,
        missing_tangents,
    } = document.place_primitives(&nodes, primitives, &mut scene)?;
    // Decode the images that simulated effects use, and compute tangents meanwhile
    let wanted = scene.images_for(options.without);
    let (images, meshes) = parallel::join(
        || document.read_images(&image_sources, &wanted, options),
        || with_tangents(&scene.geometries, &missing_tangents),
    );
    scene.images = images?;
    for (missing, mesh) in missing_tangents.iter().zip(meshes) {
        scene.geometries[missing.geometry] = Geometry::Mesh(mesh);
    }
    // Add cameras and lights
    for node in &nodes {
        scene
            .cameras
            .extend(document.camera_at(node, &mut scene.warnings)?);
        if node.is_visible {
            scene.lights.extend(document.light_at(node, &mut scene.warnings)?);
        }
    }
    Ok((document, scene, bounds))
}

/// Results of placing the primitives, beside the scene itself.
struct PlacedPrimitives {
    /// Bounds of the geometries in their object spaces.
    bounds: Vec<Bounds>,
    /// Images that the textures need.
    image_sources: Vec<ImageSource>,
    missing_tangents: Vec<MissingTangents>,
}

/// Mesh whose tangents are to be computed.
struct MissingTangents {
    geometry: usize,
    /// Texture coordinate set that the tangents follow.
    set: usize,
}

/// Returns the meshes with tangents, in parallel.
fn with_tangents(geometries: &[Geometry], missing: &[MissingTangents]) -> Vec<Mesh> {
    parallel::map(
        missing.len(),
        &|index| match &geometries[missing[index].geometry] {
            Geometry::Mesh(mesh) => mesh.with_tangents(missing[index].set),
            Geometry::Shape(_) | Geometry::Points(_) => Mesh::default(),
        },
    )
}

/// Primitives that the scene's nodes use, each read once.
type UsedPrimitives = HashMap<PrimitiveId, ReadPrimitive>;

impl GltfDocument {
    /// Reads, in parallel, every primitive of a node's mesh.
    fn read_used_primitives(
        &self,
        nodes: &[PlacedNode],
        deformations: &[Deformation],
        point_size: Option<f64>,
    ) -> Result<UsedPrimitives, GltfError> {
        let mut ids = Vec::new();
        for node in nodes {
            ids.extend(self.primitives_at(node)?);
        }
        // Read each primitive once, however many nodes use it
        ids.sort_unstable();
        ids.dedup();
        let read = parallel::try_map(ids.len(), &|index| {
            self.read_primitive(ids[index], deformations, point_size)
        })?;
        Ok(ids.into_iter().zip(read).collect())
    }

    /// Returns the primitives of a node's mesh; none if it is hidden.
    fn primitives_at(
        &self,
        node: &PlacedNode,
    ) -> Result<impl Iterator<Item = PrimitiveId> + use<>, GltfError> {
        let meshes = &self.root.meshes;
        let mesh = self.root.nodes[node.number].mesh.filter(|_| node.is_visible);
        let mesh = mesh.map(|m| m.value());
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

    /// Makes geometries, instances, materials and textures.
    fn place_primitives(
        &self,
        nodes: &[PlacedNode],
        mut primitives: UsedPrimitives,
        scene: &mut Scene,
    ) -> Result<PlacedPrimitives, GltfError> {
        let mut materials = Materials::new(self);
        let mut found = PlacedPrimitives {
            bounds: Vec::new(),
            image_sources: Vec::new(),
            missing_tangents: Vec::new(),
        };
        let mut placed: HashMap<PrimitiveId, Option<(u32, u32)>> = HashMap::new();
        for node in nodes {
            let ids: Vec<PrimitiveId> = self.primitives_at(node)?.collect();
            let placements = match ids.is_empty() {
                true => Vec::new(),
                false => self.placements(node)?,
            };
            for id in ids {
                // Add the geometry on first use of the primitive
                let place = match placed.get(&id) {
                    Some(&place) => place,
                    None => {
                        let place = match primitives.remove(&id) {
                            Some(read) => self.add_geometry(id, read, &mut materials, &mut found, scene)?,
                            None => None,
                        };
                        placed.insert(id, place);
                        place
                    }
                };
                let Some((geometry, material)) = place else {
                    continue;
                };
                for placement in &placements {
                    let instance = self.instance(placement, id, [geometry, material], &mut scene.warnings)?;
                    scene.instances.extend(instance);
                }
            }
        }
        scene.materials = materials.materials;
        scene.textures = materials.textures;
        scene.warnings.append(&mut materials.warnings);
        found.image_sources = materials.images;
        Ok(found)
    }

    /// Adds the geometry and the material of a primitive and returns their indices; `None` if it has no usable
    /// triangle or point.
    fn add_geometry(
        &self,
        id: PrimitiveId,
        read: ReadPrimitive,
        materials: &mut Materials,
        found: &mut PlacedPrimitives,
        scene: &mut Scene,
    ) -> Result<Option<(u32, u32)>, GltfError> {
        scene.warnings.extend(read.warnings);
        if read.geometry.primitive_count() == 0 {
            return Ok(None);
        }
        let sets: &[_] = match &read.geometry {
            Geometry::Mesh(mesh) => &mesh.tex_coords,
            Geometry::Shape(_) | Geometry::Points(_) => &[],
        };
        // Find the material without the textures whose coordinates the mesh lacks
        let has_set = |set: u32| sets.get(set as usize).is_some_and(|s| !s.is_empty());
        let number = self.material_number(id);
        let material = materials.index_of(number, has_set)?;
        let geometry = scene.geometries.len();
        let missing = |set| MissingTangents { geometry, set };
        found.missing_tangents.extend(read.missing_tangents.map(missing));
        found.bounds.push(read.bounds);
        scene.geometries.push(read.geometry);
        Ok(Some((geometry as u32, material)))
    }

    /// Returns an instance of one primitive at one place; `None` if it is scaled to zero, by which files hide
    /// objects.
    fn instance(
        &self,
        place: &MeshPlacement,
        id: PrimitiveId,
        [geometry, material]: [u32; 2],
        warnings: &mut Vec<String>,
    ) -> Result<Option<Instance>, GltfError> {
        let mut name = self.node_name(place.node);
        if self.root.meshes[id.mesh].primitives.len() > 1 {
            name = format!("{name} primitive {}", id.primitive);
        }
        if let Some(copy) = place.copy {
            name = format!("{name} copy {copy}");
        }
        let world_from_mesh = place.world_from_mesh;
        // A zero matrix has no inverse
        if world_from_mesh.matrix3 == DMat3::ZERO {
            warnings.push(format!("{name} has a scale of zero and was skipped"));
            return Ok(None);
        }
        match Instance::new(name, geometry, material, world_from_mesh) {
            Ok(instance) => Ok(Some(instance)),
            Err(singular) => {
                let fault = format!("cannot be placed, {singular}");
                Err(self.fault(
                    self.node_item(place.node),
                    fault,
                    "give it a scale other than zero",
                ))
            }
        }
    }

    /// Finishes the scene: normalises it, bakes meshes of single instances, adds a camera and a light if the file has
    /// none, and validates it.
    fn finish(
        &self,
        mut scene: Scene,
        mut bounds: Vec<Bounds>,
        options: &LoadOptions,
    ) -> Result<Scene, GltfError> {
        if scene.instances.is_empty() {
            return Err(self.empty(&scene.warnings));
        }
        // Normalise and bake, unless all vertices can stay as they are in the file
        let normalisation = Normalisation::fitting(&scene.bounds_from(&bounds));
        let stays = normalisation.is_identity() && scene.instances.iter().all(Instance::is_identity);
        if !stays {
            scene.normalise_and_bake(normalisation, &bounds);
            if scene.instances.is_empty() {
                return Err(self.empty(&scene.warnings));
            }
            bounds = scene.geometries.iter().map(Geometry::bounds).collect();
        }
        // Add the requested or default camera, and the requested or default lights
        scene
            .place_cameras(&options.camera, &bounds)
            .map_err(|source| GltfError::Scene {
                file: self.file.clone(),
                source,
            })?;
        if options.emissive_lights {
            let warning = scene.add_emissive_lights();
            scene.warnings.extend(warning);
        }
        if scene.lights.is_empty() {
            options.default_light.apply(&mut scene);
        }
        drop_unusable_scattering(&mut scene);
        // Validate the scene, then fold constant textures
        truncate_warnings(&mut scene.warnings);
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

/// Removes the subsurface scattering of materials of points, which have no interior, and scattering that is beyond the
/// range of the coefficients in the units of the scene.
fn drop_unusable_scattering(scene: &mut Scene) {
    for instance in &scene.instances {
        let is_points = matches!(scene.geometries[instance.geometry as usize], Geometry::Points(_));
        let scattering = &mut scene.materials[instance.material as usize].subsurface;
        scattering.take_if(|scattering| is_points || Dipole::new(scattering).is_err());
    }
}

/// Truncates the warnings, so that those of a file with ten thousand odd nodes stay readable.
fn truncate_warnings(warnings: &mut Vec<String>) {
    const MAX_WARNINGS: usize = 100;
    let rest = warnings.len().saturating_sub(MAX_WARNINGS);
    warnings.truncate(MAX_WARNINGS);
    if rest > 0 {
        warnings.push(format!("{rest} more warnings are not shown"));
    }
}
