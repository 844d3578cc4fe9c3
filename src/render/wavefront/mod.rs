//! Wavefront of a tile: ray queues, path states, and the shading of traced packets.

mod layers;
mod occlusion;
mod path_state;
mod ray_queue;
mod shading;
mod shading_state;
mod shadow_queue;
mod tile_renderer;
mod traced_packet;
mod wave_size;

pub(super) use path_state::{
    BEHIND_MIRROR, BouncedStates, InteriorArray, PathState, PathStatePacket, PathStates,
};
pub(super) use ray_queue::{PathPacket, RayLanes, RayQueue, RayWorkItem};
pub(super) use shading_state::ShadingState;
pub(super) use shadow_queue::{QueuedShadowRays, ShadowQueue};
pub(super) use tile_renderer::{RendererPool, TileRenderer, block_corners, block_pixels};
pub(super) use traced_packet::{BatchInfo, TracedPacket};
pub(super) use wave_size::{MAX_WAVE, WAVE, camera_packets};
