//! Irradiance at points of surfaces, computed with the light samples and shadow rays of camera hits.
//!
//! Each point becomes a hit seen along its normal, and a film with the pixels of one tile collects the irradiance. Points
//! therefore use the same code as camera hits, and random points on lights are numbered by position and not by thread.

use glam::DVec3;

use super::context::RenderContext;
use super::film::TileFilm;
use super::lighting::{LobeVariants, ShadingContext};
use super::profile::RenderProfile;
use super::surface::{ConeSource, Surfaces};
use super::tile::{TILE, Tile};
use super::wavefront::{BatchInfo, PathStates, ShadingState, TracedPacket};
use crate::accel::{Coherence, Hit, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::scene::Effect;
use crate::shading::MaterialPacket;

/// Number of sums of irradiance that are computed together: one for each pixel of a tile.
pub(super) const SUMS: usize = (TILE * TILE) as usize;

/// Number of tiles per row of the virtual image that numbers the points.
const TILES_A_ROW: usize = 1 << 10;

/// Throughput of 1 in every lane.
pub(super) const FULL_THROUGHPUT: Lanes3<f32> = [[1.0; LANES]; 3];

/// Working memory of one thread for irradiance at points.
pub(super) struct IrradianceMeter<'f, 's> {
    frame: &'f RenderContext<'s>,
    /// Interactions of the last packet of points.
    pub(super) surfaces: Box<Surfaces>,
    outcome: ShadingState<'f, 's>,
    /// Material that returns the transmitted irradiance.
    entrance: MaterialPacket,
    /// Path states at the points, outside of all interiors.
    path_states: PathStates,
}

impl<'f, 's> IrradianceMeter<'f, 's> {
    /// Creates working memory for irradiance that enters media of index `eta` through smooth boundaries; all irradiance
    /// enters if `eta` is 1.
    pub(super) fn new(frame: &'f RenderContext<'s>, eta: f64) -> IrradianceMeter<'f, 's> {
        let mut path_states = PathStates::new(frame.effects(), frame.combined.is_any());
        path_states.resize(1);
        IrradianceMeter {
            frame,
            surfaces: Box::new(Surfaces::new(frame.effects())),
            outcome: ShadingState::new(frame, TileFilm::new(None)),
            entrance: MaterialPacket {
                effects: frame.effects().with(Effect::Subsurface),
                entry_ior: Some(eta as f32),
                ..MaterialPacket::BLACK
            },
            path_states,
        }
    }

    /// Starts the sums of chunk number `chunk`, which gets a tile of the virtual image of its own.
    pub(super) fn begin(&mut self, chunk: usize) {
        let corner = [chunk % TILES_A_ROW, chunk / TILES_A_ROW].map(|tile| tile as u32 * TILE);
        self.outcome.meter.begin(Tile {
            x: corner[0],
            y: corner[1],
            width: TILE,
            height: TILE,
        });
        self.outcome.clear();
        self.outcome.corner = corner;
    }

    /// Computes the surface interactions of a packet of points.
    pub(super) fn compute_interactions(&mut self, packet: &RayPacket) {
        self.frame
            .surfaces
            .compute_interactions(packet, ConeSource::None, &mut self.surfaces);
    }

    /// Adds the irradiance of all lights at the points of `packet`, whose interactions are computed, to the sums `labels`.
    /// Points of equal label need different `samples`.
    pub(super) fn sample_lights(&mut self, packet: &RayPacket, labels: &Lanes<u32>, samples: &Lanes<u32>) {
        self.path_states.set_samples(0, samples);
        let traced = TracedPacket {
            packet,
            pixel: labels,
            weight: &FULL_THROUGHPUT,
            path_states: Some(self.path_states.at(0)),
        };
        // Light white points that reflect nothing but what enters
        let variants = LobeVariants::default();
        let lit = ShadingContext {
            points: &self.surfaces.points,
            materials: &self.entrance,
            weight: &FULL_THROUGHPUT,
            variants: &variants,
        };
        let stage = BatchInfo {
            order: Coherence::Incoherent,
            depth: 0,
            is_behind_bounce: false,
        };
        self.outcome.sample_lights::<false>(&traced, &lit, stage);
    }

    /// Traces the shadow rays that are still queued, and returns the sums.
    pub(super) fn finish(&mut self) -> &[[f64; 3]] {
        self.outcome.trace_shadow_rays::<false>(Coherence::Incoherent);
        self.outcome.film.sums()
    }

    /// Returns the rays and seconds of the current chunk.
    pub(super) fn ledger(&self) -> RenderProfile {
        self.outcome.meter.ledger
    }
}

/// Sets lane `l` of `packet` to a point at `position`, hit by a ray from `distance` above it along the unit `normal`. The
/// distance along the ray in `hit` is not read.
pub(super) fn set_point(
    packet: &mut RayPacket,
    l: usize,
    position: DVec3,
    normal: DVec3,
    distance: f64,
    hit: Hit,
) {
    let origin = (position + distance * normal).as_vec3();
    packet.set(l, &Ray::new(origin, -normal.as_vec3()));
    packet.set_hit(
        l,
        &Hit {
            t: distance as f32,
            ..hit
        },
    );
}
