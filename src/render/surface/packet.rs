//! Surface interactions of a packet of sixteen hits, and the origins of rays that leave them.

use glam::{DVec3, Vec3};

use super::uv_frame::UvFrame;
use crate::accel::{NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3, offset_point, spawn_point};

/// Sixteen surface interactions in world space, as structure of arrays. Lanes without a hit may hold any values,
/// including NaN.
#[derive(Clone)]
pub(in crate::render) struct SurfacePacket {
    /// Lanes that hit a surface.
    pub(in crate::render) hit: Lanes<bool>,
    /// True if the ray came from the outside, the side of the front faces of triangles.
    pub(in crate::render) front: Lanes<bool>,
    /// Geometric normals to f64 accuracy on the side of the incident ray, for lanes other than world-space triangles.
    pub(in crate::render) exact_normal: Lanes3<f64>,
    /// Texture coordinates of the lanes that hit analytic shapes, if the view of the instance needs them.
    pub(super) shape_frames: [UvFrame; LANES],
    /// Hit points in world space.
    pub(in crate::render) p: Lanes3<f64>,
    /// Unit geometric normals on the side of the incident ray.
    pub(in crate::render) ng: Lanes3<f32>,
    /// Unit shading normals on the side of the incident ray.
    pub(in crate::render) ns: Lanes3<f32>,
    /// Unit vectors towards the origins of the incident rays.
    pub(in crate::render) wo: Lanes3<f32>,
    /// Origins of rays that leave on the side of `ng`.
    pub(in crate::render) origin: Lanes3<f32>,
    /// Bounds on the distance between `p` and the surface as seen by a traversal, along `ng`; not computed if there
    /// is an `offset`.
    pub(in crate::render) error: Lanes<f64>,
    /// Offset of ray origins from the surface; `None` if `error` is used instead.
    pub(in crate::render) offset: Option<f64>,
}

impl SurfacePacket {
    /// Returns a packet without hits.
    pub(in crate::render) fn new() -> SurfacePacket {
        SurfacePacket {
            hit: [false; LANES],
            front: [true; LANES],
            exact_normal: [[0.0; LANES]; 3],
            shape_frames: [UvFrame::ZERO; LANES],
            p: [[0.0; LANES]; 3],
            ng: [[0.0; LANES]; 3],
            ns: [[0.0; LANES]; 3],
            wo: [[0.0; LANES]; 3],
            origin: [[0.0; LANES]; 3],
            error: [0.0; LANES],
            offset: None,
        }
    }

    /// Returns the unit shading normal of lane `l` on the side of the incident ray.
    pub(in crate::render) fn shading_normal(&self, l: usize) -> DVec3 {
        lane(&self.ns, l).as_dvec3().normalize()
    }

    /// Returns the cosines between the shading normals and the viewers, in [0, 1].
    pub(in crate::render) fn viewing_cosines(&self) -> Lanes<f32> {
        std::array::from_fn(|l| lane(&self.ns, l).dot(lane(&self.wo, l)).abs().min(1.0))
    }

    /// Returns whether the shading normal of lane `l` differs from the geometric normal.
    pub(in crate::render) fn ns_differs(&self, l: usize) -> bool {
        (0..3).any(|axis| self.ns[axis][l] != self.ng[axis][l])
    }

    /// Returns the hit point of lane `l`.
    pub(in crate::render) fn point(&self, l: usize) -> DVec3 {
        DVec3::new(self.p[0][l], self.p[1][l], self.p[2][l])
    }

    /// Returns the unit geometric normal of lane `l` on the side of the incident ray.
    pub(in crate::render) fn geometric_normal(&self, l: usize) -> DVec3 {
        lane(&self.ng, l).as_dvec3()
    }

    /// Returns the bound on the distance between the hit point of lane `l` and the surface as seen by a traversal.
    pub(in crate::render) fn error(&self, l: usize) -> f64 {
        self.error[l]
    }

    /// Finds the lanes that hit something and the directions towards the origins of the rays.
    #[inline(always)]
    pub(super) fn face_rays(&mut self, packet: &RayPacket) {
        let d = &packet.direction;
        for l in 0..LANES {
            self.hit[l] = packet.instance[l] != NO_HIT;
        }
        for l in 0..LANES {
            let length = (d[0][l] * d[0][l] + d[1][l] * d[1][l] + d[2][l] * d[2][l]).sqrt();
            let scale = -1.0 / length;
            for axis in 0..3 {
                self.wo[axis][l] = d[axis][l] * scale;
            }
        }
    }

    /// Sets all hit points to their reported f32 parameters along the rays.
    #[inline(always)]
    pub(in crate::render) fn report(&mut self, packet: &RayPacket) {
        for axis in 0..3 {
            for l in 0..LANES {
                let way = packet.t_far[l] * packet.direction[axis][l];
                self.p[axis][l] = f64::from(packet.origin[axis][l] + way);
            }
        }
    }

    /// Computes the origins of rays that leave on the side of `ng`.
    #[inline(always)]
    pub(in crate::render) fn spawn(&mut self) {
        // Use a fixed offset if the spawn policy has one
        if let Some(offset) = self.offset {
            return self.spawn_shifted(offset);
        }
        // Otherwise move each point by its error bound
        for l in 0..LANES {
            let p = DVec3::new(self.p[0][l], self.p[1][l], self.p[2][l]);
            let origin = spawn_point(p, lane(&self.ng, l).as_dvec3(), self.error[l]);
            for axis in 0..3 {
                self.origin[axis][l] = origin[axis];
            }
        }
    }

    #[inline(always)]
    fn spawn_shifted(&mut self, offset: f64) {
        for l in 0..LANES {
            let p = DVec3::new(self.p[0][l], self.p[1][l], self.p[2][l]);
            let origin = offset_point(p, lane(&self.ng, l).as_dvec3(), offset);
            for axis in 0..3 {
                self.origin[axis][l] = origin[axis];
            }
        }
    }

    /// Returns the origin of a ray that leaves lane `l` on the side of the unit normal `side`.
    #[inline(always)]
    pub(in crate::render) fn leave(&self, l: usize, side: DVec3) -> Vec3 {
        match self.offset {
            None => spawn_point(self.point(l), side, self.error[l]),
            Some(offset) => offset_point(self.point(l), side, offset),
        }
    }
}

/// Returns lane `l` of a vector in structure-of-arrays form.
#[inline(always)]
pub(in crate::render) fn lane(v: &Lanes3<f32>, l: usize) -> Vec3 {
    Vec3::new(v[0][l], v[1][l], v[2][l])
}
