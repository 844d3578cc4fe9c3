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

impl ConeSource<'_> {
    /// Returns the cone of lane `l` at its ray origin.
    pub(in crate::render) fn at_start(&self, l: usize) -> RayCone {
        match self {
            ConeSource::Camera(cone) => *cone,
            ConeSource::Paths(path_states) => path_states.cone(l),
            ConeSource::None => RayCone::default(),
        }
    }
}
