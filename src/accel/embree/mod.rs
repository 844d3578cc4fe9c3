//! Backend on the system's Embree, version 3.13 or 4.
//!
//! One Embree scene holds the world. A mesh whose object space is world space becomes native triangles with the
//! instance's own index as geometry ID, over the scene's own arrays. At
//! [`Precision::Watertight`](super::Precision::Watertight) up to sixteen nearby triangles are one primitive of the user
//! geometry instead (see `triangle_cluster`), also in instanced meshes. All other objects are one user geometry: each
//! shape and each instanced mesh is one of its primitives, because Embree traverses one tree for each kind of geometry
//! and each further tree costs time. Up to eight nearby static spheres are one primitive (see `sphere_cluster`). An
//! instanced mesh has an Embree scene of its own, built once for all its instances; the callback transforms the rays
//! into it in f64.
//!
//! With [`Instancing::Native`](super::Instancing::Native) instanced meshes are Embree's own instances instead, which
//! transform rays by an inverse in f32 (see `native_instances`). On 3.13.5 a coherent `rtcOccluded16` over them never
//! returns, so rays are never flagged as coherent where Embree has instances.
//!
//! Moving objects are a second user geometry, whose boxes Embree interpolates between time steps; the callback computes
//! the instance's transform at each ray's time. A scene without moving objects has no second geometry, and Embree
//! ignores the time.
//!
//! Infinite planes are outside Embree, which would drop them.
//!
//! Ties go to the smallest `t`, then instance, then primitive, wherever a callback decides. Of native triangles that
//! coincide in all three vertices, Embree is given only the first by that rule. Between different native triangles that
//! a ray hits at the same `t`, at a shared edge or where they overlap in one plane, Embree decides, by the order of
//! traversal. Watertight triangles are tested by the callbacks alone, whose results equal those of brute force.

mod baseline;
mod build;
mod built_meshes;
mod device;
mod embree_accel;
mod geometry;
mod instance_kind;
mod native_instances;
mod origin_bound;
mod progress;
mod query;
mod scene;
mod user_geometry;

pub(super) use self::built_meshes::BuiltMeshes;
pub use self::embree_accel::EmbreeAccel;
pub(super) use self::embree_accel::identity;
pub(super) use self::user_geometry::triangle_cluster::TriangleClusters;
