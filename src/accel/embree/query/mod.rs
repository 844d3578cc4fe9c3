//! Queries: packets of rays in Embree's layout, and the calls that trace them.

pub(super) mod direction_scale;
pub(super) mod packet_width;
pub(super) mod ray_packet;
pub(super) mod trace;
