//! From a scene and a backend to a picture: tiles in parallel, each a series of waves of packets.
//!
//! This room knows no file formats and no backend by name. A picture has the same bits for any number of threads and
//! any order of tiles: every tile owns its pixels and sums in one order.

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
pub use departure::{Departure, Departures};
pub use film::pixel_sum;
pub use filter::PixelFilter;
pub use layers::{Layer, LayerKind, LayerSet};
pub use ledger::{Account, Ledger, Loss, Tally};
pub use light_layers::LightLayers;
pub use memory::{Holding, Memory};
pub use monitor::{FinishedTile, Monitor};
pub use mosaic::{Mosaic, render_mosaic};
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

use crate::accel::{Accel, RayOrder, RayPacket};
use crate::image::LinearImage;
use crate::numeric::{LANES, Lanes, Ray, SpawnPolicy};
use crate::optics::{Body, InteriorStack, SpectralSampler};
use crate::parallel;
use crate::scene::image_settings::{DEFAULT_DEPTH, DEFAULT_SIZE, DEFAULT_WAVELENGTHS};
use crate::scene::{
    Background, Camera, CameraView, Effect, EffectOverrides, EffectSet, LensView, Scene, Shutter,
};
use crate::shading::ray_cone::Cone;
use crate::volume::SkipEmpty;
use adaptive::ROUND;
use costs::CostSheet;
use film::Tile;
use lamps::SoftLight;
use lens::MovingCamera;
use light_layers::LightSheet;
use mattes::MatteIds;
use memory::ThreadMemory;
use meter::Meter;
use mosaic::Canvas;
use planes::Planes;
use region::Cover;
use sampler::{Layout, PacketShape, SampleGroup};
use screen_motion::ScreenMotion;
use subsurface::Bodies;
use surface::{SurfaceScene, Surfaces};
use surroundings::Environment;
use texturing::Widths;
use wave::{TilePicture, Waves};

/// Surfaces that are looked through for the bodies around the camera.
const MAX_BOUNDARIES: usize = 4096;

/// What picture is made of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Pixels a row; at least 1.
    pub width: u32,
    /// Rows; at least 1.
    pub height: u32,
    /// Samples a pixel; at least 1. At most, with `adaptive`.
    pub spp: u32,
    /// How they lie in the pixel.
    pub pattern: Pattern,
    /// Which of the pictures it is that differ by their random numbers alone: errors of two are independent of each
    /// other, but for the places in the pixel that patterns without random numbers give.
    pub seed: u32,
    /// How they become the pixel.
    pub filter: PixelFilter,
    /// When a pixel has samples enough; `None` gives every pixel `spp`.
    ///
    /// Takes the filter for a box, as unequal numbers of samples would weigh a pixel's neighbours unequally. Does
    /// nothing up to 16 samples a pixel, the least that every pixel gets; needs a pattern whose samples go on, not a
    /// regular one.
    pub adaptive: Option<Adaptive>,
    /// Whether [`Rendering::aovs`] are wanted. They change no bit of the picture.
    pub sample_aovs: bool,
    /// Which of [`Rendering::layers`] are wanted. They change no bit of the picture; not together with `adaptive`, which
    /// takes them for none.
    pub layers: LayerSet,
    /// Which layers of light are wanted too, behind the others in [`Rendering::layers`]. They change no bit of the
    /// picture; only where samples count for their own pixel all alike: not together with `adaptive` or a `filter` other
    /// than a box, which take them for none.
    pub light_layers: LightLayers,
    /// Reflections and refractions that are followed at most; 0 for none.
    pub depth: u32,
    /// Wavelengths that a path splits into where a body disperses it; at least 1.
    pub wavelengths: u32,
    /// A reflected ray is not traced if its weight in every channel is under this.
    pub weight_cutoff: f32,
    /// Where rays start that leave surfaces.
    pub spawn: SpawnPolicy,
    /// Where on surfaces hits lie.
    pub hit_points: HitPoint,
    /// Whether marches through volumes leap over what is empty. It changes no bit of the picture.
    pub skip_empty: SkipEmpty,
    /// Effects that are wanted other than the scene calls for.
    pub effects: EffectOverrides,
    /// Whether [`Rendering::ledger`] is to tell where the time went. Off, no clock is read but at both ends of the
    /// render and before the first sample, and rays are counted all the same. It changes no bit of the picture.
    pub ledger: bool,
    /// Whether [`Rendering::costs`] are wanted, for which the ledger must be on. They change no bit of the picture, but
    /// make it slower.
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
            layers: LayerSet::NONE,
            light_layers: LightLayers::NONE,
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

/// A picture and what it took.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Linear RGB radiance.
    pub image: LinearImage,
    /// How many samples it took.
    pub samples: SampleCounts,
    /// What each pixel's samples tell, if [`RenderSettings::sample_aovs`] asks for it.
    pub aovs: Option<SampleAovs>,
    /// What camera rays met first, if [`RenderSettings::layers`] asks for it.
    pub layers: Vec<Layer>,
    /// What each pixel cost, if [`RenderSettings::cost_aovs`] asks for it.
    pub costs: Option<PixelCosts>,
    /// Rays and seconds.
    pub ledger: Ledger,
    /// Seconds before the first sample: levels of images, tables of lights, light within bodies. As long for a small
    /// picture as for a large one, for the most part.
    pub ready_seconds: f64,
    /// Bytes; empty with the ledger off.
    pub memory: Memory,
    /// What was simulated.
    pub plan: Plan,
    /// The bodies that scatter light within, where any do.
    pub subsurface: Option<SubsurfaceStats>,
}

/// Everything that stays the same over one picture.
struct Frame<'s> {
    scene: &'s Scene,
    accel: &'s dyn Accel,
    settings: RenderSettings,
    view: CameraView,
    surfaces: SurfaceScene<'s>,
    /// Width and height of a pixel as parts of the image's.
    pixel_size: [f64; 2],
    /// Where samples lie in their pixels.
    layout: Layout,
    shape: PacketShape,
    /// Pixels of the lanes of that shape, within its block.
    pixels: [Lanes<u32>; 2],
    /// The samples of each pixel, a packet's share at a time.
    groups: Vec<SampleGroup>,
    /// Those of them that are taken; all, but where a picture is the sum of several.
    part: Range<usize>,
    /// Whether the sums of pixels are wanted beside their means.
    keeps_sums: bool,
    /// What is simulated.
    plan: Plan,
    ambient: [f32; 3],
    background: Background,
    /// Into which wavelengths a path splits.
    spectrum: SpectralSampler,
    /// The bodies around the camera.
    media_at_eye: InteriorStack,
    /// Rays that were asked to find them.
    probe_count: u64,
    /// What each pixel cost, where somebody asks.
    costs: Option<CostSheet>,
    /// What the instances are called in layers of mattes.
    mattes: MatteIds,
    /// The layers of light that are wanted.
    light_sheet: LightSheet,
    /// What the threads hold, with the ledger on.
    thread_memory: Option<ThreadMemory>,
    /// How wide a camera ray is.
    camera_cone: Cone,
    /// Even samples a pixel that rays are as wide as for.
    even_count: u32,
    /// Where camera rays leave it, if it is no pinhole.
    lens: Option<LensView>,
    /// Where it is when, if it moves.
    motion: Option<MovingCamera>,
    /// How points move in the picture, where somebody asks.
    screen_motion: Option<ScreenMotion>,
    /// When samples are taken, where anything moves.
    shutter: Shutter,
    /// Lights with an extent, at the places of the lights; empty if there are none to simulate.
    soft_lights: Vec<Option<SoftLight<'s>>>,
    environment: Option<Environment>,
    /// Camera packets whose whole ray trees are finished before the next are begun.
    wave: usize,
    /// Bodies that scatter light within, once their light is known.
    bodies: Option<Bodies>,
}

/// Renders `scene` as `camera` sees it, in the current rayon pool. `None` if it was cancelled.
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

/// Renders as [`render`] does. With adaptive sampling it goes on from where `checkpoints` begin, and what is known on the
/// way is kept; other pictures are made by [`Parts`] for that, and costs (which no checkpoint knows) are those from there
/// on.
pub fn render_on(
    scene: &Scene,
    camera: &Camera,
    accel: &dyn Accel,
    settings: &RenderSettings,
    monitor: &Monitor,
    checkpoints: Option<&mut Checkpoints>,
) -> Option<Rendering> {
    let start = Instant::now();
    let mut frame = Frame::new(scene, camera, accel, settings);
    let made_ready = settings.ledger.then(|| start.elapsed().as_secs_f64());
    let scattered = frame.scatter(monitor)?;
    let ready_seconds = start.elapsed().as_secs_f64();
    let mut rendering = match settings.target() {
        Some(target) => render_adaptively(&mut frame, target, monitor, checkpoints)?,
        None => render_uniformly(&frame, &Region::whole(settings), monitor)?,
    };
    rendering.ready_seconds = ready_seconds;
    rendering.subsurface = frame.bodies.as_ref().map(|bodies| bodies.stats);
    let ledger = &mut rendering.ledger;
    *ledger += scattered;
    let setting_up = Tally {
        rays: frame.probe_count,
        seconds: made_ready.unwrap_or(0.0),
        trace_seconds: 0.0,
    };
    ledger.book(Account::Other, setting_up);
    ledger.settle(rayon::current_num_threads(), start.elapsed().as_secs_f64());
    rendering.memory = frame.memory();
    rendering.costs = frame.costs.map(CostSheet::finish);
    Some(rendering)
}

/// The same number of samples for every pixel of a rectangle.
fn render_uniformly(frame: &Frame, region: &Region, monitor: &Monitor) -> Option<Rendering> {
    let settings = &frame.settings;
    let cover = Cover::of(region, settings);
    let mut layers = layers::blank(settings.layers, region);
    layers.extend(frame.light_sheet.blank(region));
    let planes = Planes::over(&mut layers, region);
    let (tiles, mut ledger) = render_tiles(frame, &cover.tiles, Some(&planes), monitor)?;
    drop(planes);
    let tiles = cover.placed(tiles);
    let [width, height] = cover.size();
    let mut meter = Meter::new(settings);
    let mut pixels = film::assemble(width, height, &tiles, &|picture| &picture.means);
    if !settings.filter.is_box() {
        filter::assemble(width, &mut pixels, &tiles);
    }
    let aovs = || {
        SampleAovs::of(&cover.cut(film::assemble(width, height, &tiles, &|picture| {
            &picture.estimates
        })))
    };
    let aovs = settings.sample_aovs.then(aovs);
    meter.lap_all_threads(Account::Film);
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

/// Tiles with their pictures, in their order; their layers come into `planes`.
fn render_tiles(
    frame: &Frame,
    tiles: &[Tile],
    planes: Option<&Planes>,
    monitor: &Monitor,
) -> Option<(Vec<(Tile, TilePicture)>, Ledger)> {
    let finished = AtomicUsize::new(0);
    let waves = Waves::new(frame);
    let render_tile = |index: usize| {
        if monitor.cancel.load(Ordering::Relaxed) {
            return None;
        }
        let tile = tiles[index];
        let (picture, ledger) = waves.lend().render_tile(tile, planes);
        monitor.show(tile, &picture.means);
        let finished = finished.fetch_add(1, Ordering::Relaxed) + 1;
        (monitor.progress)(finished as f64 / tiles.len() as f64);
        Some(((tile, picture), ledger))
    };
    let rendered = parallel::map(tiles.len(), &render_tile);
    drop(waves);
    let mut ledger = Ledger::default();
    let mut finished_tiles = Vec::with_capacity(tiles.len());
    for tile in rendered {
        let (tile, tile_ledger) = tile?;
        ledger += tile_ledger;
        finished_tiles.push(tile);
    }
    Some((finished_tiles, ledger))
}

/// As many samples as each pixel needs, round by round.
fn render_adaptively(
    frame: &mut Frame,
    target: Adaptive,
    monitor: &Monitor,
    checkpoints: Option<&mut Checkpoints>,
) -> Option<Rendering> {
    let canvas = Canvas::whole(&frame.settings);
    let (estimates, ledger) = adaptive::render(frame, target, &canvas, monitor, checkpoints)?;
    let settings = &frame.settings;
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
    /// One without what only some ask for.
    fn new(image: LinearImage, samples: SampleCounts, ledger: Ledger, frame: &Frame) -> Rendering {
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

impl<'s> Frame<'s> {
    fn new(scene: &'s Scene, camera: &Camera, accel: &'s dyn Accel, settings: &RenderSettings) -> Frame<'s> {
        let plan = Plan::new(scene, camera, &settings.effects);
        let effects = plan.effects();
        let view = camera.view(settings.width, settings.height);
        let shape = PacketShape::for_samples(settings.spp);
        // Adaptive sampling fills the pixel evenly with every round.
        let even_count = settings.target().map_or(settings.spp, |_| ROUND);
        let layout = Layout::new(settings.pattern, even_count);
        let groups = shape.groups(layout, settings.spp);
        let mut frame = Frame {
            scene,
            accel,
            settings: *settings,
            view,
            surfaces: SurfaceScene::new(scene, &plan).left_as(settings),
            pixel_size: [settings.width, settings.height].map(|size| 1.0 / f64::from(size)),
            layout,
            shape,
            pixels: shape.pixels(),
            part: 0..groups.len(),
            keeps_sums: false,
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
            media_at_eye: InteriorStack::EMPTY,
            probe_count: 0,
            costs: (settings.ledger && settings.cost_aovs)
                .then(|| CostSheet::new(settings.width, settings.height)),
            mattes: MatteIds::of(scene, settings.layers),
            light_sheet: LightSheet::new(settings.wanted_light(), &scene.lights, effects),
            thread_memory: settings.ledger.then(ThreadMemory::default),
            even_count,
            camera_cone: settings.camera_cone(&view, even_count),
            lens: camera.lens_view().filter(|_| effects.has(Effect::DepthOfField)),
            motion: MovingCamera::of(camera, [settings.width, settings.height], effects),
            screen_motion: settings
                .layers
                .has(LayerKind::Motion)
                .then(|| ScreenMotion::new(camera, [settings.width, settings.height])),
            shutter: camera.shutter,
            soft_lights: if effects.has(Effect::AreaLight) {
                lamps::soft_lights(scene, effects)
            } else {
                Vec::new()
            },
            environment: Environment::of(scene, effects),
            wave: rough::camera_packets(scene, effects),
            bodies: None,
        };
        frame.set_samples_aside();
        (frame.media_at_eye, frame.probe_count) = frame.media_at_eye();
        frame
    }

    /// The effects that are simulated.
    #[inline(always)]
    fn effects(&self) -> EffectSet {
        self.plan.effects()
    }

    /// Makes rays as wide as for so many even samples a pixel.
    fn set_even_count(&mut self, count: u32) {
        self.even_count = count;
        self.camera_cone = self.settings.camera_cone(&self.view, count);
    }

    /// Whether paths keep more than their weights.
    fn travels(&self) -> bool {
        let effects = self.effects();
        let is_sampled = effects.samples_light() || effects.has(Effect::MotionBlur);
        effects.has_sheets() || is_sampled || self.follows_widths()
    }

    /// Whether paths know how wide they are, as it is not the same for all.
    fn follows_widths(&self) -> bool {
        let effects = self.effects();
        let differ = effects.has(Effect::Reflection) || effects.has_sheets() || effects.has_lobes();
        effects.has(Effect::TextureFilter) && differ
    }

    /// Works out what samples add to the directions of their pixels' corners, where that is the same for all packets.
    fn set_samples_aside(&mut self) {
        if self.view.eye().is_none() || self.shape.block != 1 || self.layout.is_per_pixel() {
            return;
        }
        let [width, height] = self.pixel_size;
        for group in &mut self.groups {
            let mut aside = [[0.0; LANES]; 3];
            for l in 0..LANES {
                let [x, y] = group.position.each_ref().map(|position| position[l]);
                let step = self.view.aside(x * width, y * height).to_array();
                (0..3).for_each(|axis| aside[axis][l] = step[axis]);
            }
            group.aside = Some(aside);
        }
    }

    /// The bodies around the camera in the middle of the time, with the number of rays asked.
    fn media_at_eye(&self) -> (InteriorStack, u64) {
        if !self.effects().has(Effect::MotionBlur) {
            return self.media_around(self.view.ray(0.5, 0.5).origin, 0.0);
        }
        let middle = self.shutter.time(0.5);
        let view = self
            .motion
            .as_ref()
            .map_or(self.view, |moving| moving.at(middle).0);
        self.media_around(view.ray(0.5, 0.5).origin, middle)
    }

    /// The bodies around `p` at `time`, by the surfaces that a ray from there meets: a body that is left before it is
    /// entered is one of them. With the number of rays asked.
    fn media_around(&self, p: DVec3, time: f32) -> (InteriorStack, u64) {
        let (mut around, mut probe_count) = (InteriorStack::EMPTY, 0);
        if !self.effects().has(Effect::Refraction) {
            return (around, probe_count);
        }
        let mut met = Vec::new();
        let mut surfaces = Surfaces::new(self.effects());
        let mut packet = [RayPacket::EMPTY];
        // Slanted, so that it runs along no edges of what is built along the axes.
        let mut ray = Ray {
            time,
            ..Ray::new(p.as_vec3(), Vec3::new(0.236_068, 0.854_102, 0.463_525))
        };
        for _ in 0..MAX_BOUNDARIES {
            packet[0].recycle();
            packet[0].set(0, &ray);
            probe_count += 1;
            self.accel.intersect(&mut packet, RayOrder::Incoherent);
            let Some(hit) = packet[0].hit(0) else { break };
            self.surfaces.meet(&packet[0], Widths::None, &mut surfaces);
            let index = self.scene.instances[hit.instance as usize].material;
            let material = &self.scene.materials[index as usize];
            let has_inside = material.interior.is_some_and(|inside| !inside.is_thin);
            if material.transmits() && has_inside && !met.contains(&index) {
                met.push(index);
                if !surfaces.points.front[0] {
                    let priority = material.interior.map_or(0, |inside| inside.priority);
                    around.enter(Body { id: index, priority });
                }
            }
            ray.t_near = hit.t.next_up();
        }
        (around, probe_count)
    }

    /// Whether anybody wants to know what single samples saw.
    fn keeps_samples(&self) -> bool {
        let settings = &self.settings;
        settings.target().is_some() || settings.sample_aovs || !settings.filter.is_box()
    }
}
