//! Bounding volumes around objects, tested before the objects themselves.
//!
//! * [`BoxVolume`] is the bounding box of the object, [`SphereVolume`] a bounding sphere: the centroid sphere, whose
//!   centre is the centroid of the vertices, or the smallest one ([`BoundingSphere`]).
//! * [`BoundingVolumeKind::Chosen`] takes for every object the volume that measured costs make cheapest, or none.
//! * [`ScreenBounds`] are screen-space bounding boxes: a camera ray cannot hit an object whose box does not
//!   contain its pixel, so no arithmetic on rays is needed to skip it.
//! * [`ListAccel`] is a list of objects, each behind its bounding volume, with counters of the tests that the volumes
//!   save.
//!
//! A bounding volume changes the time, never a result: `guard` bounds the rounding errors of hits, and volumes are
//! that much wider. Planes have none, nor have instance transforms that are too extreme for the bound.

mod ball;
mod candidates;
mod choice;
mod guard;
mod hull;
mod kind;
mod list;
mod object;
mod projection;
mod rays;
mod shape;
mod tiles;
mod volumes;

pub use ball::BoundingSphere;
pub use candidates::Spheres;
pub(crate) use candidates::shape_spheres;
pub use kind::{BoundingVolumeCounts, BoundingVolumeKind};
pub use list::{ListAccel, Tally};
pub use projection::{ScreenBounds, ScreenBox};
pub use shape::{BoxVolume, SphereVolume};
pub use tiles::{ListLimits, TileCulledAccel};
