//! Shading state of one thread: its film, its ray queues and its working memory.

use super::super::aov::{FirstHits, LightSource, TileLayer};
use super::super::context::RenderContext;
use super::super::film::{SampleFilm, TileFilm};
use super::super::lighting::direct::{SampleDirect, sample_direct_for};
use super::super::profile::{Category, Profiler, TileTruncation};
use super::super::scattering::{BoundaryRays, LobeRays, MarchState};
use super::super::surface::Surfaces;
use super::super::tile::Tile;
use super::ray_queue::RayQueue;
use super::shadow_queue::ShadowQueue;
use crate::numeric::LANES;
use crate::scene::{Effect, EffectSet};

/// Weight from which on rays behind diffuse surfaces are always sent. In a Cornell box, time times squared noise is least for
/// weights from 0.25 to 0.5, and a third more for 1.
const KEPT_WEIGHT: f32 = 0.25;

/// Shading state and working memory of one thread.
pub(in crate::render) struct ShadingState<'f, 's> {
    pub(in crate::render) frame: &'f RenderContext<'s>,
    pub(in crate::render) film: TileFilm,
    /// Sums of the weights with which camera rays go straight into a transparent background.
    pub(in crate::render) transparency: Option<Box<TileFilm>>,
    /// First-hit AOVs, if layers are requested.
    pub(in crate::render) first_hits: Option<Box<FirstHits<'f, 's>>>,
    /// Column and row of the film's first pixel in the image.
    pub(in crate::render) corner: [u32; 2],
    /// Direct lighting by punctual lights in scenes with plain effects only.
    pub(in crate::render) sample_direct: SampleDirect,
    pub(in crate::render) shadow_queue: Box<ShadowQueue>,
    /// Light that shadow rays are currently sampled from; not maintained in scenes with plain effects only.
    pub(in crate::render) current_source: LightSource,
    pub(in crate::render) next: RayQueue,
    /// Rays of the next generation whose paths have left a diffuse surface, in scenes with interreflection.
    pub(in crate::render) next_bounced: Option<Box<RayQueue>>,
    /// Weight from which on rays of paths that continue at random are always sent.
    pub(in crate::render) kept_weight: f32,
    /// Place of each path's wavelengths within their strata, by the number of its pixel, where paths are those of photons;
    /// empty for paths of the camera, whose wavelengths represent their strata.
    pub(in crate::render) wavelength_offsets: Vec<f64>,
    /// Number of bounces before the rays that are being shaded.
    pub(in crate::render) generation: u32,
    pub(in crate::render) meter: Profiler,
    pub(in crate::render) losses: TileTruncation,
    /// Surface interactions of shadow rays, in scenes with transparent shadows.
    pub(in crate::render) shadow_surfaces: Option<Box<Surfaces>>,
    /// Layers above surfaces, in scenes with clear coats or sheen.
    pub(in crate::render) layer_surfaces: Option<Box<Surfaces>>,
    /// Working memory for the rays that smooth boundaries scatter.
    pub(in crate::render) boundary_rays: Vec<BoundaryRays>,
    /// Working memory for the rays into lobes.
    pub(in crate::render) lobe_rays: Vec<LobeRays>,
    /// Photons that cover each lane, with the values of their kernels.
    pub(in crate::render) found_photons: [Vec<(u32, f32)>; LANES],
    /// Ray-marching state, in scenes with volumes or fog.
    pub(in crate::render) marches: Option<Box<MarchState<'s>>>,
}

impl<'f, 's> ShadingState<'f, 's> {
    pub(in crate::render) fn new(frame: &'f RenderContext<'s>, film: TileFilm) -> ShadingState<'f, 's> {
        ShadingState {
            frame,
            film,
            transparency: frame
                .settings
                .has_alpha()
                .then(|| Box::new(TileFilm::new(frame.sample_film()))),
            first_hits: FirstHits::of(frame),
            corner: [0; 2],
            sample_direct: sample_direct_for(frame.effects()),
            shadow_queue: ShadowQueue::new(frame.effects(), frame.batch)
                .with_lobe_radiance(frame.combined.splits_shadows)
                .with_chosen_lights(frame.light_tree.is_some() && frame.settings.wanted_light().lights),
            current_source: LightSource::Emission,
            next: RayQueue::of_frame(frame),
            next_bounced: RayQueue::of_bounces(frame),
            kept_weight: KEPT_WEIGHT,
            wavelength_offsets: Vec::new(),
            generation: 0,
            meter: Profiler::new(&frame.settings),
            losses: TileTruncation::default(),
            shadow_surfaces: frame
                .effects()
                .has(Effect::TransparentShadow)
                .then(|| Box::new(Surfaces::new(frame.effects()))),
            layer_surfaces: frame
                .effects()
                .has_layers()
                .then(|| Box::new(Surfaces::new(frame.effects()))),
            boundary_rays: Vec::new(),
            lobe_rays: Vec::new(),
            found_photons: [const { Vec::new() }; LANES],
            marches: frame.marches().then(|| Box::new(MarchState::new(frame))),
        }
    }

    pub(in crate::render) fn clear(&mut self) {
        self.film.clear();
        if let Some(film) = &mut self.transparency {
            film.clear();
        }
        self.next.clear();
        self.next_bounced.iter_mut().for_each(|bounced| bounced.clear());
        self.losses.clear();
        if let Some(first_hits) = &mut self.first_hits {
            first_hits.clear();
        }
    }

    /// Returns the film of the single samples of the transparency, if both exist.
    pub(in crate::render) fn transparency_samples(&mut self) -> Option<&mut SampleFilm> {
        self.transparency.as_mut()?.samples()
    }

    /// Books the film time at the end of a tile, and adds the tile's pixel costs to the cost image.
    pub(in crate::render) fn finish(&mut self, tile: Tile) {
        self.meter.lap(Category::Film);
        if let (Some(buffer), Some(costs)) = (&self.frame.costs, &self.meter.costs) {
            buffer.add(tile, costs);
        }
    }

    /// Returns the requested layers of a tile.
    pub(in crate::render) fn layers(&mut self, tile: Tile) -> Vec<TileLayer<'_>> {
        let first_hits = self.first_hits.as_mut();
        let mut layers = first_hits.map_or(Vec::new(), |first_hits| first_hits.layers(tile));
        if let Some(light) = self.film.light() {
            layers.extend(light.layers(self.frame.settings.spp));
        }
        layers
    }

    /// Returns the effects that are on.
    ///
    /// Functions with `BASIC` serve scenes whose effects are all in [`EffectSet::BASIC`]. All other effects are off
    /// there at compile time, so that a step that is not taken does not cost a test.
    #[inline(always)]
    pub(in crate::render) fn effects<const BASIC: bool>(&self) -> EffectSet {
        let all = self.frame.effects();
        if BASIC { all.within(EffectSet::BASIC) } else { all }
    }
}
