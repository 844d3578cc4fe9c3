//! Renderer: turns a scene, a camera and an acceleration structure into an image, in parallel over tiles.
//!
//! This module depends on no file format and on no particular backend. An image has the same bits for any number of
//! threads and any order of tiles, because every tile owns its pixels and adds up samples in a fixed order.

mod adaptive;
mod costs;
mod departure;
mod estimate;
mod film;
mod filter;
mod first_hits;
mod gather;
mod lamps;
mod layers;
mod ledger;
mod lens;
mod light_layers;
mod losses;
mod mattes;
mod memory;
mod meter;
mod monitor;
mod mosaic;
mod outcome;
pub mod plan;
mod planes;
mod probe;
mod queue;
mod record;
mod region;
mod rough;
mod sample;
mod sampler;
mod samples;
mod screen_motion;
mod settings;
mod shade;
mod shape_point;
mod soft;
mod subsurface;
mod surface;
mod surface_packet;
mod surroundings;
mod texturing;
mod tinted;
mod transparent;
mod travel;
mod volumes;
mod wave;

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use glam::{DVec3, Vec3};

pub use adaptive::{Adaptive, Checkpoints, MIN_ADAPTIVE_ERROR, Rounds};
pub use costs::PixelCosts;
pub use departure::{SpawnPoint, SpawnProbe};
pub use film::pixel_sum;
pub use filter::PixelFilter;
pub use layers::{AovKind, AovSet, Layer};
pub use ledger::{Category, RenderProfile, Tally, TruncationBound};
pub use light_layers::LightAovs;
pub use memory::{Memory, MemoryEntry};
pub use monitor::{FinishedTile, Monitor};
pub use mosaic::{PatchGrid, render_patches};
pub use plan::Plan;
pub use probe::{Probe, probe};
pub use record::{RecordedRays, record};
pub use region::{Parts, Region, Share, Sums, TILE_SIDE};
pub use sample::{SampledTile, TileSample, render_sample, tile_count};
pub use sampler::{Purpose, sample_2d};
pub use samples::{SampleAovs, SampleCounts};
pub use subsurface::{SubsurfaceStats, subsurface_bytes};
pub use surface::HitPoint;

pub use crate::scene::image_settings::{FilterKind, Pattern};

use crate::accel::{Accel, Coherence, RayPacket};
use crate::image::LinearImage;
use crate::numeric::{LANES, Lanes, Ray, SpawnPolicy};
use crate::optics::{InteriorStack, NestedInterior, SpectralSampler};
use crate::parallel;
use crate::scene::image_settings::{DEFAULT_DEPTH, DEFAULT_SIZE, DEFAULT_WAVELENGTHS};
use crate::scene::{
    Background, Camera, CameraView, Effect, EffectOverrides, EffectSet, LensView, Scene, Shutter,
};
use crate::shading::ray_cone::Cone;
use crate::volume::SkipEmpty;
use adaptive::ROUND;
use costs::PixelCostBuffer;
use film::Tile;
use lamps::AreaLightSampler;
use lens::MovingCamera;
use light_layers::LightGroups;
use mattes::MatteIds;
use memory::ThreadMemory;
use meter::Profiler;
use mosaic::PatchAtlas;
use planes::AovBuffers;
use region::Cover;
use sampler::{Layout, PacketShape, SampleGroup};
use screen_motion::ScreenMotion;
use subsurface::SubsurfaceObjects;
use surface::{SurfaceScene, Surfaces};
use surroundings::Environment;
use texturing::ConeSource;
use wave::{RendererPool, TileResult};

/// Largest number of surfaces that are crossed when the interiors around the camera are determined.
const MAX_BOUNDARIES: usize = 4096;

/// Image size, sampling, effects and outputs of one render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Pixels per row; at least 1.
    pub width: u32,
    /// Number of rows; at least 1.
    pub height: u32,
    /// Samples per pixel; at least 1. With `adaptive` this is the maximum.
    pub spp: u32,
    /// Pattern of the sample positions in the pixel.
    pub pattern: Pattern,
    /// Seed of the random numbers. The errors of two images with different seeds are independent, except for the
    /// positions in the pixel of patterns that use no random numbers.
    pub seed: u32,
    /// Reconstruction filter that weighs the samples into pixels.
    pub filter: PixelFilter,
    /// Stopping criterion of adaptive sampling; `None` gives every pixel `spp` samples.
    ///
    /// Treats the filter as a box, because unequal numbers of samples would weigh the neighbours of a pixel
    /// unequally. Has no effect up to 16 samples per pixel, the minimum that every pixel gets; needs a pattern that
    /// can be continued, so not a regular one.
    pub adaptive: Option<Adaptive>,
    /// True if [`Rendering::aovs`] are computed. They change no bit of the image.
    pub sample_aovs: bool,
    /// Layers (AOVs) that [`Rendering::layers`] holds. They change no bit of the image. They are ignored with
    /// `adaptive`.
    pub layers: AovSet,
    /// Layers of light (per light or per effect), appended to [`Rendering::layers`]. They change no bit of the image.
    /// They need samples that count equally and for their own pixel only: with `adaptive` or a `filter` other than a
    /// box they are ignored.
    pub light_layers: LightAovs,
    /// Largest number of reflections and refractions along a path; 0 for none.
    pub depth: u32,
    /// Number of wavelengths that a path splits into at a dispersive dielectric; at least 1.
    pub wavelengths: u32,
    /// Smallest throughput of a secondary ray: the ray is not traced if all channels are below this.
    pub weight_cutoff: f32,
    /// Rule for the origins of rays that leave surfaces.
    pub spawn: SpawnPolicy,
    /// Rule for the positions of hit points on surfaces.
    pub hit_points: HitPoint,
    /// Skipping of empty space in ray marching. It changes no bit of the image.
    pub skip_empty: SkipEmpty,
    /// Effects that are switched on or off against the needs of the scene.
    pub effects: EffectOverrides,
    /// True if [`Rendering::ledger`] records times per account. When off, the clock is read only at both ends of the
    /// render and before the first sample; rays are counted either way. It changes no bit of the image.
    pub ledger: bool,
    /// True if [`Rendering::costs`] are computed, for which `ledger` must be on. They change no bit of the image, but
    /// make rendering slower.
    pub cost_aovs: bool,
}

impl Default for RenderSettings {
    fn default() -> RenderSettings {
        RenderSettings {
            width: DEFAULT_SIZE[0],
            height: DEFAULT_SIZE[1],
            spp: 1,
            pattern: Pattern::default(),
            seed: 0,
            filter: PixelFilter::default(),
            adaptive: None,
            sample_aovs: false,
            layers: AovSet::NONE,
            light_layers: LightAovs::NONE,
            depth: DEFAULT_DEPTH,
            wavelengths: DEFAULT_WAVELENGTHS,
            weight_cutoff: 1.0 / 512.0,
            spawn: SpawnPolicy::default(),
            hit_points: HitPoint::default(),
            skip_empty: SkipEmpty::default(),
            effects: EffectOverrides::default(),
            ledger: false,
            cost_aovs: false,
        }
    }
}

/// Finished image with its statistics.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Linear RGB radiance of the pixels.
    pub image: LinearImage,
    /// Number of samples that each pixel took.
    pub samples: SampleCounts,
    /// Sample statistics per pixel, if [`RenderSettings::sample_aovs`] is on.
    pub aovs: Option<SampleAovs>,
    /// AOVs of the first hits of camera rays, and layers of light, if [`RenderSettings::layers`] or
    /// [`RenderSettings::light_layers`] request any.
    pub layers: Vec<Layer>,
    /// Cost of each pixel, if [`RenderSettings::cost_aovs`] is on.
    pub costs: Option<PixelCosts>,
    /// Numbers of rays and seconds, by account.
    pub ledger: RenderProfile,
    /// Seconds before the first sample: mip levels, light tables, subsurface irradiance. Mostly independent of the
    /// image size.
    pub ready_seconds: f64,
    /// Memory use in bytes; empty with the ledger off.
    pub memory: Memory,
    /// Effects that were simulated, with the reason for each.
    pub plan: Plan,
    /// Statistics of subsurface scattering, if any object has it.
    pub subsurface: Option<SubsurfaceStats>,
}

/// Render context: everything that stays constant during one render.
struct RenderContext<'s> {
    scene: &'s Scene,
    accel: &'s dyn Accel,
    settings: RenderSettings,
    view: CameraView,
    surfaces: SurfaceScene<'s>,
    /// Width and height of a pixel, as fractions of the image size.
    pixel_size: [f64; 2],
    /// Distribution of the sample positions within pixels.
    layout: Layout,
    shape: PacketShape,
    /// Pixel offsets of the lanes of a packet of `shape`, within its block of pixels.
    pixels: [Lanes<u32>; 2],
    /// Sample positions of each pixel, divided into groups of one packet.
    groups: Vec<SampleGroup>,
    /// Range of `groups` that is rendered; all of them, unless the image is the sum of several partial renders.
    part: Range<usize>,
    /// True if the f64 sums of pixels are returned in addition to their means.
    returns_sums: bool,
    /// Effects that are simulated, and the lights that cast shadows.
    plan: Plan,
    ambient: [f32; 3],
    background: Background,
    /// Sampler of the wavelengths that a path splits into.
    spectrum: SpectralSampler,
    /// Dielectric interiors that contain the camera.
    media_at_camera: InteriorStack,
    /// Number of rays traced to determine `media_at_camera`.
    probe_count: u64,
    /// Cost of each pixel, if it is requested.
    costs: Option<PixelCostBuffer>,
    /// Names of the instances in matte (Cryptomatte) layers.
    mattes: MatteIds,
    /// Requested layers of light.
    light_sheet: LightGroups,
    /// Memory use of the render threads, with the ledger on.
    thread_memory: Option<ThreadMemory>,
    /// Ray cone of camera rays.
    camera_cone: Cone,
    /// Number of evenly distributed samples per pixel for which ray cones are as wide as a sample.
    even_count: u32,
    /// Thin lens that camera rays leave from; `None` for a pinhole.
    lens: Option<LensView>,
    /// Position of the camera over time, if the camera moves.
    motion: Option<MovingCamera>,
    /// Projection of points at both ends of the shutter interval, if motion vectors are requested.
    screen_motion: Option<ScreenMotion>,
    /// Shutter interval from which sample times are drawn.
    shutter: Shutter,
    /// Area lights, indexed like the lights of the scene (`None` for others); empty if no area light is simulated.
    area_lights: Vec<Option<AreaLightSampler<'s>>>,
    environment: Option<Environment>,
    /// Number of camera packets whose complete ray trees are traced before the next packets begin.
    wave: usize,
    /// Objects with subsurface scattering, once their irradiance is computed.
    bodies: Option<SubsurfaceObjects>,
}

/// Renders `scene` as seen by `camera`, in the current rayon pool. Returns `None` if cancelled.
///
/// `scene` must have passed [`Scene::validate`], and `accel` must have been built from it.
pub fn render(
    scene: &Scene,
    camera: &Camera,
    accel: &dyn Accel,
    settings: &RenderSettings,
    monitor: &Monitor,
) -> Option<Rendering> {
    render_on(scene, camera, accel, settings, monitor, None)
}

/// Renders as [`render`] does and, with adaptive sampling, resumes from and writes `checkpoints`.
///
/// Images without adaptive sampling are resumed by [`Parts`] instead. Pixel costs are not part of a checkpoint, so
/// they count only the work after it.
pub fn render_on(
    scene: &Scene,
    camera: &Camera,
    accel: &dyn Accel,
    settings: &RenderSettings,
    monitor: &Monitor,
    checkpoints: Option<&mut Checkpoints>,
) -> Option<Rendering> {
    // Prepare the scene and compute subsurface irradiance
    let start = Instant::now();
    let mut frame = RenderContext::new(scene, camera, accel, settings);
    let setup_seconds = settings.ledger.then(|| start.elapsed().as_secs_f64());
    let scattered = frame.scatter(monitor)?;
    let ready_seconds = start.elapsed().as_secs_f64();
    // Render the image with fixed or adaptive sample counts
    let mut rendering = match settings.target() {
        Some(target) => render_adaptively(&mut frame, target, monitor, checkpoints)?,
        None => render_uniformly(&frame, &Region::whole(settings), monitor)?,
    };
    rendering.ready_seconds = ready_seconds;
    rendering.subsurface = frame.bodies.as_ref().map(|bodies| bodies.stats);
    // Account for the preparation and finish the statistics
    let ledger = &mut rendering.ledger;
    *ledger += scattered;
    let setting_up = Tally {
        rays: frame.probe_count,
        seconds: setup_seconds.unwrap_or(0.0),
        trace_seconds: 0.0,
    };
    ledger.book(Category::Other, setting_up);
    ledger.settle(rayon::current_num_threads(), start.elapsed().as_secs_f64());
    rendering.memory = frame.memory();
    rendering.costs = frame.costs.map(PixelCostBuffer::finish);
    Some(rendering)
}

/// Renders a rectangle with `spp` samples in every pixel.
fn render_uniformly(frame: &RenderContext, region: &Region, monitor: &Monitor) -> Option<Rendering> {
    let settings = &frame.settings;
    // Allocate the AOVs, which the tiles write directly
    let cover = Cover::of(region, settings);
    let mut layers = layers::blank(settings.layers, region);
    layers.extend(frame.light_sheet.blank(region));
    let planes = AovBuffers::over(&mut layers, region);
    // Render all tiles that the region touches
    let (tiles, mut ledger) = render_tiles(frame, &cover.tiles, Some(&planes), monitor)?;
    drop(planes);
    let tiles = cover.placed(tiles);
    let [width, height] = cover.size();
    // Assemble tiles into pixels and add filtered neighbours
    let mut meter = Profiler::new(settings);
    let mut pixels = film::assemble(width, height, &tiles, &|result| &result.means);
    if !settings.filter.is_box() {
        filter::assemble(width, &mut pixels, &tiles);
    }
    let aovs =
        || SampleAovs::of(&cover.cut(film::assemble(width, height, &tiles, &|result| &result.estimates)));
    let aovs = settings.sample_aovs.then(aovs);
    meter.lap_all_threads(Category::Film);
    ledger += meter.ledger;
    let image = LinearImage {
        width: region.width,
        height: region.height,
        pixels: cover.cut(pixels),
    };
    let samples = SampleCounts::uniform(region.pixel_count(), settings.spp);
    Some(Rendering {
        aovs,
        layers,
        ..Rendering::new(image, samples, ledger, frame)
    })
}

/// Renders `tiles` and returns them in order with their pixels; their AOVs are written to `planes`.
fn render_tiles(
    frame: &RenderContext,
    tiles: &[Tile],
    planes: Option<&AovBuffers>,
    monitor: &Monitor,
) -> Option<(Vec<(Tile, TileResult)>, RenderProfile)> {
    let finished = AtomicUsize::new(0);
    // Render tiles in parallel with pooled working memory
    let waves = RendererPool::new(frame);
    let render_tile = |index: usize| {
        // Stop between tiles if the render is cancelled
        if monitor.cancel.load(Ordering::Relaxed) {
            return None;
        }
        let tile = tiles[index];
        let (result, ledger) = waves.acquire().render_tile(tile, planes);
        // Report the finished tile
        monitor.show(tile, &result.means);
        let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
        (monitor.progress)(finished as f64 / tiles.len() as f64);
        Some(((tile, result), ledger))
    };
    let rendered = parallel::map(tiles.len(), &render_tile);
    drop(waves);
    // Merge the ledgers of tiles in tile order
    let mut ledger = RenderProfile::default();
    let mut finished_tiles = Vec::with_capacity(tiles.len());
    for tile in rendered {
        let (tile, tile_ledger) = tile?;
        ledger += tile_ledger;
        finished_tiles.push(tile);
    }
    Some((finished_tiles, ledger))
}

/// Renders with adaptive sampling, in rounds, until each pixel reaches its target error.
fn render_adaptively(
    frame: &mut RenderContext,
    target: Adaptive,
    monitor: &Monitor,
    checkpoints: Option<&mut Checkpoints>,
) -> Option<Rendering> {
    // Sample the whole image as one canvas
    let canvas = PatchAtlas::whole(&frame.settings);
    let (estimates, ledger) = adaptive::render(frame, target, &canvas, monitor, checkpoints)?;
    let settings = &frame.settings;
    // Convert estimates to pixels
    let to_pixel = |index: usize| estimates[index].mean().map(|channel| channel as f32);
    let image = LinearImage {
        width: settings.width,
        height: settings.height,
        pixels: parallel::generate(estimates.len(), to_pixel),
    };
    Some(Rendering {
        aovs: settings.sample_aovs.then(|| SampleAovs::of(&estimates)),
        ..Rendering::new(image, SampleCounts::of(&estimates), ledger, frame)
    })
}

impl Rendering {
    /// Returns a rendering without its optional outputs.
    fn new(
        image: LinearImage,
        samples: SampleCounts,
        ledger: RenderProfile,
        frame: &RenderContext,
    ) -> Rendering {
        Rendering {
            image,
            samples,
            aovs: None,
            layers: Vec::new(),
            costs: None,
            ledger,
            ready_seconds: 0.0,
            memory: Memory::default(),
            plan: frame.plan.clone(),
            subsurface: None,
        }
    }
}

impl<'s> RenderContext<'s> {
    fn new(
        scene: &'s Scene,
        camera: &Camera,
        accel: &'s dyn Accel,
        settings: &RenderSettings,
    ) -> RenderContext<'s> {
        // Determine effects, view and sample layout
        let plan = Plan::new(scene, camera, &settings.effects);
        let effects = plan.effects();
        let view = camera.view(settings.width, settings.height);
        let shape = PacketShape::for_samples(settings.spp);
        // Adaptive sampling distributes the samples of each round evenly over the pixel.
        let even_count = settings.target().map_or(settings.spp, |_| ROUND);
        let layout = Layout::new(settings.pattern, even_count);
        let groups = shape.groups(layout, settings.spp);
        // Build the context without what depends on it
        let mut frame = RenderContext {
            scene,
            accel,
            settings: *settings,
            view,
            surfaces: SurfaceScene::new(scene, &plan).with_spawn_policy(settings),
            pixel_size: [settings.width, settings.height].map(|size| 1.0 / f64::from(size)),
            layout,
            shape,
            pixels: shape.pixels(),
            part: 0..groups.len(),
            returns_sums: false,
            groups,
            ambient: if effects.has(Effect::Ambient) {
                scene.ambient
            } else {
                [0.0; 3]
            },
            background: if effects.has(Effect::Background) {
                scene.background
            } else {
                Background::default()
            },
            plan,
            spectrum: SpectralSampler::new(settings.wavelengths as usize),
            media_at_camera: InteriorStack::EMPTY,
            probe_count: 0,
            costs: (settings.ledger && settings.cost_aovs)
                .then(|| PixelCostBuffer::new(settings.width, settings.height)),
            mattes: MatteIds::of(scene, settings.layers),
            light_sheet: LightGroups::new(settings.wanted_light(), &scene.lights, effects),
            thread_memory: settings.ledger.then(ThreadMemory::default),
            even_count,
            camera_cone: settings.camera_cone(&view, even_count),
            lens: camera.lens_view().filter(|_| effects.has(Effect::DepthOfField)),
            motion: MovingCamera::of(camera, [settings.width, settings.height], effects),
            screen_motion: settings
                .layers
                .has(AovKind::Motion)
                .then(|| ScreenMotion::new(camera, [settings.width, settings.height])),
            shutter: camera.shutter,
            area_lights: if effects.has(Effect::AreaLight) {
                lamps::area_lights(scene, effects)
            } else {
                Vec::new()
            },
            environment: Environment::of(scene, effects),
            wave: rough::camera_packets(scene, effects),
            bodies: None,
        };
        // Precompute direction offsets and find interiors around the camera
        frame.precompute_offsets();
        (frame.media_at_camera, frame.probe_count) = frame.media_at_camera();
        frame
    }

    /// Returns the effects that are simulated.
    #[inline(always)]
    fn effects(&self) -> EffectSet {
        self.plan.effects()
    }

    /// Sets the ray cones of camera rays for `count` evenly distributed samples per pixel.
    fn set_even_count(&mut self, count: u32) {
        self.even_count = count;
        self.camera_cone = self.settings.camera_cone(&self.view, count);
    }

    /// Returns whether paths carry state beyond their weights.
    fn has_path_state(&self) -> bool {
        let effects = self.effects();
        let is_sampled = effects.samples_light() || effects.has(Effect::MotionBlur);
        effects.has_transmission() || is_sampled || self.tracks_cones()
    }

    /// Returns whether each path carries its own ray cone, because cones differ between paths.
    fn tracks_cones(&self) -> bool {
        let effects = self.effects();
        // Without scattering, all cones are those of camera rays
        let differ = effects.has(Effect::Reflection) || effects.has_transmission() || effects.has_lobes();
        effects.has(Effect::TextureFilter) && differ
    }

    /// Precomputes the direction offsets of samples from the corners of their pixels, if they are equal for all
    /// packets.
    fn precompute_offsets(&mut self) {
        // Offsets need a common ray origin, and positions that all pixels share
        if self.view.eye().is_none() || self.shape.block != 1 || self.layout.is_per_pixel() {
            return;
        }
        let [width, height] = self.pixel_size;
        for group in &mut self.groups {
            let mut aside = [[0.0; LANES]; 3];
            for l in 0..LANES {
                let [x, y] = group.position.each_ref().map(|position| position[l]);
                let step = self.view.direction_offset(x * width, y * height).to_array();
                (0..3).for_each(|axis| aside[axis][l] = step[axis]);
            }
            group.aside = Some(aside);
        }
    }

    /// Returns the dielectric interiors around the camera at the middle of the shutter interval, and the number of
    /// rays traced.
    fn media_at_camera(&self) -> (InteriorStack, u64) {
        if !self.effects().has(Effect::MotionBlur) {
            return self.media_around(self.view.ray(0.5, 0.5).origin, 0.0);
        }
        // Use the camera position at the middle of the shutter interval
        let middle = self.shutter.time(0.5);
        let view = self
            .motion
            .as_ref()
            .map_or(self.view, |moving| moving.at(middle).0);
        self.media_around(view.ray(0.5, 0.5).origin, middle)
    }

    /// Returns the dielectric interiors around `p` at `time`, and the number of rays traced.
    ///
    /// Follows one ray through all surfaces that it hits: an interior that the ray leaves before it enters it
    /// contains `p`.
    fn media_around(&self, p: DVec3, time: f32) -> (InteriorStack, u64) {
        let (mut around, mut probe_count) = (InteriorStack::EMPTY, 0);
        if !self.effects().has(Effect::Refraction) {
            return (around, probe_count);
        }
        let mut visited_materials = Vec::new();
        let mut surfaces = Surfaces::new(self.effects());
        let mut packet = [RayPacket::EMPTY];
        // Oblique, so that the ray does not run along edges of axis-aligned geometry.
        let mut ray = Ray {
            time,
            ..Ray::new(p.as_vec3(), Vec3::new(0.236_068, 0.854_102, 0.463_525))
        };
        // Step through the surfaces along the ray
        for _ in 0..MAX_BOUNDARIES {
            packet[0].recycle();
            packet[0].set(0, &ray);
            probe_count += 1;
            self.accel.intersect(&mut packet, Coherence::Incoherent);
            let Some(hit) = packet[0].hit(0) else { break };
            self.surfaces
                .compute_interactions(&packet[0], ConeSource::None, &mut surfaces);
            let index = self.scene.instances[hit.instance as usize].material;
            // Enter interiors whose first hit is a back face
            let material = &self.scene.materials[index as usize];
            let has_inside = material.interior.is_some_and(|inside| !inside.is_thin);
            if material.transmits() && has_inside && !visited_materials.contains(&index) {
                visited_materials.push(index);
                if !surfaces.points.front[0] {
                    let priority = material.interior.map_or(0, |inside| inside.priority);
                    around.enter(NestedInterior { id: index, priority });
                }
            }
            ray.t_near = hit.t.next_up();
        }
        (around, probe_count)
    }

    /// Returns whether statistics of single samples are needed.
    fn needs_sample_statistics(&self) -> bool {
        let settings = &self.settings;
        settings.target().is_some() || settings.sample_aovs || !settings.filter.is_box()
    }
}
