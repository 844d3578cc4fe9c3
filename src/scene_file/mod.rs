//! Scene files: TOML for authoring by hand, read through serde.
//!
//! A file is a list of objects and the resources that they refer to by name:
//!
//! ```toml
//! ambient = 0.1                                   # top-level values stand before all tables
//! background = { horizon = "#cfe0ff", up = "#5080d0" }
//! interreflection = true                          # diffuse light from surfaces to others; { bounces = 16 }
//! caustics = true                                 # light by mirrors and glass; { photons = 262144, neighbours = 32 }
//!
//! [output]                                        # the command line overrides these
//! size = [640, 480]
//! spp = 64
//! backend = "auto"                                # or "embree", "native", "bsp", "brute"
//!
//! [camera]                                        # or [[camera]], the first being the usual one
//! from = [0, 1.5, 5]
//! at = [0, 1, 0]
//! fov = 40                                        # degrees, vertical; `height = 3` for a parallel projection
//!
//! [[light]]
//! kind = "point"                                  # or "directional", "spot"
//! position = [3, 5, 4]
//! intensity = 80
//!
//! [texture.checks]
//! pattern = "checker"                             # or `image = "file.png"`
//! colors = ["#d02020", "#e0e020"]
//!
//! [material.floor]
//! base_color = { texture = "checks" }             # any parameter alike: a value, or a texture times a value
//!
//! [material.ball]
//! model = "lecture"                               # or "metallic-roughness" (the default), "unlit"
//! diffuse = 0.1
//! glass = "bk7"                                   # or `ior`, `speed`, `sellmeier`, `cauchy`
//!
//! [[object]]
//! shape = "plane"                                 # z = 0, so it is turned to lie on the ground
//! transform = [{ z-to = [0, 1, 0] }]
//! material = "floor"
//!
//! [[object]]
//! name = "ball"
//! shape = { sphere = { radius = 0.5 } }
//! transform = [{ scale = [1, 2, 1] }, { translate = [0, 1, 0] }]
//! material = "ball"
//! ```
//!
//! * **World.** Right-handed, +y up, metres. Colours are linear RGB as a grey number, `[r, g, b]`, or `"#rrggbb"` by
//!   the sRGB curve. Angles are degrees.
//! * **Transforms** are applied to the object in the order written: above, the ball is first stretched, then moved.
//! * **Cameras** by an explicit frame instead of a look-at have `eye`, `i`, `j`, `k`, `near` and `window = [2w, 2h]`,
//!   the window's full size.
//! * **Objects** have exactly one of `shape` (a word, `[shape.NAME]`, or `{ KIND = { ... } }` in place), `group`
//!   (`[[group.NAME.object]]`, which may hold groups), `gltf` and `include` (files, looked up beside the file that
//!   names them; names in an include are its own). A `material` goes to every member that has none; it replaces a glTF
//!   file's.
//! * **Emissive objects**: `lamp = true`, or a number of samples, makes an object's emission light the scene; it
//!   applies to the members of a group and of a file, and stays with them wherever these are included.
//! * **Volumes** (`[[volume]]`) fill the cube [-1, 1]³, which a `transform` places, with the numbers of a `file` (.npy,
//!   .nrrd), of `raw = { file = "a.raw", size = [64, 64, 32], type = "u8" }`, or of a `cloud = { shape = "plume" }`;
//!   `transfer = [{ value = 0, extinction = 0 }, { value = 1, extinction = 9, color = 0.8, emission = 0 }]` is the
//!   transfer function. `[fog]` has an `extinction` and a `color`, and fills all space; that of an include is ignored.
//! * **Copies**: `repeat = { count = [10, 1, 10], step = [2, 0, 2], jitter = 0.3, seed = 7 }` or
//!   `scatter = { count = 99, min = [...], max = [...] }`, each with random `turn` and `scale`, apply after the
//!   object's own transforms.
//!
//! Names are resolved, files read and checks made (`assembly`) before anything is flattened (`flatten`). Every
//! message names the file, the line, the item and a remedy.

mod appearance;
mod assembly;
mod camera;
mod document;
mod edit;
pub(crate) mod fault;
mod flatten;
pub(crate) mod forms;
mod gltf_import;
mod light;
mod material;
mod material_form;
mod material_interior;
mod material_layer;
mod material_scattering;
mod medium;
pub(crate) mod node;
mod object_tree;
mod on_request;
mod placement;
mod polygons;
mod scattering;
mod schema;
mod shape;
mod shape_diagnostic;
pub(crate) mod source_text;
mod texture;
pub(crate) mod value;
mod visible_background;
mod volume;

use std::path::Path;

use crate::accel::Backend;
use crate::gltf::LoadOptions;
use crate::image::ToneOperator;
use crate::scene::image_settings::{
    FilterKind, MAX_DEPTH, MAX_EXPOSURE, MAX_FILTER_RADIUS, MAX_PIXELS, MAX_SPP, MAX_WAVELENGTHS,
    MIN_FILTER_RADIUS, Pattern, VisibleBackground,
};
use crate::scene::{Background, CameraRequest, Scene};
use assembly::Resolver;
use document::{Document, OutputForm};
use fault::{Source, file_error};
use value::Located;

pub use edit::Edit;
pub use fault::SceneFileError;
pub use schema::json_schema;

/// A loaded scene file with everything it includes.
#[derive(Clone, Debug)]
pub struct SceneFile {
    /// Scene to render; [`Scene::validate`] accepts it.
    pub scene: Scene,
    /// Image settings, which the command line overrides.
    pub output: Output,
    /// Number of groups that were flattened.
    pub group_count: usize,
    /// Number of other scene files that were included.
    pub include_count: usize,
    /// Number of glTF files that were included.
    pub gltf_count: usize,
}

/// Image settings of a scene file; `None` where the file has no key.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// Width and height in pixels, 1 or more each.
    pub size: Option<[u32; 2]>,
    /// Samples per pixel, 1 to [`MAX_SPP`].
    pub spp: Option<u32>,
    /// Pattern of the samples in a pixel.
    pub pattern: Option<Pattern>,
    /// Filter that weights samples into pixels.
    pub filter: Option<FilterKind>,
    /// Radius of the filter in pixels; only with a filter that is not a box.
    pub filter_radius: Option<f64>,
    /// Number of bounces of secondary rays, up to [`MAX_DEPTH`].
    pub depth: Option<u32>,
    /// Wavelengths that a path splits into where glass disperses it, 1 to [`MAX_WAVELENGTHS`].
    pub wavelengths: Option<u32>,
    /// Stops of exposure of PNG images, up to [`MAX_EXPOSURE`] either way.
    pub exposure: Option<f32>,
    /// Background that camera rays see which go straight into the distance.
    pub background: Option<VisibleBackground>,
    /// Tone mapping operator of PNG images.
    pub tone_map: Option<ToneOperator>,
    /// Backend that finds the hits.
    pub backend: Option<Backend>,
}

impl Output {
    /// Returns these settings, with those of `other` where they are absent. A radius is only taken along with its
    /// filter.
    pub fn or(self, other: &Output) -> Output {
        Output {
            size: self.size.or(other.size),
            spp: self.spp.or(other.spp),
            pattern: self.pattern.or(other.pattern),
            filter: self.filter.or(other.filter),
            // A radius of another filter would be wrong
            filter_radius: match self.filter {
                Some(_) => self.filter_radius,
                None => self.filter_radius.or(other.filter_radius),
            },
            depth: self.depth.or(other.depth),
            wavelengths: self.wavelengths.or(other.wavelengths),
            exposure: self.exposure.or(other.exposure),
            background: self.background.or(other.background),
            tone_map: self.tone_map.or(other.tone_map),
            backend: self.backend.or(other.backend),
        }
    }
}

/// Loads a scene file and everything it includes as a normalised scene that [`Scene::validate`] accepts.
///
/// # Errors
/// A file that cannot be read, is not TOML, has unknown keys, refers to something that does not exist, includes itself,
/// or has invalid values.
pub fn load(path: &Path, options: &LoadOptions) -> Result<SceneFile, SceneFileError> {
    load_edited(path, &[], options)
}

/// Loads a scene file after edits of its keys.
///
/// # Errors
/// Errors of [`load`], and edits of keys that do not exist. With edits, errors in the edited file have no line number,
/// as its text is generated.
pub fn load_edited(path: &Path, edits: &[Edit], options: &LoadOptions) -> Result<SceneFile, SceneFileError> {
    let loaded = load_with(path, edits, options);
    loaded.map_err(|error| match error {
        SceneFileError::Item {
            file, item, fault, ..
        } if !edits.is_empty() && file == path => {
            // Name the edits instead of the line
            let changes: Vec<String> = edits.iter().map(Edit::to_string).collect();
            SceneFileError::File {
                file,
                fault: format!("with the swept {}: {item}: {fault}", changes.join(", ")),
            }
        }
        error => error,
    })
}

fn load_with(path: &Path, edits: &[Edit], options: &LoadOptions) -> Result<SceneFile, SceneFileError> {
    // Resolve the file and everything that it refers to
    let key = path
        .canonicalize()
        .map_err(|e| file_error(path, format!("cannot be read ({e}): check the path")))?;
    let mut assembler = Resolver::new(options, edits);
    let (assembly, document, source) = assembler.parse_file(path, key)?;
    // Objects and volumes both count
    if assembly.count == 0 {
        return Err(file_error(path, "holds nothing to render: add an [[object]]"));
    }
    // Read the image settings, the background and the fog
    let output = output(document.output.as_ref(), &source)?;
    let default_material = assembler.default_material();
    let [include_count, gltf_count] = assembler.file_counts();
    let group_count = assembler.group_count;
    let environment_map = assembler.environment_map(&source, path, &document)?;
    let exact_rough_rays = assembler.exact_rough_rays;
    let mut scene = assembler.scene;
    set_background(&mut scene, &document, (environment_map, path), &source)?;
    scene.caustics = document.caustics.and_then(|form| form.caustics());
    scene.interreflection = document.interreflection.and_then(|form| form.interreflection());
    if matches!(scene.background, Background::Environment { .. }) {
        scene.reflect_environment(&exact_rough_rays);
    }
    // Flatten the objects into instances
    flatten::flatten(&mut scene, &assembly, default_material)?;
    if scene.instances.iter().all(|i| i.material != default_material) {
        // The default material is unused and the last one, so removing it changes no index.
        scene.materials.pop();
    }
    // Normalise, bake and validate
    let camera = CameraRequest {
        image_size: options.camera.image_size.or(output.size),
        ..options.camera
    };
    let scene = flatten::finish(scene, &camera, path)?;
    Ok(SceneFile {
        scene,
        output,
        group_count,
        include_count,
        gltf_count,
    })
}

/// Sets the ambient light, the background and the fog; an environment map is the scene's image `image`.
fn set_background(
    scene: &mut Scene,
    document: &Document,
    (image, path): (u32, &Path),
    source: &Source,
) -> Result<(), SceneFileError> {
    scene.ambient = document.ambient.map_or([0.0; 3], |color| color.0);
    scene.background = match &document.background {
        Some(form) => form
            .background(image)
            .map_err(|sentence| file_error(path, sentence))?,
        None => Background::Uniform(scene.ambient),
    };
    if let Some(form) = &document.fog {
        let fog = form
            .fog()
            .map_err(|sentence| source.error(form.fault(sentence)))?;
        scene.fog = Some(fog);
    }
    Ok(())
}

fn output(form: Option<&Located<OutputForm>>, source: &Source) -> Result<Output, SceneFileError> {
    let Some(form) = form else {
        return Ok(Output::default());
    };
    let refuse = |sentence: String| Err(source.error(form.fault(sentence)));
    // Check the size and the numbers of samples, bounces, stops and wavelengths
    if let Some([width, height]) = form.size {
        let pixels = u64::from(width) * u64::from(height);
        if !(1..=MAX_PIXELS).contains(&pixels) {
            return refuse(format!("its size is {width} x {height}: give 1 to 2^31 pixels"));
        }
    }
    if let Some(spp) = form.spp.filter(|spp| !(1..=MAX_SPP).contains(spp)) {
        return refuse(format!("its spp is {spp}: give 1 to {MAX_SPP}"));
    }
    if let Some(depth) = form.depth.filter(|depth| *depth > MAX_DEPTH) {
        return refuse(format!("its depth is {depth}: give 0 to {MAX_DEPTH}"));
    }
    if let Some(exposure) = form.exposure.filter(|ev| !(ev.abs() <= MAX_EXPOSURE)) {
        return refuse(format!(
            "its exposure is {exposure}: give stops from -{MAX_EXPOSURE} to {MAX_EXPOSURE}"
        ));
    }
    if let Some(count) = form.wavelengths.filter(|n| !(1..=MAX_WAVELENGTHS).contains(n)) {
        return refuse(format!(
            "its number of wavelengths is {count}: give 1 to {MAX_WAVELENGTHS}"
        ));
    }
    // Check the filter's radius
    if let Some(radius) = form.filter_radius {
        if !(MIN_FILTER_RADIUS..=MAX_FILTER_RADIUS).contains(&radius) {
            return refuse(format!(
                "its filter_radius is {radius}: give {MIN_FILTER_RADIUS} to {MAX_FILTER_RADIUS} pixels"
            ));
        }
        if matches!(form.filter, None | Some(FilterKind::Box)) {
            return refuse(
                "its filter is a box, which has no filter_radius: give another `filter` or remove it".into(),
            );
        }
    }
    Ok(Output {
        size: form.size,
        spp: form.spp,
        pattern: form.pattern,
        filter: form.filter,
        filter_radius: form.filter_radius,
        depth: form.depth,
        wavelengths: form.wavelengths,
        exposure: form.exposure,
        background: form.background.map(|form| form.0),
        tone_map: form.tone_map,
        backend: form.backend,
    })
}
