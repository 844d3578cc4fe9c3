//! Name resolution: objects of a file with everything they refer to resolved: names, files, geometries, materials and
//! numbers of copies.
//!
//! After this stage nothing can be missing, cyclic or too numerous; flattening is the only stage left.

use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::SceneFileError;
use super::document::{Document, ObjectForm};
use super::edit::Edit;
use super::fault::{Diagnostic, Source, suggestion};
use super::gltf_import::{ImportKey, check_point_size};
use super::object_tree::{EmissiveSettings, Node, ObjectKind, ObjectTree, PlacedVolume};
use super::placement::{Copies, Step, map_of};
use super::shape::{ShapeForm, ShapeRef};
use super::source_text::{edited, read};
use super::value::Located;
use super::volume::VolumeForm;
use crate::gltf::{self, AnimationTime, LoadOptions, UnsupportedExtensions};
use crate::numeric::AnimatedTransform;
use crate::scene::{Camera, EffectSet, Geometry, ImageCache, Light, Scene, Texture, TextureBinding};

/// Largest number of instances of a scene: about 4 GiB of them.
pub(super) const MAX_INSTANCES: u64 = 10_000_000;
/// Largest nesting depth of groups and files.
const MAX_NESTING: usize = 64;
/// Bytes of a texel in the unit of the image budget.
const TEXEL_BYTES: u64 = size_of::<[u8; 4]>() as u64;

/// Builder of object trees, which adds the resources they refer to to the scene.
pub(super) struct Resolver {
    pub(super) scene: Scene,
    pub(super) texels_left: u64,
    /// Effects that will not be simulated, whose images need not be decoded.
    pub(super) without: EffectSet,
    /// Number of files and groups that are being resolved.
    nesting: usize,
    /// Files that are being read, the outermost first.
    open_files: Vec<PathBuf>,
    includes: HashMap<PathBuf, Rc<ObjectTree>>,
    imports: HashMap<ImportKey, Rc<ObjectTree>>,
    words: HashMap<String, u32>,
    default_material: Option<u32>,
    /// Materials that state the number of rays into their lobes.
    pub(super) exact_rough_rays: HashSet<u32>,
    /// Time at which glTF animations are evaluated.
    pose: Option<AnimationTime>,
    variant: Option<String>,
    unsupported: UnsupportedExtensions,
    /// True if glTF files may refer to files outside of their folders.
    allows_outside: bool,
    /// Diameter of the points of glTF files, unless an object has its own.
    point_size: Option<f64>,
    /// Cache of images that are already decoded.
    pub(super) image_cache: ImageCache,
    /// Edits that apply to the outermost file.
    edits: Vec<Edit>,
    pub(super) group_count: usize,
}

/// State of a file whose objects are being resolved.
struct FileContext {
    source: Rc<Source>,
    folder: PathBuf,
    document: Document,
    materials: HashMap<String, u32>,
    shapes: HashMap<String, u32>,
    groups: HashMap<String, Rc<ObjectTree>>,
    open_groups: Vec<String>,
}

impl Resolver {
    pub(super) fn new(options: &LoadOptions, edits: &[Edit]) -> Resolver {
        Resolver {
            edits: edits.to_vec(),
            pose: options.pose.clone(),
            variant: options.variant.clone(),
            unsupported: options.unsupported,
            allows_outside: options.allows_outside,
            point_size: options.point_size,
            image_cache: options.image_cache.clone(),
            scene: Scene::default(),
            texels_left: options.max_texels,
            without: options.without,
            nesting: 0,
            open_files: Vec::new(),
            includes: HashMap::new(),
            imports: HashMap::new(),
            words: HashMap::new(),
            default_material: None,
            exact_rough_rays: HashSet::new(),
            group_count: 0,
        }
    }

    /// Returns the numbers of included scene files and of glTF files that were read.
    pub(super) fn file_counts(&self) -> [usize; 2] {
        [self.includes.len(), self.imports.len()]
    }

    /// Returns the material of objects that name none; adds it to the scene on first use.
    pub(super) fn default_material(&mut self) -> u32 {
        let materials = &mut self.scene.materials;
        *self.default_material.get_or_insert_with(|| {
            let plain = super::material_form::MaterialForm::default();
            materials.push(plain.material("default").unwrap_or_default());
            materials.len() as u32 - 1
        })
    }

    /// Reads the file at `path` and resolves its objects; returns them with the parsed document and its source.
    pub(super) fn file(&mut self, path: &Path) -> Result<(ObjectTree, Document, Rc<Source>), SceneFileError> {
        // Read, edit and parse the file
        let source = Rc::new(edited(read(path)?, &std::mem::take(&mut self.edits))?);
        let document: Document = source.parse()?;
        let mut unit = FileContext {
            folder: path.parent().unwrap_or(Path::new("")).to_owned(),
            materials: self.materials(&source, path, &document)?,
            shapes: HashMap::new(),
            groups: HashMap::new(),
            open_groups: Vec::new(),
            source: source.clone(),
            document,
        };
        // Resolve shapes, groups and objects, in the order of their dependence
        self.named_shapes(&mut unit)?;
        let names: Vec<String> = unit.document.group.keys().cloned().collect();
        for name in names {
            self.group(&mut unit, &name)?;
        }
        let objects = std::mem::take(&mut unit.document.object);
        let mut assembly = self.objects(&mut unit, &objects)?;
        // Add lights, cameras and volumes
        assembly.lights = lights(&unit)?;
        assembly.cameras = cameras(&unit)?;
        assembly.volumes = self.volumes(&unit)?;
        assembly.count = assembly.count.saturating_add(assembly.volumes.len() as u64);
        Ok((assembly, unit.document, source))
    }

    /// Loads the volumes of a file. Their bytes are charged to the image budget.
    fn volumes(&mut self, unit: &FileContext) -> Result<Vec<PlacedVolume>, SceneFileError> {
        let forms = &unit.document.volume;
        let fail = |fault| unit.source.error(fault);
        check_names(forms.iter().map(|form| form.name.as_ref()), "volume").map_err(fail)?;
        let mut volumes = Vec::with_capacity(forms.len());
        for (number, form) in forms.iter().enumerate() {
            // Limit the volume to what is left of the image budget
            let max_bytes = self.texels_left.saturating_mul(TEXEL_BYTES);
            let made = VolumeForm::volume(form, number, &unit.folder, max_bytes).map_err(fail)?;
            let texels = made.bytes().div_ceil(TEXEL_BYTES);
            self.texels_left -= texels.min(self.texels_left);
            volumes.push(PlacedVolume {
                made,
                source: unit.source.clone(),
                span: form.span.clone(),
            });
        }
        Ok(volumes)
    }

    fn named_shapes(&mut self, unit: &mut FileContext) -> Result<(), SceneFileError> {
        for (name, form) in &unit.document.shape {
            // A name for a plain shape would be ambiguous
            if ShapeForm::of_word(name).is_some() {
                let sentence = format!("`{name}` always means the plain {name}: choose another name");
                return Err(unit.source.error(form.fault(sentence)));
            }
            let geometry = self.shape(&unit.source, form, &form.span)?;
            unit.shapes.insert(name.clone(), geometry);
        }
        Ok(())
    }

    /// Adds the geometry of a shape to the scene; `span` is where a fault of the whole shape is reported.
    fn shape(
        &mut self,
        source: &Source,
        form: &ShapeForm,
        span: &Range<usize>,
    ) -> Result<u32, SceneFileError> {
        let geometry = form
            .geometry()
            .map_err(|fault| source.error_at(fault.span.unwrap_or(span.clone()), fault.sentence))?;
        self.scene.geometries.push(geometry);
        Ok(self.scene.geometries.len() as u32 - 1)
    }

    /// Returns a group of the file, resolving it on first use.
    fn group(&mut self, unit: &mut FileContext, name: &str) -> Result<Rc<ObjectTree>, SceneFileError> {
        if let Some(group) = unit.groups.get(name) {
            return Ok(group.clone());
        }
        // The group is removed from the document while its objects are resolved; one that is missing is therefore open.
        let Some(form) = unit.document.group.remove(name) else {
            return Ok(Rc::default());
        };
        // Resolve the group's objects, with the group marked as open
        unit.open_groups.push(name.to_owned());
        self.nesting += 1;
        let made = self.objects(unit, &form.object)?;
        self.nesting -= 1;
        unit.open_groups.pop();
        let group = Rc::new(made);
        unit.groups.insert(name.to_owned(), group.clone());
        self.group_count += 1;
        Ok(group)
    }

    fn objects(
        &mut self,
        unit: &mut FileContext,
        forms: &[Located<ObjectForm>],
    ) -> Result<ObjectTree, SceneFileError> {
        let mut assembly = ObjectTree::default();
        check_names(forms.iter().map(|form| form.name.as_ref()), "object")
            .map_err(|fault| unit.source.error(fault))?;
        for (number, form) in forms.iter().enumerate() {
            let node = self.node(unit, form, number)?;
            // Count the instances, copies included
            let inner = match &node.what {
                ObjectKind::Geometry(_) => 1,
                ObjectKind::ObjectTree(inside) | ObjectKind::Import(inside) => inside.count,
            };
            let copies = node.copies.as_ref().map_or(1, Copies::count);
            assembly.count = assembly.count.saturating_add(inner.saturating_mul(copies));
            if assembly.count > MAX_INSTANCES {
                let sentence = format!("makes more than {MAX_INSTANCES} objects in all: make fewer copies");
                return Err(unit.source.error(form.fault(sentence)));
            }
            assembly.nodes.push(node);
        }
        Ok(assembly)
    }

    fn node(
        &mut self,
        unit: &mut FileContext,
        form: &Located<ObjectForm>,
        number: usize,
    ) -> Result<Node, SceneFileError> {
        let source = unit.source.clone();
        // Name the object by its number where it has no name
        let name = form
            .name
            .as_ref()
            .map_or_else(|| format!("object {}", number + 1), |n| n.to_string());
        let map_of = |steps: &[Located<Step>]| {
            map_of(steps.iter().map(|step| &**step))
                .map_err(|(step, sentence)| source.error(steps[step].fault(sentence)))
        };
        // Compose the transforms at the start and at the end of the motion
        let start = map_of(&form.transform)?;
        let mut end = start;
        if let Some(steps) = &form.transform_end {
            end = map_of(steps)?;
            AnimatedTransform::new(start, end)
                .map_err(|e| source.error(steps.fault(format!("cannot be the end of a motion: {e}"))))?;
        }
        // Resolve the material, the copies and the content
        let material = match &form.material {
            None => None,
            Some(name) => Some(find("material", name, &unit.materials).map_err(|f| source.error(f))?),
        };
        let copies = copies(form).map_err(|f| source.error(f))?;
        check_point_size(form).map_err(|f| source.error(f))?;
        let what = self.what(unit, form)?;
        if (form.lights || form.cameras) && form.gltf.is_none() && form.include.is_none() {
            let sentence = "has no lights or cameras to import: give `lights` and `cameras` only to `gltf` and `include`";
            return Err(source.error(form.fault(sentence)));
        }
        self.check_coordinates(&what, material)
            .map_err(|sentence| source.error(form.fault(sentence)))?;
        Ok(Node {
            name: name.into(),
            maps: [start, end],
            copies,
            what,
            material,
            lights: form.lights,
            cameras: form.cameras,
            emissive: form.lamp.as_ref().and_then(EmissiveSettings::of),
            source,
            span: form.span.clone(),
        })
    }

    fn what(
        &mut self,
        unit: &mut FileContext,
        form: &Located<ObjectForm>,
    ) -> Result<ObjectKind, SceneFileError> {
        let source = unit.source.clone();
        // Limit the recursion of this resolver
        if self.nesting > MAX_NESTING {
            let sentence = format!("is nested more than {MAX_NESTING} levels deep: nest less");
            return Err(source.error(form.fault(sentence)));
        }
        // Resolve the one key that is given
        match (&form.shape, &form.group, &form.gltf, &form.include) {
            (Some(shape), None, None, None) => self.shape_of(unit, shape).map(ObjectKind::Geometry),
            (None, Some(group), None, None) => {
                // A group that is open contains itself
                if let Some(first) = unit.open_groups.iter().position(|open| *open == **group) {
                    let ring = [&unit.open_groups[first..], &[group.to_string()]]
                        .concat()
                        .join("` in `");
                    let sentence =
                        format!("groups contain each other (`{ring}`): remove one of these references");
                    return Err(source.error(group.fault(sentence)));
                }
                let known: HashMap<String, ()> = (unit.document.group.keys().chain(unit.groups.keys()))
                    .map(|name| (name.clone(), ()))
                    .collect();
                find("group", group, &known).map_err(|f| source.error(f))?;
                self.group(unit, group).map(ObjectKind::ObjectTree)
            }
            (None, None, Some(file), None) => {
                let path = unit.folder.join(&**file);
                let point_size = form.point_size.as_ref().map(|size| **size);
                self.import(&path, point_size.or(self.point_size))
                    .map(ObjectKind::Import)
                    .map_err(|sentence| source.error(file.fault(sentence)))
            }
            (None, None, None, Some(file)) => self.include(unit, file).map(ObjectKind::ObjectTree),
            _ => {
                let sentence =
                    "is ambiguous or incomplete: give exactly one of `shape`, `group`, `gltf` and `include`";
                Err(source.error(form.fault(sentence)))
            }
        }
    }

    fn shape_of(&mut self, unit: &FileContext, shape: &Located<ShapeRef>) -> Result<u32, SceneFileError> {
        let name = match &**shape {
            ShapeRef::Inline(form) => return self.shape(&unit.source, form, &shape.span),
            ShapeRef::Name(name) => name,
        };
        // Use a named shape, or a plain one that exists already
        if let Some(&geometry) = unit.shapes.get(name).or_else(|| self.words.get(name)) {
            return Ok(geometry);
        }
        // Otherwise the name must be a word for a plain shape
        let Some(form) = ShapeForm::of_word(name) else {
            let mut known: Vec<&str> = ShapeForm::words().collect();
            known.extend(unit.shapes.keys().map(String::as_str));
            let advice = suggestion(name, &known);
            return Err(unit
                .source
                .error(shape.fault(format!("there is no shape `{name}`: {advice}"))));
        };
        let geometry = self.shape(&unit.source, &form, &shape.span)?;
        self.words.insert(name.clone(), geometry);
        Ok(geometry)
    }

    /// Returns the objects of another scene file, which is read once.
    fn include(
        &mut self,
        unit: &FileContext,
        file: &Located<String>,
    ) -> Result<Rc<ObjectTree>, SceneFileError> {
        let path = unit.folder.join(&**file);
        // Files are compared by their canonical paths
        let key = path.canonicalize().map_err(|e| {
            unit.source
                .error(file.fault(format!("{} cannot be read ({e}): check the path", path.display())))
        })?;
        // A file that is open includes itself
        if self.open_files.contains(&key) {
            let sentence = format!(
                "{} includes itself, directly or indirectly: remove the include",
                path.display()
            );
            return Err(unit.source.error(file.fault(sentence)));
        }
        if let Some(known) = self.includes.get(&key) {
            return Ok(known.clone());
        }
        let assembly = self.parse_file(&path, key.clone())?.0;
        let assembly = Rc::new(assembly);
        self.includes.insert(key, assembly.clone());
        Ok(assembly)
    }

    /// Runs [`Resolver::file`] with the file marked as open, which detects circular includes.
    pub(super) fn parse_file(
        &mut self,
        path: &Path,
        key: PathBuf,
    ) -> Result<(ObjectTree, Document, Rc<Source>), SceneFileError> {
        self.open_files.push(key);
        self.nesting += 1;
        let made = self.file(path)?;
        self.nesting -= 1;
        self.open_files.pop();
        Ok(made)
    }

    /// Returns the objects of a glTF file with points of this diameter; the file is read once for each.
    fn import(&mut self, path: &Path, point_size: Option<f64>) -> Result<Rc<ObjectTree>, String> {
        let key = ImportKey::new(path, point_size);
        if let Some(known) = self.imports.get(&key) {
            return Ok(known.clone());
        }
        let options = LoadOptions {
            max_texels: self.texels_left,
            without: self.without,
            pose: self.pose.clone(),
            image_cache: self.image_cache.clone(),
            variant: self.variant.clone(),
            unsupported: self.unsupported,
            allows_outside: self.allows_outside,
            point_size,
            ..LoadOptions::default()
        };
        let part = gltf::load_part(path, &options).map_err(|error| error.to_string())?;
        let source = Source {
            path: path.to_owned(),
            text: String::new(),
        };
        let assembly = Rc::new(self.merge(part, Rc::new(source)));
        self.imports.insert(key, assembly.clone());
        Ok(assembly)
    }

    /// Moves the contents of a glTF file's scene into this one; its indices are shifted behind the existing ones.
    fn merge(&mut self, part: Scene, source: Rc<Source>) -> ObjectTree {
        let scene = &mut self.scene;
        let geometries = scene.geometries.len() as u32;
        let materials = scene.materials.len() as u32;
        let textures = scene.textures.len() as u32;
        let images = scene.images.len() as u32;
        // Charge the decoded images to the budget
        self.texels_left -= part
            .images
            .iter()
            .map(|image| image.texels.budget())
            .sum::<u64>()
            .min(self.texels_left);
        // Append the resources with shifted indices
        scene.animations.extend(part.animations);
        scene.geometries.extend(part.geometries);
        scene.images.extend(part.images);
        scene
            .textures
            .extend(part.textures.into_iter().map(|mut texture| {
                if let Texture::Image { image, .. } = &mut texture {
                    *image += images;
                }
                texture
            }));
        scene
            .materials
            .extend(part.materials.into_iter().map(|mut material| {
                for layer in &mut material.layers {
                    layer.texture.texture += textures;
                }
                material
            }));
        let file = source.path.display().to_string();
        let warnings = part
            .warnings
            .into_iter()
            .map(|warning| format!("{file}: {warning}"));
        scene.warnings.extend(warnings);
        scene.extensions.extend(part.extensions);
        scene.extensions.sort_by(|a, b| a.name.cmp(&b.name));
        scene.extensions.dedup_by(|a, b| a.name == b.name);
        // Make an object of each instance
        let nodes: Vec<Node> = part
            .instances
            .into_iter()
            .map(|instance| Node {
                maps: [instance.world_from_object(); 2],
                name: instance.name,
                copies: None,
                what: ObjectKind::Geometry(instance.geometry + geometries),
                material: Some(instance.material + materials),
                lights: false,
                cameras: false,
                emissive: None,
                source: source.clone(),
                span: 0..0,
            })
            .collect();
        ObjectTree {
            count: nodes.len() as u64,
            nodes,
            lights: part.lights,
            cameras: part.cameras,
            volumes: Vec::new(),
        }
    }

    /// Checks that a mesh has the texture coordinates that its object's material uses.
    fn check_coordinates(&self, what: &ObjectKind, material: Option<u32>) -> Result<(), String> {
        // Only a mesh with a material of its own can lack coordinates at this point
        let (ObjectKind::Geometry(geometry), Some(material)) = (what, material) else {
            return Ok(());
        };
        let Geometry::Mesh(mesh) = &self.scene.geometries[*geometry as usize] else {
            return Ok(());
        };
        let material = &self.scene.materials[material as usize];
        let lacks = |layer: &&TextureBinding| {
            self.scene.looks_up_coordinates(layer.texture.texture)
                && layer.texture.tex_coord as usize >= mesh.tex_coords.len()
        };
        match material.layers.iter().find(lacks) {
            None => Ok(()),
            Some(layer) => Err(format!(
                "its material `{}` looks up texture coordinate set {}, which its mesh lacks: give the mesh `uv` or the \
                 texture `space = \"object\"`",
                material.name, layer.texture.tex_coord
            )),
        }
    }
}

fn lights(unit: &FileContext) -> Result<Vec<Light>, SceneFileError> {
    let forms = &unit.document.light;
    check_names(forms.iter().map(|form| form.name.as_ref()), "light").map_err(|f| unit.source.error(f))?;
    (forms.iter().enumerate())
        .map(|(number, form)| form.light(number).map_err(|s| unit.source.error(form.fault(s))))
        .collect()
}

fn cameras(unit: &FileContext) -> Result<Vec<Camera>, SceneFileError> {
    let forms = &unit.document.camera.0;
    check_names(forms.iter().map(|form| form.name.as_ref()), "camera").map_err(|f| unit.source.error(f))?;
    (forms.iter().enumerate())
        .map(|(number, form)| form.camera(number).map_err(|s| unit.source.error(form.fault(s))))
        .collect()
}

fn check_names<'f>(
    names: impl Iterator<Item = Option<&'f Located<String>>>,
    kind: &str,
) -> Result<(), Diagnostic> {
    let mut taken: HashSet<&str> = HashSet::new();
    for name in names.flatten() {
        if !taken.insert(name) {
            return Err(name.fault(format!(
                "the name `{}` is already used by an earlier {kind}: choose another",
                **name
            )));
        }
    }
    Ok(())
}

fn copies(form: &ObjectForm) -> Result<Option<Copies>, Diagnostic> {
    match (&form.repeat, &form.scatter) {
        (Some(_), Some(scatter)) => {
            Err(scatter.fault("cannot be combined with `repeat`: give one, and use a group for the other"))
        }
        (Some(repeat), None) => repeat.copies().map(Some).map_err(|s| repeat.fault(s)),
        (None, Some(scatter)) => scatter.copies().map(Some).map_err(|s| scatter.fault(s)),
        (None, None) => Ok(None),
    }
}

/// Returns the value of a name; an error suggests a known name.
pub(super) fn find<T: Copy>(
    kind: &str,
    name: &Located<String>,
    known: &HashMap<String, T>,
) -> Result<T, Diagnostic> {
    known.get(&**name).copied().ok_or_else(|| {
        // Sorted, as the order of a hash map would change the message from run to run
        let mut names: Vec<&str> = known.keys().map(String::as_str).collect();
        names.sort_unstable();
        let advice = if names.is_empty() {
            format!("add [{kind}.{}]", **name)
        } else {
            suggestion(name, &names)
        };
        name.fault(format!("there is no {kind} `{}`: {advice}", **name))
    })
}
