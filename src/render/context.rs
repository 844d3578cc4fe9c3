//! Render context: scene, camera, settings and prepared data, which stay constant during one render.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::adaptive::ROUND;
use super::aov::{AovKind, AovSet, LightAovs, LightGroups, MatteIds, PixelCostBuffer};
use super::camera::{MovingCamera, ScreenMotion};
use super::caustics::PhotonMap;
use super::film::{PixelFilter, SampleFilm};
use super::lighting::{
    AreaLightSampler, CombinedSampling, Environment, LightDivision, LightTree, area_lights,
};
use super::plan::Plan;
use super::profile::ThreadMemory;
use super::sampler::{PacketShape, SampleGroup, SampleLayout};
use super::settings::RenderSettings;
use super::subsurface::SubsurfaceObjects;
use super::surface::{ConeSource, SurfaceScene, Surfaces};
use super::wavefront::camera_packets;
use crate::accel::{Accel, Coherence, MAX_BATCH, RayPacket};
use crate::numeric::{LANES, Lanes, Ray};
use crate::optics::{InteriorStack, NestedInterior, SpectralSampler};
use crate::scene::image_settings::{Pattern, VisibleBackground};
use crate::scene::{Background, Camera, CameraView, Effect, EffectSet, LensView, Scene, Shutter};
use crate::shading::ray_cone::RayCone;

/// Largest number of surfaces that are crossed when the interiors around the camera are determined.
const MAX_BOUNDARIES: usize = 4096;

/// Render context: everything that stays constant during one render.
pub(super) struct RenderContext<'s> {
    pub(super) scene: &'s Scene,
    pub(super) accel: &'s dyn Accel,
    /// Number of coherent packets that are traced and shaded together.
    pub(super) batch: usize,
    pub(super) settings: RenderSettings,
    pub(super) view: CameraView,
    pub(super) surfaces: SurfaceScene<'s>,
    /// Width and height of a pixel, as fractions of the image size.
    pub(super) pixel_size: [f64; 2],
    /// Distribution of the sample positions within pixels.
    pub(super) layout: SampleLayout,
    pub(super) shape: PacketShape,
    /// Pixel offsets of the lanes of a packet of `shape`, within its block of pixels.
    pub(super) pixels: [Lanes<u32>; 2],
    /// Sample positions of each pixel, divided into groups of one packet.
    pub(super) groups: Vec<SampleGroup>,
    /// Range of `groups` that is rendered; all of them, unless the image is the sum of several partial renders.
    pub(super) part: Range<usize>,
    /// True if the f64 sums of pixels are returned in addition to their means.
    pub(super) returns_sums: bool,
    /// Effects that are simulated, and the lights that cast shadows.
    pub(super) plan: Plan,
    pub(super) ambient: [f32; 3],
    pub(super) background: Background,
    /// Sampler of the wavelengths that a path splits into.
    pub(super) spectrum: SpectralSampler,
    /// Dielectric interiors that contain the camera.
    pub(super) media_at_camera: InteriorStack,
    /// Number of rays traced to determine `media_at_camera`.
    pub(super) probe_count: u64,
    /// Cost of each pixel, if it is requested.
    pub(super) costs: Option<PixelCostBuffer>,
    /// Names of the instances in matte (Cryptomatte) layers.
    pub(super) mattes: MatteIds,
    /// Requested layers of light.
    pub(super) light_sheet: LightGroups,
    /// Memory use of the render threads, with the ledger on.
    pub(super) thread_memory: Option<ThreadMemory>,
    /// Ray cone of camera rays.
    pub(super) camera_cone: RayCone,
    /// Number of evenly distributed samples per pixel for which ray cones are as wide as a sample.
    pub(super) even_count: u32,
    /// Thin lens that camera rays leave from; `None` for a pinhole.
    pub(super) lens: Option<LensView>,
    /// Position of the camera over time, if the camera moves.
    pub(super) motion: Option<MovingCamera>,
    /// Projection of points at both ends of the shutter interval, if motion vectors are requested.
    pub(super) screen_motion: Option<ScreenMotion>,
    /// Shutter interval from which sample times are drawn.
    pub(super) shutter: Shutter,
    /// Area lights, indexed like the lights of the scene (`None` for others); empty if no area light is simulated.
    pub(super) area_lights: Vec<Option<AreaLightSampler<'s>>>,
    pub(super) environment: Option<Environment>,
    /// Tree of many lights, of which surfaces behind a diffuse bounce sample one; `None` where they sample all.
    pub(super) light_tree: Option<LightTree>,
    /// Lights that reach rough lobes both by light samples and by lobe rays.
    pub(super) combined: CombinedSampling,
    /// Largest number of diffuse surfaces that scatter the light of a path, in scenes with interreflection.
    pub(super) max_bounces: u32,
    /// Number of camera packets whose complete ray trees are traced before the next packets begin.
    pub(super) wave: usize,
    /// Objects with subsurface scattering, once their irradiance is computed.
    pub(super) bodies: Option<SubsurfaceObjects>,
    /// Photons of caustics, once lights have emitted them.
    pub(super) photons: Option<PhotonMap>,
}

impl<'s> RenderContext<'s> {
    pub(super) fn new(
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
        let layout = SampleLayout::new(settings.pattern, even_count);
        let groups = shape.groups(layout, settings.spp);
        let lights_with_extent = match effects.has(Effect::AreaLight) {
            true => area_lights(scene, effects),
            false => Vec::new(),
        };
        let combined = CombinedSampling::of(scene, &plan, &lights_with_extent);
        let division = LightDivision::of(scene, effects);
        // Build the context without what depends on it
        let mut frame = RenderContext {
            scene,
            accel,
            batch: accel.batch().clamp(1, MAX_BATCH),
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
            combined,
            light_tree: division.map(|division| LightTree::build(scene, division, &lights_with_extent)),
            area_lights: lights_with_extent,
            environment: Environment::of(scene, effects),
            max_bounces: scene.interreflection.unwrap_or_default().bounces,
            wave: camera_packets(scene, effects),
            bodies: None,
            photons: None,
        };
        // Precompute direction offsets and find interiors around the camera
        frame.precompute_offsets();
        (frame.media_at_camera, frame.probe_count) = frame.media_at_camera();
        frame
    }

    /// Changes to `spp` samples per pixel of `pattern`, with other random numbers and without any output but the image.
    /// Ray cones stay as they are, so that textures are filtered alike.
    pub(super) fn set_samples(&mut self, seed: u32, spp: u32, pattern: Pattern) {
        let filter = match self.settings.has_equal_counts() {
            true => self.settings.filter,
            false => PixelFilter::default(),
        };
        self.settings = RenderSettings {
            seed,
            spp,
            pattern,
            filter,
            adaptive: None,
            edge_contrast: None,
            ledger: false,
            ..self.settings.without_aovs()
        };
        (self.costs, self.thread_memory, self.screen_motion) = (None, None, None);
        self.mattes = MatteIds::of(self.scene, AovSet::NONE);
        self.light_sheet = LightGroups::new(LightAovs::NONE, &self.scene.lights, self.effects());
        self.returns_sums = false;
        self.lay_out_samples();
    }

    /// Changes to `spp` samples per pixel, with ray cones of their width.
    pub(super) fn set_spp(&mut self, spp: u32) {
        self.settings.spp = spp;
        self.set_even_count(spp);
        self.lay_out_samples();
    }

    /// Distributes the samples of the settings over pixels and packets.
    fn lay_out_samples(&mut self) {
        let RenderSettings { spp, pattern, .. } = self.settings;
        self.shape = PacketShape::for_samples(spp);
        self.pixels = self.shape.pixels();
        self.layout = SampleLayout::new(pattern, spp);
        self.groups = self.shape.groups(self.layout, spp);
        self.part = 0..self.groups.len();
        self.precompute_offsets();
    }

    /// Returns the effects that are simulated.
    #[inline(always)]
    pub(super) fn effects(&self) -> EffectSet {
        self.plan.effects()
    }

    /// Sets the ray cones of camera rays for `count` evenly distributed samples per pixel.
    pub(super) fn set_even_count(&mut self, count: u32) {
        self.even_count = count;
        self.camera_cone = self.settings.camera_cone(&self.view, count);
    }

    /// Returns whether paths carry state beyond their weights.
    pub(super) fn has_path_state(&self) -> bool {
        let effects = self.effects();
        let is_sampled = effects.samples_light() || effects.has(Effect::MotionBlur);
        effects.counts_bounces() || is_sampled || self.tracks_cones()
    }

    /// Returns whether each path carries its own ray cone, because cones differ between paths.
    pub(super) fn tracks_cones(&self) -> bool {
        self.effects().tracks_cones()
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
    pub(super) fn media_around(&self, p: DVec3, time: f32) -> (InteriorStack, u64) {
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
            let has_inside = material.interior.is_some_and(|inside| !inside.is_thin());
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
    pub(super) fn needs_sample_statistics(&self) -> bool {
        let settings = &self.settings;
        settings.target().is_some() || settings.sample_aovs || !settings.filter.is_box()
    }

    /// Returns an empty film of single samples, if statistics of them are needed.
    pub(super) fn sample_film(&self) -> Option<SampleFilm> {
        self.needs_sample_statistics()
            .then(|| SampleFilm::new(self.settings.filter))
    }

    /// Returns whether camera rays see another background than the scene's.
    pub(super) fn replaces_background(&self) -> bool {
        self.settings.background != VisibleBackground::Environment
    }

    /// Returns the number of samples per pixel in the share that is rendered.
    pub(super) fn samples_taken(&self) -> u32 {
        let before = |group: usize| self.settings.spp.min(group as u32 * self.shape.samples);
        before(self.part.end) - before(self.part.start)
    }
}
