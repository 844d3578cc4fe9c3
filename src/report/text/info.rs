//! Description of a loaded scene: `whit info`.

use std::collections::BTreeMap;
use std::fmt::{self, Write};
use std::path::PathBuf;

use serde::Serialize;

use crate::bench::AblationStudy;
use crate::render::plan::{Decision, Plan};
use crate::scene::{
    Animation, AreaShape, EffectOverrides, ExtensionUse, Geometry, LightKind, Projection, Scene,
};
use crate::shape::Shape;

use super::ablation;
use super::accel_info::{self, StructureRow};
use super::forecast::Forecast;
pub use super::material_info::MaterialInfo;
use super::volume_info;
pub use super::volume_info::{FogInfo, VolumeInfo};
use crate::report::memory::{self, MemoryForecast};

/// Numbers and names of a scene's contents.
#[derive(Clone, Debug, Serialize)]
pub struct SceneInfo {
    /// Path of the scene as given on the command line.
    pub scene: PathBuf,
    /// Number of triangles; a shared mesh counts once per instance.
    pub triangles: usize,
    /// Number of points; a shared point cloud counts once per instance.
    pub points: usize,
    /// Number of analytic shapes among the geometries.
    pub shapes: usize,
    /// Number of meshes and shapes.
    pub geometries: usize,
    /// Number of instances by the name of their shape, or `mesh`.
    pub objects: BTreeMap<&'static str, usize>,
    /// Number of a scene file's groups, which were flattened.
    pub groups: usize,
    /// Number of files that a scene file includes.
    pub included_files: usize,
    /// Number of instances of all geometries.
    pub instances: usize,
    /// Number of instances that are not baked into world space.
    pub transformed_instances: usize,
    /// Bytes of vertex and index arrays.
    pub mesh_bytes: u64,
    /// Number of materials, the default one included where it is used.
    pub materials: usize,
    /// Main values of the materials, in order.
    pub material_list: Vec<MaterialInfo>,
    /// Number of material textures.
    pub textures: usize,
    /// Number of decoded images.
    pub images: usize,
    /// Bytes of the decoded images.
    pub image_bytes: u64,
    /// Volumes in the order of the file.
    pub volumes: Vec<VolumeInfo>,
    /// Bytes of the volumes' grids.
    pub volume_bytes: u64,
    /// Fog that fills all space; null if there is none.
    pub fog: Option<FogInfo>,
    /// Lights in the order of the file.
    pub lights: Vec<LightInfo>,
    /// Radiance of the background, linear RGB.
    pub ambient: [f32; 3],
    /// Cameras; the index in the list is the number for `--camera`.
    pub cameras: Vec<CameraInfo>,
    /// Animations of glTF files, for `--time` and `--animation`.
    pub animations: Vec<Animation>,
    /// Bounds of all instances in the file's coordinates; null for an empty scene.
    pub bounds: Option<BoundsInfo>,
    /// Transform from the file's coordinates to the rendered ones: `(p - center) * scale`.
    pub normalisation: NormalisationInfo,
    /// Estimated memory for rendering the scene.
    pub memory: MemoryForecast,
    /// Reasons for simulating or skipping each effect, for the first camera.
    pub effects: BTreeMap<&'static str, String>,
    /// Decisions on the effects in the plan's order, for the first camera.
    pub plan: Vec<Decision>,
    /// Parts of the acceleration structure, and the reasons for their presence or absence.
    pub structure: Vec<StructureRow>,
    /// Estimated distribution of rays and time, from a quick probe.
    pub forecast: Option<Forecast>,
    /// Reason for which there is no forecast.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_forecast: Option<String>,
    /// Cost of each effect; absent unless requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prices: Option<AblationStudy>,
    /// Names of the variants of materials, for `--variant`.
    pub variants: Vec<String>,
    /// Extensions that glTF files state, and how far images honour each.
    pub extensions: Vec<ExtensionUse>,
    /// Objects that were dropped or approximated while loading.
    pub warnings: Vec<String>,
}

/// Description of a light.
#[derive(Clone, Debug, Serialize)]
pub struct LightInfo {
    /// Name from the file, or a generated one.
    pub name: String,
    /// Kind of light: `point`, `spot` or `directional`, or the shape of an area light.
    pub kind: &'static str,
    /// Intensity as in the file, linear RGB: candela for point and spot lights, lux for directional ones, radiance in
    /// candela per square metre for area lights.
    pub intensity: [f32; 3],
}

/// Description of a camera.
#[derive(Clone, Debug, Serialize)]
pub struct CameraInfo {
    /// Name from the file, or a generated one.
    pub name: String,
    /// Kind of projection: `perspective`, `window` or `orthographic`.
    pub kind: &'static str,
    /// Full vertical field of view in degrees, for projections that have one.
    pub y_fov_degrees: Option<f64>,
}

/// Axis-aligned bounding box in the file's coordinates.
#[derive(Clone, Debug, Serialize)]
pub struct BoundsInfo {
    /// Corner with the smallest coordinates.
    pub min: [f64; 3],
    /// Corner with the largest coordinates.
    pub max: [f64; 3],
}

/// Translation and scaling that normalise a scene.
#[derive(Clone, Debug, Serialize)]
pub struct NormalisationInfo {
    /// Point that becomes the origin, in the file's coordinates.
    pub center: [f64; 3],
    /// Scale factor, which is a power of two.
    pub scale: f64,
}

impl SceneInfo {
    /// Describes a loaded scene that was read from `path`, with the user's overrides of effects.
    pub fn of(scene: &Scene, path: impl Into<PathBuf>, overrides: &EffectOverrides) -> SceneInfo {
        // Plan effects for the first camera
        let plan = scene
            .cameras
            .first()
            .map_or_else(Vec::new, |camera| Plan::new(scene, camera, overrides).decisions);
        // Collect counts, sizes, bounds and decisions
        SceneInfo {
            scene: path.into(),
            triangles: scene.triangle_count(),
            points: scene.point_count(),
            shapes: scene
                .geometries
                .iter()
                .filter(|g| matches!(g, Geometry::Shape(_)))
                .count(),
            geometries: scene.geometries.len(),
            instances: scene.instances.len(),
            transformed_instances: scene.instances.iter().filter(|i| !i.is_identity()).count(),
            mesh_bytes: memory::mesh_bytes(scene),
            objects: objects(scene),
            groups: 0,
            included_files: 0,
            materials: scene.materials.len(),
            material_list: scene.materials.iter().map(MaterialInfo::of).collect(),
            textures: scene.textures.len(),
            images: scene.images.len(),
            image_bytes: memory::image_bytes(scene),
            volumes: volume_info::volumes(scene),
            volume_bytes: memory::volume_bytes(scene),
            fog: volume_info::fog(scene),
            lights: lights(scene),
            ambient: scene.ambient,
            cameras: cameras(scene),
            animations: scene.animations.clone(),
            bounds: bounds(scene),
            normalisation: NormalisationInfo {
                center: scene.normalisation.center.to_array(),
                scale: scene.normalisation.scale,
            },
            memory: MemoryForecast::of(scene),
            effects: plan
                .iter()
                .map(|decision| (decision.effect.name(), decision.reason.clone()))
                .collect(),
            plan,
            structure: accel_info::rows(scene),
            forecast: None,
            no_forecast: None,
            prices: None,
            variants: scene.variants.clone(),
            extensions: scene.extensions.clone(),
            warnings: scene.warnings.clone(),
        }
    }
}

fn objects(scene: &Scene) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    for instance in &scene.instances {
        let kind = match &scene.geometries[instance.geometry as usize] {
            Geometry::Mesh(_) => "mesh",
            Geometry::Points(_) => "point cloud",
            Geometry::Shape(shape) => match shape {
                Shape::Sphere(_) => "sphere",
                Shape::Plane => "plane",
                Shape::Cube => "cube",
                Shape::Polyhedron(_) => "polyhedron",
                Shape::Disk => "disk",
                Shape::Quad => "quad",
                Shape::Cylinder(_) => "cylinder",
                Shape::Cone(_) => "cone",
                Shape::Torus(_) => "torus",
                Shape::Quadric(_) => "quadric",
            },
        };
        *counts.entry(kind).or_insert(0) += 1;
    }
    counts
}

fn lights(scene: &Scene) -> Vec<LightInfo> {
    // Irradiance is intensity over squared distance, and distances were scaled.
    let area_scale = scene.normalisation.scale.powi(2);
    // Undo the scale of punctual intensities
    let describe = |kind: &LightKind| match kind {
        LightKind::Directional { .. } => ("directional", 1.0),
        LightKind::Point { .. } => ("point", area_scale),
        LightKind::Spot { .. } => ("spot", area_scale),
        LightKind::Area { shape, .. } => match shape {
            AreaShape::Quad { .. } => ("quad", 1.0),
            AreaShape::Disk { .. } => ("disk", 1.0),
            AreaShape::Sphere { .. } => ("sphere", 1.0),
            AreaShape::Object { .. } => ("object", 1.0),
        },
    };
    scene
        .lights
        .iter()
        .map(|light| {
            let (kind, scale) = describe(&light.kind);
            LightInfo {
                name: light.name.clone(),
                kind,
                intensity: light.intensity.map(|i| (f64::from(i) / scale) as f32),
            }
        })
        .collect()
}

fn cameras(scene: &Scene) -> Vec<CameraInfo> {
    scene
        .cameras
        .iter()
        .map(|camera| {
            let (kind, y_fov_degrees) = match camera.projection {
                Projection::Perspective { y_fov, .. } => ("perspective", Some(y_fov.to_degrees())),
                Projection::Window {
                    half_height,
                    distance,
                    ..
                } => ("window", Some(2.0 * (half_height / distance).atan().to_degrees())),
                Projection::Orthographic { .. } => ("orthographic", None),
            };
            CameraInfo {
                name: camera.name.clone(),
                kind,
                y_fov_degrees,
            }
        })
        .collect()
}

/// Returns the scene's bounds in the file's coordinates.
fn bounds(scene: &Scene) -> Option<BoundsInfo> {
    let bounds = scene.bounds();
    let from_scene = |p: glam::DVec3| (p / scene.normalisation.scale + scene.normalisation.center).to_array();
    (!bounds.is_empty()).then(|| BoundsInfo {
        min: from_scene(bounds.min),
        max: from_scene(bounds.max),
    })
}

/// Largest number of materials in the text form; JSON lists all.
const MAX_MATERIALS: usize = 32;

/// Text form for a person: one subject per line.
impl fmt::Display for SceneInfo {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let words = memory::in_words;
        let mut line = |subject: &str, text: String| writeln!(f, "{subject:<15}{text}");
        // Print geometry and instances
        line("scene", self.scene.display().to_string())?;
        line("triangles", self.triangles.to_string())?;
        if self.points > 0 {
            line("points", self.points.to_string())?;
        }
        line(
            "geometries",
            format!(
                "{} ({} analytic shapes), {}",
                self.geometries,
                self.shapes,
                words(self.mesh_bytes)
            ),
        )?;
        line(
            "instances",
            format!("{} ({} transformed)", self.instances, self.transformed_instances),
        )?;
        let objects: Vec<String> = self
            .objects
            .iter()
            .map(|(kind, n)| format!("{n} {kind}"))
            .collect();
        line("objects", objects.join(", "))?;
        if self.groups + self.included_files > 0 {
            line(
                "flattened",
                format!("{} groups, {} included files", self.groups, self.included_files),
            )?;
        }
        // Print materials, textures and volumes
        line("materials", self.materials.to_string())?;
        for (number, material) in self.material_list.iter().enumerate().take(MAX_MATERIALS) {
            line(&format!("material {number}"), material.to_string())?;
        }
        line(
            "textures",
            format!(
                "{} of {} images, {}",
                self.textures,
                self.images,
                words(self.image_bytes)
            ),
        )?;
        for (number, volume) in self.volumes.iter().enumerate() {
            line(&format!("volume {number}"), volume.to_string())?;
        }
        if let Some(fog) = &self.fog {
            line("fog", fog.to_string())?;
        }
        // Print lights and cameras
        for (number, light) in self.lights.iter().enumerate() {
            let [r, g, b] = light.intensity;
            let unit = match light.kind {
                "point" | "spot" => "cd",
                "directional" => "lx",
                _ => "cd/m²",
            };
            line(
                &format!("light {number}"),
                format!("`{}`, {}, {r} {g} {b} {unit}", light.name, light.kind),
            )?;
        }
        let [r, g, b] = self.ambient;
        line("ambient", format!("{r} {g} {b}"))?;
        for (number, camera) in self.cameras.iter().enumerate() {
            let fov = camera
                .y_fov_degrees
                .map_or(String::new(), |fov| format!(", {fov:.1} degrees high"));
            line(
                &format!("camera {number}"),
                format!("`{}`, {}{fov}", camera.name, camera.kind),
            )?;
        }
        // Print animations, bounds and normalisation
        for (number, animation) in self.animations.iter().enumerate() {
            let [from, to] = animation.seconds;
            line(
                &format!("animation {number}"),
                format!(
                    "`{}`, {from} to {to} s, {} channels",
                    animation.name, animation.channels
                ),
            )?;
        }
        match &self.bounds {
            Some(bounds) => line("bounds", format!("{:?} to {:?}", bounds.min, bounds.max))?,
            None => line("bounds", "empty".into())?,
        }
        let normalisation = &self.normalisation;
        line(
            "normalisation",
            format!("(p - {:?}) * {}", normalisation.center, normalisation.scale),
        )?;
        // Print effects with forecast and cost
        for decision in &self.plan {
            let forecast = self
                .forecast
                .as_ref()
                .map(|forecast| forecast.note(decision.effect));
            let price = self
                .prices
                .as_ref()
                .map(|prices| ablation::note(prices, decision.effect));
            let notes = [forecast, price].map(Option::unwrap_or_default).concat();
            line("effect", format!("{decision}{notes}"))?;
        }
        for row in &self.structure {
            line("structure", row.to_string())?;
        }
        if let Some(reason) = &self.no_forecast {
            line("forecast", format!("none: {reason}"))?;
        }
        // Print estimated memory
        let memory = &self.memory;
        let held = [
            (memory.subsurface_bytes, "subsurface scattering"),
            (memory.photon_bytes, "photons of caustics"),
        ];
        let held = held.into_iter().filter(|(bytes, _)| *bytes > 0);
        let within: String = held
            .map(|(bytes, what)| format!(", plus {} for {what}", words(bytes)))
            .collect();
        line(
            "memory",
            format!(
                "scene {}, plus Embree about {} or BSP about {}, plus {} for 1024x1024 pixels{within}",
                words(memory.scene_bytes),
                words(memory.embree_bytes),
                words(memory.bsp_bytes),
                words(memory.film_bytes)
            ),
        )?;
        // Print forecast, costs, extensions and warnings
        if let Some(forecast) = &self.forecast {
            write!(f, "{forecast}")?;
        }
        if let Some(prices) = &self.prices {
            write!(f, "{prices}")?;
        }
        let mut remarks = String::new();
        if !self.variants.is_empty() {
            writeln!(remarks, "{:<15}{}", "variants", self.variants.join(", "))?;
        }
        for extension in &self.extensions {
            writeln!(remarks, "{:<15}{extension}", "extension")?;
        }
        for warning in &self.warnings {
            writeln!(remarks, "{:<15}{warning}", "warning")?;
        }
        f.write_str(&remarks)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::scene::{Falloff, Instance, Light, Material, Normalisation};
    use crate::shape::Sphere;

    fn scene() -> Scene {
        Scene {
            geometries: vec![Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
            instances: vec![Instance::new("ball", 0, 0, glam::DAffine3::IDENTITY).unwrap()],
            materials: vec![Material::default()],
            lights: vec![Light {
                name: "sun".into(),
                intensity: [3.0, 2.0, 1.0],
                kind: LightKind::Directional { to_light: DVec3::Y },
            }],
            normalisation: Normalisation {
                center: DVec3::new(10.0, 0.0, 0.0),
                scale: 0.5,
            },
            warnings: vec!["2 triangles without area were dropped".into()],
            ..Scene::default()
        }
    }

    #[test]
    fn bounds_are_in_the_coordinates_of_the_file() {
        // A unit sphere in the scene, scaled by 1/2 and centred at 10: ±1 / 0.5 + 10 = 8 .. 12.
        let bounds = SceneInfo::of(&scene(), "a.glb", &EffectOverrides::default())
            .bounds
            .unwrap();
        assert_eq!((bounds.min, bounds.max), ([8.0, -2.0, -2.0], [12.0, 2.0, 2.0]));
        assert!(
            SceneInfo::of(&Scene::default(), "a.glb", &EffectOverrides::default())
                .bounds
                .is_none()
        );
    }

    #[test]
    fn intensities_are_those_of_the_file() {
        let mut scene = scene();
        scene.lights[0].kind = LightKind::Point {
            position: DVec3::ZERO,
            falloff: Falloff::PHYSICAL,
        };
        // Halving all lengths requires a quarter of the intensity for an equal image.
        assert_eq!(
            SceneInfo::of(&scene, "a.glb", &EffectOverrides::default()).lights[0].intensity,
            [12.0, 8.0, 4.0]
        );
    }

    #[test]
    fn area_lights_have_a_radiance() {
        let mut scene = scene();
        scene.lights[0].kind = LightKind::Area {
            shape: AreaShape::Sphere {
                center: DVec3::ZERO,
                radius: 1.0,
            },
            samples: 1,
        };
        let text = SceneInfo::of(&scene, "a.glb", &EffectOverrides::default()).to_string();
        assert!(
            text.contains("light 0        `sun`, sphere, 3 2 1 cd/m²\n"),
            "{text}"
        );
    }

    #[test]
    fn text_lists_lights_with_units_and_warnings() {
        let text = SceneInfo::of(&scene(), "a.glb", &EffectOverrides::default()).to_string();
        assert!(
            text.contains("light 0        `sun`, directional, 3 2 1 lx\n"),
            "{text}"
        );
        assert!(
            text.ends_with("warning        2 triangles without area were dropped\n"),
            "{text}"
        );
    }
}
