//! Surface interactions: points, normals and materials of hits.

mod cone_source;
mod interaction;
mod packet;
mod shape_hit;
mod spawn_probe;
mod texture_eval;
mod uv_frame;
mod uv_packet;
mod vertex_fetch;

pub use spawn_probe::{SpawnPoint, SpawnProbe};

pub(super) use cone_source::ConeSource;
pub(super) use interaction::{InstanceView, SurfaceScene, Surfaces};
pub(super) use packet::SurfacePacket;
