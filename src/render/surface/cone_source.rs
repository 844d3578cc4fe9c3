//! Ray cones of the rays of a packet.

use super::super::wavefront::PathStatePacket;
use crate::shading::ray_cone::RayCone;

/// Ray cones at the origins of the rays of a packet.
#[derive(Clone, Copy)]
pub(in crate::render) enum ConeSource<'a> {
    /// Cone of camera rays, for all lanes.
    Camera(RayCone),
    /// Cones from the path states, one per lane.
    Paths(PathStatePacket<'a>),
    /// No cones, so that textures are not filtered.
    None,
}
