//! Surface interactions: points, normals and materials of hits.

mod cone_source;
mod instance_view;
mod interaction;
mod object_points;
mod packet;
mod placed_packet;
mod shape_hit;
mod spawn_probe;
mod texel_inputs;
mod texture_eval;
mod uv_frame;
mod uv_packet;
mod vertex_fetch;

pub use spawn_probe::{SpawnPoint, SpawnProbe};

pub(super) use cone_source::ConeSource;
pub(super) use instance_view::InstanceView;
pub(super) use interaction::{SurfaceScene, Surfaces};
pub(super) use packet::{SurfacePacket, lane};
